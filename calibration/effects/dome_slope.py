"""Unknown, smooth slope errors of the dome. Typical patterns represent the field."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.dome_map import DomeMap
from gonio.geometry import FloatArray, rotated
from gonio.shared_term import SharedTerm

# What slope errors do to a lobe, the component of the shift (0 in the plane of incidence, 1
# across) and the axis along which it grows; None: constant over the lobe.
_PATTERNS: tuple[tuple[str, str, int, int | None], ...] = (
    ("shift", "moves the lobe", 0, None),
    ("in plane", "stretches the lobe in the plane of incidence", 0, 0),
    ("across", "stretches the lobe across the plane of incidence", 1, 1),
    ("shear in plane", "shears the lobe along the plane of incidence", 0, 1),
    ("shear across", "shears the lobe across the plane of incidence", 1, 0),
)
RECORDS = tuple(
    TermRecord(f"dome slope, {name}", f"slope errors of the dome: {meaning}", typical=True)
    for name, meaning, _, _ in _PATTERNS
)
# A dome that was drawn: planning uses the drawn field itself instead of the patterns.
DRAWN = TermRecord("dome slope", "slope errors of the dome")


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """What unknown, smooth slope errors of the dome do to a lobe.

    Slope errors e shift directions by 2 e and are correlated over a length L: they move a lobe as a
    whole, and stretch and shear it by 2 e / L. Along the plane of incidence and across it e has two
    components and each of them two slopes, all independent; a sample turned by 45 deg shows the
    shears as a stretch. Incidences L apart see other parts of the dome; rotations of the sample at
    one incidence see the same.
    """
    limits = measured.metadata.limits
    slope, rim_slope = limits.slope_error_deg or 0.0, limits.rim_slope_error_deg or 0.0
    if not (slope or rim_slope):
        return
    reach = np.radians(limits.slope_correlation_deg)
    patterns: list[list[FloatArray]] = [[] for _ in _PATTERNS]
    for part in measured.images:
        rim = (part.theta_i / (np.pi / 2)) ** 6
        size = 2 * np.radians(slope + rim_slope * rim)
        mirror = np.array([-np.sin(part.theta_i), 0.0, np.cos(part.theta_i)])
        axes = (np.array([np.cos(part.theta_i), 0.0, np.sin(part.theta_i)]), np.array([0, 1.0, 0]))
        lab = rotated(part.centroid, -part.psi)
        # Beyond L the error is another one: it grows no further. A stretch that fell off as the
        # correlation does would leave the finer shapes out, and with them half of alpha's error.
        distance = [np.clip((lab - mirror) @ axis, -reach, reach) / reach for axis in axes]
        for kept, (_, _, component, slope_along) in zip(patterns, _PATTERNS, strict=True):
            grows = np.ones(len(lab)) if slope_along is None else distance[slope_along]
            left = (
                1.0
                if measured.dome is None
                else _left(measured.dome, mirror, axes, reach, component, slope_along)
            )
            shift = left * size * grows[:, None] * axes[component]
            # Only the part across the direction turns it.
            shift = shift - np.sum(shift * lab, axis=1, keepdims=True) * lab
            kept.append(rotated(shift, part.psi))
    theta_i = np.radians(measured.metadata.plan.theta_i_deg)
    # The dome is the same in every channel, whose incidences are counted on.
    group = np.floor(theta_i / reach).astype(np.int64)[measured.incidence % len(theta_i)]
    for shifts, record in zip(patterns, RECORDS, strict=True):
        yield record.shared(group=group, shift=np.concatenate(shifts))


def _left(
    dome: DomeMap,
    mirror: FloatArray,
    axes: tuple[FloatArray, FloatArray],
    reach: float,
    component: int,
    slope_along: int | None,
) -> float:
    """What a map of the dome leaves of a pattern at the mirror direction, as a part of it."""
    if slope_along is None:
        where, weight = mirror[None], [1.0]
    else:
        step = reach / 4 * axes[slope_along]
        where, weight = np.stack([mirror + step, mirror - step]), [1.0, -1.0]
        where = where / np.linalg.norm(where, axis=1, keepdims=True)
    return dome.remaining(where, np.broadcast_to(axes[component], where.shape), weight)


EFFECT = Effect(
    key="dome_slope",
    order=40,
    title="slope errors of the dome",
    text="The dome's surface is tilted by small angles that are correlated over some length. The "
    "field is unknown. A shift, two stretches and two shears of the lobe at each incidence "
    "represent it. A map of the dome (`gonio calibrate dome`) corrects directions and leaves what "
    "it does not know of these five. `gonio design` uses drawn fields instead.",
    records=RECORDS,
    terms=terms,
    unknown=(Unknown("slope errors of the dome", "limits.slope_error_deg"),),
    quantities=(
        StatedQuantity("slope error of the dome", "limits.slope_error_deg", "°"),
        StatedQuantity("slope error added at the rim", "limits.rim_slope_error_deg", "°"),
    ),
)
