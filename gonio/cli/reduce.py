"""`gonio reduce`: raw frames -> BRDF samples."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import rich_click as click

from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.samples import BRDFSamples


@click.command(name="reduce")
@click.argument("session", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="SAMPLES.nc",
    type=click.Path(path_type=Path),
    help="File of BRDF samples to write, netCDF.",
)
@click.option(
    "--mapping",
    type=click.Choice(["eq3", "exact"]),
    default="eq3",
    show_default=True,
    help="How a pixel is mapped to a direction: by Ward's eq. (3), or by the law of reflection.",
)
@click.option(
    "--geometry",
    metavar="GEOMETRY.toml",
    type=click.Path(path_type=Path),
    help="File written by 'gonio calibrate alignment', to replace the geometry that the "
    "session states.",
)
@click.option(
    "--dome",
    metavar="DOME.nc",
    type=click.Path(path_type=Path),
    help="Map of the dome, written by 'gonio calibrate dome' from other sessions on the rig.",
)
@click.option(
    "--retro",
    is_flag=True,
    help="Keep samples seen through the patch where the beam of the lamp enters the dome; "
    "they are flagged.",
)
@click.option(
    "--force",
    is_flag=True,
    help="Continue if frames are faulty; the history lists the faults.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of worker threads; the samples do not depend on it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    session: Path,
    output: Path,
    mapping: Literal["eq3", "exact"],
    geometry: Path | None,
    dome: Path | None,
    retro: bool,
    force: bool,
    threads: int | None,
    as_json: bool,
) -> None:
    """Turn the raw frames of SESSION into BRDF samples with uncertainties.

    The exposures of each image are merged and referred to the white standard. The geometry of the
    dome gives the direction of each pixel. Neighbouring pixels are averaged into cells; a fit
    integrates the model over the cells and the cone of the lamp. After an error no partial file is
    left.
    """
    from gonio.cli.options import check_target
    from gonio.cli.progress import progress
    from gonio.session import Session

    if output.suffix != ".nc":
        raise ConfigurationError(
            f"{output}: samples are written as netCDF; give a name that ends in .nc.", value=output
        )
    check_target(output)
    opened = Session.open(session)
    opened.require_complete()
    if geometry is not None:
        from gonio.calibration.dome import geometry_file

        geometry_file.read(geometry)  # before anything slow is imported
    from gonio.calibration.reduction.reduce import reduce

    with progress(f"reducing {session.name or session}", "images") as callback:
        samples = reduce(
            opened,
            mapping=mapping,
            geometry=geometry,
            dome=dome,
            retro=retro,
            force=force,
            threads=threads,
            progress=callback,
        )
    samples.save(output)
    _print(samples, output, as_json)


def _print(samples: BRDFSamples, output: Path, as_json: bool) -> None:
    from gonio.cli.options import echo_json

    negative = int((samples.value < 0).sum())
    if as_json:
        echo_json(
            {
                "schema": "gonio.reduce/1",
                "samples": str(output),
                "sample": samples.metadata["sample"],
                "instrument": samples.metadata["instrument"],
                "n_samples": len(samples),
                "n_negative": negative,
                "findings": samples.metadata["findings"],
                "history": list(samples.history),
            }
        )
        return
    for line in samples.history:
        click.echo(f"- {line}")
    click.echo(f"{output}: {len(samples)} samples, {negative} of them negative (noise around 0).")
