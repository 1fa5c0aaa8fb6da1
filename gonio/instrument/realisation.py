"""What chance decides once for a session: the errors of standard, lamp, dome, camera and holder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.geometry import FloatArray
from gonio.instrument import Instrument
from gonio.metadata import Plan


@dataclass(frozen=True)
class Realisation:
    """What chance decides once: the standard's error and the lamp's output for every image."""

    standard_scale: float
    lamp: FloatArray  # (images in the plan's order, channels)
    pattern_seed: int  # the camera's fixed patterns
    dome_seed: int  # the dome's slope errors and coating
    noise_seed: int
    multibounce_scale: float  # the true g over the stated one
    azimuth: float = 0.0  # turn of the sample that its rotations do not count, radians

    @classmethod
    def from_seed(cls, seed: int, rig: Instrument, plan: Plan) -> Realisation:
        """Draw them; what further channels and a slow drift need comes last."""
        n = plan.n_images
        rng = np.random.default_rng(seed)
        seeds = rng.integers(0, 2**63, size=3)
        standard = 1 + rig.standard.uncertainty * rng.standard_normal()
        drawn = [rng.standard_normal(n) for _ in plan.channels]
        lamp = 1 + rig.lamp.drift * np.stack(drawn, axis=1)
        if rig.lamp.slow_drift:
            # A random walk: the images follow each other in time, a step of the arm apart.
            wander = np.cumsum(rig.lamp.slow_drift * rng.standard_normal(n))
            lamp *= np.exp(wander)[:, None]
        multibounce = 1.0
        if rig.surroundings.multibounce_uncertainty:
            multibounce += rig.surroundings.multibounce_uncertainty * rng.standard_normal()
        azimuth = rig.holder.azimuth_deg
        if rig.holder.u_azimuth_deg:
            azimuth += rig.holder.u_azimuth_deg * rng.standard_normal()
        pattern, dome, noise = (int(s) for s in seeds)
        return cls(
            float(standard), lamp, pattern, dome, noise, max(multibounce, 0.0),
            float(np.radians(azimuth)),
        )  # fmt: skip
