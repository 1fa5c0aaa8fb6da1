"""Blinn's lobe: mirror facets as on ellipsoids of revolution, in V-cavities.

f = rho_d/pi + k_s D F G / (4 cos theta_i cos theta_r)

D = c^2 / {pi [(n.h)^2 (c^2 - 1) + 1]^2}
G = min[1, 2 (n.h)(n.i)/(h.i), 2 (n.h)(n.r)/(h.i)]
F: Fresnel's reflectance of a dielectric of index eta at the angle between i and h

c is the eccentricity of the facets' ellipsoids, 0 for a mirror and 1 for a sphere. D is Trowbridge
and Reitz's shape, today's GGX with alpha = c; the integral of D (n.h) over the hemisphere is 1.

Losasso prints D = {c^2 / [...]}^2 with its peak at 1, which makes that integral pi c^2, divides by
no 4 and ends G on V.H; the printed I is 4 pi c^2 times this f times N.L (docs/errata.md).
"""

from __future__ import annotations

import math

from gonio.geometry import FloatArray
from gonio.models._lobes import TrowbridgeReitz, at_normal, schlick
from gonio.models._microfacet import fresnel_dielectric, v_cavities
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine, Named


def kernel(
    xi: float,
    yi: float,
    zi: float,
    xr: float,
    yr: float,
    zr: float,
    rho_d: float,
    k_s: float,
    c: float,
    eta: float,
) -> tuple[float, float, float, float, float]:
    """f and its derivatives by rho_d, k_s, c, eta."""
    h_z = zi + zr
    sin2 = (xi + xr) * (xi + xr) + (yi + yr) * (yi + yr)
    q = sin2 + h_z * h_z
    cos2 = h_z * h_z / q
    # (n.h)^2 (c^2 - 1) + 1 without the difference of near equals at small c.
    t = sin2 / q + c * c * cos2
    d = c * c / (math.pi * t * t)
    fresnel, _, by_eta = fresnel_dielectric(0.5 * math.sqrt(q), eta)
    facets = d * v_cavities(h_z, q, zi, zr) / (4 * zi * zr)
    lobe = fresnel * facets
    return (
        rho_d / math.pi + k_s * lobe,
        1 / math.pi,
        lobe,
        k_s * lobe * 2 * (1 / c - 2 * c * cos2 / t),
        k_s * by_eta * facets,
    )


def mirrored(p: Named, cos_i: FloatArray) -> FloatArray:
    """About the albedo of the lobe."""
    return p["k_s"] * schlick(at_normal(p["eta"]), cos_i)


DEG = math.pi / 180

MODEL = Model(
    name="blinn",
    title="Blinn, Trowbridge-Reitz facets",
    reference="Blinn 1977; Losasso, Surface Reflection Models, as corrected",
    parameters=(
        Parameter("rho_d", "ρ_d", "diffuse reflectance", 0.2, 0.0, 1.0, linear=True),
        Parameter("k_s", "k_s", "scale of the lobe, 1 is physical", 1.0, 0.0, 1.0, linear=True),
        Parameter(
            "c",
            "c",
            "eccentricity of the facets",
            0.2,
            0.005,
            1.0,
            scale="log",
            start=(0.02, 0.8),
        ),
        Parameter("eta", "η", "refractive index", 1.5, 1.0, 4.0, start=(1.2, 3.0)),
    ),
    kernel=kernel,
    claims=Claims(
        isotropic=True,
        # Where G leaves 1, where its two other terms cross, and both at once (45 deg retro).
        seams=(
            (0.0, 0.0, 0.0, 0.0),
            (50 * DEG, 0.0, 30 * DEG, 0.0),
            (70 * DEG, 0.0, 30 * DEG, math.pi),
            (60 * DEG, 0.0, 60 * DEG, 0.0),
            (45 * DEG, 0.0, 45 * DEG, 0.0),
        ),
        lambert_limit={"k_s": 0.0},
        albedo_at_most=("rho_d", "k_s"),
    ),
    validity="Single reflection; the albedo is at most rho_d + k_s, which may be above 1: keep "
    "rho_d below 1 - k_s F. k_s and eta are separated by oblique directions only.",
    lobes=(Cosine(share="rho_d"), TrowbridgeReitz(share=mirrored, c="c")),
)
