"""The least-squares minimum of a model: searched, settled, compared with rivals, and how good."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gonio.fitting.diagnostics.diagnose import usable
from gonio.fitting.minimum import gauss_newton, starting_values
from gonio.fitting.minimum.gauss_newton import Optimum
from gonio.fitting.problem.joint import JointProblem
from gonio.fitting.problem.losses import CHI2
from gonio.fitting.problem.nuisance import NuisanceProblem
from gonio.fitting.problem.problem import Problem, Weights
from gonio.fitting.result import PartFit, Sharing
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.models import Model
from gonio.samples import BRDFSamples

MISFIT = 1.5  # chi2/dof above which the model, not the noise, decides the residuals
SCALE_ROUNDS = 8  # in which a robust scale of the noise settles
CHI2_95 = 3.841459  # 95 % quantile of chi-squared with one degree of freedom


@dataclass(frozen=True)
class Minimum:
    """Where the least squares of a model lie, and how well it fits there.

    Parameters
    ----------
    problem : Problem
        With the weights that the minimum was found with.
    optimum : Optimum
    doubts : list of str
        A rival minimum, or a lobe that was taken out.
    faults : list of str
        Parameters whose derivative is not that of the model.
    chi2, dof, noise_scale : float, int, float
        As `FitResult` has them.
    parts : tuple of PartFit
        Of a joint fit.
    sharing : Sharing or None
        Of a joint fit.
    """

    problem: Problem
    optimum: Optimum
    doubts: list[str]
    faults: list[str]
    chi2: float
    dof: int
    noise_scale: float
    parts: tuple[PartFit, ...] = ()
    sharing: Sharing | None = None

    @property
    def status(self) -> Literal["converged", "not_converged"]:
        """Whether the optimum passed its checks."""
        return "converged" if self.optimum.verified and not self.faults else "not_converged"


def find_minimum(
    samples: BRDFSamples,
    model: Model,
    *,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    threads: int | None = None,
    engine: gauss_newton.Engine | None = None,
    loss: str = CHI2.name,
) -> Minimum:
    """The deepest minimum found and its goodness, without uncertainties; arguments as of `fit`.

    `engine` is what `engines.get` gives.
    """
    problem = Problem.from_samples(usable(samples), model, weights, threads, loss)
    problem, optimum, doubts = _find(problem, start, engine)
    faults = gauss_newton.gradient_faults(problem, optimum.p)
    return Minimum(problem, optimum, doubts, faults, *goodness(problem, optimum))


def uncertainties(
    problem: Problem, optimum: Optimum, noise_scale: float
) -> tuple[uncertainty.Uncertainty, list[str]]:
    """Covariance at a minimum, without parameters of a lobe that may as well not be there.

    The list tells of each such lobe.
    """
    if isinstance(problem, NuisanceProblem):
        errors = uncertainty.evaluate(
            problem, optimum, noise_scale, changes=problem.changes(optimum.p), learnt=problem.learnt
        )
    else:
        errors = uncertainty.evaluate(problem, optimum, noise_scale)
        if isinstance(problem, JointProblem):
            from gonio.fitting.minimum.joint_fit import alike

            errors = alike(problem, optimum, errors)
    return _without_undetected(problem, optimum, errors)


def _find(
    problem: Problem, start: Mapping[str, float] | None, engine: gauss_newton.Engine | None
) -> tuple[Problem, Optimum, list[str]]:
    """The deepest minimum found, the problem with its weights, and what to know about it."""
    found = gauss_newton.minima(problem, engine)
    doubts = []
    if start is not None:
        given = gauss_newton.minimise(problem, problem.vector(start), engine=engine)
        if gauss_newton.better(given, found[0]) is given:
            found = [given]
        elif given.verified:
            doubts.append(
                f"the start led to another minimum, at {place(problem, given)}, where chi2 is "
                f"{given.chi2 / max(found[0].chi2, 1e-300):.3g} times that of the minimum that was "
                "taken."
            )
    problem, optimum = settled(problem, found[0])
    for other in found[1:]:
        if problem.settles:
            other = gauss_newton.minimise(problem, other.p, search=False)
        deepest = gauss_newton.better(optimum, other)
        doubts += rival(problem, deepest, optimum if deepest is other else other)
        if deepest is other:
            problem, optimum = settled(problem, other)
    if not optimum.verified:
        optimum, told = without_spikes(problem, optimum)
        doubts = told or doubts
    return problem, optimum, doubts


def settled(problem: Problem, optimum: Optimum) -> tuple[Problem, Optimum]:
    """Weights from the model's values need the model first: a few rounds settle them."""
    if problem.settles:
        for _ in range(SCALE_ROUNDS if problem.finds_scale else 2):
            problem = problem.reweighted(optimum.p)
            optimum = gauss_newton.minimise(problem, optimum.p, near=True)
    return problem, optimum


def rival(problem: Problem, optimum: Optimum, other: Optimum) -> list[str]:
    """A warning where another minimum, far from the deepest, fits almost as well."""
    noise = goodness(problem, optimum)[2]
    step = starting_values.ordered(problem, other.p) - starting_values.ordered(problem, optimum.p)
    apart = float(step @ optimum.curvature @ step) > 25 * noise**2
    apart = apart and bool(np.all(np.diag(optimum.curvature) > 0))
    if not (apart and other.verified and other.chi2 - optimum.chi2 < CHI2_95 * noise**2):
        return []
    return [f"the data hardly prefer this minimum to another one at {place(problem, other)}."]


def place(problem: Problem, optimum: Optimum) -> str:
    """Parameters at a minimum, in file units, as text."""
    return ", ".join(
        f"{q.name} = {q.to_file(float(v)):.4g}"
        for q, v in zip(problem.parameters, optimum.p, strict=True)
    )


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
        null = gauss_newton.at_lower(problem, optimum, j)
        gain = (null.chi2 - optimum.chi2) / noise**2
        if null.verified and gain < expected:
            return null, [
                f"{q.name} was set to its bound: with it the fit only followed the noise of "
                f"single samples (chi2 smaller by {gain:.2g}; noise alone gives up to about "
                f"{expected:.2g})."
            ]
    return optimum, []


def _without_undetected(
    problem: Problem, optimum: Optimum, errors: uncertainty.Uncertainty
) -> tuple[uncertainty.Uncertainty, list[str]]:
    """Parameters of a lobe whose amplitude may be zero have no uncertainty."""
    determined = errors.determined.copy()
    warnings = []
    for j, q in enumerate(problem.parameters):
        sd = np.sqrt(errors.covariance[j, j])
        if not (q.linear and errors.determined[j] and optimum.p[j] - q.lower < 4 * sd):
            continue
        small, at, place = uncertainty.around(problem, optimum, j)
        null = gauss_newton.at_lower(small, at, int(np.flatnonzero(place == j)[0]))
        lost = np.zeros_like(determined)
        lost[place] = (np.diag(null.curvature) <= 0) & determined[place]
        gain = max(null.chi2 - at.chi2, 0.0) / max(errors.noise_scale, 1e-300) ** 2
        if gain < CHI2_95 and lost.any():
            names = [r.name for k, r in enumerate(problem.parameters) if lost[k]]
            determined[lost] = False
            warnings.append(
                f"{q.name} may as well be {q.to_file(q.lower):.4g} (chi2 grows by {gain:.2g}): "
                f"{' and '.join(names)} would then mean nothing."
            )
    return replace(errors, determined=determined), warnings


def goodness(problem: Problem, optimum: Optimum) -> tuple[float, int, float]:
    """chi2, degrees of freedom, and the factor on the independent uncertainties.

    Where the samples state their uncertainty the factor is 1, or sqrt(chi2/dof) where the
    residuals are larger than it explains (Birge's ratio); otherwise the scatter of the weighted
    residuals is the only measure of the noise.
    """
    dof = problem.n - int(np.count_nonzero(optimum.free))
    if not problem.quadratic:
        known = problem.law.likelihood
        return optimum.chi2, dof, 1.0 if known else float(np.sqrt(optimum.chi2 / dof))
    if problem.weights == "sd":
        f = problem.values(optimum.p)
        residual = problem.samples.value - f
        chi2 = float(np.sum(residual**2 / problem.variance(f)))
        return chi2, dof, float(np.sqrt(max(1.0, chi2 / dof)))
    return optimum.chi2, dof, float(np.sqrt(optimum.chi2 / dof))
