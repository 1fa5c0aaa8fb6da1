"""Does one value stand on many lines in a row?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

RUN = 6  # equal values in a row, of as many geometries
VARIED = 0.8  # distinct values, as a share of all others


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Runs of one value inside the range of values that differ otherwise."""
    value = evidence.value
    if len(value) < 2 * RUN:
        return
    starts = np.flatnonzero(np.r_[True, value[1:] != value[:-1]])
    lengths = np.diff(np.r_[starts, len(value)])
    enough = lengths >= RUN
    long = zip(starts[enough].tolist(), lengths[enough].tolist(), strict=True)
    runs = [
        np.arange(s, s + n)
        for s, n in long
        if value.min() < value[s] < value.max()
        and n < 0.9 * np.count_nonzero(evidence.incidence == evidence.incidence[s])
        and len(np.unique(evidence.geometry_class[s : s + n])) >= RUN
    ]
    if not runs:
        return
    index = np.concatenate(runs)
    others = np.delete(value, index)
    # A noise-free or coarsely rounded file repeats its values everywhere.
    if len(others) < RUN or len(np.unique(others)) < VARIED * len(others):
        return
    first = runs[0]
    yield Finding(
        "stuck",
        "warning",
        f"{len(index)} of {len(value)} values stand in {len(runs)} "
        f"{'row' if len(runs) == 1 else 'rows'} of equal values, the first {len(first)} times "
        f"{value[first[0]]:.6g} ({evidence.where(index)}), where others differ from line to line: "
        "the reading was stuck, or cells were filled down. Remove or measure these lines again.",
        tuple(index.tolist()),
        evidence.lines(index),
    )


QUESTION = Question(
    key="stuck",
    order=60,
    asks="Does one value stand on many lines in a row?",
    compares="equal values in a row with how much the other values differ",
    codes=("stuck",),
    ask=ask,
)
