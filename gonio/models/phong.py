"""Phong's lobe around the mirror direction, normalised and reciprocal.

f = rho_d/pi + rho_s (n + 2)/(2 pi) max(0, R.r)^n

R = 2 (n.i) n - i is the mirror direction of the light, so R.r = zi zr - xi xr - yi yr.

Phong and Losasso print the radiance k_s (E.R)^n without N.L; as a BRDF that is k_s (E.R)^n/(N.L),
neither reciprocal nor bounded (docs/errata.md). Here the cosine stays outside f. (n + 2)/(2 pi)
makes the lobe's albedo rho_s at normal incidence; elsewhere the horizon cuts the lobe and it is
less, 0.50 rho_s at 60 deg for n = 20.
"""

from __future__ import annotations

import math

from gonio.models._lobes import AboutMirror
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine


def kernel(
    xi: float,
    yi: float,
    zi: float,
    xr: float,
    yr: float,
    zr: float,
    rho_d: float,
    rho_s: float,
    n: float,
) -> tuple[float, float, float, float]:
    """f and its derivatives by rho_d, rho_s, n."""
    c = zi * zr - (xi * xr + yi * yr)
    if c <= 0.0:
        return rho_d / math.pi, 1 / math.pi, 0.0, 0.0
    power = c**n / (2 * math.pi)
    lobe = (n + 2) * power
    by_n = rho_s * power * (1 + (n + 2) * math.log(c))
    return rho_d / math.pi + rho_s * lobe, 1 / math.pi, lobe, by_n


DEG = math.pi / 180

MODEL = Model(
    name="phong",
    title="Phong, normalised",
    reference="Phong 1975; Losasso, Surface Reflection Models, as corrected",
    parameters=(
        Parameter("rho_d", "ρ_d", "diffuse reflectance", 0.2, 0.0, 1.0, linear=True),
        Parameter("rho_s", "ρ_s", "reflectance of the lobe, bound", 0.1, 0.0, 1.0, linear=True),
        Parameter(
            "n", "n", "specular exponent", 50.0, 1.0, 10000.0, scale="log", start=(2.0, 2000.0)
        ),
    ),
    kernel=kernel,
    claims=Claims(
        isotropic=True,
        # Where R.r changes its sign, in the plane of incidence and outside it.
        seams=(
            (40 * DEG, 0.0, 50 * DEG, 0.0),
            (60 * DEG, 0.0, 60 * DEG, math.acos(1 / 3)),
        ),
        lambert_limit={"rho_s": 0.0},
        albedo_at_most=("rho_d", "rho_s"),
    ),
    validity="No surface physics: the lobe is round about R and does not widen towards grazing; "
    "the albedo is at most rho_d + rho_s.",
    lobes=(Cosine(share="rho_d"), AboutMirror(share="rho_s", n="n")),
)
