"""Exchanges of parameters that the data do not see, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.diagnostics.next_measurement import facts
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.kernels.boxed import UNDETERMINED
from gonio.wording import listed

TAKES_PART = 0.1  # component of a unit vector above which a parameter is part of an exchange


def step_along(
    problem: Problem, optimum: Optimum, informed: NDArray[np.int64], step: FloatArray
) -> dict[str, float]:
    """A step along an axis, its largest relative change 10 %, in file units."""
    size = np.maximum(np.abs(optimum.p[informed]), 1e-12)
    part = np.abs(step) / size
    factor = 0.1 / max(float(part.max()), 1e-300)
    factor *= np.sign(step[int(np.argmax(part))]) or 1.0
    return {
        problem.parameters[k].name: problem.parameters[k].to_file(float(s * factor))
        for k, s in zip(informed.tolist(), step, strict=True)
    }


def causes_of(
    problem: Problem,
    optimum: Optimum,
    informed: NDArray[np.int64],
    values: FloatArray,
    vectors: FloatArray,
    scale: FloatArray,
    missing: set[int],
    hard: set[int],
) -> list[str]:
    """One sentence for each exchange that the data do not determine, and each missing effect."""
    names = [q.name for q in problem.parameters]
    because = ""
    if hard or np.any(values < UNDETERMINED):
        why = facts(problem)
        because = f" ({'; '.join(why)})" if why else ""
    causes = []
    for k in sorted(missing - set(informed.tolist())):
        causes.append(_without_effect(problem, optimum, k))
    for k in np.flatnonzero(~optimum.free & (np.diag(optimum.curvature) <= 0)).tolist():
        causes.append(_flat_at_bound(problem, optimum, k))
    for value, vector in zip(values, vectors.T, strict=True):
        parts = informed[np.abs(vector) > TAKES_PART]
        if value < UNDETERMINED:
            causes.append(
                _exchange(problem, optimum, parts, informed, vector / scale) + because + "."
            )
    if hard:
        words = listed([names[k] for k in sorted(hard)])
        weakest = next(
            v for value, v in zip(values, vectors.T, strict=True) if value >= UNDETERMINED
        )
        others = [names[m] for m in informed[np.abs(weakest) > TAKES_PART] if m not in hard]
        them = "them" if len(hard) > 1 else "it"
        by = f"{listed(others)} can replace {them}" if others else "one can replace another"
        causes.append(
            f"{words} {'are' if len(hard) > 1 else 'is'} hardly determined: {by}{because}."
        )
    return causes


def _exchange(
    problem: Problem,
    optimum: Optimum,
    parts: NDArray[np.int64],
    informed: NDArray[np.int64],
    step: FloatArray,
) -> str:
    """What is exchanged for what, without the full stop."""
    names = [problem.parameters[k].name for k in parts]
    if len(parts) == 2 and all(problem.parameters[k].linear for k in parts):
        return f"{listed(names)} scale the same shape in these data: only their sum is determined"
    change = step_along(problem, optimum, informed, step)
    shown = []
    for k in parts.tolist():
        q = problem.parameters[k]
        value = q.to_file(float(optimum.p[k]))
        if value:
            shown.append(f"{100 * change[q.name] / value:+.0f} % in {q.name}")
        else:
            shown.append(f"{change[q.name]:+.2g} in {q.name}")
    return f"{listed(names)} can be exchanged: {listed(shown)} leave every sample unchanged"


def _without_effect(problem: Problem, optimum: Optimum, k: int) -> str:
    """Why a free parameter has no derivative."""
    names = [q.name for q in problem.parameters]
    holders = depends_on(problem, optimum, k)
    if holders:
        q = problem.parameters[holders[0]]
        at = q.to_file(float(optimum.p[holders[0]]))
        return (
            f"{names[k]} has no effect while {q.name} is at its bound {at:.4g}: no direction "
            f"determines it unless the data move {q.name} off its bound."
        )
    why = facts(problem)
    because = f" ({'; '.join(why)})" if why else ""
    return f"{names[k]} has no effect on any of these samples{because}."


def depends_on(problem: Problem, optimum: Optimum, k: int) -> list[int]:
    """Parameters at a bound that take away the effect of parameter k."""
    others = []
    for m in np.flatnonzero(~optimum.free).tolist():
        q = problem.parameters[m]
        inside = optimum.p.copy()
        inside[m] += 0.05 * (q.upper - q.lower) * (1 if inside[m] <= q.lower else -1)
        if np.any(problem.jacobian(inside)[1][:, k] != 0):
            others.append(m)
    return others


def _flat_at_bound(problem: Problem, optimum: Optimum, k: int) -> str:
    q = problem.parameters[k]
    at = q.to_file(float(optimum.p[k]))
    return (
        f"{q.name} acts only in second order near its bound {at:.4g}, so that there is no "
        "curvature there; its limit comes from the profile of chi-squared."
    )
