"""A model as a page of text or HTML, from its description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

_HEAD = ("parameter", "default", "lowest", "highest", "meaning")


def page(about: Mapping[str, Any], units: Sequence[str]) -> str:
    """Title, documentation, validity and the parameters as a table.

    Parameters
    ----------
    about : mapping
        What `Model.describe` gives.
    units : sequence of str
        Unit of each parameter in Python.
    """
    parts = [_title(about)]
    text = (about.get("documentation") or "").strip()
    if text:
        parts += ["", text]
    elif about["validity"]:
        parts += ["", about["validity"]]
    rows = [_HEAD, *_rows(about, units)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(_HEAD) - 1)]
    parts.append("")
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:-1], widths[1:], strict=True)]
        parts.append("  ".join([*cells, row[-1]]).rstrip())
    if any(units):
        parts += ["", "Angles are radians in Python, degrees in files and on the command line."]
    return "\n".join(parts)


def html(about: Mapping[str, Any], units: Sequence[str]) -> str:
    """The title and the table of parameters, the documentation folded away."""
    head = "".join(f"<th>{escape(name)}</th>" for name in _HEAD)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in _rows(about, units)
    )
    text = (about.get("documentation") or about["validity"] or "").strip()
    more = f"<details><summary>formula</summary><pre>{escape(text)}</pre></details>" if text else ""
    return (
        f"<div><p><strong>{escape(_title(about))}</strong></p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{more}</div>"
    )


def _title(about: Mapping[str, Any]) -> str:
    reference = f" ({about['reference']})" if about["reference"] else ""
    return f"{about['name']}: {about['title']}{reference}"


def _rows(about: Mapping[str, Any], units: Sequence[str]) -> list[tuple[str, ...]]:
    """A parameter's name, default and range in the unit of Python, with degrees beside radians."""
    rows = []
    for q, unit in zip(about["parameters"], units, strict=True):
        ends = [q["default"], q["lower"], q["upper"]]
        if unit == "rad":
            shown = [f"{number * _DEGREE:.4g} ({number:.4g} deg)" for number in ends]
        else:
            shown = [f"{number:.6g}" for number in ends]
        name = q["name"] + (f" [{unit}]" if unit else "")
        rows.append((name, *shown, q["meaning"]))
    return rows


_DEGREE = 0.017453292519943295  # radians
