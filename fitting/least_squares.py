"""`fit`: BRDF samples and a model to parameters with honest uncertainties."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy import stats

from gonio import __version__
from gonio.errors import DataError
from gonio.fitting import optimise, uncertainty
from gonio.fitting.optimise import Optimum
from gonio.fitting.problem import Problem, Weights
from gonio.fitting.result import Estimate, FitResult
from gonio.geometry import FloatArray
from gonio.models import Model, Parameter
from gonio.models import get as get_model
from gonio.samples import BRDFSamples

MISFIT = 1.5  # chi2/dof above which the model, not the noise, decides the residuals
LEVELS = (0.6826895, 0.95)  # of the intervals
CHI2_95 = 3.841459  # 95 % quantile of chi-squared with one degree of freedom

Progress = Callable[[int, int], None]


def fit(
    samples: BRDFSamples,
    *,
    model: str | Model,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    posterior: bool = False,
    draws: str | Path | None = None,
    seed: int = 0,
    threads: int | None = None,
    cuts: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a model to BRDF samples.

    Parameters
    ----------
    samples : BRDFSamples
        The model is integrated over their cells where they have them.
    model : str or Model
    weights : {"sd", "none", "cos", "coscos"}, optional
        What residuals are multiplied by; "sd" where the samples have uncertainties.
    start : mapping, optional
        Starting values (radians for angles) in place of those that the data suggest. Where they
        lead to a bound or to no verified minimum, the data are asked after all.
    posterior : bool
        Sample the posterior with emcee; its quantiles become the intervals.
    draws : path, optional
        Where to write the draws (netCDF, group "posterior").
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
        For an unknown model, weights or starting value.
    DataError
        If there are not more samples than parameters, or a posterior is asked for where there
        is no noise.

    Notes
    -----
    Independent errors set the weights; errors that samples share (the standard, the lamp, the
    mapping) are propagated to the parameters linearly and added, not learnt from the data.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> theta = np.linspace(0, 1.2, 20)
    >>> samples = BRDFSamples(Directions(0.3 * np.ones(20), 0.0, theta, 0.0), 0.1 + 0 * theta)
    >>> round(fit(samples, model="lambert").parameters["rho"].value, 6)
    0.314159
    """
    chosen = get_model(model) if isinstance(model, str) else model
    found = find_minimum(samples, chosen, weights=weights, start=start, threads=threads)
    problem, optimum, doubts, faults = found.problem, found.optimum, found.doubts, found.faults
    chi2, dof, scale = found.chi2, found.dof, found.noise_scale
    errors, undetected = uncertainties(problem, optimum, scale)
    warnings = _warnings(problem, optimum, errors, chi2, dof, faults) + doubts + undetected
    estimates, bound_warnings = _estimates(problem, optimum, errors, dof)
    warnings += bound_warnings
    summary = None
    if posterior:
        from gonio.fitting import posterior as sampler

        if scale == 0:
            raise DataError(
                "the model leaves no residuals and the samples state no uncertainty: there is no "
                "noise to sample a posterior with; give u_brdf or fit without a posterior."
            )

        chain = sampler.sample(problem, optimum, errors, seed=seed, progress=progress)
        summary = chain.summary(None if draws is None else str(draws))
        estimates = _with_quantiles(chosen, estimates, chain.draws)
        if draws is not None:
            chain.save(Path(draws), chosen)
        if not chain.converged:
            warnings.append(
                f"the posterior has not converged (R-hat {summary.r_hat:.3f}, "
                f"{chain.n_steps} steps, tau {summary.tau:.0f}): its intervals are provisional."
            )
        warnings += chain.warnings
    return FitResult(
        model=chosen.name,
        status=found.status,
        parameters=estimates,
        covariance=_covariance(chosen.parameters, errors),
        chi2=chi2,
        dof=dof,
        noise_scale=scale,
        n_samples=problem.n,
        n_negative=samples.n_negative,
        weights=problem.weights,
        seed=seed,
        cuts=dict(cuts or {}),
        posterior=summary,
        warnings=tuple(warnings),
        diagnostics={
            "evaluations": optimum.evaluations,
            "history": list(samples.history),
            "priors": {q.name: [q.to_file(q.lower), q.to_file(q.upper)] for q in chosen.parameters}
            if posterior
            else None,
        },
        **provenance(samples),
    )


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
    """

    problem: Problem
    optimum: Optimum
    doubts: list[str]
    faults: list[str]
    chi2: float
    dof: int
    noise_scale: float

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
) -> Minimum:
    """The deepest minimum found and its goodness, without uncertainties; arguments as of `fit`."""
    problem = Problem.from_samples(samples, model, weights, threads)
    problem, optimum, doubts = _find(problem, start)
    faults = optimise.gradient_faults(problem, optimum.p)
    return Minimum(problem, optimum, doubts, faults, *_goodness(problem, optimum))


def uncertainties(
    problem: Problem, optimum: Optimum, noise_scale: float
) -> tuple[uncertainty.Uncertainty, list[str]]:
    """Covariance at a minimum, without parameters of a lobe that may as well not be there.

    The list tells of each such lobe.
    """
    errors = uncertainty.evaluate(problem, optimum, noise_scale)
    return _without_undetected(problem, optimum, errors)


def provenance(samples: BRDFSamples) -> dict[str, Any]:
    """What a result says of its origin: versions of the programs, and the data."""
    return {
        "versions": _versions(),
        "source": {"data_sha256": _data_hash(samples), **samples.metadata},
    }


def _find(
    problem: Problem, start: Mapping[str, float] | None
) -> tuple[Problem, Optimum, list[str]]:
    """The deepest minimum found, the problem with its weights, and what to know about it."""
    if start is not None:
        candidates = [problem.vector(start)]
    else:
        candidates = optimise.starts(problem)
    problem, optimum = _settled(problem, optimise.minimise(problem, candidates[0]))
    doubts = []
    for candidate in candidates[1:]:
        other = optimise.minimise(problem, candidate)
        deepest = optimise.better(optimum, other)
        if deepest is optimum:
            doubts += _rival(problem, optimum, other)
        else:
            doubts += _rival(problem, other, optimum)
            problem, optimum = _settled(problem, other)
    if not optimum.verified:
        optimum, told = _without_spikes(problem, optimum)
        doubts = told or doubts
    return problem, optimum, doubts


def _settled(problem: Problem, optimum: Optimum) -> tuple[Problem, Optimum]:
    """Weights from the model's values need the model first: two rounds settle them."""
    if problem.weights == "sd" and problem.samples.noise_slope is not None:
        for _ in range(2):
            problem = problem.reweighted(optimum.p)
            optimum = optimise.minimise(problem, optimum.p)
    return problem, optimum


def _rival(problem: Problem, optimum: Optimum, other: Optimum) -> list[str]:
    """A warning where another minimum, far from the deepest, fits almost as well."""
    noise = _goodness(problem, optimum)[2]
    step = other.p - optimum.p
    apart = float(step @ optimum.curvature @ step) > 25 * noise**2
    apart = apart and bool(np.all(np.diag(optimum.curvature) > 0))
    if not (apart and other.verified and other.chi2 - optimum.chi2 < CHI2_95 * noise**2):
        return []
    place = ", ".join(
        f"{q.name} = {q.to_file(float(v)):.4g}"
        for q, v in zip(problem.parameters, other.p, strict=True)
    )
    return [f"the data hardly prefer this minimum to another one at {place}."]


def _without_spikes(problem: Problem, optimum: Optimum) -> tuple[Optimum, list[str]]:
    """The fit without a lobe that only follows single noisy samples.

    The largest of N squared normal deviates is about 2 ln N; a lobe narrow enough to meet one
    sample alone lowers chi-squared by as much, in a valley without a bottom.
    """
    noise = max(_goodness(problem, optimum)[2], 1e-300)
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
        null = optimise.at_lower(problem, optimum, j)
        lost = (np.diag(null.curvature) <= 0) & determined
        gain = max(null.chi2 - optimum.chi2, 0.0) / max(errors.noise_scale, 1e-300) ** 2
        if gain < CHI2_95 and lost.any():
            names = [r.name for k, r in enumerate(problem.parameters) if lost[k]]
            determined[lost] = False
            warnings.append(
                f"{q.name} may as well be {q.to_file(q.lower):.4g} (chi2 grows by {gain:.2g}): "
                f"{' and '.join(names)} would then mean nothing."
            )
    return replace(errors, determined=determined), warnings


def _goodness(problem: Problem, optimum: Optimum) -> tuple[float, int, float]:
    """chi2, degrees of freedom, and the factor on the independent uncertainties.

    Where the samples state their uncertainty the factor is 1, or sqrt(chi2/dof) where the
    residuals are larger than it explains (Birge's ratio); otherwise the scatter of the weighted
    residuals is the only measure of the noise.
    """
    dof = problem.n - int(np.count_nonzero(optimum.free))
    f = problem.values(optimum.p)
    residual = problem.samples.value - f
    if problem.weights == "sd":
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
    for j, q in enumerate(problem.parameters):
        value = float(optimum.p[j])
        if value in (q.lower, q.upper):
            estimates[q.name], text = _at_bound(problem, optimum, j, errors.noise_scale)
            warnings.append(text)
            continue
        estimate = Estimate(q.to_file(value), None, q.file_unit, None, None, None)
        if errors.determined[j]:
            estimate = _inside(problem, optimum, errors, j, quantiles)
        if estimate.interval_95 is None:
            warnings.append(
                f"{q.name} is not determined by these data: its value is arbitrary and it has no "
                "uncertainty; measure other directions or hold the model simpler."
            )
        estimates[q.name] = estimate
    return estimates, warnings


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
    for t in quantiles:
        ends = []
        for side, bound in ((-1, q.lower), (1, q.upper)):
            end: float | None = value + side * t * stderr
            if side * (value + side * t * stderr - bound) >= 0:
                increase = (t * errors.noise_scale) ** 2
                end = uncertainty.profile_limit(problem, optimum, j, increase, side=side)
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


def _at_bound(problem: Problem, optimum: Optimum, j: int, scale: float) -> tuple[Estimate, str]:
    """A parameter at its bound: one-sided limits from the profile of chi-squared, no stderr."""
    q = problem.parameters[j]
    value = float(optimum.p[j])
    at_bound: Literal["lower", "upper"] = "lower" if value == q.lower else "upper"
    side = 1 if at_bound == "lower" else -1
    limits = [
        uncertainty.profile_limit(problem, optimum, j, increase * scale**2, side=side)
        for increase in (1.0, CHI2_95)
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
    model: Model,
    estimates: Mapping[str, Estimate],
    draws: FloatArray,
) -> dict[str, Estimate]:
    """Intervals from the posterior's quantiles: central, or one-sided where a bound is near.

    A central interval would exclude a bound that the data do not exclude.
    """
    result = {}
    flat = draws.reshape(-1, draws.shape[-1])
    for j, q in enumerate(model.parameters):
        estimate = estimates[q.name]
        ends = estimate.interval_95 or (np.nan, np.nan)
        near = [ends[0] <= q.to_file(q.lower), ends[1] >= q.to_file(q.upper)]
        if estimate.at_bound is not None:
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


def _warnings(
    problem: Problem,
    optimum: Optimum,
    errors: uncertainty.Uncertainty,
    chi2: float,
    dof: int,
    faults: list[str],
) -> list[str]:
    warnings = []
    if not optimum.verified:
        warnings.append("the minimum was not reached: the next step would still change the fit.")
    warnings += [
        f"the derivative by {name} that {problem.name} gives is not that of its formula: "
        "the fit cannot be trusted until the model's kernel is mended."
        for name in faults
    ]
    if problem.weights == "sd" and chi2 / dof > MISFIT:
        warnings.append(
            f"chi2/dof is {chi2 / dof:.3g}: the model or effects it does not hold, not the noise, "
            "make the residuals; the independent uncertainties were multiplied by "
            f"{errors.noise_scale:.3g}."
        )
    if problem.samples.n_negative:
        warnings.append(
            f"{problem.samples.n_negative} of {problem.n} values are negative; they were kept as "
            "noise around zero."
        )
    return warnings


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
