"""Does the standard follow the cosine of the incidence?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.calibration.faults.standard_levels import StandardLevels

COSINE = 0.2  # by which the standard may fail to follow the cosine


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Frames exchanged, another surface, or a spot that is too small."""
    levels = StandardLevels.of(evidence)
    if levels is None:
        return
    level, angle = levels.level, levels.angle
    if levels.exchanged:
        a, b = (f"{np.degrees(angle[i]):g}" for i in levels.exchanged)
        yield Finding(
            "exchanged_frames",
            "error",
            f"the standard's signals at {a} and {b} deg would follow cos(theta_i) if the frames of "
            "the two were exchanged.",
        )
        return
    i, off = max(((i, x - 1) for i, x in level.items()), key=lambda each: abs(each[1]))
    # An arm that is off by a degree and a half moves the cosine by its tangent.
    if abs(off) > COSINE + 0.026 * np.tan(angle[i]):
        yield Finding(
            "standard_off_cosine",
            "warning",
            f"{evidence.name(('standard', 0, i))}: its signal is {1 + off:.3g} of what the others "
            "and cos(theta_i) predict: another surface, another angle, or a lit spot smaller than "
            "what the camera sees.",
        )


QUESTION = Question(
    key="standard_cosine",
    order=90,
    asks="Does the standard follow the cosine of the incidence?",
    compares="the standard's signals at all incidences with f_std cos(theta_i)",
    codes=("exchanged_frames", "standard_off_cosine"),
    ask=ask,
)
