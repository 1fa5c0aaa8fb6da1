"""Torrance and Sparrow's lobe: mirror facets on the V-cavities of the Oren-Nayar surface.

f = k_s F G P(theta_a) / (8 pi cos theta_a cos theta_i cos theta_r)

P(theta_a) = exp(-theta_a^2 / 2 sigma^2) / S(sigma)
S(sigma)   = int_0^{pi/2} exp(-t^2 / 2 sigma^2) sin t dt
G          = min[1, 2 (n.h)(n.i)/(h.i), 2 (n.h)(n.r)/(h.i)]

theta_a is the angle between the normal n and the half vector h, that is the slope of the facets
that mirror i into r. P is a share of surface area, int P sin(theta_a) dtheta_a = 1, so that the
lobe and `oren_nayar` describe one surface with one sigma. F = 1: k_s is the mean Fresnel
reflectance of a facet. This equals D F G / (4 cos theta_i cos theta_r), D = P/(2 pi cos theta_a).

Oren and Nayar print only L = k_b L_b + k_s L_s and leave the lobe's scale open. Against the
unnormalised exp(-theta_a^2/2 sigma^2) G / (4 cos theta_i cos theta_r) of other texts this one is
higher by 1/(2 pi S cos theta_a): 1.360 at 20 deg, 0.376 at 42 deg (docs/errata.md).
"""

from __future__ import annotations

import math

from gonio.kernels.fastmath import arcvers, exp
from gonio.models._lobes import SlopeAngles
from gonio.models.base import Claims, Model, Parameter


def slope_norm(sigma: float) -> tuple[float, float]:
    """S(sigma) = int_0^{pi/2} exp(-t^2/2 sigma^2) sin t dt and dS/dsigma, for sigma in (0, 60 deg].

    Notes
    -----
    Both errors are below 1e-13 of the value. Integrating by parts twice gives the derivative
    without a second series: sigma dS/dsigma = S + sigma^2 (1 - S) - (pi/2) exp(-pi^2/8 sigma^2).

    Examples
    --------
    >>> s, _ = slope_norm(math.radians(20))
    >>> round(1 / (2 * math.pi * s), 3)
    1.36
    """
    q = sigma * sigma
    edge = exp(-math.pi * math.pi / (8 * q))
    # S/sigma^2 = A(q) - exp(-pi^2/8q) T(q): the integral to infinity less its tail. Written out,
    # the sums are done once for all pairs of directions; loops would be done for each.
    # A is Dawson's integral by its series of (-q)^k / (2k + 1)!!:
    #   [(-1) ** k / math.prod(range(1, 2 * k + 2, 2)) for k in range(16)]
    whole = -5.211080442257311e-18
    whole = whole * q + 1.6154349370997664e-16
    whole = whole * q - 4.684761317589322e-15
    whole = whole * q + 1.264885555749117e-13
    whole = whole * q - 3.1622138893727926e-12
    whole = whole * q + 7.273091945557423e-11
    whole = whole * q - 1.5273493085670588e-09
    whole = whole * q + 2.901963686277412e-08
    whole = whole * q - 4.9333382666716e-07
    whole = whole * q + 7.4000074000074e-06
    whole = whole * q - 9.62000962000962e-05
    whole = whole * q + 0.0010582010582010583
    whole = whole * q - 0.009523809523809525
    whole = whole * q + 0.06666666666666667
    whole = whole * q - 0.3333333333333333
    whole = whole * q + 1.0
    # T(q) = int_0^inf exp(-pi w/2 - q w^2/2) cos(q w) dw (t = pi/2 + q w in the tail), as
    #   Chebyshev.interpolate(T, 9, [0, 1.1]).convert(kind=Polynomial).coef
    # of numpy.polynomial, with T by scipy.integrate.quad.
    tail = -1.1151778692133373e-09
    tail = tail * q + 2.6490550397122948e-08
    tail = tail * q - 4.578385649641707e-07
    tail = tail * q + 6.8124100435089816e-06
    tail = tail * q - 8.7436960094106e-05
    tail = tail * q + 0.0009449987394157087
    tail = tail * q - 0.008289246471018044
    tail = tail * q + 0.05569303426790983
    tail = tail * q - 0.25801227546564903
    tail = tail * q + 0.6366197723675822
    s = q * (whole - edge * tail)
    return s, (s + q * (1 - s) - 0.5 * math.pi * edge) / sigma


def kernel(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, k_s: float, sigma: float
) -> tuple[float, float, float]:
    """f of a single mirror reflection and its derivatives by k_s and sigma."""
    h_x = xi + xr
    h_y = yi + yr
    h_z = zi + zr
    # h is not normalised: n.h = h_z/|h| and h.i = |h|/2.
    sin2 = h_x * h_x + h_y * h_y
    q = sin2 + h_z * h_z
    cos_a = h_z / math.sqrt(q)
    # 1 - cos = sin^2/(1 + cos) keeps the digits of a small angle.
    theta_a = arcvers(sin2 / (q * (1 + cos_a)))
    g = min(1.0, 4 * h_z * min(zi, zr) / q)
    s, d_s = slope_norm(sigma)
    t2 = theta_a * theta_a / (sigma * sigma)
    lobe = exp(-0.5 * t2) / s * g / (8 * math.pi * cos_a * zi * zr)
    return k_s * lobe, lobe, k_s * lobe * (t2 / sigma - d_s / s)


DEG = math.pi / 180

MODEL = Model(
    name="torrance_sparrow",
    title="Torrance-Sparrow, slope-area Gaussian, F = 1",
    reference="Torrance & Sparrow 1967; with the surface of Oren & Nayar 1994, section 3.1",
    parameters=(
        Parameter("k_s", "k_s", "mean Fresnel reflectance of a facet", 0.05, 0.0, 1.0, linear=True),
        Parameter(
            "sigma",
            "σ",
            "spread of the facets' slope angle",
            20 * DEG,
            0.5 * DEG,
            60 * DEG,
            unit="rad",
            scale="log",
            start=(2 * DEG, 50 * DEG),
        ),
    ),
    kernel=kernel,
    claims=Claims(
        isotropic=True,
        # Where G leaves 1, where its two other terms cross, and both at once (45 deg retro).
        seams=(
            (0.0, 0.0, 0.0, 0.0),
            (50 * DEG, 0.0, 30 * DEG, 0.0),
            (30 * DEG, 1.0, 50 * DEG, 1.0),
            (70 * DEG, 0.0, 30 * DEG, math.pi),
            (60 * DEG, 0.0, 60 * DEG, 0.0),
            (45 * DEG, 0.0, 45 * DEG, 0.0),
        ),
        albedo_at_most=("k_s",),
    ),
    validity="Single reflection, k_s constant over angle: a dielectric's Fresnel rise towards "
    "grazing is not in it.",
    lobes=(SlopeAngles(share="k_s", sigma="sigma"),),
)
