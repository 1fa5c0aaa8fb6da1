"""Is an image saturated in every exposure?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.wording import counted

SATURATED = 0.005  # share of saturated pixels


def ask(evidence: Evidence) -> Iterator[Finding]:
    for role in ("background", "standard", "sample"):
        full = [(statistics.saturated, image) for image, statistics in evidence.of(role)]
        full = [each for each in full if each[0] > SATURATED]
        if full:
            share, image = max(full, key=lambda each: each[0])
            yield Finding(
                f"saturated_{role}",
                "error" if share > 0.5 else "warning",
                f"{evidence.name(image)}: {share:.1%} of the pixels are saturated in the shortest "
                f"exposure, or where none is expected; this is so in "
                f"{counted(len(full), 'image')}. They are left out: take a shorter exposure.",
            )


QUESTION = Question(
    key="saturation",
    order=50,
    asks="Is an image saturated in every exposure?",
    compares="the share of saturated pixels of every image with 0.5 %",
    codes=("saturated_background", "saturated_standard", "saturated_sample"),
    ask=ask,
)
