"""NIST's table of bidirectional Mueller matrices, as published for sintered PTFE.

Comma-separated, angles in degrees: ``lambda`` (micrometres), ``thetai, phi, thetar, phir``,
``f_r11`` (the BRDF for unpolarised light, sr^-1, cosine not included), then ratios of the other
Mueller elements to f_r11, which are not read. A polar angle may carry a sign: a negative one
means that the azimuth is larger by 180 degrees. Incidence is written so: forward scatter lies at
phir = 0.

References
----------
T. A. Germer, "Full four-dimensional and reciprocal Mueller matrix bidirectional reflectance
distribution function of sintered polytetrafluoroethylene", Applied Optics, 2017.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats._text import Lines, Table, check_polar, numbers, open_text
from gonio.geometry import Directions, FloatArray
from gonio.samples import BRDFSamples

NAME = "nist_ptfe"
TITLE = "NIST Mueller-matrix table: lambda, thetai, phi, thetar, phir, f_r11"

COLUMNS = ("lambda", "thetai", "phi", "thetar", "phir", "f_r11")


def mismatch(path: Path, head: bytes) -> str | None:
    """Why the file is not in this format, or None where it is."""
    first = head.decode("utf-8-sig", errors="replace").lstrip().split("\n", 1)[0]
    names = {cell.strip() for cell in first.split(",")}
    if {"thetai", "thetar"} <= names or "f_r11" in names:
        return None
    return "its first line does not name the columns thetai, thetar, f_r11"


def read(path: str | Path) -> BRDFSamples:
    """Samples from a NIST table, one a line, wavelength in nm.

    Parameters
    ----------
    path : str or Path
        File as in this module's description.

    Returns
    -------
    BRDFSamples
        Polar angles in [0, pi/2], the sign turned into the azimuth.

    Raises
    ------
    DataError
        If a column is missing or a cell cannot be used: the message names the line, the column
        and the value.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "ptfe.csv"
    >>> n = file.write_text("lambda,thetai,phi,thetar,phir,f_r11\\n0.532,-45,0,45,0,0.33\\n")
    >>> d = read(file).directions
    >>> np.degrees(d.theta_i).tolist(), np.degrees(d.phi_i).tolist()
    ([45.0], [180.0])
    """
    path = Path(path)
    parts: list[tuple[FloatArray, ...]] = []
    with open_text(path) as file:
        table = Table(path, file)
        missing = [name for name in COLUMNS if name not in table.header]
        if missing:
            raise DataError(
                f"{path}: no column {', '.join(missing)}; wanted are {', '.join(COLUMNS)}.",
                value=missing,
            )
        positions = [table.header.index(name) for name in COLUMNS]
        for lines, cells in table.blocks():
            columns = [
                numbers(path, lines, name, cells[k])
                for name, k in zip(COLUMNS, positions, strict=True)
            ]
            parts.append(_converted(path, lines, *columns))
    wavelength, theta_i, phi_i, theta_r, phi_r, value = map(
        np.concatenate, zip(*parts, strict=True)
    )
    return BRDFSamples(
        directions=Directions(theta_i, phi_i, theta_r, phi_r),
        value=value,
        wavelength_nm=wavelength,
        history=(
            "negative polar angles turned to positive ones with the azimuth + 180 deg; "
            "f_r11 taken as the unpolarised BRDF, other Mueller elements not read",
        ),
    )


def _converted(
    path: Path,
    lines: Lines,
    wavelength_um: FloatArray,
    thetai: FloatArray,
    phi: FloatArray,
    thetar: FloatArray,
    phir: FloatArray,
    value: FloatArray,
) -> tuple[FloatArray, ...]:
    if np.any(wavelength_um <= 0):
        k = int(np.flatnonzero(wavelength_um <= 0)[0])
        raise DataError(
            f"{path}: line {lines[k]}, column lambda: {wavelength_um[k]:.12g} um is not positive.",
            value=float(wavelength_um[k]),
        )
    theta_i = check_polar(path, lines, "thetai", np.abs(thetai), azimuth="phi")
    theta_r = check_polar(path, lines, "thetar", np.abs(thetar), azimuth="phir")
    phi_i = np.radians(np.where(thetai < 0, phi + 180, phi))
    phi_r = np.radians(np.where(thetar < 0, phir + 180, phir))
    # Rounding takes back what the change of unit adds: 0.532 um is 532 nm and can be selected.
    return np.round(wavelength_um * 1000, 9), theta_i, phi_i, theta_r, phi_r, value
