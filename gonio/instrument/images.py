"""Expected images: the stages of image formation in the order of the light path.

sample or standard -> multiple reflections -> stray light of the lamp -> lamp drift -> room light ->
filter -> point spread -> PRNU and dead pixels. What follows, dark current, noise and counts, is
`noise.expose`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.geometry import FloatArray
from gonio.instrument import Instrument, imaging, mirror
from gonio.metadata import Plan, Role
from gonio.models import Model


@dataclass(frozen=True)
class Surface:
    """The surface on the holder.

    Parameters
    ----------
    name : str
    model : Model, optional
        None for a mirror.
    p : tuple of ndarray
        The model's parameter vector in every channel.
    """

    name: str
    model: Model | None
    p: tuple[FloatArray, ...]


@dataclass(frozen=True)
class Fixed:
    """Random errors that are drawn once for all images of a session.

    Parameters
    ----------
    dome_seed, pattern_seed : int
        Seeds of the dome's fields and of the camera's fixed patterns.
    standard_scale : float
        True reflectance of the standard over its certified value.
    multibounce_scale : float
        True g of `imaging.multibounce_gain` over the stated value.
    azimuth : float
        Rotation of the sample that the plan's rotations do not include, radians.
    """

    dome_seed: int
    pattern_seed: int
    standard_scale: float = 1.0
    multibounce_scale: float = 1.0
    azimuth: float = 0.0


class Images:
    """Expected images of one surface on one instrument.

    Parameters
    ----------
    instrument : Instrument
    surface : Surface
    plan : Plan
    fixed : Fixed
    threads : int, optional
        Number of worker threads; the images do not depend on it.
    """

    def __init__(
        self,
        instrument: Instrument,
        surface: Surface,
        plan: Plan,
        fixed: Fixed,
        *,
        threads: int | None = None,
    ) -> None:
        self.instrument, self.surface, self.plan = instrument, surface, plan
        self.fixed, self.threads = fixed, threads
        self.rays = imaging.trace_rays(instrument, fixed.dome_seed, threads=threads)
        self.white = imaging.white_rate(instrument, self.rays)
        self._f_standard: tuple[float | None, FloatArray] = (None, self.white)
        self._response = instrument.sensor.response(fixed.pattern_seed).ravel()
        self._turned: tuple[float | None, FloatArray] = (None, self.rays.w_r)
        mean = self.rays.w_r.mean(axis=1)
        self.mean_directions = mean / np.linalg.norm(mean, axis=1, keepdims=True)

    def rates(
        self, role: Role, take: int, incidence: int, lamp: Sequence[float] | FloatArray
    ) -> list[FloatArray]:
        """Photo-electrons per second (rows, columns) without dark current, for each channel.

        Parameters
        ----------
        role, take, incidence
            The image, as in `Plan.images`.
        lamp : sequence of float
            Output of the lamp over its nominal value in every channel.
        """
        theta_i = np.radians(self.plan.incidences(role)[incidence])
        psi = self.rotation(take) if role == "sample" else 0.0
        below = self._below(role, incidence)
        stray = imaging.stray_rate(self.instrument, self.rays, theta_i, below=below)
        if role == "background":
            lit = [np.zeros(len(self.rays.pixel))] * len(self.plan.channels)
        elif role == "standard":
            lit = [self._standard(theta_i)] * len(self.plan.channels)
        elif self.surface.model is None:
            lit = [self._mirror(theta_i, psi)] * len(self.plan.channels)
        else:
            lit = self._sample(self.surface.model, theta_i, psi, below=below)
        room = self._room_light(role, psi)
        filters = self.instrument.channels
        return [
            self._image(((signal + stray) * output + ambient) * through.relative_rate)
            for signal, output, ambient, through in zip(lit, lamp, room, filters, strict=True)
        ]

    def rotation(self, take: int) -> float:
        """True rotation of the sample about its normal in a take, radians; a mirror has none."""
        off = 0.0 if self.surface.model is None else self.fixed.azimuth
        return float(np.radians(self.plan.rotations_deg[take])) + off

    def _below(self, role: Role, incidence: int) -> bool:
        """Whether the lamp stands below the sample: not for the standard and its background."""
        if self.plan.mode != "transmission" or role == "standard":
            return False
        return role == "sample" or incidence < len(self.plan.theta_i_deg)

    def _standard(self, theta_i: float) -> FloatArray:
        instrument, scale = self.instrument, self.fixed.standard_scale
        weights = imaging.lit_weights(instrument, self.rays, theta_i)
        f = scale * np.einsum("ij,ij->i", weights, self._standard_brdf(theta_i))
        rho = scale * instrument.standard.reflectance
        gain = imaging.multibounce_gain(instrument, rho, self.fixed.multibounce_scale)
        return np.asarray(self.white * self._irradiance(theta_i) * np.pi * f * gain)

    def _standard_brdf(self, theta_i: float) -> FloatArray:
        """f of the standard for every ray; kept for the next image where it does not change."""
        at = theta_i if self.instrument.standard.shape.depends_on_incidence else 0.0
        if self._f_standard[0] != at:
            f = imaging.standard_brdf(self.instrument, self.rays, at)
            self._f_standard = (at, f)
        return self._f_standard[1]

    def _sample(self, model: Model, theta_i: float, psi: float, *, below: bool) -> list[FloatArray]:
        """Light from the sample, for each channel; f of equal parameters is computed once."""
        instrument = self.instrument
        weights = imaging.lit_weights(instrument, self.rays, theta_i)
        w_r = self._viewing(psi)
        # Light from below is taken as if mirrored in the plane of the sample: w_i' = (x, y, |z|).
        lamp = instrument.lamp.directions(theta_i, self.rays.source)
        w_i = imaging.in_sample_frame(instrument, lamp, psi)
        rates: dict[bytes, FloatArray] = {}
        for p in self.surface.p:
            if p.tobytes() in rates:
                continue
            f = imaging.mean_brdf(model, p, w_i, w_r, weights, threads=self.threads)
            gain = 1.0
            if instrument.surroundings.multibounce and not below:
                centre = w_i.mean(axis=0)
                rho = imaging.albedo(model, p, centre / np.linalg.norm(centre))
                gain = imaging.multibounce_gain(instrument, rho, self.fixed.multibounce_scale)
            irradiance = self._irradiance(theta_i, below=below)
            rates[p.tobytes()] = self.white * irradiance * np.pi * f * gain
        return [rates[p.tobytes()] for p in self.surface.p]

    def _mirror(self, theta_i: float, psi: float) -> FloatArray:
        instrument, seed = self.instrument, self.fixed.dome_seed
        wedge = np.radians(self.plan.wedge_deg)
        spot = mirror.spot_rate(instrument, self.rays, theta_i, wedge=wedge, psi=psi, seed=seed)
        return spot * imaging.entry_transmittance(instrument, theta_i, seed)

    def _room_light(self, role: Role, psi: float) -> list[FloatArray]:
        """Room light, direct and reflected by the surface on the holder, for each channel."""
        instrument, n = self.instrument, len(self.plan.channels)
        direct = imaging.ambient_rate(instrument, self.rays)
        if not instrument.surroundings.ambient_reflected or role == "background":
            return [direct] * n
        if role == "standard":
            shown = self.fixed.standard_scale * imaging.standard_in_even_light(
                instrument, self.rays
            )
            return [direct + imaging.reflected_ambient_rate(instrument, self.rays, shown)] * n
        if self.surface.model is None or self.plan.mode == "transmission":
            # The room's image in a mirror and the reflection of a transmitting sheet are unknown.
            return [direct] * n
        w_r = imaging.in_sample_frame(instrument, self.mean_directions, psi)
        return [
            direct
            + imaging.reflected_ambient_rate(
                instrument, self.rays, imaging.even_light_reflectance(self.surface.model, p, w_r)
            )
            for p in self.surface.p
        ]

    def _viewing(self, psi: float) -> FloatArray:
        """Viewing directions of the rays (n, rays, 3) in the frame of the rotated sample."""
        if self._turned[0] != psi:
            self._turned = (psi, imaging.in_sample_frame(self.instrument, self.rays.w_r, psi))
        return self._turned[1]

    def _irradiance(self, theta_i: float, *, below: bool = False) -> float:
        return imaging.irradiance(self.instrument, theta_i, self.fixed.dome_seed, below=below)

    def _image(self, signal: FloatArray) -> FloatArray:
        """Frame of the camera from the light of the pixels in the image circle."""
        sensor = self.instrument.sensor
        rate = np.zeros(sensor.shape)
        rate.ravel()[self.rays.pixel] = np.maximum(signal, 0.0)
        rate = imaging.point_spread(rate, self.instrument.lens.psf_px / sensor.binning)
        return (rate.ravel() * self._response).reshape(rate.shape)
