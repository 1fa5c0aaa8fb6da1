"""The scores of one model under the noise of the best-fitting one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.comparison import predictive_scores
from gonio.fitting.comparison.records import Entry
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.residual_tests.verdict import verdict_of
from gonio.fitting.uncertainty.at_minimum import uncertainties
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.geometry import FloatArray
from gonio.wording import counted


@dataclass(frozen=True)
class Judged:
    """A model with the terms of its scores, before they are set against each other."""

    entry: Entry
    by_group: FloatArray | None
    by_sample: FloatArray | None


def score_model(
    minimum: Minimum,
    reference: Minimum,
    groups: list[predictive_scores.Index],
    some: predictive_scores.Index,
    seed: int,
) -> Judged:
    """One model under the noise of the best-fitting one."""
    verdict = verdict_of(minimum)
    problem, optimum = minimum.problem, minimum.optimum
    common = reference.problem.inverse_variance
    if not np.array_equal(problem.inverse_variance, common):
        problem = problem.with_weights(common)
        optimum = minimise(problem, optimum.p, search=False)
    minimum = replace(minimum, problem=problem, optimum=optimum, noise_scale=reference.noise_scale)
    errors, undetected = uncertainties(minimum)
    notes = [*minimum.warnings, *undetected]
    by_group = _held_out(minimum, groups, notes)
    rng = np.random.default_rng([seed, 1])
    draws = predictive_scores.draw(minimum, some, rng)
    by_sample, k_hat = _leave_one_out(draws, notes)
    evidence = _evidence(minimum, errors, draws, notes)
    parameters = problem.parameters
    entry = Entry(
        model=problem.name,
        status=minimum.status,
        n_parameters=len(parameters),
        chi2=minimum.chi2,
        dof=minimum.dof,
        values={r.parameter.name: float(r.of(optimum.p)) for r in problem.reported},
        units={r.parameter.name: r.parameter.unit for r in problem.reported},
        at_bound=_names(minimum, _held(optimum)),
        undetermined=_names(minimum, ~_held(optimum) & ~errors.determined),
        priors={q.name: (q.lower, q.upper) for q in parameters},
        held_out=None,
        held_out_by_group=None if by_group is None else tuple(map(float, by_group)),
        loo=None,
        loo_k_hat=k_hat,
        log_evidence=None if evidence is None else evidence[0],
        log_evidence_stderr=None if evidence is None else evidence[1],
        notes=tuple(notes),
        verdict=verdict,
    )
    return Judged(entry, by_group, by_sample)


def _names(minimum: Minimum, which: Any) -> tuple[str, ...]:
    names = [q.name for q in minimum.problem.parameters]
    return tuple(name for name, chosen in zip(names, which, strict=True) if chosen)


def _held_out(
    minimum: Minimum, groups: list[predictive_scores.Index], notes: list[str]
) -> FloatArray | None:
    problem = minimum.problem
    if len(groups) < predictive_scores.MIN_GROUPS:
        return None  # said once for all models
    left = problem.n - max(len(group) for group in groups)
    if left <= len(problem.parameters):
        notes.append(
            f"no held-out score: without the largest incidence {left} samples are left for "
            f"{counted(len(problem.parameters), 'parameter')}."
        )
        return None
    score = predictive_scores.held_out(minimum, groups)
    if score.unverified:
        notes.append(
            f"{score.unverified} of {len(groups)} held-out fits did not reach a verified minimum."
        )
    if score.left_out:
        notes.append(
            f"the held-out score leaves out {', '.join(score.left_out)}: each has more than "
            f"{predictive_scores.MAX_SHARED} draws."
        )
    return score.by_group


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
            "the leave-one-out score is unreliable: k-hat is above "
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
    elif minimum.warnings:
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
