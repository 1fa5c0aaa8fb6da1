"""Compile the templates of loops around one scalar kernel and keep the machine code on disk.

numba caches machine code only for functions that live in a file, so the loops of each model are
written, header and all, to a file in the cache folder whose name is a hash of every source that
went into it: a changed model, a changed loop or a changed numba makes a new file, and stale code
cannot be run. The same holds for a kernel that is generated, such as a sum of models, and for one
that lives in no file.

The header defines, for one model, the names that the templates take as parameters; the
docstring of `gonio.kernels.loops.loops_around` describes each. `gonio.kernels.template` describes
how templates become text.

Loops for float32 are another such file, made for the first float32 directions: the same
kernel and the same loops, with their constants in single precision (`gonio.kernels.single`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from gonio.kernels import compiling
from gonio.kernels.arrays import ArrayKernel, loops_of, moment_loops_of, texel_loops_of
from gonio.kernels.generated import generated_module
from gonio.kernels.kept import kept_around
from gonio.kernels.loops import Loops, loops_around
from gonio.kernels.moments import MomentLoops, moments_around
from gonio.kernels.pairs import PairLoops, pairs_around
from gonio.kernels.single import must_be_double, text_in_single
from gonio.kernels.small_fits import small_fits_of
from gonio.kernels.sources import definition, ingredients, plain, reached
from gonio.kernels.split import split
from gonio.kernels.template import DECORATOR, module_text, read
from gonio.kernels.texels import TexelLoops, texels_around
from gonio.kernels.uncompilable import guarded

_HEADER = '''"""Loops around {name}, written by gonio.kernels.build; safe to delete.

`source`, the kernel, is handed in by gonio.kernels.build.
"""
import numpy as np
from numba import njit
from gonio.kernels.intrinsics import align_stack
from gonio.kernels.scalar import compiled
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
_PARTS = """
n_kept = {n}
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
_SMALL_FITS = """from gonio.kernels.build import small_fits
from gonio.kernels.fastmath import sincos

small_fits, sincos = small_fits({n_parameters}), compiled(sincos)
"""
OWN = ("gonio.", "gonio_cache_")  # modules of functions that are part of gonio, or written by it
_DIRECTIONS = ("xi", "yi", "zi", "xr", "yr", "zr")

Piece = str | Callable[..., Any]  # of a generated file: a text or a template
Record = TypeVar("Record")


@cache
def loops_for(kernel: Callable[..., Any], n_parameters: int) -> Loops:
    """Compiled loops around `kernel(xi, yi, zi, xr, yr, zr, *parameters)`.

    Parameters
    ----------
    kernel : callable
        A function of plain scalar Python and `math` that returns the tuple
        (f, df/dp_1, ..., df/dp_n). Functions that it calls are compiled with it. An `ArrayKernel`
        is not compiled; its loops are numpy's.
    n_parameters : int
        Number of parameters behind the six direction cosines.

    Returns
    -------
    Loops
        Compiled at their first call, or read from the cache on disk.
    """
    if isinstance(kernel, ArrayKernel):
        return loops_of(kernel)
    return _compiled_record(Loops, kernel, "", *_double(kernel, n_parameters))


@cache
def moment_loops_for(
    kernel: Callable[..., Any], n_parameters: int, linear: tuple[int, ...]
) -> MomentLoops:
    """Loops for chi-squared as a function of the parameters with the numbers `linear`."""
    if isinstance(kernel, ArrayKernel):
        return moment_loops_of(kernel, linear)
    stores = [
        f"    gradient[{k}, k] = both[{j + 1}] if above else 0.0" for k, j in enumerate(linear)
    ]
    header = _header(kernel, n_parameters, stores or ["    pass"])
    header += f"\nn_amplitudes = {len(linear)}\n"
    kept, sums = _kept_pieces(kernel, n_parameters), _dispatch(1 + len(linear))
    return _compiled_record(
        MomentLoops, kernel, "_moments", header, *kept, sums, pairs_around, moments_around
    )


@cache
def texel_loops_for(kernel: Callable[..., Any], n_parameters: int) -> TexelLoops:
    """Loops that fit one small data set after another."""
    if isinstance(kernel, ArrayKernel):
        return texel_loops_of(kernel, small_fits(n_parameters))
    header = _header(kernel, n_parameters, _all_derivatives(n_parameters))
    header += _SMALL_FITS.format(n_parameters=n_parameters)
    # The values, the part without amplitudes, and as many amplitudes as models have.
    kept, sums = _kept_pieces(kernel, n_parameters), _dispatch(2, 3, 4)
    sums += f"\nKEPT = {split(kernel).n}\n"
    return _compiled_record(TexelLoops, kernel, "_texels", header, *kept, sums, texels_around)


@cache
def small_fits(n_parameters: int) -> ModuleType:
    """The compiled functions of `gonio.kernels.small_fits` for this number of parameters."""
    header = f"from numba import njit\n\nn_p = {n_parameters}\n" + _dispatch(1 + n_parameters)
    text = module_text(header, small_fits_of)
    sums = Path(__file__).with_name("sums.py").read_text(encoding="utf-8")
    return generated_module("gonio_small_fits", text, [*_versions(), sums])


@cache
def single_loops_for(kernel: Callable[..., Any], n_parameters: int) -> PairLoops:
    """`loops_for` float32 directions and results; parameters stay float64.

    A kernel that single precision would ruin (`gonio.kernels.single.DOUBLE`), or whose source
    cannot be read, is computed in double by these loops, and rounded.
    """
    if isinstance(kernel, ArrayKernel):
        return PairLoops(loops_of(kernel).evaluate, loops_of(kernel).evaluate_gradient)
    if any(must_be_double(f) or definition(f) is None for f in reached(kernel)):
        return _compiled_record(PairLoops, kernel, "", *_double(kernel, n_parameters))
    stores = _all_derivatives(n_parameters, "_float32(0.0)")
    header = _header(kernel, n_parameters, stores, single=True)
    functions = read(pairs_around).functions
    converted = [
        "\n\n" + DECORATOR + text_in_single(functions[name], (name,))
        for name in PairLoops.__dataclass_fields__
    ]
    return _compiled_record(PairLoops, kernel, "_single", header, *converted)


def _double(kernel: Callable[..., Any], n_parameters: int) -> list[Piece]:
    """The pieces of the file that holds the loops in double precision."""
    header = _header(kernel, n_parameters, _all_derivatives(n_parameters))
    # All columns of a fit, or those of up to two amplitudes.
    sums = _dispatch(2, 3, 1 + n_parameters)
    return [header, *_kept_pieces(kernel, n_parameters), sums, pairs_around, loops_around]


def _compiled_record(
    record: type[Record], kernel: Callable[..., Any], suffix: str, *pieces: Piece
) -> Record:
    """The record of the compiled functions that these pieces define around a kernel."""
    source = plain(kernel)
    texts = [
        path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("*.py"))
    ]
    read_in, complete = ingredients(reached(source))
    compiling.watch()
    module = generated_module(
        (source.__module__ or "kernel").replace(".", "_") + suffix,
        module_text(*pieces),
        [*_versions(), *texts, *read_in],
        bound={"source": source},
        kept=complete,
    )
    fields = getattr(record, "__dataclass_fields__")  # noqa: B009
    found = {name: getattr(module, name) for name in fields}
    outside = [f for f in reached(source) if not f.__module__.startswith(OWN)]
    if outside:
        found |= {name: guarded(f, outside[0]) for name, f in found.items() if callable(f)}
    return record(**found)


def _versions() -> list[str]:
    """Versions and hardware on which machine code depends besides its source."""
    import numba

    return [numba.__version__, sys.version]


def _dispatch(*sizes: int) -> str:
    """An `add_products` for blocks with these numbers of rows."""
    from gonio.kernels.sums import dispatch

    return dispatch(sizes)


def _kept_pieces(kernel: Callable[..., Any], n_parameters: int) -> tuple[Piece, Piece]:
    """The two parts of a kernel, and the loops over the results of the first one."""
    n = split(kernel).n
    arguments = [f"rows[{k}, k]" for k in range(n)] + [f"q[{j}]" for j in range(n_parameters)]
    stores = "\n".join(f"    rows[{k}, k] = kept[{k}]" for k in range(n))
    return _PARTS.format(n=n, stores=stores, arguments=", ".join(arguments)), kept_around


def _all_derivatives(n_parameters: int, zero: str = "0.0") -> list[str]:
    """The lines of `store` that keep the derivative by every parameter."""
    return [
        f"    gradient[{j}, k] = both[{j + 1}] if above else {zero}" for j in range(n_parameters)
    ]


def _header(
    kernel: Callable[..., Any], n_parameters: int, stores: Iterable[str], *, single: bool = False
) -> str:
    """The names that bind the loops to one kernel; `stores` are lines that keep derivatives."""
    real = "_float32" if single else "np.float64"
    return _HEADER.format(
        name=f"{kernel.__module__}.{kernel.__name__}",
        single=single,
        directions=", ".join(f"{real}({name})" for name in _DIRECTIONS),
        arguments="".join(f", q[{j}]" for j in range(n_parameters)),
        stores="\n".join(stores),
        scalars=", ".join(f"{real}(p[{j}])" for j in range(n_parameters)),
    )
