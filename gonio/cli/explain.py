"""`gonio fit --explain`: what the data say of each parameter, and where the residuals are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from gonio.fitting.result import FitResult

AXES = 3  # weakest axes that are shown
PLACES = 8  # groups of residuals that are shown


def lines(result: FitResult) -> list[str]:
    """The residuals in one line; of several parts one line for all."""
    found = result.diagnostics.get("residuals")
    if not found:
        return []
    if "parts" not in found:
        return [str(found["line"])]
    parts = found["parts"]
    structured = sum(1 for part in parts if part["structured"])
    return [f"residuals: structure beyond noise in {structured} of {len(parts)} parts"]


def show(result: FitResult, console: Console) -> None:
    """Identifiability and residuals as tables."""
    identified = result.diagnostics.get("identifiability")
    if identified:
        _identified(result, identified, console)
    found = result.diagnostics.get("residuals") or {}
    parts = found.get("parts") or ([found] if found else [])
    for number, part in enumerate(parts, 1):
        _residuals(part, f", part {number}" if len(parts) > 1 else "", console)


def _table(title: str, *headings: str) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(headings[0])
    for heading in headings[1:]:
        table.add_column(heading, justify="right")
    return table


def _identified(result: FitResult, found: Mapping[str, Any], console: Console) -> None:
    names = list(found["parameters"])
    if not result.parts:
        table = _table("Correlation of the independent errors", "", *names)
        for name, row in zip(names, found["correlation"], strict=True):
            table.add_row(name, *("unknown" if r is None else f"{r:+.3f}" for r in row))
        console.print(table)
        table = _table(
            "What the data say", "parameter", "alone known to", "Cramer-Rao bound", "std. unc."
        )
        for name, own in result.parameters.items():
            estimate = own.in_file_units()
            unit = f" [{estimate.unit}]" if estimate.unit else ""
            values = (found["alone"][name], found["bound"][name], estimate.stderr)
            table.add_row(name + unit, *("unknown" if v is None else f"{v:.2g}" for v in values))
        console.print(table)
    weakest = found["axes"][:AXES]
    table = _table("Weakest directions", "information, 1 without exchange", "change of")
    for axis in weakest:
        table.add_row(f"{axis['information']:.2g}", _moved(result, axis["change"]))
    console.print(table)
    for a, b, r in found["correlated"]:
        console.print(f"{a} and {b} are exchanged nearly freely: correlation {r:+.4f}")
    if found["mending"] is not None:
        console.print(f"to mend it: {found['mending']['text']}")


def _moved(result: FitResult, change: Mapping[str, float]) -> str:
    """A change along an axis in per cent of the values, small parts left out."""
    shown = []
    for name, step in change.items():
        value = result.parameters[name].in_file_units().value
        if value and abs(step / value) >= 0.005:
            shown.append(f"{name} {100 * step / value:+.0f} %")
    return ", ".join(shown)


def _residuals(found: Mapping[str, Any], of: str, console: Console) -> None:
    table = _table(f"Structure of the residuals{of}", "compared by", "statistic", "p", "share")
    for test in found["tests"]:
        share = f"{100 * test['share']:.1f} %"
        table.add_row(test["name"], f"{test['statistic']:.2f}", f"{test['p_value']:.2g}", share)
    console.print(table)
    places = sorted(
        (place for group in found["maps"].values() for place in group),
        key=lambda place: -abs(place["z"]),
    )[:PLACES]
    table = _table(f"Largest mean residuals{of}", "where", "theta_i [deg]", "n", "z", "relative")
    for place in places:
        theta_i = "all" if place["theta_i_deg"] is None else f"{place['theta_i_deg']:.0f}"
        relative = "" if place["relative"] is None else f"{100 * place['relative']:+.2g} %"
        table.add_row(place["where"], theta_i, str(place["n"]), f"{place['z']:+.1f}", relative)
    console.print(table)
