"""Do repeated directions have values that cannot be repeats?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray

LEAST = 5  # directions that occur more than once
SPREAD = 0.3  # relative standard deviation of repeats that no measurement has
AT_POLE = 0.2  # the same where they differ in an azimuth that means nothing
ORDERED = 0.1  # the same where the repeats follow the same order everywhere
IN_ORDER = 0.9  # share of the spread that the order of the lines explains
FACTOR = 8.0  # times the stated uncertainty
TURN = 2**23  # steps of a turn: less than 1e-6 rad each
MULTIPLIER = 6364136223846793005  # odd and with bits in no order (Knuth)


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Equal directions with values that differ by more than noise."""
    key = _directions(evidence)
    if not _enough(key):
        return
    _, group, count = np.unique(key, return_inverse=True, return_counts=True)
    several = count[group] > 1
    usable = several & (evidence.value > 0.3 * np.median(np.abs(evidence.value)))
    if len(np.unique(group[usable])) < LEAST:
        return
    index = np.flatnonzero(usable)
    of, log = group[index], np.log(evidence.value[index])
    off = log - _mean(log, of)[of]
    repeats = np.bincount(of)[of] > 1
    index, of, off = index[repeats], of[repeats], off[repeats]
    distinct = len(np.unique(of))
    if distinct < LEAST:
        return
    spread = float(np.sqrt(np.sum(off**2) / max(len(off) - distinct, 1)))
    order = _occurrence(group)[index]
    ordered = 1 - float(np.sum((off - _mean(off, order)[order]) ** 2) / max(np.sum(off**2), 1e-300))
    noise = 0.0
    if evidence.u is not None:
        noise = float(np.sqrt(np.mean((evidence.u[index] / evidence.value[index]) ** 2)))
    at_pole = np.minimum(evidence.theta_i[index], evidence.theta_r[index]) < 1e-6
    pole = bool(at_pole.mean() > 0.9)
    implausible = spread > (AT_POLE if pole else SPREAD)
    implausible |= spread > ORDERED and ordered > IN_ORDER
    if implausible and spread >= FACTOR * noise:
        yield _finding(evidence, index, distinct, spread, ordered, pole=pole)


def _directions(evidence: Evidence) -> NDArray[np.int64]:
    """A number for the direction pair of each sample, the same for those equal to 1e-6 rad."""
    key = np.zeros(evidence.n, np.int64)
    pairs = ((evidence.theta_i, evidence.phi_i), (evidence.theta_r, evidence.phi_r))
    for theta, phi in pairs:
        polar = np.rint(theta * (TURN / (2 * np.pi))).astype(np.int64)
        azimuth = np.rint(phi * (TURN / (2 * np.pi))).astype(np.int64)
        azimuth &= TURN - 1  # of whole turns the rest
        azimuth *= polar > 1  # the normal has no azimuth
        for angle in (polar, azimuth):
            # Products wrap around: other directions have the same number once in 10^18 pairs.
            key *= MULTIPLIER
            key += angle
    return key


def _enough(key: NDArray[np.int64]) -> bool:
    """Whether enough directions occur more than once."""
    ordered = np.sort(key)
    again = ordered[1:] == ordered[:-1]
    return int(np.count_nonzero(again[1:] & ~again[:-1])) + int(again[:1].sum()) >= LEAST


def _mean(values: FloatArray, group: NDArray[np.int64]) -> FloatArray:
    """Mean of the values of each group."""
    count = np.maximum(np.bincount(group), 1)
    mean: FloatArray = np.bincount(group, weights=values) / count
    return mean


def _occurrence(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many samples of the same direction stand before each sample."""
    order = np.argsort(group, kind="stable")
    ranked = group[order]
    starts = np.flatnonzero(np.r_[True, ranked[1:] != ranked[:-1]])
    number = np.arange(len(group)) - np.repeat(starts, np.diff(np.r_[starts, len(group)]))
    result = np.empty(len(group), np.int64)
    result[order] = number
    return result


def _finding(
    evidence: Evidence,
    index: NDArray[np.int64],
    distinct: int,
    spread: float,
    ordered: float,
    *,
    pole: bool,
) -> Finding:
    text = (
        f"{distinct} directions occur more than once, with values that differ by {spread:.0%} "
        f"({evidence.where(index)})"
    )
    if pole:
        name = "theta_r" if np.all(evidence.theta_r[index] < 1e-6) else "theta_i"
        return Finding(
            "azimuth_at_pole",
            "warning",
            f"{text}: where {name} is 0 the azimuth means nothing, and the values depend on it. "
            "Columns stand in the wrong order, or polar angles are elevations: compare the header "
            "with the columns.",
            tuple(index.tolist()),
            evidence.lines(index),
        )
    why = f"; the order of the lines explains {ordered:.0%} of that" if ordered > IN_ORDER else ""
    return Finding(
        "inconsistent_repeats",
        "warning",
        f"{text}{why}: the file holds several wavelengths, samples or polarisations as one. Name "
        "them in a column channel or wavelength_nm.",
        tuple(index.tolist()),
        evidence.lines(index),
    )


QUESTION = Question(
    key="repeats",
    order=140,
    asks="Do repeated directions have values that cannot be repeats?",
    compares="the values of equal directions with 30 % (20 % where theta is 0), or with 10 % "
    "where they differ in the order of the lines, and with 8 times the stated uncertainty",
    codes=("inconsistent_repeats", "azimuth_at_pole"),
    ask=ask,
)
