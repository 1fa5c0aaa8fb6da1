"""Did the lamp stand where the plan says?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.calibration.faults.frame_statistics import middle
from gonio.geometry import FloatArray, unit_vectors

PATCH_DEG = 6.0  # by which the lamp's entry patch may be off


def ask(evidence: Evidence) -> Iterator[Finding]:
    """The patch where the beam enters the dome shows where the lamp stood."""
    metadata, regions = evidence.metadata, evidence.regions
    if metadata.plan.mode == "transmission":
        return
    for image, statistics in evidence.of("background"):
        usable = (regions.cover > 0) & np.isfinite(statistics.rate)
        light = np.where(usable, statistics.rate - metadata.camera.dark_e_per_s, 0.0)
        most, usual = float(light.max()), middle(light[usable])
        if not most > 8 * max(usual, 0.0) + 10 * middle(statistics.sd[usable]):
            continue
        patch = light > most / 2
        centre = np.sum(regions.w_r[patch] * light[patch][:, None], axis=0)
        centre /= np.linalg.norm(centre)

        def away(theta_i_deg: float, centre: FloatArray = centre) -> float:
            lamp = unit_vectors(np.radians(theta_i_deg), 0.0)
            return float(np.degrees(np.arccos(np.clip(centre @ lamp, -1, 1))))

        planned = np.degrees(evidence.theta_i(image))
        if away(float(planned)) <= PATCH_DEG:
            continue
        others = metadata.plan.incidences("background")
        nearest = min(others, key=away)
        if away(nearest) <= PATCH_DEG / 2:
            yield Finding(
                "exchanged_frames",
                "error",
                f"{evidence.name(image)}: the lamp's entry patch lies at {nearest:g} deg; the "
                "frames of two incidences are exchanged.",
            )
            return


QUESTION = Question(
    key="entry_patch",
    order=120,
    asks="Did the lamp stand where the plan says?",
    compares="the place where the beam enters the dome with theta_i of each background",
    codes=("exchanged_frames",),
    ask=ask,
)
