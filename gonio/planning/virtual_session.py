"""Virtual sessions in memory, for the search and the verification of a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.frames.exposure import SATURATED
from gonio.fitting.problem.constraints import Constraints
from gonio.geometry import FloatArray
from gonio.instrument import Instrument
from gonio.instrument.images import Fixed, Images, Surface
from gonio.instrument.noise import expose
from gonio.instrument.realisation import Realisation
from gonio.instrument.records import channels, metadata
from gonio.metadata import Metadata, Plan, Role
from gonio.models import Model, Parameter
from gonio.session import Session

# Pixels across the frame to which a sensor is binned. Shared errors dominate, and they do not
# depend on how finely the hemisphere is sampled.
ACROSS = 250
Progress = Callable[[int, int], None]


class VirtualSession(Session):
    """A session of one channel whose frames stay in memory.

    Parameters
    ----------
    metadata : Metadata
    frames : mapping of (role, take, incidence) to ndarray, shape (exposures, rows, columns)
    """

    def __init__(
        self, metadata: Metadata, frames: dict[tuple[Role, int, int], NDArray[np.uint16]]
    ) -> None:
        super().__init__(Path("virtual session"), metadata, {})
        self._frames = frames

    def require_complete(self) -> None:
        """Do nothing: all frames are in memory."""

    def bracket(
        self, role: str, take: int, incidence: int, *, channel: int = 0
    ) -> NDArray[np.uint16]:
        """All exposures of one image."""
        return self._frames[role, take, incidence]  # type: ignore[index]

    def with_exposures(self, keep: list[int]) -> VirtualSession:
        """The session with only the exposures of these numbers."""
        plan = self.metadata.plan
        less = plan.model_copy(update={"exposures_s": tuple(plan.exposures_s[k] for k in keep)})
        metadata = self.metadata.model_copy(update={"plan": less})
        return VirtualSession(
            metadata, {image: frames[keep] for image, frames in self._frames.items()}
        )

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
class Setup:
    """An instrument with a surface on its holder.

    Parameters
    ----------
    instrument : Instrument
        Of one channel.
    model : Model
    p : ndarray, shape (P,)
    threads : int, optional
        No result depends on it.
    constraints : Constraints
        Parameters that a fit to its sessions holds fixed or tied.
    """

    instrument: Instrument
    model: Model
    p: FloatArray
    threads: int | None = None
    constraints: Constraints = field(default_factory=Constraints)

    @property
    def unknowns(self) -> tuple[Parameter, ...]:
        """Parameters that a fit searches for."""
        return self.constraints.unknowns(self.model)[0]

    def session(
        self, plan: Plan, realisation: Realisation | None = None, progress: Progress | None = None
    ) -> VirtualSession:
        """Frames of the plan; without a realisation nothing but noise is left to chance.

        Parameters
        ----------
        plan : Plan
            Of one channel.
        realisation : Realisation, optional
        progress : callable, optional
            Called with (images done, images in all).
        """
        drawn = realisation or _no_drift(plan)
        surface = Surface(self.model.name, self.model, (self.p,))
        fixed = Fixed(
            drawn.dome_seed, drawn.pattern_seed, drawn.standard_scale, drawn.multibounce_scale
        )
        images = Images(self.instrument, surface, plan, fixed, threads=self.threads)
        dark = self.instrument.sensor.dark_current(drawn.pattern_seed)
        readout = self.instrument.sensor.readout() | {
            "seed": drawn.noise_seed,
            "threads": self.threads,
        }
        frames = {}
        n = len(plan.exposures_s)
        for number, image in enumerate(plan.images()):
            (rate,) = images.rates(*image, drawn.lamp[number])
            frames[image] = np.stack(
                [
                    expose(rate + dark, t, frame=number * n + k, **readout)
                    for k, t in enumerate(plan.exposures_s)
                ]
            )
            if progress is not None:
                progress(number + 1, plan.n_images)
        return VirtualSession(metadata(self.instrument, plan, self.model.name, ""), frames)

    def drawn(self, plan: Plan, seed: int) -> VirtualSession:
        """A session as `gonio.simulate` draws one from a seed."""
        return self.session(plan, Realisation.from_seed(seed, self.instrument, plan))


def _no_drift(plan: Plan) -> Realisation:
    return Realisation(1.0, np.ones((plan.n_images, 1)), 1, 2, 3, 1.0)


def one_channel(instrument: Instrument) -> Instrument:
    """The instrument with its dimmest filter alone."""
    dimmest = min(instrument.channels, key=lambda channel: channel.relative_rate)
    return instrument.model_copy(update={"channels": (dimmest,)})


def coarse(instrument: Instrument) -> Instrument:
    """The instrument with a sensor that is binned to about `ACROSS` pixels.

    Rates, full wells and noise are those of the pixels that are summed.

    Examples
    --------
    >>> from gonio.instrument import preset
    >>> coarse(preset("modern12")).sensor.shape
    (208, 208)
    """
    sensor = instrument.sensor
    binning = sensor.binning
    while min(sensor.rows, sensor.columns) // binning > ACROSS and not (
        sensor.rows % (2 * binning) or sensor.columns % (2 * binning)
    ):
        binning *= 2
    if binning == sensor.binning:
        return instrument
    largest = binning**2 * ((1 << sensor.bits) - 1)
    change = {
        "binning": binning,
        "binned_divisor": max(sensor.binned_divisor, -(-largest // 65535)),
    }
    return instrument.model_copy(update={"sensor": sensor.model_copy(update=change)})


def with_channels(plan: Plan, instrument: Instrument) -> Plan:
    """The plan for this instrument's channels."""
    return plan.model_copy(update={"channels": channels(instrument)})
