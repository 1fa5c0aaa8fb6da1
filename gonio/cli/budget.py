"""`gonio budget`: where the uncertainty of the samples comes from."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import rich_click as click

from gonio.cli.inputs import require_measured
from gonio.cli.measured import pairs, read_source
from gonio.errors import ConfigurationError


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
    from gonio.calibration.budget_page import WIDTH, page

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
        columns = shutil.get_terminal_size((WIDTH, 24)).columns
        for line in page(report, f"{source}: ", columns):
            click.echo(line)


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
