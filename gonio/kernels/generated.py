"""Modules that are written when they are needed and kept in the folder of `gonio.cache`.

numba keeps machine code only for functions that live in a file (docs/adr/0004). Each file is named
by a hash of all that its code depends on, so it never changes once it is there, and deleting it
costs nothing but the time to compile it again.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import tempfile
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from gonio.cache import folder as cache_folder


def generated_module(
    prefix: str,
    text: str,
    ingredients: Iterable[str] = (),
    *,
    bound: Mapping[str, Any] | None = None,
    kept: bool = True,
) -> ModuleType:
    """A module with this text, imported from a file in the cache folder.

    Parameters
    ----------
    prefix : str
        Beginning of the file's name; a hash follows.
    text : str
        Source of the module.
    ingredients : iterable of str
        Texts on which the compiled code depends besides `text`; they go into the hash.
    bound : mapping, optional
        Objects that the module has under these names before its text runs.
    kept : bool
        Whether another process may use the file. False where the hash cannot tell what the code
        depends on; the file is then in a temporary folder of this process.

    Returns
    -------
    module
        Registered under its name: numba finds the environment of cached code by it.
    """
    digest = hashlib.sha256("\0".join([text, *ingredients]).encode()).hexdigest()[:16]
    path = (cache_folder() if kept else _process_folder()) / f"{prefix}_{digest}.py"
    if not path.exists():
        with tempfile.NamedTemporaryFile(
            "w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
        Path(file.name).replace(path)
    spec = importlib.util.spec_from_file_location(f"gonio_cache_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    vars(module).update(bound or {})
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@cache
def _process_folder() -> Path:
    """A temporary folder of this process."""
    return Path(tempfile.mkdtemp(prefix="gonio-"))
