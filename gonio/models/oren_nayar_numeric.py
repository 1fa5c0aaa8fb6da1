"""Oren and Nayar's rough diffuse surface, the integral itself: two bounces, no approximation.

f = rho/pi d1 + rho^2/pi d2

d_k = 1/S(sigma) int_0^{pi/2} exp(-t^2/2 sigma^2) sin t [1/2pi int_0^{2pi} g_k dphi_a] dt
S(sigma) = int_0^{pi/2} exp(-t^2/2 sigma^2) sin t dt

t and phi_a are a facet's slope and azimuth; g1 is what it returns of the light that meets it, less
shadow and mask, and g2 what it returns of its companion's light (eqs 6 and 10, corrected; the
formulas stand in `_vcavity.py`). `oren_nayar` is the paper's fit to this integral. It is off by
2 to 3 % in the mean and by tens of per cent near grazing: parameters of one are not those of the
other.

Third and further bounces are missing, as in the paper: at rho = 1 the surface loses 10 % of the
light (sigma 30 deg) to 26 % (60 deg) near normal incidence.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from gonio.geometry import FloatArray
from gonio.models._vcavity import gaussian, shares
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine

if TYPE_CHECKING:
    from gonio.models._vcavity_table import Table


def kernel(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, rho: float, sigma: float
) -> tuple[float, float, float]:
    """f of eq. (13) and its derivatives by rho and sigma."""
    d1, d2, s1, s2 = gaussian(xi, yi, zi, xr, yr, zr, sigma)
    return (
        rho / math.pi * (d1 + rho * d2),
        (d1 + 2 * rho * d2) / math.pi,
        rho / math.pi * (s1 + rho * s2),
    )


def d1(theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike, sigma: float) -> FloatArray:
    """pi f/rho of the light that leaves after one bounce.

    Parameters
    ----------
    theta_i, theta_r, dphi : array_like
        Polar angles and difference of azimuth, radians.
    sigma : float
        Spread of the facets' slope angle, radians.

    Examples
    --------
    >>> round(float(d1(0.0, 0.0, 0.0, math.radians(30))), 3)
    0.776
    """
    return shares(gaussian, theta_i, theta_r, dphi, sigma)[0]


def d2(theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike, sigma: float) -> FloatArray:
    """pi f/rho^2 of the light that leaves after two bounces; arguments as for `d1`.

    Examples
    --------
    >>> round(float(d2(0.0, 0.0, 0.0, math.radians(30))), 3)
    0.135
    """
    return shares(gaussian, theta_i, theta_r, dphi, sigma)[1]


def surrogate() -> Table:
    """This model from a table: some hundred times faster, good to 1e-4 (docs/adr/0006).

    The table is computed at the first call on a machine and kept in the cache folder.
    """
    from gonio.models._vcavity_table import table

    return table()


DEG = math.pi / 180

MODEL = Model(
    name="oren_nayar_numeric",
    title="Oren-Nayar, numerical integral",
    reference="Oren & Nayar 1994, eqs (5), (6), (10)-(13), section 3.3",
    parameters=(
        Parameter("rho", "ρ", "reflectance of a facet", 0.8, 0.0, 1.0, start=(0.05, 1.0)),
        Parameter(
            "sigma",
            "σ",
            "spread of the facets' slope angle",
            20 * DEG,
            0.0,
            60 * DEG,
            unit="rad",
            start=(3 * DEG, 50 * DEG),
        ),
    ),
    kernel=kernel,
    claims=Claims(
        isotropic=True,
        # The kink at theta_i = theta_r, dphi = 0, and what the integral's panels depend on.
        seams=(
            (0.0, 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.8, 1.0),
            (0.8, 1.0, 0.0, 0.0),
            (0.7, 0.3, 0.7, 0.3),
            (75 * DEG, 0.0, 75 * DEG, 0.0),
            (1.2, 0.0, 1.2, 2.0),
            (1.0, 0.3, 0.6, 0.3 + math.pi / 2),
            (1.3, 0.0, 1.3, math.pi / 2),
            (0.9, 0.0, 0.5, math.pi),
            (1.2, 0.0, 1.2, math.pi),
        ),
        lambert_limit={"sigma": 0.0},
        albedo_at_most=("rho",),
    ),
    validity="Two bounces: third and further ones, missing here, carry up to a quarter of the "
    "light at rho = 1 and sigma = 60 deg. Exact to 1e-4 for polar angles up to 85 deg.",
    lobes=(Cosine(share="rho"),),
    costly=True,
)
