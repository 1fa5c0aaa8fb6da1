"""Which pixels are dead or hot?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.wording import counted


def ask(evidence: Evidence) -> Iterator[Finding]:
    for kind, why in (
        ("dead", "less than a fifth of the signal of their neighbours, in the standard"),
        ("hot", "far brighter than their neighbours, in the background"),
    ):
        masks = list(evidence.bad[kind].values())
        # A pixel at the edge of the lit spot may look dead, but not from every incidence.
        often = np.sum(masks, axis=0) > 0.7 * len(masks)
        n = int(np.count_nonzero(often))
        if n:
            text = f"{counted(n, f'{kind} pixel')} left out: {why}."
            yield Finding(f"{kind}_pixels", "warning", text)


QUESTION = Question(
    key="bad_pixels",
    order=80,
    asks="Which pixels are dead or hot?",
    compares="every pixel with its neighbours, in standard and background",
    codes=("dead_pixels", "hot_pixels"),
    ask=ask,
)
