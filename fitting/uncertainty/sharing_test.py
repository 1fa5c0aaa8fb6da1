"""Test of the parameters that the parts of a joint fit share.

Where the model holds, by the growth of chi-squared from separate fits to the joint one; where it
does not, by the estimates of the separate fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.optimum import Optimum, better
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.channels import Channel
from gonio.fitting.problem.joint import JointProblem, base_name
from gonio.fitting.residual_tests.verdict import misfit_beyond_shared
from gonio.fitting.result import Sharing
from gonio.fitting.result.verdict import TOLERANCE
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.fitting.uncertainty.correlated_parts import (
    residual_correlation,
    with_correlated_parts,
)
from gonio.fitting.uncertainty.estimates_compared import compared_estimates
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.under_misfit import allowing
from gonio.geometry import FloatArray
from gonio.kernels.boxed import UNDETERMINED

REFUSED = 0.01  # chance below which the data refuse the sharing


def sharing_test(
    problem: JointProblem,
    optimum: Optimum,
    alone: Sequence[Minimum],
    channels: Sequence[Channel],
) -> tuple[Sharing, list[dict[str, tuple[float, float | None]]]]:
    """Whether the parts share what the joint fit lets them; the shared parameters part by part.

    All with the weights of the joint fit, so that the growth of chi-squared is never negative.

    Notes
    -----
    Where the residuals of the separate fits show that the model, or equal noise, does not hold, or
    where residuals of the parts are correlated, the estimates of the separate fits are compared.
    A model that does not hold finds other values where it is wrong in another way, as at another
    wavelength. Such a difference may be clear, and is not refused where it changes f by less than
    the tolerance of the verdict. Where the model holds, the likelihood ratio decides.
    """
    apart, growth = [], 0.0
    for minimum, (part, _, index) in zip(alone, problem.pieces(), strict=True):
        own = minimise(part, minimum.optimum.p, search=False)
        other = minimise(part, optimum.p[index], search=False)
        apart.append(better(own, other))
        growth += max(part.chi2(optimum.p[index]) - apart[-1].chi2, 0.0)
    separate = JointProblem.from_parts(channels, problem.parts, ())
    separate = replace(separate, scales=problem.scales)
    whole = Minimum.of(separate, _stacked(apart), 1.0)
    errors = uncertainty.evaluate(whole)
    names = tuple(q.name for q in problem.parameters if q.name == base_name(q.name))
    dof = sum(_rank(own) for own in apart) - _rank(optimum)
    misfit, informed_by = misfit_beyond_shared(whole), Informed.once(whole)
    honest = allowing(whole, with_correlated_parts(whole, errors), misfit, informed_by)
    by_estimates = (
        honest.allowance is not None or residual_correlation(separate, whole.optimum.p) is not None
    )
    comparison = (
        compared_estimates(whole, names, honest, misfit, informed_by) if by_estimates else None
    )
    p_value = None if comparison is None else comparison.p
    if not by_estimates and dof > 0:
        allowed = growth * _allowance(names, separate, apart, errors)
        left = problem.n - sum(int(np.count_nonzero(own.free)) for own in apart)
        p_value = _chance(problem, allowed, dof, left)
    identified_pairs = []
    for own, part, index in zip(apart, separate.parts, separate.indices, strict=True):
        pairs: dict[str, tuple[float, float | None]] = {}
        for j, q in enumerate(part.parameters):
            if q.name in names:
                sd = float(np.sqrt(honest.covariance[index[j], index[j]]))
                is_known = errors.determined[index[j]] and sd < q.upper - q.lower
                pairs[q.name] = (float(own.p[j]), sd if is_known else None)
        identified_pairs.append(pairs)
    refused = p_value is not None and p_value < REFUSED
    test = Sharing(names, growth, max(dof, 0), p_value, refused)
    if comparison is not None:
        change = _change(problem, optimum, growth)
        test = replace(
            test,
            refused=refused and change > TOLERANCE,
            distance=comparison.distance,
            distance_dof=comparison.dof,
            change=change,
        )
    return test, identified_pairs


def _change(problem: JointProblem, optimum: Optimum, growth: float) -> float:
    """Typical change of f by the sharing, as a fraction of f: the root of growth / sum w f^2."""
    level = float(np.sum(problem.inverse_variance * problem.values(optimum.p) ** 2))
    return float(np.sqrt(growth / max(level, 1e-300)))


def _chance(problem: JointProblem, growth: float, dof: int, left: int) -> float:
    """Chance of a larger growth; where the scatter stands for the noise, by its F distribution."""
    if problem.weights == "sd" and max(problem.scales) == 1.0:
        return float(stats.chi2.sf(growth, dof))
    return float(stats.f.sf(growth / dof, dof, left))


def _allowance(
    names: Sequence[str],
    separate: JointProblem,
    apart: Sequence[Optimum],
    errors: uncertainty.Uncertainty,
) -> float:
    """Share of the disagreement that is left with the errors that not all parts have in common.

    The parameters that separate fits find scatter about a common value by their independent
    errors, and by shared errors that act otherwise in one part than in another.
    """
    if not errors.shared:
        return 1.0
    compared, value, column = [], [], []
    for own, part, index in zip(apart, separate.parts, separate.indices, strict=True):
        for j, q in enumerate(part.parameters):
            if q.name in names and errors.determined[index[j]]:
                compared.append(index[j])
                value.append(own.p[j])
                column.append(names.index(q.name))
    design = np.eye(len(names))[column]
    at = np.ix_(compared, compared)
    covariances = errors.independent[at], errors.covariance[at]
    independent, full = (_disagreement(np.array(value), design, c) for c in covariances)
    return float(np.clip(full / independent, 0.0, 1.0)) if independent > 0 else 1.0


def _disagreement(value: FloatArray, design: FloatArray, covariance: FloatArray) -> float:
    """Weighted sum of squares about the best common values."""
    unit = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(unit, unit) + 1e-12 * np.eye(len(unit)))
    y, x = np.linalg.solve(root, value / unit), np.linalg.solve(root, design / unit[:, None])
    return float(np.sum((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2))


def _stacked(apart: Sequence[Optimum]) -> Optimum:
    """Separate minima as the minimum of a joint problem that shares nothing."""
    from scipy.linalg import block_diag

    return Optimum(
        np.concatenate([own.p for own in apart]),
        sum(own.chi2 for own in apart),
        np.concatenate([own.gradient for own in apart]),
        block_diag(*(own.curvature for own in apart)),
        np.concatenate([own.free for own in apart]),
        sum(own.evaluations for own in apart),
        all(own.verified for own in apart),
    )


def _rank(optimum: Optimum) -> int:
    """How many free parameters the data determine."""
    compared = np.flatnonzero(optimum.free & (np.diag(optimum.curvature) > 0))
    scale = 1 / np.sqrt(np.diag(optimum.curvature)[compared])
    scaled = optimum.curvature[np.ix_(compared, compared)] * np.outer(scale, scale)
    return int(np.count_nonzero(np.linalg.eigvalsh(scaled) > UNDETERMINED))
