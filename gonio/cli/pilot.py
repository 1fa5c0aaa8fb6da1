"""Virtual sessions in memory: what 'gonio design' plans with and what it verifies its plan by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gonio.calibration.frames.exposure import SATURATED
from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument import Instrument
from gonio.instrument.images import Fixed, Images, Surface
from gonio.instrument.imaging import trace_rays
from gonio.instrument.noise import expose
from gonio.instrument.records import channels, metadata
from gonio.metadata import Metadata, Plan, Role
from gonio.models import Model
from gonio.samples import BRDFSamples, SharedTerm
from gonio.session import Session
from gonio.simulation import Draws

# Pixels across the frame, to which a sensor is binned: the shared errors decide, and they do not
# depend on how finely the hemisphere is sampled.
ACROSS = 250
# Shared errors that average down over takes of background and standard.
AVERAGED = ("lamp, standard", "lamp, background", "lamp, background 2")
# Shared errors that are the same whatever the seed of a simulation: they bias, and do not scatter.
CONSTANT = ("mapping", "source cone", "room light", "standard, shape")

DOME = "dome slope"  # how the names of the terms for slope errors begin
FIELDS = 32  # drawn domes, whose scatter is known to 1/sqrt(2 32) = 12 %

Progress = Callable[[int, int], None]


class Virtual(Session):
    """A session of one channel whose frames stay in memory.

    Parameters
    ----------
    known : Metadata
    frames : mapping of (role, take, incidence) to ndarray, shape (exposures, rows, columns)
    """

    def __init__(
        self, known: Metadata, frames: dict[tuple[Role, int, int], NDArray[np.uint16]]
    ) -> None:
        super().__init__(Path("virtual session"), known, {})
        self._frames = frames

    def require_complete(self) -> None:
        """It always is."""

    def bracket(
        self, role: str, take: int, incidence: int, *, channel: int = 0
    ) -> NDArray[np.uint16]:
        """All exposures of one image."""
        return self._frames[role, take, incidence]  # type: ignore[index]

    def with_exposures(self, keep: list[int]) -> Virtual:
        """The session as if only these exposures, by number, had been taken."""
        plan = self.metadata.plan
        less = plan.model_copy(update={"exposures_s": tuple(plan.exposures_s[k] for k in keep)})
        known = self.metadata.model_copy(update={"plan": less})
        return Virtual(known, {image: frames[keep] for image, frames in self._frames.items()})

    def overexposed(self) -> float:
        """Largest share of pixels of a standard's image that its shortest exposure saturates."""
        camera = self.metadata.camera
        well_dn = camera.black_dn + camera.gain_dn_per_e * camera.full_well_e
        full = SATURATED * min(camera.saturation_dn, well_dn)
        return max(
            float(np.mean(frames[0] >= full))
            for (role, _, _), frames in self._frames.items()
            if role == "standard"
        )


@dataclass(frozen=True)
class Bench:
    """An instrument with a surface on its holder.

    Parameters
    ----------
    rig : Instrument
        Of one channel.
    model : Model
    p : ndarray, shape (P,)
    threads : int, optional
        No result depends on it.
    """

    rig: Instrument
    model: Model
    p: FloatArray
    threads: int | None = None

    def session(
        self, plan: Plan, draws: Draws | None = None, progress: Progress | None = None
    ) -> Virtual:
        """Frames of the plan; without draws nothing but noise is left to chance.

        Parameters
        ----------
        plan : Plan
            Of one channel.
        draws : Draws, optional
        progress : callable, optional
            Called with (images done, images in all).
        """
        drawn = draws or _no_drift(plan)
        surface = Surface(self.model.name, self.model, (self.p,))
        fixed = Fixed(
            drawn.dome_seed, drawn.pattern_seed, drawn.standard_scale, drawn.multibounce_scale
        )
        images = Images(self.rig, surface, plan, fixed, threads=self.threads)
        dark = self.rig.sensor.dark_current(drawn.pattern_seed)
        figures = self.rig.sensor.figures() | {"seed": drawn.noise_seed, "threads": self.threads}
        frames = {}
        n = len(plan.exposures_s)
        for number, image in enumerate(plan.images()):
            (rate,) = images.rates(*image, drawn.lamp[number])
            frames[image] = np.stack(
                [
                    expose(rate + dark, t, frame=number * n + k, **figures)
                    for k, t in enumerate(plan.exposures_s)
                ]
            )
            if progress is not None:
                progress(number + 1, plan.n_images)
        return Virtual(metadata(self.rig, plan, self.model.name, ""), frames)

    def drawn(self, plan: Plan, seed: int) -> Virtual:
        """A session as 'gonio simulate' draws one from a seed."""
        return self.session(plan, Draws.from_seed(seed, self.rig, plan))


def _no_drift(plan: Plan) -> Draws:
    return Draws(1.0, np.ones((plan.n_images, 1)), 1, 2, 3, 1.0)


def one_channel(rig: Instrument) -> Instrument:
    """The instrument with its dimmest filter alone."""
    dimmest = min(rig.channels, key=lambda channel: channel.relative_rate)
    return rig.model_copy(update={"channels": (dimmest,)})


def coarse(rig: Instrument) -> Instrument:
    """The instrument with a sensor that is binned to about `ACROSS` pixels.

    Rates, full wells and noise are those of the pixels that are summed.

    Examples
    --------
    >>> from gonio.instrument import preset
    >>> coarse(preset("modern12")).sensor.shape
    (208, 208)
    """
    sensor = rig.sensor
    binning = sensor.binning
    while min(sensor.rows, sensor.columns) // binning > ACROSS and not (
        sensor.rows % (2 * binning) or sensor.columns % (2 * binning)
    ):
        binning *= 2
    if binning == sensor.binning:
        return rig
    largest = binning**2 * ((1 << sensor.bits) - 1)
    change = {
        "binning": binning,
        "binned_divisor": max(sensor.binned_divisor, -(-largest // 65535)),
    }
    return rig.model_copy(update={"sensor": sensor.model_copy(update=change)})


def with_channels(plan: Plan, rig: Instrument) -> Plan:
    """The plan for this instrument's channels."""
    return plan.model_copy(update={"channels": channels(rig)})


@dataclass(frozen=True)
class Domes:
    """Slope errors of `FIELDS` drawn domes: by how much each turns the directions of pixels.

    The reduction knows a size and a correlation length, and makes three patterns of them: enough
    for a plan that somebody made, not for one that was made to be blind to these very patterns.

    Parameters
    ----------
    w_r : ndarray, shape (n, 3)
        Directions from sample to a dome without errors.
    shifts : list of ndarray, shape (n, 3)
    """

    w_r: FloatArray
    shifts: list[FloatArray]

    @classmethod
    def drawn(cls, rig: Instrument, first: int) -> Domes:
        """Domes of the seeds from `first` on; none where the instrument's has no slope errors."""
        rig = rig.model_copy(update={"rays_per_pixel": 1})
        none = {"slope_error_deg": 0.0, "rim_slope_error_deg": 0.0}
        even = rig.model_copy(update={"dome": rig.dome.model_copy(update=none)})
        w_r = trace_rays(even, 0).w_r[:, 0]
        if even == rig:
            return cls(w_r, [])
        return cls(w_r, [trace_rays(rig, first + k).w_r[:, 0] - w_r for k in range(FIELDS)])

    def given_to(self, samples: BRDFSamples) -> BRDFSamples:
        """The samples with these domes in place of the reduction's terms for slope errors.

        The domes are shared terms of one name, each with the weight 1/sqrt(FIELDS).
        """
        if not self.shifts:
            return samples
        # The dome stands still in the laboratory; the sample's azimuth is minus the lamp's.
        psi = -samples.directions.phi_i
        where = unit_vectors(samples.directions.theta_r, samples.directions.phi_r + psi)
        _, nearest = cKDTree(self.w_r).query(where)
        cos, sin = np.cos(psi), np.sin(psi)
        terms = []
        for shift in self.shifts:
            x, y, z = shift[nearest].T / np.sqrt(len(self.shifts))
            turned = np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)
            terms.append(SharedTerm(DOME, "slope errors of the dome", shift=turned))
        others = tuple(term for term in samples.shared if not term.name.startswith(DOME))
        return replace(samples, shared=(*others, *terms))


def seen(samples: BRDFSamples) -> tuple[float, float]:
    """Solid angle over all images, sr, and light in it: a lost peak shows in the second."""
    assert samples.solid_angle is not None
    light = samples.solid_angle * samples.value * np.cos(samples.directions.theta_r)
    return float(np.sum(samples.solid_angle)), float(np.sum(light))
