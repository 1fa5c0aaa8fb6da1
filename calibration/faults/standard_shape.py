"""Is the standard the certified one?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.calibration.faults.standard_levels import FEWEST, StandardLevels

SHAPE = 0.06  # by which its f may change over the hemisphere between incidences


def ask(evidence: Evidence) -> Iterator[Finding]:
    """f of the standard may not change over the hemisphere but as its certificate says."""
    levels = StandardLevels.of(evidence)
    if levels is None or levels.exchanged:
        return  # other questions say so
    spread = {}
    for i, x in levels.level.items():
        relative = levels.ratio[i] / x
        finite = np.isfinite(relative)
        # Means of 3 x 3 blocks: noise must not pass for shape.
        share = uniform_filter(finite.astype(float), 3)
        smooth = uniform_filter(np.where(finite, relative, 0.0), 3) / np.where(finite, share, 1.0)
        inner = smooth[finite & (share > 0.99)]
        if len(inner) > FEWEST:
            low, high = np.percentile(inner, [5, 95])
            spread[i] = float(high - low) / 2
    if not spread:
        return
    i, most = max(spread.items(), key=lambda each: each[1])
    certificate = evidence.metadata.standard
    if most > SHAPE + certificate.rolloff_uncertainty + (certificate.u_shape or 0.0):
        yield Finding(
            "wrong_standard",
            "warning",
            f"{evidence.name(('standard', 0, i))}: against the other incidences its f changes by "
            f"+-{most:.0%} over the hemisphere, which the certificate does not state: it is "
            "not the certified standard, or it is dirty or glossy.",
        )


QUESTION = Question(
    key="standard_shape",
    order=100,
    asks="Is the standard the certified one?",
    compares="f of the standard over the hemisphere between incidences",
    codes=("wrong_standard",),
    ask=ask,
)
