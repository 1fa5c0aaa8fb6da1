"""Spectral BRDF text of the Cornell Program of Computer Graphics (`.brdf`).

``#`` starts a comment. The number of wavelengths, the wavelengths in nm, then one line a geometry:
``theta_i phi_i theta_s phi_s`` in radians and one BRDF value (sr^-1) for each wavelength. Both
directions leave the surface: the mirror direction of phi_i = 0 lies at phi_s = pi.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats._text import Lines, check_count, check_polar, numbers, open_text
from gonio.geometry import Directions, FloatArray
from gonio.samples import BRDFSamples

NAME = "cornell"
TITLE = "Cornell .brdf text: wavelengths, then theta_i phi_i theta_s phi_s in radians and values"

ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")
MAX_WAVELENGTHS = 100_000

Rows = Iterator[tuple[int, list[str]]]


def mismatch(path: Path, head: bytes) -> str | None:
    """Why the file is not in this format, or None where it is."""
    if b"\0" in head:
        return "it is not UTF-8 text"
    for line in head.decode("utf-8-sig", errors="replace").splitlines():
        words = line.partition("#")[0].split()
        if words:
            if len(words) == 1 and words[0].isdecimal():
                return None
            break
    if path.suffix.lower() == ".brdf":
        return None
    return "its first line that is no comment is not the number of wavelengths"


def read(path: str | Path) -> BRDFSamples:
    """Samples from a Cornell `.brdf` file: one for each geometry and wavelength.

    Parameters
    ----------
    path : str or Path
        File as in this module's description.

    Returns
    -------
    BRDFSamples
        G geometries by W wavelengths, the wavelength running fastest.

    Raises
    ------
    DataError
        If the counts disagree or a number cannot be used: the message names the line.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "paint.brdf"
    >>> n = file.write_text("# paint\\n2\\n450 650\\n0.5 0 0.5 3.141593 0.02 0.3\\n")
    >>> samples = read(file)
    >>> samples.wavelength_nm.tolist(), samples.value.tolist()
    ([450.0, 650.0], [0.02, 0.3])
    """
    path = Path(path)
    with open_text(path) as file:
        rows = _rows(file)
        wavelengths = _wavelengths(path, rows)
        lines, table = _geometries(path, rows, len(wavelengths))
    theta_i = check_polar(path, lines, "theta_i", table[:, 0], azimuth="phi_i", unit="rad")
    theta_r = check_polar(path, lines, "theta_s", table[:, 2], azimuth="phi_s", unit="rad")
    angles = (theta_i, table[:, 1], theta_r, table[:, 3])
    return BRDFSamples(
        directions=Directions(*(np.repeat(angle, len(wavelengths)) for angle in angles)),
        value=table[:, 4:].ravel(),
        wavelength_nm=np.tile(wavelengths, len(table)),
        history=(f"{len(table)} geometries by {len(wavelengths)} wavelengths",),
    )


def _rows(file: Iterator[str]) -> Rows:
    """Line numbers and words of the lines that hold more than a comment."""
    for number, line in enumerate(file, start=1):
        words = line.partition("#")[0].split()
        if words:
            yield number, words


def _wavelengths(path: Path, rows: Rows) -> FloatArray:
    line, words = next(rows, (0, []))
    if not words:
        raise DataError(
            f"{path}: the file holds comments only; the number of wavelengths comes first.",
            value=path,
        )
    if len(words) != 1 or not words[0].isdecimal() or not 0 < int(words[0]) <= MAX_WAVELENGTHS:
        raise DataError(
            f"{path}: line {line}: {' '.join(words)[:60]!r} is not the number of wavelengths; "
            f"a whole number from 1 to {MAX_WAVELENGTHS} stands alone in the first line that is "
            "no comment.",
            value=words,
        )
    count = int(words[0])
    parts: list[FloatArray] = []
    have = 0
    while have < count:
        line, words = next(rows, (0, []))
        if not words:
            raise DataError(
                f"{path}: the file ends after {have} of {count} wavelengths; it is truncated.",
                value=have,
            )
        parts.append(numbers(path, np.full(len(words), line), "wavelength", words))
        have += len(words)
    wavelengths = np.concatenate(parts)
    if have != count:
        raise DataError(
            f"{path}: line {line}: {have} wavelengths where {count} are announced; "
            "correct the count or the list.",
            value=have,
        )
    if np.any(wavelengths <= 0):
        raise DataError(
            f"{path}: line {line}: the wavelength {wavelengths.min():.12g} nm is not positive.",
            value=float(wavelengths.min()),
        )
    return wavelengths


def _geometries(path: Path, rows: Rows, count: int) -> tuple[Lines, FloatArray]:
    lines: list[int] = []
    table: list[FloatArray] = []
    for line, words in rows:
        if len(words) != 4 + count:
            raise DataError(
                f"{path}: line {line}: {len(words)} numbers where 4 angles and {count} values "
                "are wanted; the line may be truncated.",
                value=len(words),
            )
        check_count(path, (len(table) + 1) * count)
        table.append(_row(path, line, words))
        lines.append(line)
    if not table:
        raise DataError(f"{path}: no geometry follows the wavelengths.", value=path)
    return np.array(lines, np.int64), np.array(table)


def _row(path: Path, line: int, words: list[str]) -> FloatArray:
    try:
        row = np.array(words, dtype=float)
        if np.all(np.isfinite(row)):
            return row
    except ValueError:
        pass
    # Read again cell by cell, to name the one that is wrong.
    for k, word in enumerate(words):
        column = ANGLES[k] if k < 4 else f"value {k - 3}"
        numbers(path, np.array([line]), column, [word])
    raise AssertionError("a row that failed as a whole failed in no cell")
