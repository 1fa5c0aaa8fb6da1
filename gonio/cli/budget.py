"""`gonio budget`: where the uncertainty of the samples comes from."""

from __future__ import annotations

import math
import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rich_click as click

from gonio.cli.inputs import require_measured
from gonio.cli.measured import pairs, read_source
from gonio.errors import ConfigurationError

WIDTH = 80  # columns of the narrowest terminal that the table is made for
NAME = 26  # columns of the longest line of a name
TEXTS = 4  # columns of texts, before those of numbers
_NAMES = ("theta_i", "phi_i", "theta_r", "phi_r")


@click.command(name="budget")
@click.argument("source", metavar="SESSION|SAMPLES", type=click.Path(path_type=Path))
@click.option(
    "--at",
    metavar="THETA_I,PHI_I,THETA_R,PHI_R",
    help="Show the budget of the sample nearest to these directions (degrees) instead of all "
    "samples.",
)
@click.option(
    "--select",
    "selections",
    multiple=True,
    metavar="KEY=VALUE",
    help="Use part of a file, such as wavelength=650 or channel=red.",
)
@click.option(
    "--threads", type=click.IntRange(min=1), metavar="N", help="Number of worker threads."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.option("--csv", "as_csv", is_flag=True, help="Print the table as CSV, with all digits.")
@click.option("--latex", "as_latex", is_flag=True, help="Print the table as LaTeX, in per cent.")
def command(
    source: Path,
    at: str | None,
    selections: tuple[str, ...],
    threads: int | None,
    as_json: bool,
    as_csv: bool,
    as_latex: bool,
) -> None:
    """List where the uncertainty of BRDF samples comes from.

    The table has a row for each source: its standard uncertainty in per cent of f, as the median
    over the samples and the 5th and 95th percentile. An error of the viewing direction is converted
    by the slope of f over neighbouring samples. A source without a stated uncertainty is listed as
    unknown and not counted.
    """
    from gonio.cli.options import echo_json, refuse_both

    refuse_both(as_json, as_csv, as_latex)
    directions = None if at is None else _directions(at)
    require_measured(source)
    from gonio.calibration.budget import budget

    uncertainties = budget(read_source(source, pairs(selections), threads))
    report = uncertainties.describe(
        None if directions is None else uncertainties.nearest(*directions)
    )
    if as_json:
        echo_json({**report, "source": str(source)})
    elif as_csv or as_latex:
        from gonio.reporting.tables import budget_table

        table = budget_table(report)
        click.echo(table.latex() if as_latex else table.csv(), nl=False)
    else:
        _show(report, source)


def _directions(text: str) -> tuple[float, float, float, float]:
    """Four angles in radians.

    Examples
    --------
    >>> [round(a, 4) for a in _directions("30, 0, 45, 180")]
    [0.5236, 0.0, 0.7854, 3.1416]
    """
    try:
        theta_i, phi_i, theta_r, phi_r = (math.radians(float(part)) for part in text.split(","))
    except ValueError:
        raise ConfigurationError(
            f"--at {text!r} is not four angles; write theta_i,phi_i,theta_r,phi_r in degrees, for "
            "instance 30,0,45,180.",
            value=text,
        ) from None
    return theta_i, phi_i, theta_r, phi_r


def _show(report: dict[str, Any], source: Path) -> None:
    at = report["at"]
    _say(f"{source}: {_what(report)}")
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
                *_figures(row["relative"], at),
                "?" if share is None else f"{share:.1%}",
            )
        )
    k = report["coverage_factor"]
    rows.append(("combined", "", "", "", *_figures(report["combined"], at), ""))
    rows.append((f"expanded, k = {k:g}", "", "", "", *_figures(report["expanded"], at), ""))
    lines = table_lines(rows, shutil.get_terminal_size((WIDTH, 24)).columns)
    sums = sum(len(_folded(row[0])) for row in rows[-2:])
    click.echo()
    if not at:
        click.echo(f"{'u/f in % over the samples':>{lines[0].index('95 %') + 4}}")
    for line in [*lines[:-sums], "", *lines[-sums:], ""]:
        click.echo(line)
    for line in _remarks(report):
        _say(line)


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


def _what(report: dict[str, Any]) -> str:
    kind, n, at = report["quantity"], report["n_samples"], report["at"]
    if at:
        where = ", ".join(f"{name} {at[name] + 0.0:.4g}" for name in _NAMES)
        return f"{kind} {at['value']:.4g} sr^-1 at {where} deg"
    left = report["n_left_out"]
    left_out = f", {left} of them 0 within their noise and left out" if left else ""
    return f"{kind}, {n} samples{left_out}"


def _figures(summary: dict[str, float] | None, at: Any) -> tuple[str, ...]:
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


def _remarks(report: dict[str, Any]) -> list[str]:
    lines = [
        "u: standard uncertainty of f by one source; share: its part of the variance"
        + ("." if report["at"] else ", mean of the samples."),
        "Type A: from counts, or from a fit to calibration frames. Type B: stated by certificate "
        "or operator, without degrees of freedom, which are taken as infinite; those of counts "
        "are many.",
        "A factor multiplies f and an offset adds to it; what turns the viewing direction counts "
        "by the slope of f over neighbouring samples.",
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


def _say(text: str) -> None:
    click.echo(
        textwrap.fill(
            text, 80, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False
        )
    )
