"""The errors that the samples of a session share: mapping, source, dome, standard, lamp."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray, angles, rotated
from gonio.metadata import Metadata
from gonio.samples import SharedTerm

if TYPE_CHECKING:
    from gonio.calibration.reduction import Part


def shared_terms(
    metadata: Metadata,
    parts: list[Part],
    image: NDArray[np.int64],
    incidence: NDArray[np.int64],
) -> tuple[SharedTerm, ...]:
    """Every error of a session that many samples share, as far as the metadata tell of it.

    Parameters
    ----------
    metadata : Metadata
    parts : list of Part
        The images' cells, in the order of the samples.
    image, incidence : ndarray of int64, shape (N,)
        Image and incidence of every sample.
    """
    terms = [
        SharedTerm(
            "mapping",
            "what eq. (3) leaves out on this dome, to leading order",
            shift=np.concatenate([part.shift for part in parts]),
        )
    ]
    source = (
        np.radians(metadata.lamp.half_angle_deg or 0.0) / 2
    )  # sd of a uniform disc on each axis
    if source:
        terms.append(SharedTerm("source cone", "the lamp's finite half-angle", blur=source))
    terms += _slope_terms(metadata, parts, incidence)
    if metadata.limits.multibounce:
        share = metadata.limits.multibounce * metadata.standard.reflectance
        terms.append(SharedTerm("multi-bounce", "light that reaches the sample twice", share))
    if metadata.standard.uncertainty:
        terms.append(
            SharedTerm(
                "standard", "reflectance of the white standard", metadata.standard.uncertainty
            )
        )
    if metadata.standard.rolloff_uncertainty:
        theta_r = angles(np.concatenate([part.centroid for part in parts]))[0]
        terms.append(
            SharedTerm(
                "standard, shape",
                "how the standard departs from a Lambertian one at high angles",
                metadata.standard.rolloff_uncertainty,
                profile=(theta_r / np.radians(75)) ** 4,
            )
        )
    if metadata.lamp.drift:
        drift = metadata.lamp.drift
        terms.append(SharedTerm("lamp, sample", "lamp output, image to image", drift, image))
        # The standard's image is averaged over its repeats and serves every rotation.
        averaged = drift / np.sqrt(metadata.plan.repeats)
        terms.append(
            SharedTerm("lamp, standard", "lamp output when the standard was taken", averaged,
                       incidence)
        )  # fmt: skip
    return tuple(terms)


def _slope_terms(
    metadata: Metadata, parts: list[Part], incidence: NDArray[np.int64]
) -> list[SharedTerm]:
    """What unknown, smooth slope errors of the dome do to a lobe.

    They shift directions by 2 e, alike over a correlation length L: a lobe is moved as a whole and
    stretched by 2 e / L, in the plane of incidence and across. Incidences L apart see other parts
    of the dome; rotations of the sample at one incidence see the same.
    """
    limits = metadata.limits
    slope, rim_slope = limits.slope_error_deg or 0.0, limits.rim_slope_error_deg or 0.0
    if not (slope or rim_slope):
        return []
    reach = np.radians(limits.slope_correlation_deg)
    moved: list[FloatArray] = []
    stretched: list[FloatArray] = []
    across: list[FloatArray] = []
    for part in parts:
        rim = (part.theta_i / (np.pi / 2)) ** 6
        size = 2 * np.radians(slope + rim_slope * rim)
        mirror = np.array([-np.sin(part.theta_i), 0.0, np.cos(part.theta_i)])
        axes = (np.array([np.cos(part.theta_i), 0.0, np.sin(part.theta_i)]), np.array([0, 1.0, 0]))
        lab = rotated(part.centroid, -part.psi)
        shifts = [size * axes[0] * np.ones((len(lab), 1))]
        for axis in axes:
            # Beyond L the error is another one: it grows no further.
            distance = np.clip((lab - mirror) @ axis, -reach, reach)
            shifts.append(size / reach * distance[:, None] * axis)
        for kept, shift in zip((moved, stretched, across), shifts, strict=True):
            # Only the part across the direction turns it.
            shift = shift - np.sum(shift * lab, axis=1, keepdims=True) * lab
            kept.append(rotated(shift, part.psi))
    theta_i = np.radians(metadata.plan.theta_i_deg)
    group = np.floor(theta_i / reach).astype(np.int64)[incidence]
    meanings = ("moves the lobe", "stretches the lobe in the plane of incidence", "and across it")
    names = ("dome slope, shift", "dome slope, in plane", "dome slope, across")
    return [
        SharedTerm(
            name, f"slope errors of the dome: {meaning}", group=group, shift=np.concatenate(s)
        )
        for name, meaning, s in zip(names, meanings, (moved, stretched, across), strict=True)
    ]
