"""Pairs of directions as the compiled loops take them: six flat rows of components."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError


def components(
    w_i: NDArray[Any], w_r: NDArray[Any]
) -> tuple[tuple[NDArray[Any], ...], tuple[int, ...]]:
    """The six components as flat contiguous arrays, and the common shape of the pairs.

    They are float32 where all directions are, else float64, and read-only: numba compiles loops
    anew for arrays that may be written and arrays that may not.
    """
    w_i, w_r = np.asarray(w_i), np.asarray(w_r)
    real = np.float32 if w_i.dtype == w_r.dtype == np.float32 else np.float64
    w_i, w_r = np.broadcast_arrays(w_i.astype(real, copy=False), w_r.astype(real, copy=False))
    parts = tuple(
        np.ascontiguousarray(w[..., axis]).reshape(-1) for w in (w_i, w_r) for axis in range(3)
    )
    for part in parts:
        part.flags.writeable = False
    return parts, w_i.shape[:-1]


def check_out(out: NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse an array that f cannot be written to."""
    given = f"an array of {out.dtype} and shape {out.shape}"
    flaw = ""
    if out.shape != shape or out.dtype != dtype:
        flaw = f"out is {given}"
    elif not out.flags.c_contiguous:
        flaw = f"out is {given} that is not C-contiguous"
    elif not out.flags.writeable:
        flaw = f"out is {given} that is read-only"
    if flaw:
        raise ConfigurationError(
            f"{flaw}; for these directions it must be np.empty({shape}, np.{dtype}), or be left "
            "out.",
            value=out,
        )
