"""Rough plastic: a GGX dielectric interface over a diffuse base, with the light between them.

f = D F G_2 / (4 cos theta_i cos theta_r)
    + rho T(theta_i) T(theta_r) / {pi eta^2 [1 - rho F_int]}

D, G_2: GGX with Smith's masking of correlated heights, as in `ggx` with alpha_x = alpha_y = alpha
F: Fresnel's reflectance of a dielectric of index eta at the angle between i and the half vector
T(theta) = 1 - <F>: light that the interface lets in, <F> the mean of F(i.h) over the facets that i
sees, weighted as it sees them (density D G_1 (i.h)/cos theta)
F_int = 1 - (1 - F_mean)/eta^2, F_mean = 2 int <F> cos theta d(cos theta): what the interface throws
back of diffuse light from below

Light enters with T(theta_i), is scattered by the base and thrown back by the interface any number
of times, and leaves with T(theta_r)/eta^2, the radiance being spread by refraction: the model is
reciprocal. F_int follows from T by the balance of energy, so that at rho = 1 the diffuse part
returns exactly what was let in. The albedo is at most 1: the lobe reflects less than <F>, for light
that meets a second facet is lost (3 % of all at normal incidence for alpha = 0.5, eta = 1.5). As
alpha -> 0 the diffuse part becomes that of a smooth plastic, T = 1 - F(cos theta).

Renderers take T and F_int from tables. Here <F> is a sum over 48 facets, exact to 2e-4, and F_mean
a polynomial for the average of that sum.
"""

from __future__ import annotations

import math

from gonio.geometry import FloatArray
from gonio.models._lobes import VisibleFacets, at_normal, schlick
from gonio.models._microfacet import fresnel_dielectric, ggx, ggx_smith
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine, Named

# Facets seen by i: stretched to alpha = 1 they are h = i + c with c even over the cap of the unit
# sphere above -i.z (Dupuy & Benyoub 2023). Gauss-Legendre nodes x, y in (0, 1), crowded where i.h
# is small: the height on the cap is x^2 with weight 2 x w, the azimuth is pi (1 - y^2) with 2 y w,
# of which the cosine is kept. From numpy.polynomial.legendre.leggauss(8) and (6).
HEIGHT = (
    0.0003942238742465675,
    0.01033613035184579,
    0.05627987350995162,
    0.1666947457690518,
    0.3501293882647015,
    0.5818122834262806,
    0.8070026077654725,
    0.9606840803717828,
)
HEIGHT_WEIGHT = (
    0.00200989985131762,
    0.02260875954590313,
    0.07442181813145629,
    0.1480775066176911,
    0.2146062767606705,
    0.2392848277464306,
    0.1997722749074713,
    0.09921863643905944,
)
COS_AZIMUTH = (
    -0.9999935857069374,
    -0.9959394850338151,
    -0.8981309521767329,
    -0.357748909217686,
    0.5618343171877811,
    0.9783276862542761,
)
AZIMUTH_WEIGHT = (
    0.005784813099631881,
    0.06111131733618723,
    0.1781303461739846,
    0.2897835883987064,
    0.2996502557119515,
    0.1655396792795384,
)
# F_mean in powers of 2 sqrt(alpha) - 1 (rows) and of (eta - 1.6)/0.4 (columns), from the Chebyshev
# interpolant of the sum over 120 values of cos theta. Its error is 4e-6, and 5e-6 is taken off the
# first number, so that the interface never lets out more than it let in.
F_MEAN = (
    (0.093611630, 0.057259113, -0.001770861, 0.000027030, -0.000187028, 0.000210970, -0.000102734),
    (-0.013507562, -0.000391213, 0.002199104, -0.001002969, 0.000385230, -0.000219177, 0.000093928),
    (0.015728066, -0.000619298, -0.001487714, 0.000752075, -0.000353785, 0.000393353, -0.000226321),
    (0.005030221, 0.001257938, -0.002060904, 0.000925892, -0.000324227, -0.000038429, 0.000091280),
    (-0.012001028, 0.000144318, 0.001880725, -0.000975650, 0.000465871, -0.000412911, 0.000213639),
    (0.009944288, -0.001654361, 0.000156673, -0.000010012, -0.000084013, 0.000524022, -0.000380910),
    (-0.001765753, 0.000822359, -0.001086270, 0.000575593, -0.000262955, 0.000040006, 0.000030773),
    (-0.009862548, 0.000958130, 0.000859543, -0.000470145, 0.000270747, -0.000544237, 0.000358248),
    (0.007953668, -0.000807146, -0.000159335, 0.000061018, -0.000037533, 0.000233429, -0.000174797),
    (0.002604091, -0.000195874, -0.000402105, 0.000214926, -0.000114702, 0.000180849, -0.000113609),
    (-0.003076857, 0.000223224, 0.000249732, -0.000120804, 0.000059535, -0.000115501, 0.000076845),
)


def seen(x: float, y: float, z: float, alpha: float, eta: float) -> tuple[float, float, float]:
    """<F>, the mean reflectance of the facets that a direction sees, and d<F>/dalpha, d<F>/deta."""
    s2 = x * x + y * y
    s = math.sqrt(s2)
    # The direction stretched by alpha, (i_x, 0, i_z), and its derivatives by alpha.
    k = math.sqrt(z * z + alpha * alpha * s2)
    i_x = alpha * s / k
    i_z = z / k
    di_x = s * z * z / (k * k * k)
    di_z = -z * alpha * s2 / (k * k * k)
    mean = by_alpha = by_eta = 0.0
    for j in range(len(HEIGHT)):
        c_z = HEIGHT[j] * (1 + i_z) - i_z
        rim = math.sqrt(1 - c_z * c_z)
        d_rim = c_z * (1 - HEIGHT[j]) * di_z / rim
        h_z = c_z + i_z
        dh_z = HEIGHT[j] * di_z
        for n in range(len(COS_AZIMUTH)):
            cos = COS_AZIMUTH[n]
            h_x = rim * cos + i_x
            dh_x = d_rim * cos + di_x
            # Unstretched the normal is (alpha h_x, alpha h_y, h_z).
            across = h_x * h_x + rim * rim * (1 - cos * cos)
            d_across = 2 * (h_x * dh_x + rim * d_rim * (1 - cos * cos))
            l2 = alpha * alpha * across + h_z * h_z
            d_l2 = 2 * alpha * across + alpha * alpha * d_across + 2 * h_z * dh_z
            dot = alpha * h_x * s + h_z * z
            d_dot = (h_x + alpha * dh_x) * s + dh_z * z
            length = math.sqrt(l2)
            f, f_c, f_eta = fresnel_dielectric(dot / length, eta)
            weight = HEIGHT_WEIGHT[j] * AZIMUTH_WEIGHT[n]
            mean += weight * f
            by_alpha += weight * f_c * (d_dot - 0.5 * dot * d_l2 / l2) / length
            by_eta += weight * f_eta
    return mean, by_alpha, by_eta


def seen_mean(alpha: float, eta: float) -> tuple[float, float, float]:
    """F_mean, <F> averaged over diffuse light, and its derivatives by alpha and eta."""
    root = math.sqrt(alpha)
    t = 2 * root - 1
    e = (eta - 1.6) / 0.4
    value = by_t = by_e = 0.0
    for k in range(len(F_MEAN) - 1, -1, -1):
        row = row_e = 0.0
        for j in range(len(F_MEAN[0]) - 1, -1, -1):
            row_e = row_e * e + row
            row = row * e + F_MEAN[k][j]
        by_t = by_t * t + value
        value = value * t + row
        by_e = by_e * t + row_e
    return value, by_t / root, by_e / 0.4


def kernel(
    xi: float,
    yi: float,
    zi: float,
    xr: float,
    yr: float,
    zr: float,
    rho: float,
    alpha: float,
    eta: float,
) -> tuple[float, float, float, float]:
    """f and its derivatives by rho, alpha, eta."""
    h_x = xi + xr
    h_y = yi + yr
    h_z = zi + zr
    d, d_x, d_y = ggx(h_x, h_y, h_z, alpha, alpha)
    s_i, s_ix, s_iy = ggx_smith(xi, yi, zi, alpha, alpha)
    s_r, s_rx, s_ry = ggx_smith(xr, yr, zr, alpha, alpha)
    v = zr * s_i + zi * s_r
    c = 0.5 * math.sqrt(h_x * h_x + h_y * h_y + h_z * h_z)
    fresnel, _, fresnel_eta = fresnel_dielectric(c, eta)
    facets = d / (2 * v)
    lobe = fresnel * facets
    lobe_alpha = lobe * (d_x + d_y - (zr * (s_ix + s_iy) + zi * (s_rx + s_ry)) / v)

    f_i, f_i_alpha, f_i_eta = seen(xi, yi, zi, alpha, eta)
    f_r, f_r_alpha, f_r_eta = seen(xr, yr, zr, alpha, eta)
    mean, mean_alpha, mean_eta = seen_mean(alpha, eta)
    through = (1 - f_i) * (1 - f_r)
    through_alpha = -(f_i_alpha * (1 - f_r) + (1 - f_i) * f_r_alpha)
    through_eta = -(f_i_eta * (1 - f_r) + (1 - f_i) * f_r_eta)
    # eta^2 (1 - rho F_int) = eta^2 (1 - rho) + rho (1 - F_mean)
    series = eta * eta * (1 - rho) + rho * (1 - mean)
    base = through / (math.pi * series)
    base_rho = base * eta * eta / series
    base_alpha = (through_alpha + through * rho * mean_alpha / series) / (math.pi * series)
    by_eta = 2 * eta * (1 - rho) - rho * mean_eta
    base_eta = (through_eta - through * by_eta / series) / (math.pi * series)
    return (
        lobe + rho * base,
        base_rho,
        lobe_alpha + rho * base_alpha,
        fresnel_eta * facets + rho * base_eta,
    )


def mirrored(p: Named, cos_i: FloatArray) -> FloatArray:
    """About the albedo of the interface."""
    return schlick(at_normal(p["eta"]), cos_i)


MODEL = Model(
    name="rough_plastic",
    title="Rough plastic, GGX interface over a diffuse base",
    reference="after Walter et al. 2007 and Jakob 2010, Mitsuba's roughplastic; the transmittance "
    "over visible facets and the balance of energy are derived here",
    parameters=(
        Parameter("rho", "ρ", "reflectance of the base", 0.5, 0.0, 1.0),
        Parameter(
            "alpha",
            "α",
            "roughness of the interface",
            0.1,
            0.005,
            1.0,
            scale="log",
            start=(0.02, 0.8),
        ),
        Parameter("eta", "η", "refractive index", 1.5, 1.2, 2.0, start=(1.3, 1.8)),
    ),
    kernel=kernel,
    claims=Claims(isotropic=True, albedo_at_most=()),
    validity="Albedo at most 1. The base scatters evenly below the interface and nothing is "
    "absorbed on the way; light that meets two facets from outside is lost.",
    lobes=(
        Cosine(share="rho"),
        VisibleFacets(share=mirrored, alpha_x="alpha", alpha_y="alpha"),
    ),
)
