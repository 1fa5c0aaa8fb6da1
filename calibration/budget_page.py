"""The page of a budget: a table of the sources of uncertainty, and what its columns mean."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gonio.wording import counted, paragraph

WIDTH = 80  # columns of the narrowest terminal that the table is made for
NAME = 26  # columns of the longest line of a name
TEXTS = 4  # columns of texts, before those of numbers
_NAMES = ("theta_i", "phi_i", "theta_r", "phi_r")


def page(report: Mapping[str, Any], start: str = "", width: int = WIDTH) -> Iterator[str]:
    """Lines of the table of a budget, with what its columns mean.

    Parameters
    ----------
    report : mapping
        What `Budget.describe` gives.
    start : str
        What stands before the first line.
    width : int
        Columns of the terminal.
    """
    at = report["at"]
    yield paragraph(f"{start}{_what(report)}", indent=2)
    heads = ("u/f, %",) if at else ("median", "5 %", "95 %")
    rows = [("source", "type", "shared by", "acts", *heads, "share")]
    for row in report["sources"]:
        share = row["share_of_variance"]
        rows.append(
            (
                row["name"],
                row["kind"],
                row["shared_by"],
                "both" if row["acts"] == "factor and offset" else row["acts"],
                *_percentages(row["relative"], at),
                "?" if share is None else f"{share:.1%}",
            )
        )
    k = report["coverage_factor"]
    rows.append(("combined", "", "", "", *_percentages(report["combined"], at), ""))
    rows.append((f"expanded, k = {k:g}", "", "", "", *_percentages(report["expanded"], at), ""))
    lines = table_lines(rows, width)
    sums = sum(len(_folded(row[0])) for row in rows[-2:])
    yield ""
    if not at:
        yield f"{'u/f in % over the samples':>{lines[0].index('95 %') + 4}}"
    yield from (*lines[:-sums], "", *lines[-sums:], "")
    for line in _remarks(report):
        yield paragraph(line, indent=2)


def table_lines(rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Lines of a table: texts flush left, numbers flush right, at least one blank between columns.

    Parameters
    ----------
    rows : sequence of sequence of str
        Four texts, then numbers. A long text in the first column takes several lines.
    width : int
        Columns of the terminal. Two blanks stand between the columns of texts where they fit.

    Examples
    --------
    >>> rows = [("source", "type", "shared by", "acts", "median"),
    ...         ("lamp", "B", "incidences", "turns", "0.3")]
    >>> print(*table_lines(rows, 80), sep="\\n")
    source                      type  shared by   acts   median
    lamp                        B     incidences  turns     0.3
    """
    cells = [[_folded(row[0]), *([text] for text in row[1:])] for row in rows]
    wide = [max(len(line) for row in cells for line in row[k]) for k in range(len(cells[0]))]
    wide[0] = NAME
    for gap in (2, 1):
        used = sum(wide) + (len(wide) - 1) * gap
        if used <= max(width, WIDTH):
            break
    lines = []
    for row in cells:
        texts = "".join(f"{row[k][0]:<{wide[k] + gap}}" for k in range(TEXTS))
        numbers = (" " * gap).join(f"{cell[0]:>{w}}" for cell, w in
                                   zip(row[TEXTS:], wide[TEXTS:], strict=True))  # fmt: skip
        lines += [(texts + numbers).rstrip(), *row[0][1:]]
    return lines


def _folded(name: str) -> list[str]:
    """The lines of a name in the first column."""
    return textwrap.wrap(name, NAME, subsequent_indent="  ") or [""]


def _what(report: Mapping[str, Any]) -> str:
    kind, n, at = report["quantity"], report["n_samples"], report["at"]
    if at:
        where = ", ".join(f"{name} {at[name] + 0.0:.4g}" for name in _NAMES)
        return f"{kind} {at['value']:.4g} sr^-1 at {where} deg"
    left = report["n_left_out"]
    left_out = f", {left} of them 0 within their noise and left out" if left else ""
    return f"{kind}, {counted(n, 'sample')}{left_out}"


def _percentages(summary: dict[str, float] | None, at: Any) -> tuple[str, ...]:
    if summary is None:
        return ("?",) if at else ("?", "?", "?")
    if at:
        return (_percent(summary["median"]),)
    return tuple(_percent(summary[key]) for key in ("median", "p5", "p95"))


def _percent(x: float) -> str:
    """A percentage with about three digits, without the sign %.

    Examples
    --------
    >>> [_percent(x) for x in (0.0, 1.2e-7, 0.00123, 0.0512, 1.7)]
    ['0', '<0.001', '0.123', '5.12', '170']
    """
    if 0 < x < 1e-5:
        return "<0.001"
    return f"{100 * x:.3g}"


def _remarks(report: Mapping[str, Any]) -> list[str]:
    lines = [
        "u: standard uncertainty of f by one source; share: its part of the variance"
        + ("." if report["at"] else ", mean of the samples."),
        "Type A: from counts, or from a fit to calibration frames. Type B: stated by certificate "
        "or operator, without degrees of freedom, which are taken as infinite; those of counts "
        "are many.",
        "A factor multiplies f and an offset adds to it; an error that turns the viewing direction "
        "counts by the slope of f over neighbouring samples.",
    ]
    through = [row["name"] for row in report["sources"] if row["relative"] is None]
    if through:
        lines.append(
            f"Not counted here: {', '.join(through)}. A blur acts through the curvature of the "
            "lobe, a turn of the sample through both directions at once; 'gonio fit' counts them."
        )
    for source in report["unknown"]:
        lines.append(f"UNKNOWN, not counted: {source}.")
    return lines
