"""`fit`: BRDF samples and a model to parameters with honest uncertainties."""

from __future__ import annotations

import hashlib
import platform
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy import stats

from gonio import __version__
from gonio.errors import ConfigurationError, DataError
from gonio.fitting import engines, losses, optimise, scan, uncertainty
from gonio.fitting import nuisance as shared_errors
from gonio.fitting.diagnose import diagnose, usable
from gonio.fitting.joint import JointProblem
from gonio.fitting.limits import excluded
from gonio.fitting.limits import limit as bound_limit
from gonio.fitting.losses import CHI2, Loss
from gonio.fitting.nuisance import Nuisance, NuisanceProblem
from gonio.fitting.optimise import Optimum
from gonio.fitting.priors import Prior, resolve
from gonio.fitting.problem import Problem, Weights
from gonio.fitting.result import Estimate, FitResult, NuisanceEstimate, PartFit, Sharing
from gonio.geometry import FloatArray
from gonio.models import Model, Parameter
from gonio.models import get as get_model
from gonio.samples import BRDFSamples

if TYPE_CHECKING:  # emcee is slow to import
    from gonio.fitting.posterior import Chain, Sampler

MISFIT = 1.5  # chi2/dof above which the model, not the noise, decides the residuals
LEVELS = (0.6826895, 0.95)  # of the intervals
ROUNDING = 1e-13  # of the root mean square of the data: residuals that are rounding
NEAR_BOUND = 2  # half-widths of an interval within which a bound is asked for by itself
ALIKE = 3  # warnings that parts of a joint fit give alike, told one by one
RESTARTS = 2  # times that a posterior may lead to a deeper minimum
NO_DEEPER = 1e-3  # of the noise squared: as deep, but for rounding
SCALE_ROUNDS = 8  # in which a robust scale of the noise settles
CHI2_95 = 3.841459  # 95 % quantile of chi-squared with one degree of freedom

Progress = Callable[[int, int], None]


def fit(
    samples: BRDFSamples | Sequence[BRDFSamples] | Mapping[str, BRDFSamples],
    *,
    model: str | Model,
    share: str | Sequence[str] | None = None,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    engine: str = engines.DEFAULT,
    loss: str = CHI2.name,
    nuisance: Nuisance = "none",
    posterior: bool = False,
    draws: str | Path | None = None,
    sampler: Literal["auto", "marginal", "emcee"] = "auto",
    priors: Mapping[str, str | Prior] | None = None,
    seed: int = 0,
    threads: int | None = None,
    cuts: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a model to BRDF samples.

    Parameters
    ----------
    samples : BRDFSamples, or with `share` a sequence or mapping of them
        The model is integrated over their cells where they have them.
    model : str or Model
    share : sequence of str, optional
        Parameters that all channels, wavelengths and materials of the samples have in common: they
        are fitted together, each with its own values of the others, named `rho_d[650 nm]`,
        `rho_d[red]` or `rho_d[paint_a]`. An empty sequence shares nothing. Names may stand in one
        text, with commas.
    weights : {"sd", "none", "cos", "coscos"}, optional
        What residuals are multiplied by; "sd" where the samples have uncertainties.
    start : mapping, optional
        Starting values (radians for angles) beside those that the data suggest. Where these lead
        to a deeper minimum, it is taken and the other one is told of.
    engine : str
        What searches for the minimum before the Gauss-Newton steps in which every fit ends:
        "gauss_newton" (nothing else), "slsqp", "lbfgs", "mma", "bobyqa", "sbplx" or "mlsl".
    loss : {"chi2", "log", "cube_root", "student_t"}
        What is made small: the sum of squared weighted residuals, squared differences of
        ln(1 + f cos theta_r) or of (f cos theta_r)^(1/3), or Student's t, which outliers hardly
        move.
    nuisance : {"none", "all"} or sequence of str
        Shared errors of the samples that the data may tell of, by name: each draw is an unknown of
        the fit whose prior the budget states. The others are propagated.
    posterior : bool
        Sample the posterior; its quantiles become the intervals.
    draws : path, optional
        Where to write the draws and what they predict (netCDF, as arviz opens it).
    sampler : {"auto", "marginal", "emcee"}
        The posterior's sampler; emcee takes over where the guard of the quicker marginal sampler
        refuses it.
    priors : mapping of str to str, optional
        Priors in place of those that parameters declare, in the unit of files: "flat", "log",
        "normal(mean, sd)", "lognormal(median, factor)" or "half_normal(sd)". They enter the
        posterior alone.
    seed : int
        Seed of the sampler, the only random step.
    threads : int, optional
        The result does not depend on it.
    cuts : mapping, optional
        Selections made before, to be stated in the result.
    progress : callable, optional
        Called with (steps done, steps in all) while the posterior is sampled.

    Returns
    -------
    FitResult
        With values in the unit of files (degrees for angles).

    Raises
    ------
    ConfigurationError
        For an unknown model, weights, starting value or name to share, or samples of one channel
        with something to share.
    DataError
        If there are not more samples than parameters, or a posterior is asked for where there
        is no noise.

    Notes
    -----
    Independent errors set the weights; errors that samples share (the standard, the lamp, the
    mapping) are propagated to the parameters linearly and added, not learnt from the data, unless
    `nuisance` names them.

    With `share` every part counts by its own noise: its independent uncertainties are multiplied
    by what its fit alone needs (Birge's ratio). The growth of chi-squared over separate fits tells
    whether the parts share what they should (`FitResult.sharing`).

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> theta = np.linspace(0, 1.2, 20)
    >>> samples = BRDFSamples(Directions(0.3 * np.ones(20), 0.0, theta, 0.0), 0.1 + 0 * theta)
    >>> round(fit(samples, model="lambert").parameters["rho"].value, 6)
    0.314159
    """
    chosen = get_model(model) if isinstance(model, str) else model
    if share is None:
        resolve(chosen.parameters, priors)  # before anything takes long
    searched_by, law = engines.get(engine, seed), losses.get(loss)
    _check_combination(law, posterior, share is not None or nuisance != "none", engine)
    options: dict[str, Any] = {"weights": weights, "start": start, "threads": threads}
    if share is None:
        options |= {"engine": searched_by, "loss": loss}
    found = _minimum(samples, chosen, share, **options)
    found = _learnt(found, shared_errors.chosen(found.problem.samples, nuisance))
    chain = None
    if posterior:
        found, chain = _sampled(found, priors, seed=seed, sampler=sampler, progress=progress)
    problem, optimum, doubts = found.problem, found.optimum, found.doubts
    chi2, dof, scale = found.chi2, found.dof, found.noise_scale
    errors, undetected = uncertainties(problem, optimum, scale)
    warnings = _warnings(found, errors) + doubts
    estimates, bound_warnings = _estimates(problem, optimum, errors, dof)
    warnings += _condensed(undetected + bound_warnings)
    # What residuals should look like is known for chi-squared alone.
    diagnostics, diagnosed = diagnose(problem, optimum, scale) if problem.quadratic else ({}, [])
    warnings += diagnosed
    told: tuple[NuisanceEstimate, ...] = ()
    if isinstance(problem, NuisanceProblem):
        told = shared_errors.estimates(problem, optimum)
        warnings += shared_errors.pull_warnings(told)
    summary = None
    if chain is not None:
        summary = chain.summary(problem.parameters, None if draws is None else str(draws))
        estimates = _with_quantiles(problem.parameters, estimates, chain.draws)
        if draws is not None:
            from gonio.fitting import predictive

            predictive.save(chain, Path(draws), problem, scale=scale, seed=seed)
        if not chain.converged:
            warnings.append(
                f"the posterior has not converged (R-hat {summary.r_hat:.3f}, "
                f"{chain.n_steps} steps, tau {summary.tau:.0f}, effective draws "
                f"{summary.ess:.0f} in the bulk and {summary.ess_tail:.0f} in the tails): its "
                "intervals are provisional."
            )
        warnings += chain.warnings
    return FitResult(
        model=chosen.name,
        status=found.status,
        parameters=estimates,
        covariance=None if noiseless(problem, scale) else _covariance(problem.parameters, errors),
        chi2=chi2,
        dof=dof,
        noise_scale=scale,
        n_samples=problem.n,
        n_negative=problem.samples.n_negative,
        weights=problem.weights,
        seed=seed,
        cuts=dict(cuts or {}),
        posterior=summary,
        warnings=tuple(warnings),
        diagnostics={
            "evaluations": optimum.evaluations,
            "history": list(problem.samples.history),
            **diagnostics,
            "priors": {q.name: [q.to_file(q.lower), q.to_file(q.upper)] for q in problem.parameters}
            if posterior
            else None,
        },
        parts=found.parts,
        sharing=found.sharing,
        nuisance=told,
        engine=engine,
        loss=loss,
        **provenance(problem.samples),
    )


def _sampled(
    found: Minimum,
    priors: Mapping[str, str | Prior] | None,
    *,
    seed: int,
    sampler: Sampler,
    progress: Progress | None,
) -> tuple[Minimum, Chain]:
    """The posterior, and the minimum where its draws led to a deeper one.

    Raises
    ------
    DataError
        Where there is no noise.
    """
    from gonio.fitting import posterior as posteriors

    if found.noise_scale == 0:
        raise DataError(
            "the model leaves no residuals and the samples state no uncertainty: there is no "
            "noise to sample a posterior with; give u_brdf or fit without a posterior."
        )
    believed = resolve(found.problem.parameters, priors)
    for _ in range(RESTARTS + 1):
        errors, _ = uncertainties(found.problem, found.optimum, found.noise_scale)
        chain = posteriors.sample(
            found.problem, found.optimum, errors, seed=seed, sampler=sampler, priors=believed,
            progress=progress,
        )  # fmt: skip
        deeper = _deeper_by_draws(found, chain)
        if deeper is None:
            break
        found = deeper
        if not deeper.optimum.verified:
            break
    return found, chain


def _deeper_by_draws(found: Minimum, chain: Chain) -> Minimum | None:
    """The minimum below the best draw where it is deeper; unverified where it cannot be taken."""
    best = chain.draws.reshape(-1, chain.draws.shape[-1])[int(np.argmax(chain.log_density))]
    problem, optimum = found.problem, found.optimum
    other = optimise.minimise(problem, best, search=False)
    if not other.verified or optimum.chi2 - other.chi2 <= NO_DEEPER * found.noise_scale**2:
        return None
    if type(problem) is not Problem:
        told = "the posterior holds a deeper minimum, which the search did not find."
        return replace(
            found, optimum=replace(optimum, verified=False), doubts=[*found.doubts, told]
        )
    problem, other = _settled(problem, other)
    told = (
        f"the search found a minimum at {_place(problem, optimum)}; the posterior led to a deeper "
        "one, which was taken."
    )
    faults = optimise.gradient_faults(problem, other.p)
    return Minimum(problem, other, [told], faults, *goodness(problem, other))


def _check_combination(law: Loss, posterior: bool, several: bool, engine: str) -> None:
    """Refuse what one loss or engine cannot do.

    Raises
    ------
    ConfigurationError
    """
    if posterior and not law.likelihood:
        raise ConfigurationError(
            f"loss {law.name!r} is no likelihood, so that it has no posterior; fit without one, or "
            "use loss chi2 or student_t.",
            value=law.name,
        )
    if several and (law is not CHI2 or engine != engines.DEFAULT):
        raise ConfigurationError(
            f"share and nuisance take loss {CHI2.name!r} and engine {engines.DEFAULT!r} alone, not "
            f"{law.name!r} and {engine!r}; leave these or those out.",
            value=(law.name, engine),
        )


def _minimum(
    samples: BRDFSamples | Sequence[BRDFSamples] | Mapping[str, BRDFSamples],
    model: Model,
    share: str | Sequence[str] | None,
    **options: Any,
) -> Minimum:
    """The minimum for one BRDF, or for several that share parameters."""
    if share is not None:
        from gonio.fitting.joint_fit import find_joint_minimum

        words = share.split(",") if isinstance(share, str) else share
        names = [word.strip() for word in words if word.strip()]
        return find_joint_minimum(samples, model, names, **options)
    if not isinstance(samples, BRDFSamples):
        raise ConfigurationError(
            "several samples are fitted together with 'share', the names of the parameters that "
            "they have in common; an empty one shares nothing."
        )
    return find_minimum(samples, model, **options)


def _learnt(found: Minimum, names: tuple[str, ...]) -> Minimum:
    """The minimum with these shared errors learnt; chi-squared counts their draws as well."""
    if not names:
        return found
    problem, optimum, doubts = shared_errors.learnt_fit(found.problem, found.optimum, names)
    if not optimum.verified:
        optimum, told = without_spikes(problem, optimum)
        doubts = told or doubts
    chi2, dof, _ = goodness(problem, optimum)
    if problem.weights == "sd":
        chi2 += float(problem.z0 @ problem.z0)
    return replace(
        found, problem=problem, optimum=optimum, doubts=found.doubts + doubts, chi2=chi2, dof=dof,
        noise_scale=problem.noise,
    )  # fmt: skip


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
    engine: optimise.Engine | None = None,
    loss: str = CHI2.name,
) -> Minimum:
    """The deepest minimum found and its goodness, without uncertainties; arguments as of `fit`.

    `engine` is what `engines.get` gives.
    """
    problem = Problem.from_samples(usable(samples), model, weights, threads, loss)
    problem, optimum, doubts = _find(problem, start, engine)
    faults = optimise.gradient_faults(problem, optimum.p)
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
            from gonio.fitting.joint_fit import alike

            errors = alike(problem, optimum, errors)
    return _without_undetected(problem, optimum, errors)


def provenance(samples: BRDFSamples) -> dict[str, Any]:
    """What a result says of its origin: versions of the programs, and the data."""
    return {
        "versions": _versions(),
        "source": {"data_sha256": _data_hash(samples), **samples.metadata},
    }


def _find(
    problem: Problem, start: Mapping[str, float] | None, engine: optimise.Engine | None
) -> tuple[Problem, Optimum, list[str]]:
    """The deepest minimum found, the problem with its weights, and what to know about it."""
    found = optimise.minima(problem, engine)
    doubts = []
    if start is not None:
        given = optimise.minimise(problem, problem.vector(start), engine=engine)
        if optimise.better(given, found[0]) is given:
            found = [given]
        elif given.verified:
            doubts.append(
                f"the start led to another minimum, at {_place(problem, given)}, where chi2 is "
                f"{given.chi2 / max(found[0].chi2, 1e-300):.3g} times that of the minimum that was "
                "taken."
            )
    problem, optimum = _settled(problem, found[0])
    for other in found[1:]:
        if problem.settles:
            other = optimise.minimise(problem, other.p, search=False)
        deepest = optimise.better(optimum, other)
        doubts += rival(problem, deepest, optimum if deepest is other else other)
        if deepest is other:
            problem, optimum = _settled(problem, other)
    if not optimum.verified:
        optimum, told = without_spikes(problem, optimum)
        doubts = told or doubts
    return problem, optimum, doubts


def _settled(problem: Problem, optimum: Optimum) -> tuple[Problem, Optimum]:
    """Weights from the model's values need the model first: a few rounds settle them."""
    if problem.settles:
        for _ in range(SCALE_ROUNDS if problem.finds_scale else 2):
            problem = problem.reweighted(optimum.p)
            optimum = optimise.minimise(problem, optimum.p, near=True)
    return problem, optimum


def rival(problem: Problem, optimum: Optimum, other: Optimum) -> list[str]:
    """A warning where another minimum, far from the deepest, fits almost as well."""
    noise = goodness(problem, optimum)[2]
    step = scan.ordered(problem, other.p) - scan.ordered(problem, optimum.p)
    apart = float(step @ optimum.curvature @ step) > 25 * noise**2
    apart = apart and bool(np.all(np.diag(optimum.curvature) > 0))
    if not (apart and other.verified and other.chi2 - optimum.chi2 < CHI2_95 * noise**2):
        return []
    place = _place(problem, other)
    return [f"the data hardly prefer this minimum to another one at {place}."]


def _place(problem: Problem, optimum: Optimum) -> str:
    """Parameters at a minimum, in file units."""
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
        null = optimise.at_lower(problem, optimum, j)
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
        null = optimise.at_lower(small, at, int(np.flatnonzero(place == j)[0]))
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


def _estimates(
    problem: Problem, optimum: Optimum, errors: uncertainty.Uncertainty, dof: int
) -> tuple[dict[str, Estimate], list[str]]:
    """Every parameter with its standard uncertainty and intervals, in file units."""
    # Where the scatter stands for the noise, few degrees of freedom widen the intervals.
    known_noise = problem.weights == "sd"
    quantiles = [
        float(stats.norm.ppf(q) if known_noise else stats.t.ppf(q, dof))
        for q in ((1 + level) / 2 for level in LEVELS)
    ]
    estimates, warnings = {}, []
    bare = noiseless(problem, errors.noise_scale)
    if bare:
        warnings.append(
            "the model leaves no residuals beyond rounding and the samples state no uncertainty: "
            "nothing tells how uncertain the parameters are; give u_brdf."
        )
    for j, q in enumerate(problem.parameters):
        value = float(optimum.p[j])
        if value in (q.lower, q.upper):
            estimates[q.name], text = _at_bound(problem, optimum, j, errors.noise_scale)
            warnings.append(text)
            continue
        if j in optimum.limited:
            estimates[q.name] = _along_sum(problem, optimum, j, errors.noise_scale)
            continue
        estimate = Estimate(q.to_file(value), None, q.file_unit, None, None, None)
        if errors.determined[j] and bare:
            estimates[q.name] = estimate
            continue
        if errors.determined[j]:
            estimate = _inside(problem, optimum, errors, j, quantiles)
        if estimate.interval_95 is None:
            warnings.append(
                f"{q.name} is not determined by these data: its value is arbitrary and it has no "
                "uncertainty; measure other directions or hold the model simpler."
            )
        estimates[q.name] = estimate
    return estimates, warnings


def noiseless(problem: Problem, noise_scale: float) -> bool:
    """Whether rounding is all that the residuals hold and nobody stated the noise."""
    if problem.weights == "sd" or problem.samples.shared:
        return False
    size = np.sqrt(np.mean(problem.samples.value**2 * problem.inverse_variance))
    return bool(noise_scale <= ROUNDING * size)


def _inside(
    problem: Problem,
    optimum: Optimum,
    errors: uncertainty.Uncertainty,
    j: int,
    quantiles: list[float],
) -> Estimate:
    """A parameter between its bounds.

    Where an end of an interval leaves the bounds the curvature is no guide any more: that end is
    looked for on the profile of chi-squared.
    """
    q = problem.parameters[j]
    value = float(optimum.p[j])
    stderr = float(np.sqrt(errors.covariance[j, j]))
    intervals = []
    for t, level in zip(quantiles, LEVELS, strict=True):
        ends = []
        for side, bound in ((-1, q.lower), (1, q.upper)):
            end: float | None = value + side * t * stderr
            # All errors, where chi-squared counts those of the likelihood alone.
            own = errors.of_likelihood[j, j]
            unit = (errors.noise_scale * stderr) ** 2 / own if own > 0 else 0.0
            if side * (value + NEAR_BOUND * side * t * stderr - bound) >= 0 and not excluded(
                problem, optimum, j, bound, unit, level
            ):
                end = bound
            elif side * (value + side * t * stderr - bound) >= 0:
                end = bound_limit(problem, optimum, j, t**2, errors.noise_scale, side=side)
            ends.append(q.to_file(bound if end is None else end))
        intervals.append((ends[0], ends[1]))
    if intervals[1] == (q.to_file(q.lower), q.to_file(q.upper)):
        return Estimate(q.to_file(value), None, q.file_unit, None, None, None)
    components = {name: q.to_file(u) for name, u in errors.components(j).items()}
    known = stderr < q.upper - q.lower
    return Estimate(
        q.to_file(value),
        q.to_file(stderr) if known else None,
        q.file_unit,
        None,
        intervals[0],
        intervals[1],
        components if known else {},
    )


def _along_sum(problem: Problem, optimum: Optimum, j: int, scale: float) -> Estimate:
    """A reflectance whose sum with others is held at 1: it grows as far as those give way."""
    q = problem.parameters[j]
    intervals = []
    for increase in (1.0, CHI2_95):
        ends = [bound_limit(problem, optimum, j, increase, scale, side=side) for side in (-1, 1)]
        low, high = (
            bound if end is None else end
            for end, bound in zip(ends, (q.lower, q.upper), strict=True)
        )
        intervals.append((q.to_file(low), q.to_file(high)))
    return Estimate(
        q.to_file(float(optimum.p[j])), None, q.file_unit, "upper", intervals[0], intervals[1]
    )


def _at_bound(problem: Problem, optimum: Optimum, j: int, scale: float) -> tuple[Estimate, str]:
    """A parameter at its bound: one-sided limits from the profile of chi-squared, no stderr."""
    q = problem.parameters[j]
    value = float(optimum.p[j])
    at_bound: Literal["lower", "upper"] = "lower" if value == q.lower else "upper"
    side = 1 if at_bound == "lower" else -1
    limits = [
        bound_limit(problem, optimum, j, increase, scale, side=side) for increase in (1.0, CHI2_95)
    ]
    far = q.upper if side > 0 else q.lower
    intervals = []
    for limit in limits:
        low, high = sorted((value, far if limit is None else limit))
        intervals.append((q.to_file(low), q.to_file(high)))
    unit = f" {q.file_unit}" if q.file_unit else ""
    text = f"{q.name} is at its {at_bound} bound ({q.to_file(value):.4g}{unit}): "
    if limits[1] is None:
        text += "the data do not limit it."
    else:
        text += (
            f"the data do not support a value {'above' if side > 0 else 'below'} "
            f"{q.to_file(limits[1]):.3g}{unit} (95 %) and do not determine it otherwise."
        )
    return Estimate(q.to_file(value), None, q.file_unit, at_bound, intervals[0], intervals[1]), text


def _with_quantiles(
    parameters: tuple[Parameter, ...],
    estimates: Mapping[str, Estimate],
    draws: FloatArray,
) -> dict[str, Estimate]:
    """Intervals from the posterior's quantiles: central, or one-sided where a bound is near.

    A central interval would exclude a bound that the data do not exclude.
    """
    result = {}
    flat = draws.reshape(-1, draws.shape[-1])
    for j, q in enumerate(parameters):
        estimate = estimates[q.name]
        ends = estimate.interval_95 or (np.nan, np.nan)
        near = [ends[0] <= q.to_file(q.lower), ends[1] >= q.to_file(q.upper)]
        if estimate.value in (q.to_file(q.lower), q.to_file(q.upper)):
            near = [estimate.at_bound == "lower", estimate.at_bound == "upper"]
        intervals = []
        for level in LEVELS:
            if near == [True, False]:
                pair = (q.lower, float(np.quantile(flat[:, j], level)))
            elif near == [False, True]:
                pair = (float(np.quantile(flat[:, j], 1 - level)), q.upper)
            else:
                tail = (1 - level) / 2
                low, high = np.quantile(flat[:, j], [tail, 1 - tail])
                pair = (float(low), float(high))
            intervals.append((q.to_file(pair[0]), q.to_file(pair[1])))
        result[q.name] = replace(estimate, interval_68=intervals[0], interval_95=intervals[1])
    return result


def _covariance(
    parameters: tuple[Parameter, ...], errors: uncertainty.Uncertainty
) -> list[list[float]] | None:
    if not errors.determined.all():
        return None
    unit = np.array([q.to_file(1.0) for q in parameters])
    scaled = errors.covariance * np.outer(unit, unit)
    return [[float(v) for v in row] for row in scaled]


def _warnings(found: Minimum, errors: uncertainty.Uncertainty) -> list[str]:
    problem = found.problem
    warnings = []
    if not found.optimum.verified:
        warnings.append("the minimum was not reached: the next step would still change the fit.")
    if found.optimum.limited:
        names = " + ".join(problem.parameters[j].name for j in found.optimum.limited)
        warnings.append(
            f"{names} is at its bound 1, beyond which the surface would reflect more light than it "
            "receives: the data alone ask for more; their intervals are those of chi-squared along "
            "the bound."
        )
    warnings += [
        f"the derivative by {name} that {problem.name} gives is not that of its formula: "
        "the fit cannot be trusted until the model's kernel is mended."
        for name in found.faults
    ]
    known = problem.weights == "sd" and problem.quadratic and not found.parts
    if known and found.chi2 / found.dof > MISFIT:
        warnings.append(
            f"chi2/dof is {found.chi2 / found.dof:.3g}: the model or effects it does not hold, "
            "not the noise, make the residuals; the independent uncertainties were multiplied by "
            f"{errors.noise_scale:.3g}."
        )
    if problem.samples.n_negative:
        warnings.append(
            f"{problem.samples.n_negative} of {problem.n} values are negative; they were kept as "
            "noise around zero."
        )
    return warnings


def _condensed(lines: list[str]) -> list[str]:
    """Warnings that more than a few parts of a joint fit give alike, as one line each."""
    groups: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for line in lines:
        match = re.match(r"(\w+)\[(.+?)\] ([^(:]+?) ?[(:]", line)
        key = (match[1], match[3]) if match else ("", line)
        groups.setdefault(key, []).append((match[2] if match else "", line))
    told = []
    for (name, what), items in groups.items():
        if len(items) <= ALIKE:
            told += [line for _, line in items]
        else:
            told.append(f"{name} {what} in {len(items)} parts: {', '.join(p for p, _ in items)}.")
    return told


def _versions() -> dict[str, str]:
    packages = ("numpy", "scipy", "numba", "nlopt", "emcee")
    found = {name: metadata.version(name) for name in packages}
    return {"gonio": __version__, "python": platform.python_version(), **found}


def _data_hash(samples: BRDFSamples) -> str:
    digest = hashlib.sha256()
    d = samples.directions
    for array in (d.theta_i, d.phi_i, d.theta_r, d.phi_r, samples.value, samples.u_independent):
        if array is not None:
            digest.update(np.ascontiguousarray(np.broadcast_to(array, (len(samples),))).tobytes())
    return digest.hexdigest()
