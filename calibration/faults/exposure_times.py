"""Do counts grow as the exposure times say?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence, Image
from gonio.calibration.faults.frame_statistics import ValueWithError
from gonio.wording import counted

SIGMAS = 5.0  # that a ratio must stand out by
GROWTH = 0.05  # by which a signal may fail to grow as the exposure


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Counts must grow as the exposure does."""
    times = evidence.metadata.plan.exposures_s
    wrong: list[tuple[float, Image, int, float]] = []
    for image, statistics in evidence.of("standard", "sample"):
        for k, ratio in enumerate(statistics.growth, start=1):
            expected = times[k] / times[k - 1]
            if ratio is not None and _stands_out(ratio, expected, GROWTH * expected):
                wrong.append((abs(np.log(max(ratio[0], 1e-6) / expected)), image, k, ratio[0]))
    if not wrong:
        return
    _, image, k, growth = max(wrong, key=lambda each: each[0])
    expected = times[k] / times[k - 1]
    text = (
        f"{evidence.name(image, k)}: signals are {growth:.3g} times those of "
        f"{times[k - 1] * 1e3:g} ms, not {expected:.3g}"
    )
    images = {each[1] for each in wrong}
    if growth <= 1:
        yield Finding(
            "exposure_order",
            "error",
            f"{text}: frames are exchanged, or plan.exposures_s is not what the camera did.",
        )
    else:
        yield Finding(
            "not_linear",
            "warning",
            f"{text}, as in {counted(len(images), 'image')}: the response is not what "
            f"camera.gamma = {evidence.metadata.camera.gamma:g} says, or plan.exposures_s is not "
            "what the camera did.",
        )


def _stands_out(ratio: ValueWithError, expected: float, tolerance: float) -> bool:
    return abs(ratio[0] - expected) > max(tolerance, SIGMAS * ratio[1])


QUESTION = Question(
    key="exposure_times",
    order=30,
    asks="Do counts grow as the exposure times say?",
    compares="the signals of each exposure with those of the previous one",
    codes=("exposure_order", "not_linear"),
    ask=ask,
)
