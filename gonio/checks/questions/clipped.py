"""Are values cut off at a floor or a ceiling?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray

SHARE = 0.05  # of the values, from which on equal ones are a floor
CLASSES = 5  # different geometries that share one value
AGAINST_OTHERS = 5  # times as many as of any other value
APART = 1e-4  # relative distance of the next value from a floor
VARIED = 0.8  # share of other values that occur once, where readings have noise
COARSE = 0.05  # of the smallest value: steps from which on its resolution matters
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
        if code == "floor" and not (low and (_is_round(limit) or _stands_alone(values, counts))):
            continue
        yield _finding(evidence, code, limit, tuple(index.tolist()))


def _is_round(number: float) -> bool:
    """Whether a number has two digits at most."""
    return float(f"{number:.1e}") == number


def _stands_alone(values: FloatArray, counts: NDArray[np.int64]) -> bool:
    """Whether the smallest value alone occurs again and again, and none lies close above it.

    Above the diffuse level of a formula the tails of its lobe lie closer and closer.
    """
    return bool(values[1] > (1 + APART) * values[0] and np.mean(counts[1:] == 1) > VARIED)


def _step(values: FloatArray) -> float | None:
    """The step of which all values are multiples; None where they are on no grid."""
    step = float(np.diff(values).min())
    steps = values / step
    on_grid = step > COARSE * values[0] and np.all(np.abs(steps - np.round(steps)) < 1e-3)
    return step if on_grid else None


def _finding(evidence: Evidence, code: str, limit: float, index: tuple[int, ...]) -> Finding:
    count = f"{len(index)} of {evidence.n} values are exactly {limit:.6g}"
    step = _step(np.unique(evidence.value)) if code == "floor" else None
    if step is not None:
        text = (
            f"{count}, the smallest ({evidence.where(index)}), and all values are multiples of "
            f"{step:.3g} sr^-1: the resolution of the readings, which is coarse for these. Give "
            f"u_brdf at least {step / np.sqrt(12):.2g} sr^-1, or remove these lines."
        )
    elif code == "floor":
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
