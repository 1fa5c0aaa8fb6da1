"""`compare`: which of several models the data prefer, and which they cannot tell apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.fitting.comparison import predictive_scores
from gonio.fitting.comparison.ranking import (
    conclusion_of,
    ranked,
)
from gonio.fitting.comparison.records import Comparison
from gonio.fitting.comparison.scores import score_model
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.minimum.record import MISFIT, Minimum
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.noise_law import laws_in_words
from gonio.fitting.problem.protocol import Weights
from gonio.fitting.provenance import provenance
from gonio.fitting.screening import screened
from gonio.models import Model, source_of
from gonio.models import get as get_model
from gonio.samples import BRDFSamples
from gonio.samples.stated_errors import with_shared_errors
from gonio.wording import counted

ROUGH_GROUPS = 8  # a standard error over fewer groups is rough
EXACT = 1e-10  # residuals this small beside the values are no noise

Progress = Callable[[int, int], None]


def compare(
    samples: BRDFSamples,
    models: Sequence[str | Model],
    *,
    weights: Weights | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    seed: int = 0,
    threads: int | None = None,
    cuts: Mapping[str, Any] | None = None,
    u_scale: float | None = None,
    u_angle: float | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compare models on the same BRDF samples.

    Parameters
    ----------
    samples : BRDFSamples
        Of one wavelength and channel.
    models : sequence of str or Model
        Two at least.
    weights : {"sd", "none", "cos", "coscos", "relative"}, optional
        As `gonio.fit` takes them.
    fixed : mapping of str to float, optional
    tied : mapping of str to str, optional
        Parameters that are fixed, or take the value of another one, in every model that has them.
    seed : int
        Seed of the draws; one seed, one result, whatever the number of threads.
    threads : int, optional
    cuts : mapping, optional
        Selections made before, to be stated in the result.
    u_scale, u_angle : float, optional
        As `gonio.fit` takes them.
    progress : callable, optional
        Called with (models done, models in all).

    Returns
    -------
    Comparison

    Raises
    ------
    ConfigurationError
        For fewer than two models, an unknown one, one given twice, or parameters that cannot be
        fixed or tied so, or that no model has.
    DataError
        If there are not more samples than parameters, or no noise to judge differences by.

    Notes
    -----
    Every model is given the noise of the one that fits best: its weights and its factor on the
    independent uncertainties. With scales of their own a worse model would call its misfit noise.

    Held out is one incidence at a time: residuals of a model that does not fit are alike within an
    incidence, and scores of single samples take them for independent evidence. A model is told
    from the best where their scores differ by two standard errors at least, and by more than 4:
    the standard error of a smaller difference is not to be trusted (Sivula, Magnusson & Vehtari
    2020, arXiv:2008.10296). That rule is blind where one incidence decides: the scatter is then as
    large as the difference. Where the best model fits to the stated uncertainties (chi2/dof up to
    1.5) the noise itself gives the standard error of a difference D, sqrt(2 D), and D of 8 at least
    tells models apart too.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> theta_i, theta_r = np.repeat([0.0, 0.3, 0.6, 0.9, 1.2], 8), np.tile(np.linspace(0, 1, 8), 5)
    >>> noise = np.random.default_rng(1).standard_normal(40)
    >>> value = 0.1 + 0.001 * noise
    >>> samples = BRDFSamples(Directions(theta_i, 0.0, theta_r, 0.0), value, 0.001 + 0 * value)
    >>> found = compare(samples, ["lambert", "phong"])
    >>> found.entry("phong").held_out.told_apart
    False
    """
    chosen = _checked(models)
    samples = with_shared_errors(samples, u_scale=u_scale, u_angle=u_angle)
    constraints = _constraints(chosen, fixed or {}, tied or {})
    screening = screened(samples)
    samples = screening.samples
    minima = []
    for model in chosen:
        held = constraints[model.name]
        options: dict[str, Any] = {"weights": weights, "threads": threads, "constraints": held}
        minima.append(find_minimum(samples, model, **options))
    # Of two that fit alike to rounding, whatever their order, the smaller model.
    reference = min(
        minima,
        key=lambda m: (
            float(f"{m.chi2 / m.dof:.10g}"), len(m.problem.parameters), m.problem.name
        ),
    )  # fmt: skip
    _require_noise(reference)
    groups = predictive_scores.incidence_groups(
        np.broadcast_to(samples.directions.theta_i, len(samples))
    )
    rng = np.random.default_rng(seed)
    some = np.sort(rng.permutation(len(samples))[: predictive_scores.LOO_SAMPLES])
    judged = []
    for k, minimum in enumerate(minima):
        judged.append(score_model(minimum, reference, groups, some, seed))
        if progress is not None:
            progress(k + 1, len(minima))
    known_noise = _fits_to_the_noise(reference)
    entries = ranked(judged, len(samples), known_noise)
    return Comparison(
        entries=entries,
        conclusion=conclusion_of(entries),
        noise_scale=reference.noise_scale,
        noise_model=reference.problem.name,
        n_samples=len(samples),
        weights=reference.problem.weights,
        seed=seed,
        groups=tuple(_described(samples, g) for g in groups),
        cuts=dict(cuts or {}),
        notes=(*screening.warnings, *_notes(reference, groups, len(some))),
        fixed=_in_file_units(chosen, fixed or {}),
        tied=dict(tied or {}),
        **provenance(samples),
    )


def _checked(models: Sequence[str | Model]) -> list[Model]:
    given = [models] if isinstance(models, str) else list(models)
    chosen = _labelled([get_model(m) for m in given])
    names = [m.name for m in chosen]
    if len(chosen) < 2:
        raise ConfigurationError(
            f"a comparison needs at least two models and got {', '.join(names) or 'none'}; "
            "'gonio models' lists them.",
            value=names,
        )
    return chosen


def _labelled(models: Sequence[Model]) -> list[Model]:
    """The models; those of one name from several files are named with their files."""
    counts = Counter(model.name for model in models)
    labelled = [
        replace(model, name=f"{model.name} ({(source_of(model) or {}).get('file')})")
        if counts[model.name] > 1
        else model
        for model in models
    ]
    for label, count in Counter(model.name for model in labelled).items():
        if count > 1:
            name = label.partition(" (")[0]
            raise ConfigurationError(f"model {name} is given twice; give it once.", value=name)
    return labelled


def _constraints(
    models: Sequence[Model], fixed: Mapping[str, float], tied: Mapping[str, str]
) -> dict[str, Constraints]:
    """The constraints of each model: those whose parameters it has."""
    all_names = {name for model in models for name in model.names}
    for how, names in (("fixed", fixed), ("tied", [*tied, *tied.values()])):
        for name in names:
            if name not in all_names:
                raise unknown_name(f"{how} parameter", name, all_names, of="these models")
    by_model = {}
    for model in models:
        own = set(model.names)
        values = {name: value for name, value in fixed.items() if name in own}
        ties = {name: other for name, other in tied.items() if {name, other} <= own}
        by_model[model.name] = Constraints.of(model, values, ties)
    return by_model


def _in_file_units(models: Sequence[Model], fixed: Mapping[str, float]) -> dict[str, float]:
    owners = {name: model for model in models for name in model.names}
    return {name: owners[name].parameter(name).to_file(v) for name, v in fixed.items()}


def _require_noise(reference: Minimum) -> None:
    problem = reference.problem
    size = np.sqrt(np.mean(problem.samples.value**2 * problem.inverse_variance))
    if reference.noise_scale <= EXACT * size:
        raise DataError(
            f"{problem.name} leaves no residuals and the samples state no uncertainty: there "
            "is no noise to judge the other models by; give u_brdf."
        )


def _fits_to_the_noise(reference: Minimum) -> bool:
    """Whether the uncertainties are stated and the best model's residuals are no larger."""
    return reference.problem.weights == "sd" and reference.chi2 / reference.dof <= MISFIT


def _described(samples: BRDFSamples, group: predictive_scores.Index) -> dict[str, float]:
    theta_i = np.broadcast_to(samples.directions.theta_i, len(samples))[group]
    return {"theta_i_deg": float(np.degrees(theta_i.mean())), "n_samples": len(group)}


def _notes(reference: Minimum, groups: list[predictive_scores.Index], n_loo: int) -> list[str]:
    """What holds for all models."""
    problem = reference.problem
    unit = (
        f"the stated uncertainties times {reference.noise_scale:.4g}"
        if problem.weights == "sd"
        else f"the scatter of its weighted residuals, {reference.noise_scale:.4g} sr^-1"
    )
    text = f"all models are judged with the noise of {problem.name}, which fits best: {unit}."
    if not _fits_to_the_noise(reference):
        text += (
            " This noise includes the misfit: scores of single samples and the "
            "evidence are then overconfident; the scatter between incidences is the better guide."
        )
    notes = [text, *laws_in_words(problem.noise_laws)]
    if len(groups) < predictive_scores.MIN_GROUPS:
        notes.append(
            f"no held-out score: the samples have {counted(len(groups), 'group')} of incidence and "
            f"{predictive_scores.MIN_GROUPS} are needed; measure more incidences or widen the cuts."
        )
    elif len(groups) < ROUGH_GROUPS:
        notes.append(f"standard errors over {counted(len(groups), 'incidence')} are rough.")
    if problem.samples.shared:
        shared = ", ".join(term.name for term in problem.samples.shared)
        notes.append(
            f"errors that samples share ({shared}) are in the held-out predictions and not in the "
            "leave-one-out score and the evidence."
        )
    if n_loo < problem.n:
        notes.append(
            f"the leave-one-out score is estimated from {n_loo} of {problem.n} samples, drawn at "
            "random."
        )
    return notes
