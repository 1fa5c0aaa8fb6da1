"""What a joint fit says of each of its parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gonio.fitting.minimum.joint import JointMinimum
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.minimum.record import MISFIT, Minimum
from gonio.fitting.problem.channels import Channel
from gonio.fitting.problem.joint import JointProblem, base_name
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.result import PartFit, Sharing
from gonio.fitting.uncertainty.correlated_parts import (
    mean_correlation,
    residual_correlation,
)
from gonio.fitting.uncertainty.sharing_test import sharing_test
from gonio.geometry import FloatArray

LISTED = 3  # parts that a warning names
TINY = 1e-15  # a chance below which its digits mean nothing


def with_parts(joint: JointMinimum) -> Minimum:
    """The minimum with its parts, the test of what they share, and the warnings of both."""
    problem, optimum = joint.problem, joint.whole.optimum
    test, apart = sharing_test(problem, optimum, joint.alone, joint.channels)
    parts = _part_fits(problem, optimum, apart, joint.channels, joint.whole.noise_scale)
    warnings = _misfits(problem, parts) + _refusal(problem, optimum, parts, test)
    warnings += _correlation_warning(problem, optimum)
    return replace(
        joint.whole,
        warnings=warnings + joint.whole.warnings,
        chi2=sum(part.chi2 for part in parts),
        parts=parts,
        sharing=test if test.parameters else None,
    )


def _part_fits(
    problem: JointProblem,
    optimum: Optimum,
    alone: Sequence[Mapping[str, tuple[float, float | None]]],
    channels: Sequence[Channel],
    scale: float,
) -> tuple[PartFit, ...]:
    """What the fit says of each part."""
    fits = []
    own = [q.name != base_name(q.name) for q in problem.parameters]
    pieces = zip(problem.pieces(), problem.scales, channels, alone, strict=True)
    for k, ((part, _, index), factor, channel, pairs) in enumerate(pieces):
        n_own = sum(int(own[j] and optimum.free[j]) for j in index)
        fits.append(
            PartFit(
                name=channel.label,
                parameters=problem.names_of_part(k),
                alone=pairs,
                chi2=_chi2(part, optimum.p[index], factor),
                dof=part.n - n_own,
                noise_scale=factor * scale,
                n_samples=part.n,
                n_negative=part.samples.n_negative,
                select=channel.select,
                input=channel.material or None,
            )
        )
    return tuple(fits)


def _chi2(part: Problem, p: FloatArray, factor: float) -> float:
    """chi-squared of a part by its stated uncertainties, without the factor on them."""
    if part.weights != "sd":
        return part.chi2(p) * factor**2
    f = part.values(p)
    return float(np.sum((part.samples.value - f) ** 2 / part.variance(f)))


def _misfits(problem: JointProblem, parts: Sequence[PartFit]) -> list[str]:
    """Parts that the model does not fit even when they are fitted alone."""
    bad = [part for part, s in zip(parts, problem.scales, strict=True) if s**2 > MISFIT]
    if problem.weights != "sd" or not bad:
        return []
    where = ", ".join(part.name for part in bad[:LISTED])
    where += f" and {len(bad) - LISTED} more" if len(bad) > LISTED else ""
    return [
        f"in {where} the residuals are {_range([part.noise_scale for part in bad])} times as large "
        "as the stated independent noise; the independent uncertainties there were multiplied by "
        "that factor."
    ]


def _refusal(
    problem: JointProblem, optimum: Optimum, parts: Sequence[PartFit], test: Sharing
) -> list[str]:
    if not test.refused or test.p_value is None:
        return []
    chance = f"p = {test.p_value:.2g}" if test.p_value > TINY else f"p < {TINY:g}"
    why = (
        f"chi2 grows by {test.growth:.4g} over separate fits, of which noise explains about "
        f"{test.dof}"
    )
    if test.distance is not None:
        why = (
            f"separate estimates differ by up to {test.distance:.2g} standard uncertainties, which "
            "allow for misfit"
        )
    return [
        f"the data reject one {' and one '.join(test.parameters)} for all parts: {why} "
        f"({chance}). {_farthest(problem, optimum, parts)}"
    ]


def _correlation_warning(problem: JointProblem, optimum: Optimum) -> list[str]:
    r = residual_correlation(problem, optimum.p)
    if r is None:
        return []
    return [
        f"the residuals of the parts are correlated (correlation {mean_correlation(r):.2g} at the "
        "same directions): the model has the same error in all of them. The standard uncertainties "
        "and the test of the sharing allow for it; limits at bounds and a posterior do not."
    ]


def _range(numbers: Sequence[float]) -> str:
    low, high = f"{min(numbers):.3g}", f"{max(numbers):.3g}"
    return low if low == high else f"{low} to {high}"


def _farthest(problem: JointProblem, optimum: Optimum, parts: Sequence[PartFit]) -> str:
    """Which part disagrees most with a shared value, by its own uncertainty."""
    worst = (0.0, "")
    for q, value in zip(problem.parameters, optimum.p, strict=True):
        for part in parts:
            alone, sd = part.alone.get(q.name, (0.0, None))
            if sd:
                distance = abs(alone - float(value)) / sd
                unit = f" {q.file_unit}" if q.file_unit else ""
                text = (
                    f"The farthest is {part.name}: {q.name} alone is {q.to_file(alone):.4g} +/- "
                    f"{q.to_file(sd):.2g}{unit}, "
                    f"together it is {q.to_file(float(value)):.4g}{unit}."
                )
                worst = max(worst, (distance, text))
    return worst[1]
