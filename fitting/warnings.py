"""The warnings that a fit gives, in words."""

from __future__ import annotations

import re

from gonio.fitting.minimum.record import MISFIT, Minimum
from gonio.fitting.uncertainty import covariance as uncertainty

ONE_BY_ONE = 3  # warnings that parts of a joint fit have in common, listed one by one


def warnings_of(found: Minimum, errors: uncertainty.Uncertainty) -> list[str]:
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
