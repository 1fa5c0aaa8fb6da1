"""Ashikhmin and Shirley's anisotropic Phong model.

f = (28 rho_d/23 pi) (1 - rho_s) [1 - (1 - cos theta_i/2)^5] [1 - (1 - cos theta_r/2)^5]
    + sqrt[(n_u + 1)(n_v + 1)]/(8 pi) (n.h)^e / [(h.i) max(cos theta_i, cos theta_r)] F

e = [n_u (h.x)^2 + n_v (h.y)^2] / [1 - (h.n)^2]
F = rho_s + (1 - rho_s) (1 - h.i)^5

h is the half vector, normalised; n_u and n_v are the exponents along x and y. rho_s is Schlick's
reflectance at normal incidence: also rho_s = 0 has a lobe at grazing, so that the model is never
Lambert. sqrt[(n_u + 1)(n_v + 1)]/(2 pi) normalises the density of h over the hemisphere.

Schlick's power has (1 - cos/2)^5 in its place in the diffuse term, whose albedo is then a closed
form. Both terms are reciprocal, and the albedo stays below 1.
"""

from __future__ import annotations

import math

from gonio.geometry import FloatArray
from gonio.models._lobes import AnisotropicPhong, schlick
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine, Named


def _body(z: float) -> float:
    """Share of light that enters the body: 1 - (1 - z/2)^5."""
    t = 1 - 0.5 * z
    return 1 - t * t * t * t * t


def kernel(
    xi: float,
    yi: float,
    zi: float,
    xr: float,
    yr: float,
    zr: float,
    rho_d: float,
    rho_s: float,
    n_u: float,
    n_v: float,
) -> tuple[float, float, float, float, float]:
    """f and its derivatives by rho_d, rho_s, n_u, n_v."""
    h_x = xi + xr
    h_y = yi + yr
    h_z = zi + zr
    sin2 = h_x * h_x + h_y * h_y
    q = sin2 + h_z * h_z
    # ln(n.h)/[1 - (n.h)^2], which tends to -1/2 as h -> n.
    s = sin2 / q
    if s < 0.5:
        log = 0.5 * math.log1p(-s) / s if s > 0.0 else -0.5
    else:
        log = 0.5 * math.log(h_z * h_z / q) / s
    u = h_x * h_x / q * log
    v = h_y * h_y / q * log
    c = 0.5 * math.sqrt(q)
    root = math.sqrt((n_u + 1) * (n_v + 1))
    lobe = root / (8 * math.pi) * math.exp(n_u * u + n_v * v) / (c * max(zi, zr))
    t = 1 - c
    schlick = t * t * t * t * t
    body = 28 / (23 * math.pi) * _body(zi) * _body(zr)
    specular = lobe * (rho_s + (1 - rho_s) * schlick)
    return (
        rho_d * (1 - rho_s) * body + specular,
        (1 - rho_s) * body,
        lobe * (1 - schlick) - rho_d * body,
        specular * (0.5 / (n_u + 1) + u),
        specular * (0.5 / (n_v + 1) + v),
    )


def entered(p: Named, cos_i: FloatArray) -> float:
    """About the albedo of the body."""
    return p["rho_d"] * (1 - p["rho_s"])


def mirrored(p: Named, cos_i: FloatArray) -> FloatArray:
    """About the albedo of the lobe."""
    return schlick(p["rho_s"], cos_i)


DEG = math.pi / 180

MODEL = Model(
    name="ashikhmin_shirley",
    title="Ashikhmin-Shirley, anisotropic Phong",
    reference="Ashikhmin & Shirley 2000, An Anisotropic Phong BRDF Model",
    parameters=(
        Parameter("rho_d", "ρ_d", "reflectance of the body", 0.2, 0.0, 1.0, linear=True),
        # f holds rho_d rho_s: it is linear in either, not in both together.
        Parameter(
            "rho_s",
            "ρ_s",
            "mirror reflectance at normal incidence",
            0.1,
            0.0,
            1.0,
            start=(0.01, 0.81),
        ),
        Parameter(
            "n_u",
            "n_u",
            "specular exponent along x",
            100.0,
            1.0,
            10000.0,
            scale="log",
            start=(2.0, 5000.0),
        ),
        Parameter(
            "n_v",
            "n_v",
            "specular exponent along y",
            100.0,
            1.0,
            10000.0,
            scale="log",
            start=(2.0, 5000.0),
        ),
    ),
    kernel=kernel,
    claims=Claims(
        # Where the larger cosine changes side, and where h is n.
        seams=(
            (60 * DEG, 0.3, 60 * DEG, 0.9),
            (30 * DEG, 1.0, 30 * DEG, 1.0 + math.pi),
            (30 * DEG, 0.0, 60 * DEG, 0.0),
            (0.0, 0.0, 0.0, 0.0),
        ),
        albedo_at_most=(),
    ),
    validity="Plausible rather than derived: no masking, Schlick's Fresnel term.",
    lobes=(Cosine(share=entered), AnisotropicPhong(share=mirrored, n_u="n_u", n_v="n_v")),
)
