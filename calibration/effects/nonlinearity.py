"""What is left of the camera's nonlinearity: bright and dim signals are not in proportion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

RECORD = TermRecord(
    "nonlinearity", "signals of the camera that are not in proportion to the light", constant=True
)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """The change of f by one standard uncertainty of the nonlinearity per decade."""
    u = measured.metadata.camera.u_nonlinearity_per_decade
    parts = [image.bend for image in measured.images if image.bend is not None]
    if not u or len(parts) < len(measured.images):
        return
    yield RECORD.shared(offset=u * np.concatenate(parts))


def notes(metadata: Metadata) -> tuple[str, ...]:
    """Which nonlinearity was corrected, for the history."""
    camera = metadata.camera
    if not camera.nonlinearity_per_decade:
        return ()
    u = camera.u_nonlinearity_per_decade
    price = "unknown uncertainty" if u is None else f"+- {100 * u:.2g} %"
    return (f"nonlinearity of {100 * camera.nonlinearity_per_decade:.3g} % per decade corrected, "
            f"{price}",)  # fmt: skip


EFFECT = Effect(
    key="nonlinearity",
    order=75,
    title="nonlinearity of the camera",
    text="Counts above black are times 1 + n log10(e/Q), with e the electrons, Q the full well and "
    "n the nonlinearity per decade. The standard is bright and a sample beside its lobe is dim: "
    "their ratio is off. gonio calibrate camera measures n; the reduction corrects for it, and its "
    "standard uncertainty is a shared error of all samples.",
    records=(RECORD,),
    terms=terms,
    unknown=(Unknown("nonlinearity of the camera", "camera.u_nonlinearity_per_decade"),),
    quantities=(
        StatedQuantity("nonlinearity per decade", "camera.nonlinearity_per_decade"),
        StatedQuantity(
            "uncertainty of the nonlinearity per decade", "camera.u_nonlinearity_per_decade"
        ),
    ),
    notes=notes,
)
