"""Are counts cut off at 0?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.calibration.faults.frame_statistics import ZEROS
from gonio.wording import counted


def ask(evidence: Evidence) -> Iterator[Finding]:
    cut = [
        (share, image, k)
        for image, statistics in evidence.of("background", "standard", "sample")
        for k, share in enumerate(statistics.zeros)
        if share > ZEROS and min(statistics.zeros) < 1
    ]
    if cut:
        share, image, k = max(cut, key=lambda each: each[0])
        yield Finding(
            "clipped_at_zero",
            "warning",
            f"{evidence.name(image, k)}: {share:.0%} of the counts are 0, as in "
            f"{counted(len(cut), 'frame')}; the black level is too low for the read "
            "noise and dark pixels come out too bright. Raise the camera's offset.",
        )


QUESTION = Question(
    key="clipped_at_zero",
    order=70,
    asks="Are counts cut off at 0?",
    compares="the share of counts at 0 with 1 %",
    codes=("clipped_at_zero",),
    ask=ask,
)
