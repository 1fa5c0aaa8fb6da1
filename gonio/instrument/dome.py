"""The half-silvered dome: exact reflection in a hemisphere or a hemi-ellipsoid.

Frame: z is the sample's normal, the dome's centre O lies on the plane z = 0 of the sample, the
camera's pupil is C = (0, -D, 0) and the target T = (0, D, 0). The ellipsoid has its foci in C and
T: semi-axes R in x and z, sqrt(R^2 + D^2) in y.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from gonio.geometry import FloatArray, angles, unit_vectors
from gonio.instrument.part import Part


class Dome(Part):
    """Shape and coating of the dome.

    Examples
    --------
    In an ellipsoid, the pixel that looks straight up receives the ray from T to the same point:

    >>> theta_r, phi_r = Dome(shape="ellipsoid", R=150.0, D=15.0).reflected_angles(0.0, 0.0)
    >>> round(float(np.degrees(theta_r)), 3), round(float(np.degrees(phi_r)), 3)
    (11.365, -90.0)
    """

    shape: Literal["sphere", "ellipsoid"] = Field(
        default="ellipsoid", description="shape; the ellipsoid has its foci in camera and target"
    )
    R: float = Field(gt=0, description="radius of the sphere, semi-minor axis of the ellipsoid, mm")
    D: float = Field(gt=0, description="half the separation of camera and target, mm")
    reflectance: float = Field(default=0.45, gt=0, lt=1, description="R_d of the coating")
    transmittance: float = Field(
        default=0.45, gt=0, lt=1, description="T_d of the coating, for light that enters"
    )
    slope_error_deg: float = Field(
        default=0.0, ge=0, description="sd of the surface slope at the zenith"
    )
    rim_slope_error_deg: float = Field(
        default=0.0, ge=0, description="sd of the slope at the rim, added as (theta/90 deg)^6"
    )
    slope_correlation_deg: float = Field(
        default=10.0, gt=0, description="correlation length of the slope errors"
    )
    reflectance_variation: float = Field(
        default=0.0, ge=0, le=0.3, description="relative sd of the reflectance over the dome"
    )
    transmittance_variation: float = Field(
        default=0.0, ge=0, le=0.3, description="relative sd of the transmittance over the dome"
    )
    coating_correlation_deg: float = Field(
        default=30.0, gt=0, description="correlation length of the coating"
    )

    @model_validator(mode="after")
    def _possible(self) -> Dome:
        if self.D >= self.R:
            raise ValueError(f"D = {self.D} mm must be smaller than R = {self.R} mm")
        if self.reflectance + self.transmittance > 1:
            raise ValueError("reflectance + transmittance must not exceed 1")
        return self

    @property
    def semi_axis_y(self) -> float:
        """Semi-axis along the line from camera to target, mm."""
        return float(np.hypot(self.R, self.D)) if self.shape == "ellipsoid" else self.R

    def reflected_angles(
        self, theta_c: ArrayLike, phi_c: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Directions from the sample to the dome that the camera's chief rays see, exactly.

        The ray from C is reflected by the law of reflection and followed to the plane of the
        sample; the direction given is the reverse of its last leg.

        Parameters
        ----------
        theta_c, phi_c : array_like
            Polar angle and azimuth at the camera, radians.

        Returns
        -------
        theta_r, phi_r : ndarray
            Radians.
        """
        w_c = unit_vectors(theta_c, phi_c)
        pupil = np.broadcast_to([0.0, -self.D, 0.0], w_c.shape)
        w_r, _ = self.trace(pupil, w_c)
        return angles(w_r)

    def trace(
        self, origin: FloatArray, direction: FloatArray, slope: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Follow rays from the camera side to the plane of the sample.

        Parameters
        ----------
        origin, direction : ndarray, shape (..., 3)
            Points inside the dome in mm and unit vectors.
        slope : ndarray, shape (..., 2), optional
            Slope errors of the dome where the rays meet it, radians, along the two tangents that
            lie closest to x and y.

        Returns
        -------
        w_r : ndarray, shape (..., 3)
            Unit vectors from the sample back to the dome; z <= 0 marks a ray that never lands.
        landing : ndarray, shape (..., 2)
            Where the rays meet the plane z = 0, mm from the target T.
        """
        return self.reflect(self.hit(origin, direction), direction, slope)

    def reflect(
        self, point: FloatArray, direction: FloatArray, slope: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """`trace` from the points of the dome (..., 3), in mm, that the rays meet."""
        axes = np.array([self.R, self.semi_axis_y, self.R])
        normal = _unit(point / axes**2)
        if slope is not None:
            normal = _tilted(normal, slope)
        down = direction - 2 * _dot(direction, normal)[..., None] * normal
        # A ray that grazes or leaves upwards lands far outside any sample.
        z = np.minimum(down[..., 2], -1e-9)
        landing = point[..., :2] - (point[..., 2] / z)[..., None] * down[..., :2]
        return -down, landing - np.array([0.0, self.D])

    def hit(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """Points of the dome, mm, that rays from inside meet: the far root of the quadratic."""
        axes = np.array([self.R, self.semi_axis_y, self.R])
        o, d = origin / axes, direction / axes
        a, b, c = _dot(d, d), _dot(o, d), _dot(o, o) - 1
        t = (-b + np.sqrt(b * b - a * c)) / a
        return np.asarray(origin + t[..., None] * direction)

    def slope_errors(self, point: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Slope errors (..., 2) in radians at points of the dome, a smooth random field.

        A sum of plane waves in space with Gaussian wave numbers: its correlation falls as
        exp(-s^2 / 2 c^2) with the distance s, c being `slope_correlation_deg` as an arc of R. One
        seed always gives the same field.
        """
        theta = np.arctan2(np.hypot(point[..., 0], point[..., 1]), point[..., 2])
        sd = np.radians(
            self.slope_error_deg + self.rim_slope_error_deg * (theta / (np.pi / 2)) ** 6
        )
        return self._smooth_field(point, self.slope_correlation_deg, rng) * sd[..., None]

    def coating(self, point: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """R_d and T_d at points of the dome over their nominal values, smooth random fields.

        exp(s g - s^2/2) with g of unit variance: the mean is 1, and no value is negative.

        Parameters
        ----------
        point : ndarray, shape (..., 3)
            Points of the dome, mm.
        rng : numpy.random.Generator
            Generator of the fields; one seed always gives the same coating.

        Returns
        -------
        reflectance, transmittance : ndarray, shape (...)
        """
        field = self._smooth_field(point, self.coating_correlation_deg, rng)
        sd = np.array([self.reflectance_variation, self.transmittance_variation])
        relative = np.exp(sd * field - sd**2 / 2)
        return relative[..., 0], relative[..., 1]

    def entry_point(self, theta_i: float) -> FloatArray:
        """Point of the dome (3,), mm, where the axis of the lamp's beam enters it."""
        w_i = np.array([np.sin(theta_i), 0.0, np.cos(theta_i)])
        return self.hit(np.array([0.0, self.D, 0.0]), w_i)

    def _smooth_field(
        self, point: FloatArray, correlation_deg: float, rng: np.random.Generator
    ) -> FloatArray:
        """Two independent fields of unit variance at points of the dome, shape (..., 2)."""
        from gonio.instrument.slope_field import sum_of_waves

        waves = 64
        k = rng.normal(size=(waves, 3)) / np.radians(correlation_deg)
        phase = rng.uniform(0, 2 * np.pi, size=(2, waves))
        field = np.empty((*point.shape[:-1], 2))
        turn = 2 * np.pi
        sum_of_waves(
            np.ascontiguousarray(point).reshape(-1, 3),
            k / (turn * self.R),
            phase / turn,
            field.reshape(-1, 2),
        )
        return np.asarray(field * np.sqrt(2 / waves))


def _tilted(normal: FloatArray, slope: FloatArray) -> FloatArray:
    x_hat = np.array([1.0, 0.0, 0.0])
    t_x = x_hat - normal[..., :1] * normal
    t_x /= np.sqrt(np.maximum(_dot(t_x, t_x), 1e-24))[..., None]
    t_y = np.cross(normal, t_x)
    return _unit(normal + slope[..., :1] * t_x + slope[..., 1:] * t_y)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.sqrt(_dot(vectors, vectors))[..., None])
