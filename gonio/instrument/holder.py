"""The holder: size of the sample and errors of its position."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from gonio.geometry import FloatArray, rotated
from gonio.instrument.part import Part


class Holder(Part):
    """Holder of the sample at the target point; it is rotated by hand about its normal."""

    sample_diameter_mm: float = Field(gt=0, description="diameter of the sample")
    height_mm: float = Field(
        default=0.0, ge=-20, le=20, description="surface of the sample above the target's plane"
    )
    tilt_deg: float = Field(
        default=0.0, ge=0, le=20, description="tilt of the sample's normal, in the laboratory"
    )
    tilt_azimuth_deg: float = Field(default=0.0, description="azimuth of the tilt")
    azimuth_deg: float = Field(
        default=0.0,
        ge=-180,
        le=180,
        description="counter-clockwise rotation of the sample that the plan's rotations do not "
        "include",
    )
    u_azimuth_deg: float = Field(
        default=0.0,
        ge=0,
        le=45,
        description="standard uncertainty of the sample's azimuth; each session draws its error",
    )

    def on_surface(self, vectors: FloatArray) -> FloatArray:
        """Laboratory vectors (..., 3) in the frame of the sample before it is rotated by hand."""
        if not self.tilt_deg:
            return vectors
        return tilted(vectors, np.radians(self.tilt_deg), np.radians(self.tilt_azimuth_deg))


def tilted(vectors: FloatArray, tilt: float, azimuth: float) -> FloatArray:
    """Vectors (..., 3) seen from a frame whose z axis leans by `tilt` towards `azimuth`.

    The frame is turned about the horizontal axis at right angles to the azimuth.

    Examples
    --------
    The vector along the tilted axis becomes the new z axis:

    >>> np.round(tilted(np.array([np.sin(0.1), 0.0, np.cos(0.1)]), 0.1, 0.0), 12).tolist()
    [0.0, 0.0, 1.0]
    """
    x, y, z = np.moveaxis(rotated(vectors, azimuth), -1, 0)
    c, s = np.cos(tilt), np.sin(tilt)
    return rotated(np.stack([c * x - s * z, y, c * z + s * x], axis=-1), -azimuth)
