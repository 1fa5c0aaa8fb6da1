"""Do two incidences hold the same readings?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

LEAST = 8  # equal values that are no accident
DISTINCT = 6  # different ones among them
SHARE = 0.8  # of the smaller block
IN_A_ROW = 12  # equal values on lines that follow each other
MIXED = 20  # equal values that stand in another order
MIXED_SHARE = 0.6  # of the smaller block, for these
VARIED = 0.9  # share of different values in a block whose order may not matter
NOISY = 0.5  # share of mirror pairs that differ where readings have noise
LEAST_MIRRORED = 5  # mirror pairs that tell whether readings have noise
ROUNDING = 1e-9  # relative difference that the last digits of a formula have
MOST_INCIDENCES = 400

Index = NDArray[np.int64]


@dataclass(frozen=True)
class _Copy:
    """Samples of two incidences that hold the same values, one for one."""

    one: Index
    other: Index
    whole: bool


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Blocks of different incidences whose values agree to all digits."""
    n = evidence.n_incidences
    if not 2 <= n <= MOST_INCIDENCES or evidence.repeated_values < DISTINCT:
        return
    blocks = [evidence.of_incidence(number) for number in range(n)]
    noisy = _mirror_pairs_differ(evidence)
    theta = np.array([evidence.theta_i[block[0]] for block in blocks])
    _, times, count = np.unique(evidence.value, return_inverse=True, return_counts=True)
    again = count[times] > 1
    few = [k for k in range(n) if np.count_nonzero(again[blocks[k]]) >= LEAST]
    varied = {k: len(np.unique(evidence.value[blocks[k]])) >= VARIED * len(blocks[k]) for k in few}
    copies = []
    for a, b in combinations(few, 2):
        # With the sample turned, values without noise agree by symmetry.
        if noisy or abs(theta[a] - theta[b]) >= 1e-4:
            in_any_order = noisy and varied[a] and varied[b]
            copy = _copy(evidence, blocks[a], blocks[b], in_any_order=in_any_order)
            if copy is not None:
                copies.append(copy)
    compared = n * (n - 1) // 2
    if not noisy:
        compared = sum(
            int(np.count_nonzero(np.abs(theta[:k] - theta[k]) >= 1e-4)) for k in range(n)
        )
    # Where most blocks agree, the values do not depend on the incidence: a formula without noise.
    if copies and not (compared > 1 and len(copies) > compared / 2):
        yield _finding(evidence, copies)


def _mirror_pairs_differ(evidence: Evidence) -> bool:
    """Whether samples on both sides of the plane of incidence differ, as noise makes them do."""
    incidence, like = evidence.incidence, evidence.geometry_class
    order = np.lexsort((np.sign(np.sin(evidence.delta)), like, incidence))
    first, second = order[:-1], order[1:]
    mirrored = (incidence[first] == incidence[second]) & (like[first] == like[second])
    side = np.sin(evidence.delta)
    mirrored &= (side[first] < -1e-3) & (side[second] > 1e-3)
    count = int(np.count_nonzero(mirrored))
    one, other = evidence.value[first[mirrored]], evidence.value[second[mirrored]]
    differ = np.abs(one - other) > ROUNDING * np.abs(one)
    return count >= LEAST_MIRRORED and float(np.mean(differ)) > NOISY


def _copy(evidence: Evidence, a: Index, b: Index, *, in_any_order: bool) -> _Copy | None:
    """The samples of two blocks with the same values, where there are too many for an accident.

    They are compared in the order of the file and, where readings have noise and digits enough,
    in any order.
    """
    value, size = evidence.value, min(len(a), len(b))
    alike = max(len(a), len(b)) <= 1.25 * size
    same = value[a[:size]] == value[b[:size]]
    if np.count_nonzero(same) >= LEAST:
        if alike and _enough(evidence, a[:size][same], SHARE * size, DISTINCT, LEAST):
            return _Copy(a, b, whole=True)
        row = _longest_row(same)
        if _enough(evidence, a[row], IN_A_ROW, LEAST, IN_A_ROW):
            return _Copy(a[row], b[row], whole=False)
    if not in_any_order:
        return None
    _, of_a, of_b = np.intersect1d(value[a], value[b], return_indices=True)
    if _enough(evidence, a[of_a], MIXED_SHARE * size, MIXED, MIXED):
        return _Copy(a[of_a], b[of_b], whole=alike and len(of_a) >= SHARE * size)
    return None


def _enough(evidence: Evidence, same: Index, share: float, distinct: int, least: int) -> bool:
    """Whether equal values are many, and different from each other."""
    if len(same) < max(least, share):
        return False
    return len(np.unique(evidence.value[same])) >= distinct


def _longest_row(same: NDArray[np.bool_]) -> Index:
    """Places of the longest row of lines that agree."""
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(np.int8)))
    if not len(edges):
        return np.zeros(0, np.int64)
    start, end = edges[::2], edges[1::2]
    longest = int(np.argmax(end - start))
    return np.arange(start[longest], end[longest])


def _finding(evidence: Evidence, copies: list[_Copy]) -> Finding:
    first = copies[0]
    one, other = np.sort(first.one), np.sort(first.other)
    count = min(len(one), len(other))
    both = np.concatenate([one, other])
    theta = [float(np.degrees(evidence.theta_i[k])) for k in (one[0], other[0])]
    phi = [float(np.degrees(evidence.phi_i[k])) for k in (one[0], other[0])]
    at = f"theta_i {theta[0]:.5g} and {theta[1]:.5g} deg"
    if abs(theta[0] - theta[1]) < 1e-2:
        at = f"theta_i {theta[0]:.5g} deg, phi_i {phi[0]:.5g} and {phi[1]:.5g} deg"
    what = "the" if first.whole else f"{count} of the"
    more = f", and {len(copies) - 1} more such pairs" if len(copies) > 1 else ""
    number = f"{count} " if first.whole else ""
    return Finding(
        "copied_block",
        "warning",
        f"{what} {number}readings at {at} are the same to all digits ({evidence.where(one)}; "
        f"{evidence.where(other)}){more}: one block was copied over the other. Remove the wrong "
        "one.",
        tuple(both.tolist()),
        evidence.lines(both),
    )


QUESTION = Question(
    key="copied_block",
    order=70,
    asks="Do two incidences hold the same readings?",
    compares="the values of each incidence with those of the others, line by line and, where "
    "readings on both sides of the plane differ, in any order",
    codes=("copied_block",),
    ask=ask,
)
