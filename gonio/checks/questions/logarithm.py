"""Are the values logarithms of the BRDF?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

LEAST = 10  # samples
MOST = 0.6  # share of negative values
SIGMAS = 5.0  # by which the median lies below 0


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Values that are negative by far more than their noise, smoothly."""
    value, n = evidence.value, evidence.n
    count = int(np.count_nonzero(value < 0))
    if n < LEAST or count < MOST * n:
        return
    typical = float(np.median(value))
    scatter = _scatter(evidence)
    noise = scatter if evidence.u is None else max(scatter, float(np.median(evidence.u)))
    if -typical < SIGMAS * noise:
        return
    low, high = float(value.min()), float(value.max())
    found = (
        f"{count} of {n} values are negative, typically {typical:.3g}, where neighbours differ by "
        f"{scatter:.2g} only: a BRDF is not negative, and noise does not do so."
    )
    if high > 20 or low < -50:
        said = "An offset that is too large was subtracted. Give the readings before that."
    else:
        said = (
            f"They look like logarithms: as log10 the BRDF is {10**low:.2g} to {10**high:.2g} "
            f"sr^-1, as ln {np.exp(low):.2g} to {np.exp(high):.2g} sr^-1. Write 10^brdf or "
            "exp(brdf), and u_brdf for that; leaving the negative lines out would be wrong. If "
            "an offset was subtracted, correct it."
        )
    yield Finding("logarithm", "warning", f"{found} {said}")


def _scatter(evidence: Evidence) -> float:
    """Typical difference of a value from the median of the nearest at almost the same incidence."""
    around = np.median(evidence.value[evidence.neighbours], axis=1)
    return 1.4826 * float(np.median(np.abs(evidence.value - around)))


QUESTION = Question(
    key="logarithm",
    order=45,
    asks="Are the values logarithms of the BRDF?",
    compares="the number of negative values with 60 %, their size with the noise",
    codes=("logarithm",),
    ask=ask,
)
