"""Do single values stand far above their neighbours outside the plane of incidence?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.checks.questions.single_values import away_from_lobes, standing_out

FACTOR = 5.0  # times the largest of the values around it
LEVEL = 3.0  # largest ratio among the values around it
NEAR_DEG = 25.0  # to the farthest of the values around it
AWAY_DEG = 8.0  # tilt from the mirror direction, and half the angle from the light
IN_PLANE = 0.02  # sine of phi_r - phi_i: samples there stand in scans and are asked elsewhere
SHARE = 0.02  # of the samples, above which it is the surface
LEAST = 20  # samples
HASH_BITS = 20
FIBONACCI = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio, which spreads keys


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Single samples out of the plane that are far above all around them, which are smooth."""
    if evidence.n < LEAST or np.count_nonzero(evidence.value > 0) < LEAST:
        return
    some = np.flatnonzero(evidence.value > FACTOR * np.median(evidence.value[evidence.value > 0]))
    some = some[np.abs(np.sin(evidence.delta[some])) > IN_PLANE]
    # The neighbours of many samples take seconds to find: they are asked for last.
    some = some[_above_their_like(evidence, some)]
    some = some[away_from_lobes(evidence, some, AWAY_DEG)]
    if not len(some):
        return
    around = evidence.neighbours_of(some)
    beside = evidence.value[around]
    w_i, w_r = evidence.vectors
    cosine = np.minimum(
        np.einsum("nkj,nj->nk", w_r[around], w_r[some]),
        np.einsum("nkj,nj->nk", w_i[around], w_i[some]),
    )
    stands = np.all(beside > 0, axis=1) & (evidence.value[some] > FACTOR * beside.max(axis=1))
    stands &= beside.max(axis=1) < LEVEL * beside.min(axis=1)
    stands &= cosine.min(axis=1) > np.cos(np.radians(NEAR_DEG))
    index = some[stands]
    if not len(index) or len(index) > max(1, SHARE * evidence.n):
        return
    times = evidence.value[index] / np.median(beside[stands], axis=1)
    yield standing_out(
        "isolated",
        evidence,
        index,
        times,
        "the values around {them}",
        ", far from the mirror direction and from the light",
    )


def _above_their_like(evidence: Evidence, some: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether samples that an isotropic surface makes alike exist, and are as far below.

    Between few samples of a brushed surface a streak of its lobe may pass that one of them meets.
    """
    key, value = evidence.geometry_key, evidence.value
    # Only samples with the hash of one in question are sorted.
    bucket = (key.astype(np.uint64) * FIBONACCI) >> np.uint64(64 - HASH_BITS)
    asked = np.zeros(1 << HASH_BITS, dtype=np.bool_)
    asked[bucket[some]] = True
    members = np.flatnonzero(asked[bucket])
    order = members[np.lexsort((value[members], key[members]))]
    ordered = key[order]
    first = np.searchsorted(ordered, key[some], side="left")
    last = np.searchsorted(ordered, key[some], side="right") - 1
    # The largest of a class stands last.
    below = value[order[np.maximum(last - 1, 0)]]
    return np.asarray((last > first) & (order[last] == some) & (value[some] > FACTOR * below))


QUESTION = Question(
    key="isolated",
    order=165,
    asks="Do single values out of the plane of incidence stand far above their neighbours?",
    compares="each value with the eight nearest at almost the same incidence, and with that on the "
    "other side of the plane, away from the mirror direction and the light",
    codes=("isolated",),
    ask=ask,
)
