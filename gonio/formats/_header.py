"""Names in the header of a table, which may be followed by their units."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from gonio.errors import ConfigurationError, DataError, unknown_name

NEAR = 0.75  # likeness of two names from which on one is taken for a slip of the other


@dataclass(frozen=True)
class Unit:
    """The unit of some columns.

    Parameters
    ----------
    columns : tuple of str
        Names that a header may give them.
    written : tuple of str
        The unit as people write it; the first is shown.
    others : dict
        Other units, each with what turns values in it to this one.
    """

    columns: tuple[str, ...]
    written: tuple[str, ...]
    others: dict[str, str]


_RAD, _GON, _TURN = "multiply by 57.29577951 (180/pi)", "multiply by 0.9", "multiply by 360"
_CENT = "multiply by brdf and divide by 100 if they are per cent of the reading"
UNITS = (
    Unit(
        ("theta_i", "phi_i", "theta_r", "phi_r"),
        ("deg", "degree", "degrees", "\N{DEGREE SIGN}", "\N{MASCULINE ORDINAL INDICATOR}"),
        {"rad": _RAD, "radian": _RAD, "radians": _RAD, "mrad": "multiply by 0.05729577951",
         "gon": _GON, "grad": _GON, "gradian": _GON, "gradians": _GON,
         "turn": _TURN, "turns": _TURN, "rev": _TURN},
    ),
    Unit(
        ("brdf",),
        ("sr^-1", "1/sr", "/sr", "sr-1", "sr**-1", "sr^(-1)", "sr^{-1}", "per sr",
         "sr\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT ONE}"),
        {"%": "divide by 100", "%/sr": "divide by 100", "percent": "divide by 100"},
    ),
    Unit(("wavelength_nm", "wavelength"), ("nm", "nanometre", "nanometres"),
         {"um": "multiply by 1000", "\N{MICRO SIGN}m": "multiply by 1000",
          "\N{GREEK SMALL LETTER MU}m": "multiply by 1000", "micron": "multiply by 1000",
          "microns": "multiply by 1000", "mm": "multiply by 1e6", "m": "multiply by 1e9",
          "a": "divide by 10", "angstrom": "divide by 10"}),
)  # fmt: skip
_OF_U = Unit(("u_brdf",), UNITS[1].written,
             {"%": _CENT, "percent": _CENT, "rel": "multiply by brdf"})  # fmt: skip


def base_name(cell: str) -> str:
    """The name in a cell of a header, without its unit.

    Examples
    --------
    >>> base_name("theta_i [deg]"), base_name("phi_r/deg"), base_name("u_brdf (sr^-1)")
    ('theta_i', 'phi_r', 'u_brdf')
    """
    return _parted(cell)[0]


def column_names(path: Path, header: Iterable[str], columns: tuple[str, ...]) -> list[str]:
    """The names of the columns of a table, without their units.

    Parameters
    ----------
    path : Path
        For messages.
    header : iterable of str
        Cells of the header.
    columns : tuple of str
        The names that the table may have.

    Raises
    ------
    DataError
        If a name is unknown, its unit is another one, or it stands twice.
    """
    names: list[str] = []
    for cell in header:
        name = _checked(path, cell, columns)
        if name in names:
            raise DataError(
                f"{path}: column {name} stands twice in the header, once as {cell!r}; remove one.",
                value=cell,
            )
        names.append(name)
    return names


def _parted(cell: str) -> tuple[str, str, Unit | None]:
    """Name, unit as it is written, and the unit that the name has."""
    for unit in (*UNITS, _OF_U):
        for name in unit.columns:
            rest = cell[len(name) :].strip() if cell.startswith(name) else ""
            if not rest:
                continue
            bracketed = re.fullmatch(r"/?\s*(?:\[(.*)\]|\((.*)\))", rest)
            if bracketed:
                return name, (bracketed[1] or bracketed[2] or "").strip(), unit
            known = (*unit.written, *unit.others)
            for text in (rest, rest[1:].strip() if rest[0] in "/_," else rest):
                if text.lower() in known and (rest[0] in "/_," or cell[len(name)] == " "):
                    return name, text, unit
    return cell, "", None


def _checked(path: Path, cell: str, columns: tuple[str, ...]) -> str:
    """The name of a column whose unit is right.

    Raises
    ------
    DataError
    """
    if cell in columns:
        return cell
    name, written, unit = _parted(cell)
    if unit is None:  # a name with its unit is meant, whatever its letters
        name, written, unit = _parted(cell.lower())
    if unit is None:
        raise DataError(f"{path}: {_unknown(cell, columns)}", value=cell)
    column = unit.columns[0] if name == "wavelength" else name
    text = written.lower()
    if text in unit.written:
        return column
    shown = f"column {cell!r}: {written!r} is not the unit of {column}, which is {unit.written[0]}"
    if text in unit.others:
        raise DataError(
            f"{path}: {shown}; convert the values ({unit.others[text]}) and call the column "
            f"{column}.",
            value=cell,
        )
    raise DataError(
        f"{path}: {shown}; convert the values, or call the column {column} if they are in "
        f"{unit.written[0]}.",
        value=cell,
    )


def _unknown(cell: str, columns: tuple[str, ...]) -> str | ConfigurationError:
    """What is said of a name that no column has: a slip, or something that gonio does not read."""
    small = base_name(cell.lower())
    if small in columns:
        return f"unknown column {cell!r}: names have small letters; write {small}."
    error = unknown_name("column", cell, columns)
    if cell == "wavelength":
        return f"{error} Wavelengths are in nm: convert them and call the column wavelength_nm."
    if cell.startswith("brdf"):
        return (
            f"{error} One line holds one value: write a line for each wavelength or channel, and "
            "name it in a column wavelength_nm or channel."
        )
    if get_close_matches(cell, columns, n=1, cutoff=NEAR) or not re.fullmatch(r"\w[\w .-]*", cell):
        return error
    return (
        f"{error} Remove this column; if lines with different {cell} do not belong together, "
        "call it channel."
    )
