"""Are values codes for a missing or overflown reading?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray

NEGATIVE = (-1.0, -9.0, -99.0, -999.0, -9999.0, -99999.0, -999999.0, -99.9, -999.9, -9999.9,
            -99.99, -999.99, -9999.99, -32768.0, -32767.0)  # fmt: skip
POSITIVE = (99.0, 999.0, 9999.0, 99999.0, 999999.0, 99.9, 999.9, 9999.9, 99.99, 999.99, 9999.99,
            32767.0, 65535.0)  # fmt: skip
# A mirror in a beam of a thousandth of a degree reaches about 1e9 sr^-1.
HUGE = 1e10
FAR = 10.0  # times the largest other value, from which on a number is taken for a code


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Codes that programs write for missing values, far from all other values."""
    value = evidence.value
    codes = _codes(value)
    if not codes:
        return
    index = np.flatnonzero(np.isin(value, codes))
    named = ", ".join(f"{code:g}" for code in codes[:4])
    yield Finding.without_reading(
        "missing_code",
        evidence,
        index,
        f"{named}, which stands for a missing or overflown reading",
        "; they were left out. Remove these lines to silence this.",
    )


def _codes(value: FloatArray) -> list[float]:
    """The values that are codes, by size."""
    if max(NEGATIVE) < value.min() and value.max() < min(POSITIVE):
        return []
    huge = np.abs(value) >= HUGE
    if huge.all():
        return []  # a unit that nobody can mean, and no codes among readings
    suspects: NDArray[np.bool_] = huge | np.isin(value, NEGATIVE + POSITIVE)
    if not suspects.any():
        return []
    # One code may be the largest of what is left beside another.
    codes = set(value[huge].tolist())
    others = value[~huge & ~np.isin(value, NEGATIVE + POSITIVE)]
    for code in np.unique(value[suspects & ~huge]).tolist():
        if not len(others):
            codes.add(code)
        elif code < 0:
            lowest = max(0.0, -float(others.min()))
            if -code > FAR * lowest and -code > 2 * float(np.median(np.abs(others))):
                codes.add(code)
        elif code > FAR * float(np.abs(others).max()):
            codes.add(code)
    return sorted(codes)


QUESTION = Question(
    key="missing_codes",
    order=30,
    asks="Are values codes for a missing reading?",
    compares="values such as -9999, -1, 999 or 1e30 with the size of all others",
    codes=("missing_code",),
    ask=ask,
    of_values=True,
)
