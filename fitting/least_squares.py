"""`fit`: BRDF samples and a model to parameters with honest uncertainties."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from gonio import __version__
from gonio.fitting import optimise, uncertainty
from gonio.fitting.optimise import Optimum
from gonio.fitting.problem import Problem, Weights
from gonio.fitting.result import Estimate, FitResult
from gonio.geometry import FloatArray
from gonio.models import Model, Parameter
from gonio.models import get as get_model
from gonio.samples import BRDFSamples

NEAR_BOUND = 1e-9  # of the range: at a bound
MISFIT = 1.5  # chi2/dof above which the model, not the noise, decides the residuals
SAME_CHI2 = 1e-6  # relative agreement of two minima

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
        Starting values (radians for angles) in place of those that the data suggest; only the
        minimum that lies below them is looked for.
    posterior : bool
        Sample the posterior with emcee; its quantiles become the intervals.
    draws : path, optional
        Where to write the draws (netCDF, group "posterior").
    seed : int
        Seed of the start's subset and of the sampler.
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
        If there are not more samples than parameters.

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
    problem = Problem.from_samples(samples, chosen, weights, threads)
    rng = np.random.default_rng(seed)
    problem, optimum, agreed = _find(problem, start, rng)
    chi2, dof, scale = _goodness(problem, optimum)
    errors = uncertainty.evaluate(problem, optimum, scale)
    warnings = _warnings(problem, optimum, errors, chi2, dof, agreed)
    estimates, bound_warnings = _estimates(problem, optimum, errors, scale, dof)
    warnings += bound_warnings
    summary = None
    if posterior:
        from gonio.fitting import posterior as sampler

        chain = sampler.sample(problem, optimum, errors, seed=seed, progress=progress)
        summary = chain.summary(None if draws is None else str(draws))
        estimates = _with_quantiles(chosen, estimates, errors.determined, chain.draws)
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
        status="converged" if optimum.verified and agreed else "not_converged",
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
        versions=_versions(),
        source={"data_sha256": _data_hash(samples), **samples.metadata},
    )


def _find(
    problem: Problem, start: Mapping[str, float] | None, rng: np.random.Generator
) -> tuple[Problem, Optimum, bool]:
    """The minimum, the weights it was found with, and whether a second start agrees."""
    model = problem.model
    if start is not None:
        candidates = [model.vector(start)]
    else:
        candidates = optimise.starts(problem)
    # Weights from the model's values need the model first: two rounds settle them.
    optimum = optimise.minimise(problem, candidates[0])
    for _ in range(2):
        if problem.weights != "sd" or problem.samples.noise_slope is None:
            break
        problem = problem.reweighted(optimum.p)
        optimum = optimise.minimise(problem, optimum.p)
    agreed = True
    for candidate in candidates[1:]:
        other = optimise.minimise(problem, candidate)
        if other.chi2 < optimum.chi2 * (1 - SAME_CHI2):
            optimum = other
        # A second start may end in another valley; what counts is that none is deeper.
        agreed = agreed and optimum.verified
    return problem, optimum, agreed


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
    problem: Problem,
    optimum: Optimum,
    errors: uncertainty.Uncertainty,
    scale: float,
    dof: int,
) -> tuple[dict[str, Estimate], list[str]]:
    """Every parameter with its standard uncertainty and intervals, in file units."""
    # Where the scatter stands for the noise, few degrees of freedom widen the intervals.
    known_noise = problem.weights == "sd"
    quantiles = [
        float(stats.norm.ppf(q) if known_noise else stats.t.ppf(q, dof)) for q in (0.8413447, 0.975)
    ]
    covariance = errors.covariance
    estimates, warnings = {}, []
    for j, q in enumerate(problem.model.parameters):
        value = float(optimum.p[j])
        bound = _bound(q, value)
        if bound is not None:
            estimates[q.name], text = _at_bound(problem, optimum, j, bound, scale)
            warnings.append(text)
            continue
        stderr, intervals = None, [None, None]
        components: dict[str, float] = {}
        if errors.determined[j]:
            stderr = float(np.sqrt(covariance[j, j]))
            intervals = [_clipped(q, value - t * stderr, value + t * stderr) for t in quantiles]  # type: ignore[misc]
            components = {k: _width(q, u) for k, u in errors.components(j).items()}
            stderr = _width(q, stderr)
        else:
            warnings.append(
                f"{q.name} is not determined by these data: its value is arbitrary and it has no "
                "uncertainty; measure other directions or hold the model simpler."
            )
        estimates[q.name] = Estimate(
            q.to_file(value), stderr, q.file_unit, None, intervals[0], intervals[1], components
        )
    return estimates, warnings


def _at_bound(
    problem: Problem, optimum: Optimum, j: int, bound: str, scale: float
) -> tuple[Estimate, str]:
    """A parameter at its bound: one-sided limits from the profile of chi-squared, no stderr."""
    q = problem.model.parameters[j]
    side = 1 if bound == "lower" else -1
    value = float(optimum.p[j])
    intervals: list[tuple[float, float] | None] = []
    for increase in (1.0, 3.841459):
        limit = uncertainty.profile_limit(problem, optimum, j, increase * scale**2, side=side)
        far = q.upper if side > 0 else q.lower
        intervals.append(_clipped(q, *sorted((value, far if limit is None else limit))))
    assert intervals[1] is not None
    limit_95 = intervals[1][1] if side > 0 else intervals[1][0]
    unit = f" {q.file_unit}" if q.file_unit else ""
    text = (
        f"{q.name} is at its {bound} bound ({q.to_file(value):.4g}{unit}): the data do not support "
        f"a value {'above' if side > 0 else 'below'} {limit_95:.3g}{unit} (95 %) and do not "
        "determine it otherwise."
    )
    estimate = Estimate(
        q.to_file(value), None, q.file_unit, "lower" if side > 0 else "upper", *intervals
    )
    return estimate, text


def _bound(q: Parameter, value: float) -> str | None:
    slack = NEAR_BOUND * (q.upper - q.lower)
    if value <= q.lower + slack:
        return "lower"
    return "upper" if value >= q.upper - slack else None


def _clipped(q: Parameter, low: float, high: float) -> tuple[float, float]:
    return q.to_file(max(low, q.lower)), q.to_file(min(high, q.upper))


def _width(q: Parameter, u: float) -> float:
    """An uncertainty in the unit of files."""
    return q.to_file(u)


def _with_quantiles(
    model: Model,
    estimates: Mapping[str, Estimate],
    determined: Any,
    draws: FloatArray,
) -> dict[str, Estimate]:
    """Intervals from the posterior's quantiles: central, or one-sided at a bound."""
    from dataclasses import replace

    result = {}
    flat = draws.reshape(-1, draws.shape[-1])
    for j, q in enumerate(model.parameters):
        estimate = estimates[q.name]
        column = flat[:, j]
        intervals = []
        for level in (0.6826895, 0.95):
            if estimate.at_bound == "lower":
                pair = (q.lower, float(np.quantile(column, level)))
            elif estimate.at_bound == "upper":
                pair = (float(np.quantile(column, 1 - level)), q.upper)
            else:
                tail = (1 - level) / 2
                low, high = np.quantile(column, [tail, 1 - tail])
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
    agreed: bool,
) -> list[str]:
    warnings = []
    if not optimum.verified:
        warnings.append("the minimum was not reached: the next step would still change the fit.")
    if not agreed:
        warnings.append("two starts ended in minima that could not both be verified.")
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
