"""Ward's anisotropic (elliptical) Gaussian model, the exact form.

f = rho_d/pi + rho_s / sqrt(cos theta_i cos theta_r)
    * exp[-tan^2 delta (cos^2 phi/alpha_x^2 + sin^2 phi/alpha_y^2)] / (4 pi alpha_x alpha_y)

(delta, phi) is the half vector h = d_i + d_r; with h not normalised the exponent is
-[(h.x/alpha_x)^2 + (h.y/alpha_y)^2] / (h.n)^2.

In print alpha is called the standard deviation of the slope; the exponent says that the standard
deviation along each axis is alpha/sqrt(2). The normalisation holds at normal incidence and small
alpha only: the albedo of the lobe falls about as rho_s cos(theta_i) (docs/errata.md).

Directions drawn from the lobe by eq. (7), corrected, are not "uniformly weighted": their weight
rho_s (h.i) cos^3(delta) sqrt(cos theta_r/cos theta_i) is at most rho_s/sqrt(cos theta_i), which has
no bound at grazing incidence.
"""

from __future__ import annotations

import math

from gonio.kernels.fastmath import exp
from gonio.models._lobes import GaussianSlopes
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
    """f of eq. (5a) and its derivatives by rho_d, rho_s, alpha_x, alpha_y."""
    a_x = 1 / alpha_x
    a_y = 1 / alpha_y
    scale = 1 / (zi + zr)
    u = (xi + xr) * scale * a_x
    v = (yi + yr) * scale * a_y
    u2 = u * u
    v2 = v * v
    lobe = exp(-(u2 + v2)) * (a_x * a_y / (4 * math.pi)) * (1 / math.sqrt(zi * zr))
    return (
        rho_d / math.pi + rho_s * lobe,
        1 / math.pi,
        lobe,
        rho_s * lobe * (2 * u2 - 1) * a_x,
        rho_s * lobe * (2 * v2 - 1) * a_y,
    )


MODEL = Model(
    name="ward",
    title="Ward, elliptical Gaussian, exact",
    reference="Ward 1992, eq. (5a), section 4.2",
    parameters=elliptical(),
    kernel=kernel,
    claims=Claims(),
    validity="alpha up to about 0.2; rho_s is an amplitude, the lobe's albedo is less at oblique "
    "incidence and diverges at grazing.",
    lobes=(
        Cosine(share="rho_d"),
        GaussianSlopes(share=falling, alpha_x="alpha_x", alpha_y="alpha_y"),
    ),
)
