"""Room light that sample and standard reflect. The background does not contain it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

RECORD = TermRecord("room light", "room light that the sample reflects", constant=True)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """Room light whose irradiance is a times that of the lamp at normal incidence.

    It turns f into (f cos(theta_i) + a rho/pi)/(cos(theta_i) + a) for a sample that shows rho in
    even light; the image's own mean of f stands for rho/pi.
    """
    a = measured.metadata.limits.ambient
    if not a or measured.metadata.plan.mode == "transmission":
        return
    changes = []
    for part in measured.images:
        weight = part.solid_angle * part.centroid[:, 2]
        mean = np.sum(weight * part.means[0]) / np.sum(weight) if len(weight) else 0.0
        changes.append(a * (mean - part.means[0]) / (np.cos(part.theta_i) + a))
    yield RECORD.shared(offset=np.concatenate(changes))


def _on_a_sheet(metadata: Metadata, pixel_map: PixelMap) -> bool:
    return metadata.plan.mode == "transmission" and bool(metadata.limits.ambient)


EFFECT = Effect(
    key="room_light",
    order=100,
    title="room light",
    text="Sample and standard reflect light of the room. The background does not contain it, since "
    "it is taken without a sample. It makes lobes flatter.",
    records=(RECORD,),
    terms=terms,
    unknown=(
        Unknown("room light that the sample reflects", "limits.ambient"),
        Unknown("room light on a sheet in transmission", holds=_on_a_sheet),
    ),
    quantities=(StatedQuantity("room light", "limits.ambient"),),
)
