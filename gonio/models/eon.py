"""Energy-preserving Oren-Nayar (EON): Fujii's variant with the light of all further bounces.

f = rho/pi A (1 + r s/t) + rho_ms/pi (1 - E_i)(1 - E_r)/(1 - <E>)

s = cos(phi_i - phi_r) sin theta_i sin theta_r
t = max(cos theta_i, cos theta_r) where s > 0, else 1
A = 1/(1 + c_1 r),  c_1 = 1/2 - 2/(3 pi),  c_2 = 2/3 - 28/(15 pi)
E(theta) = A [1 + r G(theta)/pi],  <E> = A (1 + c_2 r)
G = sin theta (theta - sin theta cos theta) + 2/3 [tan theta (1 - sin^3 theta) - sin theta]
rho_ms = rho^2 <E> / [1 - rho (1 - <E>)]

The first term is Fujii's model (FON), with roughness r in [0, 1] in place of sigma, and E its
directional albedo at rho = 1, here exact and not the published polynomial. The second gives back
what E lacks to 1: with rho = 1 the albedo is 1 at every incidence, the model conserves energy and
is reciprocal. r = 0 is Lambert.
"""

from __future__ import annotations

import math

from gonio.kernels.fastmath import acos
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine

C1 = 0.5 - 2 / (3 * math.pi)
C2 = 2 / 3 - 28 / (15 * math.pi)


def lacking(x: float, y: float, z: float) -> float:
    """(1 - E)/(A r) = c_1 - G/pi, which falls from c_1 at the normal to 0 at the horizon.

    Notes
    -----
    (1 - s^3)/z is written z (1 + s + s^2)/(1 + s), s = sin theta, which is no 0/0 at the horizon.
    """
    s2 = x * x + y * y
    s = math.sqrt(s2)
    g = s * (acos(z) - s * z) + 2 / 3 * s * (z * (1 + s + s2) / (1 + s) - 1)
    return C1 - g / math.pi


def kernel(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, rho: float, r: float
) -> tuple[float, float, float]:
    """f and its derivatives by rho and r."""
    s = xi * xr + yi * yr
    if s > 0.0:
        s /= max(zi, zr)
    a = 1 / (1 + C1 * r)
    d_a = -C1 * a * a
    single = a * (1 + r * s)
    single_r = d_a * (1 + r * s) + a * s
    # (1 - E_i)(1 - E_r)/(1 - <E>) = A r k: no 0/0 at r = 0.
    k = lacking(xi, yi, zi) * lacking(xr, yr, zr) / (C1 - C2)
    mean = a * (1 + C2 * r)
    d_mean = d_a * (1 + C2 * r) + a * C2
    series = 1 - rho * (1 - mean)
    rho_ms = rho * rho * mean / series
    rho_ms_rho = rho * mean * (2 - rho * (1 - mean)) / (series * series)
    rho_ms_mean = rho * rho * (1 - rho) / (series * series)
    multiple = a * r * k
    multiple_r = (d_a * r + a) * k
    return (
        (rho * single + rho_ms * multiple) / math.pi,
        (single + rho_ms_rho * multiple) / math.pi,
        (rho * single_r + rho_ms * multiple_r + rho_ms_mean * d_mean * multiple) / math.pi,
    )


DEG = math.pi / 180

MODEL = Model(
    name="eon",
    title="Energy-preserving Oren-Nayar (EON)",
    reference="Portsmouth, Kutz & Hill 2025, EON: A practical energy-preserving rough diffuse "
    "BRDF, JCGT 14(1)",
    parameters=(
        Parameter("rho", "ρ", "reflectance of a facet", 0.8, 0.0, 1.0, start=(0.05, 1.0)),
        Parameter("r", "r", "roughness", 0.5, 0.0, 1.0),
    ),
    kernel=kernel,
    claims=Claims(
        isotropic=True,
        # Where s changes its sign and where the larger cosine changes side.
        seams=(
            (0.0, 0.0, 0.0, 0.0),
            (50 * DEG, 0.0, 35 * DEG, math.pi / 2),
            (50 * DEG, 0.0, 50 * DEG, 0.5),
            (50 * DEG, 0.0, 50 * DEG, math.pi / 2),
        ),
        lambert_limit={"r": 0.0},
        albedo_at_most=("rho",),
    ),
    validity="All angles, albedo at most 1; the shape is a fit to V-cavities, r is no measured "
    "slope.",
    lobes=(Cosine(share="rho"),),
)
