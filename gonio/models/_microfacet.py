"""What the microfacet models share: Fresnel's formulas, V-cavities and the GGX distribution.

Half vectors are H = i + r, not normalised: with q = H.H the cosine of the facet's normal is
n.h = H.z/sqrt(q) and that of the angle on the facet is i.h = sqrt(q)/2.
"""

from __future__ import annotations

import math


def fresnel_dielectric(c: float, eta: float) -> tuple[float, float, float]:
    """Reflectance of a smooth dielectric for unpolarised light, and its derivatives by c and eta.

    Parameters
    ----------
    c : float
        Cosine of the angle of incidence, in (0, 1].
    eta : float
        Refractive index, real, 1 or more.

    Notes
    -----
    F = (g - c)^2 / 2 (g + c)^2 {1 + [c (g + c) - 1]^2 / [c (g - c) + 1]^2}, g^2 = eta^2 + c^2 - 1
    as in Cook & Torrance 1982.

    Examples
    --------
    >>> round(fresnel_dielectric(1.0, 1.5)[0], 12)
    0.04
    """
    g = math.sqrt(eta * eta - 1 + c * c)
    a = (g - c) / (g + c)
    n = c * (g + c) - 1
    d = c * (g - c) + 1
    b = n / d
    # F = a^2 (1 + b^2)/2, first by g and by c as if they were independent.
    by_a = a * (1 + b * b) * 2 / ((g + c) * (g + c))
    by_b = a * a * b / (d * d)
    by_g = by_a * c + by_b * 2 * c * (1 - c * c)
    by_c = by_b * ((g + 2 * c) * d - (g - 2 * c) * n) - by_a * g
    return 0.5 * a * a * (1 + b * b), by_c + by_g * c / g, by_g * eta / g


def fresnel_conductor(c: float, eta: float, kappa: float) -> tuple[float, float, float]:
    """Reflectance for the complex index m = eta + i kappa, and its derivatives by eta and kappa.

    Parameters
    ----------
    c : float
        Cosine of the angle of incidence, in (0, 1].
    eta, kappa : float
        Refractive index and extinction coefficient, kappa 0 or more; a dielectric at kappa = 0.

    Notes
    -----
    r_s = (c - w)/(c + w), r_p = (m^2 c - w)/(m^2 c + w), w^2 = m^2 - 1 + c^2, and
    F = (|r_s|^2 + |r_p|^2)/2. Both r are holomorphic in m, so one complex derivative gives both
    real ones. Written in real numbers, which become SIMD code where complex ones do not.

    Examples
    --------
    >>> round(fresnel_conductor(1.0, 1.5, 0.0)[0], 12)
    0.04
    """
    m2_re = eta * eta - kappa * kappa
    m2_im = 2 * eta * kappa
    a = m2_re - 1 + c * c
    size = math.sqrt(a * a + m2_im * m2_im)
    # w = u + i v with v >= 0; the smaller part by 2 u v = Im(m^2), which does not cancel.
    large = math.sqrt(0.5 * (size + abs(a)))
    small = 0.5 * m2_im / (large if large > 0.0 else 1.0)
    u = large if a >= 0.0 else small
    v = small if a >= 0.0 else large
    # w = 0 is the critical angle of a medium with eta < 1 and kappa = 0: no derivative there.
    over = 1 / (size if size > 0.0 else 1.0)
    dw_re = (eta * u + kappa * v) * over  # dw/dm = m/w
    dw_im = (kappa * u - eta * v) * over
    s2, s_re, s_im = _amplitude(c, 0.0, u, v, 0.0, 0.0, dw_re, dw_im)
    t_re, t_im = 2 * c * eta, 2 * c * kappa
    p2, p_re, p_im = _amplitude(c * m2_re, c * m2_im, u, v, t_re, t_im, dw_re, dw_im)
    return 0.5 * (s2 + p2), s_re + p_re, -(s_im + p_im)


def _amplitude(
    t_re: float,
    t_im: float,
    u: float,
    v: float,
    dt_re: float,
    dt_im: float,
    dw_re: float,
    dw_im: float,
) -> tuple[float, float, float]:
    """|r|^2 and conj(r) dr/dm, real and imaginary, for r = (t - w)/(t + w) and w = u + i v."""
    d_re, d_im = t_re - u, t_im - v
    s_re, s_im = t_re + u, t_im + v
    over = 1 / (s_re * s_re + s_im * s_im)
    # dr/dm = 2 n/s^2 with n = w dt - t dw, and conj(r)/s^2 = conj(d s)/|s|^4.
    n_re = u * dt_re - v * dt_im - (t_re * dw_re - t_im * dw_im)
    n_im = u * dt_im + v * dt_re - (t_re * dw_im + t_im * dw_re)
    e_re = d_re * s_re - d_im * s_im
    e_im = -(d_re * s_im + d_im * s_re)
    k = 2 * over * over
    return (
        (d_re * d_re + d_im * d_im) * over,
        k * (n_re * e_re - n_im * e_im),
        k * (n_re * e_im + n_im * e_re),
    )


def v_cavities(h_z: float, q: float, zi: float, zr: float) -> float:
    """Shadowing and masking by V-cavities: min[1, 2 (n.h)(n.i)/(h.i), 2 (n.h)(n.r)/(h.r)]."""
    return min(1.0, 4 * h_z * min(zi, zr) / q)


def ggx(
    h_x: float, h_y: float, h_z: float, alpha_x: float, alpha_y: float
) -> tuple[float, float, float]:
    """GGX density D of facet normals along H, and the derivatives of ln D by alpha_x and alpha_y.

    Notes
    -----
    D = 1 / {pi alpha_x alpha_y [(h.x/alpha_x)^2 + (h.y/alpha_y)^2 + (h.n)^2]^2}, and the integral
    of D h.n over the hemisphere is 1 (Walter et al. 2007, eq. (33), with two slopes).
    """
    u2 = h_x * h_x / (alpha_x * alpha_x)
    v2 = h_y * h_y / (alpha_y * alpha_y)
    t = u2 + v2 + h_z * h_z
    q = h_x * h_x + h_y * h_y + h_z * h_z
    return (
        q * q / (math.pi * alpha_x * alpha_y * t * t),
        (4 * u2 / t - 1) / alpha_x,
        (4 * v2 / t - 1) / alpha_y,
    )


def ggx_smith(
    x: float, y: float, z: float, alpha_x: float, alpha_y: float
) -> tuple[float, float, float]:
    """S = z (1 + 2 Lambda) of Smith's masking for GGX, and its derivatives by alpha_x and alpha_y.

    Notes
    -----
    S^2 = z^2 + (alpha_x x)^2 + (alpha_y y)^2. G_1 = 2 z/(z + S), and with correlated heights
    G_2 = 2 zi zr/(zr S_i + zi S_r) (Heitz 2014, eq. (99)).
    """
    s = math.sqrt(z * z + alpha_x * alpha_x * x * x + alpha_y * alpha_y * y * y)
    return s, alpha_x * x * x / s, alpha_y * y * y / s
