"""Random errors of a session: standard, lamp, dome, camera and holder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.geometry import FloatArray
from gonio.instrument import Instrument
from gonio.metadata import Plan


@dataclass(frozen=True)
class Realisation:
    """Random errors drawn once for a session, and the lamp's output for every image."""

    standard_scale: float
    lamp: FloatArray  # (images in the plan's order, channels)
    pattern_seed: int  # the camera's fixed patterns
    dome_seed: int  # the dome's slope errors and coating
    noise_seed: int
    multibounce_scale: float  # true g over the stated value
    azimuth: float = 0.0  # rotation of the sample that the plan does not include, radians

    @classmethod
    def from_seed(cls, seed: int, instrument: Instrument, plan: Plan) -> Realisation:
        """Draw the errors; those of further channels and of a slow drift are drawn last."""
        n = plan.n_images
        rng = np.random.default_rng(seed)
        seeds = rng.integers(0, 2**63, size=3)
        standard = 1 + instrument.standard.uncertainty * rng.standard_normal()
        drawn = [rng.standard_normal(n) for _ in plan.channels]
        lamp = 1 + instrument.lamp.drift * np.stack(drawn, axis=1)
        if instrument.lamp.slow_drift:
            # A random walk: consecutive images are one step of the arm apart in time.
            wander = np.cumsum(instrument.lamp.slow_drift * rng.standard_normal(n))
            lamp *= np.exp(wander)[:, None]
        multibounce = 1.0
        if instrument.surroundings.multibounce_uncertainty:
            multibounce += instrument.surroundings.multibounce_uncertainty * rng.standard_normal()
        azimuth = instrument.holder.azimuth_deg
        if instrument.holder.u_azimuth_deg:
            azimuth += instrument.holder.u_azimuth_deg * rng.standard_normal()
        pattern, dome, noise = (int(s) for s in seeds)
        return cls(
            float(standard), lamp, pattern, dome, noise, max(multibounce, 0.0),
            float(np.radians(azimuth)),
        )  # fmt: skip
