"""Samples as a pandas table and back; angles in radians, or in degrees on request."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.geometry import Directions
from gonio.samples.record import ANGLES, PER_SAMPLE, SampleRecord

if TYPE_CHECKING:
    import pandas as pd

AngleUnit = Literal["rad", "deg"]
# Column of the table for each field of the samples, as gonio's CSV names them.
NAMES = {"value": "brdf", "u_independent": "u_brdf"} | {
    name: name for name in PER_SAMPLE if name != "u_independent"
}


def to_frame(samples: SampleRecord, angles: AngleUnit) -> pd.DataFrame:
    """One row per sample: the four angles, brdf, and the other columns of the samples."""
    import pandas as pd

    degrees = _is_degrees(angles)
    columns: dict[str, Any] = {}
    for name in ANGLES:
        angle = np.broadcast_to(getattr(samples.directions, name), (len(samples),))
        columns[name] = np.degrees(angle) if degrees else angle
    for field, name in NAMES.items():
        column = getattr(samples, field)
        if column is not None:
            columns[name] = column
    return pd.DataFrame(columns)


def from_frame(frame: pd.DataFrame, angles: AngleUnit) -> dict[str, Any]:
    """The fields of samples from a table.

    Raises
    ------
    DataError
        If a column is missing or unknown, or polar angles look like degrees.
    """
    degrees = _is_degrees(angles)
    columns = (*ANGLES, *NAMES.values())
    for name in frame.columns:
        if name not in columns:
            raise DataError(str(unknown_name("column", str(name), columns)), value=name)
    missing = [name for name in (*ANGLES, "brdf") if name not in frame.columns]
    if missing:
        raise DataError(
            f"the table has no column {', '.join(missing)}; wanted are {', '.join(ANGLES)}, in "
            "radians unless angles='deg' is given, and brdf in sr^-1.",
            value=missing,
        )
    given = [np.asarray(frame[name], float) for name in ANGLES]
    if not degrees and any(np.any(given[k] > np.pi / 2 + 1e-6) for k in (0, 2)):
        raise DataError(
            "a polar angle of the table is beyond 90 deg taken as radians; where its angles are "
            "degrees give angles='deg'."
        )
    fields = {f: _column(frame[name], f) for f, name in NAMES.items() if name in frame.columns}
    directions = Directions(*(np.radians(angle) if degrees else angle for angle in given))
    return {"directions": directions, **fields}


def _column(column: Any, field: str) -> Any:
    if field == "channel":
        return np.asarray(column).astype(np.str_)
    kind = {"flags": np.uint8, "image": np.int64}.get(field, np.float64)
    return np.asarray(column, kind)


def _is_degrees(angles: str) -> bool:
    if angles not in ("rad", "deg"):
        raise ConfigurationError(f"angles = {angles!r}; allowed are 'rad' and 'deg'.", value=angles)
    return angles == "deg"
