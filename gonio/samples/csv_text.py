"""Samples as a CSV for people and spreadsheets: one line per sample, angles in degrees."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import DataError
from gonio.files import write_text
from gonio.geometry import Directions, FloatArray
from gonio.samples.record import ANGLES, SampleRecord


def write_csv(path: Path, samples: SampleRecord) -> None:
    """Write directions, values and, where known, uncertainty, channel and wavelength.

    Raises
    ------
    DataError
        If the file cannot be written, or the samples are not a BRDF.
    """
    if samples.quantity != "BRDF":
        raise DataError(
            f"{path}: the samples are a {samples.quantity} and the table has a column for a BRDF; "
            "save them as netCDF (.nc), which says what they are.",
            value=samples.quantity,
        )
    columns: dict[str, Sequence[str]] = {"brdf": printed(samples.value)}
    if samples.u_independent is not None:
        columns["u_brdf"] = printed(samples.u_independent)
    if samples.channel is not None:
        columns["channel"] = samples.channel.tolist()
    if samples.wavelength_nm is not None:
        columns["wavelength_nm"] = printed(samples.wavelength_nm)
    write_text(path, csv_text(samples.directions, columns))


def not_in_csv(samples: SampleRecord) -> list[str]:
    """Names of the data for which a CSV has no column."""
    names = {
        "cells": "the cells over which a fit integrates",
        "noise_slope": "the growth of the noise with the value",
        "u_reference": "the part of the noise that reference frames share",
        "solid_angle": "solid angles",
        "flags": "flags",
        "image": "the images of the samples",
    }
    lost = [words for name, words in names.items() if getattr(samples, name) is not None]
    if samples.shared:
        terms = len(samples.shared)
        lost.insert(0, f"{terms} shared error{'s' if terms > 1 else ''}")
    return lost


def csv_text(directions: Directions, columns: dict[str, Sequence[str]]) -> str:
    """The text of a CSV: the four angles in degrees, then columns of printed cells."""
    shape = directions.shape
    angles = [
        printed(_degrees(np.broadcast_to(getattr(directions, name), shape))) for name in ANGLES
    ]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*ANGLES, *columns])
    writer.writerows(zip(*angles, *columns.values(), strict=True))
    return text.getvalue()


def printed(values: FloatArray) -> list[str]:
    """Numbers with 17 significant digits, which are read back bit for bit."""
    return [f"{value:.17g}" for value in values.tolist()]


def _degrees(radians: NDArray[Any]) -> FloatArray:
    """Degrees that `np.radians` converts back to the same bits; the shortest such numbers."""
    exact = np.degrees(radians)
    best = np.array(exact)
    pending = np.ones(best.shape, dtype=bool)
    candidates = [np.round(exact, 10), np.round(exact, 12), exact]
    for side in (-np.inf, np.inf):
        step = exact
        for _ in range(2):
            step = np.nextafter(step, side)
            candidates.append(step)
    for candidate in candidates:
        hit = pending & (np.radians(candidate) == radians)
        best[hit] = candidate[hit]
        pending &= ~hit
    return best
