"""The errors that the samples of a session share: those of direction here, of light beside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.dome.pixel_map import PixelMap, across, error_modes, left_out
from gonio.calibration.effects.light_terms import light_terms, unknown_light
from gonio.calibration.image_cells import ImageCells
from gonio.geometry import FloatArray, rotated
from gonio.metadata import LampRecord, Limits, Metadata
from gonio.shared_term import SharedTerm

# Name and meaning of what slope errors do to a lobe, the component of the shift (0 in the plane of
# incidence, 1 across) and the axis along which it grows; None: alike all over.
_SLOPES: tuple[tuple[str, str, int, int | None], ...] = (
    ("shift", "moves the lobe", 0, None),
    ("in plane", "stretches the lobe in the plane of incidence", 0, 0),
    ("across", "stretches the lobe across the plane of incidence", 1, 1),
    ("shear in plane", "shears the lobe along the plane of incidence", 0, 1),
    ("shear across", "shears the lobe across the plane of incidence", 1, 0),
)
ASSUMED_CONE = 0.1  # relative uncertainty of a half-angle of the lamp that states none


def shared_terms(
    metadata: Metadata,
    seen: PixelMap,
    parts: list[ImageCells],
    image: NDArray[np.int64],
    incidence: NDArray[np.int64],
) -> tuple[SharedTerm, ...]:
    """Every error of a session that many samples share, as far as the metadata tell of it.

    Parameters
    ----------
    metadata : Metadata
    seen : PixelMap
        The mapping of the pixels.
    parts : list of ImageCells
        The images' cells, in the order of the samples.
    image, incidence : ndarray of int64, shape (N,)
        Image and incidence of every sample, channel by channel counted on.
    """
    terms = _geometry_terms(seen, parts)
    terms += _source_terms(metadata.lamp)
    terms += _slope_terms(metadata, parts, incidence)
    terms += _azimuth_terms(metadata.limits)
    terms += light_terms(metadata, parts, image, incidence)
    return tuple(terms)


def unknown(metadata: Metadata, seen: PixelMap) -> tuple[str, ...]:
    """Sources of error whose size nobody stated, and that no uncertainty holds."""
    figures = {"geometry": "geometry of the dome", "lens": "lens calibration"}
    found = [f"{text} ({name}.uncertain)" for name, text in figures.items()
             if name not in seen.uncertain]  # fmt: skip
    if metadata.lamp.half_angle_deg is None:
        found.append("the lamp's cone (lamp.half_angle_deg)")
    if metadata.limits.slope_error_deg is None:
        found.append("slope errors of the dome (limits.slope_error_deg)")
    if metadata.limits.u_azimuth_deg is None:
        found.append("azimuth of the sample (limits.u_azimuth_deg)")
    return (*found, *unknown_light(metadata))


def notes(metadata: Metadata, seen: PixelMap) -> tuple[str, ...]:
    """What the geometry's terms rest on, for the history: what is unknown, what is assumed."""
    unknown = [name for name in ("geometry", "lens") if name not in seen.uncertain]
    lines = []
    if metadata.limits.u_azimuth_deg is None:
        lines.append("azimuth of the sample: uncertainty unknown, not included")
    if unknown:
        lines.append(f"uncertainty of the {' and of the '.join(unknown)}: unknown, not included")
    angle, u = metadata.lamp.half_angle_deg, metadata.lamp.u_half_angle_deg
    if angle is None:
        lines.append("source cone: half-angle unknown, not included")
    elif angle or u:
        stated = f"unknown, {ASSUMED_CONE:.0%} assumed" if u is None else f"{u:g} deg"
        lines.append(
            f"source cone of half-angle {angle:g} deg is part of the members; "
            f"its uncertainty: {stated}"
        )
    return tuple(lines)


def _geometry_terms(seen: PixelMap, parts: list[ImageCells]) -> list[SharedTerm]:
    """What eq. (3) leaves out, and the errors of the calibrated figures behind the mapping."""
    at = [part.at.T for part in parts]
    columns, rows = np.concatenate(at, axis=1)

    def turned(shift: FloatArray) -> FloatArray:
        """Shifts in the frame of the sample, across the directions of its cells."""
        ends = np.cumsum([pixels.shape[1] for pixels in at])[:-1]
        pieces = zip(np.split(shift, ends), parts, strict=True)
        return np.concatenate([across(rotated(s, p.psi), p.centroid) for s, p in pieces])

    terms = []
    if seen.mapping == "eq3":
        terms.append(
            SharedTerm(
                "mapping",
                "what eq. (3) leaves out on this dome",
                shift=turned(left_out(seen, columns, rows)),
            )
        )
    for name, uncertain in seen.uncertain.items():
        for number, mode in enumerate(error_modes(seen, uncertain, columns, rows), start=1):
            meaning = f"calibration of the {name}: mostly {', '.join(mode.figures)}"
            terms.append(SharedTerm(f"{name}, mode {number}", meaning, shift=turned(mode.shift)))
    return terms


def _source_terms(lamp: LampRecord) -> list[SharedTerm]:
    """How far the half-angle a of the lamp may be off: the members hold the cone itself.

    A cone of a + u blurs by another sqrt((a + u)^2 - a^2)/2 on each axis.
    """
    if lamp.half_angle_deg is None:
        return []
    a = np.radians(lamp.half_angle_deg)
    u = ASSUMED_CONE * a if lamp.u_half_angle_deg is None else np.radians(lamp.u_half_angle_deg)
    blur = float(np.sqrt((a + u) ** 2 - a**2)) / 2
    if not blur:
        return []
    return [SharedTerm("source cone", "half-angle of the lamp's cone", blur=blur)]


def _azimuth_terms(limits: Limits) -> list[SharedTerm]:
    """How far the zero of the sample's rotation may be off: one turn for all images."""
    if not limits.u_azimuth_deg:
        return []
    turn = float(np.radians(limits.u_azimuth_deg))
    return [SharedTerm("azimuth", "azimuth at which the sample lies", turn=turn)]


def _slope_terms(
    metadata: Metadata, parts: list[ImageCells], incidence: NDArray[np.int64]
) -> list[SharedTerm]:
    """What unknown, smooth slope errors of the dome do to a lobe.

    They shift directions by 2 e, alike over a correlation length L: a lobe is moved as a whole, and
    stretched and sheared by 2 e / L. Along the plane of incidence and across it e has two
    components and each of them two slopes, all independent; a sample turned by 45 deg shows the
    shears as a stretch. Incidences L apart see other parts of the dome; rotations of the sample at
    one incidence see the same.
    """
    limits = metadata.limits
    slope, rim_slope = limits.slope_error_deg or 0.0, limits.rim_slope_error_deg or 0.0
    if not (slope or rim_slope):
        return []
    reach = np.radians(limits.slope_correlation_deg)
    found: list[list[FloatArray]] = [[] for _ in _SLOPES]
    for part in parts:
        rim = (part.theta_i / (np.pi / 2)) ** 6
        size = 2 * np.radians(slope + rim_slope * rim)
        mirror = np.array([-np.sin(part.theta_i), 0.0, np.cos(part.theta_i)])
        axes = (np.array([np.cos(part.theta_i), 0.0, np.sin(part.theta_i)]), np.array([0, 1.0, 0]))
        lab = rotated(part.centroid, -part.psi)
        # Beyond L the error is another one: it grows no further. A stretch that fell off as the
        # correlation does would leave the finer shapes out, and with them half of alpha's error.
        distance = [np.clip((lab - mirror) @ axis, -reach, reach) / reach for axis in axes]
        for kept, (_, _, component, slope_along) in zip(found, _SLOPES, strict=True):
            grows = np.ones(len(lab)) if slope_along is None else distance[slope_along]
            shift = size * grows[:, None] * axes[component]
            # Only the part across the direction turns it.
            shift = shift - np.sum(shift * lab, axis=1, keepdims=True) * lab
            kept.append(rotated(shift, part.psi))
    theta_i = np.radians(metadata.plan.theta_i_deg)
    # The dome is the same in every channel, whose incidences are counted on.
    group = np.floor(theta_i / reach).astype(np.int64)[incidence % len(theta_i)]
    return [
        SharedTerm(
            f"dome slope, {name}",
            f"slope errors of the dome: {meaning}",
            group=group,
            shift=np.concatenate(shift),
            typical=True,
        )
        for shift, (name, meaning, _, _) in zip(found, _SLOPES, strict=True)
    ]
