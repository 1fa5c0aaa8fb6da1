"""Ward's isotropic Gaussian model.

f = rho_d/pi + rho_s / sqrt(cos theta_i cos theta_r) * exp[-tan^2 delta / alpha^2] / (4 pi alpha^2)

delta is the angle between the normal and the half vector h = d_i + d_r; with h not normalised
tan^2 delta = [(h.x)^2 + (h.y)^2] / (h.n)^2.

In print alpha is "the standard deviation (RMS) of the surface slope": it is the RMS of the
two-dimensional slope, the standard deviation along one axis is alpha/sqrt(2). The reflectance is
rho_d + rho_s at normal incidence and small alpha only (docs/errata.md). The weight of a direction
drawn from the lobe is at most rho_s/sqrt(cos theta_i), which has no bound at grazing incidence.
"""

from __future__ import annotations

import math

from gonio.kernels.fastmath import exp
from gonio.models._lobes import GaussianSlopes
from gonio.models._ward import falling
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
    alpha: float,
) -> tuple[float, float, float, float]:
    """f of eq. (4) and its derivatives by rho_d, rho_s, alpha."""
    a = 1 / alpha
    scale = 1 / (zi + zr)
    u = (xi + xr) * scale
    v = (yi + yr) * scale
    t2 = (u * u + v * v) * (a * a)
    lobe = exp(-t2) * (a * a / (4 * math.pi)) * (1 / math.sqrt(zi * zr))
    return (
        rho_d / math.pi + rho_s * lobe,
        1 / math.pi,
        lobe,
        rho_s * lobe * 2 * (t2 - 1) * a,
    )


MODEL = Model(
    name="ward_isotropic",
    title="Ward, isotropic Gaussian",
    reference="Ward 1992, eq. (4), section 4.1",
    parameters=(
        Parameter("rho_d", "ρ_d", "diffuse reflectance", 0.2, 0.0, 1.0, linear=True),
        Parameter("rho_s", "ρ_s", "amplitude of the specular lobe", 0.1, 0.0, 1.0, linear=True),
        Parameter(
            "alpha",
            "α",
            "RMS slope of the facets",
            0.1,
            0.005,
            2.0,
            scale="log",
            start=(0.02, 0.8),
        ),
    ),
    kernel=kernel,
    claims=Claims(isotropic=True, seams=((0.0, 0.0, 0.0, 0.0),), lambert_limit={"rho_s": 0.0}),
    validity="alpha up to about 0.2; rho_s is an amplitude, the lobe's albedo is less at oblique "
    "incidence and diverges at grazing.",
    lobes=(
        Cosine(share="rho_d"),
        GaussianSlopes(share=falling, alpha_x="alpha", alpha_y="alpha"),
    ),
)
