"""Cook and Torrance's lobe: mirror facets with Beckmann's slopes in V-cavities.

f = rho_d/pi + k_s D F G / (4 cos theta_i cos theta_r)

D = exp(-tan^2 beta/m^2) / (pi m^2 cos^4 beta)
G = min[1, 2 (n.h)(n.i)/(h.i), 2 (n.h)(n.r)/(h.i)]
F: Fresnel's reflectance of a dielectric of index eta at the angle between i and h

beta is the angle between the normal n and the half vector h; m is the RMS of the two-dimensional
slope, and the integral of D cos beta over the hemisphere is 1.

Losasso prints D with 4 m^2 and divides by pi, which is this lobe; mixed with the pi m^2 or the 4
from here it would not be. The specular term stands in I and again in rho, the facets are called
Lambertian and must be mirrors, G ends on V.H, and the root in g must take in the -1 that is
printed behind it (docs/errata.md).
"""

from __future__ import annotations

import math

from gonio.geometry import FloatArray
from gonio.kernels.fastmath import exp
from gonio.models._lobes import GaussianSlopes, at_normal, schlick
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
    m: float,
    eta: float,
) -> tuple[float, float, float, float, float]:
    """f and its derivatives by rho_d, k_s, m, eta."""
    h_z = zi + zr
    sin2 = (xi + xr) * (xi + xr) + (yi + yr) * (yi + yr)
    q = sin2 + h_z * h_z
    cos2 = h_z * h_z / q
    t2 = sin2 / (h_z * h_z * m * m)
    d = exp(-t2) / (math.pi * m * m * cos2 * cos2)
    fresnel, _, by_eta = fresnel_dielectric(0.5 * math.sqrt(q), eta)
    facets = d * v_cavities(h_z, q, zi, zr) / (4 * zi * zr)
    lobe = fresnel * facets
    return (
        rho_d / math.pi + k_s * lobe,
        1 / math.pi,
        lobe,
        k_s * lobe * 2 * (t2 - 1) / m,
        k_s * by_eta * facets,
    )


def mirrored(p: Named, cos_i: FloatArray) -> FloatArray:
    """About the albedo of the lobe."""
    return p["k_s"] * schlick(at_normal(p["eta"]), cos_i)


DEG = math.pi / 180

MODEL = Model(
    name="cook_torrance",
    title="Cook-Torrance, Beckmann slopes",
    reference="Cook & Torrance 1982; Losasso, Surface Reflection Models, as corrected",
    parameters=(
        Parameter("rho_d", "ρ_d", "diffuse reflectance", 0.2, 0.0, 1.0, linear=True),
        Parameter("k_s", "k_s", "scale of the lobe, 1 is physical", 1.0, 0.0, 1.0, linear=True),
        Parameter(
            "m", "m", "RMS slope of the facets", 0.2, 0.005, 2.0, scale="log", start=(0.02, 0.8)
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
    lobes=(Cosine(share="rho_d"), GaussianSlopes(share=mirrored, alpha_x="m", alpha_y="m")),
)
