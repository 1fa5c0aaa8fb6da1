"""Ward's anisotropic (elliptical) Gaussian model, the convenient approximation.

f = rho_d/pi + rho_s / sqrt(cos theta_i cos theta_r) / (4 pi alpha_x alpha_y)
    * exp{-2 [(h.x/alpha_x)^2 + (h.y/alpha_y)^2] / (1 + h.n)}

h is the half vector, normalised. With H = d_i + d_r not normalised and q = H.H the exponent is
-2 [(H.x/alpha_x)^2 + (H.y/alpha_y)^2] / (q + H.n sqrt(q)).

In print it stands for eq. (5a); it is a model of its own with a heavier tail: where the lobe of
(5a) has fallen to a hundredth, this one is 1.16 times (alpha = 0.1) to 8 times (alpha = 0.5) as
high. Parameters fitted with one of the two belong to that one (docs/errata.md). Directions are
drawn from a Gaussian of its own: beside that of (5a) the tail would have weights without bound.
Here they are at most rho_s/sqrt(cos theta_i), which has none at grazing incidence.
"""

from __future__ import annotations

import math

from gonio.kernels.fastmath import exp
from gonio.models._lobes import EqualAreaGaussian
from gonio.models._ward import elliptical, falling
from gonio.models.base import Claims, Model
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
    alpha_x: float,
    alpha_y: float,
) -> tuple[float, float, float, float, float]:
    """f of eq. (5b) and its derivatives by rho_d, rho_s, alpha_x, alpha_y."""
    h_x = xi + xr
    h_y = yi + yr
    h_z = zi + zr
    q = h_x * h_x + h_y * h_y + h_z * h_z
    a_x = 1 / alpha_x
    a_y = 1 / alpha_y
    scale = 2 / (q + h_z * math.sqrt(q))
    u2 = scale * h_x * h_x * (a_x * a_x)
    v2 = scale * h_y * h_y * (a_y * a_y)
    lobe = exp(-(u2 + v2)) * (a_x * a_y / (4 * math.pi)) * (1 / math.sqrt(zi * zr))
    return (
        rho_d / math.pi + rho_s * lobe,
        1 / math.pi,
        lobe,
        rho_s * lobe * (2 * u2 - 1) * a_x,
        rho_s * lobe * (2 * v2 - 1) * a_y,
    )


MODEL = Model(
    name="ward_approx",
    title="Ward, elliptical Gaussian, approximate",
    reference="Ward 1992, eq. (5b), section 4.2",
    parameters=elliptical(),
    kernel=kernel,
    claims=Claims(seams=((0.0, 0.0, 0.0, 0.0),), lambert_limit={"rho_s": 0.0}),
    validity="Near eq. (5a) inside the lobe for alpha up to about 0.2; rho_s is an amplitude, the "
    "lobe's albedo is less at oblique incidence and diverges at grazing.",
    lobes=(
        Cosine(share="rho_d"),
        EqualAreaGaussian(share=falling, alpha_x="alpha_x", alpha_y="alpha_y"),
    ),
)
