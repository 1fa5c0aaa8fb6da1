"""Unknown, smooth slope errors of the dome: typical patterns stand for the field."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.effects.base import Effect, Figure, Measured, TermRecord, Unknown
from gonio.geometry import FloatArray, rotated
from gonio.shared_term import SharedTerm

# What slope errors do to a lobe, the component of the shift (0 in the plane of incidence, 1
# across) and the axis along which it grows; None: alike all over.
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
# A dome that was drawn, where planning puts the field itself in the place of its patterns.
DRAWN = TermRecord("dome slope", "slope errors of the dome")


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """What unknown, smooth slope errors of the dome do to a lobe.

    They shift directions by 2 e, alike over a correlation length L: a lobe is moved as a whole, and
    stretched and sheared by 2 e / L. Along the plane of incidence and across it e has two
    components and each of them two slopes, all independent; a sample turned by 45 deg shows the
    shears as a stretch. Incidences L apart see other parts of the dome; rotations of the sample at
    one incidence see the same.
    """
    limits = measured.metadata.limits
    slope, rim_slope = limits.slope_error_deg or 0.0, limits.rim_slope_error_deg or 0.0
    if not (slope or rim_slope):
        return
    reach = np.radians(limits.slope_correlation_deg)
    found: list[list[FloatArray]] = [[] for _ in _PATTERNS]
    for part in measured.images:
        rim = (part.theta_i / (np.pi / 2)) ** 6
        size = 2 * np.radians(slope + rim_slope * rim)
        mirror = np.array([-np.sin(part.theta_i), 0.0, np.cos(part.theta_i)])
        axes = (np.array([np.cos(part.theta_i), 0.0, np.sin(part.theta_i)]), np.array([0, 1.0, 0]))
        lab = rotated(part.centroid, -part.psi)
        # Beyond L the error is another one: it grows no further. A stretch that fell off as the
        # correlation does would leave the finer shapes out, and with them half of alpha's error.
        distance = [np.clip((lab - mirror) @ axis, -reach, reach) / reach for axis in axes]
        for kept, (_, _, component, slope_along) in zip(found, _PATTERNS, strict=True):
            grows = np.ones(len(lab)) if slope_along is None else distance[slope_along]
            shift = size * grows[:, None] * axes[component]
            # Only the part across the direction turns it.
            shift = shift - np.sum(shift * lab, axis=1, keepdims=True) * lab
            kept.append(rotated(shift, part.psi))
    theta_i = np.radians(measured.metadata.plan.theta_i_deg)
    # The dome is the same in every channel, whose incidences are counted on.
    group = np.floor(theta_i / reach).astype(np.int64)[measured.incidence % len(theta_i)]
    for shifts, record in zip(found, RECORDS, strict=True):
        yield record.shared(group=group, shift=np.concatenate(shifts))


EFFECT = Effect(
    key="dome_slope",
    order=40,
    title="slope errors of the dome",
    text="The dome's surface is tilted by small angles, alike over a correlation length. Nobody "
    "knows the field; a shift, two stretches and two shears of the lobe at each incidence stand "
    "for it. `gonio design` puts drawn fields in their place.",
    records=RECORDS,
    terms=terms,
    unknown=(Unknown("slope errors of the dome", "limits.slope_error_deg"),),
    figures=(
        Figure("slope error of the dome", "limits.slope_error_deg", "°"),
        Figure("slope error added at the rim", "limits.rim_slope_error_deg", "°"),
    ),
)
