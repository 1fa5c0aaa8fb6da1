"""Light traced through V-cavities, to check the formulas of the models on one.

Nothing of the theory is in here but the shape of the surface: a photon enters through the mouth of
a cavity, meets facets where its straight path crosses them, is scattered or mirrored there, and
goes on until it leaves. Shadows, masks and interreflections come of themselves. A photon that meets
a diffuse facet is counted towards each viewer with the density that the facet sends there, if the
straight path to him is free ("next-event estimation"), so that f needs no bins.

All facets return all light. Bounce k is counted by itself: a surface of facets of reflectance rho
has f = sum_k rho^k f_k.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gonio.errors import ConfigurationError
from gonio.geometry import HORIZON, FloatArray, unit_vectors
from gonio.kernels.scalar import compiled

ORDERS = ("direct", "second", "higher")


@dataclass(frozen=True)
class Traced:
    """What became of the photons.

    Parameters
    ----------
    f, f_stderr : ndarray, shape (3, n)
        BRDF in sr^-1 towards each of n viewers by one, two and more bounces (`ORDERS`), all facets
        of reflectance 1, and its standard error. Zero for mirror facets, whose f has no density.
    by_bounce : ndarray, shape (n_bounces + 1, n)
        BRDF towards each viewer by exactly k bounces, row 0 being empty.
    escaped, mean_cosine : ndarray, shape (n_bounces + 1,)
        Share of the photons that left after exactly k bounces, and the sum of their cos(theta_r)
        as a share of all photons: int f_k cos dw and int f_k cos^2 dw.
    trapped : float
        Share that had not left after the last bounce.
    photons : int
        Number of photons.
    """

    f: FloatArray
    f_stderr: FloatArray
    by_bounce: FloatArray
    escaped: FloatArray
    mean_cosine: FloatArray
    trapped: float
    photons: int

    def total(self, rho: float) -> FloatArray:
        """f in sr^-1, shape (n,), of all bounces for facets of reflectance `rho`."""
        result: FloatArray = rho ** np.arange(len(self.by_bounce)) @ self.by_bounce
        return result


def gaussian_slopes(sigma: float) -> Callable[[np.random.Generator, int], FloatArray]:
    """Sampler of slopes with density exp(-t^2/2 sigma^2) sin t on [0, pi/2]: eq. (13) of Oren &
    Nayar 1994, a share of surface area.

    Examples
    --------
    >>> slopes = gaussian_slopes(0.3)(np.random.default_rng(1), 1000)
    >>> bool(slopes.min() > 0), bool(slopes.max() < np.pi / 2)
    (True, True)
    """

    def sample(rng: np.random.Generator, n: int) -> FloatArray:
        kept: list[FloatArray] = []
        count = 0
        while count < n:
            # t exp(-t^2/2 sigma^2) below pi/2 by inversion, of which the share sin(t)/t is kept.
            top = -math.expm1(-0.5 * (HORIZON / sigma) ** 2)
            t = sigma * np.sqrt(-2 * np.log1p(-top * rng.random(n)))
            t = t[rng.random(n) < np.sinc(t / np.pi)]
            kept.append(t)
            count += len(t)
        return np.concatenate(kept)[:n]

    return sample


def trace(
    theta_i: float,
    theta_r: ArrayLike,
    dphi: ArrayLike,
    slopes: Callable[[np.random.Generator, int], FloatArray] | float,
    rng: np.random.Generator,
    *,
    photons: int = 100_000,
    azimuth: float | None = None,
    mirror: bool = False,
    bounces: int = 200,
) -> Traced:
    """Trace photons through V-cavities.

    Parameters
    ----------
    theta_i : float
        Polar angle of the light, whose azimuth is 0, radians.
    theta_r, dphi : array_like
        Polar angles and azimuths of the viewers, radians.
    slopes : callable or float
        `slopes(rng, n)` draws n slopes of facets in (0, pi/2), each as often as its share of the
        surface's (projected) area; or the one slope of all facets.
    rng : numpy.random.Generator
        Source of all randomness.
    photons : int
        Number of photons.
    azimuth : float, optional
        Azimuth of all cavities, radians; uniformly distributed if not given.
    mirror : bool
        Whether facets are mirrors; they scatter by Lambert's law if not.
    bounces : int
        Bounces after which a photon is given up.

    Raises
    ------
    ConfigurationError
        If a direction is not above the horizon or a slope not between 0 and pi/2.
    """
    theta_r, dphi = np.broadcast_arrays(
        np.atleast_1d(np.asarray(theta_r, float)), np.atleast_1d(np.asarray(dphi, float))
    )
    for name, angle in (("theta_i", np.asarray(theta_i)), ("theta_r", theta_r)):
        if np.any((angle < 0) | (angle >= HORIZON)):
            raise ConfigurationError(
                f"{name} = {angle.ravel()[0]:g} is not above the horizon; "
                "give polar angles from 0 to less than pi/2 radians.",
                value=angle,
            )
    if callable(slopes):
        slope = np.asarray(slopes(rng, photons), float)
    else:
        slope = np.full(photons, float(slopes))
    if slope.shape != (photons,) or np.any((slope <= 0) | (slope >= HORIZON)):
        raise ConfigurationError(
            f"slopes must be {photons} numbers, one a photon, between 0 and pi/2 radians; "
            "both ends are excluded.",
            value=slope,
        )
    around = rng.uniform(0, 2 * np.pi, photons) if azimuth is None else np.full(photons, azimuth)
    viewers = unit_vectors(theta_r, dphi)
    sums = np.zeros((2, 3, len(viewers)))
    each = np.zeros((bounces + 1, len(viewers)))
    left = np.zeros((2, bounces + 1))
    _loop()(unit_vectors(theta_i, 0.0), viewers, slope, around, mirror, rng, sums, each, left)
    mean = sums[0] / photons
    spread = np.sqrt(np.maximum(sums[1] / photons - mean * mean, 0) / photons)
    left /= photons
    return Traced(
        f=mean,
        f_stderr=spread,
        by_bounce=each / photons,
        escaped=left[0],
        mean_cosine=left[1],
        trapped=float(1 - left[0].sum()),
        photons=photons,
    )


@cache
def _loop() -> Callable[..., Any]:
    """`_photons` compiled."""
    return compiled(_photons)


def _photons(
    light: FloatArray,
    viewers: FloatArray,
    slope: FloatArray,
    azimuth: FloatArray,
    mirror: bool,
    rng: np.random.Generator,
    sums: FloatArray,
    each: FloatArray,
    left: FloatArray,
) -> None:
    """Follow each photon; add up f and f^2 by order, f by bounce, and what leaves by bounce."""
    bounces = left.shape[1] - 1
    seen = np.zeros((3, viewers.shape[0]))
    for n in range(slope.shape[0]):
        s, c = math.sin(slope[n]), math.cos(slope[n])
        # The cavity's frame: e across, g along the groove, z up. Facets are segments of length 1
        # from the valley at 0 to (-c, s) and (c, s); their normals lean towards each other.
        e_x, e_y = math.cos(azimuth[n]), math.sin(azimuth[n])
        across = -(light[0] * e_x + light[1] * e_y)
        along = -(light[1] * e_x - light[0] * e_y)
        down = -light[2]
        side, x = _enter(c * (2 * rng.random() - 1), across, down, c, s)
        seen[:, :] = 0.0
        for bounce in range(1, bounces + 1):
            # Mirrored where needed, so that the facet is the left one with normal (s, 0, c).
            across *= side
            if mirror:
                into = across * s + down * c
                across -= 2 * into * s
                down -= 2 * into * c
            else:
                order = min(bounce, 3) - 1
                for v in range(viewers.shape[0]):
                    v_e = side * (viewers[v, 0] * e_x + viewers[v, 1] * e_y)
                    cosine = v_e * s + viewers[v, 2] * c
                    if cosine > 0 and _meets(x, v_e, viewers[v, 2], c, s) > 1:
                        f = cosine / (math.pi * viewers[v, 2])
                        seen[order, v] += f
                        each[bounce, v] += f
                # Lambert: density cos/pi about the normal (s, 0, c), tangents (c, 0, -s), g.
                u = rng.random()
                turn = 2 * math.pi * rng.random()
                rise, flat = math.sqrt(1 - u), math.sqrt(u)
                across = s * rise + c * flat * math.cos(turn)
                down = c * rise - s * flat * math.cos(turn)
                along = flat * math.sin(turn)
            y = _meets(x, across, down, c, s)
            across *= side
            if y > 1:
                left[0, bounce] += 1
                left[1, bounce] += down / math.sqrt(across**2 + along**2 + down**2)
                break
            x = y
            side = -side
        for order in range(3):
            for v in range(viewers.shape[0]):
                sums[0, order, v] += seen[order, v]
                sums[1, order, v] += seen[order, v] * seen[order, v]


def _enter(u: float, across: float, down: float, c: float, s: float) -> tuple[float, float]:
    """Facet (1 the left, -1 the right) that a ray meets, and where, from (u, s) in the mouth."""
    to_left = across * s + down * c
    to_right = down * c - across * s
    side, path = 1.0, math.inf
    if to_left < 0:
        path = -s * (u + c) / to_left
    if to_right < 0 and -s * (c - u) / to_right < path:
        side, path = -1.0, -s * (c - u) / to_right
    return side, min(max((s + path * down) / s, 0.0), 1.0)


def _meets(x: float, across: float, up: float, c: float, s: float) -> float:
    """Where on the right facet's line a ray from x on the left facet arrives; 2 if it leaves.

    The right facet is where the result is at most 1.
    """
    towards = across * s - up * c
    if towards <= 0:
        return 2.0
    path = 2 * x * s * c / towards
    return x * (s * s - c * c) + path * (across * c + up * s)
