"""Errors of the calibration of dome and lens, from which directions are computed."""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.dome.pixel_map import PixelMap, error_modes
from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

RECORDS = {
    name: TermRecord(f"{name}, mode N", f"calibration of the {name}", evaluation="A")
    for name in ("geometry", "lens")
}


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """Independent errors of directions, from the covariances of dome and lens."""
    pixel_map = measured.pixel_map
    for name, uncertain in pixel_map.uncertain.items():
        modes = error_modes(pixel_map, uncertain, *measured.pixels)
        for number, mode in enumerate(modes, start=1):
            yield RECORDS[name].shared(
                name=f"{name}, mode {number}",
                meaning=f"{RECORDS[name].meaning}: mostly {', '.join(mode.quantities)}",
                shift=measured.left_by_map(measured.in_sample_frame(mode.shift)),
            )


def _not_stated(name: str, words: str) -> Unknown:
    def holds(metadata: Metadata, pixel_map: PixelMap) -> bool:
        # A file of the alignment may state what the session does not.
        return name not in pixel_map.uncertain

    return Unknown(words, f"{name}.uncertain", holds)


EFFECT = Effect(
    key="calibrated_geometry",
    order=20,
    title="calibration of dome and lens",
    text="R, D, the position of the pupil, the camera's azimuth, the focal length, the polynomial "
    "of the lens and the image centre turn all directions together. Their covariances become "
    "independent modes, the largest first.",
    records=tuple(RECORDS.values()),
    terms=terms,
    unknown=(
        _not_stated("geometry", "geometry of the dome"),
        _not_stated("lens", "lens calibration"),
    ),
    quantities=(
        StatedQuantity("uncertainty of the geometry", "geometry.uncertain"),
        StatedQuantity("uncertainty of the lens", "lens.uncertain"),
    ),
)
