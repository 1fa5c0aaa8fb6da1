"""Are the values logarithms of the BRDF?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray

LEAST = 10  # samples
MOST = 0.6  # share of negative values
SIGMAS = 5.0  # by which the median lies below 0
FOLLOWING = 0.25  # share of negative values where these follow each other
LEAST_FOLLOWING = 20  # negative values
CORRELATED = 0.5  # rank correlation of negative values with their neighbours that is no noise
CHANCE_SIGMAS = 4.5  # standard deviations of that correlation between independent values
MANY = 20_000  # negative values of which some are compared
# What a logarithm may be: its name, its inverse in words, the factor to the natural logarithm.
READINGS = (("log10", "10^brdf", np.log(10)), ("ln", "exp(brdf)", 1.0),
            ("dB", "10^(brdf / 10)", np.log(10) / 10))  # fmt: skip
LIKELY = (1e-8, 1e4)  # sr^-1, where a BRDF lies
DARKEST = 0.32  # sr^-1, below which the least value of a BRDF lies: that of white all over
SHALLOW = 0.05  # of the largest value: negative values that an offset made, no logarithm


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Values that are negative by far more than their noise, or that follow each other there."""
    value, n = evidence.value, evidence.n
    negative = np.flatnonzero(value < 0)
    if n < LEAST or len(negative) < FOLLOWING * n:
        return
    why = ""
    if len(negative) >= MOST * n:
        why = _beyond_noise(evidence)
    if not why and len(negative) >= LEAST_FOLLOWING:
        why = _following(evidence, negative)
    if why:
        found = f"{len(negative)} of {n} values are negative, {why}"
        yield Finding("logarithm", "warning", f"{found} {_cure(value)}")


def _beyond_noise(evidence: Evidence) -> str:
    """What is said of values whose median lies far below 0, else empty."""
    value = evidence.value
    typical = float(np.median(value))
    around = np.median(value[evidence.neighbours], axis=1)
    scatter = 1.4826 * float(np.median(np.abs(value - around)))
    noise = scatter if evidence.u is None else max(scatter, float(np.median(evidence.u)))
    if -typical < SIGMAS * noise:
        return ""
    return (
        f"typically {typical:.3g}, where neighbours differ by {scatter:.2g} only: a BRDF is not "
        "negative, and noise does not do so."
    )


def _following(evidence: Evidence, negative: NDArray[np.int64]) -> str:
    """What is said of negative values that follow their neighbours, else empty.

    Around lobes neighbours differ by more than the noise, so that their scatter does not tell it.
    But noise about a BRDF near 0 is negative here and there by itself: negative values then have
    nothing in common with those beside them.
    """
    if len(negative) > MANY:
        negative = negative[np.linspace(0, len(negative) - 1, MANY).astype(np.int64)]
    beside = np.median(evidence.value[evidence.neighbours_of(negative)], axis=1)
    r = _rank_correlation(evidence.value[negative], beside)
    if r < CORRELATED or r * np.sqrt(len(negative) - 1) < CHANCE_SIGMAS:
        return ""
    return (
        "and they follow each other: their rank correlation with the median of their neighbours is "
        f"{r:.2g}. A BRDF is not negative, and independent noise about 0 does not do so."
    )


def _rank_correlation(a: FloatArray, b: FloatArray) -> float:
    """Spearman's correlation; 0 where one of them is the same everywhere."""
    from scipy.stats import rankdata

    ranks = [rankdata(x) - (len(x) + 1) / 2 for x in (a, b)]
    size = np.sqrt(np.prod([float(x @ x) for x in ranks]))
    return float(ranks[0] @ ranks[1] / size) if size > 0 else 0.0


def _cure(value: FloatArray) -> str:
    low, high = float(value.min()), float(value.max())
    likely = []
    for name, inverse, factor in READINGS:
        with np.errstate(over="ignore", under="ignore"):
            ends = np.exp(factor * low), np.exp(factor * high)
        if LIKELY[0] <= ends[0] <= DARKEST and ends[1] <= LIKELY[1]:
            likely.append((f"as {name} the BRDF is {ends[0]:.2g} to {ends[1]:.2g} sr^-1", inverse))
    if not likely or -low < SHALLOW * high:
        return "An offset that is too large was subtracted. Give the readings before that."
    return (
        f"They look like logarithms: {', '.join(text for text, _ in likely)}. Write "
        f"{' or '.join(inverse for _, inverse in likely)}, and u_brdf for that; leaving the "
        "negative lines out would be wrong. If an offset was subtracted, correct it."
    )


QUESTION = Question(
    key="logarithm",
    order=45,
    asks="Are the values logarithms of the BRDF?",
    compares="the number of negative values with 60 %, their size with the noise, and negative "
    "values, from a quarter on, with their neighbours, which independent noise does not follow",
    codes=("logarithm",),
    ask=ask,
)
