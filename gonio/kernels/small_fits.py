"""The arithmetic of a small fit, independent of the model; `texels.py` calls it.

`small_fits_of` is a template (`gonio.kernels.template`), compiled once for each number of
parameters `n_p`: loops over few parameters of known number are written out. Sums over samples may
be taken in any order, so that they become SIMD code. A fit alternates: the model is evaluated at
`trial`, and `advance` gives the next trial, until a minimum is reached. Steps are those of Gauss
and Newton, damped where they fail (Levenberg-Marquardt), inside the bounds; parameters
that `log` names move by their logarithm. h = J^T W J, g = J^T W r, with r = y - f.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gonio.kernels.template import any_order

STEPS = 200  # most evaluations of a fit
SWEEPS = 200
STOP = 3e-2  # a step below this share of the uncertainties is the last; its error is a tenth of it
DAMPED = 0.1  # damping after the first step that failed
LARGEST = 1.7976931348623157e308  # largest finite number
ROUNDING = 1e-12  # change by rounding alone, over the norm of the data
UNDETERMINED = 1e-10  # smallest pivot of the scaled curvature that counts as information
DISTINCT = 3.84  # chi-squared by which an amplitude must differ from its bound
GOING, CONVERGED, STUCK = 0, 1, 2
CHI2, DAMPING, COUNT, SIZE, BEST, VERIFIED, STEP = 0, 1, 2, 3, 4, 5, 6


@dataclass(frozen=True)
class SmallFits:
    """The functions for one number of parameters, see `small_fits_of`."""

    prepare: Callable[..., tuple[int, int]]
    split_basis: Callable[..., None]
    constant_rows: Callable[..., None]
    project: Callable[..., None]
    spread: Callable[..., None]
    scores: Callable[..., None]
    start: Callable[..., bool]
    advance: Callable[..., int]
    keep: Callable[..., bool]
    judge: Callable[..., None]
    may_be_none: Callable[..., bool]
    forget: Callable[..., None]


def small_fits_of(
    n_p: int,
    add_products: Callable[..., Any],
) -> SmallFits:
    """The arithmetic of fits with `n_p` parameters; `add_products` is that of `sums`."""

    @any_order
    def prepare(lit, weight, value, y, iv, wy, state):
        """Usable values and weights of one texel, 0 elsewhere; how many there are.

        The second number counts the unusable ones among those with a weight. Elements of y, iv and
        wy beyond the values keep their value.
        """
        size = count = weighted = 0.0
        for k in range(value.shape[0]):
            w = weight[k] * lit[k]
            good = w > 0.0 and abs(value[k]) <= LARGEST
            v = value[k] if good else 0.0
            y[k] = v
            iv[k] = w if good else 0.0
            wy[k] = iv[k] * v
            size += wy[k] * v
            count += 1.0 if good else 0.0
            weighted += 1.0 if w > 0.0 else 0.0
        state[COUNT], state[SIZE], state[BEST], state[VERIFIED] = count, size, math.inf, 0.0
        return int(count), int(weighted - count)

    def split_basis(grid, m, linear, columns, basis):
        """Parts of f at point m of the grid: the part without amplitudes, then df/da.

        `columns` holds f and its derivatives there; row 0 of the basis (1 + 1 + amplitudes, N) is
        for the values. The weighted products of all these rows give chi2 for all amplitudes.
        """
        n = columns.shape[1]
        for k in range(n):
            basis[1, k] = columns[0, k]
        for i in range(linear.shape[0]):
            a = grid[m, linear[i]]
            for k in range(n):
                basis[1, k] -= a * columns[1 + linear[i], k]
                basis[2 + i, k] = columns[1 + linear[i], k]

    def constant_rows(basis, constant):
        """Mark the rows of the basis that are the same at every point of the grid."""
        for row in range(basis.shape[1]):
            constant[row] = True
            for m in range(1, basis.shape[0]):
                for k in range(basis.shape[2]):
                    constant[row] = constant[row] and basis[m, row, k] == basis[0, row, k]

    @any_order
    def project(basis, constant, wy, out):
        """Weighted sums of the values with the rows of the basis but the first, out[row, m]."""
        n_grid = basis.shape[0]
        for row in range(1, basis.shape[1]):
            if constant[row]:
                total = 0.0
                for k in range(wy.shape[0]):
                    total += basis[0, row, k] * wy[k]
                for m in range(n_grid):
                    out[row, m] = total
                continue
            for m in range(0, n_grid, 4):  # four sums at once hide the latency of each
                m_1, m_2, m_3 = (
                    min(m + 1, n_grid - 1),
                    min(m + 2, n_grid - 1),
                    min(m + 3, n_grid - 1),
                )
                total = total_1 = total_2 = total_3 = 0.0
                for k in range(wy.shape[0]):
                    total += basis[m, row, k] * wy[k]
                    total_1 += basis[m_1, row, k] * wy[k]
                    total_2 += basis[m_2, row, k] * wy[k]
                    total_3 += basis[m_3, row, k] * wy[k]
                out[row, m], out[row, m_1], out[row, m_2], out[row, m_3] = (
                    total, total_1, total_2, total_3,
                )  # fmt: skip

    def spread(square, m, sums):
        """Put the lower triangle of point m's products, and its mirror, into sums[:, :, m]."""
        for a in range(square.shape[0]):
            for b in range(a + 1):
                sums[a, b, m] = square[a, b]
                sums[b, a, m] = square[a, b]

    def scores(sums, score, solved, state):
        """chi2 at each point of the grid with the best amplitudes, inside their bounds or not.

        sums[a, b, m]: weighted products of [values, part without amplitudes, df/da, ...]. It is
        a lower bound of chi2; `start` puts the amplitudes inside their bounds where that matters.
        It also solves all cases of more than two amplitudes.
        """
        n_a = sums.shape[0] - 2
        size = state[SIZE]
        for m in range(score.shape[0]):
            solved[m] = False
        if n_a == 0:
            for m in range(score.shape[0]):
                score[m] = size - 2 * sums[0, 1, m] + sums[1, 1, m]
        elif n_a == 1:
            for m in range(score.shape[0]):
                rest = size - 2 * sums[0, 1, m] + sums[1, 1, m]
                g, h = sums[0, 2, m] - sums[1, 2, m], sums[2, 2, m]
                score[m] = rest - g * g / h if h > 0.0 else -math.inf
        elif n_a == 2:
            for m in range(score.shape[0]):
                rest = size - 2 * sums[0, 1, m] + sums[1, 1, m]
                g_0, g_1 = sums[0, 2, m] - sums[1, 2, m], sums[0, 3, m] - sums[1, 3, m]
                h_0, h_01, h_1 = sums[2, 2, m], sums[2, 3, m], sums[3, 3, m]
                det = h_0 * h_1 - h_01 * h_01
                determined = det > UNDETERMINED * h_0 * h_1
                gain = (g_0 * g_0 * h_1 - 2 * g_0 * g_1 * h_01 + g_1 * g_1 * h_0) / det
                score[m] = rest - gain if determined else -math.inf
        else:
            for m in range(score.shape[0]):
                score[m] = -math.inf

    def start(grid, sums, linear, lower, upper, score, solved, g, step, trial, state):
        """Put the best point of the grid that is not yet tried into `trial`; False if none."""
        while True:
            best = 0
            for m in range(1, score.shape[0]):
                if score[m] < score[best]:
                    best = m
            if score[best] == math.inf:
                return False
            if solved[best]:
                break
            score[best] = _in_bounds(best, sums, linear, lower, upper, g, step, state)
            solved[best] = True
        _in_bounds(best, sums, linear, lower, upper, g, step, state)
        score[best] = math.inf
        for j in range(trial.shape[0]):
            trial[j] = grid[best, j]
        for i in range(linear.shape[0]):
            trial[linear[i]] = step[i]
        state[STEP] = state[DAMPING] = 0.0
        return True

    def _in_bounds(m, sums, linear, lower, upper, g, step, state):
        """The best amplitudes inside their bounds at point m of the grid; chi2 with them."""
        n_a = linear.shape[0]
        chi2 = state[SIZE] - 2 * sums[0, 1, m] + sums[1, 1, m]
        for i in range(n_a):
            g[i] = sums[0, 2 + i, m] - sums[1, 2 + i, m]
            step[i] = _clipped(0.0, lower[linear[i]], upper[linear[i]])
        inside = n_a < 3
        if n_a == 1:
            step[0] = g[0] / sums[2, 2, m]
        elif n_a == 2:
            h_0, h_01, h_1 = sums[2, 2, m], sums[2, 3, m], sums[3, 3, m]
            det = h_0 * h_1 - h_01 * h_01
            inside = det > UNDETERMINED * h_0 * h_1
            step[0] = (g[0] * h_1 - g[1] * h_01) / det
            step[1] = (g[1] * h_0 - g[0] * h_01) / det
        for i in range(n_a):
            inside = inside and lower[linear[i]] <= step[i] <= upper[linear[i]]
        if not inside:
            _in_box(m, sums, linear, lower, upper, g, step)
        for i in range(n_a):
            chi2 -= 2 * g[i] * step[i]
            for j in range(n_a):
                chi2 += step[i] * sums[2 + i, 2 + j, m] * step[j]
        return chi2

    def _in_box(m, sums, linear, lower, upper, g, step):
        """Coordinate descent in the amplitudes: a convex problem in a box."""
        n_a = linear.shape[0]
        for i in range(n_a):
            step[i] = _clipped(0.0, lower[linear[i]], upper[linear[i]])
        for _ in range(SWEEPS):
            moved = 0.0
            for i in range(n_a):
                curvature = sums[2 + i, 2 + i, m]
                if curvature > 0.0:
                    a = g[i] + curvature * step[i]
                    for j in range(n_a):
                        a -= sums[2 + i, 2 + j, m] * step[j]
                    a = _clipped(a / curvature, lower[linear[i]], upper[linear[i]])
                    moved += abs(a - step[i])
                    step[i] = a
            if moved < 1e-6:
                break

    def _clipped(a, low, high):
        if a < low:
            return low
        return high if a > high else a

    def advance(
        y,
        iv,
        columns,
        work,
        lower,
        upper,
        log,
        p,
        trial,
        g,
        h,
        rows,
        square,
        step,
        root,
        free,
        state,
    ):
        """Accept or refuse `trial` by the model's columns there; put in the next trial."""
        new = _normal_equations(y, iv, trial, log, columns, work, rows, square)
        first = state[STEP] == 0.0
        state[STEP] += 1.0
        if first or new <= state[CHI2]:
            for i in range(n_p):
                p[i] = trial[i]
                g[i] = square[1 + i, 0]
                for j in range(i + 1):
                    h[i, j] = h[j, i] = square[1 + i, 1 + j]
                free[i] = not ((p[i] <= lower[i] and g[i] <= 0) or (p[i] >= upper[i] and g[i] >= 0))
            state[CHI2] = new
            state[DAMPING] = state[DAMPING] / 10 if state[DAMPING] > DAMPED else 0.0
            decrease = _solved(h, g, free, 0.0, root, step)
            noise = new / (state[COUNT] - n_p)
            if decrease <= STOP * STOP * noise or decrease <= ROUNDING * ROUNDING * state[SIZE]:
                _moved(p, step, lower, upper, log, trial)
                inside = True
                for j in range(n_p):
                    inside = inside and (not free[j] or lower[j] < trial[j] < upper[j])
                if inside:  # for so short a step chi2 is a parabola
                    for j in range(n_p):
                        p[j] = trial[j]
                    state[CHI2] = new - decrease if new > decrease else 0.0
                return CONVERGED
            if state[DAMPING] > 0.0:
                _solved(h, g, free, state[DAMPING], root, step)
        else:
            state[DAMPING] = 10 * state[DAMPING] if state[DAMPING] > 0.0 else DAMPED
            if state[DAMPING] > 1e10:
                return STUCK
            _solved(h, g, free, state[DAMPING], root, step)
        _moved(p, step, lower, upper, log, trial)
        return GOING if state[STEP] < STEPS else STUCK

    def _normal_equations(y, iv, p, log, columns, work, rows, square):
        """chi2; g and h by the logarithm of p where `log`: the products of column 0 with each."""
        for k in range(y.shape[0]):
            columns[0, k] = y[k] - columns[0, k]
        for a in range(n_p + 1):
            for b in range(a + 1):
                square[a, b] = 0.0
        add_products(columns, rows, iv, work, square)
        for j in range(n_p):
            if log[j]:
                for b in range(j + 2):
                    square[1 + j, b] *= p[j]
                for a in range(1 + j, n_p + 1):
                    square[a, 1 + j] *= p[j]
        return square[0, 0]

    def _solved(h, g, free, damping, root, step):
        """(H + damping diag H) step = g on the free parameters; the decrease of chi2 at damping 0.

        `root` holds the triangle of Cholesky with the reciprocals of its diagonal on the diagonal.
        The entry is 0, without a step, for a parameter that the data do not determine beside those
        before it.
        """
        decrease = 0.0
        for i in range(n_p):
            step[i] = 0.0
            for j in range(i):
                total = h[i, j]
                for k in range(j):
                    total -= root[i, k] * root[j, k]
                root[i, j] = total * root[j, j] if free[i] else 0.0
            pivot = h[i, i] * (1 + damping)
            for k in range(i):
                pivot -= root[i, k] * root[i, k]
            determined = free[i] and pivot > UNDETERMINED * h[i, i] and h[i, i] > 0.0
            root[i, i] = 1.0 / math.sqrt(pivot) if determined else 0.0
            if determined:
                total = g[i]
                for k in range(i):
                    total -= root[i, k] * step[k]
                step[i] = total * root[i, i]
                decrease += step[i] * step[i]
        for i in range(n_p - 1, -1, -1):
            total = step[i]
            for k in range(i + 1, n_p):
                total -= root[k, i] * step[k]
            step[i] = total * root[i, i]
        return decrease

    def _moved(p, step, lower, upper, log, trial):
        """p + step inside the bounds; no logarithm moves by more than 1."""
        for j in range(n_p):
            a = p[j] * math.exp(_clipped(step[j], -1.0, 1.0)) if log[j] else p[j] + step[j]
            trial[j] = _clipped(a, lower[j], upper[j])

    def keep(outcome, p, h, lower, upper, best, h_best, state):
        """Keep the deeper minimum; return whether it is one and lies inside the bounds."""
        chi2 = state[CHI2]
        verified = outcome == CONVERGED
        deeper = chi2 < state[BEST] * (1 - 1e-9)
        as_deep = chi2 <= state[BEST] * (1 + 1e-9)
        inside = verified
        for j in range(n_p):
            inside = inside and lower[j] < p[j] < upper[j]
        if deeper or (verified and state[VERIFIED] == 0.0 and as_deep):
            state[BEST] = chi2
            state[VERIFIED] = 1.0 if verified else 0.0
            for i in range(n_p):
                best[i] = p[i]
                for j in range(n_p):
                    h_best[i, j] = h[i, j]
        return inside

    def judge(
        p, h, lower, upper, log, noise_known, free, root, step, state, stderr, determined, bound
    ):
        """Standard uncertainties at p; none at a bound or where the data do not determine p."""
        n_free = 0
        for j in range(n_p):
            bound[j] = -1 if p[j] <= lower[j] else (1 if p[j] >= upper[j] else 0)
            free[j] = bound[j] == 0
            determined[j] = free[j] and state[VERIFIED] > 0.0
            n_free += free[j]
        noise = state[BEST] / (state[COUNT] - n_free)
        if noise_known and noise < 1.0:
            noise = 1.0
        _solved(h, step, free, 0.0, root, step)
        for i in range(n_p):
            if free[i] and root[i, i] == 0.0:
                _unknown_direction(root, h, i, step, determined)
        for j in range(n_p):
            # Column j of the inverse of the triangle; its length is the root of the covariance.
            variance = 0.0
            for i in range(j, n_p):
                total = 1.0 if i == j else 0.0
                for k in range(j, i):
                    total -= root[i, k] * step[k]
                step[i] = total * root[i, i]
                variance += step[i] * step[i]
            u = math.sqrt(noise * variance) * (p[j] if log[j] else 1.0)
            determined[j] = determined[j] and u < upper[j] - lower[j]
            stderr[j] = u

    def _unknown_direction(root, h, i, step, determined):
        """Mark the parameters in a direction without information as not determined."""
        determined[i] = False
        if not h[i, i] > 0.0:
            return
        # The null vector has 1 at i and solves the triangle above it.
        for j in range(i - 1, -1, -1):
            step[j] = 0.0
            if root[j, j] > 0.0:
                total = -root[i, j]
                for k in range(j + 1, i):
                    total -= root[k, j] * step[k]
                step[j] = total * root[j, j]
                if abs(step[j]) * math.sqrt(h[j, j]) > 1e-3 * math.sqrt(h[i, i]):
                    determined[j] = False

    def may_be_none(j, p, lower, stderr, bound, trial):
        """Whether the data allow amplitude j at its bound; `trial` is then p with it there."""
        if bound[j] != 0 or (p[j] - lower[j]) ** 2 > DISTINCT * stderr[j] ** 2:
            return False
        for i in range(n_p):
            trial[i] = p[i]
        trial[j] = lower[j]
        return True

    @any_order
    def forget(iv, columns, determined):
        """Mark the parameters without a derivative as not determined."""
        for j in range(determined.shape[0]):
            total = 0.0
            for k in range(iv.shape[0]):
                total += iv[k] * columns[1 + j, k] * columns[1 + j, k]
            determined[j] = determined[j] and total > 0.0

    return SmallFits(
        prepare=prepare,
        split_basis=split_basis,
        constant_rows=constant_rows,
        project=project,
        spread=spread,
        scores=scores,
        start=start,
        advance=advance,
        keep=keep,
        judge=judge,
        may_be_none=may_be_none,
        forget=forget,
    )
