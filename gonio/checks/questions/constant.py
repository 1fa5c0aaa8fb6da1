"""Do all samples hold one value?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

LEAST = 8  # samples, and geometries
DIGITS = 8  # of a number that a person or an instrument wrote; a formula gives more


def ask(evidence: Evidence) -> Iterator[Finding]:
    """One value everywhere: a column that was filled, or a formula, and no measurement."""
    value = evidence.value
    if evidence.n < LEAST or value[0] == 0 or np.any(value != value[0]):
        return
    geometries = len(np.unique(evidence.geometry_class))
    # The formula of a white surface gives one value, which nobody takes for a measurement.
    written = evidence.u is not None or float(f"{value[0]:.{DIGITS}g}") == value[0]
    if geometries < LEAST or not written:
        return
    yield Finding(
        "constant",
        "warning",
        f"all {evidence.n} values are exactly {value[0]:.6g}, at {geometries} different "
        "geometries: readings have noise, so these were not measured. The column was filled down, "
        "or a formula wrote it. Give the readings.",
    )


QUESTION = Question(
    key="constant",
    order=55,
    asks="Do all samples hold one value?",
    compares="each value with the first",
    codes=("constant",),
    ask=ask,
)
