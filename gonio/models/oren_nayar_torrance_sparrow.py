"""Oren and Nayar's body reflection with the specular lobe of the same rough surface.

f = f_oren_nayar(rho, sigma) + (k_s/k_b) f_torrance_sparrow(sigma)

The two parts are those of `oren_nayar`, eqs (14)-(16), and of `torrance_sparrow` with k_s = 1, and
share one sigma: the V-cavities are the same, their facets reflect diffusely and as mirrors.

In print L = k_b L_b + k_s L_s with the lobe's scale left open, and k_b and rho are separated only
by the light that bounces twice. Here k_b = 1, as absolute BRDF values allow, and the lobe is
normalised by the share of facet area (docs/errata.md).
"""

from __future__ import annotations

import math

from gonio.models._lobes import SlopeAngles
from gonio.models.base import Claims, Model, Parameter
from gonio.models.oren_nayar import MODEL as BODY
from gonio.models.oren_nayar import kernel as body_kernel
from gonio.models.sampling import Cosine
from gonio.models.torrance_sparrow import MODEL as FACETS
from gonio.models.torrance_sparrow import kernel as facet_kernel


def kernel(
    xi: float,
    yi: float,
    zi: float,
    xr: float,
    yr: float,
    zr: float,
    sigma: float,
    rho: float,
    ks_over_kb: float,
) -> tuple[float, float, float, float]:
    """f and its derivatives by sigma, rho, ks_over_kb."""
    body, body_rho, body_sigma = body_kernel(xi, yi, zi, xr, yr, zr, rho, sigma)
    facets, lobe, facets_sigma = facet_kernel(xi, yi, zi, xr, yr, zr, ks_over_kb, sigma)
    return body + facets, body_sigma + facets_sigma, body_rho, lobe


MODEL = Model(
    name="oren_nayar_torrance_sparrow",
    title="Oren-Nayar with a Torrance-Sparrow lobe",
    reference="Oren & Nayar 1994, section 4, with eqs (14)-(16) for the body",
    parameters=(
        Parameter(
            "sigma",
            "σ",
            "spread of the facets' slope angle",
            math.radians(20),
            math.radians(0.5),
            math.radians(60),
            unit="rad",
            start=(math.radians(3), math.radians(50)),
        ),
        Parameter("rho", "ρ", "reflectance of a facet's body", 0.8, 0.0, 1.0, start=(0.05, 1.0)),
        Parameter(
            "ks_over_kb",
            "k_s/k_b",
            "mirror against body reflection of a facet",
            0.02,
            0.0,
            1.0,
            linear=True,
            start=(0.0, 0.3),
        ),
    ),
    kernel=kernel,
    claims=Claims(
        non_negative=False,
        isotropic=True,
        seams=(*BODY.claims.seams, *FACETS.claims.seams),
    ),
    validity="As `oren_nayar`; without data at theta_i of 60 deg and more ks_over_kb is weakly "
    "determined, and without a visible lobe a small sigma is an upper limit.",
    lobes=(Cosine(share="rho"), SlopeAngles(share="ks_over_kb", sigma="sigma")),
)
