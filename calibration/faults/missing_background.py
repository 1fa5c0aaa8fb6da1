"""Was the background taken?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence


def ask(evidence: Evidence) -> Iterator[Finding]:
    camera = evidence.metadata.camera
    for image, statistics in evidence.of("background"):
        if min(statistics.zeros) == 1:
            # A camera without a black level may be that dark.
            possible = camera.black_dn <= 3 * camera.noise_dn
            yield Finding(
                "missing_background",
                "warning" if possible else "error",
                f"{evidence.name(image)}: every count is 0; it was not taken. Take it without the "
                "sample, with the lamp where it stands.",
            )


QUESTION = Question(
    key="missing_background",
    order=10,
    asks="Was the background taken?",
    compares="the counts of every background with 0",
    codes=("missing_background",),
    ask=ask,
)
