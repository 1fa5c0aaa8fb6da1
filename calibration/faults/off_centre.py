"""Does the image circle lie where the lens calibration has it?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence

OFF_CENTRE_PX, OFF_CENTRE_DEG = 0.5, 0.15


def ask(evidence: Evidence) -> Iterator[Finding]:
    """The image circle, as stray light fills it, against the calibrated one."""
    camera, rate = evidence.metadata.camera, evidence.background
    if rate is None or not evidence.regions.dark.any():
        return
    light = uniform_filter(rate.value - float(np.median(rate.value[evidence.regions.dark])), 3)
    rim = evidence.circle & (light < 5 * np.median(light[evidence.circle]))
    usual = float(np.median(light[rim])) if rim.any() else 0.0
    noise = float(np.median(np.sqrt(rate.variance(rate.value))[evidence.circle])) / 3
    if usual < 8 * noise:
        return
    lit = light > 0.4 * usual
    if not 0.85 < lit.sum() / evidence.circle.sum() < 1.15:
        return  # what fills the frame is not the image circle
    rows, columns = np.indices(lit.shape)
    off = [float(axis[lit].mean() - axis[evidence.circle].mean()) for axis in (columns, rows)]
    size = float(np.hypot(off[0], off[1]))
    pitch_mm = float(np.mean(camera.pitch_mm))
    deg_per_px = float(np.degrees(pitch_mm / evidence.metadata.lens.focal_length_mm))
    if size > max(OFF_CENTRE_PX, OFF_CENTRE_DEG / deg_per_px):
        yield Finding(
            "off_centre",
            "warning",
            f"the image circle lies {off[0]:+.1f} columns and {off[1]:+.1f} rows from where the "
            f"lens calibration has it, {size * deg_per_px:.2g} deg: all directions are off by "
            "that. Calibrate again, or give lens.centre_px.",
        )


QUESTION = Question(
    key="off_centre",
    order=150,
    asks="Does the image circle lie where the lens calibration has it?",
    compares="the circle that stray light fills with the calibrated one",
    codes=("off_centre",),
    ask=ask,
)
