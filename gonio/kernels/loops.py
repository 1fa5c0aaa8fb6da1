"""The loops that are compiled around each model's scalar kernel.

`loops_around` is a template (`gonio.kernels.template`): `gonio.kernels.build` writes its inner
functions behind the names that bind them to one model. All loops release the GIL, write to slices
of their outputs and keep no state: threads may run them on disjoint slices, and the result does not
depend on how many do.

The compiler turns the inner loops into SIMD code. For that they run over contiguous components
(x of all directions, then y, then z), by way of a block that fits the first cache where the caller
has vectors, and they hold no branch: a pair at or below the horizon is evaluated at z = 1 and its
value replaced by 0.

Directions are unit vectors in the frame of the sample, i towards the light and r towards the
viewer; `p` is the parameter vector; f is in sr^-1. All is float64; `evaluate` and
`evaluate_gradient` are also made for directions and results in float32.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

BLOCK = 256


@dataclass(frozen=True)
class Loops:
    """The loops of one model; `loops_around` describes each."""

    evaluate: Callable[..., None]
    evaluate_gradient: Callable[..., None]
    cell_values: Callable[..., None]
    cell_gradient: Callable[..., None]
    normal_equations: Callable[..., None]
    cell_normal_equations: Callable[..., None]
    sums_of_squares: Callable[..., None]
    batch_chi2: Callable[..., None]
    image: Callable[..., None]


def loops_around(
    unpack: Callable[..., Any],
    call: Callable[..., Any],
    evaluate: Callable[..., Any],
    evaluate_gradient: Callable[..., Any],
    n_kept: int,
    keep_geometry: Callable[..., Any],
    kept_gradient: Callable[..., Any],
    add_products: Callable[..., Any],
    mirror: Callable[..., Any],
    sum_of_squares: Callable[..., Any],
) -> Loops:
    """The loops around one model.

    Parameters
    ----------
    unpack, call : callable
        As for `gonio.kernels.pairs.pairs_around`.
    evaluate, evaluate_gradient : callable
        Those of `gonio.kernels.pairs`.
    n_kept, keep_geometry, kept_gradient : int, callable, callable
        Repeated evaluation at the same directions, see `gonio.kernels.kept`.
    add_products, mirror, sum_of_squares : callable
        Those of `gonio.kernels.sums`.
    """

    def _values(s, n, q):
        """f of the n pairs whose components stand in s[0] to s[5], into s[6]."""
        for k in range(n):
            above = s[2, k] > 0.0 and s[5, k] > 0.0
            a = s[2, k] if above else 1.0
            b = s[5, k] if above else 1.0
            f = call(s[0, k], s[1, k], a, s[3, k], s[4, k], b, q)[0]
            s[6, k] = f if above else 0.0

    def cell_values(w_i, w_r, weight, offsets, first, p, out):
        """f integrated over cells; sample `first + k` owns members offsets[k] to offsets[k + 1]."""
        q = unpack(p)
        s = np.empty((7, BLOCK))
        owner = np.empty(BLOCK, np.int64)
        share = np.empty(BLOCK)
        n = 0
        for k in range(out.shape[0]):
            out[k] = 0.0
            sample = first + k
            for m in range(offsets[sample], offsets[sample + 1]):
                s[0, n], s[1, n], s[2, n] = w_i[sample, 0], w_i[sample, 1], w_i[sample, 2]
                s[3, n], s[4, n], s[5, n] = w_r[m, 0], w_r[m, 1], w_r[m, 2]
                owner[n], share[n] = k, weight[m]
                n += 1
                if n == BLOCK:
                    _add_values(s, q, owner, share, n, out)
                    n = 0
        _add_values(s, q, owner, share, n, out)

    def _add_values(s, q, owner, share, n, out):
        """Evaluate n members and add them to their samples."""
        _values(s, n, q)
        for t in range(n):
            out[owner[t]] += share[t] * s[6, t]

    def cell_gradient(w_i, w_r, weight, offsets, first, p, out, gradient):
        """`cell_values` and the derivative by every parameter (n, parameters), in one pass."""
        s = np.empty((6, BLOCK))
        f = np.empty(BLOCK)
        df = np.empty((gradient.shape[1], BLOCK))
        owner = np.empty(BLOCK, np.int64)
        share = np.empty(BLOCK)
        n = 0
        for k in range(out.shape[0]):
            out[k] = 0.0
            gradient[k, :] = 0.0
            sample = first + k
            for m in range(offsets[sample], offsets[sample + 1]):
                s[0, n], s[1, n], s[2, n] = w_i[sample, 0], w_i[sample, 1], w_i[sample, 2]
                s[3, n], s[4, n], s[5, n] = w_r[m, 0], w_r[m, 1], w_r[m, 2]
                owner[n], share[n] = k, weight[m]
                n += 1
                if n == BLOCK:
                    _add_gradient(s, p, f, df, owner, share, n, out, gradient)
                    n = 0
        _add_gradient(s, p, f, df, owner, share, n, out, gradient)

    def _add_gradient(s, p, f, df, owner, share, n, out, gradient):
        """Evaluate n members and add them to their samples."""
        evaluate_gradient(s[0], s[1], s[2], s[3], s[4], s[5], p, f[:n], df)
        for t in range(n):
            k = owner[t]
            out[k] += share[t] * f[t]
            for j in range(gradient.shape[1]):
                gradient[k, j] += share[t] * df[j, t]

    def normal_equations(s, value, inverse_variance, points, rows, first, last, out):
        """Weighted products of residuals and derivatives, summed over the samples first to last.

        out[b] holds the products of the columns [value - f, df/dp_1, ...] at the parameters
        points[b]; `rows` chooses among the columns, 0 being the residual. s holds the six
        components (6, N). A block of samples stays in the first cache for all points.
        """
        columns = np.empty((points.shape[1] + 1, BLOCK))
        kept, lit, work = np.empty((n_kept, BLOCK)), np.empty(BLOCK), np.empty(BLOCK)
        out[:] = 0.0
        for a in range(first, last, BLOCK):
            e = min(a + BLOCK, last)
            f, slopes = columns[0, : e - a], columns[1:]
            all_lit = keep_geometry(s, a, e, kept, lit)
            for b in range(points.shape[0]):
                kept_gradient(kept, lit, all_lit, unpack(points[b]), f, slopes)
                for t in range(e - a):
                    f[t] = value[a + t] - f[t]
                add_products(columns, rows, inverse_variance[a:e], work, out[b])
        mirror(out)

    def cell_normal_equations(
        w_i, w_r, weight, offsets, value, inverse_variance, p, rows, first, last, out
    ):
        """`normal_equations` at one point of samples that are cells."""
        n_p = p.shape[0]
        f = np.empty(BLOCK)
        gradient = np.empty((BLOCK, n_p))
        columns = np.empty((n_p + 1, BLOCK))
        work = np.empty(BLOCK)
        out[:] = 0.0
        for a in range(first, last, BLOCK):
            n = min(BLOCK, last - a)
            cell_gradient(w_i, w_r, weight, offsets, a, p, f[:n], gradient[:n])
            for t in range(n):
                columns[0, t] = value[a + t] - f[t]
                for j in range(n_p):
                    columns[j + 1, t] = gradient[t, j]
            add_products(columns, rows, inverse_variance[a : a + n], work, out[0])
        mirror(out)

    def sums_of_squares(s, value, inverse_variance, points, first, last, out):
        """chi-squared of the samples first to last for each parameter vector of `points`."""
        f = np.empty(BLOCK)
        out[:] = 0.0
        for a in range(first, last, BLOCK):
            e = min(a + BLOCK, last)
            xi, yi, zi = s[0, a:e], s[1, a:e], s[2, a:e]
            xr, yr, zr = s[3, a:e], s[4, a:e], s[5, a:e]
            for b in range(points.shape[0]):
                evaluate(xi, yi, zi, xr, yr, zr, points[b], f[: e - a])
                out[b] += sum_of_squares(value[a:e], f[: e - a], inverse_variance[a:e])

    def batch_chi2(w_i, w_r, factor, mode, value, inverse_variance, batch, out):
        """Sum of squared weighted residuals for each parameter vector of a batch.

        One direction a sample; factor[k, 0] + factor[k, 1:] (p - mode) turns f there into f
        integrated over the sample's cell.
        """
        out[:] = 0.0
        n_p = mode.shape[0]
        s = np.empty((7, BLOCK))
        columns = np.empty((n_p + 1, BLOCK))
        terms = np.empty(BLOCK)
        for start in range(0, value.shape[0], BLOCK):
            n = min(BLOCK, value.shape[0] - start)
            for t in range(n):
                k = start + t
                s[0, t], s[1, t], s[2, t] = w_i[k, 0], w_i[k, 1], w_i[k, 2]
                s[3, t], s[4, t], s[5, t] = w_r[k, 0], w_r[k, 1], w_r[k, 2]
                for j in range(n_p + 1):
                    columns[j, t] = factor[k, j]
            for b in range(batch.shape[0]):
                _values(s, n, unpack(batch[b]))
                for t in range(n):
                    terms[t] = columns[0, t]
                for j in range(n_p):
                    step = batch[b, j] - mode[j]
                    for t in range(n):
                        terms[t] += columns[j + 1, t] * step
                for t in range(n):
                    r = value[start + t] - terms[t] * s[6, t]
                    terms[t] = r * r * inverse_variance[start + t]
                for t in range(n):
                    out[b] += terms[t]

    def image(w_i, w_r, ray_weight, p, out):
        """f averaged over the rays of each pixel.

        Ray k of every pixel pairs the incident direction w_i[k] (a point of the lamp) with its own
        traced direction w_r[pixel, k]; `ray_weight` is 0 where the ray misses the lit sample.
        """
        q = unpack(p)
        rays = w_i.shape[0]
        s = np.empty((7, rays))
        for k in range(rays):
            s[0, k], s[1, k], s[2, k] = w_i[k, 0], w_i[k, 1], w_i[k, 2]
        for pixel in range(out.shape[0]):
            for k in range(rays):
                s[3, k], s[4, k], s[5, k] = w_r[pixel, k, 0], w_r[pixel, k, 1], w_r[pixel, k, 2]
            _values(s, rays, q)
            total = 0.0
            for k in range(rays):
                total += ray_weight[pixel, k] * s[6, k]
            out[pixel] = total

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
