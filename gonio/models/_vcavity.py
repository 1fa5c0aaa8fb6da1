"""V-cavities with Lambertian facets: the integrals behind Oren and Nayar's model, without fits.

Three surfaces of Oren & Nayar 1994, section 3, each as the pair (d1, d2) of

    f = rho/pi d1 + rho^2/pi d2,

d1 for light that left after one bounce and d2 after two: `unidirectional` (section 3.1, eqs 4-11),
`single_slope` (section 3.2, eq. 12) and `gaussian` (section 3.3, eq. 13). They depend on the
directions and the slopes only. All are plain Python and `math`, so that they compile.

Facets have slope t and unit normal a, their companions in the cavity a'. In units of cos(theta_i)
and cos(theta_r), lit and seen projections of a facet at azimuth phi are

    S = <s,a> / cos(theta_i) = cos t + sin t tan(theta_i) cos(phi - phi_i)
    V = <v,a> / cos(theta_r) = cos t + sin t tan(theta_r) cos(phi - phi_r)

and those of its companion 2 cos t - S and 2 cos t - V. Corrected (docs/errata.md), eq. (5) is
GAF = min(1, max(0, 2 cos t/S), max(0, 2 cos t/V)): shadow and mask both begin at the valley, so
that what is lit and seen is the smaller of two strips. Then eq. (6), divided by (rho/pi) E0
cos(theta_i), is

    g1 = min(S, V) min(max(S, V), 2 cos t) / cos t        where S > 0 and V > 0

which is trigonometric between the azimuths at which S or V is 0 or 2 cos t, or S = V: its mean
over azimuth, eq. (12), is closed. With W = 2 cos t - S, eqs (10) and (11) are

    g2 = V W IF / (pi cos t)                               where V > 0 and W > 0

IF/pi is half of two crossed strings less two uncrossed ones. The facet's masked width is
m_v = max(0, 1 - 2 cos t/V), the companion's shadowed one m_s = max(0, 1 - 2 cos t/W), and with
tan(theta_r) cos(phi - phi_r) = b and -tan(theta_i) cos(phi - phi_i) = a the strings are

    d(1, m_v) = 2 sin t cos t sqrt(1 + b^2) / V            where V > 2 cos t, else 1
    d(1, m_s) = 2 sin t cos t sqrt(1 + a^2) / W            where W > 2 cos t, else 1
    d(m_v, m_s) = 2 cos t sqrt((sin^2 t a b - cos^2 t)^2 + sin^4 t (a - b)^2) / (V W)   where both

so that g2 needs Gauss-Legendre only where something is shadowed or masked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from gonio.geometry import Directions, FloatArray
from gonio.models.base import Model, Parameter
from gonio.models.torrance_sparrow import slope_norm

# Gauss-Legendre nodes and weights: numpy.polynomial.legendre.leggauss(14) moved to [0, 1].
_SLOPE = (
    (0.006858095651593787, 0.017559730165875875),
    (0.03578255816821324, 0.04007904357987999),
    (0.08639934246511749, 0.060759285343951655),
    (0.15635354759415726, 0.07860158357909681),
    (0.24237568182092295, 0.09276919873896894),
    (0.3404438155360551, 0.10259923186064786),
    (0.44597252564632817, 0.10763192673157897),
    (0.5540274743536718, 0.10763192673157897),
    (0.6595561844639448, 0.10259923186064786),
    (0.757624318179077, 0.09276919873896894),
    (0.8436464524058427, 0.07860158357909681),
    (0.9136006575348825, 0.060759285343951655),
    (0.9642174418317868, 0.04007904357987999),
    (0.9931419043484062, 0.017559730165875875),
)
# Gauss-Legendre on [-1, 1], the positive half of 12 nodes moved towards the ends of their interval
# by x (3 - x^2)/2: the square roots of d(x, y) have branch points just outside of it.
_AZIMUTH = (
    (0.18686806953394536, 0.36785935708331774),
    (0.5268634454464597, 0.3028514904349526),
    (0.7796815051138918, 0.19962955669059895),
    (0.9266740570566924, 0.0977878182783392),
    (0.9866504982381048, 0.029286187810300103),
    (0.9994931194722304, 0.0025855897024910607),
)

# (tan theta_i, tan theta_r, cos dphi, sin dphi, dphi, azimuth and height of the corner S = V = 2,
# and of the corner V = W = 2, heights as 1/tan t); see `_pair`.
Pair = tuple[float, float, float, float, float, float, float, float, float]


def unidirectional(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, slope: float
) -> tuple[float, float]:
    """(d1, d2) of parallel cavities of one slope, eqs (4)-(11) as they stand.

    Parameters
    ----------
    xi, yi, zi, xr, yr, zr : float
        Unit vectors towards the light and towards the viewer, above the horizon. The grooves run
        along y: the azimuth of a facet is 0 or pi.
    slope : float
        Slope theta_a in [0, pi/2), radians.

    Notes
    -----
    Corrected are the GAF and the meaning of the two widths (docs/errata.md). The surface's radiance
    is the mean over both facets; only that mean is reciprocal after two bounces.
    """
    s, c = math.sin(slope), math.cos(slope)
    direct = 0.0
    twice = 0.0
    for sign in (1.0, -1.0):
        lit = sign * s * xi + c * zi
        seen = sign * s * xr + c * zr
        lit_companion = c * zi - sign * s * xi
        if lit > 0 and seen > 0:
            gaf = min(1.0, 2 * zi * c / lit, 2 * zr * c / seen)
            direct += 0.5 * lit * seen / (c * zr * zi) * gaf
        if lit_companion > 0 and seen > 0:
            m_v = max(0.0, 1 - 2 * zr * c / seen)
            m_s = max(0.0, 1 - 2 * zi * c / lit_companion)
            cos_2t = c * c - s * s
            factor = 0.5 * (
                math.sqrt(1 + 2 * m_v * cos_2t + m_v * m_v)
                + math.sqrt(1 + 2 * m_s * cos_2t + m_s * m_s)
                - math.sqrt(max(0.0, m_v * m_v + 2 * m_v * m_s * cos_2t + m_s * m_s))
                - 2 * c
            )
            twice += 0.5 * lit_companion * seen / (c * zr * zi) * factor
    return direct, twice


def single_slope(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, slope: float
) -> tuple[float, float]:
    """(d1, d2) of cavities of one slope in [0, pi/2), all azimuths alike: eq. (12)."""
    return _ring(_pair(xi, yi, zi, xr, yr, zr), math.cos(slope), math.sin(slope), [0.0] * 11)


def gaussian(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, sigma: float
) -> tuple[float, float, float, float]:
    """(d1, d2) of the Gaussian slope-area distribution and their derivatives by sigma: eq. (13).

    Parameters
    ----------
    xi, yi, zi, xr, yr, zr : float
        Unit vectors towards the light and towards the viewer, above the horizon.
    sigma : float
        Spread of the slope in [0, 60 deg], radians; at 0 the surface is flat: (1, 0, 0, 0).

    Notes
    -----
    d = int_0^{pi/2} exp(-t^2/2 sigma^2) sin t g(t) dt / S(sigma), with S of `torrance_sparrow`:
    P is a share of surface area. g has kinks where cavities begin to shadow (t = pi/2 - theta_i),
    to mask (pi/2 - theta_r) and where the corners S = V = 2 cos t and V = W = 2 cos t come in. From
    the first of them on it runs like powers of sqrt(t - kink), hence t = kink + length u^2.

    The nodes do not move with sigma, except that the range ends at 6 to 7.1 sigma in steps: so the
    derivatives are those of the sum, to rounding.
    """
    # Light and viewer may be exchanged. The lower of them as i makes that exact to the bit.
    if zi > zr:
        xi, yi, zi, xr, yr, zr = xr, yr, zr, xi, yi, zi
    if sigma < 1e-6:
        return 1.0, 0.0, 0.0, 0.0
    pair = _pair(xi, yi, zi, xr, yr, zr)
    scratch = [0.0] * 11
    top = min(0.5 * math.pi, 6 * 2 ** (0.25 * math.ceil(4 * math.log2(sigma))))
    high, low = max(pair[6], pair[8]), min(pair[6], pair[8])
    kinks = (
        math.atan2(1.0, pair[0]),
        math.atan2(1.0, pair[1]),
        math.atan2(1.0, high),
        math.atan2(1.0, low),
        top,
    )
    d1 = d2 = e1 = e2 = start = 0.0
    for kink in kinks:
        stop = min(kink, top)
        if stop <= start:
            continue
        for u, weight in _SLOPE:
            if start > 0:
                t = start + (stop - start) * u * u
                share = 2 * weight * u * (stop - start)
            else:
                t = stop * u
                share = weight * stop
            g1, g2 = _ring(pair, math.cos(t), math.sin(t), scratch)
            z = (t / sigma) * (t / sigma)
            share *= math.exp(-0.5 * z) * math.sin(t)
            d1 += share * g1
            d2 += share * g2
            e1 += share * z * g1
            e2 += share * z * g2
        start = stop
    norm, d_norm = slope_norm(sigma)
    d1 /= norm
    d2 = max(0.0, d2 / norm)
    d_norm /= norm
    return d1, d2, e1 / (norm * sigma) - d1 * d_norm, e2 / (norm * sigma) - d2 * d_norm


def shares(
    kernel: Callable[..., tuple[float, ...]],
    theta_i: ArrayLike,
    theta_r: ArrayLike,
    dphi: ArrayLike,
    parameter: float,
    *,
    azimuth: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """d1 and d2 of one of this module's three surfaces for arrays of angles.

    Parameters
    ----------
    kernel : callable
        `unidirectional`, `single_slope` or `gaussian`.
    theta_i, theta_r, dphi : array_like
        Polar angles and azimuth from the light, which is at 0, to the viewer, radians.
    parameter : float
        Slope or sigma, radians.
    azimuth : float
        Azimuth of the facets of `unidirectional`, radians.

    Returns
    -------
    d1, d2 : ndarray
        Common shape of the angles; 0 at and below the horizon.
    """
    w_i, w_r = Directions(theta_i, -azimuth, theta_r, np.asarray(dphi) - azimuth).vectors()
    d1, others = _surface(kernel).gradient(w_i, w_r, np.array([parameter]))
    return d1, others[..., 0]


@cache
def _surface(kernel: Callable[..., tuple[float, ...]]) -> Model:
    """A kernel in the loops of a model, which part a tuple into its first number and the next."""
    angle = Parameter("angle", "", "slope or sigma", 0.3, 0.0, 1.5, unit="rad")
    return Model(kernel.__name__, "", "", (angle,), kernel)


def _pair(xi: float, yi: float, zi: float, xr: float, yr: float, zr: float) -> Pair:
    """What the integrals need of two directions; azimuths count from that of i.

    S = 2 cos t and V = 2 cos t are straight lines in the plane of slopes (tan t, phi), and so are
    V and W. Two of them cross at a corner, which facets reach whose tan t is 1/height or more.
    """
    tan_i = math.sqrt(xi * xi + yi * yi) / zi
    tan_r = math.sqrt(xr * xr + yr * yr) / zr
    dphi = abs(math.atan2(xi * yr - yi * xr, xi * xr + yi * yr))
    across = tan_r * math.sin(dphi)
    along = tan_r * math.cos(dphi)
    apart = math.sqrt((tan_i - along) * (tan_i - along) + across * across)
    joint = math.sqrt((tan_i + along) * (tan_i + along) + across * across)
    # Lines that coincide or are parallel have no corner, and no kink comes of them.
    tie = tan_i * across / apart if apart > 0 else 0.0
    cross = tan_i * across / joint if joint > 0 else 0.0
    return (
        tan_i,
        tan_r,
        math.cos(dphi),
        math.sin(dphi),
        dphi,
        math.atan2(tan_i - along, across),
        tie,
        math.atan2(tan_i + along, -across),
        cross,
    )


def _ring(pair: Pair, c: float, s: float, edges: list[float]) -> tuple[float, float]:
    """Means over azimuth of g1 and g2 for facets of slope (cos, sin) = (c, s).

    `edges` is room for 11 numbers.
    """
    tan_i, tan_r, cos_d, sin_d, dphi, tie, h_tie, cross, h_cross = pair
    x = s * tan_i
    y = s * tan_r
    n = 0
    # Azimuths where S is 0 or 2c, V is 0 or 2c, and of the corners.
    if x > c:
        turn = math.acos(c / x)
        edges[0] = turn
        edges[1] = -turn
        edges[2] = math.pi - turn
        edges[3] = math.pi + turn
        n = 4
    if y > c:
        turn = math.acos(c / y)
        edges[n] = dphi + turn
        edges[n + 1] = dphi - turn
        edges[n + 2] = dphi + math.pi - turn
        edges[n + 3] = dphi + math.pi + turn
        n += 4
    if n == 0:
        # Nothing is shadowed or masked: g1 = S V / c, g2 = W V (1 - c) / c.
        flat = c + 0.5 * s * s / c * tan_i * tan_r * cos_d
        return flat, (1 - c) * (2 * c - flat)
    if s * h_tie > c:
        edges[n] = tie
        n += 1
    if s * h_cross > c:
        edges[n] = cross
        n += 1
    for k in range(n):
        edge = edges[k]
        if edge < 0:
            edge += 2 * math.pi
        elif edge >= 2 * math.pi:
            edge -= 2 * math.pi
        j = k
        while j > 0 and edges[j - 1] > edge:
            edges[j] = edges[j - 1]
            j -= 1
        edges[j] = edge
    edges[n] = edges[0] + 2 * math.pi

    direct = 0.0
    twice = 0.0
    for k in range(n):
        h = 0.5 * (edges[k + 1] - edges[k])
        middle = edges[k] + h
        cos_m = math.cos(middle)
        sin_m = math.sin(middle)
        # Azimuth from that of r.
        cos_n = cos_m * cos_d + sin_m * sin_d
        sin_n = sin_m * cos_d - cos_m * sin_d
        lit = c + x * cos_m
        seen = c + y * cos_n
        if seen <= 0:
            continue
        cos_h = math.cos(h)
        sin_h = math.sin(h)
        int_s = 2 * (c * h + x * sin_h * cos_m)
        int_v = 2 * (c * h + y * sin_h * cos_n)
        int_sv = 2 * c * (c * h + sin_h * (x * cos_m + y * cos_n))
        int_sv += x * y * (h * cos_d + sin_h * cos_h * (cos_m * cos_n - sin_m * sin_n))
        if lit > 0:
            if max(lit, seen) <= 2 * c:
                direct += int_sv / c
            elif lit < seen:
                direct += 2 * int_s
            else:
                direct += 2 * int_v
        if lit >= 2 * c:
            continue
        if seen <= 2 * c and lit >= 0:
            twice += (1 - c) * (2 * int_v - int_sv / c)
        else:
            a = (-tan_i * cos_m, tan_i * sin_m)
            b = (tan_r * cos_n, -tan_r * sin_n)
            twice += _strings(a, b, sin_h / (1 + cos_h), c, s, seen > 2 * c, lit < 0)
    return direct / (2 * math.pi), twice / (2 * math.pi)


def _strings(
    even_odd_a: tuple[float, float],
    even_odd_b: tuple[float, float],
    reach: float,
    c: float,
    s: float,
    masked: bool,
    shadowed: bool,
) -> float:
    """Integral of g2 over an interval of azimuth in which the facet is masked or shadowed or both.

    In z = tan((phi - middle)/2), |z| < `reach`, cosine and sine are rational.
    """
    a_even, a_odd = even_odd_a
    b_even, b_odd = even_odd_b
    total = 0.0
    for node, weight in _AZIMUTH:
        z = reach * node
        half = 1 / (1 + z * z)
        even = (1 - z * z) * half
        odd = 2 * z * half
        both = 0.0
        for sign in (1.0, -1.0):
            a = a_even * even + sign * a_odd * odd
            b = b_even * even + sign * b_odd * odd
            v = c + s * b
            w = c + s * a
            if not shadowed:
                both += w * (s * math.sqrt(1 + b * b) + 1 - v)
            elif not masked:
                both += v * (s * math.sqrt(1 + a * a) + 1 - w)
            else:
                p = s * s * a * b - c * c
                q = s * s * (a - b)
                both += s * w * math.sqrt(1 + b * b) + s * v * math.sqrt(1 + a * a)
                both -= math.sqrt(p * p + q * q) + v * w
        total += 2 * weight * half * both
    return reach * total
