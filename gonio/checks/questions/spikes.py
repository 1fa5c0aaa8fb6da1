"""Do single values stand far above their neighbours in a scan?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.checks.questions.single_values import away_from_lobes, standing_out
from gonio.geometry import FloatArray

FACTOR = 2.0  # times the larger of the values beside it
SIGMAS = 8.0  # times the typical departure of ln f from the values beside it
LEVEL = 3.0  # largest ratio among the four values around it
GAP_DEG = 16.0  # between a sample and the second beside it
AWAY_DEG = 4.0  # tilt from the mirror direction, and half the angle from the light
IN_PLANE = 0.02  # sine of phi_r - phi_i
SHARE = 0.05  # of the samples of the scans, above which it is noise
LEAST = 20  # samples in scans


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Single samples of scans in the plane of incidence that are far above both neighbours."""
    scans = list(_scans(evidence))
    found, departures = [], []
    for scan in scans:
        value = evidence.value[scan]
        near = np.stack([value[1:-3], value[2:-2], value[3:-1]])
        logs = np.log(near[:, np.all(near > 0, axis=0)])
        departures.append(np.abs(logs[1] - (logs[0] + logs[2]) / 2))
        found.append(scan[2:-2][_stands_out(evidence, scan)])
    typical = np.concatenate([np.zeros(0), *departures])
    if len(typical) < LEAST:
        return
    scatter = max(1.4826 * float(np.median(typical)), 0.01)
    index = np.concatenate(found)
    times = np.array([_times(evidence, scans, k) for k in index.tolist()], dtype=float)
    index, times = index[np.log(times) > SIGMAS * scatter], times[np.log(times) > SIGMAS * scatter]
    if not len(index) or len(index) > max(1, SHARE * len(typical)):
        return
    yield standing_out(
        "spikes",
        evidence,
        index,
        times,
        f"the values beside {{them}} in the plane of incidence, which scatter by {scatter:.1%}",
    )


def _scans(evidence: Evidence) -> Iterator[NDArray[np.int64]]:
    """Samples of each incidence in its plane, from one horizon to the other."""
    away = np.abs(evidence.delta)
    in_plane = np.minimum(away, np.pi - away) < np.arcsin(IN_PLANE)
    for number in range(min(evidence.n_incidences, 400)):
        index = evidence.of_incidence(number)
        index = index[in_plane[index]]
        side = _side(evidence, index)
        index, side = index[np.argsort(side, kind="stable")], np.sort(side)
        if len(index) >= 5 and np.all(np.diff(side) > 0.01):
            yield index


def _side(evidence: Evidence, index: NDArray[np.int64]) -> FloatArray:
    """theta_r in degrees, negative on the side of the light."""
    side: FloatArray = -np.degrees(evidence.theta_r[index]) * np.sign(np.cos(evidence.delta[index]))
    return side


def _stands_out(evidence: Evidence, scan: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which samples of a scan, two from its ends, are far above two smooth neighbours each side."""
    value, side = evidence.value[scan], _side(evidence, scan)
    around = np.stack([value[:-4], value[1:-3], value[3:-1], value[4:]])
    middle, own = value[2:-2], scan[2:-2]
    stands: NDArray[np.bool_] = middle > FACTOR * np.maximum(around[1], around[2])
    stands &= np.all(around > 0, axis=0) & (around.max(axis=0) < LEVEL * around.min(axis=0))
    stands &= (side[4:] - side[2:-2] < GAP_DEG) & (side[2:-2] - side[:-4] < GAP_DEG)
    if evidence.u is not None:
        stands &= middle - around.max(axis=0) > SIGMAS * evidence.u[own]
    stands &= away_from_lobes(evidence, own, AWAY_DEG)
    return stands


def _times(evidence: Evidence, scans: list[NDArray[np.int64]], k: int) -> float:
    """A sample as a multiple of the geometric mean of the two beside it."""
    for scan in scans:
        at = np.flatnonzero(scan == k)
        if len(at):
            beside = evidence.value[scan[[at[0] - 1, at[0] + 1]]]
            return float(evidence.value[k] / np.sqrt(np.prod(beside)))
    return 1.0


QUESTION = Question(
    key="spikes",
    order=160,
    asks="Do single values stand far above their neighbours?",
    compares="each value in the plane of incidence with the four beside it, away from the mirror "
    "direction and the light",
    codes=("spikes",),
    ask=ask,
)
