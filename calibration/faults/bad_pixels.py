"""Which pixels are dead or hot?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence


def ask(evidence: Evidence) -> Iterator[Finding]:
    for kind, why in (
        ("dead", "see less than a fifth of what their neighbours see of the standard"),
        ("hot", "are far brighter than their neighbours in the background"),
    ):
        masks = list(evidence.bad[kind].values())
        # A pixel at the edge of the lit spot may look dead, but not from every incidence.
        often = np.sum(masks, axis=0) > 0.7 * len(masks)
        n = int(np.count_nonzero(often))
        if n:
            yield Finding(f"{kind}_pixels", "warning", f"{n} pixels {why}; they are left out.")


QUESTION = Question(
    key="bad_pixels",
    order=80,
    asks="Which pixels are dead or hot?",
    compares="every pixel with its neighbours, in standard and background",
    codes=("dead_pixels", "hot_pixels"),
    ask=ask,
)
