"""The loop that fits one small data set after another: a texel of a map of materials each.

`gonio.kernels.build` compiles this text around a model's kernel as it does `loops.py`. The
amplitudes (`Parameter.linear`) are solved for on a grid of the other parameters; from the best
point of the grid damped Gauss-Newton steps go down inside the bounds, by
`gonio.kernels.small_fits`. Everything that a texel needs stands in arrays that are made once a
call, and each texel is fitted alone: the result does not depend on its neighbours or on the number
of threads.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

import numpy as np

from gonio.kernels import small_fits
from gonio.kernels.loops import call, store, unpack

# HEADER ENDS

FOLLOWED = 3  # points of the grid that are followed where the best leads to a bound or nowhere


def fit_texels(
    w, weight, values, grid, basis, products, linear, lower, upper, log, known_noise,
    p_out, stderr, chi2_out, status, known, bound, used,
):  # fmt: skip
    """Fit every texel; row t of each output belongs to texel t.

    w (1 or T, 6, N): components of the directions; weight (1 or T, N): inverse variances, 0 for
    a sample that is left out; values (T, N); grid (M, P): points to start from, with the
    amplitudes at any value; basis (M, 1 + amplitudes, N) and products: what `grid_basis` makes of
    them where the directions are those of all texels, empty otherwise; linear: numbers of the
    amplitudes; status 0 converged, 1 not, 2 no data; bound -1, 0 or 1.
    """
    n_p, n, n_b = lower.shape[0], values.shape[1], 1 + linear.shape[0]
    common = basis.shape[0] > 0
    own = basis if common else np.empty((grid.shape[0], n_b, n))
    pairs = products if common else np.empty((grid.shape[0], n_b * (n_b + 1) // 2, n))
    sums, right = np.empty(pairs.shape[:2]), np.empty(own.shape[:2])
    whole = -1  # samples that `sums` hold where none with a weight is missing
    first = 1 if common else 0  # of the parts of f: the one without amplitudes may be nothing
    for m in range(basis.shape[0]):
        for k in range(n):
            if basis[m, 0, k] != 0.0:
                first = 0
    f, y, iv, wy, work = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    jac = np.empty((n_p, n))
    score, starts = np.empty(grid.shape[0]), np.empty(grid.shape)
    p, trial, best, step = np.empty(n_p), np.empty(n_p), np.empty(n_p), np.empty(n_p)
    g, g_new, h, h_new = np.empty(n_p), np.empty(n_p), np.empty((n_p, n_p)), np.empty((n_p, n_p))
    root, h_best = np.empty((n_p, n_p)), np.empty((n_p, n_p))
    free, state = np.empty(n_p, np.bool_), np.zeros(8)
    for t in range(values.shape[0]):
        x = w[t if w.shape[0] > 1 else 0]
        row = weight[t if weight.shape[0] > 1 else 0]
        count, left_out = small_fits.prepare(x, row, values[t], y, iv, wy, state)
        used[t] = count
        chi2_out[t] = np.nan
        for j in range(n_p):
            p_out[t, j] = stderr[t, j] = best[j] = np.nan
            known[t, j], bound[t, j] = False, 0
        if count <= n_p:
            status[t] = 2
            continue
        if not common:
            grid_basis(x, grid, linear, f, jac, own, pairs)
        # The same samples with the same weights: the same sums.
        if not (common and weight.shape[0] == 1 and count == whole):
            small_fits.weighted_sums(pairs, iv, 0, sums)
            whole = count if left_out == 0 else -1
        small_fits.weighted_sums(own, wy, first, right)
        small_fits.amplitudes(
            grid, sums, right, linear, lower, upper, starts, score, g, step, state
        )
        for _ in range(FOLLOWED):
            if not small_fits.start(score, starts, trial, state):
                break
            found = 0
            while found == 0:
                _gradient(x, trial, f, jac)
                found = small_fits.advance(
                    y, iv, f, jac, work, lower, upper, log, p, trial, g, h, g_new, h_new, step,
                    root, free, state,
                )  # fmt: skip
            if small_fits.keep(found, p, h, lower, upper, best, h_best, state):
                break
        status[t] = 0 if state[small_fits.VERIFIED] > 0.0 else 1
        if not np.isfinite(state[small_fits.BEST]):
            continue
        chi2_out[t] = state[small_fits.BEST]
        small_fits.judge(
            best, h_best, lower, upper, log, known_noise, free, root, step, state, stderr[t],
            known[t], bound[t],
        )  # fmt: skip
        for i in range(linear.shape[0]):
            if small_fits.may_be_none(linear[i], best, lower, stderr[t], bound[t], trial):
                # The lobe may as well not be there; what shapes it would then mean nothing.
                _gradient(x, trial, f, jac)
                small_fits.forget(iv, jac, known[t])
        for j in range(n_p):
            p_out[t, j] = best[j]
            if not known[t, j]:
                stderr[t, j] = np.nan


def grid_basis(x, grid, linear, f, jac, basis, products):
    """What f is made of at every point of the grid: `gonio.kernels.small_fits.split_basis`."""
    for m in range(grid.shape[0]):
        _gradient(x, grid[m], f, jac)
        small_fits.split_basis(m, grid, linear, f, jac, basis, products)


def _gradient(x, p, f, jac):
    """f, and its derivative by every parameter (P, N)."""
    q = unpack(p)
    for k in range(f.shape[0]):
        above = x[2, k] > 0.0 and x[5, k] > 0.0
        a = x[2, k] if above else 1.0
        b = x[5, k] if above else 1.0
        both = call(x[0, k], x[1, k], a, x[3, k], x[4, k], b, q)
        f[k] = both[0] if above else 0.0
        store(both, above, jac, k)
