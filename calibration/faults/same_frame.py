"""Does a frame occur twice?"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence


def ask(evidence: Evidence) -> Iterator[Finding]:
    """The same frame twice, noise and all."""
    frames_of = defaultdict(list)
    for image, statistics in evidence.of("background", "standard", "sample"):
        for k, fingerprint in enumerate(statistics.prints):
            if fingerprint is not None:
                frames_of[fingerprint].append((image, k))
    twins = [frames for frames in frames_of.values() if len(frames) > 1]
    for frames in twins[:1]:
        (a, j), (b, k) = frames[:2]
        code = "missing_background" if "background" in (a[0], b[0]) else "same_frame"
        more = f" There are {len(twins)} such pairs." if len(twins) > 1 else ""
        yield Finding(
            code,
            "error",
            f"{evidence.name(a, j)}, and {evidence.name(b, k)}, are the same frame, including its "
            f"noise.{more}",
        )


QUESTION = Question(
    key="same_frame",
    order=20,
    asks="Does a frame occur twice?",
    compares="the fingerprints of all frames, noise included",
    codes=("same_frame", "missing_background"),
    ask=ask,
)
