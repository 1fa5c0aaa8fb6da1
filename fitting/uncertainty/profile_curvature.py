"""Whether chi-squared is so far from a parabola that its curvature gives no interval."""

from __future__ import annotations

import numpy as np

from gonio.fitting.minimum.curvature import inverse_curvature
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.uncertainty.profile_likelihood import around

CURVED = 0.2  # relative difference of the growth from that of the parabola: 10 % of a length


def curved_profile(minimum: Minimum, j: int, reach: float) -> bool:
    """Whether chi-squared differs much from its parabola at the ends of an interval.

    Parameters
    ----------
    minimum : Minimum
        Of any problem; of a quadratic loss.
    j : int
        Number of a parameter that is determined.
    reach : float
        Standard uncertainties to either end.

    Notes
    -----
    The other parameters move as the curvature would have them, p_j + t u_j and the others by
    C_kj / C_jj of that. In a parabola chi-squared then grows by t^2. Ends outside the bounds are
    not asked for.
    """
    if not minimum.problem.quadratic or minimum.noise_scale <= 0:
        return False
    minimum, j, _ = around(minimum, j)
    problem, optimum = minimum.problem, minimum.optimum
    inverse = inverse_curvature(optimum)[1]
    if inverse[j, j] <= 0:
        return False
    step = reach * minimum.noise_scale * inverse[:, j] / np.sqrt(inverse[j, j])
    ends = optimum.p + np.array([[-1.0], [1.0]]) * step
    lower = np.array([q.lower for q in problem.parameters])
    upper = np.array([q.upper for q in problem.parameters])
    inside = np.all((ends >= lower) & (ends <= upper), axis=1)
    inside &= ends @ problem.sum_limit <= 1
    if not inside.any():
        return False
    growth = problem.batch_chi2(ends[inside]) - optimum.chi2
    parabola = (reach * minimum.noise_scale) ** 2
    return bool(np.any(np.abs(growth / parabola - 1) > CURVED))
