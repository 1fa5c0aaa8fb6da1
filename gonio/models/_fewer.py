"""A kernel of fewer parameters: some arguments of another kernel are constants or equal.

It is written to a file like the loops around it (docs/adr/0004): numba keeps machine code only for
functions that live in one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from gonio.geometry import FloatArray
from gonio.kernels.arrays import ArrayKernel
from gonio.kernels.generated import generated_module
from gonio.kernels.sources import ingredients, reached

_DIRECTIONS = "xi, yi, zi, xr, yr, zr"
_TEXT = '''# Written by gonio.models._fewer; safe to delete.
"""A model with some of its parameters fixed or tied."""
# Handed in by gonio.models._fewer: whole, the kernel of all parameters.


def kernel({directions}, {unknowns}):
    """f and its derivative by every unknown."""
    f = whole({directions}, {arguments})
    return (
        f[0],
        {derivatives},
    )
'''


@cache
def fewer_parameters(
    kernel: Callable[..., Any], source: tuple[int, ...], values: tuple[float, ...]
) -> Callable[..., Any]:
    """The kernel of the unknowns that fill the arguments of a kernel.

    Parameters
    ----------
    kernel : callable
        As `gonio.kernels.loops_for` takes it.
    source : tuple of int
        For each parameter of the kernel the index of its unknown; -1 where it is fixed. Every
        unknown from 0 on occurs.
    values : tuple of float
        What parameters are fixed to; not read elsewhere.

    Returns
    -------
    callable
        The derivative by an unknown is the sum of those by the parameters that it fills.

    Examples
    --------
    >>> from gonio.models import get
    >>> ward = get("ward").kernel
    >>> tied = fewer_parameters(ward, (-1, 0, 1, 1), (0.2, 0.0, 0.0, 0.0))
    >>> up = (0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
    >>> f, whole = tied(*up, 0.1, 0.3), ward(*up, 0.2, 0.1, 0.3, 0.3)
    >>> f == (whole[0], whole[2], whole[3] + whole[4])
    True
    """
    if isinstance(kernel, ArrayKernel):
        return _of_arrays(kernel, np.array(source), np.array(values))
    read, kept = ingredients(reached(kernel))
    text = _text(source, values)
    module = generated_module("fewer", text, read, bound={"whole": kernel}, kept=kept)
    fewer: Callable[..., Any] = module.kernel
    return fewer


def _text(source: tuple[int, ...], values: tuple[float, ...]) -> str:
    """Source of the module that holds the kernel."""
    arguments = [f"p_{j}" if j >= 0 else repr(v) for j, v in zip(source, values, strict=True)]
    filled = [[k for k, j in enumerate(source, 1) if j == i] for i in range(max(source) + 1)]
    return _TEXT.format(
        directions=_DIRECTIONS,
        unknowns=", ".join(f"p_{j}" for j in range(len(filled))),
        arguments=", ".join(arguments),
        derivatives=", ".join(" + ".join(f"f[{k}]" for k in own) for own in filled),
    )


def _of_arrays(kernel: ArrayKernel, source: np.ndarray, values: FloatArray) -> ArrayKernel:
    """The same for a kernel of whole arrays."""
    free = source >= 0
    adds = np.zeros((len(source), int(source.max()) + 1))
    adds[free, source[free]] = 1.0

    def arguments(p: FloatArray) -> FloatArray:
        return np.where(free, p[source], values)

    def f(w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> FloatArray:
        return kernel.values(w_i, w_r, arguments(p))

    def gradient(w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, jac = kernel.gradient(w_i, w_r, arguments(p))
        return value, jac @ adds

    return ArrayKernel(kernel.function, f, gradient, adds.shape[1], kernel.note)
