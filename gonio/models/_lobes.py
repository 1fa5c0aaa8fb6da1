"""The lobes that the models draw from, beside the cosine of `sampling`.

Each is the shape of one model's lobe, in that model's letters: a record in a model file says which
of the model's parameters they are. Densities of normals h integrate to 1 over the hemisphere, those
of visible facets over the facets that the light sees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gonio.geometry import HORIZON, FloatArray, angles, equal_area, from_equal_area, unit_vectors
from gonio.models.sampling import NADIR, Facets, Lobe, Named


@dataclass(frozen=True, kw_only=True)
class GaussianSlopes(Facets):
    """Half vectors of Ward's eq. (5a), and of Beckmann's D cos delta.

    delta = arctan {-ln(u_1) / [cos^2(phi)/alpha_x^2 + sin^2(phi)/alpha_y^2]}^(1/2)
    phi   = atan2[alpha_y sin(2 pi u_2), alpha_x cos(2 pi u_2)]
    pdf(h) = exp{-tan^2(delta) [cos^2(phi)/alpha_x^2 + sin^2(phi)/alpha_y^2]}
             / [pi alpha_x alpha_y cos^3(delta)]

    Ward 1992, eqs (7a) and (7b), corrected: in print (7a) lacks its arctangent, and that of (7b)
    must be told the quadrant (docs/errata.md).
    """

    alpha_x: str
    alpha_y: str

    def normals(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        ax, ay = p[self.alpha_x], p[self.alpha_y]
        phi = np.arctan2(ay * np.sin(2 * np.pi * u[1]), ax * np.cos(2 * np.pi * u[1]))
        width = np.cos(phi) ** 2 / ax**2 + np.sin(phi) ** 2 / ay**2
        return unit_vectors(np.arctan(np.sqrt(-np.log(1 - u[0]) / width)), phi)

    def normal_density(self, p: Named, w_i: FloatArray, h: FloatArray) -> FloatArray:
        ax, ay = p[self.alpha_x], p[self.alpha_y]
        x, y, z = h.T
        slopes = (x / (ax * z)) ** 2 + (y / (ay * z)) ** 2
        return np.asarray(np.exp(-slopes) / (np.pi * ax * ay * z**3))


@dataclass(frozen=True, kw_only=True)
class EqualAreaGaussian(Facets):
    """Half vectors of Ward's eq. (5b): a Gaussian in the equal-area map.

    2 [(h.x/alpha_x)^2 + (h.y/alpha_y)^2]/(1 + h.n) = (X/alpha_x)^2 + (Y/alpha_y)^2 where
    (X, Y) = sqrt(2) (h.x, h.y)/sqrt(1 + h.n), and dX dY is a solid angle, so that
    pdf(h) = exp[-(X/alpha_x)^2 - (Y/alpha_y)^2] / (pi alpha_x alpha_y).
    """

    alpha_x: str
    alpha_y: str

    def normals(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        radius, psi = np.sqrt(-0.5 * np.log(1 - u[0])), 2 * np.pi * u[1]
        x, y = p[self.alpha_x] * radius * np.cos(psi), p[self.alpha_y] * radius * np.sin(psi)
        return from_equal_area(x, y)

    def normal_density(self, p: Named, w_i: FloatArray, h: FloatArray) -> FloatArray:
        ax, ay = p[self.alpha_x], p[self.alpha_y]
        x, y = equal_area(h)
        return np.asarray(np.exp(-2 * ((x / ax) ** 2 + (y / ay) ** 2)) / (np.pi * ax * ay))


@dataclass(frozen=True, kw_only=True)
class TrowbridgeReitz(Facets):
    """Half vectors of D cos delta, D = c^2 / {pi [(n.h)^2 (c^2 - 1) + 1]^2}.

    tan^2(delta) = c^2 u/(1 - u): Walter et al. 2007, eq. (35), with c for alpha.
    """

    c: str

    def normals(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        return unit_vectors(np.arctan(p[self.c] * np.sqrt(u[0] / (1 - u[0]))), 2 * np.pi * u[1])

    def normal_density(self, p: Named, w_i: FloatArray, h: FloatArray) -> FloatArray:
        c2, (x, y, z) = p[self.c] ** 2, h.T
        # (n.h)^2 (c^2 - 1) + 1 without the difference of near equals at small c.
        t = x * x + y * y + c2 * z * z
        return np.asarray(c2 * z / (np.pi * t * t))


@dataclass(frozen=True, kw_only=True)
class VisibleFacets(Facets):
    """GGX normals as the light sees them: pdf(h) = G_1 D (h.i)/cos(theta_i).

    Stretched to alpha = 1 they are h = i + c with c even over the cap of the unit sphere above -i.z
    (Dupuy & Benyoub 2023, Sampling Visible GGX Normals with Spherical Caps). The weight
    F G_2/G_1 is at most 1.
    """

    alpha_x: str
    alpha_y: str

    def normals(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        stretch = np.array([p[self.alpha_x], p[self.alpha_y], 1.0])
        i = _normalised(stretch * w_i)
        z = (1 - u[0]) * (1 + i[:, 2]) - i[:, 2]
        rim, phi = np.sqrt(np.maximum(1 - z * z, 0)), 2 * np.pi * u[1]
        return _normalised(stretch * (i + np.stack([rim * np.cos(phi), rim * np.sin(phi), z], -1)))

    def normal_density(self, p: Named, w_i: FloatArray, h: FloatArray) -> FloatArray:
        ax, ay = p[self.alpha_x], p[self.alpha_y]
        x, y, z = h.T
        t = (x / ax) ** 2 + (y / ay) ** 2 + z * z
        d = 1 / (np.pi * ax * ay * t * t)
        # G_1/cos(theta_i) = 2/(i.z + S)
        s = np.sqrt((ax * w_i[:, 0]) ** 2 + (ay * w_i[:, 1]) ** 2 + w_i[:, 2] ** 2)
        return np.asarray(2 * d * np.sum(h * w_i, axis=-1) / (w_i[:, 2] + s))


@dataclass(frozen=True, kw_only=True)
class SlopeAngles(Facets):
    """Half vectors whose angle theta_a to the normal has the density P(theta_a) sin(theta_a).

    P = exp(-theta_a^2/2 sigma^2)/S(sigma) on [0, pi/2], pdf(h) = P/(2 pi). The distribution is
    inverted by Newton's steps; it is an error function of a complex argument,
    int exp(-t^2/2 sigma^2) sin t dt = sigma (pi/2)^(1/2) exp(-sigma^2/2)
                                       Im erf[(t - i sigma^2)/(2^(1/2) sigma)].
    """

    sigma: str

    def normals(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        sigma = p[self.sigma]
        total = slopes_below(HORIZON, sigma)
        # Where sin t is t the distribution has an inverse; it is the start.
        t = sigma * np.sqrt(-2 * np.log1p(u[0] * np.expm1(-0.5 * (HORIZON / sigma) ** 2)))
        for _ in range(6):
            slope = np.exp(-0.5 * (t / sigma) ** 2) * np.sin(t)
            step = (slopes_below(t, sigma) - u[0] * total) / np.where(slope > 0, slope, 1.0)
            t = np.clip(t - step, 0.5 * t, 0.5 * (t + HORIZON))
        return unit_vectors(t, 2 * np.pi * u[1])

    def normal_density(self, p: Named, w_i: FloatArray, h: FloatArray) -> FloatArray:
        sigma = p[self.sigma]
        theta_a = angles(h)[0]
        norm = 2 * np.pi * slopes_below(HORIZON, sigma)
        return np.asarray(np.exp(-0.5 * (theta_a / sigma) ** 2) / norm)


def slopes_below(t: ArrayLike, sigma: float) -> FloatArray:
    """int_0^t exp(-s^2/2 sigma^2) sin s ds."""
    from scipy.special import erf

    scale = math.sqrt(2) * sigma
    ends = [erf((np.asarray(x) - 1j * sigma**2) / scale).imag for x in (t, 0.0)]
    factor = sigma * math.sqrt(math.pi / 2) * math.exp(-0.5 * sigma**2)
    return np.asarray(factor * (ends[0] - ends[1]))


@dataclass(frozen=True, kw_only=True)
class AnisotropicPhong(Facets):
    """Half vectors of Ashikhmin and Shirley's lobe, as they draw them (2000).

    tan(phi)   = [(n_u + 1)/(n_v + 1)]^(1/2) tan(2 pi u_2), in the quadrant of 2 pi u_2
    cos(theta) = u_1^{1/[n_u cos^2(phi) + n_v sin^2(phi) + 1]}
    pdf(h) = [(n_u + 1)(n_v + 1)]^(1/2)/(2 pi) (n.h)^[n_u cos^2(phi) + n_v sin^2(phi)]

    In print the arctangent knows one quadrant, into which u_2 is folded from the four.
    """

    n_u: str
    n_v: str

    def normals(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        n_u, n_v = p[self.n_u], p[self.n_v]
        psi = 2 * np.pi * u[1]
        phi = np.arctan2(math.sqrt(n_u + 1) * np.sin(psi), math.sqrt(n_v + 1) * np.cos(psi))
        log = np.log(1 - u[0]) / (n_u * np.cos(phi) ** 2 + n_v * np.sin(phi) ** 2 + 1)
        # sin^2 = 1 - cos^2 without the difference of near equals at large exponents.
        return unit_vectors(np.arctan2(np.sqrt(-np.expm1(2 * log)), np.exp(log)), phi)

    def normal_density(self, p: Named, w_i: FloatArray, h: FloatArray) -> FloatArray:
        n_u, n_v = p[self.n_u], p[self.n_v]
        x, y, z = h.T
        phi = np.arctan2(y, x)
        exponent = n_u * np.cos(phi) ** 2 + n_v * np.sin(phi) ** 2
        # Near the normal ln(n.h) from the sine, which has more digits there.
        log = np.where(z < 0.7, np.log(z), 0.5 * np.log1p(-np.minimum(x * x + y * y, 0.6)))
        norm = math.sqrt((n_u + 1) * (n_v + 1)) / (2 * math.pi)
        return np.asarray(norm * np.exp(exponent * log))


@dataclass(frozen=True, kw_only=True)
class AboutMirror(Lobe):
    """Phong's lobe about R = 2 (n.i) n - i: pdf(r) = (n + 1)/(2 pi) max(0, R.r)^n."""

    n: str

    def draw(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        log = np.log(1 - u[0]) / (p[self.n] + 1)
        cos, sin, psi = np.exp(log), np.sqrt(-np.expm1(2 * log)), 2 * np.pi * u[1]
        a, b, mirror = _frame(w_i * np.array([-1.0, -1.0, 1.0]))
        across = np.cos(psi)[:, None] * a + np.sin(psi)[:, None] * b
        return np.asarray(sin[:, None] * across + cos[:, None] * mirror)

    def density(self, p: Named, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
        n = p[self.n]
        cos = w_i[:, 2] * w_r[:, 2] - w_i[:, 0] * w_r[:, 0] - w_i[:, 1] * w_r[:, 1]
        return np.asarray((n + 1) / (2 * np.pi) * np.maximum(cos, 0) ** n)


@dataclass(frozen=True, kw_only=True)
class AboutMirrorProjection(Lobe):
    """Projections beta of w_r on the surface about that of the mirror direction, as `abg` falls.

    pdf(beta) = (x_0^2 + x^2)^(-g/2)/norm for x = |beta - beta_0| below 1 + sin(theta_i), with
    x_0 = B^(1/g); pdf(r) = pdf(beta) cos(theta_r). With L = ln(1 + x^2/x_0^2) and m = 1 - g/2 the
    distribution of x is [exp(m L) - 1]/[exp(m L_max) - 1]. A beta beyond the unit circle is lost.
    """

    B: str
    g: str

    def draw(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        m, square, most = self._shape(p, w_i)
        level = u[0] * most if m == 0 else np.log1p(u[0] * np.expm1(m * most)) / m
        x, psi = np.sqrt(square * np.expm1(level)), 2 * np.pi * u[1]
        beta = np.stack([x * np.cos(psi), x * np.sin(psi)], -1) - w_i[:, :2]
        z2 = 1 - np.sum(beta**2, axis=-1)
        w_r = np.column_stack([beta, np.sqrt(np.maximum(z2, 0.0))])
        return np.where((z2 > 0)[:, None], w_r, NADIR)

    def density(self, p: Named, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
        m, square, most = self._shape(p, w_i)
        x2 = np.sum((w_i[:, :2] + w_r[:, :2]) ** 2, axis=-1)
        level = np.log1p(x2 / square)
        by_level = 1 / most if m == 0 else m * np.exp(m * level) / np.expm1(m * most)
        return np.asarray(by_level / (np.pi * (square + x2)) * w_r[:, 2])

    def _shape(self, p: Named, w_i: FloatArray) -> tuple[float, float, FloatArray]:
        """m, x_0^2 and L_max (n,)."""
        square = p[self.B] ** (2 / p[self.g])
        reach = 1 + np.hypot(w_i[:, 0], w_i[:, 1])
        return 1 - p[self.g] / 2, square, np.log1p(reach**2 / square)


def schlick(f_0: float, cos_i: FloatArray) -> FloatArray:
    """About what facets reflect of light from theta_i; f_0 is their reflectance at 0.

    Never below 0.01: facets turned away from the light reflect more than those that face it, and
    what they reflect must be drawn.
    """
    return np.maximum(f_0 + (1 - f_0) * (1 - cos_i) ** 5, 0.01)


def at_normal(eta: float, kappa: float = 0.0) -> float:
    """Fresnel's reflectance at normal incidence for the index eta + i kappa."""
    return ((eta - 1) ** 2 + kappa**2) / ((eta + 1) ** 2 + kappa**2)


def _normalised(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _frame(z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Two unit vectors across each unit vector (n, 3) above the horizon, and itself."""
    x, y, w = z.T
    c = 1 / (1 + w)
    a = np.stack([1 - x * x * c, -x * y * c, -x], -1)
    b = np.stack([-x * y * c, 1 - y * y * c, -y], -1)
    return a, b, z
