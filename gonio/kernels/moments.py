"""Loops that give chi-squared for all values of the amplitudes at once.

f is linear in a model's amplitudes a (`Parameter.linear`), so that with d = a - a_ref

    chi2(a) = c - 2 g.d + d.H d,   c = sum W r^2,  g_j = sum W r f_j,  H_jk = sum W f_j f_k

where r = y - f at the amplitudes a_ref and f_j = df/da_j. `moments_around` is a template
(`gonio.kernels.template`) as `loops_around` is; only the derivatives by the amplitudes are
stored, and the compiler drops the others.

A row of the result holds c, g_1 .. g_L, and the upper triangle of H row by row.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

BLOCK = 256


@dataclass(frozen=True)
class MomentLoops:
    """The loops of one model and its amplitudes, see `moments_around`."""

    moments: Callable[..., None]
    factored_moments: Callable[..., None]
    cell_moments: Callable[..., None]


def moments_around(
    unpack: Callable[..., Any],
    evaluate_gradient: Callable[..., Any],
    n_amplitudes: int,
    n_kept: int,
    keep_geometry: Callable[..., Any],
    kept_gradient: Callable[..., Any],
    add_products: Callable[..., Any],
) -> MomentLoops:
    """The loops around one model.

    Parameters
    ----------
    n_amplitudes : int
        Number of amplitudes, whose derivatives `evaluate_gradient` and `kept_gradient` give.
    unpack, evaluate_gradient, n_kept, keep_geometry, kept_gradient, add_products
        As for `gonio.kernels.loops.loops_around`.
    """

    def _upper(square, out):
        """The sums row by row: those of the residuals with each column, then of the next column."""
        m = 0
        for a in range(square.shape[0]):
            for b in range(a, square.shape[0]):
                out[m] = square[b, a]
                m += 1

    def moments(components, value, weight, batch, out):
        """Sums for each parameter vector of a batch, one direction a sample.

        components (6, n): x, y, z of the directions of incidence, then of reflection; weight:
        inverse variances; batch (B, P): parameter vectors with the amplitudes a_ref; out (B, sums).
        A block of samples stays in the first cache for all vectors.
        """
        factored_moments(components, None, None, None, value, weight, batch, out)

    def factored_moments(components, factor, steps, linear, value, weight, batch, out):
        """`moments` of samples with cells, over which each part of f is integrated by a factor.

        factor (1 + amplitudes, 1 + others, n): factor[0] for the part of f without the
        amplitudes, factor[1 + j] for f_j; the value of each and its slopes by the other parameters,
        whose steps (B, others) each vector brings. `linear` holds the numbers of the amplitudes.
        Without a factor, f is taken as it is; the compiler then drops what the factor does.
        """
        n_a = n_amplitudes
        columns, work = np.empty((1 + n_a, BLOCK)), np.empty(BLOCK)
        rows, squares = np.arange(1 + n_a), np.zeros((batch.shape[0], 1 + n_a, 1 + n_a))
        f, df = columns[0], columns[1:]
        kept, lit = np.empty((n_kept, BLOCK)), np.empty(BLOCK)
        scale = np.empty(BLOCK)
        for start in range(0, value.shape[0], BLOCK):
            stop = min(start + BLOCK, value.shape[0])
            n = stop - start
            all_lit = keep_geometry(components, start, stop, kept, lit)
            for b in range(batch.shape[0]):
                kept_gradient(kept, lit, all_lit, unpack(batch[b]), f[:n], df)
                if factor is not None:
                    for j in range(n_a):
                        a = batch[b, linear[j]]
                        for t in range(n):
                            f[t] -= a * df[j, t]
                    for j in range(n_a + 1):
                        for t in range(n):
                            scale[t] = factor[j, 0, start + t]
                        for i in range(steps.shape[1]):
                            step = steps[b, i]
                            for t in range(n):
                                scale[t] += factor[j, 1 + i, start + t] * step
                        if j == 0:
                            for t in range(n):
                                f[t] *= scale[t]
                        else:
                            a = batch[b, linear[j - 1]]
                            for t in range(n):
                                df[j - 1, t] *= scale[t]
                                f[t] += a * df[j - 1, t]
                for t in range(n):
                    f[t] = value[start + t] - f[t]
                add_products(columns, rows, weight[start:stop], work, squares[b])
        for b in range(batch.shape[0]):
            _upper(squares[b], out[b])

    def cell_moments(w_i, w_r, share, offsets, first, value, weight, batch, out):
        """`moments` with f integrated over every member of the cells, as `cell_gradient` does.

        value and weight begin with the sample `first`.
        """
        n_a = n_amplitudes
        s = np.empty((6, BLOCK))
        f = np.empty(BLOCK)
        df = np.empty((n_a, BLOCK))
        columns, work = np.empty((1 + n_a, BLOCK)), np.empty(BLOCK)
        rows, square = np.arange(1 + n_a), np.empty((1 + n_a, 1 + n_a))
        r, dr = columns[0], columns[1:]
        owner = np.empty(BLOCK, np.int64)
        part = np.empty(BLOCK)
        for b in range(batch.shape[0]):
            square[:] = 0.0
            for start in range(0, value.shape[0], BLOCK):
                stop = min(start + BLOCK, value.shape[0])
                for t in range(stop - start):
                    r[t] = value[start + t]
                dr[:, :] = 0.0
                m = 0
                for t in range(stop - start):
                    sample = first + start + t
                    for k in range(offsets[sample], offsets[sample + 1]):
                        s[0, m], s[1, m], s[2, m] = w_i[sample, 0], w_i[sample, 1], w_i[sample, 2]
                        s[3, m], s[4, m], s[5, m] = w_r[k, 0], w_r[k, 1], w_r[k, 2]
                        owner[m], part[m] = t, share[k]
                        m += 1
                        if m == BLOCK:
                            _gather(s, batch[b], f, df, owner, part, m, r, dr)
                            m = 0
                _gather(s, batch[b], f, df, owner, part, m, r, dr)
                add_products(columns, rows, weight[start:stop], work, square)
            _upper(square, out[b])

    def _gather(s, p, f, df, owner, part, m, r, dr):
        """Evaluate m members; take f from the residuals of their samples, add its derivatives."""
        evaluate_gradient(s[0], s[1], s[2], s[3], s[4], s[5], p, f[:m], df)
        for k in range(m):
            r[owner[k]] -= part[k] * f[k]
            for j in range(df.shape[0]):
                dr[j, owner[k]] += part[k] * df[j, k]

    return MomentLoops(
        moments=moments,
        factored_moments=factored_moments,
        cell_moments=cell_moments,
    )
