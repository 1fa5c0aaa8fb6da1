"""f of the white standard in all directions, from the number or the list that is certified.

A certified number is an average of f over directions: at the normal, at 0/45, or over the
hemisphere at 8 deg. The shape turns it into f in another direction. Where the shape is uncertain,
the conversion is uncertain as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.calibration.frames import typical_shape
from gonio.certificate import (
    FACTOR_AT_DEG,
    KIND_WORDS,
    SHAPE_AT_DEG,
    TOTAL_AT_DEG,
    Certificate,
    ListedBRDF,
    StandardTable,
)
from gonio.geometry import FloatArray

# The shape that a list is interpolated with where nobody stated one. It does not count as an
# uncertainty: what lies between the listed geometries is unknown then.
ASSUMED_SHAPE = 0.1
_ROUNDING = 1e-5  # relative error of a listed value that is stated without uncertainty
_N_THETA, _N_PHI = 40, 16  # nodes of an integral over the hemisphere


@dataclass(frozen=True)
class Directions:
    """Pairs of directions, radians, with weights.

    Parameters
    ----------
    theta_i, theta_r, dphi, weight : ndarray, shape (n,)
    """

    theta_i: FloatArray
    theta_r: FloatArray
    dphi: FloatArray
    weight: FloatArray

    def mean(self, values: FloatArray) -> FloatArray:
        """Weighted sum over the last axis; the weights sum to 1."""
        return np.asarray(values @ self.weight)


@dataclass(frozen=True)
class Estimate:
    """f of the standard and how uncertain its shape is.

    Parameters
    ----------
    certificate : Certificate
    scale : float
        f where the shape is 1, sr^-1.
    coefficients : ndarray, shape (7,), or None
        Of the functions of `typical_shape`, fitted to a list.
    covariance : ndarray, shape (8, 8), or None
        Of the coefficients of the constant and the functions. None without a stated uncertainty of
        the shape.
    """

    certificate: Certificate
    scale: float
    coefficients: FloatArray | None = None
    covariance: FloatArray | None = None

    def brdf(self, theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike) -> FloatArray:
        """f in sr^-1 for angles in radians; NaN stays NaN."""
        f = self.scale * _shape(self.certificate, theta_i, theta_r, dphi)
        if self.coefficients is None:
            return np.asarray(f)
        values = typical_shape.functions(theta_i, theta_r, dphi)
        return np.asarray(f * np.exp(np.tensordot(self.coefficients, values, axes=1)))

    def modes(self, theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike) -> FloatArray:
        """Relative change of f for one standard deviation of each mode, shape (modes, ...)."""
        if self.covariance is None:
            return np.empty((0, *np.shape(theta_r)))
        modes = typical_shape.principal(self.covariance)
        return np.tensordot(modes, typical_shape.with_one(theta_i, theta_r, dphi), axes=1)


@lru_cache(maxsize=16)
def estimate(certificate: Certificate) -> Estimate:
    """What a certificate says of f in all directions.

    Parameters
    ----------
    certificate : Certificate

    Examples
    --------
    A total reflectance of 0.96 is f(0 deg) of more than 0.96/pi where f falls towards the rim:

    >>> total = Certificate(kind="total", reflectance=0.96, uncertainty=0.005, rolloff=0.1)
    >>> round(float(np.pi * estimate(total).brdf(0.0, 0.0, 0.0)), 4)
    0.9884
    """
    if certificate.brdf is not None:
        return _of_list(certificate, certificate.brdf)
    assert certificate.reflectance is not None
    at = _certified_at(certificate)
    shape = _shape(certificate, at.theta_i, at.theta_r, at.dphi)
    # With a table, pi_f0 is the reflectance that the table's factor multiplies.
    mean = 1.0 if certificate.kind == "pi_f0" else float(at.mean(shape))
    scale = certificate.reflectance / np.pi / mean
    if not certificate.u_shape:
        return Estimate(certificate, scale)
    sd = certificate.u_shape * typical_shape.SD
    values = at.mean(shape * typical_shape.functions(at.theta_i, at.theta_r, at.dphi)) / mean
    # The certified number holds whatever the shape is: the constant makes up for the functions.
    kept = np.concatenate([-values[None], np.eye(len(sd))])
    return Estimate(certificate, scale, covariance=(kept * sd**2) @ kept.T)


def rolloff_profile(certificate: Certificate, theta_i: ArrayLike, theta_r: ArrayLike) -> FloatArray:
    """Relative change of f with a rolloff of 1, to first order, the certified number being kept.

    Parameters
    ----------
    certificate : Certificate
    theta_i, theta_r : array_like
        Radians.
    """
    profile = _fall(theta_r) + (_fall(theta_i) if certificate.reciprocal else 0.0)
    if certificate.kind == "pi_f0":
        return np.asarray(profile)
    at = _certified_at(certificate)
    shape = _shape(certificate, at.theta_i, at.theta_r, at.dphi)
    own = _fall(at.theta_r) + (_fall(at.theta_i) if certificate.reciprocal else 0.0)
    return np.asarray(profile - at.mean(shape * own) / at.mean(shape))


def total_reflectance(certificate: Certificate) -> float:
    """The certified reflectance; from a list of f its integral at 8 deg."""
    if certificate.reflectance is not None:
        return certificate.reflectance
    at = _hemisphere()
    f = estimate(certificate).brdf(at.theta_i, at.theta_r, at.dphi)
    return float(np.pi * at.mean(f))


def describe(certificate: Certificate) -> str:
    """The certified number and the shape in words.

    Examples
    --------
    >>> describe(Certificate(kind="total", reflectance=0.98, uncertainty=0.01))
    'total reflectance, 8 deg/hemispherical = 0.98, shape unknown and taken as Lambertian'
    """
    words = KIND_WORDS[certificate.kind]
    if certificate.brdf is not None:
        return f"{words} ({len(certificate.brdf.brdf)}), smooth and reciprocal in between"
    words += f" = {certificate.reflectance:g}"
    if certificate.table is not None:
        words += ", f of its table by direction"
    elif certificate.rolloff:
        words += f", less {certificate.rolloff:g} (theta_r/75 deg)^4"
        words += ", and the same in theta_i" if certificate.reciprocal else ""
    elif certificate.u_shape is not None:
        words += f", shape not certified, {certificate.u_shape:.2g} at 75 deg"
    elif not certificate.shape_is_certified:
        words += ", shape unknown and taken as Lambertian"
    return words


def _of_list(certificate: Certificate, listed: ListedBRDF) -> Estimate:
    """Constant and functions fitted to the logarithms of the listed f."""
    theta_i, theta_r, dphi = np.radians([listed.theta_i_deg, listed.theta_r_deg, listed.dphi_deg])
    f = np.array(listed.brdf)
    noise = (np.array(listed.u_brdf) / f) ** 2 + _ROUNDING**2
    u = ASSUMED_SHAPE if certificate.u_shape is None else max(certificate.u_shape, _ROUNDING)
    prior = np.concatenate([[1.0], (u * typical_shape.SD) ** 2])  # of the constant: as good as free
    design = typical_shape.with_one(theta_i, theta_r, dphi).T
    usual = float(np.log(f).mean())
    residual = np.log(f) - usual
    spread = (design * prior) @ design.T + np.diag(noise)
    gain = np.linalg.solve(spread, design * prior).T
    found = gain @ residual
    # A list that no smooth shape follows within its uncertainty is less certain than it states.
    misfit = max(float(residual @ np.linalg.solve(spread, residual)) / len(f), 1.0)
    if certificate.u_shape is None:
        covariance = (gain * noise) @ gain.T
    else:
        covariance = np.diag(prior) - gain @ (design * prior)
    return Estimate(certificate, float(np.exp(usual + found[0])), found[1:], misfit * covariance)


def _certified_at(certificate: Certificate) -> Directions:
    """Directions over which the certified number is an average of pi f."""
    if certificate.kind == "total":
        return _hemisphere()
    theta_i, theta_r = FACTOR_AT_DEG if certificate.kind == "0/45" else (0.0, 0.0)
    return Directions(np.radians([theta_i]), np.radians([theta_r]), np.zeros(1), np.ones(1))


@lru_cache(maxsize=1)
def _hemisphere() -> Directions:
    """All viewing directions at 8 deg, weighted by the cosine; the weights sum to 1."""
    node, weight = np.polynomial.legendre.leggauss(_N_THETA)
    # Nodes of the polar angle itself: f is smooth in it up to the horizon.
    theta = (node + 1) * np.pi / 4
    weight = weight * np.sin(2 * theta) * np.pi / 4
    phi = (np.arange(_N_PHI) + 0.5) * np.pi / _N_PHI  # both sides of the plane are alike
    theta_r, dphi = (angle.ravel() for angle in np.meshgrid(theta, phi, indexing="ij"))
    return Directions(
        np.full(theta_r.shape, np.radians(TOTAL_AT_DEG)),
        theta_r,
        dphi,
        np.repeat(weight, _N_PHI) / _N_PHI,
    )


def _shape(
    certificate: Certificate, theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike
) -> FloatArray:
    """The certified shape; 1 where there is none."""
    if certificate.table is not None:
        return _interpolated(certificate.table, theta_i, theta_r, dphi)
    rolloff = certificate.rolloff or 0.0
    shape = 1 - rolloff * _fall(theta_r)
    return np.asarray(shape * (1 - rolloff * _fall(theta_i)) if certificate.reciprocal else shape)


def _fall(theta: ArrayLike) -> FloatArray:
    return np.asarray((np.asarray(theta, float) / np.radians(SHAPE_AT_DEG)) ** 4)


def _interpolated(
    table: StandardTable, theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike
) -> FloatArray:
    """Trilinear; the nearest value holds outside the grid."""
    values = np.array(table.factor)
    # f is the same on either side of the plane of incidence: 0 to 180 deg hold all.
    aside = np.abs((np.degrees(dphi) + 180) % 360 - 180)
    i, j, w = _bracket(table.theta_i_deg, np.degrees(theta_i))
    a, b, u = _bracket(table.theta_r_deg, np.degrees(theta_r))
    c, d, v = _bracket(table.dphi_deg, aside)

    def at_azimuth(row: NDArray[np.int64]) -> FloatArray:
        low, high = (values[i, row, k] * (1 - w) + values[j, row, k] * w for k in (c, d))
        return np.asarray(low * (1 - v) + high * v)

    return np.asarray(at_azimuth(a) * (1 - u) + at_azimuth(b) * u)


def _bracket(
    axis: tuple[float, ...], x: ArrayLike
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Indices of the neighbours of x on the axis, and the weight of the upper one."""
    grid, x = np.array(axis), np.asarray(x, float)
    lower = np.clip(np.searchsorted(grid, x, side="right") - 1, 0, max(len(grid) - 2, 0))
    upper = np.minimum(lower + 1, len(grid) - 1)
    step = np.where(upper > lower, grid[upper] - grid[lower], 1.0)
    return lower, upper, np.clip((x - grid[lower]) / step, 0, 1)
