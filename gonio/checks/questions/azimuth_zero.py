"""Is the azimuth counted from the forward side?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

EXPLAINED = 0.25  # share that a lobe may leave
NOTHING = 0.9  # share that a lobe leaves where there is none
STRONG = 3.0  # times the median: higher than the shading of a rough surface
BETTER = 0.3  # of what surfaces that throw light back leave


def ask(evidence: Evidence) -> Iterator[Finding]:
    """A mirror lobe at phi_r = phi_i and none at phi_r = phi_i + 180 deg."""
    fit = evidence.lobes
    if fit is None or fit.azimuth_turned > EXPLAINED or fit.mirror < NOTHING:
        return
    found = (
        "a lobe about theta_r = theta_i, phi_r = phi_i explains "
        f"{1 - fit.azimuth_turned:.0%} of the variation of the values, one about the mirror "
        f"direction (phi_r = phi_i + 180 deg) {1 - fit.mirror:.0%}"
    )
    if fit.azimuth_turned < BETTER * fit.retro:
        yield Finding(
            "azimuth_zero",
            "warning",
            f"{found}. It has the shape of a mirror lobe and not that of light thrown back to the "
            "source: the azimuth is counted from the forward side. Add 180 deg to phi_r.",
        )
    elif np.max(evidence.value) > STRONG * np.median(evidence.value):
        yield Finding(
            "azimuth_zero_possible",
            "note",
            f"{found}. A retroreflecting surface does so. Otherwise the azimuth is counted from "
            "the forward side: add 180 deg to phi_r.",
        )


QUESTION = Question(
    key="azimuth_zero",
    order=100,
    asks="Is the azimuth counted from the forward side?",
    compares="lobes about the mirror direction, the direction of the light, and the mirror "
    "direction with phi_r turned by 180 deg",
    codes=("azimuth_zero", "azimuth_zero_possible"),
    ask=ask,
)
