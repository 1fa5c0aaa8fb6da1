"""Metadata of a session: the instrument, its frames and how they were taken.

Calibration reads these records. The simulator or the operator of a rig writes them. Unknown is None
and never 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from gonio.certificate import Certificate

SCHEMA = "gonio.session/1"

Role = Literal["background", "standard", "sample"]
ROLES: tuple[Role, ...] = ("background", "standard", "sample")
GEOMETRY_QUANTITIES = ("R", "D", "pupil_x", "pupil_y", "pupil_z", "camera_azimuth")
LENS_QUANTITIES = ("focal_length", "k1", "k2", "k3", "k4", "centre_x", "centre_y")


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Uncertain(_Record):
    """Covariance of some quantities of a calibration, in the units of their fields."""

    names: tuple[str, ...] = Field(min_length=1, description="the quantities, in this order")
    covariance: tuple[tuple[float, ...], ...] = Field(description="a row for each name")

    @model_validator(mode="after")
    def _square(self) -> Uncertain:
        n = len(self.names)
        if len(set(self.names)) < n:
            raise ValueError("names must differ")
        matrix = self.covariance
        if len(matrix) != n or any(len(row) != n for row in matrix):
            raise ValueError(f"covariance must have {n} rows of {n} numbers, as names has {n}")
        array = np.array(matrix)
        scale = np.sqrt(np.outer(array.diagonal(), array.diagonal()).clip(0))
        if (array.diagonal() < 0).any() or (abs(array - array.T) > 1e-9 * scale).any():
            raise ValueError("covariance must be symmetric with variances on its diagonal")
        return self


class Geometry(_Record):
    """The dome and the camera's position in it; lengths in mm, angles in degrees."""

    shape: Literal["sphere", "ellipsoid"]
    R: float = Field(gt=0, description="radius of the sphere, semi-minor axis of the ellipsoid")
    D: float = Field(gt=0, description="half the separation of camera and target")
    usable_theta_r_deg: float = Field(gt=0, le=90)
    pupil_mm: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="entrance pupil from its nominal position (0, -D, 0)"
    )
    pupil_walk_mm: float = Field(
        default=0.0, description="rise of the entrance pupil at 90 deg, as (theta/90 deg)^2"
    )
    camera_azimuth_deg: float = Field(
        default=0.0, description="turn of the camera about the normal, counter-clockwise"
    )
    uncertain: Uncertain | None = Field(
        default=None,
        description="of R, D, pupil_x, pupil_y, pupil_z (mm), camera_azimuth (deg); "
        "not given means unknown",
    )

    @model_validator(mode="after")
    def _known(self) -> Geometry:
        _check_names(self.uncertain, GEOMETRY_QUANTITIES)
        return self


class LensCalibration(_Record):
    """Pixel to angle: position on the sensor = pitch (pixel - centre), r = f(theta)."""

    projection: Literal["equidistant", "equisolid", "kannala_brandt"]
    focal_length_mm: float = Field(gt=0)
    k: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    field_deg: float = Field(default=180.0, gt=0, le=180)
    centre_px: tuple[float, float] | None = Field(
        default=None, description="column and row of the axis; the middle of the frame if not given"
    )
    uncertain: Uncertain | None = Field(
        default=None,
        description="of focal_length (mm), k1 to k4, centre_x, centre_y (px); "
        "not given means unknown",
    )

    @model_validator(mode="after")
    def _known(self) -> LensCalibration:
        _check_names(self.uncertain, LENS_QUANTITIES)
        return self


class Camera(_Record):
    """The frames' pixels; all values are of binned pixels, as the counts in the frames are."""

    rows: int = Field(gt=0)
    columns: int = Field(gt=0)
    pitch_mm: tuple[float, float]
    gain_dn_per_e: float = Field(gt=0)
    black_dn: float = Field(ge=0)
    saturation_dn: int = Field(gt=0, le=65535)
    full_well_e: float = Field(gt=0)
    noise_dn: float = Field(ge=0)
    dark_e_per_s: float = Field(ge=0)
    gamma: float = Field(
        default=1.0,
        gt=0.2,
        le=2,
        description="response: counts above black are gain full_well (e-/full_well)^gamma",
    )
    nonlinearity_per_decade: float = Field(
        default=0.0,
        ge=-0.05,
        le=0.05,
        description="what is left of a nonlinearity, for which the reduction corrects: counts "
        "above black are further times 1 + nonlinearity_per_decade log10(e-/full_well)",
    )
    u_nonlinearity_per_decade: float | None = Field(
        default=None,
        ge=0,
        le=0.05,
        description="standard uncertainty of it; not given means unknown",
    )


class LampRecord(_Record):
    """What is known of the lamp; None is unknown."""

    half_angle_deg: float | None = Field(default=None, ge=0)
    u_half_angle_deg: float | None = Field(
        default=None, ge=0, description="standard uncertainty of the half-angle"
    )
    drift: float | None = Field(
        default=None, ge=0, description="relative sd of the output, image to image"
    )


class Limits(_Record):
    """Influence quantities of instrument, room and sample holder; None is unknown."""

    slope_error_deg: float | None = Field(
        default=None, ge=0, description="sd of the dome's surface slope"
    )
    rim_slope_error_deg: float | None = Field(
        default=None, ge=0, description="added to it at the rim, as (theta/90 deg)^6"
    )
    slope_correlation_deg: float = Field(
        default=10.0, gt=0, description="correlation length of the slope errors"
    )
    multibounce: float | None = Field(
        default=None, ge=0, description="estimate of g: the irradiance grows by 1 + g albedo"
    )
    u_multibounce: float | None = Field(
        default=None,
        ge=0,
        description="standard uncertainty of g; where it is given the reduction corrects by g",
    )
    transmittance: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="T_d of the dome where the lamp shines in; a standard in reflection is lit "
        "through it, a sample in transmission is not",
    )
    ambient: float | None = Field(
        default=None,
        ge=0,
        description="estimate of the room light on the sample, as a fraction of the lamp's "
        "irradiance at normal incidence; frames without a sample do not hold it",
    )
    u_azimuth_deg: float | None = Field(
        default=None,
        ge=0,
        le=45,
        description="standard uncertainty of the azimuth at which the sample lies: the zero of "
        "its rotation",
    )


class Channel(_Record):
    """A colour filter before lamp or camera."""

    name: str = ""
    wavelength_nm: float | None = Field(default=None, gt=0)


class Plan(_Record):
    """Which frames are taken: angles in degrees, exposures in seconds.

    Background and standard are taken at every incidence of the sample. With `standard_theta_i_deg`
    the standard is taken at that one only, and the backgrounds are one more: the last belongs to
    the standard. In transmission it alone is taken with the lamp above, the others with the lamp
    below and its way closed. A session of a mirror has no standard.
    """

    theta_i_deg: tuple[float, ...] = Field(
        min_length=1, description="0 to 90; below 0, the lamp at azimuth 180 deg, for a mirror only"
    )
    rotations_deg: tuple[float, ...] = Field(min_length=1)
    exposures_s: tuple[float, ...] = Field(min_length=1)
    repeats: int = Field(default=1, ge=1, description="takes of each background and standard frame")
    channels: tuple[Channel, ...] = Field(default=(Channel(),), min_length=1, max_length=100)
    mode: Literal["reflection", "transmission", "mirror"] = Field(
        default="reflection",
        description="transmission: the lamp stands below the sample; mirror: a plane mirror lies "
        "in its place and shows where the pixels look",
    )
    wedge_deg: float = Field(
        default=0.0,
        ge=0,
        lt=45,
        description="tilt of the mirror's normal, towards the azimuth of its rotation",
    )
    standard_theta_i_deg: float | None = Field(
        default=None,
        description="the one incidence at which the standard was taken; every one if not given",
    )
    u_irradiance: float | None = Field(
        default=None,
        ge=0,
        description="relative standard uncertainty of the irradiance computed for another "
        "incidence than the standard's",
    )

    @model_validator(mode="after")
    def _distinct(self) -> Plan:
        names = [channel.name for channel in self.channels]
        if len(set(names)) < len(names):
            raise ValueError("channels must have different names")
        return self

    @model_validator(mode="after")
    def _possible(self) -> Plan:
        lowest = -90 if self.mode == "mirror" else 0
        standard = () if self.standard_theta_i_deg is None else (self.standard_theta_i_deg,)
        for angle in (*self.theta_i_deg, *standard):
            if not lowest <= angle <= 90:
                raise ValueError(f"theta_i = {angle:g} deg must lie in {lowest} to 90 deg")
        if self.mode == "transmission" and not standard:
            raise ValueError(
                "transmission needs standard_theta_i_deg, the incidence of the standard, which is "
                "taken in reflection"
            )
        if self.mode == "mirror" and standard:
            raise ValueError("a session of a mirror has no standard")
        if self.mode != "mirror" and self.wedge_deg:
            raise ValueError("wedge_deg belongs to a session of a mirror")
        return self

    @property
    def roles(self) -> tuple[Role, ...]:
        """Roles that have frames, in the order in which they are taken."""
        return tuple(role for role in ROLES if self.takes(role))

    def takes(self, role: str) -> int:
        """Rotations for the sample, repeats for background and standard."""
        if role == "standard" and self.mode == "mirror":
            return 0
        return len(self.rotations_deg) if role == "sample" else self.repeats

    def incidences(self, role: str) -> tuple[float, ...]:
        """Angles of the lamp, degrees, at which the images of a role are taken.

        Examples
        --------
        >>> at_45 = Plan(theta_i_deg=(0, 30, 60), rotations_deg=(0,), exposures_s=(0.01,),
        ...              standard_theta_i_deg=45)
        >>> at_45.incidences("standard"), at_45.incidences("background")
        ((45.0,), (0.0, 30.0, 60.0, 45.0))
        """
        if self.standard_theta_i_deg is None or role == "sample":
            return self.theta_i_deg
        own = (self.standard_theta_i_deg,)
        return own if role == "standard" else self.theta_i_deg + own

    def images(self) -> Iterator[tuple[Role, int, int]]:
        """(role, take, incidence) in the order in which they are taken, each in every channel."""
        for role in ROLES:
            for take in range(self.takes(role)):
                for incidence in range(len(self.incidences(role))):
                    yield role, take, incidence

    @property
    def n_images(self) -> int:
        """Number of images of a complete session; each has a frame a channel and exposure."""
        return sum(self.takes(role) * len(self.incidences(role)) for role in ROLES)

    @property
    def n_frames(self) -> int:
        """Number of frames of a complete session."""
        return self.n_images * len(self.exposures_s) * len(self.channels)


class Metadata(_Record):
    """Everything that calibration uses, of a simulated instrument or of a real rig."""

    schema_: str = Field(default=SCHEMA, alias="schema")
    instrument: str
    sample: str = Field(description="name of the sample, as the operator wrote it")
    geometry: Geometry
    lens: LensCalibration
    camera: Camera
    standard: Certificate
    lamp: LampRecord
    limits: Limits = Limits()
    plan: Plan
    rig: str | None = Field(
        default=None,
        description="identity of the rig: sessions that state the same one have one dome, one "
        "camera and one lens",
    )
    fingerprint: str = Field(
        default="", description="hash of what made the session; resuming checks it"
    )


def _check_names(uncertain: Uncertain | None, known: tuple[str, ...]) -> None:
    for name in uncertain.names if uncertain else ():
        if name not in known:
            raise ValueError(f"uncertain names {name!r}; known are {', '.join(known)}")
