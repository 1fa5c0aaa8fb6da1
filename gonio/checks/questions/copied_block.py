"""Do two incidences hold the same readings?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

LEAST = 8  # equal values that are no accident
DISTINCT = 6  # different ones among them
SHARE = 0.8  # of the smaller block
MOST_INCIDENCES = 400


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Blocks of different theta_i whose values agree to all digits, line by line."""
    n = evidence.n_incidences
    if not 2 <= n <= MOST_INCIDENCES or evidence.repeated_values < DISTINCT:
        return
    blocks = [evidence.of_incidence(number) for number in range(n)]
    copies, compared = [], 0
    theta = np.array([evidence.theta_i[block[0]] for block in blocks])
    size = np.array([len(block) for block in blocks])
    for a in range(n):
        # With the sample turned, values agree by symmetry.
        other = np.abs(theta[a + 1 :] - theta[a]) >= 1e-4
        compared += int(np.count_nonzero(other))
        small, large = np.minimum(size[a], size[a + 1 :]), np.maximum(size[a], size[a + 1 :])
        other &= (small >= LEAST) & (large <= 1.25 * small)
        for b in (a + 1 + np.flatnonzero(other)).tolist():
            if _equal(evidence, blocks[a], blocks[b]):
                copies.append((a, b))
    # Where most blocks agree, the values do not depend on the incidence: a formula without noise.
    if not copies or (compared > 1 and len(copies) > compared / 2):
        return
    one, other = (blocks[k] for k in copies[0])
    first, second = (float(np.degrees(evidence.theta_i[block[0]])) for block in (one, other))
    both = np.concatenate([one, other])
    more = f", and {len(copies) - 1} more such pairs" if len(copies) > 1 else ""
    yield Finding(
        "copied_block",
        "warning",
        f"the {min(len(one), len(other))} readings at theta_i {first:.5g} and {second:.5g} deg are "
        f"the same to all digits ({evidence.where(one)}; {evidence.where(other)}){more}: one block "
        "was copied over the other. Remove the wrong one.",
        tuple(both.tolist()),
        evidence.lines(both),
    )


def _equal(evidence: Evidence, a: NDArray[np.int64], b: NDArray[np.int64]) -> bool:
    """Whether two blocks hold the same values, in the order of the file."""
    size = min(len(a), len(b))
    first, second = evidence.value[a[:size]], evidence.value[b[:size]]
    same = first == second
    count = int(np.count_nonzero(same))
    return count >= max(LEAST, SHARE * size) and len(np.unique(first[same])) >= DISTINCT


QUESTION = Question(
    key="copied_block",
    order=70,
    asks="Do two incidences hold the same readings?",
    compares="the values of each incidence with those of the others, line by line",
    codes=("copied_block",),
    ask=ask,
)
