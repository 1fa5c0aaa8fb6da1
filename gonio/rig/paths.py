"""Names of files that lead out of a rig's folder are refused."""

from __future__ import annotations

from pathlib import Path

from gonio.errors import ConfigurationError


def inside(folder: Path, name: str, where: str) -> Path:
    """The file of this name below a folder.

    Parameters
    ----------
    folder : Path
    name : str
        Relative to the folder; the file need not exist.
    where : str
        What names it, as a message begins.

    Raises
    ------
    ConfigurationError
        If it is absolute, or leads out of the folder by `..` or by a link.
    """
    try:
        resolved = (folder / name).resolve()
        leads_out = not resolved.is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):  # a circle of links, a name with a null byte
        leads_out = True
    if leads_out:
        raise ConfigurationError(
            f"{where}: {name!r} leads out of {folder}; put every file of the rig below its folder "
            "(no '..', no link that leads elsewhere).",
            value=name,
        )
    return folder / name
