"""Compile the loops of `loops.py` around one scalar kernel and keep the machine code on disk.

numba caches machine code only for functions that live in a file, so the loops of each model are
written, header and all, to a file in the cache folder whose name is a hash of every source that
went into it: a changed model, a changed loop or a changed numba makes a new file, and stale code
cannot be run. A kernel that is written when asked for, such as a sum of models, goes the same way.
The folder is `GONIO_CACHE_DIR`, else `~/.cache/gonio`.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

_MARK = "# HEADER ENDS"
_HEADER = '''"""Loops around {module}.{name}, written by gonio.kernels.build; safe to delete."""
import numpy as np
from numba import njit
from {module} import {name} as source
from gonio.kernels.build import compiled

kernel = compiled(source)


@njit(error_model="numpy", inline="always")
def unpack(p):
    return ({scalars},)


@njit(error_model="numpy", inline="always")
def call(xi, yi, zi, xr, yr, zr, q):
    return kernel(xi, yi, zi, xr, yr, zr{arguments})


@njit(error_model="numpy", inline="always")
def store(both, above, gradient, k):
{stores}

'''
_DECORATOR = '@njit(cache=True, nogil=True, error_model="numpy")\n'


@dataclass(frozen=True)
class Loops:
    """The compiled loops of one model; what each does stands in `gonio.kernels.loops`."""

    evaluate: Callable[..., None]
    evaluate_gradient: Callable[..., None]
    cell_values: Callable[..., None]
    cell_gradient: Callable[..., None]
    batch_chi2: Callable[..., None]
    image: Callable[..., None]


@cache
def loops_for(kernel: Callable[..., Any], n_parameters: int) -> Loops:
    """Compiled loops around `kernel(xi, yi, zi, xr, yr, zr, *parameters)`.

    Parameters
    ----------
    kernel : callable
        A module-level function of plain scalar Python and `math` that returns the tuple
        (f, df/dp_1, ..., df/dp_n). Functions that it calls are compiled with it.
    n_parameters : int
        Number of parameters behind the six direction cosines.

    Returns
    -------
    Loops
        Compiled at their first call, or read from the cache on disk.
    """
    module = _load(_render(kernel, n_parameters), f"{kernel.__module__}.{kernel.__qualname__}")
    return Loops(**{name: getattr(module, name) for name in Loops.__dataclass_fields__})


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` compiled by numba together with the plain functions that it calls by name."""
    from numba import njit

    plain = inspect.unwrap(function)
    assert isinstance(plain, FunctionType)
    if hasattr(plain, "compiled_twin"):
        # A function that Python and machine code do differently brings its own compiled form.
        own: Callable[..., Any] = plain.compiled_twin()
        return own
    names = dict(plain.__globals__)
    for name in plain.__code__.co_names:
        callee = names.get(name)
        if isinstance(callee, FunctionType):
            names[name] = compiled(callee)
    twin = FunctionType(plain.__code__, names, plain.__name__, plain.__defaults__)
    result: Callable[..., Any] = njit(error_model="numpy")(twin)
    return result


def generated_module(prefix: str, text: str, ingredients: Iterable[str] = ()) -> ModuleType:
    """A module with this text, imported from a file in the cache folder.

    Parameters
    ----------
    prefix : str
        Beginning of the file's name; a hash follows.
    text : str
        Source of the module.
    ingredients : iterable of str
        What the compiled code depends on besides the text; it goes into the hash.

    Returns
    -------
    module
        Registered under its name: numba finds the environment of cached code by it, and one
        generated module can import another.
    """
    digest = hashlib.sha256("\0".join([text, *ingredients]).encode()).hexdigest()[:16]
    path = _cache_folder() / f"{prefix}_{digest}.py"
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
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def _render(kernel: Callable[..., Any], n_parameters: int) -> str:
    """Text of the generated module: header, hash of the sources, decorated loops."""
    text = Path(__file__).with_name("loops.py").read_text(encoding="utf-8")
    body = text.split(_MARK, 1)[1].split("def unpack(", 1)[0]
    body = body.replace("\ndef ", "\n" + _DECORATOR + "def ")
    header = _HEADER.format(
        module=kernel.__module__,
        name=kernel.__name__,
        arguments="".join(f", q[{j}]" for j in range(n_parameters)),
        stores="\n".join(
            f"    gradient[{j}, k] = both[{j + 1}] if above else 0.0" for j in range(n_parameters)
        ),
        scalars=", ".join(f"p[{j}]" for j in range(n_parameters)),
    )
    return header + body


def _sources(function: Callable[..., Any], seen: dict[str, str]) -> dict[str, str]:
    plain = inspect.unwrap(function)
    assert isinstance(plain, FunctionType)
    key = f"{plain.__module__}.{plain.__qualname__}"
    if key not in seen:
        path = inspect.getsourcefile(plain)
        seen[key] = Path(path).read_text(encoding="utf-8") if path else ""
        for name in plain.__code__.co_names:
            callee = plain.__globals__.get(name)
            if isinstance(callee, FunctionType):
                _sources(callee, seen)
    return seen


def _load(text: str, origin: str) -> ModuleType:
    import numba

    module_name, _, name = origin.rpartition(".")
    kernel = getattr(sys.modules[module_name], name)
    ingredients = [numba.__version__, sys.version, *_sources(kernel, {}).values()]
    return generated_module(module_name.replace(".", "_"), text, ingredients)


@cache
def _cache_folder() -> Path:
    """The cache folder, or a temporary one where no home can be written."""
    given = os.environ.get("GONIO_CACHE_DIR")
    folder = Path(given) if given else Path.home() / ".cache" / "gonio"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="gonio-"))
    return folder
