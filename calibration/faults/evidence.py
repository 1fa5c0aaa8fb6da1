"""Statistics of the images of a session, for the search for faults."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.faults.frame_statistics import ImageStatistics, Regions, image_statistics
from gonio.calibration.frames.exposure import Rate
from gonio.calibration.frames.standard import Reference
from gonio.geometry import FloatArray
from gonio.metadata import Metadata

Image = tuple[str, int, int]  # role, take, incidence


class Evidence:
    """Statistics of the images of a session, gathered while they are read.

    Parameters
    ----------
    metadata : Metadata
    theta_r, phi_r : ndarray, shape (rows, columns)
        Directions of the pixels, radians, frame of the laboratory; NaN outside the image circle.
    """

    def __init__(self, metadata: Metadata, theta_r: FloatArray, phi_r: FloatArray) -> None:
        self.metadata = metadata
        usable = np.radians(metadata.geometry.usable_theta_r_deg)
        self.regions = Regions.of(theta_r, phi_r, usable)
        self.circle = np.isfinite(theta_r)
        self.images: dict[Image, ImageStatistics] = {}
        self.bad: dict[str, dict[int, NDArray[np.bool_]]] = {"dead": {}, "hot": {}}
        self.background: Rate | None = None

    # A reader of frames calls the next two (`gonio.calibration.frames.reader`).
    def add_image(
        self, role: str, take: int, incidence: int, bracket: NDArray[np.uint16], rate: Rate
    ) -> None:
        """Add the statistics of one image. Images may come in any order and from any thread."""
        if (role, take, incidence) == ("background", 0, 0):
            self.background = rate
        self.images[role, take, incidence] = image_statistics(
            bracket, rate, self.metadata, self.regions
        )

    def add_reference(self, incidence: int, reference: Reference) -> None:
        """Add the dead and hot pixels of one incidence."""
        self.bad["dead"][incidence] = reference.dead & self.regions.inside
        self.bad["hot"][incidence] = reference.hot & self.regions.inside

    def of(self, *roles: str) -> list[tuple[Image, ImageStatistics]]:
        """The images of these roles, in order."""
        return [(key, self.images[key]) for key in sorted(self.images) if key[0] in roles]

    def theta_i(self, image: Image) -> float:
        """Incidence of an image, radians."""
        return float(np.radians(self.metadata.plan.incidences(image[0])[image[2]]))

    def name(self, image: Image, exposure: int | None = None) -> str:
        """What an image, or one of its frames, is called in a sentence."""
        plan = self.metadata.plan
        role, take, _ = image
        text = f"{role} at {np.degrees(self.theta_i(image)):g} deg"
        if role == "sample" and len(plan.rotations_deg) > 1:
            text += f", rotation {plan.rotations_deg[take]:g} deg"
        elif role != "sample" and plan.repeats > 1:
            text += f", take {take + 1}"
        if exposure is not None:
            text += f", {plan.exposures_s[exposure] * 1e3:g} ms"
        return text

    def mean(self, role: str, incidence: int) -> FloatArray | None:
        """Coarse image of a role at an incidence, mean of its takes; None where there is none."""
        takes = [f.rate for (_, _, i), f in self.of(role) if i == incidence]
        return np.asarray(np.mean(takes, axis=0)) if takes else None
