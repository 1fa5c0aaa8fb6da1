"""Estimates of profiled shared errors, and pulls too large for their priors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.result import NuisanceEstimate

PULL = 3.0  # standard deviations of one draw that are worth a warning
INFORMED = 0.05  # smallest part of the prior's variance that data must take away for a pull


def nuisance_estimates(minimum: Minimum) -> tuple[NuisanceEstimate, ...]:
    """Every profiled draw with its standard uncertainty, in units of its prior's; often none."""
    optimum = minimum.optimum
    informed = optimum.free & (np.diag(optimum.curvature) > 0)
    draws = minimum.problem.profiled_draws(optimum.p, informed)
    return tuple(NuisanceEstimate(*draw) for draw in draws)


def pull_warnings(estimates: Sequence[NuisanceEstimate]) -> list[str]:
    """A sentence for every term with a draw too far from 0 for its prior.

    The pull of a draw is its estimate over sqrt(1 - sd^2), the spread that an honest prior gives
    the estimate. Of many draws the largest is allowed to be larger.
    """
    if not estimates:
        return []
    from scipy.stats import norm

    pulls = {
        k: e.estimate / np.sqrt(1 - e.stderr**2)
        for k, e in enumerate(estimates)
        if 1 - e.stderr**2 >= INFORMED
    }
    limit = float(norm.isf(norm.sf(PULL) / max(len(pulls), 1)))
    worst: dict[str, int] = {}
    for k, pull in pulls.items():
        name = estimates[k].name
        if abs(pull) > limit and abs(pull) > abs(pulls.get(worst.get(name, -1), 0.0)):
            worst[name] = k
    return [
        f"the data pull the shared error {name!r}"
        + ("" if estimates[k].group is None else f" (draw {estimates[k].group})")
        + f" to {estimates[k].estimate:+.1f} of its standard uncertainties: the budget is too "
        "small for it, or the model is wrong and this error makes up for it."
        for name, k in worst.items()
    ]
