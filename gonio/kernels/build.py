"""Compile the loops of `loops.py` around one scalar kernel and keep the machine code on disk.

numba caches machine code only for functions that live in a file, so the loops of each model are
written, header and all, to a file in the cache folder whose name is a hash of every source that
went into it: a changed model, a changed loop or a changed numba makes a new file, and stale code
cannot be run. A kernel that is written when asked for, such as a sum of models, goes the same way.
`gonio.cache` says which folder that is.

Loops for float32 are another such file, made when the first float32 directions come: the same
kernel and the same loops, with their constants in single precision (`gonio.kernels.single`).
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import re
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from gonio.cache import folder as cache_folder
from gonio.kernels.single import in_single, must_be_double, text_in_single
from gonio.kernels.split import split

_BEGIN, _END = "# HEADER ENDS", "# STAND-INS"
_HEADER = '''"""Loops around {module}.{name}, written by gonio.kernels.build; safe to delete."""
import numpy as np
from numba import njit
from {module} import {name} as source
from gonio.kernels.build import compiled
from gonio.kernels.intrinsics import align_stack
from gonio.kernels.split import split
from gonio.kernels.sums import mirror, sum_of_squares

_float32 = np.float32
kernel = compiled(source, single={single})


@njit(error_model="numpy", inline="always")
def unpack(p):
    align_stack()
    return ({scalars},)


@njit(error_model="numpy", inline="always")
def call(xi, yi, zi, xr, yr, zr, q):
    return kernel({directions}{arguments})


@njit(error_model="numpy", inline="always")
def store(both, above, gradient, k):
{stores}

'''
_KEPT = """
KEPT = {n}
parts = split(source)
first, second = compiled(parts.geometry), compiled(parts.shape)


@njit(error_model="numpy", inline="always")
def geometry(xi, yi, zi, xr, yr, zr):
    return first(xi, yi, zi, xr, yr, zr)


@njit(error_model="numpy", inline="always")
def keep(kept, rows, k):
{stores}


@njit(error_model="numpy", inline="always")
def shape(rows, k, q):
    return second({arguments})

"""
_AMPLITUDES = """
@njit(inline="always")
def amplitudes():
    return {}

"""
_DECORATOR = '@njit(cache=True, nogil=True, error_model="numpy")\n'
_SUMMING = ("prepare", "project", "forget")  # those of `small_fits` that sum over samples
_DIRECTIONS = ("xi", "yi", "zi", "xr", "yr", "zr")


@dataclass(frozen=True)
class Loops:
    """The compiled loops of one model; what each does stands in `gonio.kernels.loops`."""

    evaluate: Callable[..., None]
    evaluate_gradient: Callable[..., None]
    cell_values: Callable[..., None]
    cell_gradient: Callable[..., None]
    normal_equations: Callable[..., None]
    cell_normal_equations: Callable[..., None]
    sums_of_squares: Callable[..., None]
    batch_chi2: Callable[..., None]
    image: Callable[..., None]


@dataclass(frozen=True)
class SingleLoops:
    """Those loops that take float32 directions and write float32."""

    evaluate: Callable[..., None]
    evaluate_gradient: Callable[..., None]


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
    module = _load(kernel, n_parameters, single=False)
    return Loops(**{name: getattr(module, name) for name in Loops.__dataclass_fields__})


@dataclass(frozen=True)
class MomentLoops:
    """The loops of `gonio.kernels.moments` around one model and its amplitudes."""

    moments: Callable[..., None]
    factored_moments: Callable[..., None]
    cell_moments: Callable[..., None]


@cache
def moment_loops_for(
    kernel: Callable[..., Any], n_parameters: int, linear: tuple[int, ...]
) -> MomentLoops:
    """Loops that sum up chi-squared as a function of the parameters with the numbers `linear`."""
    stores = [
        f"    gradient[{k}, k] = both[{j + 1}] if above else 0.0" for k, j in enumerate(linear)
    ]
    text = _header(kernel, n_parameters, stores or ["    pass"]) + _AMPLITUDES.format(len(linear))
    text += _kept(kernel, n_parameters) + _dispatch(1 + len(linear)) + _decorated(_body("moments"))
    prefix = kernel.__module__.replace(".", "_") + "_moments"
    module = generated_module(prefix, text, _ingredients(kernel))
    return MomentLoops(**{name: getattr(module, name) for name in MomentLoops.__dataclass_fields__})


@dataclass(frozen=True)
class TexelLoops:
    """The loops of `gonio.kernels.texels` around one model."""

    KEPT: int
    fit_texels: Callable[..., None]
    directions: Callable[..., None]
    grid_basis: Callable[..., None]


@cache
def texel_loops_for(kernel: Callable[..., Any], n_parameters: int) -> TexelLoops:
    """Loops that fit one small data set after another."""
    stores = [
        f"    gradient[{j}, k] = both[{j + 1}] if above else 0.0" for j in range(n_parameters)
    ]
    text = _header(kernel, n_parameters, stores)
    text += "from gonio.kernels.build import small_fits\n"
    text += "from gonio.kernels.fastmath import sincos\n\n"
    text += f"small_fits, sincos = small_fits({n_parameters}), compiled(sincos)\n"
    # The values, the part without amplitudes, and as many amplitudes as models have.
    text += _kept(kernel, n_parameters) + _dispatch(2, 3, 4) + _decorated(_body("texels"))
    prefix = kernel.__module__.replace(".", "_") + "_texels"
    module = generated_module(prefix, text, _ingredients(kernel))
    return TexelLoops(**{name: getattr(module, name) for name in TexelLoops.__dataclass_fields__})


@cache
def small_fits(n_parameters: int) -> ModuleType:
    """The compiled functions of `gonio.kernels.small_fits` for models with so many parameters."""
    import numba

    text = "import math\n\nfrom numba import njit\n" + _dispatch(1 + n_parameters)
    text += _decorated(_body("small_fits"))
    summing = _DECORATOR.replace(")\n", ', fastmath={"reassoc", "contract"})\n')
    for name in _SUMMING:
        text = text.replace(f"{_DECORATOR}def {name}(", f"{summing}def {name}(")
    text = re.sub(r"\bn_p = \w+\.shape\[0\]", f"n_p = {n_parameters}", text)
    sums = Path(__file__).with_name("sums.py").read_text(encoding="utf-8")
    return generated_module("gonio_small_fits", text, [numba.__version__, sys.version, sums])


@cache
def single_loops_for(kernel: Callable[..., Any], n_parameters: int) -> SingleLoops:
    """`loops_for` float32 directions and results; parameters stay float64.

    A kernel that single precision would ruin (`gonio.kernels.single.DOUBLE`) is computed in double
    by these loops, and rounded.
    """
    in_double = any(map(must_be_double, _reached(kernel)))
    module = _load(kernel, n_parameters, single=not in_double)
    return SingleLoops(**{name: getattr(module, name) for name in SingleLoops.__dataclass_fields__})


def compiled(function: Callable[..., Any], *, single: bool = False) -> Callable[..., Any]:
    """`function` compiled by numba together with the plain functions that it calls by name.

    With `single` their constants are float32, and so is all that they make of float32 arguments.
    """
    from numba import njit

    plain = _plain(function)
    if hasattr(plain, "compiled_twin"):
        # A function that Python and machine code do differently brings its own compiled form.
        own: Callable[..., Any] = plain.compiled_twin()
        return own
    if single:
        plain = in_single(_plain(getattr(plain, "single_twin", plain)))
    names = dict(plain.__globals__)
    for name in plain.__code__.co_names:
        callee = names.get(name)
        if isinstance(callee, FunctionType):
            names[name] = compiled(callee, single=single)
    twin = FunctionType(plain.__code__, names, plain.__name__, plain.__defaults__)
    result: Callable[..., Any] = njit(error_model="numpy", forceinline=True)(twin)
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
    path = cache_folder() / f"{prefix}_{digest}.py"
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


def _load(kernel: Callable[..., Any], n_parameters: int, *, single: bool) -> ModuleType:
    prefix = kernel.__module__.replace(".", "_") + ("_single" if single else "")
    text = _render(kernel, n_parameters, single=single)
    return generated_module(prefix, text, _ingredients(kernel))


def _ingredients(kernel: Callable[..., Any]) -> list[str]:
    """What the code compiled around a kernel depends on."""
    import numba

    own = [path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("*.py"))]
    sources = {inspect.getsourcefile(function) for function in _reached(kernel)}
    read = [Path(path).read_text(encoding="utf-8") for path in sorted(filter(None, sources))]
    return [numba.__version__, sys.version, *own, *read]


def _render(kernel: Callable[..., Any], n_parameters: int, *, single: bool) -> str:
    """Text of the generated module: header and decorated loops."""
    body = _body("loops")
    zero = "_float32(0.0)" if single else "0.0"
    if single:
        body = "\n\n\n" + text_in_single(body, tuple(SingleLoops.__dataclass_fields__))
    stores = [
        f"    gradient[{j}, k] = both[{j + 1}] if above else {zero}" for j in range(n_parameters)
    ]
    header = _header(kernel, n_parameters, stores, single=single)
    if single:
        return header + _decorated(body)
    # All columns of a fit, or those of up to two amplitudes.
    sums = _dispatch(2, 3, 1 + n_parameters)
    return header + _kept(kernel, n_parameters) + sums + _decorated(body)


def _body(name: str) -> str:
    """The loops of a file beside this one, without what stands for the header there."""
    text = Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
    return text.split(_BEGIN, 1)[1].split(_END, 1)[0]


def _decorated(body: str) -> str:
    return body.replace("\ndef ", "\n" + _DECORATOR + "def ")


def _dispatch(*sizes: int) -> str:
    """An `add_products` for blocks with these numbers of rows."""
    from gonio.kernels.sums import dispatch

    return dispatch(sizes)


def _kept(kernel: Callable[..., Any], n_parameters: int) -> str:
    """The two parts of a kernel, and the loops over what the first one says."""
    n = split(kernel).n
    arguments = [f"rows[{k}, k]" for k in range(n)] + [f"q[{j}]" for j in range(n_parameters)]
    stores = "\n".join(f"    rows[{k}, k] = kept[{k}]" for k in range(n))
    text = _KEPT.format(n=n, stores=stores, arguments=", ".join(arguments))
    return text + _decorated(_body("kept"))


def _header(
    kernel: Callable[..., Any], n_parameters: int, stores: Iterable[str], *, single: bool = False
) -> str:
    """What binds the loops to one kernel; `stores` are the lines that keep its derivatives."""
    real = "_float32" if single else "np.float64"
    return _HEADER.format(
        module=kernel.__module__,
        name=kernel.__name__,
        single=single,
        directions=", ".join(f"{real}({name})" for name in _DIRECTIONS),
        arguments="".join(f", q[{j}]" for j in range(n_parameters)),
        stores="\n".join(stores),
        scalars=", ".join(f"{real}(p[{j}])" for j in range(n_parameters)),
    )


def _plain(function: Callable[..., Any]) -> FunctionType:
    plain = inspect.unwrap(function)
    assert isinstance(plain, FunctionType)
    return plain


def _reached(function: Callable[..., Any]) -> list[FunctionType]:
    """The function and all plain functions that it calls, directly or not."""
    found = [_plain(function)]
    for caller in found:
        for name in caller.__code__.co_names:
            callee = caller.__globals__.get(name)
            if isinstance(callee, FunctionType) and _plain(callee) not in found:
                found.append(_plain(callee))
    return found
