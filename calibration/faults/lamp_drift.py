"""Does the lamp drift more than is stated?"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.calibration.faults.frame_statistics import middle
from gonio.calibration.faults.standard_levels import StandardLevels

ASSUMED_DRIFT = 0.005  # of a lamp that states none


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Scatter of the lamp's output about a smooth trend with the incidence, and among repeats."""
    levels = StandardLevels.of(evidence)
    if levels is None or levels.exchanged:
        return  # other questions say so
    stated, plan = evidence.metadata.lamp.drift, evidence.metadata.plan
    allowed = ASSUMED_DRIFT if stated is None else stated
    said = "none is stated" if stated is None else f"{stated:.2g} is stated"
    scatter = None
    if len(levels.level) >= 5:
        theta = np.array([levels.angle[i] for i in levels.level])
        x = np.log([levels.level[i] for i in levels.level])
        degree = min(len(x) - 3, 4)
        trend = np.polyval(np.polyfit(theta, x, degree), theta)
        scatter = float(np.sqrt(np.sum((x - trend) ** 2) / (len(x) - degree - 1)))
        allowed /= np.sqrt(plan.repeats)
        how = "about a smooth trend with the incidence"
    elif plan.repeats > 1:
        takes = defaultdict(list)
        for (_, _, i), statistics in evidence.of("standard"):
            takes[i].append(middle(statistics.rate))
        scatter = float(np.sqrt(np.mean([np.var(np.log(x), ddof=1) for x in takes.values()])))
        how = "among its repeats"
    # With two degrees of freedom chance passes 3.5 times the sd once in 200 000.
    if scatter is not None and scatter > 3.5 * allowed + 3e-3:
        yield Finding(
            "lamp_drift",
            "warning",
            f"the standard's signals scatter by {scatter:.2g} {how} and {said} for the lamp: the "
            "lamp drifts and the samples' shared uncertainty is too small, unless it is the dome "
            "whose transmittance changes between incidences, which cancels. Let the lamp warm up, "
            "or correct lamp.drift.",
        )


QUESTION = Question(
    key="lamp_drift",
    order=110,
    asks="Does the lamp drift more than is stated?",
    compares="the standard's signals with a smooth trend, or its repeats with each other",
    codes=("lamp_drift",),
    ask=ask,
)
