"""Write files whole or not at all."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gonio.errors import DataError


@contextmanager
def atomic_path(target: Path) -> Iterator[Path]:
    """A temporary name beside `target` that is synced and renamed to it when the block ends.

    An error inside the block, a full disk included, leaves `target` as it was and no remnant.

    Raises
    ------
    DataError
        If the folder is missing or the disk refuses the write.
    """
    target = Path(target)
    if not target.parent.is_dir():
        raise DataError(
            f"{target}: the folder {target.parent} does not exist; make it first.", value=target
        )
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
        os.close(handle)
        temporary = Path(name)
        # mkstemp makes the file private; give it the permissions of an ordinary new file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
    except OSError as error:
        raise _refused(target, error) from error
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise _refused(target, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(target: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sha256_of(path: Path) -> str:
    """Hex digest of a file's content, read in pieces."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()


def _refused(target: Path, error: OSError) -> DataError:
    return DataError(
        f"{target}: cannot be written ({error.strerror or error}); "
        "nothing was left behind, free space or choose another place.",
        value=target,
    )
