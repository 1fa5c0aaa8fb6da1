"""Does the sample reflect more light than falls on it?"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray

MOST = 1.05  # albedo that errors of a measurement explain
STEEPEST = math.radians(70)  # incidence beyond which measurements are not trusted for this
LEAST = 8  # samples of an incidence
DRAWN = 2000  # samples of an incidence that are looked at
MEASURED = 0.9  # of the area that both sides would cover
FLAT = 0.6  # of the median, below which the darkest sample in the plane says nothing beyond it


def ask(evidence: Evidence) -> Iterator[Finding]:
    """A lower bound of the albedo above 1: a reflectance factor, per cent, or counts."""
    worst, theta, n, how = 0.0, 0.0, 0, ""
    for number in range(min(evidence.n_incidences, 400)):
        index = evidence.of_incidence(number)
        if len(index) < LEAST or evidence.theta_i[index[0]] > STEEPEST:
            continue
        bound, way = lower_bound(evidence, index)
        if bound > worst:
            worst, theta, n, how = bound, float(evidence.theta_i[index[0]]), len(index), way
    if worst > MOST:
        yield Finding("albedo", "warning", _text(worst, math.degrees(theta), n, how))


def lower_bound(evidence: Evidence, index: NDArray[np.int64]) -> tuple[float, str]:
    """A lower bound of the directional albedo from the samples of an incidence, and how it is made.

    Between three neighbouring samples the BRDF is taken for their harmonic mean, below which the
    mean of a lobe does not lie: a peak that one sample has alone counts for nothing. Outside of the
    samples nothing is counted. It is 0 where it cannot exceed `MOST`.
    """
    if len(index) > DRAWN:
        index = index[:: -(-len(index) // DRAWN)]
    theta, delta, f = evidence.theta_r[index], evidence.delta[index], evidence.value[index]
    if evidence.u is not None:
        f = f - evidence.u[index]
    # The projected solid angle is the area in the plane of the sample.
    x, y = np.sin(theta) * np.cos(delta), np.sin(theta) * np.sin(delta)
    if max(_at_most(x, y, f), np.pi * float(f.min())) <= MOST:
        return 0.0, ""
    area, mean = _triangles(x, y, f)
    both_area, both_mean = _triangles(np.r_[x, x], np.r_[y, -y], np.r_[f, f])
    # Measured on one side of the plane of incidence, a sample is as bright on the other.
    if np.sum(area) < MEASURED * np.sum(both_area):
        area, mean = both_area, both_mean
    if len(area):
        return float(np.sum(area * mean)), "between neighbouring samples"
    return _in_plane(theta, delta, f), "with the darkest sample of the plane"


def _at_most(x: FloatArray, y: FloatArray, f: FloatArray) -> float:
    """What no triangles between the samples exceed, mirrored ones included.

    The harmonic mean of three values exceeds t = 3/(1/g + 2/max f) only if all of them exceed g,
    and the triangles between samples above g lie in the rectangle that holds these.
    """
    order = np.argsort(-f)
    order = order[f[order] > 0]
    if not len(order):
        return 0.0
    x, y, g = x[order], np.abs(y[order]), f[order]
    width = np.maximum.accumulate(x) - np.minimum.accumulate(x)
    area = np.minimum((width + 1e-5) * (2 * np.maximum.accumulate(y) + 1e-5), np.pi)
    t = 3 / (1 / g + 2 / g[0])
    return float(np.sum(area * (t - np.append(t[1:], 0.0))))


def _triangles(x: FloatArray, y: FloatArray, f: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Areas of the triangles between samples, and the harmonic means of their corners."""
    from scipy.spatial import Delaunay, QhullError

    points, first = np.unique(np.round(np.stack([x, y], axis=1), 6), axis=0, return_index=True)
    if len(points) < 4 or np.ptp(points[:, 1]) < 1e-3 or np.ptp(points[:, 0]) < 1e-3:
        return np.zeros(0), np.zeros(0)
    try:
        corners = Delaunay(points).simplices
    except QhullError:
        return np.zeros(0), np.zeros(0)
    a, b, c = (points[corners[:, k]] for k in range(3))
    area = 0.5 * np.abs(
        (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    )
    values = f[first][corners]
    positive = np.all(values > 0, axis=1)
    mean = 3 / np.sum(1 / np.where(values > 0, values, 1.0), axis=1)
    return area, np.where(positive, mean, np.minimum(np.min(values, axis=1), 0.0))


def _in_plane(theta: FloatArray, delta: FloatArray, f: FloatArray) -> float:
    """A bound from one plane: of flat values the darkest, as far as both sides were measured."""
    side = np.cos(delta) * theta
    reach = min(float(side.max()), -float(side.min()))
    if reach < math.radians(30) or f.min() < FLAT * np.median(f):
        return 0.0
    return float(np.pi * f.min() * math.sin(reach) ** 2)


def _text(albedo: float, theta_deg: float, n: int, how: str) -> str:
    found = (
        f"the {n} samples at theta_i {theta_deg:.4g} deg reflect at least {albedo:.3g} times the "
        f"light that falls on them (lower bound {how}), so they are no BRDF in sr^-1"
    )
    if albedo <= 1.05 * math.pi:
        return (
            f"{found}; a reflectance factor pi*BRDF would be so (divided by pi: at least "
            f"{albedo / math.pi:.2g}). Divide the values by pi if they are one; else their scale "
            "is wrong."
        )
    if albedo <= 115:
        return (
            f"{found}; per cent would be so (divided by 100: at least {albedo / 100:.2g}), or a "
            f"reflectance factor in per cent (divided by 100 pi: at least "
            f"{albedo / 100 / math.pi:.2g}). Divide the values by that."
        )
    if albedo <= 110 * math.pi:
        return (
            f"{found}; a reflectance factor in per cent would be so (divided by 100 pi: at least "
            f"{albedo / 100 / math.pi:.2g}). Divide the values by 100 pi if they are one."
        )
    return f"{found}: their unit is another one. Divide them by the value of a known standard."


QUESTION = Question(
    key="albedo",
    order=110,
    asks="Does the sample reflect more light than falls on it?",
    compares="a lower bound of the albedo with 1.05",
    codes=("albedo",),
    ask=ask,
)
