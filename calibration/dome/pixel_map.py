"""From pixels to the directions that they see, with the geometry that a session states.

This module alone puts lens, camera, pupil and dome together: image centre and turn of the camera,
a pupil that is displaced and that rises with the angle as a fisheye's does, and the reflection by
Ward's eq. (3) or exactly.
"""

from __future__ import annotations

from collections.abc import Mapping as Table
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from gonio.calibration import reflector
from gonio.calibration.lens import projection as optics
from gonio.calibration.reflector import Mapping
from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, angles, unit_vectors
from gonio.metadata import (
    LENS_QUANTITIES,
    Camera,
    Geometry,
    LensCalibration,
    Metadata,
    Uncertain,
)

MAPPINGS: tuple[Mapping, ...] = get_args(Mapping)
_NEWTON = 30
# Fields of the quantities that are not a field of their own name.
_FIELDS = {
    "pupil_x": "pupil_mm",
    "pupil_y": "pupil_mm",
    "pupil_z": "pupil_mm",
    "camera_azimuth": "camera_azimuth_deg",
    "focal_length": "focal_length_mm",
    "centre_x": "centre_px",
    "centre_y": "centre_px",
}
_NEGLIGIBLE = 1e-6  # share of the mean square shift that modes left out may have together


@dataclass(frozen=True)
class PixelMap:
    """Directions that the pixels of a camera see, in the frame of the laboratory.

    Parameters
    ----------
    camera : Camera
    lens : LensCalibration
    geometry : Geometry
    mapping : {"eq3", "exact"}
        Ward's eq. (3), or the law of reflection on the dome's shape.
    uncertain : mapping of str to Uncertain
        Covariances of quantities of geometry and lens, if they are known. Those of two names are
        independent of each other.

    Raises
    ------
    ConfigurationError
        For another mapping, or a pupil outside the dome.

    Examples
    --------
    The middle of the frame looks up; the dome turns that to the far side of the target:

    >>> camera = Camera(rows=101, columns=101, pitch_mm=(0.05, 0.05), gain_dn_per_e=1, black_dn=0,
    ...     saturation_dn=255, full_well_e=255, noise_dn=1, dark_e_per_s=0)
    >>> lens = LensCalibration(projection="equidistant", focal_length_mm=1.8)
    >>> dome = Geometry(shape="ellipsoid", R=150.0, D=15.0, usable_theta_r_deg=80)
    >>> np.round(PixelMap(camera, lens, dome).directions(50, 50), 4).tolist()
    [0.0, -0.1971, 0.9804]
    """

    camera: Camera
    lens: LensCalibration
    geometry: Geometry
    mapping: Mapping = "eq3"
    uncertain: Table[str, Uncertain] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.mapping not in MAPPINGS:
            raise ConfigurationError(
                f"mapping {self.mapping!r} is unknown; allowed are {', '.join(MAPPINGS)}.",
                value=self.mapping,
            )
        x, y, z = np.abs(self._pupil(np.array(0.0)))
        corner = np.linalg.norm([x, y, z + abs(self._walk)])
        if not corner < self.geometry.R:
            raise ConfigurationError(
                f"the pupil lies {corner:.4g} mm from the dome's centre and R is "
                f"{self.geometry.R:g} mm: the camera must sit inside the dome.",
                value=float(corner),
            )

    @classmethod
    def of(
        cls,
        metadata: Metadata,
        mapping: Mapping = "eq3",
        uncertain_geometry: Uncertain | None = None,
    ) -> PixelMap:
        """The map of a session.

        Parameters
        ----------
        metadata : Metadata
        mapping : {"eq3", "exact"}
        uncertain_geometry : Uncertain, optional
            In place of the covariance that the session states.
        """
        stated = {
            "geometry": uncertain_geometry or metadata.geometry.uncertain,
            "lens": metadata.lens.uncertain,
        }
        uncertain = {name: record for name, record in stated.items() if record is not None}
        return cls(metadata.camera, metadata.lens, metadata.geometry, mapping, uncertain)

    def directions(self, columns: ArrayLike, rows: ArrayLike) -> FloatArray:
        """Unit vectors (..., 3) from the sample that (fractional) pixels see.

        NaN outside the image circle. Whole numbers are the pixels' centres.
        """
        theta_c, phi_c = self._camera_angles(columns, rows)
        pupil, w_c = self._pupil(theta_c), unit_vectors(theta_c, phi_c)
        return self._reflected(pupil, w_c, ())[0]

    def solid_angles(self, columns: ArrayLike, rows: ArrayLike) -> FloatArray:
        """Solid angles of pixels on the side of the sample, sr; NaN outside the image circle.

        The lens's sin(theta)/(r dr/dtheta) times the Jacobian of the reflection, both analytic.
        """
        theta_c, phi_c = self._camera_angles(columns, rows)
        _, (d_theta, d_phi) = self._along_tangents(theta_c, phi_c)
        ratio = np.linalg.norm(np.cross(d_theta, d_phi), axis=-1)
        return np.asarray(ratio * self.camera_solid_angles(columns, rows))

    def camera_solid_angles(self, columns: ArrayLike, rows: ArrayLike) -> FloatArray:
        """Solid angles of pixels on the side of the camera, sr: what its light is in proportion to.

        NaN outside the image circle.
        """
        theta_c, _ = self._camera_angles(columns, rows)
        area = self.camera.pitch_mm[0] * self.camera.pitch_mm[1]
        return area * optics.solid_angle_per_area(self.lens, theta_c)

    def pixels(self, w_r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fractional columns and rows that see directions (..., 3): the inverse of `directions`.

        Newton's method on the tangent plane of the camera's directions, from the inverse of
        eq. (3). NaN where it does not converge. A direction that the lens or the frame does not
        reach has a position too, outside of them.
        """
        geometry = self.geometry
        w_r = np.asarray(w_r, float)
        theta_c, phi_c = reflector.camera_angles(*angles(w_r), R=geometry.R, D=geometry.D)
        for _ in range(_NEWTON):
            w_now, (d_theta, d_phi) = self._along_tangents(theta_c, phi_c)
            # Two unknowns, three components of which the one along w_r is zero to first order.
            a, b = _solved(d_theta, d_phi, w_r - w_now)
            w_c = unit_vectors(theta_c, phi_c)
            e_theta, e_phi = _tangents(theta_c, phi_c)
            theta_c, phi_c = angles(w_c + a[..., None] * e_theta + b[..., None] * e_phi)
            step = np.hypot(a, b)
            if np.all(step < 1e-10):  # the next one is of the order of its square
                break
        theta_c = np.where(step < 1e-10, theta_c, np.nan)
        r = optics.sensor_radius(self.lens, theta_c)
        phi = phi_c - np.radians(geometry.camera_azimuth_deg)
        centre, pitch = optics.image_centre(self.camera, self.lens), self.camera.pitch_mm
        return centre[0] + r * np.cos(phi) / pitch[0], centre[1] + r * np.sin(phi) / pitch[1]

    def landing_mm(self, columns: ArrayLike, rows: ArrayLike) -> FloatArray:
        """Where the chief rays of pixels land on the sample (..., 2), mm from the target."""
        theta_c, phi_c = self._camera_angles(columns, rows)
        geometry = self.geometry
        return reflector.landing_points(
            self._pupil(theta_c),
            unit_vectors(theta_c, phi_c),
            R=geometry.R,
            D=geometry.D,
            shape=geometry.shape,
        )

    def quantity(self, name: str) -> float:
        """A quantity of the calibration by its name in `gonio.metadata`: mm, deg, px.

        Parameters
        ----------
        name : str
            One of GEOMETRY_QUANTITIES or LENS_QUANTITIES.
        """
        lens, geometry = self.lens, self.geometry
        if name in LENS_QUANTITIES:
            if name.startswith("centre_"):
                return optics.image_centre(self.camera, lens)["xy".index(name[-1])]
            return lens.focal_length_mm if name == "focal_length" else lens.k[int(name[1:]) - 1]
        if name.startswith("pupil_"):
            return geometry.pupil_mm["xyz".index(name[-1])]
        return float(getattr(geometry, _FIELDS.get(name, name)))

    def changed(self, name: str, step: float) -> PixelMap:
        """The map with one quantity of its calibration changed.

        Parameters
        ----------
        name : str
            One of GEOMETRY_QUANTITIES or LENS_QUANTITIES.
        step : float
            Added to the quantity, in its unit.
        """
        value: object = self.quantity(name) + step
        if name.startswith("centre_"):
            centre = optics.image_centre(self.camera, self.lens)
            value = _replaced(centre, "xy".index(name[-1]), value)
        elif name.startswith("pupil_"):
            value = _replaced(self.geometry.pupil_mm, "xyz".index(name[-1]), value)
        elif name.startswith("k"):
            value = _replaced(self.lens.k, int(name[1:]) - 1, value)
        if name in LENS_QUANTITIES:
            key = "k" if name.startswith("k") else _FIELDS[name]
            return replace(self, lens=self.lens.model_copy(update={key: value}))
        key = _FIELDS.get(name, name)
        return replace(self, geometry=self.geometry.model_copy(update={key: value}))

    def describe(self) -> str:
        """One line for the history of a reduction."""
        geometry, lens = self.geometry, self.lens
        how = {"eq3": "eq. (3)", "exact": "exact law of reflection"}[self.mapping]
        parts = [f"{how} with R = {geometry.R:g} mm, D = {geometry.D:g} mm ({geometry.shape})"]
        if any(geometry.pupil_mm):
            shift = ", ".join(f"{x:g}" for x in geometry.pupil_mm)
            parts.append(f"pupil displaced by ({shift}) mm")
        if self._walk:
            parts.append(f"pupil rising {self._walk:g} mm to the rim")
        if geometry.camera_azimuth_deg:
            parts.append(f"camera turned by {geometry.camera_azimuth_deg:g} deg")
        if lens.centre_px is not None:
            parts.append(f"image centre at ({lens.centre_px[0]:g}, {lens.centre_px[1]:g}) px")
        return ", ".join(parts)

    @property
    def _walk(self) -> float:
        return self.geometry.pupil_walk_mm

    def _camera_angles(self, columns: ArrayLike, rows: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Polar angle and azimuth of the chief rays in the frame of the laboratory."""
        x, y = optics.pixel_positions(self.camera, columns, rows, self.lens)
        theta_c, phi_c = optics.camera_angles(self.lens, x, y)
        return theta_c, phi_c + np.radians(self.geometry.camera_azimuth_deg)

    def _along_tangents(
        self, theta_c: FloatArray, phi_c: FloatArray
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Directions, and their changes along the two tangents of the camera's direction."""
        e_theta, e_phi = _tangents(theta_c, phi_c)
        rise = np.zeros((*np.shape(theta_c), 3))
        rise[..., 2] = self._walk * 2 * theta_c / (np.pi / 2) ** 2
        return self._reflected(
            self._pupil(theta_c),
            unit_vectors(theta_c, phi_c),
            ((rise, e_theta), (np.zeros(3), e_phi)),
        )

    def _pupil(self, theta_c: FloatArray) -> FloatArray:
        """Entrance pupil (..., 3) of chief rays, mm from the dome's centre."""
        pupil = np.empty((*theta_c.shape, 3))
        pupil[:] = self.geometry.pupil_mm
        pupil[..., 1] -= self.geometry.D
        pupil[..., 2] += self._walk * (theta_c / (np.pi / 2)) ** 2
        return pupil

    def _reflected(
        self,
        pupil: FloatArray,
        w_c: FloatArray,
        changes: tuple[tuple[FloatArray, FloatArray], ...],
    ) -> tuple[FloatArray, list[FloatArray]]:
        geometry = self.geometry
        return reflector.reflected_directions(
            pupil,
            w_c,
            changes,
            R=geometry.R,
            D=geometry.D,
            shape=geometry.shape,
            mapping=self.mapping,
        )


@dataclass(frozen=True)
class Mode:
    """One independent error of the geometry.

    Parameters
    ----------
    shift : ndarray, shape (..., 3)
        Change of the directions for one standard deviation, tangent vectors in radians.
    quantities : tuple of str
        The quantities that take part, the strongest first.
    """

    shift: FloatArray
    quantities: tuple[str, ...]


def left_out(pixel_map: PixelMap, columns: ArrayLike, rows: ArrayLike) -> FloatArray:
    """Error of eq. (3) at pixels: exact direction minus that of eq. (3), (..., 3), radians.

    Tangent to the direction by eq. (3).
    """
    by_eq_3 = replace(pixel_map, mapping="eq3").directions(columns, rows)
    exact = replace(pixel_map, mapping="exact").directions(columns, rows)
    return across(exact - by_eq_3, by_eq_3)


def error_modes(
    pixel_map: PixelMap, uncertain: Uncertain, columns: ArrayLike, rows: ArrayLike
) -> list[Mode]:
    """Independent errors of directions from the covariance of the calibration.

    Parameters
    ----------
    pixel_map : PixelMap
    uncertain : Uncertain
        Of the geometry or of the lens.
    columns, rows : array_like, shape (N,)
        The pixels at which the errors are wanted.

    Returns
    -------
    list of Mode
        The largest first. Modes that together hold less than 1e-6 of the mean square are left
        out.

    Notes
    -----
    With the derivatives A of the directions by the quantities (central differences of one standard
    deviation) and any factor L L^T of their covariance, the columns of A L are independent errors.
    They are turned to the principal axes of (A L)^T (A L), so that the result does not depend on
    the units of the quantities, and a few modes suffice.
    """
    covariance = np.array(uncertain.covariance)
    sd = np.sqrt(covariance.diagonal())
    names = [name for name, s in zip(uncertain.names, sd, strict=True) if s > 0]
    if not names:
        return []
    covariance, sd = covariance[np.ix_(sd > 0, sd > 0)], sd[sd > 0]
    w_r = pixel_map.directions(columns, rows)
    unit = np.stack([_by_one_sd(pixel_map, *f, columns, rows) for f in zip(names, sd, strict=True)])
    values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
    factor = vectors * np.sqrt(values.clip(0))
    moved = np.einsum("jni,jm->mni", unit, factor)
    size, turn = np.linalg.eigh(np.einsum("kni,mni->km", moved, moved))
    modes = []
    for m in np.argsort(size)[::-1]:
        if size[: m + 1].clip(0).sum() <= _NEGLIGIBLE * size.sum():
            break
        share = np.abs(factor @ turn[:, m]) * np.sqrt(np.einsum("jni,jni->j", unit, unit))
        strongest = [names[j] for j in np.argsort(share)[::-1] if share[j] > 0.3 * share.max()]
        shift = np.einsum("m,mni->ni", turn[:, m], moved)
        modes.append(Mode(across(shift, w_r), tuple(strongest)))
    return modes


def _by_one_sd(
    pixel_map: PixelMap, name: str, sd: float, columns: ArrayLike, rows: ArrayLike
) -> FloatArray:
    """Change of the directions for one standard deviation of one quantity."""
    up = pixel_map.changed(name, sd).directions(columns, rows)
    down = pixel_map.changed(name, -sd).directions(columns, rows)
    return (up - down) / 2


def _tangents(theta: FloatArray, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors of growing theta and of growing phi."""
    return unit_vectors(theta + np.pi / 2, phi), unit_vectors(np.pi / 2, phi + np.pi / 2)


def _solved(d_1: FloatArray, d_2: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least-squares a, b of a d_1 + b d_2 = wanted, all of shape (..., 3)."""

    def dot(u: FloatArray, v: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("...i,...i->...", u, v))

    p, q, r = dot(d_1, d_1), dot(d_1, d_2), dot(d_2, d_2)
    x, y = dot(d_1, wanted), dot(d_2, wanted)
    det = p * r - q * q
    return (r * x - q * y) / det, (p * y - q * x) / det


def across(change: FloatArray, w: FloatArray) -> FloatArray:
    """The part of changes (..., 3) at right angles to unit vectors (..., 3)."""
    return np.asarray(change - np.einsum("...i,...i->...", change, w)[..., None] * w)


def _replaced(values: tuple[float, ...], index: int, value: object) -> tuple[object, ...]:
    return tuple(value if k == index else v for k, v in enumerate(values))
