"""GGX microfacets with Smith's masking of correlated heights, on a dielectric or a metal.

f = rho_d/pi + k_s D F G_2 / (4 cos theta_i cos theta_r)

D   = 1 / {pi alpha_x alpha_y [(h.x/alpha_x)^2 + (h.y/alpha_y)^2 + (h.n)^2]^2}
G_2 = 1 / (1 + Lambda_i + Lambda_r)
Lambda = {-1 + sqrt[1 + (alpha_x^2 x^2 + alpha_y^2 y^2)/z^2]} / 2
F: Fresnel's reflectance for the index eta + i kappa at the angle between i and h

h is the half vector, normalised. kappa = 0 is a dielectric; kappa > 0 a metal, for which eta may
be below 1. k_s = 1 is the physical lobe; less stands for dust, porosity or losses between facets.
rho_d/pi is added as it is, without the loss that the interface takes from it (`rough_plastic` has
that). The lobe reflects once: what meets a second facet is lost. With F = 1 the albedo at normal
incidence is 1 - ln 2 = 0.31 for alpha = 1.
"""

from __future__ import annotations

import math

from gonio.geometry import FloatArray
from gonio.models._lobes import VisibleFacets, at_normal, schlick
from gonio.models._microfacet import fresnel_conductor, ggx, ggx_smith
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
    alpha_x: float,
    alpha_y: float,
    eta: float,
    kappa: float,
) -> tuple[float, float, float, float, float, float, float]:
    """f and its derivatives by rho_d, k_s, alpha_x, alpha_y, eta, kappa."""
    h_x = xi + xr
    h_y = yi + yr
    h_z = zi + zr
    d, d_x, d_y = ggx(h_x, h_y, h_z, alpha_x, alpha_y)
    s_i, s_ix, s_iy = ggx_smith(xi, yi, zi, alpha_x, alpha_y)
    s_r, s_rx, s_ry = ggx_smith(xr, yr, zr, alpha_x, alpha_y)
    # G_2 / (4 zi zr) = 1 / 2 (zr S_i + zi S_r)
    v = zr * s_i + zi * s_r
    facets = d / (2 * v)
    c = 0.5 * math.sqrt(h_x * h_x + h_y * h_y + h_z * h_z)
    fresnel, by_eta, by_kappa = fresnel_conductor(c, eta, kappa)
    lobe = fresnel * facets
    return (
        rho_d / math.pi + k_s * lobe,
        1 / math.pi,
        lobe,
        k_s * lobe * (d_x - (zr * s_ix + zi * s_rx) / v),
        k_s * lobe * (d_y - (zr * s_iy + zi * s_ry) / v),
        k_s * by_eta * facets,
        k_s * by_kappa * facets,
    )


def mirrored(p: Named, cos_i: FloatArray) -> FloatArray:
    """About the albedo of the lobe."""
    return p["k_s"] * schlick(at_normal(p["eta"], p["kappa"]), cos_i)


MODEL = Model(
    name="ggx",
    title="GGX microfacets, anisotropic, dielectric or metal",
    reference="Walter et al. 2007, eqs (20), (33); Heitz 2014, eq. (99)",
    parameters=(
        Parameter("rho_d", "ρ_d", "diffuse reflectance", 0.2, 0.0, 1.0, linear=True),
        Parameter("k_s", "k_s", "scale of the lobe, 1 is physical", 1.0, 0.0, 1.0, linear=True),
        Parameter(
            "alpha_x",
            "α_x",
            "roughness in x",
            0.1,
            0.005,
            1.0,
            scale="log",
            start=(0.02, 0.8),
        ),
        Parameter(
            "alpha_y",
            "α_y",
            "roughness in y",
            0.1,
            0.005,
            1.0,
            scale="log",
            start=(0.02, 0.8),
        ),
        Parameter("eta", "η", "refractive index", 1.5, 0.05, 5.0, start=(0.2, 3.0)),
        Parameter("kappa", "κ", "extinction coefficient", 0.0, 0.0, 10.0, start=(0.0, 6.0)),
    ),
    kernel=kernel,
    claims=Claims(lambert_limit={"k_s": 0.0}, albedo_at_most=("rho_d", "k_s")),
    validity="Single reflection; the albedo is at most rho_d + k_s, which may be above 1. "
    "k_s, eta and kappa are hard to separate: hold those that are known.",
    lobes=(
        Cosine(share="rho_d"),
        VisibleFacets(share=mirrored, alpha_x="alpha_x", alpha_y="alpha_y"),
    ),
)
