"""Are values exactly 0?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

GAP = 0.1  # of the median value, below which nothing else lies where zeros are codes
SMOOTH = 0.2  # scatter of ln f between neighbours up to which a 0 among them is no reading
BULK = 0.05  # fraction of zeros from which on they bias a fit


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Zeros among bright values, which are no readings, and zeros in bulk."""
    value = evidence.value
    zero = value == 0
    count = int(np.count_nonzero(zero))
    if not count or count == len(value):
        return
    missing = np.flatnonzero(zero & _no_reading(evidence, zero))
    if 2 * len(missing) < count:  # most zeros are small readings
        missing = missing[:0]
    rest = np.flatnonzero(zero & ~np.isin(np.arange(len(value)), missing))
    if len(missing):
        yield _missing(evidence, missing)
    if len(rest) >= max(5, BULK * len(value)):
        yield Finding(
            "zeros_in_bulk",
            "warning",
            f"{len(rest)} of {len(value)} values are exactly 0 ({evidence.where(rest)}): they were "
            "cut off below the resolution, or never measured. A fit takes each for a measured 0. "
            "Give the values before the cut, with their noise, or remove these lines.",
            tuple(rest.tolist()),
            evidence.lines(rest),
        )


def _no_reading(evidence: Evidence, zero: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Zeros that cannot be small readings, because readings around them are large and smooth."""
    value = evidence.value
    size = np.abs(value[~zero])
    if size.min() > GAP * np.median(size):
        return zero
    near = evidence.neighbours
    alone = np.count_nonzero(zero[near], axis=1) <= near.shape[1] // 4
    result = np.zeros_like(zero)
    for k in np.flatnonzero(zero & alone).tolist():
        beside = near[k][~zero[near[k]]]
        if len(beside) >= 4 and np.all(value[beside] > 0):
            result[k] = _scatter(evidence, beside, zero) < SMOOTH
    return result


def _scatter(evidence: Evidence, samples: NDArray[np.int64], zero: NDArray[np.bool_]) -> float:
    """Typical |ln f - median ln f of the neighbours| at these samples."""
    off = []
    for k in samples.tolist():
        beside = evidence.neighbours[k]
        around = evidence.value[beside[~zero[beside]]]
        if not len(around) or not np.all(around > 0):
            return np.inf
        off.append(abs(np.log(evidence.value[k]) - np.median(np.log(around))))
    return float(np.median(off))


def _missing(evidence: Evidence, missing: NDArray[np.int64]) -> Finding:
    near = evidence.neighbours[missing]
    beside = evidence.value[near]
    typical = float(np.median(beside[beside > 0])) if np.any(beside > 0) else 0.0
    return Finding.without_reading(
        "zero_is_missing",
        evidence,
        missing,
        f"exactly 0 among values about {typical:.2g}",
        ": they mark missing readings and were left out. Remove these lines.",
    )


QUESTION = Question(
    key="exact_zeros",
    order=40,
    asks="Are values exactly 0?",
    compares="each 0 with the values around it, the number of zeros with 5 %",
    codes=("zero_is_missing", "zeros_in_bulk"),
    ask=ask,
    of_values=True,
)
