"""Checks of measured samples: reciprocity, mirror symmetry, and quantity."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gonio.checks.samples_report import BRDF, UNDECIDED, Pairing, SamplesReport
from gonio.geometry import (
    Directions,
    FloatArray,
    hemisphere_quadrature,
    unit_vectors,
)
from gonio.samples import BRDFSamples

MIN_PAIRS = 12  # fewer reciprocal pairs do not decide on the quantity
# Pairs whose cosines differ by less than this fraction cannot distinguish the quantities.
MIN_CONTRAST = 0.05
# The best quantity must halve the disagreement of the next one.
CLEARLY_BETTER = 0.5
# Albedo of the nearest-sample sum above which a constant factor is suspected.
SUSPECT_ALBEDO = 1.2


def check_samples(samples: BRDFSamples, *, tolerance_deg: float = 2.0) -> SamplesReport:
    """Compare reciprocal and mirrored pairs of samples, and decide which quantity they hold.

    Parameters
    ----------
    samples : BRDFSamples
        Values that are a BRDF, or a BRDF times a cosine.
    tolerance_deg : float
        Largest angle between each direction of a pair and its exact partner.

    Returns
    -------
    SamplesReport

    Notes
    -----
    A BRDF is reciprocal. A BRDF times one cosine is not, and division by the right cosine restores
    reciprocity. A factor that is symmetric in light and viewer cannot be detected: a constant such
    as pi, or cos(theta_i) cos(theta_r). BRDF / cos(theta_i) breaks reciprocity exactly as
    BRDF * cos(theta_r) does.

    Examples
    --------
    >>> t = np.radians(np.arange(5, 80, 5.0))
    >>> theta_i, theta_r = (grid.ravel() for grid in np.meshgrid(t, t))
    >>> d = Directions(theta_i, np.zeros(225), theta_r, np.full(225, np.pi))
    >>> check_samples(BRDFSamples(d, 0.2 * np.cos(theta_r))).quantity
    'BRDF*cos(theta_r)'
    """
    tolerance = math.radians(tolerance_deg)
    group = _groups(samples)
    theta_i, phi_i, theta_r, phi_r = (
        np.broadcast_to(getattr(samples.directions, name), (len(samples),))
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    )
    delta = _azimuth_between(theta_i, phi_i, theta_r, phi_r)
    zero = np.zeros_like(delta)

    directions = Directions(theta_i, phi_i, theta_r, phi_r)
    k, j = _partners(directions, directions.swapped(), group, tolerance)
    # If the sample was never rotated, only the plane of incidence holds such partners.
    assumed = _one_azimuth(phi_i[theta_i > tolerance], tolerance) or len(k) < MIN_PAIRS
    if assumed:
        folded = Directions(theta_i, zero, theta_r, np.abs(delta))
        exchanged = Directions(theta_r, zero, theta_i, np.abs(delta))
        k, j = _partners(folded, exchanged, group, tolerance)
    relative = Directions(theta_i, zero, theta_r, delta)
    opposite = Directions(theta_i, zero, theta_r, -delta)
    mirror = _partners(relative, opposite, group, tolerance)

    value = samples.value
    cosines = {
        BRDF: np.ones(len(samples)),
        "BRDF*cos(theta_r)": np.cos(theta_r),
        "BRDF*cos(theta_i)": np.cos(theta_i),
    }
    quantity, candidates, n_telling = _quantity(value, cosines, k, j)
    cosine = cosines.get(quantity, cosines[BRDF])
    usable = cosine > 0
    albedo = _rough_albedo(
        theta_i[usable],
        theta_r[usable],
        np.abs(delta)[usable],
        value[usable] / cosine[usable],
        group[usable],
    )
    return SamplesReport(
        n_samples=len(samples),
        n_negative=samples.n_negative,
        tolerance_deg=tolerance_deg,
        reciprocity=_pairing(value, k, j),
        mirror=_pairing(value, *mirror),
        assumed_isotropic=assumed,
        quantity=quantity,
        candidates=candidates,
        n_telling=n_telling,
        albedo=albedo,
        notes=_notes(quantity, candidates, n_telling, assumed, albedo),
    )


def _groups(samples: BRDFSamples) -> NDArray[np.int64]:
    """Group index by wavelength and channel; values are compared within a group only."""
    n = len(samples)
    group = np.zeros(n, np.int64)
    for column in (samples.wavelength_nm, samples.channel):
        if column is not None:
            _, index = np.unique(column, return_inverse=True)
            group = group * (int(index.max(initial=0)) + 1) + index
    return group


def _wrapped(angle: FloatArray) -> FloatArray:
    """The same azimuth in [-pi, pi)."""
    result: FloatArray = (angle + np.pi) % (2 * np.pi) - np.pi
    return result


def _one_azimuth(phi: FloatArray, tolerance: float) -> bool:
    """Whether all azimuths are the same."""
    return not len(phi) or bool(np.all(np.abs(_wrapped(phi - phi[0])) < tolerance))


def _azimuth_between(
    theta_i: FloatArray, phi_i: FloatArray, theta_r: FloatArray, phi_r: FloatArray
) -> FloatArray:
    """phi_r - phi_i in [-pi, pi), 0 where a direction is the normal and has no azimuth."""
    at_normal = np.minimum(theta_i, theta_r) < 1e-9
    return np.where(at_normal, 0.0, _wrapped(phi_r - phi_i))


def _partners(
    have: Directions, want: Directions, group: NDArray[np.int64], tolerance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (k, j), each once: sample j lies in the direction `want` of the partner of sample k."""
    from scipy.spatial import cKDTree

    if len(group) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    # Groups lie farther from each other than any two directions.
    separation = 10.0 * group[:, None]
    points = np.hstack([*have.vectors(), separation])
    wanted = np.hstack([*want.vectors(), separation])
    joint_distance, nearest = cKDTree(points).query(wanted, distance_upper_bound=1.5 * tolerance)
    k = np.flatnonzero(np.isfinite(joint_distance))
    j = np.asarray(nearest[k], np.int64)
    distance = np.maximum(
        np.linalg.norm(points[j, :3] - wanted[k, :3], axis=1),
        np.linalg.norm(points[j, 3:6] - wanted[k, 3:6], axis=1),
    )
    keep = (distance <= tolerance) & (k != j)
    pairs = np.unique(np.sort(np.stack([k[keep], j[keep]], axis=1), axis=1), axis=0)
    return pairs[:, 0], pairs[:, 1]


def _disagreement(a: FloatArray, b: FloatArray) -> FloatArray:
    """|a - b| / mean(|a|, |b|), between 0 and 2; two zeros agree."""
    mean = (np.abs(a) + np.abs(b)) / 2
    return np.abs(a - b) / np.where(mean > 0, mean, 1.0)


def _pairing(value: FloatArray, k: NDArray[np.int64], j: NDArray[np.int64]) -> Pairing:
    if len(k) == 0:
        return Pairing(0, None, None)
    off = _disagreement(value[k], value[j])
    return Pairing(len(k), float(np.median(off)), float(np.sqrt(np.mean(off**2))))


def _quantity(
    value: FloatArray,
    cosines: Mapping[str, FloatArray],
    k: NDArray[np.int64],
    j: NDArray[np.int64],
) -> tuple[str, dict[str, float], int]:
    """The quantity for which pairs agree best, the disagreements, and the number of pairs."""
    cos_r = cosines["BRDF*cos(theta_r)"]
    # At the horizon the cosine is 0 and cannot be divided by.
    above = np.min([np.minimum(c[k], c[j]) for c in cosines.values()], axis=0) > 1e-6
    telling = above & (_disagreement(cos_r[k], cos_r[j]) > MIN_CONTRAST)
    k, j = k[telling], j[telling]
    if len(k) == 0:
        return UNDECIDED, {}, 0
    disagreement = {
        name: float(np.median(_disagreement(value[k] / c[k], value[j] / c[j])))
        for name, c in cosines.items()
    }
    best, second = sorted(disagreement, key=lambda name: disagreement[name])[:2]
    clear = len(k) >= MIN_PAIRS and disagreement[best] < CLEARLY_BETTER * disagreement[second]
    return best if clear else UNDECIDED, disagreement, len(k)


def _rough_albedo(
    theta_i: FloatArray,
    theta_r: FloatArray,
    delta: FloatArray,
    f: FloatArray,
    group: NDArray[np.int64],
) -> float | None:
    """Largest directional albedo, from the sample nearest to each direction of the hemisphere."""
    from scipy.spatial import cKDTree

    theta, phi, weight = hemisphere_quadrature(16, 32)
    grid = unit_vectors(theta, np.abs(_wrapped(phi)))
    largest = None
    incidence = np.round(np.degrees(theta_i)).astype(np.int64)
    keys = np.stack([group, incidence], axis=1)
    unique, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.ravel()
    counts = np.bincount(index, minlength=len(unique))
    for number in np.flatnonzero(counts >= 20):
        members = index == number
        points = unit_vectors(theta_r[members], delta[members])
        distance, nearest = cKDTree(points).query(grid)
        # Nine tenths of the projected hemisphere lie within 20 degrees of a sample.
        if np.sum((weight * np.cos(theta))[distance < 0.35]) > 0.9 * np.pi:
            albedo = float(np.sum(weight * np.cos(theta) * f[members][nearest]))
            largest = albedo if largest is None else max(largest, albedo)
    return largest


def _notes(
    quantity: str,
    candidates: Mapping[str, float],
    n_telling: int,
    assumed: bool,
    albedo: float | None,
) -> tuple[str, ...]:
    notes = []
    if quantity == UNDECIDED:
        if n_telling < MIN_PAIRS:
            notes.append(
                f"Undecided: {n_telling} reciprocal pairs tell the quantities apart, "
                f"{MIN_PAIRS} are needed."
            )
        else:
            best, second = sorted(candidates.values())[:2]
            notes.append(
                f"Undecided: the best quantity leaves {best:.1%}, the next {second:.1%}; "
                f"the best must leave less than {CLEARLY_BETTER:.0%} of the next."
            )
    elif quantity == BRDF:
        notes.append("BRDF*cos(theta_i)*cos(theta_r) is as reciprocal and cannot be excluded.")
    else:
        other = "i" if quantity.endswith("r)") else "r"
        notes.append(f"BRDF/cos(theta_{other}) would look the same.")
        notes.append(f"Divide the values by {quantity.removeprefix('BRDF*')} to get a BRDF.")
    if assumed and n_telling:
        notes.append(
            "Pairs were sought at any azimuth of the sample, on either side: "
            "the surface is taken as isotropic."
        )
    notes.append(
        "Reciprocity cannot see a constant factor: a reflectance factor (pi*BRDF) passes as well. "
        "Only an albedo above 1 hints at it."
    )
    if albedo is not None:
        hint = f"The rough albedo is {albedo:.2f} at most"
        if albedo > SUSPECT_ALBEDO:
            hint += f": pi*BRDF is possible (it would be {albedo / math.pi:.2f} as BRDF)"
        notes.append(f"{hint}.")
    return tuple(notes)
