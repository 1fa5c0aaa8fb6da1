"""The loop that fits one small data set after another, each a texel of a map of materials.

`texels_around` is a template (`gonio.kernels.template`). The amplitudes (`Parameter.linear`) are
solved for on a grid of the other parameters; from the best point of the grid damped Gauss-Newton
steps go down inside the bounds, by `gonio.kernels.small_fits`. All arrays are allocated once for
each call, and each texel is fitted alone: the result does not depend on
its neighbours or on the number of threads.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.kernels.small_fits import BEST, VERIFIED

HORIZON = np.pi / 2  # exactly horizontal, which its cosine is not
FOLLOWED = 3  # points of the grid to start from where the best leads to a bound or fails


@dataclass(frozen=True)
class TexelLoops:
    """The loops around one model, see `texels_around`; KEPT numbers describe a pair."""

    KEPT: int
    fit_texels: Callable[..., None]
    directions: Callable[..., None]
    grid_basis: Callable[..., None]


def texels_around(
    unpack: Callable[..., Any],
    n_kept: int,
    keep_geometry: Callable[..., Any],
    kept_gradient: Callable[..., Any],
    add_products: Callable[..., Any],
    small_fits: Any,
    sincos: Callable[..., Any],
) -> TexelLoops:
    """The loops around one model.

    Parameters
    ----------
    small_fits : module or SmallFits
        The functions of `gonio.kernels.small_fits` for this number of parameters.
    sincos : callable
        That of `gonio.kernels.fastmath`.
    unpack, n_kept, keep_geometry, kept_gradient, add_products
        As `gonio.kernels.loops.loops_around` has them.
    """

    def fit_texels(
        geometry, angles, lit, weight, values, grid, basis, linear, lower, upper, log, noise_known,
        p_out, stderr, chi2_out, status, determined, bound, used,
    ):  # fmt: skip
        """Fit every texel; row t of each output belongs to texel t.

        geometry (n_kept, W): numbers of the directions of all texels, or work space for those of
        one; angles (0 or T, 4, N): theta_i, phi_i, theta_r, phi_r of each texel, where they differ
        between texels; lit (W,): 1 where both directions are above the horizon, else 0. weight
        (1 or T, N): inverse variances, 0 for an excluded sample; values (T, N). W is N or more, so
        that SIMD code has no remainder; elements beyond N have weight 0. grid (M, P): starting
        values, with the amplitudes at any value; basis (M, 2 + amplitudes, W): the result of
        `grid_basis` where all texels have the same directions, else work space for it; linear:
        numbers of the amplitudes; status 0 converged, 1 not, 2 no data; bound -1, 0 or 1.
        """
        n_p, width, n_grid, n_b = lower.shape[0], geometry.shape[1], grid.shape[0], basis.shape[1]
        common = angles.shape[0] == 0
        w = np.empty((6, width))
        texel_sums, square = np.empty((n_b, n_b, n_grid)), np.empty((n_b, n_b))
        y, iv, wy, work = np.zeros(width), np.zeros(width), np.zeros(width), np.empty(width)
        columns, normal = np.empty((1 + n_p, width)), np.empty((1 + n_p, 1 + n_p))
        basis_rows, rows = np.arange(n_b), np.arange(1 + n_p)
        score, solved = np.empty(n_grid), np.empty(n_grid, np.bool_)
        p, trial, best, step, g = (
            np.empty(n_p), np.empty(n_p), np.empty(n_p), np.empty(n_p), np.empty(n_p),
        )  # fmt: skip
        h, root, h_best = np.empty((n_p, n_p)), np.empty((n_p, n_p)), np.empty((n_p, n_p))
        free, state = np.empty(n_p, np.bool_), np.zeros(8)
        # With the same samples and weights, only the sums with the values differ between texels.
        shared = common and weight.shape[0] == 1
        shared_sums, constant = np.empty((n_b, n_b, n_grid)), np.empty(n_b, np.bool_)
        if shared:
            small_fits.constant_rows(basis, constant)
            small_fits.prepare(lit, weight[0], np.zeros(values.shape[1]), y, iv, wy, state)
            grid_sums(basis, y, iv, basis_rows, work, square, shared_sums)
        for t in range(values.shape[0]):
            if not common:
                directions(angles[t], w, geometry, lit)
            row = weight[t if weight.shape[0] > 1 else 0]
            count, n_excluded = small_fits.prepare(lit, row, values[t], y, iv, wy, state)
            used[t] = count
            chi2_out[t] = np.nan
            for j in range(n_p):
                p_out[t, j] = stderr[t, j] = best[j] = np.nan
                determined[t, j], bound[t, j] = False, 0
            if count <= n_p:
                status[t] = 2
                continue
            sums = texel_sums
            if shared and n_excluded == 0:
                sums = shared_sums
                small_fits.project(basis, constant, wy, sums[0])
            else:
                if not common:
                    grid_basis(geometry, grid, linear, columns, basis)
                grid_sums(basis, y, iv, basis_rows, work, square, sums)
            small_fits.scores(sums, score, solved, state)
            for _ in range(FOLLOWED):
                if not small_fits.start(
                    grid, sums, linear, lower, upper, score, solved, g, step, trial, state
                ):
                    break
                outcome = 0
                while outcome == 0:
                    _gradient(geometry, trial, columns)
                    outcome = small_fits.advance(
                        y, iv, columns, work, lower, upper, log, p, trial, g, h, rows, normal, step,
                        root, free, state,
                    )  # fmt: skip
                if small_fits.keep(outcome, p, h, lower, upper, best, h_best, state):
                    break
            status[t] = 0 if state[VERIFIED] > 0.0 else 1
            if not np.isfinite(state[BEST]):
                continue
            chi2_out[t] = state[BEST]
            small_fits.judge(
                best, h_best, lower, upper, log, noise_known, free, root, step, state, stderr[t],
                determined[t], bound[t],
            )  # fmt: skip
            for i in range(linear.shape[0]):
                if small_fits.may_be_none(linear[i], best, lower, stderr[t], bound[t], trial):
                    # The data allow a fit without the lobe: its shape is then undetermined.
                    _gradient(geometry, trial, columns)
                    small_fits.forget(iv, columns, determined[t])
            for j in range(n_p):
                p_out[t, j] = best[j]
                if not determined[t, j]:
                    stderr[t, j] = np.nan

    def directions(angles, w, geometry, lit):
        """Numbers (n_kept, W) of the directions of the angles (4, N), and which are lit.

        Their components stand in w (6, W). Pairs at or below the horizon, and elements beyond N,
        are replaced by the normal: they have weight 0, but f must be a number there.
        """
        w[:] = 0.0
        for k in range(angles.shape[1]):
            sin_i, z_i = sincos(angles[0, k])
            sin_r, z_r = sincos(angles[2, k])
            y_i, x_i = sincos(angles[1, k])
            y_r, x_r = sincos(angles[3, k])
            above = z_i > 0.0 and z_r > 0.0 and angles[0, k] != HORIZON and angles[2, k] != HORIZON
            w[0, k] = sin_i * x_i if above else 0.0
            w[1, k] = sin_i * y_i if above else 0.0
            w[2, k] = z_i if above else 0.0
            w[3, k] = sin_r * x_r if above else 0.0
            w[4, k] = sin_r * y_r if above else 0.0
            w[5, k] = z_r if above else 0.0
        keep_geometry(w, 0, w.shape[1], geometry, lit)

    def grid_basis(geometry, grid, linear, columns, basis):
        """Parts of f at every point of the grid: `gonio.kernels.small_fits.split_basis`."""
        for m in range(grid.shape[0]):
            _gradient(geometry, grid[m], columns)
            small_fits.split_basis(grid, m, linear, columns, basis[m])

    def grid_sums(basis, y, iv, rows, work, square, sums):
        """Weighted products of the values and the rows of the basis at every point of the grid."""
        for m in range(basis.shape[0]):
            for k in range(y.shape[0]):
                basis[m, 0, k] = y[k]
            square[:] = 0.0
            add_products(basis[m], rows, iv, work, square)
            small_fits.spread(square, m, sums)

    def _gradient(geometry, p, columns):
        """f, and its derivative by every parameter, as rows (1 + P, W)."""
        # Pairs that are not lit have weight 0.
        kept_gradient(geometry, geometry[0], True, unpack(p), columns[0], columns[1:])

    return TexelLoops(
        KEPT=n_kept, fit_texels=fit_texels, directions=directions, grid_basis=grid_basis
    )
