"""Are the polar angles elevations above the surface?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

EXPLAINED = 0.5  # share that lobes may leave with elevations
BETTER = 0.4  # of what lobes leave with the angles as written
HORIZON_DEG = 89.9


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Lobes that have their shape only if theta is counted from the plane of the sample."""
    at_horizon = np.degrees(evidence.theta_i) > HORIZON_DEG
    count = int(np.count_nonzero(at_horizon))
    lit = f" {count} samples are lit at theta_i = 90 deg, where no light falls." if count else ""
    fit = evidence.lobes
    cure = "Theta is counted from the normal: write 90 deg - theta."
    if fit and fit.elevations < min(EXPLAINED, BETTER * fit.as_written):
        yield Finding(
            "elevation",
            "warning",
            f"with theta as written lobes leave {fit.as_written:.0%} of the variation of the "
            f"values unexplained, with 90 deg - theta {fit.elevations:.0%}: theta is an "
            f"elevation above the surface.{lit} {cure}",
        )
    elif count and not np.any(np.degrees(evidence.theta_i) < 90 - HORIZON_DEG):
        index = np.flatnonzero(at_horizon)
        yield Finding(
            "light_at_horizon",
            "warning",
            f"{lit.strip()} None is lit at 0 deg. If theta is an elevation above the surface, "
            "write 90 deg - theta; else remove these lines.",
            tuple(index.tolist()),
            evidence.lines(index),
        )


QUESTION = Question(
    key="elevation",
    order=90,
    asks="Are the polar angles elevations above the surface?",
    compares="lobes with theta as written and with 90 deg - theta, theta_i with 90 deg",
    codes=("elevation", "light_at_horizon"),
    ask=ask,
)
