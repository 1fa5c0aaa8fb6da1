"""Compile a scalar function of Python and `math` with all functions that it calls."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import CellType, FunctionType
from typing import Any

from gonio.kernels.single import in_single
from gonio.kernels.sources import bound_names, is_python, plain


def compiled(function: Callable[..., Any], *, single: bool = False) -> Callable[..., Any]:
    """`function` compiled by numba together with the plain functions that it calls by name.

    With `single` their constants are float32, and so are their results of float32 arguments.
    """
    from numba import njit

    source = plain(function)
    if hasattr(source, "compiled_twin"):
        # A function that differs between Python and machine code has its own compiled form.
        machine_form: Callable[..., Any] = source.compiled_twin()
        return machine_form
    if single:
        source = in_single(plain(getattr(source, "single_twin", source)))
    called = {
        name: compiled(callee, single=single)
        for name, callee in bound_names(source).items()
        if is_python(callee)
    }
    names = {**source.__globals__, **called}
    # numba finds cached code by the name of a module that another process can import.
    home = source.__module__
    if home == "__main__" or home not in sys.modules:
        names["__name__"] = __name__
    cells = zip(source.__code__.co_freevars, source.__closure__ or (), strict=True)
    closure = tuple(CellType(called[n]) if n in called else cell for n, cell in cells)
    twin = FunctionType(
        source.__code__, names, source.__name__, source.__defaults__, closure or None
    )
    result: Callable[..., Any] = njit(error_model="numpy", forceinline=True)(twin)
    return result
