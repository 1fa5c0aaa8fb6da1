"""Minnaert's law of limb darkening.

f = rho (k + 1)/(2 pi) (cos theta_i cos theta_r)^(k - 1)

The directional albedo is rho cos(theta_i)^(k - 1), rho at normal incidence, and k = 1 is Lambert;
k > 1 darkens the limb, k < 1 brightens it. For k < 1 the albedo exceeds rho at oblique incidence
(1.23 rho at 60 deg for k = 0.7) and diverges at grazing: energy is not conserved. Directions
drawn as cos(theta_r)^k all have this albedo for their weight.

Losasso prints (N.L)(N.L)^k (1 - N.E)^(1-k), which is not reciprocal and is Lambert for no k; right
is (N.L)^k (N.E)^(k-1), with the N.L of the irradiance in it (docs/errata.md).
"""

from __future__ import annotations

import math

from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine


def kernel(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, rho: float, k: float
) -> tuple[float, float, float]:
    """f and its derivatives by rho and k."""
    c = zi * zr
    power = c ** (k - 1) / (2 * math.pi)
    by_rho = (k + 1) * power
    return rho * by_rho, by_rho, rho * power * (1 + (k + 1) * math.log(c))


MODEL = Model(
    name="minnaert",
    title="Minnaert",
    reference="Minnaert 1941; Losasso, Surface Reflection Models, as corrected",
    parameters=(
        Parameter("rho", "ρ", "albedo at normal incidence", 0.5, 0.0, 1.0, linear=True),
        Parameter("k", "k", "limb darkening", 1.0, 0.0, 3.0, start=(0.3, 2.0)),
    ),
    kernel=kernel,
    claims=Claims(isotropic=True, lambert_limit={"k": 1.0}),
    validity="Empirical, for theta up to about 70 deg; for k < 1 the albedo exceeds rho and "
    "diverges at grazing.",
    lobes=(Cosine(share="rho", k="k"),),
)
