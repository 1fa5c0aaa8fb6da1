"""The errors of value that the samples of a session share: standard, lamp, light that strays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.effects import multibounce
from gonio.calibration.image_cells import ImageCells
from gonio.geometry import angles
from gonio.metadata import Metadata, Plan
from gonio.shared_term import SharedTerm


def light_terms(
    metadata: Metadata,
    parts: list[ImageCells],
    image: NDArray[np.int64],
    incidence: NDArray[np.int64],
) -> list[SharedTerm]:
    """Errors of eq. (2) that many samples share, as far as the metadata tell of them.

    Parameters
    ----------
    metadata : Metadata
    parts : list of ImageCells
        The images' cells, in the order of the samples.
    image, incidence : ndarray of int64, shape (N,)
        Image and incidence of every sample, channel by channel counted on.
    """
    terms = _standard_terms(metadata, parts)
    terms += _irradiance_terms(metadata.plan, incidence)
    terms += _lamp_terms(metadata, parts, image, incidence)
    terms += multibounce.terms(metadata, parts)
    return terms + _ambient_terms(metadata, parts)


def unknown_light(metadata: Metadata) -> tuple[str, ...]:
    """What the metadata leave unknown of eq. (2), and no uncertainty holds."""
    plan, limits = metadata.plan, metadata.limits
    computed = plan.standard_theta_i_deg is not None
    known = {
        "lamp drift (lamp.drift)": metadata.lamp.drift is not None,
        "light that reaches the sample twice (limits.multibounce)": limits.multibounce is not None,
        "room light that the sample reflects (limits.ambient)": limits.ambient is not None,
        "irradiance at another incidence than the standard's (plan.u_irradiance)": (
            not computed or plan.u_irradiance is not None
        ),
        "room light on a sheet in transmission": plan.mode != "transmission" or not limits.ambient,
    }
    return tuple(name for name, is_known in known.items() if not is_known)


def _standard_terms(metadata: Metadata, parts: list[ImageCells]) -> list[SharedTerm]:
    certificate = metadata.standard
    terms = []
    if certificate.uncertainty:
        terms.append(
            SharedTerm("standard", "reflectance of the white standard", certificate.uncertainty)
        )
    if certificate.rolloff_uncertainty:
        theta_r = angles(np.concatenate([part.centroid for part in parts]))[0]
        terms.append(
            SharedTerm(
                "standard, shape",
                "how the standard departs from a Lambertian one at high angles",
                certificate.rolloff_uncertainty,
                profile=(theta_r / np.radians(75)) ** 4,
            )
        )
    return terms


def _lamp_terms(
    metadata: Metadata,
    parts: list[ImageCells],
    image: NDArray[np.int64],
    incidence: NDArray[np.int64],
) -> list[SharedTerm]:
    """The lamp's output in the images of sample, standard and background.

    With outputs 1 + m, 1 + s and 1 + b, f by eq. (2) changes by m (f + e) - s f (1 + r) -
    b (e - f r), where e is the stray light as f and r the stray light in the standard's image as a
    part of its signal: drift between sample and background leaves stray light behind.
    """
    plan, drift = metadata.plan, metadata.lamp.drift
    if not drift:
        return []
    value = np.concatenate([part.means[0] for part in parts])
    stray, share = np.concatenate([part.stray for part in parts]).T
    # Background and standard are averaged over their repeats and serve every rotation.
    averaged = drift / np.sqrt(plan.repeats)
    alone = plan.standard_theta_i_deg is not None
    group = np.zeros_like(incidence) if alone else incidence
    left = stray if alone else stray - value * share
    terms = [
        SharedTerm(
            "lamp, sample", "lamp output, image to image", drift, image, offset=drift * stray
        ),
        SharedTerm(
            "lamp, standard",
            "lamp output when the standard was taken",
            averaged,
            group,
            profile=1 + share,
        ),
        SharedTerm(
            "lamp, background",
            "lamp output when the background was taken: stray light that is left",
            group=incidence,
            offset=-averaged * left,
        ),
    ]
    if alone:
        meaning = "the same for the background that belongs to the standard"
        terms.append(SharedTerm("lamp, background 2", meaning, averaged, group, profile=share))
    return terms


def _irradiance_terms(plan: Plan, incidence: NDArray[np.int64]) -> list[SharedTerm]:
    """The irradiance where it was computed from that of the standard at another incidence.

    In transmission the dome's T_d carries it, one number for all. In reflection nobody knows how
    far the errors of two incidences are alike: half of the variance is taken to be.
    """
    u = plan.u_irradiance
    if not u or plan.standard_theta_i_deg is None:
        return []
    meaning = "irradiance computed for another incidence than the standard's"
    if plan.mode == "transmission":
        return [SharedTerm("irradiance", meaning, u)]
    half = u / np.sqrt(2)
    return [
        SharedTerm("irradiance", f"{meaning}, alike at all", half),
        SharedTerm("irradiance, incidence", f"{meaning}, each for itself", half, incidence),
    ]


def _ambient_terms(metadata: Metadata, parts: list[ImageCells]) -> list[SharedTerm]:
    """Room light that sample and standard reflect, which no background holds.

    Room light of a times the lamp's irradiance at normal incidence turns f into
    (f cos(theta_i) + a rho/pi)/(cos(theta_i) + a) for a sample that shows rho in even light; the
    image's own mean of f stands for rho/pi.
    """
    a = metadata.limits.ambient
    if not a or metadata.plan.mode == "transmission":
        return []
    changes = []
    for part in parts:
        weight = part.solid_angle * part.centroid[:, 2]
        mean = np.sum(weight * part.means[0]) / np.sum(weight) if len(weight) else 0.0
        changes.append(a * (mean - part.means[0]) / (np.cos(part.theta_i) + a))
    meaning = "room light that the sample reflects"
    return [SharedTerm("room light", meaning, offset=np.concatenate(changes))]
