"""The arithmetic of a small fit, whatever the model: what `texels.py` calls between evaluations.

Compiled once by `gonio.kernels.build` for all models. Sums may be taken in any order (`reassoc`),
so that they become SIMD code. A fit runs by turns: the model is evaluated at `trial`, and `advance`
says where to evaluate it next, until a minimum is reached. Steps are those of Gauss and Newton,
damped where they fail (Levenberg-Marquardt), inside the bounds; parameters that `log` names move by
their logarithm. h = J^T W J, g = J^T W r, with r = y - f.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

import math

# HEADER ENDS

STEPS = 200  # evaluations, after which a fit is given up
SWEEPS = 200
STOP = 1e-2  # a step this small beside the uncertainties is the last; it leaves a tenth of it
ROUNDING = 1e-12  # of the norm of the data: what a step may change by rounding alone
UNDETERMINED = 1e-10  # smallest pivot of the scaled curvature that counts as information
TOLD_APART = 3.84  # chi-squared by which an amplitude must differ from its bound
GOING, CONVERGED, STUCK = 0, 1, 2
CHI2, DAMPING, COUNT, SIZE, BEST, VERIFIED, STEP = 0, 1, 2, 3, 4, 5, 6


def prepare(x, weight, value, y, iv, wy, state):
    """Usable values and weights of one texel, 0 elsewhere; how many there are.

    The second number says how many of those with a weight are not usable.
    """
    size = 0.0
    count = left_out = 0
    for k in range(y.shape[0]):
        above = x[2, k] > 0.0 and x[5, k] > 0.0
        good = weight[k] > 0.0 and above and math.isfinite(value[k])
        y[k] = value[k] if good else 0.0
        iv[k] = weight[k] if good else 0.0
        wy[k] = iv[k] * y[k]
        size += wy[k] * y[k]
        count += good
        left_out += weight[k] > 0.0 and above and not good
    state[COUNT], state[SIZE], state[BEST], state[VERIFIED] = count, size, math.inf, 0.0
    return count, left_out


def weighted_sums(rows, weight, first, out):
    """Weighted sums of the rows (M, R, N) from number `first` on, into out (M, R)."""
    for m in range(rows.shape[0]):
        for row in range(first):
            out[m, row] = 0.0
        for row in range(first, rows.shape[1]):
            total = 0.0
            for k in range(rows.shape[2]):
                total += rows[m, row, k] * weight[k]
            out[m, row] = total


def split_basis(m, grid, linear, f, jac, basis, products):
    """What f is made of at point m of the grid: the part without amplitudes, then df/da.

    `products` (M, pairs, N) are those of each two of them, with whose sums chi2 is known for all
    amplitudes: chi2 = sum W y^2 - 2 sum_i c_i sum W y b_i + sum_ij c_i c_j sum W b_i b_j, c_0 = 1.
    """
    for k in range(f.shape[0]):
        basis[m, 0, k] = f[k]
    for i in range(linear.shape[0]):
        a = grid[m, linear[i]]
        for k in range(f.shape[0]):
            basis[m, 0, k] -= a * jac[linear[i], k]
            basis[m, 1 + i, k] = jac[linear[i], k]
    row = 0
    for i in range(basis.shape[1]):
        for j in range(i + 1):
            for k in range(f.shape[0]):
                products[m, row, k] = basis[m, i, k] * basis[m, j, k]
            row += 1


def amplitudes(grid, sums, right, linear, lower, upper, starts, score, g, step, state):
    """The best amplitudes inside their bounds at each point of the grid, and chi2 with them."""
    n_a = linear.shape[0]
    for m in range(grid.shape[0]):
        chi2 = state[SIZE] + sums[m, 0] - 2 * right[m, 0]
        inside = n_a < 3
        for i in range(n_a):
            g[i] = right[m, 1 + i] - sums[m, (i + 1) * (i + 2) // 2]
        if n_a == 1:
            step[0] = g[0] / sums[m, 2]
        elif n_a == 2:
            h_0, h_01, h_1 = sums[m, 2], sums[m, 4], sums[m, 5]
            det = h_0 * h_1 - h_01 * h_01
            inside = det > UNDETERMINED * h_0 * h_1
            step[0] = (g[0] * h_1 - g[1] * h_01) / det
            step[1] = (g[1] * h_0 - g[0] * h_01) / det
        for i in range(n_a):
            inside = inside and lower[linear[i]] <= step[i] <= upper[linear[i]]
        if not inside:
            _in_box(m, sums, linear, lower, upper, g, step)
        for j in range(grid.shape[1]):
            starts[m, j] = grid[m, j]
        for i in range(n_a):
            starts[m, linear[i]] = step[i]
            chi2 -= 2 * g[i] * step[i]
            for j in range(n_a):
                chi2 += step[i] * sums[m, _pair(i, j)] * step[j]
        score[m] = chi2


def _pair(i, j):
    """Number of the product of the amplitudes i and j."""
    high = i + 1 if i > j else j + 1
    low = j + 1 if i > j else i + 1
    return high * (high + 1) // 2 + low


def _in_box(m, sums, linear, lower, upper, g, step):
    """One amplitude after the other, again and again: a convex problem in a box."""
    n_a = linear.shape[0]
    for i in range(n_a):
        step[i] = _clipped(0.0, lower[linear[i]], upper[linear[i]])
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(n_a):
            own = sums[m, _pair(i, i)]
            if own > 0.0:
                a = g[i] + own * step[i]
                for j in range(n_a):
                    a -= sums[m, _pair(i, j)] * step[j]
                a = _clipped(a / own, lower[linear[i]], upper[linear[i]])
                moved += abs(a - step[i])
                step[i] = a
        if moved < 1e-6:
            break


def _clipped(a, low, high):
    if a < low:
        return low
    return high if a > high else a


def start(score, starts, trial, state):
    """Put the best point of the grid that was not followed yet into `trial`; False if none."""
    best = -1
    for m in range(score.shape[0]):
        if score[m] < math.inf and (best < 0 or score[m] < score[best]):
            best = m
    if best < 0:
        return False
    score[best] = math.inf
    for j in range(trial.shape[0]):
        trial[j] = starts[best, j]
    state[STEP] = state[DAMPING] = 0.0
    return True


def advance(
    y, iv, f, jac, work, lower, upper, log, p, trial, g, h, g_new, h_new, step, root, free, state
):
    """Judge the model that was evaluated at `trial`, and choose the next trial."""
    n_p = p.shape[0]
    new = _normal_equations(y, iv, trial, log, f, jac, work, g_new, h_new)
    first = state[STEP] == 0.0
    state[STEP] += 1.0
    if first or new <= state[CHI2]:
        for i in range(n_p):
            p[i] = trial[i]
            g[i] = g_new[i]
            for j in range(n_p):
                h[i, j] = h_new[i, j]
            free[i] = not ((p[i] <= lower[i] and g[i] <= 0) or (p[i] >= upper[i] and g[i] >= 0))
        state[CHI2] = new
        state[DAMPING] = state[DAMPING] / 10 if state[DAMPING] > 1e-3 else 0.0
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
        state[DAMPING] = 10 * state[DAMPING] if state[DAMPING] > 0.0 else 1e-3
        if state[DAMPING] > 1e10:
            return STUCK
        _solved(h, g, free, state[DAMPING], root, step)
    _moved(p, step, lower, upper, log, trial)
    return GOING if state[STEP] < STEPS else STUCK


def _normal_equations(y, iv, p, log, f, jac, work, g, h):
    """chi2; g and h by the logarithm of p where `log`."""
    n = f.shape[0]
    chi2 = 0.0
    for k in range(n):
        f[k] = y[k] - f[k]
        chi2 += iv[k] * f[k] * f[k]
    for i in range(p.shape[0]):
        scale = p[i] if log[i] else 1.0
        total = 0.0
        for k in range(n):
            work[k] = iv[k] * jac[i, k]
            total += work[k] * f[k]
        g[i] = scale * total
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += work[k] * jac[j, k]
            total *= scale * (p[j] if log[j] else 1.0)
            h[i, j] = total
            h[j, i] = total
    return chi2


def _solved(h, g, free, damping, root, step):
    """(H + damping diag H) step = g on the free parameters; the decrease of chi2 at damping 0.

    The triangle of Cholesky stands in `root`; a parameter about which the data say nothing that
    those before it do not say has a root of 0 on the diagonal and no step.
    """
    n_p = g.shape[0]
    decrease = 0.0
    for i in range(n_p):
        step[i] = 0.0
        for j in range(i):
            total = h[i, j]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = total / root[j, j] if free[i] and root[j, j] > 0.0 else 0.0
        pivot = h[i, i] * (1 + damping)
        for k in range(i):
            pivot -= root[i, k] * root[i, k]
        known = free[i] and pivot > UNDETERMINED * h[i, i] and h[i, i] > 0.0
        root[i, i] = math.sqrt(pivot) if known else 0.0
        if known:
            total = g[i]
            for k in range(i):
                total -= root[i, k] * step[k]
            step[i] = total / root[i, i]
            decrease += step[i] * step[i]
    for i in range(n_p - 1, -1, -1):
        if root[i, i] > 0.0:
            total = step[i]
            for k in range(i + 1, n_p):
                total -= root[k, i] * step[k]
            step[i] = total / root[i, i]
    return decrease


def _moved(p, step, lower, upper, log, trial):
    """p + step inside the bounds; no logarithm moves by more than 1."""
    for j in range(p.shape[0]):
        a = p[j] * math.exp(_clipped(step[j], -1.0, 1.0)) if log[j] else p[j] + step[j]
        trial[j] = _clipped(a, lower[j], upper[j])


def keep(found, p, h, lower, upper, best, h_best, state):
    """Keep the deeper minimum; whether it is one and lies inside the bounds."""
    chi2 = state[CHI2]
    verified = found == CONVERGED
    deeper = chi2 < state[BEST] * (1 - 1e-9)
    as_deep = chi2 <= state[BEST] * (1 + 1e-9)
    inside = verified
    for j in range(p.shape[0]):
        inside = inside and lower[j] < p[j] < upper[j]
    if deeper or (verified and state[VERIFIED] == 0.0 and as_deep):
        state[BEST] = chi2
        state[VERIFIED] = 1.0 if verified else 0.0
        for i in range(p.shape[0]):
            best[i] = p[i]
            for j in range(p.shape[0]):
                h_best[i, j] = h[i, j]
    return inside


def judge(p, h, lower, upper, log, known_noise, free, root, step, state, stderr, known, bound):
    """Standard uncertainties at p; none on a bound, nor of what the data do not determine."""
    n_p = p.shape[0]
    n_free = 0
    for j in range(n_p):
        bound[j] = -1 if p[j] <= lower[j] else (1 if p[j] >= upper[j] else 0)
        free[j] = bound[j] == 0
        known[j] = free[j] and state[VERIFIED] > 0.0
        n_free += free[j]
    noise = state[BEST] / (state[COUNT] - n_free)
    if known_noise and noise < 1.0:
        noise = 1.0
    _solved(h, step, free, 0.0, root, step)
    for i in range(n_p):
        if free[i] and root[i, i] == 0.0:
            _unknown_direction(root, h, i, step, known)
    for j in range(n_p):
        # Column j of the inverse of the triangle; its length is the root of the covariance.
        variance = 0.0
        for i in range(j, n_p):
            step[i] = 0.0
            if root[i, i] > 0.0:
                total = 1.0 if i == j else 0.0
                for k in range(j, i):
                    total -= root[i, k] * step[k]
                step[i] = total / root[i, i]
            variance += step[i] * step[i]
        u = math.sqrt(noise * variance) * (p[j] if log[j] else 1.0)
        known[j] = known[j] and u < upper[j] - lower[j]
        stderr[j] = u


def _unknown_direction(root, h, i, step, known):
    """The parameters that take part in a direction without information are not known."""
    known[i] = False
    if not h[i, i] > 0.0:
        return
    # The null vector has 1 at i and solves the triangle above it.
    for j in range(i - 1, -1, -1):
        step[j] = 0.0
        if root[j, j] > 0.0:
            total = -root[i, j]
            for k in range(j + 1, i):
                total -= root[k, j] * step[k]
            step[j] = total / root[j, j]
            if abs(step[j]) * math.sqrt(h[j, j]) > 1e-3 * math.sqrt(h[i, i]):
                known[j] = False


def may_be_none(j, p, lower, stderr, bound, trial):
    """Whether amplitude j may as well be at its bound; `trial` is then p with it there."""
    if bound[j] != 0 or (p[j] - lower[j]) ** 2 > TOLD_APART * stderr[j] ** 2:
        return False
    for i in range(p.shape[0]):
        trial[i] = p[i]
    trial[j] = lower[j]
    return True


def forget(iv, jac, known):
    """Parameters without a derivative do not mean anything."""
    for j in range(jac.shape[0]):
        total = 0.0
        for k in range(iv.shape[0]):
            total += iv[k] * jac[j, k] * jac[j, k]
        known[j] = known[j] and total > 0.0
