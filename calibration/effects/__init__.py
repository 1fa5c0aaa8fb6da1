"""Sources of error that samples share. One file of this folder is one source of error.

A file that defines `EFFECT = Effect(...)` is a source of error. No other file lists it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.effects.base import Effect, Measured
from gonio.calibration.image_cells import ImageCells
from gonio.discovery import records_in
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

__all__ = ["all_effects", "corrected", "notes", "shared_terms", "unknown"]


@cache
def all_effects() -> tuple[Effect, ...]:
    """Every source of error, in its order.

    Examples
    --------
    >>> "lamp_drift" in [effect.key for effect in all_effects()]
    True
    """
    effects = records_in(__name__, "EFFECT", Effect)
    return tuple(sorted(effects, key=lambda effect: (effect.order, effect.key)))


def shared_terms(measured: Measured) -> tuple[SharedTerm, ...]:
    """Every error that the samples of a session share, as far as its metadata state them."""
    return tuple(
        replace(term, effect=effect.key)
        for effect in all_effects()
        for term in effect.terms(measured)
    )


def corrected(metadata: Metadata, images: list[ImageCells]) -> list[ImageCells]:
    """The cells, corrected for every effect whose size is known."""
    for effect in all_effects():
        if effect.corrected is not None:
            images = effect.corrected(metadata, images)
    return images


def unknown(metadata: Metadata, pixel_map: PixelMap) -> tuple[str, ...]:
    """Sources of error whose size nobody stated, and that no uncertainty holds."""
    return tuple(
        each.text
        for effect in all_effects()
        for each in effect.unknown
        if each.is_unknown(metadata, pixel_map)
    )


def notes(metadata: Metadata, pixel_map: PixelMap) -> tuple[str, ...]:
    """Lines of the history: what was corrected, what was assumed, what is unknown."""
    lines = [line for effect in all_effects() for line in effect.notes(metadata)]
    missing = [f"unknown, not included: {text}" for text in unknown(metadata, pixel_map)]
    return (*lines, *missing)
