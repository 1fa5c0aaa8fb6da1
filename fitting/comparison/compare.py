"""`compare`: which of several models the data prefer, and which they cannot tell apart."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError, DataError
from gonio.files import write_text
from gonio.fitting.comparison import predictive_scores
from gonio.fitting.fit import provenance
from gonio.fitting.minimum import gauss_newton
from gonio.fitting.minimum.find import MISFIT, Minimum, find_minimum, uncertainties
from gonio.fitting.minimum.gauss_newton import Optimum
from gonio.fitting.problem.problem import Weights
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.geometry import FloatArray
from gonio.models import Model
from gonio.models import get as get_model
from gonio.samples import BRDFSamples

SCHEMA = "gonio.compare/1"
TOLD_APART = 2.0  # standard errors of a difference
SMALL = 4.0  # a difference of log scores below which its standard error is not to be trusted
CLEAR = 8.0  # a difference D that is two of its standard errors by known noise, sqrt(2 D)
ROUGH_GROUPS = 8  # a standard error over fewer groups is rough
EXACT = 1e-10  # residuals this small beside the values are no noise

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Score:
    """Sum of log predictive densities; larger is better.

    Parameters
    ----------
    value, stderr : float
        The sum and its standard error, from the scatter between its terms.
    difference, difference_stderr : float
        This model less the first of the table, and its standard error, from the scatter of the
        differences term by term. Both are 0 for the first.
    terms, worse : int
        How many terms the sum has, and in how many of them the first scores higher.
    told_apart : bool
        Whether the data tell the model from the first of the table; `compare` says by what rule.
    """

    value: float
    stderr: float
    difference: float
    difference_stderr: float
    terms: int
    worse: int
    told_apart: bool


@dataclass(frozen=True)
class Entry:
    """One model of a comparison.

    Parameters
    ----------
    model : str
    status : {"converged", "not_converged"}
    n_parameters : int
    chi2, dof : float, int
        Of the model's own fit.
    values : mapping of str to float
        Fitted parameters in the unit of files.
    at_bound, undetermined : tuple of str
        Parameters on a bound, or in a sum that is, and others about which the data say nothing.
    priors : mapping of str to tuple of float
        Bounds between which the prior of the evidence is flat, in the unit of files.
    held_out : Score or None
        Over groups of samples of one incidence, each predicted from all others.
    held_out_by_group : tuple of float, or None
        Its terms, in the order of the comparison's groups.
    loo : Score or None
        Over samples, each predicted from all others by Pareto-smoothed importance sampling.
    loo_k_hat : float or None
        Largest k-hat; above 0.7 the score cannot be trusted.
    log_evidence, log_evidence_stderr : float or None
        Natural logarithm, with its error from the sampling.
    notes : tuple of str
        Why something is None, and what to mistrust.
    """

    model: str
    status: Literal["converged", "not_converged"]
    n_parameters: int
    chi2: float
    dof: int
    values: Mapping[str, float]
    at_bound: tuple[str, ...]
    undetermined: tuple[str, ...]
    priors: Mapping[str, tuple[float, float]]
    held_out: Score | None
    held_out_by_group: tuple[float, ...] | None
    loo: Score | None
    loo_k_hat: float | None
    log_evidence: float | None
    log_evidence_stderr: float | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Several models on the same samples, the best first.

    Parameters
    ----------
    entries : tuple of Entry
        By held-out score; by the leave-one-out score where nothing could be held out.
    conclusion : str
        Which models the data cannot tell apart.
    noise_scale, noise_model : float, str
        Factor on the weights' standard deviations, the same for all models, and the model whose
        residuals set it.
    n_samples, weights, seed : int, str, int
    groups : tuple of mapping
        The incidences that were held out: mean `theta_i_deg` and `n_samples`.
    cuts : mapping
        Selections and angle limits that were applied.
    notes : tuple of str
        What the criteria hold and do not hold.
    versions, source : mapping
    """

    entries: tuple[Entry, ...]
    conclusion: str
    noise_scale: float
    noise_model: str
    n_samples: int
    weights: str
    seed: int
    groups: tuple[Mapping[str, float], ...]
    cuts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """True when every fit passed its checks."""
        return all(entry.status == "converged" for entry in self.entries)

    @property
    def best(self) -> Entry:
        """The first of the table."""
        return self.entries[0]

    def entry(self, model: str) -> Entry:
        """The entry of a model by its name."""
        return next(e for e in self.entries if e.model == model)

    def to_dict(self) -> dict[str, Any]:
        """The comparison as plain data of schema gonio.compare/1."""
        return {"schema": SCHEMA, **asdict(self)}

    def to_json(self) -> str:
        """The comparison as a JSON document."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"

    def save(self, path: str | Path) -> None:
        """Write the JSON document, whole or not at all."""
        write_text(Path(path), self.to_json())


def compare(
    samples: BRDFSamples,
    models: Sequence[str | Model],
    *,
    weights: Weights | None = None,
    seed: int = 0,
    threads: int | None = None,
    cuts: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compare models on the same BRDF samples.

    Parameters
    ----------
    samples : BRDFSamples
        Of one wavelength and channel.
    models : sequence of str or Model
        Two at least.
    weights : {"sd", "none", "cos", "coscos"}, optional
        As `gonio.fit` takes them.
    seed : int
        Seed of the draws; one seed, one result, whatever the number of threads.
    threads : int, optional
    cuts : mapping, optional
        Selections made before, to be stated in the result.
    progress : callable, optional
        Called with (models done, models in all).

    Returns
    -------
    Comparison

    Raises
    ------
    ConfigurationError
        For fewer than two models, an unknown one, or one given twice.
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
    minima = []
    for model in chosen:
        minima.append(find_minimum(samples, model, weights=weights, threads=threads))
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
        judged.append(_judged(minimum, reference, groups, some, seed))
        if progress is not None:
            progress(k + 1, len(minima))
    known_noise = _fits_to_the_noise(reference)
    entries = _ranked(judged, len(samples), known_noise)
    return Comparison(
        entries=entries,
        conclusion=_conclusion(entries),
        noise_scale=reference.noise_scale,
        noise_model=reference.problem.name,
        n_samples=len(samples),
        weights=reference.problem.weights,
        seed=seed,
        groups=tuple(_described(samples, g) for g in groups),
        cuts=dict(cuts or {}),
        notes=tuple(_notes(reference, groups, len(some))),
        **provenance(samples),
    )


def _checked(models: Sequence[str | Model]) -> list[Model]:
    given = [models] if isinstance(models, str) else list(models)
    chosen = [get_model(m) if isinstance(m, str) else m for m in given]
    names = [m.name for m in chosen]
    for name in names:
        if names.count(name) > 1:
            raise ConfigurationError(f"model {name} is given twice; give it once.", value=name)
    if len(chosen) < 2:
        raise ConfigurationError(
            f"a comparison needs two models at least and got {', '.join(names) or 'none'}; "
            "'gonio models' lists them.",
            value=names,
        )
    return chosen


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


@dataclass(frozen=True)
class _Judged:
    """A model with the terms of its scores, before they are set against each other."""

    entry: Entry
    by_group: FloatArray | None
    by_sample: FloatArray | None


def _judged(
    minimum: Minimum,
    reference: Minimum,
    groups: list[predictive_scores.Index],
    some: predictive_scores.Index,
    seed: int,
) -> _Judged:
    """One model under the noise of the best-fitting one."""
    problem, optimum = minimum.problem, minimum.optimum
    common = reference.problem.inverse_variance
    if not np.array_equal(problem.inverse_variance, common):
        problem = replace(problem, inverse_variance=common)
        optimum = gauss_newton.minimise(problem, optimum.p, search=False)
    minimum = replace(minimum, problem=problem, optimum=optimum)
    errors, undetected = uncertainties(problem, optimum, reference.noise_scale)
    notes = [*minimum.doubts, *undetected]
    by_group = _held_out(minimum, groups, reference.noise_scale, notes)
    rng = np.random.default_rng([seed, 1])
    draws = predictive_scores.draw(problem, optimum, reference.noise_scale, some, rng)
    by_sample, k_hat = _leave_one_out(draws, notes)
    evidence = _evidence(minimum, errors, draws, notes)
    parameters = problem.parameters
    entry = Entry(
        model=problem.name,
        status=minimum.status,
        n_parameters=len(parameters),
        chi2=minimum.chi2,
        dof=minimum.dof,
        values={q.name: q.to_file(float(v)) for q, v in zip(parameters, optimum.p, strict=True)},
        at_bound=_names(minimum, _held(optimum)),
        undetermined=_names(minimum, ~_held(optimum) & ~errors.determined),
        priors={q.name: (q.to_file(q.lower), q.to_file(q.upper)) for q in parameters},
        held_out=None,
        held_out_by_group=None if by_group is None else tuple(map(float, by_group)),
        loo=None,
        loo_k_hat=k_hat,
        log_evidence=None if evidence is None else evidence[0],
        log_evidence_stderr=None if evidence is None else evidence[1],
        notes=tuple(notes),
    )
    return _Judged(entry, by_group, by_sample)


def _names(minimum: Minimum, which: Any) -> tuple[str, ...]:
    names = minimum.problem.model.names
    return tuple(name for name, chosen in zip(names, which, strict=True) if chosen)


def _held_out(
    minimum: Minimum, groups: list[predictive_scores.Index], noise_scale: float, notes: list[str]
) -> FloatArray | None:
    problem = minimum.problem
    if len(groups) < predictive_scores.MIN_GROUPS:
        return None  # said once for all models
    left = problem.n - max(len(group) for group in groups)
    if left <= len(problem.parameters):
        notes.append(
            f"no held-out score: without the largest incidence {left} samples are left for "
            f"{len(problem.parameters)} parameters."
        )
        return None
    found = predictive_scores.held_out(problem, minimum.optimum, groups, noise_scale)
    if found.unverified:
        notes.append(
            f"{found.unverified} of {len(groups)} held-out fits did not reach a verified minimum."
        )
    if found.left_out:
        notes.append(
            f"the held-out score leaves out {', '.join(found.left_out)}: each has more than "
            f"{predictive_scores.MAX_SHARED} draws."
        )
    return found.by_group


def _leave_one_out(
    draws: predictive_scores.Draws, notes: list[str]
) -> tuple[FloatArray | None, float | None]:
    if len(draws.log_likelihood) < predictive_scores.MIN_EFFECTIVE:
        notes.append("no leave-one-out score: nearly all draws fall outside the bounds.")
        return None, None
    by_sample, k_hat = predictive_scores.leave_one_out(draws)
    bad = int(np.count_nonzero(~(k_hat <= predictive_scores.MAX_K_HAT)))
    if bad:
        notes.append(
            "the leave-one-out score is not to be trusted: k-hat is above "
            f"{predictive_scores.MAX_K_HAT} for {bad} of {len(k_hat)} samples."
        )
    worst = float(np.max(k_hat))
    return by_sample, worst if np.isfinite(worst) else None


def _held(optimum: Optimum) -> NDArray[np.bool_]:
    """Parameters on a bound, and those whose sum is at its limit."""
    held = ~optimum.free
    held[list(optimum.limited)] = True
    return held


def _evidence(
    minimum: Minimum, errors: Uncertainty, draws: predictive_scores.Draws, notes: list[str]
) -> tuple[float, float] | None:
    """Log evidence and its error, or None with the reason among the notes."""
    parameters = minimum.problem.parameters
    reason = None
    if minimum.status != "converged" or not minimum.optimum.verified:
        reason = "the fit did not converge"
    elif _held(minimum.optimum).any():
        reason = f"at a bound: {', '.join(_names(minimum, _held(minimum.optimum)))}"
    elif not errors.determined.all():
        reason = f"not determined: {', '.join(_names(minimum, ~errors.determined))}"
    elif minimum.doubts:
        reason = "there is another minimum that fits almost as well"
    elif len(parameters) > predictive_scores.EVIDENCE_PARAMETERS:
        reason = f"more than {predictive_scores.EVIDENCE_PARAMETERS} parameters"
    elif len(draws.log_likelihood) < predictive_scores.MIN_EFFECTIVE:
        reason = "nearly all draws fall outside the bounds"
    if reason is None:
        log_prior = -float(np.sum(np.log([q.upper - q.lower for q in parameters])))
        value, stderr, k_hat, effective = predictive_scores.log_evidence(draws, log_prior)
        if k_hat <= predictive_scores.MAX_K_HAT and effective >= predictive_scores.MIN_EFFECTIVE:
            return value, stderr
        reason = f"the importance weights fail (k-hat {k_hat:.2g}, {effective:.0f} effective draws)"
    notes.append(f"no evidence: {reason}.")
    return None


def _ranked(judged: list[_Judged], n: int, known_noise: bool) -> tuple[Entry, ...]:
    """Entries with their scores against the first, the best first."""

    def key(item: _Judged) -> tuple[float, float, float]:
        terms = (item.by_group, item.by_sample)
        scores = [-np.inf if t is None else float(np.sum(t)) for t in terms]
        return -scores[0], -scores[1], item.entry.chi2 / item.entry.dof

    ordered = sorted(judged, key=key)
    first = ordered[0]
    return tuple(
        replace(
            item.entry,
            held_out=_score(item.by_group, first.by_group, None, known_noise),
            loo=_score(item.by_sample, first.by_sample, n, known_noise),
        )
        for item in ordered
    )


def _score(
    terms: FloatArray | None, first: FloatArray | None, n: int | None, known_noise: bool
) -> Score | None:
    """Sum over n terms, of which some may stand for all, against the first model's."""
    if terms is None or first is None:
        return None
    total = len(terms) if n is None else n

    def summed(t: FloatArray) -> tuple[float, float]:
        return float(total * t.mean()), float(total * t.std(ddof=1) / np.sqrt(len(t)))

    difference, stderr = summed(terms - first)
    size = abs(difference)
    clear = size >= TOLD_APART * stderr or (known_noise and size >= CLEAR)
    return Score(
        *summed(terms),
        difference,
        stderr,
        terms=len(terms),
        worse=int(np.count_nonzero(terms < first)),
        told_apart=bool(size > SMALL and clear),
    )


def _conclusion(entries: tuple[Entry, ...]) -> str:
    """One sentence: which models the data cannot tell from the best."""
    best = entries[0]
    kind: Literal["held_out", "loo"] = "loo" if best.held_out is None else "held_out"
    words = "held-out" if kind == "held_out" else "leave-one-out"
    scores = {e.model: getattr(e, kind) for e in entries[1:]}
    if getattr(best, kind) is None:
        return "No predictive score could be computed; the data and these models do not allow it."
    same = [name for name, s in scores.items() if s is not None and not s.told_apart]
    unknown = [name for name, s in scores.items() if s is None]
    if same:
        text = (
            f"By the {words} score the data cannot tell {best.model} from {_listed(same)}: the "
            f"difference is below {TOLD_APART:g} standard errors or below {SMALL:g}"
        )
        near = [name for name in same if abs(scores[name].difference) > SMALL]
        if near and kind == "held_out":
            counts = [f"{name} at {scores[name].worse} of {scores[name].terms}" for name in near]
            text += f", though it predicts better than {_listed(counts)} incidences"
    else:
        text = f"By the {words} score {best.model} predicts better than every other model scored"
    return text + (f"; {_listed(unknown)} could not be scored." if unknown else ".")


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


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
            " Misfit counts as noise in it: scores of single samples and evidence are then too "
            "sure, the scatter between incidences is the better guide."
        )
    notes = [text]
    if len(groups) < predictive_scores.MIN_GROUPS:
        notes.append(
            f"no held-out score: the samples have {len(groups)} groups of incidence and "
            f"{predictive_scores.MIN_GROUPS} are needed; measure more incidences or widen the cuts."
        )
    elif len(groups) < ROUGH_GROUPS:
        notes.append(f"standard errors over {len(groups)} incidences are rough.")
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
