"""Are values cut off at a floor or a ceiling?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

SHARE = 0.05  # of the values, from which on equal ones are a floor
CLASSES = 5  # different geometries that share one value
AGAINST_OTHERS = 5  # times as many as of any other value
LOW = 0.1  # of the largest value, below which a floor lies
ALL = 0.9  # equal values: a constant, and no cut


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Many equal values at the lower end, or several at the upper end."""
    ends = evidence.value.min(), evidence.value.max()
    if max(np.count_nonzero(evidence.value == end) for end in ends) < CLASSES:
        return
    values, counts = np.unique(evidence.value, return_counts=True)
    if len(values) < 10 or counts.max() > ALL * evidence.n:
        return
    for end, inner, code in ((0, slice(1, None), "floor"), (-1, slice(None, -1), "ceiling")):
        limit, count = float(values[end]), int(counts[end])
        others = int(counts[inner].max())
        least = max(CLASSES, SHARE * evidence.n) if code == "floor" else CLASSES
        if limit <= 0 or count < least or count < AGAINST_OTHERS * others:
            continue
        index = np.flatnonzero(evidence.value == limit)
        if len(np.unique(evidence.geometry_class[index])) < CLASSES:
            continue
        # A smooth formula without noise repeats its diffuse level, to all digits that are printed.
        low = limit < LOW * values[-1]
        if code == "floor" and not (low and _is_round(limit)):
            continue
        yield _finding(evidence, code, limit, tuple(index.tolist()))


def _is_round(number: float) -> bool:
    """Whether a number has two digits at most."""
    return float(f"{number:.1e}") == number


def _finding(evidence: Evidence, code: str, limit: float, index: tuple[int, ...]) -> Finding:
    count = f"{len(index)} of {evidence.n} values are exactly {limit:.6g}"
    if code == "floor":
        text = (
            f"{count}, the smallest ({evidence.where(index)}): they were cut off there, and are "
            "upper limits. A fit takes each for a measurement. Give the values before the cut, or "
            "remove these lines."
        )
    else:
        text = (
            f"{count}, the largest ({evidence.where(index)}): the detector was saturated, and they "
            "are lower limits. Remove these lines, or measure them with less light."
        )
    return Finding(code, "warning", text, index, evidence.lines(index))


QUESTION = Question(
    key="clipped",
    order=50,
    asks="Are values cut off at a floor or a ceiling?",
    compares="how often the smallest and the largest value occur with all others",
    codes=("floor", "ceiling"),
    ask=ask,
)
