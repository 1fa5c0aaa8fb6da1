"""Reads and merges the frames of one channel, and passes every image to a listener."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.frames import standard
from gonio.calibration.frames.exposure import Rate, average, merge
from gonio.calibration.frames.standard import Reference
from gonio.geometry import FloatArray
from gonio.session import Session


class Listener(Protocol):
    """Receives every image that is read and every reference that is made of them.

    It is called from any thread and in any order. It must keep what it needs: the reader keeps
    neither frames nor rates.
    """

    def add_image(
        self, role: str, take: int, incidence: int, bracket: NDArray[np.uint16], rate: Rate
    ) -> None:
        """An image was read."""

    def add_reference(self, incidence: int, reference: Reference) -> None:
        """Standard and background of an incidence were put together."""


@dataclass(frozen=True)
class FrameReader:
    """Reads the frames of one channel of a session.

    Parameters
    ----------
    session : Session
    channel : int
    theta_r, phi_r : ndarray, shape (rows, columns)
        Directions of the pixels, radians, frame of the laboratory; NaN outside the image circle.
    listener : Listener, optional
    """

    session: Session
    channel: int
    theta_r: FloatArray
    phi_r: FloatArray
    listener: Listener | None = None

    def rate(self, role: str, take: int, incidence: int) -> Rate:
        """One image, merged over its exposures."""
        metadata = self.session.metadata
        bracket = self.session.bracket(role, take, incidence, channel=self.channel)
        rate = merge(bracket, metadata.plan.exposures_s, metadata.camera)
        if self.listener is not None:
            self.listener.add_image(role, take, incidence, bracket, rate)
        return rate

    def averaged(self, role: str, incidence: int) -> Rate:
        """Mean over the takes of background or standard."""
        takes = range(self.session.metadata.plan.repeats)
        return average([self.rate(role, k, incidence) for k in takes])

    def reference(self, incidence: int) -> Reference:
        """What turns the images of the sample at an incidence into f, from all takes."""
        metadata = self.session.metadata
        plan = metadata.plan
        theta_i = float(np.radians(plan.theta_i_deg[incidence]))
        # Where the standard was taken once, the last of the backgrounds is its own.
        at_one = plan.standard_theta_i_deg
        alone = at_one is not None
        theta_std = theta_i if at_one is None else float(np.radians(at_one))
        made = standard.reference(
            self.averaged("background", incidence),
            self.averaged("standard", 0 if alone else incidence),
            standard.standard_brdf(metadata.standard, theta_std, self.theta_r, self.phi_r),
            dark_e_per_s=metadata.camera.dark_e_per_s,
            irradiance=standard.irradiance_ratio(metadata, theta_i),
            standard_background=(
                self.averaged("background", len(plan.theta_i_deg)) if alone else None
            ),
        )
        return self._reported(incidence, made)

    def standard_images(self, incidence: int) -> tuple[tuple[str, int, int], tuple[str, int, int]]:
        """First take of the standard at one of its incidences, and of the background it needs."""
        plan = self.session.metadata.plan
        alone = plan.standard_theta_i_deg is not None
        own = len(plan.theta_i_deg) if alone else incidence
        return ("standard", 0, incidence), ("background", 0, own)

    def compare_standard(self, incidence: int) -> Reference:
        """The reference at one of the standard's incidences, from the first takes alone."""
        metadata = self.session.metadata
        white, black = (self.rate(*image) for image in self.standard_images(incidence))
        theta_i = float(np.radians(metadata.plan.incidences("standard")[incidence]))
        f_std = standard.standard_brdf(metadata.standard, theta_i, self.theta_r, self.phi_r)
        dark = metadata.camera.dark_e_per_s
        return self._reported(incidence, standard.reference(black, white, f_std, dark_e_per_s=dark))

    def _reported(self, incidence: int, reference: Reference) -> Reference:
        if self.listener is not None:
            self.listener.add_reference(incidence, reference)
        return reference
