"""The tables of session.toml: every key with its unit, range and meaning.

Where a table is one of a session's own records it is that record (`gonio.metadata`). The figures
of the camera are those of one pixel of the files; `records` turns them into those of the session's
pixels.
"""

from __future__ import annotations

from itertools import pairwise

from pydantic import BaseModel, ConfigDict, Field, model_validator

from gonio.certificate import Kind, ListedBRDF, StandardTable
from gonio.metadata import Geometry, LampRecord, LensCalibration, Limits, Plan
from gonio.rig.raw import Plane

# How to measure a value that must be given, by table and key.
HOW_TO_MEASURE = {
    "camera.pitch_um": "it is the distance of two pixels in the camera's data sheet, in x and y",
    "camera.gain_dn_per_e": "take two frames of the white standard at one exposure that reaches "
    "about half of the saturation; with A - B their difference and M their mean over pixels of "
    "like brightness, the gain is var(A - B) / (2 (M - black_dn))",
    "camera.black_dn": "it is the mean count of a frame taken with the lens covered at the "
    "shortest exposure",
    "camera.saturation_dn": "it is the largest count of an overexposed frame, 4095 for a camera of "
    "12 bits",
    "camera.full_well_e": "it is (saturation_dn - black_dn) / gain_dn_per_e where the converter "
    "ends first, else the electrons at which the noise of ever brighter frames begins to fall",
    "camera.read_noise_e": "take two frames with the lens covered at the shortest exposure; it is "
    "the standard deviation of their difference over 1.414 and over gain_dn_per_e",
    "camera.dark_e_per_s": "take frames with the lens covered at two exposures; it is the "
    "difference of their means over gain_dn_per_e and over the difference of the exposures",
    "standard.reflectance": "it stands in the certificate of the standard",
    "standard.uncertainty": "it is the certificate's relative uncertainty over its coverage "
    "factor: 0.01 with k = 2 is 0.005",
    "geometry.R": "'gonio calibrate alignment' finds it from frames of a mirror and one length",
    "geometry.D": "it is half the distance from the lens's pupil to the target; 'gonio calibrate "
    "alignment' finds it from frames of a mirror",
    "lens.focal_length_mm": "'gonio calibrate lens' finds it from photographs of a board",
}


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class InstrumentTable(_Table):
    """Names that go into the session."""

    name: str = Field(
        min_length=1, max_length=200, description="name of the rig: its sessions have one"
    )
    sample: str = Field(min_length=1, max_length=200, description="name of the sample")


class CameraTable(_Table):
    """The camera: values of one pixel of the files, before region and binning of [frames]."""

    pitch_um: tuple[float, float] = Field(description="distance of the pixels in x and y, um")
    gain_dn_per_e: float = Field(gt=0, description="counts for an electron")
    black_dn: float | None = Field(
        default=None, ge=0, description="count without light; raw files may know it themselves"
    )
    saturation_dn: int | None = Field(
        default=None, gt=0, le=65535, description="largest count; raw files may know it themselves"
    )
    full_well_e: float = Field(gt=0, description="electrons at which a pixel is full")
    read_noise_e: float = Field(ge=0, description="sd of the read noise, e-")
    dark_e_per_s: float = Field(ge=0, description="dark current, e-/s")
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

    @model_validator(mode="after")
    def _possible(self) -> CameraTable:
        if min(self.pitch_um) <= 0:
            raise ValueError("pitch_um must be positive")
        if None not in (self.black_dn, self.saturation_dn) and self.black_dn >= self.saturation_dn:  # type: ignore[operator]
            raise ValueError(
                f"black_dn = {self.black_dn:g} must lie below saturation_dn = {self.saturation_dn}"
            )
        return self


class StandardRecord(_Table):
    """What the certificate of the white standard says.

    The number `reflectance` is of one `kind`, or `brdf` lists f. The shape over the directions is
    1 - rolloff (theta_r/75 deg)^4, and the same in theta_i if it is reciprocal, or `table`, or that
    of a model, which is tabulated when the frames are imported.
    """

    kind: Kind = Field(
        default="pi_f0",
        description="what is certified: pi_f0, total (8 deg/hemispherical), 0/45, or brdf_table",
    )
    reflectance: float | None = Field(
        default=None, gt=0, le=1.2, description="left out where a model or brdf is given"
    )
    uncertainty: float = Field(ge=0, description="relative standard uncertainty")
    rolloff: float | None = Field(
        default=None, ge=0, lt=1, description="loss at theta_r = 75 deg; 0 is Lambertian"
    )
    reciprocal: bool | None = Field(
        default=None, description="whether the same loss holds in theta_i"
    )
    rolloff_uncertainty: float = Field(default=0.0, ge=0, description="standard uncertainty of it")
    u_shape: float | None = Field(
        default=None,
        ge=0,
        lt=1,
        description="relative standard uncertainty of f at 75 deg against f at the normal, "
        "where nobody certified the shape",
    )
    brdf: ListedBRDF | None = Field(default=None, description="f at certified geometries")
    table: StandardTable | None = Field(default=None, description="f over reflectance/pi")
    model: str | None = Field(default=None, description="a model of 'gonio models', isotropic")
    parameters: dict[str, float] = Field(
        default={}, description="of the model, all of them, angles in degrees"
    )

    @model_validator(mode="after")
    def _one(self) -> StandardRecord:
        ways = {
            "rolloff": bool(self.rolloff),
            "table": self.table is not None,
            "model": self.model is not None,
            "brdf": self.brdf is not None,
        }
        given = [name for name, is_given in ways.items() if is_given]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} exclude each other; give one of them")
        if self.model is None and self.parameters:
            raise ValueError("parameters belong to a model; give model as well")
        if self.model is not None and self.reflectance is not None:
            raise ValueError("a model states the reflectance by its parameters; leave it out")
        if self.model is not None and self.kind != "pi_f0":
            raise ValueError("a model states f itself; leave kind out")
        return self


class RoleNames(_Table):
    """What {role} of the pattern stands for."""

    background: str = "background"
    standard: str = "standard"
    sample: str = "sample"
    background_of_standard: str | None = Field(
        default=None,
        description="where plan.standard_theta_i_deg is given: the standard's own background; as "
        "background where left out",
    )


class FramesTable(_Table):
    """Which file is which frame, and what is done to its counts."""

    pattern: str | None = Field(default=None, description="file name of a frame, with {fields}")
    pattern_of_background: str | None = Field(default=None, description="where it is another one")
    pattern_of_standard: str | None = Field(default=None, description="where it is another one")
    roles: RoleNames = RoleNames()
    csv: str | None = Field(default=None, description="table of all frames, in place of a pattern")
    counts_per_unit: float | None = Field(
        default=None, gt=0, description="float frames: counts that 1.0 stands for"
    )
    divide_by: int = Field(
        default=1,
        ge=1,
        le=4096,
        description="whole number that divides all counts: 16 for 12 bits at the upper end of 16",
    )
    plane: Plane | None = Field(
        default=None, description="raw files: the colour that is read; green sums both greens"
    )
    region_px: tuple[int, int, int, int] | None = Field(
        default=None, description="first column, first row, columns, rows that are kept"
    )
    binning: int = Field(
        default=1, ge=1, le=256, description="side of the block of pixels whose counts are summed"
    )

    @model_validator(mode="after")
    def _possible(self) -> FramesTable:
        if (self.pattern is None) == (self.csv is None):
            given = "neither" if self.pattern is None else "both"
            raise ValueError(f"give either pattern or csv; {given} was given")
        if self.csv is not None and (self.pattern_of_background or self.pattern_of_standard):
            raise ValueError("pattern_of_background and pattern_of_standard belong to a pattern")
        x, y, columns, rows = self.region_px or (0, 0, 1, 1)
        if min(x, y) < 0 or min(columns, rows) < 1:
            raise ValueError(
                "region_px must be first column, first row, columns and rows, none below 0"
            )
        return self


class SessionTable(_Table):
    """The whole of session.toml."""

    instrument: InstrumentTable
    geometry: Geometry
    lens: LensCalibration
    camera: CameraTable
    standard: StandardRecord
    lamp: LampRecord = LampRecord()
    limits: Limits = Limits()
    plan: Plan
    frames: FramesTable

    @model_validator(mode="after")
    def _plan_of_files(self) -> SessionTable:
        """What a plan of files needs beyond a plan: frames that a name can tell apart."""
        times = self.plan.exposures_s
        if min(times) <= 0 or any(b <= a for a, b in pairwise(times)):
            raise ValueError("plan.exposures_s must be positive and grow")
        for name in ("theta_i_deg", "rotations_deg"):
            values = getattr(self.plan, name)
            if len(set(values)) < len(values):
                raise ValueError(f"plan.{name} holds a value twice")
        return self
