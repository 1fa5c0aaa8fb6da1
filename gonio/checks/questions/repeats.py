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
BEYOND = 1.5  # times the stated uncertainty, from which on it does not cover the repeats
TYPICALLY = 1.25  # the same for the median, so that single readings do not decide
SIGMAS = 5.0  # of chi-squared, by which repeats must disagree
COMMON = 0.5  # share of the disagreement that one factor for each take explains
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
    elif evidence.u is not None:
        yield from _beyond_stated(evidence, index[~at_pole], of[~at_pole], order[~at_pole])


def _beyond_stated(
    evidence: Evidence, index: NDArray[np.int64], of: NDArray[np.int64], take: NDArray[np.int64]
) -> Iterator[Finding]:
    """Repeats that differ by more than their stated uncertainty, by however little."""
    assert evidence.u is not None
    count = np.bincount(of, minlength=1)[of]
    index, of, take, count = (a[count > 1] for a in (index, of, take, count))
    log, noise = np.log(evidence.value[index]), evidence.u[index] / evidence.value[index]
    distinct = len(np.unique(of))
    dof = len(index) - distinct
    if distinct < LEAST:
        return
    off = (log - _mean(log, of)[of]) * np.sqrt(count / (count - 1))
    ratio = float(np.sqrt(np.mean((off / noise) ** 2)))
    typical = 1.4826 * float(np.median(np.abs(off / noise)))
    if ratio < BEYOND or typical < TYPICALLY or dof * (ratio**2 - 1) < SIGMAS * np.sqrt(2 * dof):
        return
    spread, stated = float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(noise**2)))
    # Take by take, each with the directions that it shares with the first.
    level = _mean(log - _mean(log, of)[of], take)
    left = off - (level[take] - _mean(level[take], of)[of]) * np.sqrt(count / (count - 1))
    factor = float(np.exp(np.ptp(level[np.bincount(take) > 0])) - 1)
    common = 1 - float(np.mean(left**2) / np.mean(off**2))
    why = "the surface, its place or the lamp changed between them"
    if common > COMMON:
        why = (
            f"most of that is one factor between the takes, {factor:.1%} at most: the scale changed"
        )
    yield Finding(
        "repeats_beyond_u",
        "warning",
        f"{distinct} directions occur more than once, with values that differ by {spread:.1%} "
        f"({evidence.where(index)}), {ratio:.2g} times their u_brdf (typically {stated:.1%}): "
        f"u_brdf does not cover it; {why}. State that as a scale (--u-scale), name the takes in a "
        "column channel, or enlarge u_brdf.",
        tuple(index.tolist()),
        evidence.lines(index),
    )


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
    "where they differ in the order of the lines, and with the stated uncertainty",
    codes=("inconsistent_repeats", "azimuth_at_pole", "repeats_beyond_u"),
    ask=ask,
)
