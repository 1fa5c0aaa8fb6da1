"""The loops around a kernel that is a function of whole arrays, without numba.

`loops_of` and its companions give the records that `gonio.kernels.build` compiles, with the same
arguments, so that evaluation and fits do not depend on the kind of kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.kernels.loops import Loops
from gonio.kernels.moments import MomentLoops
from gonio.kernels.texels import TexelLoops, texels_around

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class ArrayKernel:
    """A kernel of whole arrays.

    Parameters
    ----------
    function : callable
        The user's function; its source is the model's source.
    values : callable
        `values(w_i, w_r, p)`: f (n,) of pairs of unit vectors (n, 3) above the horizon.
    gradient : callable
        `gradient(w_i, w_r, p)`: f (n,) and its derivatives (n, parameters).
    n_parameters : int
    note : str
        Remark that a fit states.
    """

    function: Callable[..., Any]
    values: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
    gradient: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
    n_parameters: int
    note: str = ""

    def __call__(self, *arguments: float) -> tuple[float, ...]:
        """(f, df/dp_1, ...) for six direction cosines and the parameters."""
        w_i, w_r = np.array([arguments[:3]], float), np.array([arguments[3:6]], float)
        f, jac = self.gradient(w_i, w_r, np.array(arguments[6:], float))
        return float(f[0]), *jac[0].tolist()

    def lit_values(self, w_i: Array, w_r: Array, p: Array) -> FloatArray:
        """f (n,) of any pairs (n, 3), 0 at and below the horizon."""
        lit = (w_i[:, 2] > 0) & (w_r[:, 2] > 0)
        out = np.zeros(len(lit))
        if lit.any():
            out[lit] = self.values(_real(w_i[lit]), _real(w_r[lit]), _real(p))
        return out

    def lit_gradient(self, w_i: Array, w_r: Array, p: Array) -> tuple[FloatArray, FloatArray]:
        """f (n,) and its derivatives (n, parameters) of any pairs (n, 3)."""
        lit = (w_i[:, 2] > 0) & (w_r[:, 2] > 0)
        out, jac = np.zeros(len(lit)), np.zeros((len(lit), self.n_parameters))
        if lit.any():
            out[lit], jac[lit] = self.gradient(_real(w_i[lit]), _real(w_r[lit]), _real(p))
        return out, jac


def _real(array: Array) -> FloatArray:
    return np.asarray(array, float)


def loops_of(kernel: ArrayKernel) -> Loops:
    """The loops of `gonio.kernels.loops` by whole arrays."""

    def evaluate(*arguments: Array) -> None:
        *components, p, out = arguments
        out[:] = kernel.lit_values(_stacked(*components[:3]), _stacked(*components[3:]), p)

    def evaluate_gradient(*arguments: Array) -> None:
        *components, p, out, gradient = arguments
        w_i, w_r = _stacked(*components[:3]), _stacked(*components[3:])
        out[:], jac = kernel.lit_gradient(w_i, w_r, p)
        gradient[:] = jac.T

    def cell_values(
        w_i: Array, w_r: Array, weight: Array, offsets: Array, first: int, p: Array, out: Array
    ) -> None:
        cells = _Cells(w_i, w_r, weight, offsets, first, first + len(out))
        out[:] = cells.summed(kernel.lit_values(cells.w_i, cells.w_r, p))

    def cell_gradient(
        w_i: Array, w_r: Array, weight: Array, offsets: Array, first: int, p: Array, out: Array,
        gradient: Array,
    ) -> None:  # fmt: skip
        cells = _Cells(w_i, w_r, weight, offsets, first, first + len(out))
        out[:], gradient[:] = cells.gradient(kernel, p)

    def normal_equations(
        s: Array, value: Array, inverse_variance: Array, points: Array, rows: Array, first: int,
        last: int, out: Array,
    ) -> None:  # fmt: skip
        for b, p in enumerate(points):
            f, jac = kernel.lit_gradient(*_vectors(s[:, first:last]), p)
            columns = np.column_stack([value[first:last] - f, jac])[:, rows]
            out[b] = _products(columns, inverse_variance[first:last])

    def cell_normal_equations(
        w_i: Array, w_r: Array, weight: Array, offsets: Array, value: Array,
        inverse_variance: Array, p: Array, rows: Array, first: int, last: int, out: Array,
    ) -> None:  # fmt: skip
        cells = _Cells(w_i, w_r, weight, offsets, first, last)
        f, jac = cells.gradient(kernel, p)
        columns = np.column_stack([value[first:last] - f, jac])[:, rows]
        out[0] = _products(columns, inverse_variance[first:last])

    def sums_of_squares(
        s: Array, value: Array, inverse_variance: Array, points: Array, first: int, last: int,
        out: Array,
    ) -> None:  # fmt: skip
        for b, p in enumerate(points):
            r = value[first:last] - kernel.lit_values(*_vectors(s[:, first:last]), p)
            out[b] = inverse_variance[first:last] @ r**2

    def batch_chi2(
        w_i: Array, w_r: Array, factor: Array, mode: Array, value: Array,
        inverse_variance: Array, batch: Array, out: Array,
    ) -> None:  # fmt: skip
        for b, p in enumerate(batch):
            scale = factor[:, 0] + factor[:, 1:] @ (p - mode)
            r = value - scale * kernel.lit_values(w_i, w_r, p)
            out[b] = inverse_variance @ r**2

    def image(w_i: Array, w_r: Array, ray_weight: Array, p: Array, out: Array) -> None:
        lamps = np.broadcast_to(w_i, w_r.shape).reshape(-1, 3)
        f = kernel.lit_values(lamps, w_r.reshape(-1, 3), p)
        out[:] = (ray_weight * f.reshape(ray_weight.shape)).sum(axis=1)

    return Loops(
        evaluate=evaluate,
        evaluate_gradient=evaluate_gradient,
        cell_values=cell_values,
        cell_gradient=cell_gradient,
        normal_equations=normal_equations,
        cell_normal_equations=cell_normal_equations,
        sums_of_squares=sums_of_squares,
        batch_chi2=batch_chi2,
        image=image,
    )


def moment_loops_of(kernel: ArrayKernel, linear: tuple[int, ...]) -> MomentLoops:
    """The loops of `gonio.kernels.moments` by whole arrays."""
    some = list(linear)
    upper = np.triu_indices(1 + len(some))

    def sums(f: Array, df: Array, value: Array, weight: Array) -> FloatArray:
        return _products(np.column_stack([value - f, df]), weight)[upper]

    def moments(components: Array, value: Array, weight: Array, batch: Array, out: Array) -> None:
        for b, p in enumerate(batch):
            f, jac = kernel.lit_gradient(*_vectors(components), p)
            out[b] = sums(f, jac[:, some], value, weight)

    def factored_moments(
        components: Array, factor: Array, steps: Array, linear: Array, value: Array,
        weight: Array, batch: Array, out: Array,
    ) -> None:  # fmt: skip
        for b, p in enumerate(batch):
            f, jac = kernel.lit_gradient(*_vectors(components), p)
            scale = factor[:, 0] + np.einsum("jin,i->jn", factor[:, 1:], steps[b])
            rest = f - jac[:, some] @ p[linear]
            df = jac[:, some] * scale[1:].T
            out[b] = sums(rest * scale[0] + df @ p[linear], df, value, weight)

    def cell_moments(
        w_i: Array, w_r: Array, share: Array, offsets: Array, first: int, value: Array,
        weight: Array, batch: Array, out: Array,
    ) -> None:  # fmt: skip
        cells = _Cells(w_i, w_r, share, offsets, first, first + len(value))
        for b, p in enumerate(batch):
            f, jac = cells.gradient(kernel, p)
            out[b] = sums(f, jac[:, some], value, weight)

    return MomentLoops(
        moments=moments, factored_moments=factored_moments, cell_moments=cell_moments
    )


def texel_loops_of(kernel: ArrayKernel, small_fits: Any) -> TexelLoops:
    """The loops of `gonio.kernels.texels`, run by the interpreter around whole arrays.

    `small_fits` holds the compiled functions for this number of parameters.
    """
    from gonio.kernels import fastmath, sums

    def keep_geometry(s: Array, first: int, last: int, rows: Array, lit: Array) -> bool:
        rows[:] = s[:, first:last]
        above = (rows[2] > 0) & (rows[5] > 0)
        # Pairs that are not lit are evaluated along the normal and have weight 0.
        rows[:, ~above] = np.array([0.0, 0, 1, 0, 0, 1])[:, None]
        lit[:] = above
        return bool(above.all())

    def kept_gradient(
        rows: Array, lit: Array, all_lit: bool, q: Array, out: Array, gradient: Array
    ) -> None:
        out[:], jac = kernel.lit_gradient(*_vectors(rows), q)
        gradient[:] = jac.T

    return texels_around(
        unpack=lambda p: p,
        n_kept=6,
        keep_geometry=keep_geometry,
        kept_gradient=kept_gradient,
        add_products=sums.add_products,
        small_fits=small_fits,
        sincos=fastmath.sincos,
    )


class _Cells:
    """The members of the samples first to last, and their weighted sums."""

    def __init__(
        self, w_i: Array, w_r: Array, weight: Array, offsets: Array, first: int, last: int
    ) -> None:
        starts, end = offsets[first:last], offsets[last]
        members = slice(offsets[first], end)
        counts = np.diff(offsets[first : last + 1])
        self.w_i = np.repeat(w_i[first:last], counts, axis=0)
        self.w_r = w_r[members]
        self.weight = weight[members]
        self.owner = np.repeat(np.arange(len(starts)), counts)
        self.n = len(starts)

    def summed(self, f: Array) -> FloatArray:
        """The weighted sum over each sample's members of values (members, ...)."""
        out = np.zeros((self.n, *f.shape[1:]))
        np.add.at(out, self.owner, (self.weight * f.T).T)
        return out

    def gradient(self, kernel: ArrayKernel, p: Array) -> tuple[FloatArray, FloatArray]:
        """f (n,) of the samples and its derivatives (n, parameters)."""
        f, jac = kernel.lit_gradient(self.w_i, self.w_r, p)
        return self.summed(f), self.summed(jac)


def _products(columns: Array, weight: Array) -> FloatArray:
    """Weighted products of all columns (n, k) with each other."""
    return np.asarray((columns * weight[:, None]).T @ columns)


def _vectors(components: Array) -> tuple[Array, Array]:
    """Vectors (n, 3) of incidence and reflection from their components (6, n)."""
    return components[:3].T, components[3:].T


def _stacked(x: Array, y: Array, z: Array) -> FloatArray:
    return np.stack([x, y, z], axis=1).astype(float, copy=False)
