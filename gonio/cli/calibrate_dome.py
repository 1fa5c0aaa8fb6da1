"""`gonio calibrate dome`: samples of sessions on one rig -> map of its dome."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.completion import complete_model
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.fitting.dome_field.calibrate_dome import DomeCalibration


@click.command(name="dome")
@click.argument(
    "sources", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "--model",
    "model_names",
    metavar="MODEL",
    multiple=True,
    required=True,
    shell_complete=complete_model,
    help="Model of the material; one for all inputs, or repeated, one for each in their order.",
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="DOME.nc",
    type=click.Path(path_type=Path),
    help="File to write, for 'gonio reduce --dome'.",
)
@click.option("--threads", type=click.IntRange(min=1), metavar="N",
              help="Number of worker threads; the result does not depend on it.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.pass_context
def command(
    ctx: click.Context,
    sources: tuple[Path, ...],
    model_names: tuple[str, ...],
    output: Path,
    threads: int | None,
    as_json: bool,
) -> None:
    """Find the slope errors of a dome from ordinary sessions on its rig.

    INPUT is a session or a samples file. The slope errors and the materials are found together. A
    narrow lobe shows the dome best; a matte sample shows nothing of it. The exit code is 1 if the
    map does not predict images that were left out: a model may be wrong.
    """
    from gonio.cli.options import check_target, echo_json
    from gonio.models import resolve

    if output.suffix != ".nc":
        raise ConfigurationError(
            f"{output}: a map of a dome is written as netCDF; give a name that ends in .nc.",
            value=output,
        )
    check_target(output)
    models = [resolve(name) for name in model_names]
    from gonio.fitting.dome_field.calibrate_dome import calibrate_dome
    from gonio.reading import load

    samples = [load(source) for source in sources]
    result = calibrate_dome(samples, models, threads=threads)
    result.map.save(output)
    failures = result.findings.failures
    if as_json:
        echo_json(
            {
                "schema": "gonio.calibrate.dome/1",
                "dome": str(output),
                "rig": result.map.rig,
                "sessions": list(result.map.sessions),
                "parameters": [
                    {name: {"value": v, "stderr": u} for name, (v, u) in own.items()}
                    for own in result.parameters
                ],
                "findings": result.findings.to_dict(),
                "failures": list(failures),
            }
        )
    else:
        _print(result, sources, output)
    if failures:
        ctx.exit(1)


def _print(result: DomeCalibration, sources: tuple[Path, ...], output: Path) -> None:
    for line in (*result.findings.notes, *result.findings.warnings):
        click.echo(f"- {line}.")
    for each in result.findings.predictions:
        click.echo(f"- left out: {each.left_out}: chi2/n of the prediction {each.ratio:.3g}.")
    for line in result.findings.failures:
        click.echo(f"- the map is not to be trusted: {line}.")
    for source, own in zip(sources, result.parameters, strict=True):
        values = ", ".join(f"{name} {value:.6g} +- {u:.2g}" for name, (value, u) in own.items())
        click.echo(f"- {source.name}: {values} (without the standard, internal units)")
    click.echo(f"{output}: dome of {result.map.rig}.")
