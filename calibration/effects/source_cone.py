"""The half-angle of the lamp's cone. The cells include the cone, but not its uncertainty."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

ASSUMED_CONE = 0.1  # relative uncertainty of a half-angle of the lamp that states none
RECORD = TermRecord("source cone", "half-angle of the lamp's cone", constant=True)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """The uncertainty u of the half-angle a of the lamp.

    A cone of a + u blurs by another sqrt((a + u)^2 - a^2)/2 on each axis.
    """
    lamp = measured.metadata.lamp
    if lamp.half_angle_deg is None:
        return
    a = np.radians(lamp.half_angle_deg)
    u = ASSUMED_CONE * a if lamp.u_half_angle_deg is None else np.radians(lamp.u_half_angle_deg)
    blur = float(np.sqrt((a + u) ** 2 - a**2)) / 2
    if blur:
        yield RECORD.shared(blur=blur)


def notes(metadata: Metadata) -> tuple[str, ...]:
    """The half-angle that the cells include, and its uncertainty."""
    angle, u = metadata.lamp.half_angle_deg, metadata.lamp.u_half_angle_deg
    if not (angle or u) or angle is None:
        return ()
    stated = f"unknown, {ASSUMED_CONE:.0%} assumed" if u is None else f"{u:g} deg"
    line = f"source cone of half-angle {angle:g} deg is part of the members"
    return (f"{line}; its uncertainty: {stated}",)


EFFECT = Effect(
    key="source_cone",
    order=30,
    title="cone of the lamp",
    text="The sample sees the lamp as a cone, which blurs a lobe. The members of a cell include "
    "the cone. This error is the uncertainty of its half-angle. If none is stated, "
    f"{ASSUMED_CONE:.0%} is assumed.",
    records=(RECORD,),
    terms=terms,
    unknown=(Unknown("the lamp's cone", "lamp.half_angle_deg"),),
    quantities=(
        StatedQuantity("half-angle of the lamp", "lamp.half_angle_deg", "°"),
        StatedQuantity("uncertainty of the lamp's half-angle", "lamp.u_half_angle_deg", "°"),
    ),
    notes=notes,
)
