"""Do the values hold a cosine?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.checks.quantity import BRDF, UNDECIDED, WITH_COS_R
from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

SMALL = 0.05  # power of the cosine that nobody notices
SURE = 5.0  # standard uncertainties of a power that is not 0


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Pairs with light and viewer exchanged that agree once a cosine is taken out."""
    test = evidence.quantity
    if test.power is None or test.u_power is None:
        return
    power = f"{test.power:.2f} +- {test.u_power:.2f}"
    pairs = f"{test.n_telling} pairs of samples with light and viewer exchanged"
    if test.quantity not in (BRDF, UNDECIDED):
        cosine = test.quantity.removeprefix("BRDF*")
        other = "" if test.quantity == WITH_COS_R else (
            ", or BRDF*cos(theta_r) with the columns of light and viewer exchanged"
        )  # fmt: skip
        symmetric = "i" if test.quantity == WITH_COS_R else "r"
        yield Finding(
            "cosine",
            "warning",
            f"{pairs} differ by the power {power} of cos(theta_r): divided by {cosine} they agree "
            f"to {test.candidates[test.quantity]:.1%}, as they are to {test.candidates[BRDF]:.1%}. "
            f"The values are {test.quantity}{other} (BRDF/cos(theta_{symmetric}) would look the "
            f"same). Divide them by {cosine}.",
        )
    elif test.quantity == BRDF and abs(test.power) > max(SMALL, SURE * test.u_power):
        yield Finding(
            "not_reciprocal",
            "note",
            f"{pairs} differ by the power {power} of cos(theta_r), neither 0 nor another whole "
            "one. No surface does so: the scale differs between incidences, or the instrument "
            "loses or adds light at grazing directions. Compare them, or leave these out.",
        )


QUESTION = Question(
    key="cosine",
    order=120,
    asks="Do the values hold a cosine?",
    compares="samples with light and viewer exchanged, as they are and divided by a cosine",
    codes=("cosine", "not_reciprocal"),
    ask=ask,
)
