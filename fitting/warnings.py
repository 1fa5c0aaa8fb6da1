"""The warnings that a fit gives, in words."""

from __future__ import annotations

import re

import numpy as np

from gonio.fitting.minimum.record import MISFIT, Minimum
from gonio.fitting.problem.losses import NO_RESIDUAL
from gonio.fitting.problem.noise_law import laws_in_words
from gonio.fitting.uncertainty import covariance as uncertainty

ONE_BY_ONE = 3  # warnings that parts of a joint fit have in common, listed one by one


def warnings_of(minimum: Minimum, errors: uncertainty.Uncertainty) -> list[str]:
    problem = minimum.problem
    warnings = []
    if not minimum.optimum.verified:
        warnings.append("the minimum was not reached: the next step would still change the fit.")
    if minimum.optimum.limited:
        names = " + ".join(problem.parameters[j].name for j in minimum.optimum.limited)
        warnings.append(
            f"{names} is at its bound 1, beyond which the surface would reflect more light than it "
            "receives: the data alone would give more; their intervals are those of chi-squared "
            "along the bound."
        )
    warnings += [
        f"the derivative of {problem.name} with respect to {name} does not agree with its "
        "formula: the fit cannot be trusted until the model's kernel is corrected."
        for name in minimum.faults
    ]
    stated_noise = problem.weights == "sd" and problem.quadratic and not minimum.parts
    if stated_noise and minimum.chi2 / minimum.dof > MISFIT:
        size = f"the residuals are {errors.noise_scale:.3g} times as large as the stated "
        # Where the uncertainties allow for misfit they are no multiple of the noise.
        multiplied = "noise; the independent uncertainties were multiplied by that factor."
        warnings.append(f"{size}independent {'noise.' if errors.allowance else multiplied}")
    warnings += _no_scale(minimum)
    warnings += laws_in_words(problem.noise_laws)
    if problem.samples.n_negative:
        warnings.append(
            f"{problem.samples.n_negative} of {problem.n} values are negative; they were kept as "
            "noise around zero."
        )
    return warnings


def _no_scale(minimum: Minimum) -> list[str]:
    """Where the residuals do not tell the size of the noise that the loss needs."""
    problem = minimum.problem
    if not problem.finds_scale:
        return []
    residual = problem.samples.value - problem.values(minimum.optimum.p)
    if not problem.law.has_no_scale(residual * np.sqrt(problem.inverse_variance)):
        return []
    zeros = int(np.count_nonzero(np.abs(residual) <= NO_RESIDUAL * np.max(np.abs(residual))))
    return [
        f"{zeros} of {problem.n} residuals are exactly 0: loss {problem.law.name!r} finds the size "
        "of the noise in residuals of which more than one in five is not; the root mean square of "
        "all stands for it. Values that are no measurements should be left out."
    ]


def condensed(lines: list[str]) -> list[str]:
    """Warnings that more than a few parts of a joint fit have in common, as one line each."""
    groups: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for line in lines:
        match = re.match(r"(\w+)\[(.+?)\] ([^(:]+?) ?[(:]", line)
        key = (match[1], match[3]) if match else ("", line)
        groups.setdefault(key, []).append((match[2] if match else "", line))
    merged_lines = []
    for (name, what), items in groups.items():
        if len(items) <= ONE_BY_ONE:
            merged_lines += [line for _, line in items]
        else:
            merged_lines.append(
                f"{name} {what} in {len(items)} parts: {', '.join(p for p, _ in items)}."
            )
    return merged_lines
