"""`gonio report`: a fit as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.samples import BRDFSamples
    from gonio.session import Session


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
def command(source: Path, output: Path | None, selections: tuple[str, ...]) -> None:
    """Write a fit as one HTML page that opens without a network.

    FIT.json is what 'gonio fit -o' wrote. Samples, session and draws are looked for by the names
    they had, from the current folder and from that of FIT.json; what is gone is left out, and the
    page says so.
    """
    from gonio.cli.joint import part_chooser
    from gonio.cli.options import check_target

    output = source.with_suffix(".html") if output is None else output
    if output.suffix.lower() not in (".html", ".htm"):
        raise ConfigurationError(
            f"{output}: a report is written as .html; give a name that ends so.", value=output
        )
    check_target(output)
    from gonio.files import write_text
    from gonio.reporting import gather, page

    inputs = gather(source, _reduce, part_chooser(source, selections))
    write_text(output, page(inputs))
    for line in inputs.absent:
        click.echo(f"left out: {line}", err=True)
    click.echo(f"written to {output}", err=True)


def _reduce(session: Session) -> BRDFSamples:
    from gonio.calibration.reduction.reduce import reduce
    from gonio.cli.progress import progress

    with progress(f"reducing {session.path.name or session.path}", "images") as callback:
        return reduce(session, progress=callback)
