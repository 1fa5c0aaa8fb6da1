"""Does the sample reflect more light than falls on it? Then frames may be exchanged."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.calibration.faults.standard_levels import standard_signals
from gonio.calibration.frames import standard as eq2

ALBEDO = 1.1


def ask(evidence: Evidence) -> Iterator[Finding]:
    """An albedo above 1.1: sample and standard are exchanged, or the standard is another one."""
    metadata, regions = evidence.metadata, evidence.regions
    across = np.cross(np.gradient(regions.w_r, axis=0), np.gradient(regions.w_r, axis=1))
    weight = np.linalg.norm(across, axis=-1) * regions.w_r[..., 2] * (regions.cover > 0.99)
    signals = standard_signals(evidence)
    alone = metadata.plan.standard_theta_i_deg is not None
    albedos = []
    for image, statistics in evidence.of("sample"):
        black = evidence.mean("background", image[2])
        white = signals.get(0 if alone else image[2])
        if black is None or white is None:
            continue
        scale = eq2.irradiance_ratio(metadata, evidence.theta_i(image)) if alone else 1.0
        cosine = np.cos(evidence.theta_i(("standard", 0, 0 if alone else image[2])))
        with np.errstate(divide="ignore", invalid="ignore"):
            f = (statistics.rate - black) / (white * cosine) * scale
        finite = np.isfinite(f)
        if finite.any():
            albedos.append(np.pi * np.sum((weight * f)[finite]) / np.sum(weight[finite]))
    if albedos and np.median(albedos) > ALBEDO:
        yield Finding(
            "brighter_than_white",
            "warning",
            f"the sample would reflect {np.median(albedos):.2g} times the light that falls on it: "
            "sample and standard are exchanged, or the standard is not the certified one.",
        )


QUESTION = Question(
    key="albedo",
    order=140,
    asks="Does the sample reflect more than falls on it?",
    compares="the albedo that the images show with 1.1",
    codes=("brighter_than_white",),
    ask=ask,
)
