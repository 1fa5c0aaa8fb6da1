"""What the data say of each parameter, and where the residuals are: tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.text import Text

from gonio.fitting.result.correlation import correlation
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.tables import table

if TYPE_CHECKING:
    from rich.table import Table

    Piece = Table | Text

AXES = 3  # weakest axes that are shown
PLACES = 8  # groups of residuals that are shown


def residual_lines(record: FitRecord) -> list[str]:
    """The residuals in one line; of several parts one line for all."""
    found = record.diagnostics.get("residuals")
    if not found:
        return []
    if "parts" not in found:
        return [str(found["line"])]
    parts = found["parts"]
    structured = sum(1 for part in parts if part["structured"])
    return [f"residuals: structure beyond noise in {structured} of {len(parts)} parts"]


def explained(record: FitRecord) -> list[Piece]:
    """Correlation, identifiability and residuals as tables."""
    pieces: list[Piece] = []
    identified = record.diagnostics.get("identifiability")
    if identified:
        pieces += _identified(record, identified)
    found = record.diagnostics.get("residuals") or {}
    parts = found.get("parts") or ([found] if found else [])
    for number, part in enumerate(parts, 1):
        pieces += _residuals(part, f", part {number}" if len(parts) > 1 else "")
    return pieces


def _identified(record: FitRecord, found: Mapping[str, Any]) -> list[Piece]:
    pieces: list[Piece] = []
    if not record.parts:
        pieces += correlation_table(record)
        shown = _titled(
            "What the data say", "parameter", "alone known to", "Cramer-Rao bound", "std. unc."
        )
        for name, own in record.parameters.items():
            estimate = own.in_file_units()
            unit = f" [{estimate.unit}]" if estimate.unit else ""
            values = (found["alone"][name], found["bound"][name], estimate.stderr)
            shown.add_row(name + unit, *("unknown" if v is None else f"{v:.2g}" for v in values))
        pieces.append(shown)
    weakest = found["axes"][:AXES]
    shown = _titled("Weakest directions", "information, 1 without exchange", "change of")
    for axis in weakest:
        shown.add_row(f"{axis['information']:.2g}", _moved(record, axis["change"]))
    pieces.append(shown)
    for a, b, r in found["correlated"]:
        pieces.append(Text(f"{a} and {b} are exchanged nearly freely: correlation {r:+.4f}"))
    suggested = found["suggested_measurement"]
    if suggested is not None:
        pieces.append(Text(f"suggested measurement: {suggested['text']}"))
    return pieces


def correlation_table(record: FitRecord) -> list[Piece]:
    """The correlation of all errors as a table; nothing where it is not known."""
    known = correlation(record)
    if known is None:
        return []
    shown = _titled(known.of, "", *known.names)
    for name, row in zip(known.names, known.rows, strict=True):
        shown.add_row(name, *("unknown" if r is None else f"{r:+.3f}" for r in row))
    return [shown]


def _titled(title: str, *headings: str) -> Table:
    return table(*headings, fold=True, title=title)


def _moved(record: FitRecord, change: Mapping[str, float]) -> str:
    """A change along an axis in per cent of the values, small parts left out."""
    shown = []
    for name, step in change.items():
        value = record.parameters[name].in_file_units().value
        if value and abs(step / value) >= 0.005:
            shown.append(f"{name} {100 * step / value:+.0f} %")
    return ", ".join(shown)


def _residuals(found: Mapping[str, Any], of: str) -> list[Piece]:
    shown = _titled(f"Structure of the residuals{of}", "compared by", "statistic", "p", "share")
    for test in found["tests"]:
        share = f"{100 * test['share']:.1f} %"
        shown.add_row(test["name"], f"{test['statistic']:.2f}", f"{test['p_value']:.2g}", share)
    pieces: list[Piece] = [shown]
    places = sorted(
        (place for group in found["maps"].values() for place in group),
        key=lambda place: -abs(place["z"]),
    )[:PLACES]
    shown = _titled(f"Largest mean residuals{of}", "where", "theta_i [deg]", "n", "z", "relative")
    for place in places:
        theta_i = "all" if place["theta_i_deg"] is None else f"{place['theta_i_deg']:.0f}"
        relative = "" if place["relative"] is None else f"{100 * place['relative']:+.2g} %"
        shown.add_row(place["where"], theta_i, str(place["n"]), f"{place['z']:+.1f}", relative)
    return [*pieces, shown]
