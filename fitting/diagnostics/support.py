"""What carries a parameter: how many samples, which, and how well their angles must be known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gonio.fitting.diagnostics.angle_sensitivity import moved_by_angles
from gonio.fitting.diagnostics.next_measurement import suggest_measurement
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.result import Estimate
from gonio.fitting.uncertainty.established import ENOUGH, LEVERAGE, carriers
from gonio.fitting.uncertainty.informed import Informed
from gonio.geometry import FloatArray

ANGLE_DEG = 0.1  # error of the angles that is looked at where nobody states one
MATTERS = 0.01  # change by it, relative to the value, below which it decides nothing
NAMED = 3  # samples that are named
MOST = 100  # unknowns beyond which nothing is asked


@dataclass(frozen=True)
class Support:
    """What carries one parameter.

    Parameters
    ----------
    effective_samples : float
        Degrees of freedom that leaving out single samples gives its variance: about the number of
        samples that decide it.
    leverage : float
        Mean share that its samples have in their own fitted values, by how much they move it.
    moved_by_angles : float or None
        Standard deviation by independent errors of 0.1 degrees in the viewing directions, in file
        units; None where errors of directions are stated.
    samples : tuple of int
        Numbers of the samples that move it most.
    shares : tuple of float
        Their shares in its variance by equal noise.
    reasons : tuple of str
        Why it is not established; empty where it is.
    """

    effective_samples: float
    leverage: float
    moved_by_angles: float | None
    samples: tuple[int, ...]
    shares: tuple[float, ...]
    reasons: tuple[str, ...]


def supports(
    minimum: Minimum,
    estimates: Mapping[str, Estimate],
    informed_by: Callable[[], Informed] | None = None,
) -> dict[str, Support]:
    """What carries each parameter that has a standard uncertainty, by its name.

    Parameters
    ----------
    minimum : Minimum
    estimates : mapping of str to Estimate
        Of the unknowns, radians for angles.
    informed_by : callable, optional
        `Informed.once` of the minimum as least squares, where others need it as well.
    """
    minimum = minimum.as_least_squares()
    problem = minimum.problem
    wanted = [j for j, q in enumerate(problem.parameters) if estimates[q.name].stderr is not None]
    if not wanted or len(problem.parameters) > MOST:
        return {}
    informed = (informed_by or Informed.once(minimum))()
    gain = informed.gain
    number, leverage = carriers(informed)
    angles: FloatArray | None = None
    if not any(term.moves_directions for term in problem.samples.shared):
        angles = moved_by_angles(minimum, gain, float(np.radians(ANGLE_DEG)))
    found = {}
    for j in wanted:
        q = problem.parameters[j]
        weight = gain[:, j] ** 2
        weight = weight / max(float(weight.sum()), 1e-300)
        first = _largest(weight)
        moved = None if angles is None else float(angles[j])
        found[q.name] = Support(
            effective_samples=float(number[j]) if np.isfinite(number[j]) else 0.0,
            leverage=float(leverage[j]),
            moved_by_angles=None if moved is None else q.to_file(moved),
            samples=tuple(first),
            shares=tuple(float(weight[k]) for k in first),
            reasons=tuple(_reasons(estimates[q.name], float(number[j]), float(leverage[j]), moved)),
        )
    return found


def _largest(weight: FloatArray) -> list[int]:
    """The samples with the largest weights, by size; of equal ones the last."""
    left, first = weight.copy(), []
    for _ in range(min(NAMED, len(left))):
        first.append(len(left) - 1 - int(np.argmax(left[::-1])))
        left[first[-1]] = -1.0
    return first


def _reasons(estimate: Estimate, number: float, leverage: float, moved: float | None) -> list[str]:
    reasons = []
    if not number >= ENOUGH:
        size = f"{number:.2g}"
        carry = "effective sample carries" if size == "1" else "effective samples carry"
        reasons.append(f"{size} {carry} it, where {ENOUGH:g} establish it")
    elif leverage > LEVERAGE:
        reasons.append("each of the samples that carry it decides its own fitted value")
    assert estimate.stderr is not None
    if moved is not None and moved > max(estimate.stderr, MATTERS * abs(estimate.value)):
        ratio = moved / estimate.stderr if estimate.stderr > 0 else np.inf
        reasons.append(
            f"errors of {ANGLE_DEG:g} deg in the angles, which nobody states, would move it by "
            f"{ratio:.2g} of its standard uncertainties"
        )
    return reasons


def support_warnings(
    minimum: Minimum, found: Mapping[str, Support], others: Sequence[str] = ()
) -> list[str]:
    """A sentence for each parameter that is not established, and what would establish them.

    What one of the other warnings suggests already is not suggested again.
    """
    problem = minimum.problem
    weak = [j for j, q in enumerate(problem.parameters) if q.name in found]
    weak = [j for j in weak if found[problem.parameters[j].name].reasons]
    sentences = []
    for j in weak:
        name = problem.parameters[j].name
        own = found[name]
        most = ", ".join(
            f"{_place(problem, k)} ({100 * share:.0f} %)"
            for k, share in zip(own.samples, own.shares, strict=True)
        )
        sentences.append(
            f"{name} is not established by these data: {' and '.join(own.reasons)}; most is "
            f"carried by {most}."
        )
    if weak:
        suggested = suggest_measurement(minimum, weak, anew=True)
        if suggested is not None and not any("Measure " in text for text in others):
            sentences[-1] += f" {suggested.text}"
    return sentences


def _place(problem: Problem, k: int) -> str:
    d, n = problem.samples.directions, problem.n
    theta_i, phi_i, theta_r, phi_r = (
        float(np.degrees(np.broadcast_to(a, (n,))[k]))
        for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)
    )
    return f"theta_i {theta_i:.3g}, theta_r {theta_r:.3g}, phi {(phi_r - phi_i) % 360:.4g} deg"
