"""Do the counts have the bits that session.json says?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Counts that stop early, and counts in steps: fewer bits than session.json says."""
    camera = evidence.metadata.camera
    images = evidence.of("background", "standard", "sample")
    cut = [
        (statistics.cut_off_dn, image)
        for image, statistics in images
        if statistics.cut_off_dn is not None
    ]
    if cut:
        count, image = max(cut, key=lambda each: each[0])
        bits = f"; {count} is what 8 bits hold" if count == 255 else ""
        yield Finding(
            "saturates_early",
            "error",
            f"{evidence.name(image)}: counts stop at {count}, and camera.saturation_dn is "
            f"{camera.saturation_dn}{bits}. Saturated pixels would pass for good ones: correct "
            "session.json.",
        )
    steps = {statistics.step for _, statistics in evidence.of("standard", "sample")}
    step = min(steps, default=1)
    if step > 1:
        yield Finding(
            "coarse_counts",
            "warning",
            f"all counts are multiples of {step} apart: frames of fewer bits in a wider container. "
            f"Divide them by {step}, with gain, black level and saturation, so that their rounding "
            "is known.",
        )


QUESTION = Question(
    key="bit_depth",
    order=40,
    asks="Do the counts have the bits that session.json says?",
    compares="the largest counts and the steps between counts with camera.saturation_dn",
    codes=("saturates_early", "coarse_counts"),
    ask=ask,
)
