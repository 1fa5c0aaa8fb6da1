"""Is the azimuth counted from the forward side?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

EXPLAINED = 0.25  # share that a lobe may leave
NOTHING = 0.9  # share that a lobe leaves where there is none
STRONG = 3.0  # times the median: higher than the shading of a rough surface
ALIKE = 0.7  # of what a mirror lobe leaves: light thrown back leaves less on a retroreflector
OUT_OF_PLANE = 0.1  # sine of phi_r - phi_i
HEMISPHERE = 0.3  # share of samples out of the plane that show the shape of a lobe
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
        out_of_plane = float(np.mean(np.abs(np.sin(evidence.delta)) > OUT_OF_PLANE))
        like_mirror = fit.retro > ALIKE * fit.azimuth_turned and out_of_plane > HEMISPHERE
        yield Finding(
            "azimuth_zero_possible",
            "warning" if like_mirror else "note",
            f"{found}. A retroreflecting surface does so: its peak points to the light at every "
            "incidence. Otherwise the azimuth is counted from the forward side: add 180 deg to "
            "phi_r.",
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
