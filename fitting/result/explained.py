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
MOST_GROUPS = 8  # groups of residuals that are shown


def residual_lines(record: FitRecord) -> list[str]:
    """The residuals in one line; of several parts one line for all."""
    report = record.diagnostics.get("residuals")
    if not report:
        return []
    if "parts" not in report:
        return [str(report["line"])]
    parts = report["parts"]
    structured = sum(1 for part in parts if part["structured"])
    return [f"residuals: structure beyond noise in {structured} of {len(parts)} parts"]


def explained(record: FitRecord) -> list[Piece]:
    """Correlation, identifiability and residuals as tables."""
    pieces: list[Piece] = []
    identified = record.diagnostics.get("identifiability")
    if identified:
        pieces += _identified(record, identified)
    report = record.diagnostics.get("residuals") or {}
    parts = report.get("parts") or ([report] if report else [])
    for number, part in enumerate(parts, 1):
        pieces += _residuals(part, f", part {number}" if len(parts) > 1 else "")
    return pieces


def _identified(record: FitRecord, report: Mapping[str, Any]) -> list[Piece]:
    pieces: list[Piece] = []
    if not record.parts:
        pieces += correlation_table(record)
        shown = _titled(
            "What the data say", "parameter", "others known", "Cramer-Rao bound", "std. unc."
        )
        for name, own in record.parameters.items():
            estimate = own.in_file_units()
            unit = f" [{estimate.unit}]" if estimate.unit else ""
            values = (report["alone"][name], report["bound"][name], estimate.stderr)
            shown.add_row(name + unit, *("unknown" if v is None else f"{v:.2g}" for v in values))
        pieces.append(shown)
    weakest = report["axes"][:AXES]
    shown = _titled("Weakest directions", "information, 1 without exchange", "change of")
    for axis in weakest:
        shown.add_row(f"{axis['information']:.2g}", _moved(record, axis["change"]))
    pieces.append(shown)
    for a, b, r in report["correlated"]:
        pieces.append(Text(f"{a} and {b} are exchanged nearly freely: correlation {r:+.4f}"))
    suggested = report["suggested_measurement"]
    if suggested is not None:
        pieces.append(Text(f"suggested measurement: {suggested['text']}"))
    return pieces


def correlation_table(record: FitRecord) -> list[Piece]:
    """The correlation of all errors as a table; nothing where it is not known."""
    matrix = correlation(record)
    if matrix is None:
        return []
    shown = _titled(matrix.of, "", *matrix.names)
    for name, row in zip(matrix.names, matrix.rows, strict=True):
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


def _residuals(report: Mapping[str, Any], of: str) -> list[Piece]:
    shown = _titled(f"Structure of the residuals{of}", "compared by", "statistic", "p", "share")
    for test in report["tests"]:
        share = f"{100 * test['share']:.1f} %"
        shown.add_row(test["name"], f"{test['statistic']:.2f}", f"{test['p_value']:.2g}", share)
    pieces: list[Piece] = [shown]
    largest = sorted(
        (group for groups in report["maps"].values() for group in groups),
        key=lambda group: -abs(group["z"]),
    )[:MOST_GROUPS]
    shown = _titled(f"Largest mean residuals{of}", "where", "theta_i [deg]", "n", "z", "relative")
    for group in largest:
        theta_i = "all" if group["theta_i_deg"] is None else f"{group['theta_i_deg']:.0f}"
        relative = "" if group["relative"] is None else f"{100 * group['relative']:+.2g} %"
        shown.add_row(group["where"], theta_i, str(group["n"]), f"{group['z']:+.1f}", relative)
    return [*pieces, shown]
