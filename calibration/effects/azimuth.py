"""The azimuth at which the sample lies: the zero of its rotation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.shared_term import SharedTerm

RECORD = TermRecord("azimuth", "azimuth at which the sample lies")


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """How far the zero of the sample's rotation may be off: one turn for all images."""
    u = measured.metadata.limits.u_azimuth_deg
    if u:
        yield RECORD.shared(turn=float(np.radians(u)))


EFFECT = Effect(
    key="azimuth",
    order=50,
    title="azimuth of the sample",
    text="The zero of the sample's rotation may be off. It turns both directions together and "
    "matters for anisotropic surfaces.",
    records=(RECORD,),
    terms=terms,
    unknown=(Unknown("azimuth of the sample", "limits.u_azimuth_deg"),),
    quantities=(
        StatedQuantity("uncertainty of the sample's azimuth", "limits.u_azimuth_deg", "°"),
    ),
)
