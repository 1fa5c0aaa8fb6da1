"""Is the dark level what it should be?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence, Image
from gonio.calibration.faults.frame_statistics import ZEROS, middle
from gonio.metadata import Camera
from gonio.wording import counted

SIGMAS = 5.0  # that a level must stand out by
DARK_DN = 0.5  # counts by which the dark level may be off


def ask(evidence: Evidence) -> Iterator[Finding]:
    """The level well outside the image circle against black level and dark current."""
    camera, times = evidence.metadata.camera, evidence.metadata.plan.exposures_s
    off: list[tuple[float, Image, int, float]] = []
    for image, statistics in evidence.of("background", "standard", "sample"):
        for k, level in enumerate(statistics.dark_dn):
            if level is None or statistics.zeros[k] > ZEROS:
                continue
            dark, allowed = _dark_dn(camera, times[k])
            excess = level[0] - camera.black_dn - dark
            if abs(excess) > max(DARK_DN, SIGMAS * level[1], allowed):
                off.append((abs(excess), image, k, excess))
    if not off:
        return
    _, image, k, excess = max(off, key=lambda each: each[0])
    rate = excess / camera.gain_dn_per_e * len(times) / sum(times)
    white = evidence.mean("standard", 0)
    effect = ""
    if white is not None and middle(white) > 0 and camera.gamma == 1:
        share = abs(rate) / middle(white)
        effect = f", {share:.2g} of the white standard's light if it is in one image only"
    affected = f"{counted(len(off), 'frame')} {'is' if len(off) == 1 else 'are'} off"
    yield Finding(
        "dark_drift",
        "warning",
        f"{evidence.name(image, k)}: outside the image circle the level is {excess:+.3g} counts "
        f"from black level and dark current{effect}; {affected}. Let the camera "
        "warm up, or correct camera.black_dn and camera.dark_e_per_s.",
    )


def _dark_dn(camera: Camera, time_s: float) -> tuple[float, float]:
    """Counts above black by the dark current, and what they may be off by."""
    electrons = camera.dark_e_per_s * time_s
    if camera.gamma == 1:
        return camera.gain_dn_per_e * electrons, 0.05 * camera.gain_dn_per_e * electrons
    # The mean of a response that is steep at zero is not the response to the mean.
    most = camera.gain_dn_per_e * camera.full_well_e * (
        max(electrons, 1.0) / camera.full_well_e
    ) ** camera.gamma  # fmt: skip
    return most / 2, most


QUESTION = Question(
    key="dark_level",
    order=60,
    asks="Is the dark level what it should be?",
    compares="the level outside the image circle with black level and dark current",
    codes=("dark_drift",),
    ask=ask,
)
