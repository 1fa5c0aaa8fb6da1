"""The minimum with shared errors profiled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gonio.fitting.minimum import engines, starting_values
from gonio.fitting.minimum.find import without_spikes
from gonio.fitting.minimum.minimise import Engine, minimise
from gonio.fitting.minimum.optimum import Optimum, better
from gonio.fitting.minimum.record import Minimum, goodness
from gonio.fitting.problem.nuisance import NuisanceProblem
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.viewed_samples import bright_and_even

ROUNDS = 12  # of new weights, draws and parameters
CONVERGED = 1e-3  # of the uncertainties: a last round that moves less ends them


def profiled(
    minimum: Minimum, names: tuple[str, ...], engine: Engine | None = engines.SEARCH
) -> Minimum:
    """The minimum with these shared errors profiled; chi-squared counts their draws as well."""
    if not names:
        return minimum
    problem, optimum, warnings = _alternated(minimum, names, engine)
    if not optimum.verified:
        optimum, spikes = without_spikes(problem, optimum)
        warnings = spikes or warnings
    chi2, dof, _ = goodness(problem, optimum)
    if problem.weights == "sd":
        chi2 += float(problem.z0 @ problem.z0)
    return replace(
        minimum, problem=problem, optimum=optimum, noise_scale=problem.noise, chi2=chi2, dof=dof,
        warnings=minimum.warnings + warnings,
    )  # fmt: skip


def _alternated(
    minimum: Minimum, names: tuple[str, ...], engine: Engine | None
) -> tuple[NuisanceProblem, Optimum, list[str]]:
    """Rounds of weights, draws and parameters, each following the others until all stand still."""
    problem = NuisanceProblem.of(minimum.problem, names)
    optimum = minimum.optimum
    evaluations = optimum.evaluations
    for round_ in range(ROUNDS):
        before = optimum.p
        problem = problem.reweighted(before)
        optimum = minimise(problem, before, near=True)
        if round_ == 0 and engine is not None:
            point, passes = engine(_some(problem), before)
            optimum = better(minimise(problem, point, near=True), optimum)
            evaluations += passes
        evaluations += optimum.evaluations
        step = optimum.p - before
        still = float(step @ optimum.curvature @ step) <= (CONVERGED * problem.noise) ** 2
        if still and np.all(np.abs(problem.draws(optimum.p) - problem.z0) <= CONVERGED):
            return problem, replace(optimum, evaluations=evaluations), []
    text = (
        f"the profiled shared errors have not converged in {ROUNDS} rounds: they are too large "
        "for this model, or the model is wrong."
    )
    return problem, replace(optimum, evaluations=evaluations), [text]


def _some(problem: NuisanceProblem) -> Problem:
    """Some of the samples, with the draws that they share: enough for a search."""
    n = starting_values.SUBSET
    if problem.n <= 2 * n:
        return problem
    return problem.at(bright_and_even(problem.samples.value, n))
