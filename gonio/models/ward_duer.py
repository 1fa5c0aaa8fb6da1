"""Ward's elliptical Gaussian with Duer's normalisation.

f = rho_d/pi + rho_s / (cos theta_i cos theta_r)
    * exp[-tan^2 delta (cos^2 phi/alpha_x^2 + sin^2 phi/alpha_y^2)] / (4 pi alpha_x alpha_y)

(delta, phi) is the half vector h = d_i + d_r; with h not normalised the exponent is
-[(h.x/alpha_x)^2 + (h.y/alpha_y)^2] / (h.n)^2.

Duer puts 1/(cos theta_i cos theta_r) where Ward's eq. (5a) has the square root, so that the albedo
of the lobe no longer falls as cos theta_i: at alpha = 0.1 it is 0.98 rho_s from 0 to 60 deg. It
does not conserve energy: beyond some 80 deg the albedo passes rho_s (1.13 at 85 deg, alpha = 0.2)
and goes on to infinity. `ward_gmd` stays below.

The weight of a direction drawn from the lobe by Ward's eq. (7) is at most rho_s/cos theta_i, which
has no bound at grazing incidence.
"""

from __future__ import annotations

import math

from gonio.kernels.fastmath import exp
from gonio.models._lobes import GaussianSlopes
from gonio.models._ward import elliptical
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
    """f and its derivatives by rho_d, rho_s, alpha_x, alpha_y."""
    a_x = 1 / alpha_x
    a_y = 1 / alpha_y
    scale = 1 / (zi + zr)
    u = (xi + xr) * scale * a_x
    v = (yi + yr) * scale * a_y
    u2 = u * u
    v2 = v * v
    lobe = exp(-(u2 + v2)) * (a_x * a_y / (4 * math.pi)) * (1 / (zi * zr))
    return (
        rho_d / math.pi + rho_s * lobe,
        1 / math.pi,
        lobe,
        rho_s * lobe * (2 * u2 - 1) * a_x,
        rho_s * lobe * (2 * v2 - 1) * a_y,
    )


MODEL = Model(
    name="ward_duer",
    title="Ward, elliptical Gaussian, normalised by Duer",
    reference="Duer 2006; Ward 1992, eq. (5a), with 1/(cos theta_i cos theta_r)",
    parameters=elliptical(),
    kernel=kernel,
    claims=Claims(lambert_limit={"rho_s": 0.0}),
    validity="alpha up to about 0.2 and theta up to 80 deg, where the lobe's albedo is within 11 % "
    "of rho_s; at grazing it exceeds rho_s and diverges, energy is not conserved.",
    lobes=(
        Cosine(share="rho_d"),
        GaussianSlopes(share="rho_s", alpha_x="alpha_x", alpha_y="alpha_y"),
    ),
)
