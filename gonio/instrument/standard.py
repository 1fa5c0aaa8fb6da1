"""The white standard: its certificate and its true properties."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from gonio.geometry import FloatArray
from gonio.instrument.part import Part


class Standard(Part):
    """A diffuse standard with f(theta_r) = reflectance/pi (1 - rolloff (theta_r/75 deg)^4)."""

    reflectance: float = Field(gt=0, le=1, description="certified reflectance")
    uncertainty: float = Field(
        ge=0, lt=0.5, description="relative standard uncertainty of the reflectance"
    )
    rolloff: float = Field(
        default=0.0,
        ge=0,
        lt=0.4,
        description="loss at theta_r = 75 deg; 0 is a Lambertian standard",
    )
    rolloff_certified: bool = Field(
        default=True,
        description="whether the certificate states the rolloff; if not, the reduction "
        "takes the standard as Lambertian, as Ward's eq. (2) does",
    )

    rolloff_uncertainty: float = Field(
        default=0.0,
        ge=0,
        lt=0.4,
        description="standard uncertainty of the rolloff that the reduction uses",
    )

    def brdf(self, theta_r: ArrayLike) -> FloatArray:
        """f of the standard in sr^-1 for polar angles in radians."""
        t = np.asarray(theta_r, float) / np.radians(75)
        return np.asarray(self.reflectance / np.pi * (1 - self.rolloff * t**4))
