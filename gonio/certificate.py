"""What is known of the white standard: what its certificate states, and what nobody certified.

Unknown is None and never 0.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Kind = Literal["pi_f0", "total", "0/45", "brdf_table"]
TOTAL_AT_DEG = 8.0  # incidence of the total reflectance, 8 deg/hemispherical
FACTOR_AT_DEG = (0.0, 45.0)  # incidence and viewing direction of the factor 0/45
SHAPE_AT_DEG = 75.0  # polar angle at which rolloff and u_shape are stated
KIND_WORDS = {
    "pi_f0": "pi f(0 deg)",
    "total": "total reflectance, 8 deg/hemispherical",
    "0/45": "reflectance factor 0/45",
    "brdf_table": "BRDF at listed geometries",
}


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class StandardTable(_Record):
    """f of the standard over its reflectance/pi, on a grid of directions.

    Linear interpolation; outside the grid the nearest value holds. A grid with one theta_i holds
    for every incidence, one with one dphi for every azimuth.
    """

    theta_i_deg: tuple[float, ...] = Field(min_length=1, max_length=1000)
    theta_r_deg: tuple[float, ...] = Field(min_length=1, max_length=1000)
    dphi_deg: tuple[float, ...] = Field(
        default=(0.0,), min_length=1, max_length=1000, description="phi_r - phi_i, 0 to 180"
    )
    factor: tuple[tuple[tuple[float, ...], ...], ...] = Field(
        description="factor[theta_i][theta_r][dphi]"
    )

    @model_validator(mode="after")
    def _complete(self) -> StandardTable:
        axes = {
            "theta_i_deg": (self.theta_i_deg, 90),
            "theta_r_deg": (self.theta_r_deg, 90),
            "dphi_deg": (self.dphi_deg, 180),
        }
        for name, (axis, end) in axes.items():
            if any(b <= a for a, b in pairwise(axis)):
                raise ValueError(f"{name} must grow")
            if axis[0] < 0 or axis[-1] > end:
                raise ValueError(f"{name} must lie in 0 to {end}")
        shape = tuple(len(axis) for axis, _ in axes.values())
        inner = {len(row) for page in self.factor for row in page}
        given = (len(self.factor), {len(page) for page in self.factor}, inner)
        if given != (shape[0], {shape[1]}, {shape[2]}):
            raise ValueError(f"factor must have the shape {shape} of the three axes")
        if min(min(row) for page in self.factor for row in page) <= 0:
            raise ValueError("factor must be positive")
        return self


class ListedBRDF(_Record):
    """f of the standard as certified at some geometries."""

    theta_i_deg: tuple[float, ...] = Field(min_length=1, max_length=2000)
    theta_r_deg: tuple[float, ...]
    dphi_deg: tuple[float, ...] = Field(description="phi_r - phi_i, -360 to 360")
    brdf: tuple[float, ...] = Field(description="f, sr^-1")
    u_brdf: tuple[float, ...] = Field(
        description="standard uncertainty of f, sr^-1, that the values do not share"
    )

    @model_validator(mode="after")
    def _possible(self) -> ListedBRDF:
        lengths = {name: len(getattr(self, name)) for name in type(self).model_fields}
        if len(set(lengths.values())) > 1:
            given = ", ".join(f"{name} has {n}" for name, n in lengths.items())
            raise ValueError(f"the lists must have one value for each geometry; {given}")
        for name in ("theta_i_deg", "theta_r_deg"):
            if not all(0 <= angle < 90 for angle in getattr(self, name)):
                raise ValueError(f"{name} must lie in 0 to 90, without 90")
        if not all(abs(angle) <= 360 for angle in self.dphi_deg):
            raise ValueError("dphi_deg must lie in -360 to 360")
        if min(self.brdf) <= 0:
            raise ValueError("brdf must be positive")
        if not all(0 <= u < f for u, f in zip(self.u_brdf, self.brdf, strict=True)):
            raise ValueError("u_brdf must be at least 0 and smaller than brdf")
        return self


class Certificate(_Record):
    """What is known of the white standard.

    The certified number is a reflectance of a `kind`, or the list `brdf`. The shape of f over the
    directions is 1 - rolloff (theta_r/75 deg)^4, times the same in theta_i if it is `reciprocal`,
    or `table`. A shape that neither states is unknown: values are computed as if f were the same
    in all directions. `u_shape` states how much it may depart from that.
    """

    kind: Kind = Field(
        default="pi_f0",
        description="what is certified: pi_f0 is pi f at the normal; total the 8 deg/hemispherical "
        "reflectance; 0/45 the reflectance factor; brdf_table the list brdf",
    )
    reflectance: float | None = Field(
        default=None, gt=0, le=1.2, description="the certified number; none for brdf_table"
    )
    uncertainty: float = Field(
        ge=0, description="relative standard uncertainty that all directions share"
    )
    rolloff: float | None = Field(
        default=None, ge=0, lt=1, description="loss at theta_r = 75 deg; 0 is Lambertian"
    )
    reciprocal: bool | None = Field(
        default=None,
        description="whether the same loss holds in theta_i, as reciprocity demands",
    )
    rolloff_uncertainty: float = Field(
        default=0.0, ge=0, description="standard uncertainty of the rolloff"
    )
    u_shape: float | None = Field(
        default=None,
        ge=0,
        lt=1,
        description="relative standard uncertainty of f at 75 deg against f at the normal, "
        "where nobody certified the shape",
    )
    table: StandardTable | None = None
    brdf: ListedBRDF | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_0_1(cls, given: Any) -> Any:
        """A rolloff of 0 in a file of version 0.1 says that nobody stated one."""
        if not isinstance(given, dict) or "kind" in given:
            return given
        if given.get("rolloff") == 0 and not given.get("rolloff_uncertainty"):
            return {name: value for name, value in given.items() if name != "rolloff"}
        return given

    @model_validator(mode="after")
    def _one(self) -> Certificate:
        if self.rolloff and self.table is not None:
            raise ValueError("give either rolloff or table")
        if self.rolloff_uncertainty and self.u_shape:
            raise ValueError("give either rolloff_uncertainty or u_shape")
        if (self.kind == "brdf_table") != (self.brdf is not None):
            raise ValueError("kind brdf_table needs the list brdf, and no other kind has one")
        if self.brdf is not None and (self.rolloff is not None or self.table is not None):
            raise ValueError("the list brdf states f; leave rolloff and table out")
        if (self.reflectance is None) != (self.brdf is not None):
            raise ValueError("give either reflectance or, with kind brdf_table, the list brdf")
        if self.kind == "total" and self.reflectance is not None and self.reflectance > 1:
            raise ValueError(
                f"reflectance = {self.reflectance:g}: a total reflectance is at most 1"
            )
        return self

    @property
    def shape_is_certified(self) -> bool:
        """Whether the shape over the whole hemisphere is stated: a rolloff, or a table."""
        return self.rolloff is not None or self.table is not None or self.rolloff_uncertainty > 0
