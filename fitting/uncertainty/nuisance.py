"""Estimates of profiled shared errors, and pulls too large for their priors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gonio.fitting.minimum.curvature import inverse_curvature
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.problem.nuisance import NuisanceProblem
from gonio.fitting.result import NuisanceEstimate

PULL = 3.0  # standard deviations of one draw that are worth a warning
LEARNT = 0.05  # smallest part of the prior's variance that data must take away for a pull


def nuisance_estimates(problem: NuisanceProblem, optimum: Optimum) -> tuple[NuisanceEstimate, ...]:
    """Every learnt draw with its standard uncertainty, in units of its prior's.

    The covariance of all draws is that of parameters and draws together: (I + U^T W U/s^2 -
    B (J^T W J)^-1 B^T)^-1 with B = U^T W J, over the parameters that the data determine.
    """
    weight = problem.inverse_variance / problem.noise**2
    _, jac = problem.jacobian(optimum.p)
    known, _ = inverse_curvature(optimum)
    inner = np.eye(len(problem.z0)) + problem.basis.T @ (weight[:, None] * problem.basis.toarray())
    if known.any():
        jac = jac[:, known]
        scale = np.sqrt(np.sum(weight[:, None] * jac**2, axis=0))
        jac = jac / scale
        cross = np.asarray(problem.basis.T @ (weight[:, None] * jac))
        inner -= cross @ np.linalg.pinv(jac.T @ (weight[:, None] * jac), hermitian=True) @ cross.T
    sd = np.sqrt(np.diag(np.linalg.inv((inner + inner.T) / 2)).clip(0, 1))
    z = problem.draws(optimum.p)
    found = []
    for term, draw in zip(problem.terms, problem.draw, strict=True):
        labels = [None] if term.group is None else np.unique(term.group).tolist()
        first = int(draw.min())
        found += [
            NuisanceEstimate(term.name, label, float(z[first + k]), float(sd[first + k]))
            for k, label in enumerate(labels)
        ]
    return tuple(found)


def pull_warnings(found: Sequence[NuisanceEstimate]) -> list[str]:
    """A sentence for every term with a draw too far from 0 for its prior.

    The pull of a draw is its estimate over sqrt(1 - sd^2), the spread that an honest prior gives
    the estimate. Of many draws the largest is allowed to be larger.
    """
    from scipy.stats import norm

    pulls = {
        k: e.estimate / np.sqrt(1 - e.stderr**2)
        for k, e in enumerate(found)
        if 1 - e.stderr**2 >= LEARNT
    }
    limit = float(norm.isf(norm.sf(PULL) / max(len(pulls), 1)))
    worst: dict[str, int] = {}
    for k, pull in pulls.items():
        name = found[k].name
        if abs(pull) > limit and abs(pull) > abs(pulls.get(worst.get(name, -1), 0.0)):
            worst[name] = k
    return [
        f"the data pull the shared error {name!r}"
        + ("" if found[k].group is None else f" (draw {found[k].group})")
        + f" to {found[k].estimate:+.1f} of its standard uncertainties: the budget is too small "
        "for it, or the model is wrong and it takes up what the model lacks."
        for name, k in worst.items()
    ]
