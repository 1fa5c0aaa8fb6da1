"""The lamp on its arm: a collimated beam of finite half-angle that drifts."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument.part import Part


class Lamp(Part):
    """Source, reflector and arm. The arm moves in the x-z plane: phi_i = 0 in the laboratory."""

    white_rate_e_per_s: float = Field(
        gt=0,
        description="photo-electrons per second in one pixel on the axis that views a perfect "
        "white surface lit at normal incidence, for a dome without losses",
    )
    half_angle_deg: float = Field(ge=0, le=5, description="half-angle of the source cone")
    half_angle_uncertainty: float = Field(
        default=0.0,
        ge=0,
        le=0.3,
        description="relative standard uncertainty of the half-angle; the rig's true one is drawn",
    )
    lit_diameter_mm: float = Field(gt=0, description="diameter of the beam")
    drift: float = Field(ge=0, le=0.2, description="relative sd of the output, image to image")
    slow_drift: float = Field(
        default=0.0,
        ge=0,
        le=0.05,
        description="relative sd of the slow drift of the output from one incidence to the next",
    )
    edge_falloff: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="loss of irradiance from the centre of the beam to its edge, as radius^2",
    )

    def directions(self, theta_i: float, offsets: FloatArray) -> FloatArray:
        """Directions towards points of the source, shape (n, 3), laboratory frame.

        Parameters
        ----------
        theta_i : float
            Angle of the arm from the sample normal, radians.
        offsets : ndarray, shape (n, 2)
            Points of the unit disc; (x, y) leans in and across the plane of incidence.
        """
        w = unit_vectors(theta_i, 0.0)
        in_plane = np.array([np.cos(theta_i), 0.0, -np.sin(theta_i)])
        across = np.array([0.0, 1.0, 0.0])
        a = np.tan(np.radians(self.half_angle_deg))
        w = w + a * (offsets[:, :1] * in_plane + offsets[:, 1:] * across)
        return np.asarray(w / np.linalg.norm(w, axis=1, keepdims=True))

    def lit(self, theta_i: float, x: FloatArray, y: FloatArray) -> FloatArray:
        """U of the beam on the plane of the sample at (x, y) mm: 1 in its middle, 0 outside.

        The footprint is an ellipse that grows along x as 1/cos(theta_i); within it
        U = 1 - edge_falloff (r/radius)^2, r measured across the beam.
        """
        radius = self.lit_diameter_mm / 2
        across = (x * np.cos(theta_i)) ** 2 + y**2
        inside = np.asarray(across <= radius**2, dtype=float)
        if not self.edge_falloff:
            return inside
        return np.asarray(inside * (1 - self.edge_falloff * across / radius**2))
