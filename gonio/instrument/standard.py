"""The white standard: its certificate and its true properties."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from gonio.certificate import Certificate, Kind, ListedBRDF
from gonio.geometry import FloatArray
from gonio.instrument.part import Part
from gonio.instrument.standard_shape import TrueShape

_LIST_SEED = 1  # beside the standard's seed: errors of a certified list


class Standard(Part):
    """A diffuse standard with f = f(0) (1 - rolloff (theta_r/75 deg)^4) and a drawn departure."""

    kind: Kind = Field(
        default="pi_f0",
        description="what is certified: pi_f0 is pi f at the normal; total the 8 deg/hemispherical "
        "reflectance; 0/45 the reflectance factor; brdf_table f at listed_deg",
    )
    reflectance: float = Field(
        gt=0, le=1, description="certified number of that kind; pi f at the normal for brdf_table"
    )
    uncertainty: float = Field(
        ge=0, lt=0.5, description="relative standard uncertainty of the reflectance"
    )
    rolloff: float = Field(
        default=0.0,
        ge=0,
        lt=0.4,
        description="loss at theta_r = 75 deg; 0 is a Lambertian standard",
    )
    reciprocal: bool = Field(
        default=False,
        description="whether the loss holds in theta_i as well, as in every real standard",
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
    u_shape: float | None = Field(
        default=None,
        ge=0,
        lt=0.4,
        description="what the laboratory takes for the relative standard uncertainty of f at 75 "
        "deg where nobody certified the shape; unknown if left out",
    )
    shape_sd: float = Field(
        default=0.0,
        ge=0,
        lt=0.4,
        description="relative standard deviation at 75 deg of the true departure from the rolloff, "
        "which `seed` draws and nobody knows",
    )
    seed: int = Field(default=0, ge=0, lt=2**63, description="of the standard that was bought")
    listed_deg: tuple[tuple[float, float, float], ...] = Field(
        default=(), description="theta_i, theta_r, dphi at which f is certified, for brdf_table"
    )
    u_listed: float = Field(
        default=0.0,
        ge=0,
        lt=0.5,
        description="relative standard uncertainty of each listed f for itself",
    )

    @model_validator(mode="after")
    def _listed(self) -> Standard:
        if (self.kind == "brdf_table") != bool(self.listed_deg):
            raise ValueError("kind brdf_table needs listed_deg, and no other kind has it")
        if self.rolloff_uncertainty and self.u_shape:
            raise ValueError("give either rolloff_uncertainty or u_shape")
        return self

    @cached_property
    def shape(self) -> TrueShape:
        """The true shape."""
        return TrueShape.drawn(self.rolloff, self.reciprocal, self.shape_sd, self.seed)

    def brdf(self, theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike) -> FloatArray:
        """True f in sr^-1 where the certified number is exact; angles in radians."""
        f_0 = self.reflectance / np.pi / self.shape.certified_mean(self.kind)
        return np.asarray(f_0 * self.shape.factor(theta_i, theta_r, dphi))

    def even_light(self, theta_r: FloatArray) -> FloatArray:
        """Hemispherical-directional reflectance, interpolated over theta_r in radians."""
        if not self.shape.depends_on_incidence:
            return np.asarray(np.pi * self.brdf(0.0, theta_r, 0.0))
        nodes = np.radians(np.linspace(0, 89, 30))
        albedos = np.array([self.shape.albedo(float(theta)) for theta in nodes])
        f_0 = self.brdf(0.0, 0.0, 0.0)
        return np.asarray(np.pi * f_0 * np.interp(theta_r, nodes, albedos))

    def certificate(self) -> Certificate:
        """What the laboratory knows: nothing of the drawn shape but what the certificate states."""
        if self.kind == "brdf_table":
            return Certificate(
                kind=self.kind,
                uncertainty=self.uncertainty,
                u_shape=self.u_shape,
                brdf=self._certified_list(),
            )
        stated = self.rolloff_certified
        # What is taken for an uncertified rolloff is 0, if its uncertainty is stated.
        assumed = 0.0 if self.rolloff_uncertainty else None
        return Certificate(
            kind=self.kind,
            reflectance=self.reflectance,
            uncertainty=self.uncertainty,
            rolloff=self.rolloff if stated else assumed,
            reciprocal=self.reciprocal if stated else None,
            rolloff_uncertainty=self.rolloff_uncertainty,
            u_shape=self.u_shape,
        )

    def _certified_list(self) -> ListedBRDF:
        theta_i, theta_r, dphi = np.array(self.listed_deg).T
        rng = np.random.default_rng((self.seed, _LIST_SEED))
        error = 1 + self.u_listed * rng.standard_normal(len(theta_i))
        f = self.brdf(*np.radians([theta_i, theta_r, dphi])) * error
        return ListedBRDF(
            theta_i_deg=tuple(theta_i.tolist()),
            theta_r_deg=tuple(theta_r.tolist()),
            dphi_deg=tuple(dphi.tolist()),
            brdf=tuple(f.tolist()),
            u_brdf=tuple((self.u_listed * f).tolist()),
        )
