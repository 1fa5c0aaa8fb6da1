"""Are the uncertainties larger than the readings, as per cent are?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

LEAST = 20  # readings below their uncertainty
LEAST_ROUND = 5  # the same where u_brdf is one round number
NEGATIVE = 0.02  # share of these that may be negative; noise makes at least a fifth so
MOST = 0.5  # share of the readings that lie below their uncertainty
PER_CENT = 0.5  # least number that is taken for per cent
STEADY = 0.1  # scatter of ln(u_brdf/brdf) where both columns may be exchanged


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Readings that are positive although noise as large as stated would scatter about 0."""
    value, u = evidence.value, evidence.u
    if u is None or not evidence.n:
        return
    below = np.abs(value) < u
    count = int(np.count_nonzero(below))
    one = bool(np.all(u == u[0]))
    per_cent = float(np.median(u)) >= PER_CENT
    round_number = one and per_cent and float(f"{u[0]:.1e}") == u[0]
    if count < (LEAST_ROUND if round_number else LEAST) or count < MOST * evidence.n:
        return
    if np.count_nonzero(value[below] < 0) > NEGATIVE * count:
        return
    if not one and np.all(value > 0):
        ratio = np.log(u / value)
        scatter = 1.4826 * float(np.median(np.abs(ratio - np.median(ratio))))
        if scatter < STEADY and np.median(ratio) > np.log(3):
            return  # both columns are exchanged, which is another question
    typical = float(np.median(value[below]))
    what = f"{u[0]:.6g} on every line" if one else f"{np.median(u):.3g} sr^-1 typically"
    found = (
        f"u_brdf is {what}, larger than {count} of {evidence.n} readings (typically "
        f"{typical:.2g} sr^-1), and {'none' if np.all(value[below] >= 0) else 'nearly none'} of "
        "them is negative: noise of that size would make many so."
    )
    cure = (
        "It looks like per cent of the reading: write u_brdf = brdf*u_brdf/100, in sr^-1."
        if per_cent
        else "If it is a fraction of the reading, write u_brdf = brdf*u_brdf, in sr^-1; else "
        "state the noise of the readings."
    )
    yield Finding("u_per_cent", "warning", f"{found} {cure}")


QUESTION = Question(
    key="u_per_cent",
    order=152,
    asks="Is u_brdf larger than the readings, as per cent are?",
    compares="u_brdf with brdf, and the number of negative readings with that of noise as stated",
    codes=("u_per_cent",),
    ask=ask,
)
