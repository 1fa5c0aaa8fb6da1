"""Pairs of samples that should be equal: light and viewer exchanged, or mirrored."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import Directions, FloatArray, golden_fractions
from gonio.samples import ANGLES, BRDFSamples

MIN_PAIRS = 12  # fewer reciprocal pairs do not decide on the quantity
TOLERANCE_DEG = 2.0
TRIED = 5  # times as many samples as pairs that are enough
MANY = 8_000  # samples among which partners are looked for, where these are enough
BAND = math.radians(6.0)  # width of the bands of azimuth that hold these
REACH = 1.5  # tolerances within which the nearest sample is looked for

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Pairs:
    """Reciprocal pairs.

    Parameters
    ----------
    k, j : ndarray of int64
        Sample j lies where sample k does with light and viewer exchanged. Each pair stands once.
    assumed_isotropic : bool
        Whether partners were searched at any azimuth of the sample and on both sides of the plane
        of incidence, because the data contain too few others.
    """

    k: Indices
    j: Indices
    assumed_isotropic: bool


@dataclass(frozen=True)
class Pairing:
    """Agreement of pairs of values that should be equal.

    Parameters
    ----------
    n_pairs : int
        Number of pairs in the data.
    median, rms : float or None
        Median and root mean square of |a - b| / mean(|a|, |b|); None without pairs.
    """

    n_pairs: int
    median: float | None
    rms: float | None

    @classmethod
    def of(cls, value: FloatArray, k: Indices, j: Indices) -> Pairing:
        """The agreement of the values of these pairs."""
        if len(k) == 0:
            return cls(0, None, None)
        off = disagreement(value[k], value[j])
        return cls(len(k), float(np.median(off)), float(np.sqrt(np.mean(off**2))))


def reciprocal_pairs(
    samples: BRDFSamples, tolerance_deg: float = TOLERANCE_DEG, *, enough: int | None = None
) -> Pairs:
    """Pairs of samples with light and viewer exchanged, within a wavelength and channel.

    Parameters
    ----------
    samples : BRDFSamples
    tolerance_deg : float
        Largest angle between each direction of a pair and its exact partner.
    enough : int, optional
        Partners are looked for of some samples only, evenly chosen, where these lead to so many
        pairs: of many samples those in bands of |phi_r - phi_i|, which both of a pair have.
    """
    tolerance = math.radians(tolerance_deg)
    four = four_angles(samples)
    # If the sample was never rotated, only the plane of incidence holds such partners.
    assumed = _one_azimuth(four[1][four[0] > tolerance], tolerance)
    if enough is not None and len(samples) > 2 * MANY:
        some = _in_bands(azimuth_between(*four))
        k, j = _exchanged(samples, some, tolerance, enough, isotropic=assumed)
        if len(k) >= enough:
            return Pairs(k, j, assumed)
    every = np.arange(len(samples))
    k = j = np.zeros(0, np.int64)
    if not assumed:
        k, j = _exchanged(samples, every, tolerance, enough, isotropic=False)
        assumed = len(k) < MIN_PAIRS
    if assumed:
        k, j = _exchanged(samples, every, tolerance, enough, isotropic=True)
    return Pairs(k, j, assumed)


def mirror_pairs(
    samples: BRDFSamples, tolerance_deg: float = TOLERANCE_DEG
) -> tuple[Indices, Indices]:
    """Pairs of samples at phi_r - phi_i = +x and -x, equal on an isotropic surface."""
    theta_i, phi_i, theta_r, phi_r = four_angles(samples)
    delta = azimuth_between(theta_i, phi_i, theta_r, phi_r)
    zero = np.zeros_like(delta)
    relative = Directions(theta_i, zero, theta_r, delta)
    opposite = Directions(theta_i, zero, theta_r, -delta)
    return _partners(relative, opposite, groups(samples), math.radians(tolerance_deg))


def four_angles(samples: BRDFSamples) -> tuple[FloatArray, ...]:
    """theta_i, phi_i, theta_r and phi_r of every sample, radians."""
    n = len(samples)
    return tuple(np.broadcast_to(getattr(samples.directions, name), (n,)) for name in ANGLES)


def groups(samples: BRDFSamples) -> Indices:
    """Group index by wavelength and channel; values are compared within a group only."""
    group = np.zeros(len(samples), np.int64)
    for column in (samples.wavelength_nm, samples.channel):
        if column is not None:
            _, index = np.unique(column, return_inverse=True)
            group = group * (int(index.max(initial=0)) + 1) + index
    return group


def wrapped(angle: FloatArray) -> FloatArray:
    """The same azimuth in [-pi, pi)."""
    return np.asarray(angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi)))


def azimuth_between(
    theta_i: FloatArray, phi_i: FloatArray, theta_r: FloatArray, phi_r: FloatArray
) -> FloatArray:
    """phi_r - phi_i in [-pi, pi), 0 where a direction is the normal and has no azimuth."""
    at_normal = np.minimum(theta_i, theta_r) < 1e-9
    return np.where(at_normal, 0.0, wrapped(phi_r - phi_i))


def disagreement(a: FloatArray, b: FloatArray) -> FloatArray:
    """|a - b| / mean(|a|, |b|), between 0 and 2; two zeros agree."""
    mean = (np.abs(a) + np.abs(b)) / 2
    result: FloatArray = np.abs(a - b) / np.where(mean > 0, mean, 1.0)
    return result


def _one_azimuth(phi: FloatArray, tolerance: float) -> bool:
    """Whether all azimuths are the same."""
    if not len(phi) or not np.ptp(phi):
        return True
    return bool(np.all(np.abs(wrapped(phi - phi[0])) < tolerance))


def _in_bands(delta: FloatArray) -> Indices:
    """Samples in some bands of |phi_r - phi_i|, at least `MANY` of them."""
    band = (np.abs(delta) / BAND).astype(np.int64)
    counts = np.bincount(band)
    order = np.argsort(golden_fractions(len(counts)))
    chosen = np.zeros(len(counts), bool)
    chosen[order[: np.searchsorted(np.cumsum(counts[order]), MANY) + 1]] = True
    return np.flatnonzero(chosen[band])


def _exchanged(
    samples: BRDFSamples, some: Indices, tolerance: float, enough: int | None, *, isotropic: bool
) -> tuple[Indices, Indices]:
    """Pairs among some samples, of an isotropic surface at any azimuth of the sample."""
    theta_i, phi_i, theta_r, phi_r = (a[some] for a in four_angles(samples))
    may = _may_have_partner(theta_i, theta_r, tolerance)
    some = some[may]
    theta_i, phi_i, theta_r, phi_r = (a[may] for a in (theta_i, phi_i, theta_r, phi_r))
    if isotropic:
        phi_r = np.abs(azimuth_between(theta_i, phi_i, theta_r, phi_r))
        phi_i = np.zeros(len(some))
        exchanged = Directions(theta_r, phi_i, theta_i, phi_r)
    else:
        exchanged = Directions(theta_r, phi_r, theta_i, phi_i)
    have = Directions(theta_i, phi_i, theta_r, phi_r)
    k, j = _partners(have, exchanged, groups(samples)[some], tolerance, enough)
    return some[k], some[j]


def _may_have_partner(
    theta_i: FloatArray, theta_r: FloatArray, tolerance: float
) -> NDArray[np.bool_]:
    """Which samples have one whose theta_i is near their theta_r, and theta_r near their theta_i.

    Others are neither a partner nor nearer to a sample than its partner.
    """
    width = REACH * tolerance * 1.01
    of_i, of_r = (np.asarray(theta / width, np.int64) + 1 for theta in (theta_i, theta_r))
    may = np.ones(len(of_i), bool)
    for _ in range(2):  # the second time among those that are left
        for own, other in ((of_r, of_i), (of_i, of_r)):
            held = np.zeros(int(np.pi / width) + 4, bool)
            held[other[may]] = True
            held[1:-1] |= held[:-2] | held[2:]
            may &= held[own]
    return may


def _partners(
    have: Directions,
    want: Directions,
    group: Indices,
    tolerance: float,
    enough: int | None = None,
) -> tuple[Indices, Indices]:
    """Pairs (k, j), each once: sample j lies in the direction `want` of the partner of sample k."""
    if len(group) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    # Groups lie farther from each other than any two directions.
    separation = 10.0 * group[:, None]
    points = np.hstack([*have.vectors(), separation])
    wanted = np.hstack([*want.vectors(), separation])
    if enough is not None and len(group) > TRIED * enough:
        index = golden_fractions(TRIED * enough) * len(group)
        pairs = _found(points, wanted, np.unique(index.astype(np.int64)), tolerance)
        if len(pairs) >= enough:
            return pairs[:, 0], pairs[:, 1]
    pairs = _found(points, wanted, np.arange(len(group)), tolerance)
    return pairs[:, 0], pairs[:, 1]


def _found(points: FloatArray, wanted: FloatArray, some: Indices, tolerance: float) -> Indices:
    """Pairs (P, 2) of some samples with the point nearest to where their partner is wanted."""
    from scipy.spatial import cKDTree

    # A component that is the same everywhere adds nothing to a distance.
    varies = (np.ptp(points, axis=0) > 0) | np.any(wanted != points[0], axis=0)
    varies[0] = True
    # Many directions of incidence are the same, which makes medians slow.
    joint_distance, nearest = cKDTree(points[:, varies], balanced_tree=False).query(
        wanted[some][:, varies], distance_upper_bound=REACH * tolerance
    )
    near = np.isfinite(joint_distance)
    k, j = some[near], np.asarray(nearest[near], np.int64)
    distance = np.maximum(
        np.linalg.norm(points[j, :3] - wanted[k, :3], axis=1),
        np.linalg.norm(points[j, 3:6] - wanted[k, 3:6], axis=1),
    )
    keep = (distance <= tolerance) & (k != j)
    low, high = np.minimum(k[keep], j[keep]), np.maximum(k[keep], j[keep])
    n = len(points)
    return np.column_stack(np.divmod(np.unique(low * n + high), n))
