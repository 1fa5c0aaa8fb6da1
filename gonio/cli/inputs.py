"""Checks that input files exist, made before any slow import."""

from __future__ import annotations

from pathlib import Path

from gonio.errors import ConfigurationError, DataError


def require_measured(source: Path) -> None:
    """Refuse a source of samples that does not exist.

    Raises
    ------
    DataError
    """
    if not source.is_dir():
        from gonio.formats import require_file

        require_file(source)


def require_fit(source: Path) -> None:
    """Refuse a FIT.json that does not exist.

    Raises
    ------
    DataError
    """
    if not source.exists():
        raise DataError(
            f"{source}: no such file; give a fit that 'gonio fit -o' wrote.", value=source
        )


def require_rig(folder: Path) -> None:
    """Refuse a rig's folder that does not exist.

    Raises
    ------
    ConfigurationError
    """
    if not folder.is_dir():
        raise ConfigurationError(
            f"{folder}: no such folder; give the one that holds session.toml and the frames.",
            value=folder,
        )


def require_photos(paths: list[Path]) -> None:
    """Refuse photographs if one of them does not exist.

    Raises
    ------
    DataError
    """
    for path in paths:
        if not path.exists():
            raise DataError(f"{path}: cannot be read (No such file or directory).", value=path)
