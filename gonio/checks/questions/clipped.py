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
FEW = 3  # of these, where one incidence has several and other values do not repeat
AGAINST_OTHERS = 5  # times as many as of any other value
APART = 1e-4  # relative distance of the next value from a floor
VARIED = 0.8  # share of other values that occur once, where readings have noise
COARSE = 0.05  # of the smallest value: steps from which on its resolution matters
LOW = 0.1  # of the largest value, below which a floor lies
ALL = 0.9  # equal values: a constant, and no cut


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Many equal values at the lower end, or several at the upper end."""
    ends = evidence.value.min(), evidence.value.max()
    if max(np.count_nonzero(evidence.value == end) for end in ends) < FEW:
        return
    values, counts = np.unique(evidence.value, return_counts=True)
    if len(values) < 10 or counts.max() > ALL * evidence.n:
        return
    # Values may be cut at both ends: each end is compared with what lies between them.
    others = int(counts[1:-1].max())
    varied = bool(np.mean(counts[1:-1] == 1) > VARIED)
    top, bottom = (np.flatnonzero(evidence.value == values[end]) for end in (-1, 0))
    saturated = values[-1] > 0 and _is_ceiling(evidence, top, others, varied=varied)
    least = max(CLASSES, SHARE * evidence.n, AGAINST_OTHERS * others)
    if values[0] > 0 and len(bottom) >= least and _classes(evidence, bottom) >= CLASSES:
        # A formula without noise repeats its diffuse level, to all digits that are printed.
        low = values[0] < LOW * values[-1]
        marked = _is_round(values[0]) or (varied and _stands_alone(values))
        if (low and marked) or (saturated and varied):
            yield _finding(evidence, "floor", bottom)
    if saturated:
        yield _finding(evidence, "ceiling", top)


def _is_ceiling(evidence: Evidence, top: NDArray[np.int64], others: int, *, varied: bool) -> bool:
    """Whether samples with the largest value are too many for an accident.

    A formula may reach the same peak at every incidence, once.
    """
    if len(top) < AGAINST_OTHERS * others and not (varied and len(top) > others):
        return False
    classes = _classes(evidence, top)
    if classes >= CLASSES and len(top) >= AGAINST_OTHERS * others:
        return True
    of_one = np.bincount(evidence.incidence[top]).max()
    few = varied and others <= 2 and classes >= FEW and of_one >= 2
    return few and not _coarse(evidence.value)


def _coarse(value: FloatArray) -> bool:
    """Whether most values have three digits at most, so that neighbours on a peak may be equal."""
    size = np.abs(value[value != 0])
    digits = size / 10.0 ** (np.floor(np.log10(size)) - 2)
    return bool(np.mean(np.abs(digits - np.round(digits)) < 1e-6) > 0.5)


def _classes(evidence: Evidence, index: NDArray[np.int64]) -> int:
    """How many geometries samples have that differ on a reciprocal isotropic surface."""
    return len(np.unique(evidence.geometry_class[index]))


def _is_round(number: float) -> bool:
    """Whether a number has two digits at most."""
    return float(f"{number:.1e}") == number


def _stands_alone(values: FloatArray) -> bool:
    """Whether no value lies close above the smallest.

    Above the diffuse level of a formula the tails of its lobe lie closer and closer.
    """
    return bool(values[1] > (1 + APART) * values[0])


def _step(values: FloatArray) -> float | None:
    """The step of which all values are multiples; None where they are on no grid."""
    step = float(np.diff(values).min())
    steps = values / step
    on_grid = step > COARSE * values[0] and np.all(np.abs(steps - np.round(steps)) < 1e-3)
    return step if on_grid else None


def _finding(evidence: Evidence, code: str, index: NDArray[np.int64]) -> Finding:
    count = f"{len(index)} of {evidence.n} values are exactly {evidence.value[index[0]]:.6g}"
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
            "are lower limits. A fit takes each for a measurement. Remove these lines, or measure "
            "them with less light."
        )
    return Finding(code, "warning", text, tuple(index.tolist()), evidence.lines(index))


QUESTION = Question(
    key="clipped",
    order=50,
    asks="Are values cut off at a floor or a ceiling?",
    compares="how often the smallest and the largest value occur with all others",
    codes=("floor", "ceiling"),
    ask=ask,
)
