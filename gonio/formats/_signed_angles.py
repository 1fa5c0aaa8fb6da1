"""Polar angles that carry a sign: a negative one means that the azimuth is larger by 180 deg."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import DataError
from gonio.formats._text import check_polar

# Fewer signs are taken for slips.
MIN_SIGNED = 3
LISTED = 100  # lines that the record of a reading lists


def unsigned(path: Path, columns: dict[str, NDArray[Any]]) -> tuple[dict[str, Any], list[str]]:
    """Replace theta_i and theta_r (degrees, signed) in a table by angles of samples, in radians.

    Parameters
    ----------
    path : Path
        For messages.
    columns : dict
        Columns of the file and `line`, the line of each row. The angles are replaced in place.

    Returns
    -------
    record, history : dict, list of str
        What was changed, for `metadata` and `history`.

    Raises
    ------
    DataError
        If one or two polar angles are negative, if a sign and the azimuth both say on which side of
        the normal a direction lies, or if an angle is beyond the horizon.
    """
    record: dict[str, Any] = {}
    history = []
    for name, azimuth in (("theta_i", "phi_i"), ("theta_r", "phi_r")):
        theta, phi, lines = columns[name], columns[azimuth], columns["line"]
        negative = theta < 0
        count = int(np.count_nonzero(negative))
        if count >= MIN_SIGNED:
            _refuse_twice(path, name, azimuth, theta, phi)
            columns[azimuth] = np.where(negative, phi + np.pi, phi)
            record[name] = {"count": count, "lines": lines[negative].tolist()[:LISTED]}
            history.append(f"{count} negative {name} read as positive with {azimuth} + 180 deg")
            theta = np.abs(theta)
        columns[name] = check_polar(path, lines, name, theta, azimuth=azimuth)
    return ({"signed": record} if record else {}), history


def _refuse_twice(
    path: Path,
    name: str,
    azimuth: str,
    theta: NDArray[np.float64],
    phi: NDArray[np.float64],
) -> None:
    """Refuse directions whose side of the normal both the sign and the azimuth state."""
    below, above = np.exp(1j * phi[theta < 0]), np.exp(1j * phi[theta > 0])
    if not len(below) or not len(above):
        return
    one_each = all(np.allclose(side, side[0], atol=1e-6) for side in (below, above))
    if one_each and abs(below[0] + above[0]) < 1e-6:
        turn = [float(np.degrees(np.angle(side[0]))) % 360 for side in (below, above)]
        raise DataError(
            f"{path}: {name} is negative on {len(below)} lines, all with {azimuth} = {turn[0]:.6g} "
            f"deg, and positive on {len(above)} lines, all with {turn[1]:.6g} deg: sign and "
            f"azimuth state the side of the normal twice. Write {name} without its sign.",
            value=name,
        )
