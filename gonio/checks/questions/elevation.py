"""Are the polar angles elevations above the surface?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.checks.questions.lobe_fit import LobeFit

EXPLAINED = 0.5  # share that lobes may leave with elevations
BETTER = 0.4  # of what lobes leave with the angles as written
HORIZON_DEG = 89.9
ONE_EXPLAINED = 0.35  # share that a lobe may leave with one of both angles an elevation
ONE_BETTER = 0.4  # of what lobes leave in any other way
CLEARLY = 0.7  # of what the lobe leaves with the other angle an elevation


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
        return
    one = _one_of_both(evidence, fit) if fit else ""
    if one:
        yield Finding("one_elevation", "warning", f"{one}{lit}")
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


def _one_of_both(evidence: Evidence, fit: LobeFit) -> str:
    """What is said where the lobe stands at theta_r = 90 deg - theta_i, else empty."""
    least = min(fit.elevation_i, fit.elevation_r)
    others = min(fit.as_written, fit.elevations, fit.retro, fit.azimuth_turned)
    # At theta_i = 45 deg alone both read the same.
    if least > min(ONE_EXPLAINED, ONE_BETTER * others) or evidence.n_incidences < 2:
        return ""
    found = (
        f"with theta as written lobes leave {fit.as_written:.0%} of the variation of the values "
        f"unexplained, with 90 deg - theta_i {fit.elevation_i:.0%}, with 90 deg - theta_r "
        f"{fit.elevation_r:.0%}: the lobe stands at theta_r = 90 deg - theta_i"
    )
    cure = "Theta is counted from the normal: write 90 deg - {} where it is one."
    if least < CLEARLY * max(fit.elevation_i, fit.elevation_r):
        name = "theta_i" if fit.elevation_i < fit.elevation_r else "theta_r"
        return (
            f"{found}, so one of both angles is an elevation above the surface, by the shape of "
            f"the lobe {name}. {cure.format(name)}"
        )
    return (
        f"{found}, so one of both angles is an elevation above the surface, theta_i or theta_r. "
        f"{cure.format('that')}"
    )


QUESTION = Question(
    key="elevation",
    order=90,
    asks="Are the polar angles elevations above the surface?",
    compares="lobes with theta as written and with 90 deg - theta for both or one of them, "
    "theta_i with 90 deg",
    codes=("elevation", "one_elevation", "light_at_horizon"),
    ask=ask,
)
