"""Is anything darker than its background? Then the lamp stood elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence, Image
from gonio.calibration.faults.standard_levels import FEWEST
from gonio.wording import counted

SIGMAS = 5.0  # that a signal must stand out by


def ask(evidence: Evidence) -> Iterator[Finding]:
    """An image that is darker than its background: the lamp stood elsewhere."""
    metadata = evidence.metadata
    drift = 0.02 if metadata.lamp.drift is None else metadata.lamp.drift
    white = evidence.mean("standard", 0)
    darker: list[tuple[float, Image, int]] = []
    for image, statistics in evidence.of("standard", "sample"):
        alone = image[0] == "standard" and metadata.plan.standard_theta_i_deg is not None
        own = len(metadata.plan.theta_i_deg) if alone else image[2]
        black = evidence.mean("background", own)
        if black is None or white is None:
            continue
        noise = evidence.images["background", 0, own].sd
        stray = np.maximum(black - metadata.camera.dark_e_per_s, 0)
        floor = -8 * np.hypot(statistics.sd, noise) - SIGMAS * drift * stray
        missing = (evidence.regions.cover > 0) & (
            statistics.rate - black < np.minimum(floor, -0.02 * white)
        )
        if missing.sum() >= FEWEST:
            most = float((black - statistics.rate)[missing].max())
            darker.append((most, image, int(missing.sum())))
    if darker:
        most, image, n = max(darker, key=lambda each: each[0])
        yield Finding(
            "darker_than_background",
            "error",
            f"{evidence.name(image)}: it is darker than its background in {counted(n, 'place')}, "
            f"by up to {most:.3g} e-/s, as in {counted(len(darker), 'image')}: frames of two "
            "incidences are exchanged, or the lamp moved between the two.",
        )


QUESTION = Question(
    key="darker_than_background",
    order=130,
    asks="Is anything darker than its background?",
    compares="every image of standard and sample with its background",
    codes=("darker_than_background",),
    ask=ask,
)
