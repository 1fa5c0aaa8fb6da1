"""`gonio report`: a fit as one HTML page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.inputs import require_fit
from gonio.cli.options import given, model_of_fit, samples_of_fit
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult


@click.command(name="report")
@click.argument("source", metavar="FIT.json", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="REPORT.html",
    type=click.Path(path_type=Path),
    help="Page to write; FIT.json with .html where not given.",
)
@click.option(
    "--select",
    "selections",
    multiple=True,
    metavar="KEY=VALUE",
    help="Part of a joint fit: wavelength=650, channel=NAME or part=NAME.",
)
@click.option("--operator", metavar="NAME", help="Who measured; stands in the page alone.")
@click.option(
    "--date",
    "dates",
    multiple=True,
    metavar="YYYY-MM-DD",
    help="Day of the measurement; repeat for each.",
)
@click.option("--issued", metavar="YYYY-MM-DD", help="Day of the report.")
@click.option(
    "--serial",
    "serials",
    multiple=True,
    metavar="NAME=NUMBER",
    help="Serial number of the sample, the lamp, the standard ...; repeat for each.",
)
@click.option(
    "--coverage",
    metavar="K|P%",
    help="Adds expanded uncertainties U = k u: a factor, k=2, or a probability, 95%, from which k "
    "follows.",
)
@click.option(
    "--dof",
    type=float,
    metavar="N",
    help="Effective degrees of freedom of the uncertainties; a probability then gives k by "
    "Student's distribution.",
)
@click.option(
    "--csv",
    "as_csv",
    is_flag=True,
    help="Print the table of parameters as CSV; no page without -o.",
)
@click.option(
    "--latex",
    "as_latex",
    is_flag=True,
    help="Print the table of parameters as LaTeX; no page without -o.",
)
@samples_of_fit
@model_of_fit
def command(
    source: Path,
    output: Path | None,
    selections: tuple[str, ...],
    operator: str | None,
    dates: tuple[str, ...],
    issued: str | None,
    serials: tuple[str, ...],
    coverage: str | None,
    dof: float | None,
    as_csv: bool,
    as_latex: bool,
    samples: Path | None,
    model: str | None,
) -> None:
    """Write a fit as one HTML page that opens without a network and prints.

    FIT.json is what 'gonio fit -o' wrote. Samples, session and draws are looked for by the names
    they had, from the current folder and from that of FIT.json; what is gone is left out, and the
    page says so. A browser prints the page as PDF.
    """
    from gonio.cli.joint import chooser
    from gonio.cli.options import check_target, refuse_both
    from gonio.cli.progress import stages

    refuse_both(as_csv, as_latex)
    only_table = (as_csv or as_latex) and output is None
    given(model, source)
    output = source.with_suffix(".html") if output is None else output
    if output.suffix.lower() not in (".html", ".htm"):
        raise ConfigurationError(
            f"{output}: a report is written as HTML; give a name that ends in .html.", value=output
        )
    if not only_table:
        check_target(output)
    require_fit(source)
    from gonio.reporting.statement import statement

    stated = statement(operator, dates, issued, serials, coverage, dof)
    choose = chooser(source, selections)
    if as_csv or as_latex:
        _print_table(source, choose if selections else None, stated.coverage, as_latex)
    if only_table:
        return
    from gonio.verbs.report import report

    with stages() as callback:
        made = report(
            source,
            samples=samples,
            choose=choose,
            operator=operator,
            dates=dates,
            issued=issued,
            serials=serials,
            coverage=coverage,
            dof=dof,
            progress=callback,
        )
    made.save(output)
    for line in made.absent:
        click.echo(f"left out: {line}", err=True)
    click.echo(f"written to {output}", err=True)


def _print_table(
    source: Path,
    choose: Callable[[FitResult], FitResult] | None,
    coverage: float | None,
    as_latex: bool,
) -> None:
    """The table of parameters on stdout; of a joint fit all of them where no part is chosen."""
    from gonio.fitting.result import FitResult
    from gonio.reporting.tables import fit_table

    fit = FitResult.load(source)
    table = fit_table(fit if choose is None else choose(fit), coverage)
    click.echo(table.latex() if as_latex else table.csv(), nl=False)
