"""`fit`: BRDF samples and a model to parameters with their uncertainties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from gonio.errors import ConfigurationError
from gonio.fitting.diagnostics.diagnose import diagnose
from gonio.fitting.diagnostics.parts import with_parts
from gonio.fitting.diagnostics.support import support_warnings, supports
from gonio.fitting.dome_field.self_calibration import self_calibrated
from gonio.fitting.minimum import engines
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.minimum.joint import find_joint_minimum
from gonio.fitting.minimum.nuisance import profiled
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.posterior import predictive
from gonio.fitting.posterior.at_minimum import outside_posterior, sampled
from gonio.fitting.posterior.chain import Chain, Progress
from gonio.fitting.posterior.in_memory import InMemory
from gonio.fitting.posterior.priors import Prior, resolve
from gonio.fitting.problem import losses
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.losses import CHI2, Loss
from gonio.fitting.problem.nuisance_names import Nuisance, profiled_terms
from gonio.fitting.problem.protocol import Weights
from gonio.fitting.provenance import provenance
from gonio.fitting.residual_tests.verdict import misfit_beyond_shared, verdict_of
from gonio.fitting.residual_tests.whitened import Base
from gonio.fitting.result import FitResult, PosteriorSummary, plain
from gonio.fitting.screening import screened
from gonio.fitting.uncertainty.at_minimum import honest_uncertainties
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.intervals import covariance, estimated, noiseless, with_quantiles
from gonio.fitting.uncertainty.nuisance import nuisance_estimates, pull_warnings
from gonio.fitting.uncertainty.reported import all_covariances, all_estimates
from gonio.fitting.warnings import condensed, warnings_of
from gonio.models import Model, source_of
from gonio.models import get as get_model
from gonio.samples import BRDFSamples
from gonio.samples.stated_errors import with_shared_errors


def fit(
    samples: BRDFSamples | Sequence[BRDFSamples] | Mapping[str, BRDFSamples],
    model: str | Model,
    *,
    share: str | Sequence[str] | None = None,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    engine: str = engines.DEFAULT,
    loss: str = CHI2.name,
    nuisance: Nuisance = "none",
    posterior: bool = False,
    draws: str | Path | None = None,
    sampler: Literal["emcee", "marginal", "auto"] = "emcee",
    priors: Mapping[str, str | Prior] | None = None,
    seed: int = 0,
    threads: int | None = None,
    cuts: Mapping[str, Any] | None = None,
    u_scale: float | None = None,
    u_angle: float | None = None,
    self_calibrate: bool = False,
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
    weights : {"sd", "none", "cos", "coscos", "relative"}, optional
        What residuals are multiplied by; "sd" where the samples have uncertainties. "relative" is
        one over the fitted value.
    start : mapping, optional
        Starting values (radians for angles) beside those that the data suggest. Where these lead
        to a deeper minimum, it is taken and a warning names the other one.
    fixed : mapping of str to float, optional
        Parameters that are no unknowns, with their values, radians for angles: `{"rho_d": 0.0}`.
        With `share` in all parts.
    tied : mapping of str to str, optional
        Parameters that take the value of another one: `{"alpha_y": "alpha_x"}`. The two are one
        unknown, within the bounds of both.
    engine : str
        What searches for the minimum before the Gauss-Newton steps in which every fit ends:
        one of nlopt's algorithms, "lbfgs", "slsqp", "mma", "bobyqa", "sbplx" or "mlsl", or
        "gauss_newton" for no search.
    loss : {"chi2", "log", "cube_root", "relative", "student_t"}
        What is made small: the sum of squared weighted residuals, squared differences of
        ln(1 + f cos theta_r), of (f cos theta_r)^(1/3) or of ln f, or Student's t, which outliers
        hardly move.
    nuisance : {"none", "all"} or sequence of str
        Shared errors of the samples that the data may tell of, by name: each draw is an unknown of
        the fit whose prior the budget states. The others are propagated.
    posterior : bool
        Sample the posterior; its quantiles become the intervals.
    draws : path, optional
        Where to write the draws and what they predict (netCDF, as arviz opens it).
    sampler : {"emcee", "marginal", "auto"}
        The posterior's sampler. "auto" and "marginal" try the quicker marginal sampler first, and
        emcee takes over where its guard refuses it; "marginal" warns of it.
    priors : mapping of str to str, optional
        Priors in place of those that parameters declare, angles in radians: "flat", "log",
        "normal(mean, sd)", "lognormal(median, factor)" or "half_normal(sd)". They change the
        posterior only and are refused without it.
    seed : int
        Seed of the sampler, the only random step.
    threads : int, optional
        The result does not depend on it.
    cuts : mapping, optional
        Selections made before, to be stated in the result.
    u_scale, u_angle : float, optional
        Standard uncertainties, a fraction and radians, of one factor on all values and of the
        alignment, which all samples share (`gonio.samples.stated_errors.with_shared_errors`).
    self_calibrate : bool
        Find the slope errors of the dome together with the material, from the samples of one
        session; the verdict then also asks whether they predict images that were left out.
    progress : callable, optional
        Called with (steps done, steps in all) while the posterior is sampled.

    Returns
    -------
    FitResult
        Angles in radians, so that `values()` goes back into a model, `start` and `simulate`.

    Raises
    ------
    ConfigurationError
        For an unknown model, weights, starting value or name to share, samples of one channel with
        something to share, parameters that cannot be fixed or tied so, or priors without
        a posterior.
    DataError
        If there are not more samples than parameters, if the samples cannot be what they claim
        (angles in radians, codes for missing readings in most lines), or a posterior is asked for
        where there is no noise.

    Notes
    -----
    The samples are asked the questions of `gonio.check` first. Values that are no measurements are
    left out, and the warnings say how many.

    Independent errors set the weights; errors that samples share (the standard, the lamp, the
    mapping) are propagated to the parameters linearly and added, and not estimated from the data,
    unless `nuisance` names them.

    With `share` every part counts by its own noise: its independent uncertainties are multiplied
    by what its fit alone needs (Birge's ratio). The growth of chi-squared over separate fits tells
    whether the parts share what they should (`FitResult.sharing`).

    Examples
    --------
    >>> import numpy as np
    >>> from gonio.geometry import Directions
    >>> theta = np.linspace(0, 1.2, 20)
    >>> samples = BRDFSamples(Directions(0.3 * np.ones(20), 0.0, theta, 0.0), 0.1 + 0 * theta)
    >>> round(fit(samples, model="lambert").parameters["rho"].value, 6)
    0.314159
    """
    chosen = get_model(model)
    if start is not None and not isinstance(start, Mapping):
        raise ConfigurationError(
            "starting values are a mapping of names to values, such as "
            f"{{{chosen.names[0]!r}: {chosen.parameters[0].default:g}}}, not "
            f"{type(start).__name__}."
        )
    held = Constraints.of(chosen, fixed, tied)
    held.refuse(start, "starting value")
    held.refuse(priors, "prior")
    if priors and not posterior:
        raise ConfigurationError(
            "priors change the posterior only, and none was asked for; add posterior=True.",
            value=dict(priors),
        )
    if share is None:
        resolve(chosen.parameters, priors)  # before anything takes long
    searched_by, law = engines.get(engine, seed), losses.get(loss)
    _check_combination(law, posterior, share is not None or nuisance != "none")
    options: dict[str, Any] = {"weights": weights, "start": start, "threads": threads}
    options |= {"constraints": held, "engine": searched_by}
    if share is None:
        options["loss"] = loss
    screening = screened(samples)
    stated = _with_shared_errors(screening.samples, u_scale=u_scale, u_angle=u_angle)
    calibration = None
    if self_calibrate:
        if share is not None or nuisance != "none":
            raise ConfigurationError(
                "self_calibrate fits one session and estimates its shared errors; leave share and "
                "nuisance out."
            )
        calibration = self_calibrated(stated, chosen, **options)
        stated = calibration.samples
    minimum = _minimum(stated, chosen, share, **options)
    minimum = profiled(minimum, profiled_terms(minimum.problem.samples, nuisance), searched_by)
    chain = None
    if posterior:
        minimum, chain = sampled(minimum, priors, seed=seed, sampler=sampler, progress=progress)
    if chain is not None and draws is not None:
        predictive.save(chain, Path(draws), minimum.problem, scale=minimum.noise_scale, seed=seed)
    result = FitResult(
        model=chosen.name,
        model_source=source_of(chosen),
        seed=seed,
        cuts=dict(cuts or {}),
        engine=engine,
        loss=loss,
        memory=InMemory(
            chosen, minimum.problem, minimum.optimum.p, minimum.noise_scale, seed, chain
        ),
        **_stated(minimum),
        **_inferred(minimum, chain, None if draws is None else str(draws), chosen.note),
        **provenance(minimum.problem.samples),
    )
    return screening.noted(result if calibration is None else calibration.noted(result))


def _stated(minimum: Minimum) -> dict[str, Any]:
    """The fields of a result that the minimum itself states."""
    problem = minimum.problem
    return {
        "status": minimum.status,
        "chi2": minimum.chi2,
        "dof": minimum.dof,
        "noise_scale": minimum.noise_scale,
        "n_samples": problem.n,
        "n_negative": problem.samples.n_negative,
        "weights": problem.weights,
        "parts": minimum.parts,
        "sharing": minimum.sharing,
    }


def _inferred(minimum: Minimum, chain: Chain | None, file: str | None, note: str) -> dict[str, Any]:
    """Estimates, covariance, posterior, diagnostics, and the warnings that come with them.

    Parameters
    ----------
    minimum : Minimum
    chain : Chain or None
        Draws of the posterior, whose quantiles become the intervals.
    file : str or None
        Where the draws were written.
    note : str
        What the model says of every fit, "" for nothing.
    """
    problem = minimum.problem
    squares = minimum.as_least_squares()  # its residuals are those that the loss sees
    base = Base.of(squares)
    test = misfit_beyond_shared(squares, base)
    informed_by = Informed.once(squares)
    errors, undetected = honest_uncertainties(minimum, test, informed_by)
    estimates, bound_warnings = estimated(minimum, errors, test)
    support = {} if noiseless(minimum) else supports(minimum, estimates, informed_by)
    for name, carried in support.items():
        estimates[name] = replace(estimates[name], established=not carried.reasons)
    verdict, diagnostics, residual_warnings = diagnose(squares, base)
    if problem.law.robust:
        verdict = verdict_of(minimum)  # of all residuals, also those that the loss hardly sees
    shared_errors = nuisance_estimates(minimum)
    warnings = warnings_of(minimum, errors) + minimum.warnings
    warnings += condensed(undetected + bound_warnings)
    warnings += errors.allowance.warnings if errors.allowance else []
    warnings += condensed(support_warnings(minimum, support, residual_warnings))
    warnings += residual_warnings + pull_warnings(shared_errors)
    summary = priors = None
    if chain is not None:
        summary = chain.summary(problem.parameters, file)
        estimates = with_quantiles(problem.parameters, estimates, chain.draws)
        warnings += outside_posterior(problem.parameters, estimates)
        priors = {q.name: [q.to_file(q.lower), q.to_file(q.upper)] for q in problem.parameters}
        warnings += _convergence_warnings(chain, summary) + chain.warnings
    return {
        "parameters": all_estimates(problem.reported, estimates),
        "covariance": None
        if noiseless(minimum)
        else all_covariances(problem.reported, covariance(errors)),
        "verdict": verdict,
        "posterior": summary,
        "nuisance": shared_errors,
        "warnings": tuple(warnings + ([note] if note else [])),
        "diagnostics": {
            "evaluations": minimum.optimum.evaluations,
            "history": list(problem.samples.history),
            "noise_laws": [law and law.to_dict() for law in problem.noise_laws],
            **diagnostics,
            "allowance": errors.allowance.to_dict() if errors.allowance else None,
            "support": plain(support),
            "priors": priors,
        },
    }


def _convergence_warnings(chain: Chain, summary: PosteriorSummary) -> list[str]:
    """What a user must know of a posterior that has not converged."""
    if chain.converged:
        return []
    return [
        f"the posterior has not converged (R-hat {summary.r_hat:.3f}, "
        f"{chain.n_steps} steps, tau {summary.tau:.0f}, effective draws "
        f"{summary.ess:.0f} in the bulk and {summary.ess_tail:.0f} in the tails): its "
        "intervals are provisional."
    ]


def _check_combination(law: Loss, posterior: bool, several: bool) -> None:
    """Refuse what a loss cannot do.

    Raises
    ------
    ConfigurationError
    """
    if posterior and not law.likelihood:
        raise ConfigurationError(
            f"loss {law.name!r} is not a likelihood and has no posterior; fit without one, or "
            "use loss chi2 or student_t.",
            value=law.name,
        )
    if several and law is not CHI2:
        raise ConfigurationError(
            f"share and nuisance need loss {CHI2.name!r}, not {law.name!r}; change it, or leave "
            "share and nuisance out.",
            value=law.name,
        )


def _with_shared_errors(samples: Any, **sizes: float | None) -> Any:
    """The samples of each input with the shared errors that their owner states."""
    if isinstance(samples, Mapping):
        return {name: _with_shared_errors(own, **sizes) for name, own in samples.items()}
    if isinstance(samples, BRDFSamples):
        return with_shared_errors(samples, **sizes)
    if isinstance(samples, Sequence) and not isinstance(samples, str):
        return [_with_shared_errors(own, **sizes) for own in samples]
    return samples


def _minimum(
    samples: BRDFSamples | Sequence[BRDFSamples] | Mapping[str, BRDFSamples],
    model: Model,
    share: str | Sequence[str] | None,
    **options: Any,
) -> Minimum:
    """The minimum for one BRDF, or for several that share parameters."""
    if share is not None:
        words = share.split(",") if isinstance(share, str) else share
        names = [word.strip() for word in words if word.strip()]
        return with_parts(find_joint_minimum(samples, model, names, **options))
    if isinstance(samples, Mapping) or (
        isinstance(samples, Sequence) and all(isinstance(s, BRDFSamples) for s in samples)
    ):
        raise ConfigurationError(
            "several samples are fitted together with 'share', the names of the parameters that "
            "they have in common; an empty list shares nothing."
        )
    if not isinstance(samples, BRDFSamples):
        raise ConfigurationError(
            "a fit takes BRDF samples, which are values with their directions, not "
            f"{type(samples).__name__}; make them with BRDFSamples(Directions(theta_i, phi_i, "
            "theta_r, phi_r), values, u), angles in radians, with gonio.reduce(session), "
            "gonio.formats.read(file) or BRDFSamples.from_dataframe(table)."
        )
    return find_minimum(samples, model, **options)
