"""The folder on disk where compiled code is kept between runs."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path


def wanted_folder() -> Path:
    """Where the environment asks for the cache.

    Returns
    -------
    Path
        `GONIO_CACHE_DIR` where it is set, else the folder `gonio` in `XDG_CACHE_HOME` where that is
        an absolute path, as the XDG Base Directory Specification asks, else `~/.cache/gonio`.
    """
    given = os.environ.get("GONIO_CACHE_DIR")
    if given:
        return Path(given)
    shared = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (shared if shared.is_absolute() else Path.home() / ".cache") / "gonio"


@cache
def folder() -> Path:
    """The cache folder, or a temporary one where the wanted one cannot be written.

    Returns
    -------
    Path
        A folder that exists; the same one for the whole run of a program.
    """
    wanted = wanted_folder()
    try:
        wanted.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=wanted):
            pass
    except OSError:
        return Path(tempfile.mkdtemp(prefix="gonio-"))
    return wanted
