"""Oren and Nayar's rough diffuse surface, the functional approximation.

f = rho/pi [C1 + cos(dphi) C2 tan(beta) + (1 - |cos dphi|) C3 tan((alpha + beta)/2)]
    + 0.17 rho^2/pi sigma^2/(sigma^2 + 0.13) [1 - cos(dphi) (2 beta/pi)^2]

C1 = 1 - 0.5 sigma^2/(sigma^2 + 0.33)
C2 = 0.45 sigma^2/(sigma^2 + 0.09) [sin(alpha) - (2 beta/pi)^3 where cos(dphi) < 0]
C3 = 0.125 sigma^2/(sigma^2 + 0.09) (4 alpha beta/pi^2)^2

alpha and beta are the larger and the smaller of theta_i and theta_r, dphi = phi_r - phi_i, and
sigma, in radians, is the spread of the facets' slope angle. The surface is made of V-cavities
with Lambertian facets; the line with rho^2 is light that bounces twice.

In print the approximation holds "for arbitrary surface roughness and angles"; it does not at
grazing. Its first part falls below zero forward at sigma above some 40 degrees and its albedo
exceeds rho at oblique incidence and small sigma. Nothing is clamped here, so that derivatives
stay those of the formula (docs/errata.md).
"""

from __future__ import annotations

import math

from gonio.kernels.fastmath import acos
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine


def kernel(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, rho: float, sigma: float
) -> tuple[float, float, float]:
    """f of eqs (14)-(16) and its derivatives by rho and sigma."""
    sin_i = math.sqrt(xi * xi + yi * yi)
    sin_r = math.sqrt(xr * xr + yr * yr)
    alpha = acos(min(zi, zr))
    beta = acos(max(zi, zr))
    sin_alpha = max(sin_i, sin_r)
    tan_beta = min(sin_i, sin_r) / max(zi, zr)
    # tan((alpha + beta)/2) = (sin alpha + sin beta)/(cos alpha + cos beta)
    tan_mean = (sin_i + sin_r) / (zi + zr)
    # At normal incidence or view beta = 0: every term that holds cos(dphi) is 0 whatever it is.
    both = sin_i * sin_r
    cos_dphi = (xi * xr + yi * yr) / (both if both > 0 else 1)
    b = 2 / math.pi * beta
    c3 = 2 / math.pi * alpha * b
    sloped = sin_alpha - (b * b * b if cos_dphi < 0 else 0)
    tilt = 0.45 * cos_dphi * sloped * tan_beta
    tilt += 0.125 * (1 - abs(cos_dphi)) * c3 * c3 * tan_mean
    bounce = 0.17 * (1 - cos_dphi * b * b)

    s2 = sigma * sigma
    s33 = 1 / (s2 + 0.33)
    s09 = 1 / (s2 + 0.09)
    s13 = 1 / (s2 + 0.13)
    direct = 1 - 0.5 * s2 * s33 + tilt * s2 * s09
    twice = bounce * s2 * s13
    # d/dsigma of sigma^2/(sigma^2 + c) is 2 sigma c/(sigma^2 + c)^2.
    d_direct = 2 * sigma * (0.09 * s09 * s09 * tilt - 0.5 * 0.33 * s33 * s33)
    d_twice = 2 * sigma * 0.13 * s13 * s13 * bounce
    return (
        rho / math.pi * (direct + rho * twice),
        (direct + 2 * rho * twice) / math.pi,
        rho / math.pi * (d_direct + rho * d_twice),
    )


MODEL = Model(
    name="oren_nayar",
    title="Oren-Nayar, functional approximation",
    reference="Oren & Nayar 1994, eqs (14)-(16), section 3.4",
    parameters=(
        Parameter("rho", "ρ", "reflectance of a facet", 0.8, 0.0, 1.0, start=(0.05, 1.0)),
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
        non_negative=False,
        isotropic=True,
        seams=(
            (0.0, 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.8, 1.0),
            (0.8, 1.0, 0.0, 0.0),
            (0.7, 0.3, 0.7, 0.3),
            (1.2, 0.0, 1.2, 2.0),
            (1.0, 0.3, 0.6, 0.3 + math.pi / 2),
            (1.3, 0.0, 1.3, math.pi / 2),
            (0.9, 0.0, 0.5, math.pi),
        ),
        lambert_limit={"sigma": 0.0},
    ),
    validity="Both polar angles up to about 75 deg; may be negative forward at sigma above 40 deg, "
    "and its albedo exceeds rho at oblique incidence and small sigma.",
    lobes=(Cosine(share="rho"),),
)
