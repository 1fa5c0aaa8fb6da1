"""The fisheye lens: projection, pupil, relative illumination."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from gonio.geometry import FloatArray
from gonio.instrument.part import Part


class Lens(Part):
    """A fisheye that looks along +z; its image has x to the right and y down, as the frame has."""

    projection: Literal["equidistant", "equisolid", "kannala_brandt"] = Field(
        default="equidistant",
        description="projection: r = f theta, r = 2 f sin(theta/2), or with coefficients k",
    )
    focal_length_mm: float = Field(gt=0, description="focal length f of the projection")
    k: tuple[float, float, float, float] = Field(
        default=(0.0, 0.0, 0.0, 0.0),
        description="kannala_brandt: r = f theta (1 + k1 theta^2 + k2 theta^4 + ...)",
    )
    pupil_mm: float = Field(ge=0, description="diameter of the entrance pupil")
    field_deg: float = Field(default=180.0, gt=0, le=180, description="full field of view")
    vignetting: float = Field(
        default=0.0, ge=0, lt=1, description="loss of relative illumination at 90 deg, as theta^2"
    )
    focus: Literal["R/2", "R"] = Field(default="R/2", description="distance of sharp focus")
    psf_px: float = Field(
        default=0.0,
        ge=0,
        le=50,
        description="sd of the Gaussian point spread on each axis, unbinned pixels",
    )
    pupil_offset_mm: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0),
        description="offset of the entrance pupil from its nominal position (0, -D, 0)",
    )
    pupil_walk_mm: float = Field(
        default=0.0, description="rise of the entrance pupil at 90 deg, as (theta/90 deg)^2"
    )
    azimuth_deg: float = Field(
        default=0.0, description="counter-clockwise rotation of the camera about the normal"
    )
    alignment_known: bool = Field(
        default=False,
        description="whether the session states the true pupil, azimuth and image centre; if not, "
        "it states their nominal values",
    )

    def radius(self, theta: ArrayLike) -> FloatArray:
        """Distance from the image's centre, mm, for polar angles in radians."""
        t = np.asarray(theta, float)
        f = self.focal_length_mm
        if self.projection == "equisolid":
            return np.asarray(2 * f * np.sin(t / 2))
        return np.asarray(f * t * self._polynomial(t))

    def slope(self, theta: ArrayLike) -> FloatArray:
        """Derivative of `radius` by theta, mm."""
        t = np.asarray(theta, float)
        f = self.focal_length_mm
        if self.projection == "equisolid":
            return np.asarray(f * np.cos(t / 2))
        k1, k2, k3, k4 = self._k()
        q = t * t
        return np.asarray(f * (1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4)))))

    def polar_angle(self, radius: ArrayLike) -> FloatArray:
        """Polar angle, radians, at a distance from the image's centre in mm; NaN off the image.

        Newton's method on `radius`, which is monotonic over the field.
        """
        r = np.asarray(radius, float)
        edge = np.radians(self.field_deg / 2)
        theta = np.minimum(r / self.focal_length_mm, edge)
        for _ in range(20):
            step = (self.radius(theta) - r) / self.slope(theta)
            theta = np.clip(theta - step, 0, 1.05 * edge)
            if np.all(np.abs(step) < 1e-9):  # the next step would be of the order of its square
                break
        outside = r > self.radius(edge) * (1 + 1e-12)
        return np.where(outside, np.nan, theta)

    def solid_angle(self, theta: ArrayLike) -> FloatArray:
        """Solid angle seen by a small area of the image, relative to the centre: sin/(r r')."""
        t = np.asarray(theta, float)
        small = t < 1e-6
        safe = np.where(small, 1e-6, t)
        ratio = np.sin(safe) / (self.radius(safe) * self.slope(safe))
        return np.asarray(ratio * self.focal_length_mm**2)

    def pupil_centre(self, theta: ArrayLike, D: float) -> FloatArray:
        """Centre of the entrance pupil (..., 3), mm from the dome's centre.

        (0, -D, 0) + offset + (0, 0, walk (theta/90 deg)^2): a fisheye's pupil moves forward and
        up for rays from the side.

        Parameters
        ----------
        theta : array_like
            Polar angle of the chief ray, radians.
        D : float
            Half the separation of camera and target, mm.
        """
        t = np.asarray(theta, float)
        centre = np.empty((*t.shape, 3))
        centre[:] = np.array([0.0, -D, 0.0]) + self.pupil_offset_mm
        centre[..., 2] += self.pupil_walk_mm * (t / (np.pi / 2)) ** 2
        return centre

    def relative_illumination(self, theta: ArrayLike) -> FloatArray:
        """V(theta) = 1 - vignetting (theta / 90 deg)^2."""
        return np.asarray(1 - self.vignetting * (np.asarray(theta, float) / (np.pi / 2)) ** 2)

    def _k(self) -> tuple[float, float, float, float]:
        return self.k if self.projection == "kannala_brandt" else (0.0, 0.0, 0.0, 0.0)

    def _polynomial(self, t: FloatArray) -> FloatArray:
        k1, k2, k3, k4 = self._k()
        q = t * t
        return 1 + q * (k1 + q * (k2 + q * (k3 + q * k4)))
