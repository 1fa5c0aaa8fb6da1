"""Random errors of a session: standard, lamp, dome, camera and holder."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    half_angle_scale: float = 1.0  # true half-angle of the lamp over the stated one
    azimuth: float = 0.0  # rotation of the sample that the plan does not include, radians

    def instrument(self, nominal: Instrument) -> Instrument:
        """The instrument with its true lamp; it records what the nominal one states."""
        if self.half_angle_scale == 1.0:
            return nominal
        true = self.half_angle_scale * nominal.lamp.half_angle_deg
        lamp = nominal.lamp.model_copy(update={"half_angle_deg": true})
        return nominal.model_copy(update={"lamp": lamp})

    @classmethod
    def from_seeds(
        cls,
        seed: int,
        instrument: Instrument,
        plan: Plan,
        *,
        rig_seed: int | None = None,
        standard_seed: int | None = None,
    ) -> Realisation:
        """Draw the errors of a session on a rig of its own, or on one that others use as well.

        Parameters
        ----------
        seed : int
            Of everything, or of what each session draws anew: lamp, azimuth of the sample, noise.
        instrument : Instrument
        plan : Plan
        rig_seed : int, optional
            Of the dome's slope errors and coating, the camera's patterns, the multi-bounce and the
            lamp's cone.
        standard_seed : int, optional
            Of the standard's error; by default that of the rig, which has one standard.
        """
        session = cls.from_seed(seed, instrument, plan)
        if rig_seed is not None:
            rig = cls.from_seed(rig_seed, instrument, plan)
            session = replace(
                session, pattern_seed=rig.pattern_seed, dome_seed=rig.dome_seed,
                standard_scale=rig.standard_scale,
                multibounce_scale=_multibounce_scale(rig_seed, instrument),
                half_angle_scale=rig.half_angle_scale,
            )  # fmt: skip
        if standard_seed is not None:
            standard = cls.from_seed(standard_seed, instrument, plan)
            session = replace(session, standard_scale=standard.standard_scale)
        return session

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
            _half_angle_scale(seed, instrument), float(np.radians(azimuth)),
        )  # fmt: skip


def _multibounce_scale(rig_seed: int, instrument: Instrument) -> float:
    """True g over the stated value, of a rig whatever its plans are."""
    u = instrument.surroundings.multibounce_uncertainty or 0.0
    return max(1.0 + u * float(np.random.default_rng([rig_seed, 5]).standard_normal()), 0.0)


def _half_angle_scale(rig_seed: int, instrument: Instrument) -> float:
    """True half-angle of the lamp's cone over the stated one, by a generator of its own."""
    u = instrument.lamp.half_angle_uncertainty
    return max(1.0 + u * float(np.random.default_rng([rig_seed, 6]).standard_normal()), 0.1)
