"""Whether a model that does not fit is of use: what it explains, and what it predicts unseen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_columns import thinned
from gonio.fitting.residual_tests.groups import classes
from gonio.geometry import FloatArray

MOST = 20_000  # samples that are examined
SIGNIFICANT = 3.0  # standard deviations by which f must vary beyond the noise
LEAST_INCIDENCES = 3  # fewer say nothing of one that was left out
MOST_INCIDENCES = 12


def explained_share(minimum: Minimum, noise: float) -> float | None:
    """Share of the variance of f beyond the noise that the model explains, all incidences together.

    What is compared with is a constant for each part, the best by the weights of the fit.

    Parameters
    ----------
    minimum : Minimum
    noise : float
        Part of the weighted sum of squares of the residuals that is noise.

    Returns
    -------
    float or None
        None where f does not vary significantly beyond the noise.
    """
    problem, p = minimum.problem, minimum.optimum.p
    weight = problem.inverse_variance
    left = float(np.sum(weight * (problem.samples.value - problem.values(p)) ** 2))
    total = float(np.sum(weight * (problem.samples.value - _constants(problem)) ** 2))
    beyond = total - noise
    if beyond <= SIGNIFICANT * np.sqrt(2 / problem.n) * noise or beyond <= 0:
        return None
    return round(1 - max(left - noise, 0.0) / beyond, 6) + 0.0


def worse_than_constant(minimum: Minimum) -> bool:
    """Whether incidences that are left out are predicted better by a constant than by the model.

    Each class of incidence is predicted from a fit to all others. False with fewer than three, and
    for a model that is a constant itself.
    """
    problem = thinned(minimum.problem, MOST)
    theta_i = np.degrees(np.broadcast_to(problem.samples.directions.theta_i, (problem.n,)))
    incidence = classes(theta_i, MOST_INCIDENCES)
    count = int(incidence.max(initial=0)) + 1
    if count < LEAST_INCIDENCES or problem.model.name == "lambert":
        return False
    value, weight = problem.samples.value, problem.inverse_variance
    by_model = by_constant = 0.0
    for k in range(count):
        group, rest = np.flatnonzero(incidence == k), np.flatnonzero(incidence != k)
        if len(rest) <= len(problem.parameters) or not _every_part(problem, rest):
            return False
        refit = minimise(problem.at(rest), minimum.optimum.p, near=True)
        f = problem.values(refit.p)[group]
        constant = _constants(problem, incidence != k)[group]
        by_model += float(np.sum(weight[group] * (value[group] - f) ** 2))
        by_constant += float(np.sum(weight[group] * (value[group] - constant) ** 2))
    return by_model > by_constant


def _constants(problem: Problem, use: NDArray[np.bool_] | None = None) -> FloatArray:
    """The weighted mean of each part, (N,), over the samples that are used."""
    weight = problem.inverse_variance * (1.0 if use is None else use)
    out = np.empty(problem.n)
    for _, where, _ in problem.pieces():
        total = max(float(np.sum(weight[where])), 1e-300)
        out[where] = float(np.sum(weight[where] * problem.samples.value[where])) / total
    return out


def _every_part(problem: Problem, rest: NDArray[np.int64]) -> bool:
    """Whether each part keeps more samples than it has unknowns."""
    return all(
        np.count_nonzero((rest >= where.start) & (rest < where.stop)) > len(index)
        for _, where, index in problem.pieces()
    )
