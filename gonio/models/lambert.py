"""Lambert's ideal diffuse surface.

f = rho / pi

The same radiance in every direction; rho is the directional-hemispherical reflectance at any
incidence.
"""

from __future__ import annotations

import math

from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine


def kernel(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, rho: float
) -> tuple[float, float]:
    """f and df/drho."""
    return rho / math.pi, 1 / math.pi


MODEL = Model(
    name="lambert",
    title="Lambert",
    reference="Lambert, Photometria (1760)",
    parameters=(
        Parameter("rho", "ρ", "diffuse reflectance", 0.5, 0.0, 1.0, linear=True, start=(0.01, 1.0)),
    ),
    kernel=kernel,
    claims=Claims(isotropic=True, lambert_limit={}, albedo_at_most=("rho",)),
    validity="Exact for the ideal surface; no real surface keeps it at grazing angles.",
    lobes=(Cosine(share="rho"),),
)
