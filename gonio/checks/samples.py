"""Checks of measured samples: plausibility, reciprocity, mirror symmetry, and quantity."""

from __future__ import annotations

import numpy as np

from gonio.checks.pairs import (
    TOLERANCE_DEG,
    Pairing,
    azimuth_between,
    four_angles,
    groups,
    mirror_pairs,
    reciprocal_pairs,
)
from gonio.checks.plausibility import plausible
from gonio.checks.quantity import BRDF, UNDECIDED, QuantityTest, quantity_of
from gonio.checks.rough_albedo import rough_albedo
from gonio.checks.samples_report import SamplesReport
from gonio.samples import BRDFSamples


def check_samples(samples: BRDFSamples, *, tolerance_deg: float = TOLERANCE_DEG) -> SamplesReport:
    """Ask what is implausible in samples, and decide which quantity they hold.

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
    >>> from gonio.geometry import Directions
    >>> t = np.radians(np.arange(5, 80, 5.0))
    >>> theta_i, theta_r = (grid.ravel() for grid in np.meshgrid(t, t))
    >>> d = Directions(theta_i, np.zeros(225), theta_r, np.full(225, np.pi))
    >>> check_samples(BRDFSamples(d, 0.2 * np.cos(theta_r))).quantity
    'BRDF*cos(theta_r)'
    """
    plausibility = plausible(samples)
    samples = plausibility.samples
    theta_i, phi_i, theta_r, phi_r = four_angles(samples)
    value = samples.value
    pairs = reciprocal_pairs(samples, tolerance_deg)
    test = quantity_of(value, samples.u_independent, theta_i, theta_r, pairs)
    cosine = {"BRDF*cos(theta_r)": np.cos(theta_r), "BRDF*cos(theta_i)": np.cos(theta_i)}.get(
        test.quantity, np.ones(len(samples))
    )
    usable = cosine > 0
    albedo = rough_albedo(
        theta_i[usable],
        theta_r[usable],
        np.abs(azimuth_between(theta_i, phi_i, theta_r, phi_r))[usable],
        value[usable] / cosine[usable],
        groups(samples)[usable],
    )
    return SamplesReport(
        n_samples=len(samples),
        n_negative=samples.n_negative,
        tolerance_deg=tolerance_deg,
        reciprocity=Pairing.of(value, pairs.k, pairs.j),
        mirror=Pairing.of(value, *mirror_pairs(samples, tolerance_deg)),
        assumed_isotropic=pairs.assumed_isotropic,
        quantity=test.quantity,
        candidates=test.candidates,
        n_telling=test.n_telling,
        power=test.power,
        u_power=test.u_power,
        albedo=albedo,
        findings=plausibility.findings,
        notes=_notes(test, pairs.assumed_isotropic, albedo),
    )


def _notes(test: QuantityTest, assumed: bool, albedo: float | None) -> tuple[str, ...]:
    """What the numbers of a report mean, and what they cannot decide."""
    notes = []
    if test.quantity == UNDECIDED:
        notes.append(test.why)
    elif test.quantity == BRDF:
        notes.append("BRDF*cos(theta_i)*cos(theta_r) is as reciprocal and cannot be excluded.")
    else:
        other = "i" if test.quantity.endswith("r)") else "r"
        notes.append(f"BRDF/cos(theta_{other}) would look the same.")
        notes.append(f"Divide the values by {test.quantity.removeprefix('BRDF*')} to get a BRDF.")
    if assumed and test.n_telling:
        notes.append(
            "Pairs were sought at any azimuth of the sample, on either side: "
            "the surface is taken as isotropic."
        )
    notes.append(
        "Reciprocity cannot see a constant factor: a reflectance factor (pi*BRDF) passes as well. "
        "Only an albedo above 1 hints at it."
    )
    if albedo is not None:
        notes.append(f"The rough albedo is {albedo:.2f} at most.")
    return tuple(notes)
