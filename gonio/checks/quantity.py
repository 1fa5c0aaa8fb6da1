"""Which quantity the values hold, decided by light and viewer exchanged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.checks.distinct import numbered
from gonio.checks.pairs import MIN_PAIRS, Pairs, disagreement
from gonio.geometry import FloatArray

BRDF = "BRDF"
WITH_COS_R = "BRDF*cos(theta_r)"
WITH_COS_I = "BRDF*cos(theta_i)"
UNDECIDED = "undecided"
# Pairs whose cosines differ by less than this fraction cannot distinguish the quantities.
MIN_CONTRAST = 0.05
# The power of the cosine that each quantity holds.
POWERS = {BRDF: 0, WITH_COS_R: 1, WITH_COS_I: -1}
NEAR = 0.25  # of a whole power
SURE = 4.0  # standard uncertainties of the power to every other whole one
BETTER = 0.8  # of the disagreement that the next quantity leaves
AGREE = 2 / 3  # of the pairs of polar angles that must be for the quantity
NOISY = 0.3  # scatter of ln f between partners, and their disagreement, that decide nothing


@dataclass(frozen=True)
class QuantityTest:
    """What reciprocal pairs say of the quantity.

    Parameters
    ----------
    quantity : str
        A key of `POWERS`, or "undecided".
    candidates : mapping
        Median disagreement of the pairs if the file holds this quantity.
    n_telling : int
        Number of pairs that distinguish the quantities.
    power, u_power : float or None
        Slope of ln(f/f') over ln(cos theta_r/cos theta_r') of the pairs with its standard
        uncertainty: 0 for a BRDF, 1 for BRDF*cos(theta_r), -1 for BRDF*cos(theta_i). None where
        fewer than twelve pairs are positive.
    why : str
        Why it is undecided, else empty.
    """

    quantity: str
    candidates: Mapping[str, float]
    n_telling: int
    power: float | None
    u_power: float | None
    why: str = ""


def quantity_of(
    value: FloatArray, u: FloatArray | None, theta_i: FloatArray, theta_r: FloatArray, pairs: Pairs
) -> QuantityTest:
    """The quantity for which reciprocal pairs agree, if they tell.

    Parameters
    ----------
    value, u : ndarray, shape (N,)
        Values and, where known, their standard uncertainties.
    theta_i, theta_r : ndarray, shape (N,)
        Radians.
    pairs : Pairs

    Notes
    -----
    A quantity is decided if the power of the cosine is near its own and far from every other in
    standard uncertainties, if its pairs agree better, and if most pairs of polar angles say so.
    The standard uncertainty is the larger of those by the scatter of the pairs and by the scatter
    between pairs of polar angles, because what breaks reciprocity is shared within these.
    """
    k, j = pairs.k, pairs.j
    cosines = [np.cos(theta[index]) for theta in (theta_i, theta_r) for index in (k, j)]
    # At the horizon the cosine is 0 and cannot be divided by.
    above = np.min(cosines, axis=0, initial=1.0) > 1e-6
    telling = above & (disagreement(cosines[2], cosines[3]) > MIN_CONTRAST)
    k, j = k[telling], j[telling]
    i_k, i_j, r_k, r_j = (cosine[telling] for cosine in cosines)
    if len(k) == 0:
        return QuantityTest(UNDECIDED, {}, 0, None, None, _few(0))
    held = {BRDF: (1.0, 1.0), WITH_COS_R: (r_k, r_j), WITH_COS_I: (i_k, i_j)}
    candidates = {
        name: float(np.median(disagreement(value[k] / of_k, value[j] / of_j)))
        for name, (of_k, of_j) in held.items()
    }
    if len(k) < MIN_PAIRS:
        return QuantityTest(UNDECIDED, candidates, len(k), None, None, _few(len(k)))
    floor_k, floor_j = (0.0, 0.0) if u is None else (3 * u[k], 3 * u[j])
    bright = (value[k] > floor_k) & (value[j] > floor_j)
    if np.count_nonzero(bright) < max(MIN_PAIRS, 0.8 * len(k)):
        n = np.count_nonzero(bright)
        why = f"Undecided: only {n} of {len(k)} pairs stand out of the noise."
        return QuantityTest(UNDECIDED, candidates, len(k), None, None, why)
    n_telling = len(k)
    k, j = k[bright], j[bright]
    polar = np.round(np.degrees(np.sort(np.stack([theta_i[k], theta_r[k]]), axis=0)))
    group = numbered(polar[0], polar[1])
    y, c = np.log(value[k] / value[j]), np.log(r_k[bright] / r_j[bright])
    power, u_power, agreeing = _slope(y, c, group)
    scatter = float(1.4826 * np.median(np.abs(y - power * c)))
    best = min(POWERS, key=lambda name: abs(power - POWERS[name]))
    why = _doubt(best, power, u_power, agreeing[POWERS[best]], scatter, candidates)
    return QuantityTest(UNDECIDED if why else best, candidates, n_telling, power, u_power, why)


def _few(n: int) -> str:
    return f"Undecided: {n} reciprocal pairs tell the quantities apart, {MIN_PAIRS} are needed."


def _slope(
    y: FloatArray, c: FloatArray, group: NDArray[np.int64]
) -> tuple[float, float, dict[int, float]]:
    """Robust slope through 0, its standard uncertainty, and the share of groups for each power."""
    power = _median(y / c, np.abs(c))
    iid = 1.2533 * 1.4826 * float(np.median(np.abs(y - power * c))) / np.sqrt(np.sum(c**2))
    of_group, weight = _medians(y / c, np.abs(c), group)
    if len(of_group) > 2:
        off = 1.4826 * _median(np.abs(of_group - power), weight)
        between = 1.2533 * off * np.sqrt(np.sum(weight**2)) / np.sum(weight)
    else:
        between = 0.1
    powers = np.array(list(POWERS.values()))
    nearest = powers[np.argmin(np.abs(of_group[:, None] - powers), axis=1)]
    agreeing = {
        int(p): float(np.sum(weight[nearest == p]) / np.sum(weight)) for p in powers.tolist()
    }
    return power, float(max(iid, between, 1e-6)), agreeing


def _median(values: FloatArray, weight: FloatArray) -> float:
    """The weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _medians(
    values: FloatArray, weight: FloatArray, group: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """The weighted median and the weight of each group."""
    order = np.lexsort((values, group))
    total = np.cumsum(weight[order])
    ends = np.cumsum(np.bincount(group))
    before = np.concatenate([[0.0], total[ends[:-1] - 1]])
    own = total[ends - 1] - before
    # Of two that are equally in the middle the smaller one, whatever rounding the sums have.
    middle = np.searchsorted(total, before + (0.5 - 1e-9) * own)
    first = np.concatenate([[0], ends[:-1]])
    return values[order][np.clip(middle, first, ends - 1)], own


def _doubt(
    best: str,
    power: float,
    u_power: float,
    agreeing: float,
    scatter: float,
    candidates: Mapping[str, float],
) -> str:
    """Why the pairs do not decide for the best quantity; empty where they do."""
    found = (
        f"Undecided: exchanged pairs differ by the power {power:.2f} +- {u_power:.2f} of "
        "cos(theta_r)"
    )
    left = max(scatter, candidates[best])
    if left > NOISY:
        return f"Undecided: partners differ by {left:.0%} beyond any power of the cosine."
    if abs(power - POWERS[best]) > NEAR:
        return f"{found}, which is near no whole power."
    others = [abs(power - p) for name, p in POWERS.items() if name != best]
    if min(others) < SURE * u_power:
        return f"{found}, which does not exclude another quantity."
    if agreeing < AGREE:
        return f"{found}, but {1 - agreeing:.0%} of the pairs of polar angles are for another."
    second = min(d for name, d in candidates.items() if name != best)
    if candidates[best] > BETTER * second:
        return (
            f"{found}, but {best} leaves {candidates[best]:.1%}, and another quantity "
            f"{second:.1%}; the best must leave less than {BETTER:.0%} of the next."
        )
    return ""
