"""The least-squares minimum of a model: search, reweighting, rival minima, goodness of fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gonio.fitting.minimum.derivative_check import gradient_faults
from gonio.fitting.minimum.minimise import Engine, at_lower, minima, minimise
from gonio.fitting.minimum.optimum import Optimum, better
from gonio.fitting.minimum.record import Minimum, goodness
from gonio.fitting.minimum.rivals import parameter_text, rival
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.copies import usable
from gonio.fitting.problem.losses import CHI2
from gonio.fitting.problem.protocol import Problem, Weights
from gonio.fitting.problem.reduced import ReducedProblem
from gonio.fitting.problem.single import SingleProblem
from gonio.models import Model
from gonio.samples import BRDFSamples

SCALE_ROUNDS = 8  # in which a robust scale of the noise settles


def find_minimum(
    samples: BRDFSamples,
    model: Model,
    *,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    threads: int | None = None,
    engine: Engine | None = None,
    loss: str = CHI2.name,
    constraints: Constraints | None = None,
) -> Minimum:
    """The deepest minimum found and its goodness, without uncertainties; arguments as of `fit`.

    `engine` is what `engines.get` gives, `constraints` what `Constraints.of` checks.
    """
    held = constraints or Constraints()
    problem: Problem = SingleProblem.from_samples(
        usable(samples), model, weights, threads, loss, n_unknowns=held.n_unknowns(model)
    )
    if held:
        problem = ReducedProblem.of(problem, held)
    problem, optimum, warnings = _find(problem, start, engine)
    faults = gradient_faults(problem, optimum.p)
    return Minimum.of(problem, optimum, warnings=warnings, faults=faults)


def _find(
    problem: Problem, start: Mapping[str, float] | None, engine: Engine | None
) -> tuple[Problem, Optimum, list[str]]:
    """The deepest minimum found, the problem with its weights, and what to know about it."""
    candidates = minima(problem, engine)
    warnings = []
    if start is not None:
        given = minimise(problem, problem.vector(start), engine=engine)
        if better(given, candidates[0]) is given:
            candidates = [given]
        elif given.verified:
            warnings.append(
                f"the start led to another minimum, at {parameter_text(problem, given)}, "
                f"where chi2 is {given.chi2 / max(candidates[0].chi2, 1e-300):.3g} times that of "
                "the minimum that was taken."
            )
    problem, optimum = reweighted_minimum(problem, candidates[0])
    for other in candidates[1:]:
        if problem.weights_follow_model:
            other = minimise(problem, other.p, search=False)
        deepest = better(optimum, other)
        warnings += rival(problem, deepest, optimum if deepest is other else other)
        if deepest is other:
            problem, optimum = reweighted_minimum(problem, other)
    if not optimum.verified:
        optimum, spikes = without_spikes(problem, optimum)
        warnings = spikes or warnings
    return problem, optimum, warnings


def reweighted_minimum(problem: Problem, optimum: Optimum) -> tuple[Problem, Optimum]:
    """Weights from the model's values need the model first: a few rounds settle them."""
    if problem.weights_follow_model:
        for _ in range(SCALE_ROUNDS if problem.finds_scale else 2):
            problem = problem.reweighted(optimum.p)
            optimum = minimise(problem, optimum.p, near=True)
    return problem, optimum


def without_spikes(problem: Problem, optimum: Optimum) -> tuple[Optimum, list[str]]:
    """The fit without a lobe that only follows single noisy samples.

    The largest of N squared normal deviates is about 2 ln N; a lobe narrow enough to meet one
    sample alone lowers chi-squared by as much, in a valley without a bottom.
    """
    noise = max(goodness(problem, optimum)[2], 1e-300)
    expected = 2 * np.log(problem.n)
    for j, q in enumerate(problem.parameters):
        if not (q.linear and optimum.free[j]):
            continue
        null = at_lower(problem, optimum, j)
        gain = (null.chi2 - optimum.chi2) / noise**2
        if null.verified and gain < expected:
            return null, [
                f"{q.name} was set to its bound: with it the fit only followed the noise of "
                f"single samples (chi2 smaller by {gain:.2g}; noise alone gives up to about "
                f"{expected:.2g})."
            ]
    return optimum, []
