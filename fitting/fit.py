"""`fit`: BRDF samples and a model to parameters with honest uncertainties."""

from __future__ import annotations

import hashlib
import platform
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gonio._version import __version__
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.diagnostics.diagnose import diagnose
from gonio.fitting.minimum import engines, gauss_newton
from gonio.fitting.minimum.find import (
    MISFIT,
    Minimum,
    find_minimum,
    goodness,
    place,
    settled,
    uncertainties,
    without_spikes,
)
from gonio.fitting.posterior.priors import Prior, resolve
from gonio.fitting.problem import losses
from gonio.fitting.problem import nuisance as shared_errors
from gonio.fitting.problem.losses import CHI2, Loss
from gonio.fitting.problem.nuisance import Nuisance, NuisanceProblem
from gonio.fitting.problem.problem import Problem, Weights
from gonio.fitting.result import FitResult, NuisanceEstimate
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.fitting.uncertainty.intervals import covariance, estimated, noiseless, with_quantiles
from gonio.models import Model
from gonio.models import get as get_model
from gonio.samples import BRDFSamples

if TYPE_CHECKING:  # emcee is slow to import
    from gonio.fitting.posterior.sample import Chain, Sampler

ALIKE = 3  # warnings that parts of a joint fit give alike, told one by one
RESTARTS = 2  # times that a posterior may lead to a deeper minimum
NO_DEEPER = 1e-3  # of the noise squared: as deep, but for rounding

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
    estimates, bound_warnings = estimated(problem, optimum, errors, dof)
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
        estimates = with_quantiles(problem.parameters, estimates, chain.draws)
        if draws is not None:
            from gonio.fitting.posterior import predictive

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
        covariance=None if noiseless(problem, scale) else covariance(problem.parameters, errors),
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
    from gonio.fitting.posterior import sample as posteriors

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
    other = gauss_newton.minimise(problem, best, search=False)
    if not other.verified or optimum.chi2 - other.chi2 <= NO_DEEPER * found.noise_scale**2:
        return None
    if type(problem) is not Problem:
        told = "the posterior holds a deeper minimum, which the search did not find."
        return replace(
            found, optimum=replace(optimum, verified=False), doubts=[*found.doubts, told]
        )
    problem, other = settled(problem, other)
    told = (
        f"the search found a minimum at {place(problem, optimum)}; the posterior led to a deeper "
        "one, which was taken."
    )
    faults = gauss_newton.gradient_faults(problem, other.p)
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
        from gonio.fitting.minimum.joint_fit import find_joint_minimum

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


def provenance(samples: BRDFSamples) -> dict[str, Any]:
    """What a result says of its origin: versions of the programs, and the data."""
    return {
        "versions": _versions(),
        "source": {"data_sha256": _data_hash(samples), **samples.metadata},
    }


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
