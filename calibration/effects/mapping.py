"""The error of eq. (3), which the paper calls an approximation."""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.dome.pixel_map import left_out
from gonio.calibration.effects.base import Effect, Measured, TermRecord
from gonio.shared_term import SharedTerm

RECORD = TermRecord("mapping", "what eq. (3) leaves out on this dome", constant=True)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """Exact direction minus that of eq. (3), if the session is mapped by eq. (3)."""
    if measured.pixel_map.mapping == "eq3":
        shift = left_out(measured.pixel_map, *measured.pixels)
        yield RECORD.shared(shift=measured.left_by_map(measured.in_sample_frame(shift)))


EFFECT = Effect(
    key="mapping",
    order=10,
    title="approximation of eq. (3)",
    text="Eq. (3) turns a pixel into a direction only approximately, good to (D/R)^3 on an "
    "ellipsoid. The error is computed by the law of reflection. `--mapping exact` does not use "
    "eq. (3) and does not have this error.",
    records=(RECORD,),
    terms=terms,
)
