"""gonio's own table: one line is one sample, angles in degrees.

The header names the columns, in any order: ``theta_i, phi_i, theta_r, phi_r`` (degrees; both
directions leave the surface; phi from +x, counter-clockwise seen from outside) and ``brdf``
(sr^-1, cosine not included), and where known ``u_brdf`` (standard uncertainty, sr^-1),
``channel`` (a name) and ``wavelength_nm``. A file of directions needs the angles only. A name may
be followed by its unit, as in ``theta_i [deg]``, ``phi_r/deg`` or ``brdf (sr^-1)``.

Lines without a reading (an empty cell, ``NaN``, ``n/a``, ``--``, or ``u_brdf`` that is not
positive) are left out if they are fewer than half. A polar angle may carry a sign where at least
three lines do so: a negative one means that the azimuth is larger by 180 degrees. `metadata` says
what was done.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import DataError
from gonio.formats._header import base_name, column_names
from gonio.formats._signed_angles import unsigned
from gonio.formats._text import Lines, Table, check_polar, measured, numbers, open_text
from gonio.geometry import Directions, FloatArray
from gonio.samples import ANGLES, BRDFSamples
from gonio.samples.csv_text import csv_text, printed, write_csv

NAME = "gonio_csv"
TITLE = "gonio CSV: theta_i, phi_i, theta_r, phi_r in degrees and brdf"

REQUIRED = (*ANGLES, "brdf")
OPTIONAL = ("u_brdf", "channel", "wavelength_nm")
COLUMNS = (*REQUIRED, *OPTIONAL)
LISTED = 100  # lines that the record of a reading lists


def mismatch(path: Path, head: bytes) -> str | None:
    """Why the file is not in this format, or None where it is."""
    if b"\0" in head:
        return "it is not UTF-8 text"
    first = head.decode("utf-8-sig", errors="replace").lstrip().split("\n", 1)[0]
    names = {
        base_name(cell.strip()) for cell in first.replace(";", ",").replace("\t", ",").split(",")
    }
    if names.isdisjoint(COLUMNS) and path.suffix.lower() != ".csv":
        return f"its first line names none of the columns {', '.join(REQUIRED)}"
    return None


def read(path: str | Path) -> BRDFSamples:
    """Samples from a gonio CSV.

    Parameters
    ----------
    path : str or Path
        File with the columns of this module's description.

    Returns
    -------
    BRDFSamples
        One sample a line, in the order of the file. Values below zero are kept. Where lines were
        left out or polar angles had signs, `metadata` says so under ``reading``.

    Raises
    ------
    DataError
        If a column is missing or unknown, or a cell cannot be used: the message names the line,
        the column and the value.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "one.csv"
    >>> n = file.write_text("theta_i,phi_i,theta_r,phi_r,brdf\\n30,0,45,180,0.25\\n")
    >>> samples = read(file)
    >>> len(samples), float(samples.value[0])
    (1, 0.25)
    """
    path = Path(path)
    columns = _read_columns(path, REQUIRED)
    reading, history = unsigned(path, columns)
    columns, missing = _with_readings(path, columns)
    reading |= missing
    if missing:
        count = missing["left_out"]["count"]
        history.append(f"{count} lines without a reading or its uncertainty left out")
    return BRDFSamples(
        directions=Directions(*(columns[name] for name in ANGLES)),
        value=columns["brdf"],
        u_independent=columns.get("u_brdf"),
        wavelength_nm=columns.get("wavelength_nm"),
        channel=columns.get("channel"),
        line=columns["line"],
        history=tuple(history),
        metadata={"reading": reading} if reading else {},
    )


def write(path: str | Path, samples: BRDFSamples) -> None:
    """Write samples as gonio CSV, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Target; an existing file is replaced.
    samples : BRDFSamples
        Directions, values and, where known, `u_independent`, channel and wavelength are written.

    Raises
    ------
    DataError
        If the file cannot be written, or the samples are not a BRDF.

    Notes
    -----
    Numbers carry 17 significant digits, so values come back bit for bit. Angles are turned to
    degrees such that they come back to the same bits of a radian wherever a double does that;
    elsewhere they come back to the nearest. What `read` made always comes back unchanged.
    Shared terms, cells and history have no column here: `BRDFSamples.save` keeps them.
    """
    write_csv(Path(path), samples)


def read_directions(path: str | Path) -> Directions:
    """The directions of a file that has the four angle columns.

    Columns of samples (``brdf`` and so on) may stand beside them and are not read. Polar angles
    may reach 180 degrees: a model returns 0 beyond the horizon.

    Parameters
    ----------
    path : str or Path
        CSV with the columns theta_i, phi_i, theta_r, phi_r in degrees.

    Returns
    -------
    Directions
        Shape (N,), radians.

    Raises
    ------
    DataError
        As `read`.
    """
    columns = _read_columns(Path(path), ANGLES)
    return Directions(*(columns[name] for name in ANGLES))


def directions_table(directions: Directions, brdf: FloatArray) -> str:
    """The text of a CSV with the four angles, degrees, and the column brdf, sr^-1.

    Parameters
    ----------
    directions : Directions
        Shape (N,), radians.
    brdf : ndarray, shape (N,)
        BRDF, sr^-1, cosine not included.

    Examples
    --------
    >>> print(directions_table(Directions([0.0], 0.0, np.pi / 4, np.pi), np.array([0.5])), end="")
    theta_i,phi_i,theta_r,phi_r,brdf
    0,0,45,180,0.5
    """
    return csv_text(directions, {"brdf": printed(brdf)})


def _read_columns(path: Path, required: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """The wanted columns and `line`; polar angles of samples stay as written, in degrees."""
    samples = required != ANGLES
    wanted = COLUMNS if samples else required
    parts: dict[str, list[NDArray[Any]]] = {}
    with open_text(path) as file:
        table = Table(path, file)
        header = column_names(path, table.header, COLUMNS)
        _check_missing(path, header, required)
        for lines, columns in table.blocks():
            parts.setdefault("line", []).append(lines)
            for name, cells in zip(header, columns, strict=True):
                if name in wanted:
                    part = _column(path, lines, name, cells, signed=samples)
                    parts.setdefault(name, []).append(part)
                    if name == "brdf":
                        parts.setdefault("cell", []).append(_cells_of(part, cells))
    return {name: np.concatenate(part) for name, part in parts.items()}


def _cells_of(values: NDArray[np.float64], cells: Sequence[str]) -> NDArray[np.object_]:
    """The text of the cells that hold no reading, else empty."""
    text = np.full(len(cells), "", dtype=object)
    for k in np.flatnonzero(np.isnan(values)).tolist():
        text[k] = cells[k].strip()
    return text


def _with_readings(
    path: Path, columns: dict[str, NDArray[Any]]
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """The lines that hold a reading, and a record of the others.

    Raises
    ------
    DataError
        If half of the lines or more hold none.
    """
    lines, value = columns["line"], columns["brdf"]
    u = columns.get("u_brdf")
    no_value = ~np.isfinite(value)
    no_u = np.zeros_like(no_value) if u is None else ~no_value & ~(np.isfinite(u) & (u > 0))
    bad = no_value | no_u
    if not bad.any():
        return columns, {}
    if 2 * np.count_nonzero(bad) >= len(bad):
        raise _mostly_missing(path, columns, no_value, bad)
    record = {
        "count": int(np.count_nonzero(bad)),
        "of": len(bad),
        "no_value": lines[no_value].tolist()[:LISTED],
        "no_uncertainty": lines[no_u].tolist()[:LISTED],
        "n_no_value": int(np.count_nonzero(no_value)),
        "n_no_uncertainty": int(np.count_nonzero(no_u)),
    }
    return {name: column[~bad] for name, column in columns.items()}, {"left_out": record}


def _mostly_missing(
    path: Path,
    columns: dict[str, NDArray[Any]],
    no_value: NDArray[np.bool_],
    bad: NDArray[np.bool_],
) -> DataError:
    """The error for a file whose lines mostly hold no reading, with the first of them."""
    k = int(np.flatnonzero(bad)[0])
    n = np.count_nonzero(bad)
    count = f" ({n} of {len(bad)} lines have no reading)" if len(bad) > 1 else ""
    line = columns["line"][k]
    if no_value[k]:
        cell = columns["cell"][k]
        return DataError(
            f"{path}: line {line}, column brdf: {cell!r} is not a finite number; correct it or "
            f"remove the line{count}.",
            value=cell,
        )
    u = float(columns["u_brdf"][k])
    return DataError(
        f"{path}: line {line}, column u_brdf: {u:.12g} is not positive; leave the column out where "
        f"it is unknown{count}.",
        value=u,
    )


def _check_missing(path: Path, header: list[str], required: tuple[str, ...]) -> None:
    missing = [name for name in required if name not in header]
    if missing:
        raise DataError(
            f"{path}: no column {', '.join(missing)} in the header {','.join(header)!r}; "
            f"wanted are {', '.join(required)}, angles in degrees.",
            value=missing,
        )


def _column(
    path: Path, lines: Lines, name: str, cells: Sequence[str], *, signed: bool
) -> NDArray[Any]:
    if name == "channel":
        return _channels(path, lines, cells)
    if name in ("brdf", "u_brdf"):
        return measured(path, lines, name, cells)
    values = numbers(path, lines, name, cells)
    if name in ("theta_i", "theta_r"):
        azimuth = name.replace("theta", "phi")
        if signed:
            return values
        return check_polar(path, lines, name, values, azimuth=azimuth, limit_deg=180.0)
    if name in ("phi_i", "phi_r"):
        return np.radians(values)
    if name == "wavelength_nm" and not np.all(values > 0):
        k = int(np.flatnonzero(values <= 0)[0])
        raise DataError(
            f"{path}: line {lines[k]}, column {name}: {values[k]:.12g} is not positive; "
            "leave the column out where it is unknown.",
            value=float(values[k]),
        )
    return values


def _channels(path: Path, lines: Lines, cells: Sequence[str]) -> NDArray[np.str_]:
    names = np.array([cell.strip() for cell in cells], dtype=np.str_)
    if np.any(names == ""):
        k = int(np.flatnonzero(names == "")[0])
        raise DataError(
            f"{path}: line {lines[k]}, column channel: the name is empty; "
            "name every channel or leave the column out.",
            value="",
        )
    return names
