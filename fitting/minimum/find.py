"""The least-squares minimum of a model: search, reweighting, rival minima, goodness of fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gonio.fitting.minimum import engines
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
from gonio.geometry import FloatArray
from gonio.models import Model
from gonio.samples import BRDFSamples

ROUNDS = 30  # in which weights from the fitted values settle
SETTLED = 1e-6  # relative change of every weight that ends them
LAW_ROUNDS = 4  # in which weights settle that follow the fitted values in place of the readings


def find_minimum(
    samples: BRDFSamples,
    model: Model,
    *,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    threads: int | None = None,
    engine: Engine | None = engines.SEARCH,
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
    if problem.weights == "sd":
        problem = problem.with_noise_law(candidates[0].p)
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


def reweighted_minimum(
    problem: Problem, optimum: Optimum, *, search: bool = True
) -> tuple[Problem, Optimum]:
    """Weights from the model's values need the model first: a few rounds settle them.

    `search` is that of `minimise`.
    """
    if problem.weights_follow_model:
        by_law = any(law is not None for law in problem.noise_laws)
        rounds = LAW_ROUNDS if by_law else 2 if problem.weights == "sd" else ROUNDS
        for _ in range(rounds):
            before = problem.inverse_variance
            problem = problem.reweighted(optimum.p)
            optimum = minimise(problem, optimum.p, search=search, near=True)
            if settled(problem, before):
                break
    return problem, optimum


def settled(problem: Problem, before: FloatArray) -> bool:
    """Whether the weights stand still: no other fit would follow from them."""
    change = np.abs(problem.inverse_variance - before)
    return problem.weights != "sd" and bool(np.all(change <= SETTLED * before))


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
