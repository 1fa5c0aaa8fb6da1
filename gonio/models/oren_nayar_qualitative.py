"""Oren and Nayar's rough diffuse surface, the qualitative model.

f = rho/pi [A + B max(0, cos dphi) sin(alpha) tan(beta)]

A = 1 - 0.5 sigma^2/(sigma^2 + 0.33), B = 0.45 sigma^2/(sigma^2 + 0.09)

alpha and beta are the larger and the smaller of theta_i and theta_r, dphi = phi_r - phi_i, and
sigma, in radians, is the spread of the facets' slope angle. Light that bounces twice is left out.

In print the bracket closes before sin(alpha), so that A is multiplied too: that form gives half
of rho/pi, not rho/pi, at sigma = 0 and 30/60 degrees (docs/errata.md).
"""

from __future__ import annotations

import math

from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine


def kernel(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, rho: float, sigma: float
) -> tuple[float, float, float]:
    """f of eq. (17), corrected, and its derivatives by rho and sigma."""
    # sin(alpha) tan(beta) cos(dphi) = sin_i sin_r cos(dphi) / cos(beta), and cos(beta) is the
    # larger cosine: no angle is needed, and normal incidence is no special case.
    tilt = 0.45 * max(0.0, xi * xr + yi * yr) / max(zi, zr)
    s2 = sigma * sigma
    s33 = 1 / (s2 + 0.33)
    s09 = 1 / (s2 + 0.09)
    direct = 1 - 0.5 * s2 * s33 + tilt * s2 * s09
    d_direct = 2 * sigma * (0.09 * s09 * s09 * tilt - 0.5 * 0.33 * s33 * s33)
    return rho / math.pi * direct, direct / math.pi, rho / math.pi * d_direct


MODEL = Model(
    name="oren_nayar_qualitative",
    title="Oren-Nayar, qualitative model",
    reference="Oren & Nayar 1994, eq. (17) corrected, section 3.5",
    parameters=(
        Parameter(
            "rho", "ρ", "reflectance of a facet", 0.8, 0.0, 1.0, linear=True, start=(0.05, 1.0)
        ),
        Parameter(
            "sigma",
            "σ",
            "spread of the facets' slope angle",
            math.radians(20),
            0.0,
            math.radians(60),
            unit="rad",
            start=(math.radians(3), math.radians(50)),
        ),
    ),
    kernel=kernel,
    claims=Claims(
        isotropic=True,
        seams=(
            (0.0, 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.8, 1.0),
            (0.7, 0.3, 0.7, 0.3),
            (1.2, 0.0, 1.2, 1.0),
            (1.0, 0.3, 0.6, 0.3 + math.pi / 2),
            (1.3, 0.0, 1.3, math.pi / 2),
        ),
        lambert_limit={"sigma": 0.0},
    ),
    validity="A sketch: forward of the incidence plane's normal it stays constant where a rough "
    "surface darkens, tens of percent off at oblique angles.",
    lobes=(Cosine(share="rho"),),
)
