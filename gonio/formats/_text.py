"""What the readers of text files share: guarded opening, cells to numbers, checks of angles.

Every check names the file, the line and the value, because a person has to find them in an editor.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import DataError
from gonio.geometry import HORIZON, FloatArray
from gonio.samples import MAX_SAMPLES

MAX_BYTES = 2 << 30
# Angles printed with few digits (1.570797 rad) may pass the horizon by their rounding.
HORIZON_SLACK = 1e-6
_BLOCK = 100_000
# Words of spreadsheets and programs for a reading that does not exist.
MISSING = frozenset(
    (
        *("", "-", "--", "---", "?", "nan", "+nan", "-nan", "na", "n/a", "n.a.", "#n/a", "nil"),
        *("null", "none", "missing", "overflow", "#num!", "#value!", "#div/0!"),
        *("inf", "+inf", "-inf", "infinity", "-infinity"),
    )
)

Lines = NDArray[np.int64]


def check_size(path: Path) -> None:
    """Refuse a file that is missing, no file, or too large to be read as text.

    Raises
    ------
    DataError
    """
    if not path.is_file():
        raise DataError(f"{path}: no such file; give the path of a file of samples.", value=path)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise DataError(
            f"{path}: {size} bytes is more than the {MAX_BYTES} bytes that are read from a text "
            "file; split it, or convert it to a samples file (.nc).",
            value=size,
        )


@contextmanager
def open_text(path: Path) -> Iterator[io.TextIOBase]:
    """A UTF-8 text file, byte order mark skipped; what it cannot decode is a DataError."""
    check_size(path)
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            yield file
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        raise DataError(
            f"{path}: byte 0x{byte:02x} is not UTF-8 text; save the file as UTF-8.", value=byte
        ) from None
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({error.strerror or error}).", value=path
        ) from error


class Table:
    """The wanted columns of a comma-separated file, as text, read block by block.

    Parameters
    ----------
    path : Path
        For messages.
    file : text file
        Opened with ``newline=""``.

    Raises
    ------
    DataError
        If the file is empty, or the header is not separated by commas or repeats a name.
    """

    def __init__(self, path: Path, file: Iterable[str]) -> None:
        self.path = path
        self._reader = csv.reader(file, strict=True)
        first = next(self._records(), None)
        if first is None:
            raise DataError(f"{path}: the file is empty; a header line is wanted.", value=path)
        self.header = [cell.strip() for cell in first[1]]
        if len(self.header) == 1 and any(mark in self.header[0] for mark in ";\t"):
            raise DataError(
                f"{path}: line {first[0]}: the header is not separated by commas; "
                "save the table with commas between the columns and points in the numbers.",
                value=self.header[0],
            )
        for name in self.header:
            if self.header.count(name) > 1:
                raise DataError(
                    f"{path}: line {first[0]}: column {name} stands twice in the header; "
                    "remove one.",
                    value=name,
                )

    def blocks(self) -> Iterator[tuple[Lines, list[tuple[str, ...]]]]:
        """Line numbers and columns of the next rows; every row as wide as the header.

        Raises
        ------
        DataError
            If a row has too few or too many cells, or there is no row, or too many.
        """
        records = self._records()
        total = 0
        while block := list(islice(records, _BLOCK)):
            for line, cells in block:
                if len(cells) != len(self.header):
                    raise DataError(
                        f"{self.path}: line {line}: {len(cells)} cells where the header has "
                        f"{len(self.header)} columns.",
                        value=cells,
                    )
            total += len(block)
            check_count(self.path, total)
            yield (
                np.array([line for line, _ in block], np.int64),
                list(zip(*(cells for _, cells in block), strict=True)),
            )
        if total == 0:
            raise DataError(f"{self.path}: no rows follow the header.", value=self.path)

    def _records(self) -> Iterator[tuple[int, list[str]]]:
        try:
            for cells in self._reader:
                if cells:
                    yield self._reader.line_num, cells
        except csv.Error as error:
            raise DataError(
                f"{self.path}: line {self._reader.line_num}: not a comma-separated line ({error})."
            ) from error


def check_count(path: Path, count: int) -> None:
    """Refuse more samples than a file may hold."""
    if count > MAX_SAMPLES:
        raise DataError(f"{path}: more than {MAX_SAMPLES} samples; split the file.", value=count)


def numbers(path: Path, lines: Lines, column: str, cells: Sequence[str]) -> FloatArray:
    """The cells of one column as finite floats.

    Raises
    ------
    DataError
        Naming line, column and value of the first cell that is not a finite number.
    """
    try:
        # Python reads 1_000 as a number; in a file it is a slip.
        if any("_" in cell for cell in cells):
            raise ValueError
        values = np.array(list(map(float, cells)))
    except ValueError:
        values = np.array([_or_nan(cell) for cell in cells])
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        k = int(bad[0])
        raise DataError(
            f"{path}: line {lines[k]}, column {column}: {cells[k].strip()!r} is not a finite "
            "number; correct it or remove the line.",
            value=cells[k],
        )
    return values


def measured(path: Path, lines: Lines, column: str, cells: Sequence[str]) -> FloatArray:
    """The cells of one column of readings; NaN where a cell says that there is none.

    Raises
    ------
    DataError
        Naming line, column and value of the first cell that is neither a number nor such a word.
    """
    missing = np.array([cell.strip().lower() in MISSING for cell in cells], dtype=bool)
    if not missing.any():
        return numbers(path, lines, column, cells)
    values = np.full(len(cells), np.nan)
    keep = np.flatnonzero(~missing)
    values[keep] = numbers(path, lines[keep], column, [cells[k] for k in keep.tolist()])
    return values


def _or_nan(cell: str) -> float:
    try:
        return float("nan") if "_" in cell else float(cell)
    except ValueError:
        return float("nan")


def _perhaps_gradians(theta: FloatArray, unit: str) -> str:
    """A hint where several angles pass 90 and none passes 100, as in gradians."""
    beyond = np.unique(theta[theta > 90 + HORIZON_SLACK])
    if unit != "deg" or len(beyond) < 2 or beyond[-1] > 100 + 1e-6:
        return ""
    return " If the angles are in gradians, 100 to a right angle, multiply theta and phi by 0.9."


def check_polar(
    path: Path,
    lines: Lines,
    column: str,
    theta: FloatArray,
    *,
    azimuth: str,
    unit: str = "deg",
    limit_deg: float = 90.0,
) -> FloatArray:
    """Polar angles in radians, checked to lie between the normal and the limit.

    Parameters
    ----------
    theta : ndarray
        Angles as written in the file, in `unit`.
    azimuth : str
        Name of the azimuth that belongs to it, for the hint.
    limit_deg : float
        The largest angle allowed, degrees.

    Raises
    ------
    DataError
        Naming the line of the first angle that is negative or beyond the limit.
    """
    half_turn = "180" if unit == "deg" else "pi"
    limit = limit_deg if unit == "deg" else float(np.radians(limit_deg))
    bad = np.flatnonzero(theta < 0)
    if bad.size:
        k = int(bad[0])
        raise DataError(
            f"{path}: line {lines[k]}, column {column}: {theta[k]:.12g} {unit} is negative; "
            f"polar angles count from the normal, so write {-theta[k]:.12g} and add {half_turn} "
            f"to {azimuth}.",
            value=float(theta[k]),
        )
    bad = np.flatnonzero(theta > limit + HORIZON_SLACK)
    if bad.size:
        k = int(bad[0])
        what = "beyond the horizon" if limit_deg == 90 else "not a polar angle"
        raise DataError(
            f"{path}: line {lines[k]}, column {column}: {theta[k]:.12g} {unit} is {what}; "
            f"allowed is 0 to {limit:.12g} {unit} from the normal.{_perhaps_gradians(theta, unit)}",
            value=float(theta[k]),
        )
    radians = np.radians(theta) if unit == "deg" else theta
    return np.minimum(radians, HORIZON * limit_deg / 90)
