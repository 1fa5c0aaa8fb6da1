"""`gonio calibrate camera`: flat and dark frames -> gain, noise, black level, linearity."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rich_click as click

UNITS = {
    "gain_dn_per_e": "counts/e-",
    "black_dn": "counts",
    "saturation_dn": "counts",
    "full_well_e": "e-",
    "read_noise_e": "e-",
    "dark_e_per_s": "e-/s",
    "dsnu_e_per_s": "e-/s",
}


@click.command(name="camera")
@click.argument("flats", metavar="FLATS", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="CAMERA.toml",
    type=click.Path(path_type=Path),
    help="File to write, .toml or .json; session.toml names it by camera.file.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(flats: Path, output: Path | None, as_json: bool) -> None:
    """Measure a camera by photon transfer (EMVA 1288).

    FLATS is a folder with a flats.toml and two or more flat frames and dark frames at each of
    several exposures. An even light falls on the sensor; it may be uneven by some per
    cent. Take about ten exposures over two decades of signal, and one that saturates. 'gonio flats'
    writes such a folder for a virtual instrument.
    """
    from gonio.cli.options import check_target, echo_json

    if output is not None:
        from gonio.calibration.frames.camera_file import check_suffix

        check_suffix(output)
        check_target(output)
    from gonio.verbs.calibrate_camera import calibrate_camera

    content = calibrate_camera(flats, output=output)
    for warning in content["fit"]["warnings"]:
        click.echo(f"Warning: {warning}.", err=True)
    if as_json:
        echo_json({**content, "output": None if output is None else str(output)})
        return
    _show(content)
    if output is not None:
        click.echo(f"{output}: figures of one pixel of the frames.")


def _show(content: dict[str, Any]) -> None:
    from rich.table import Table

    from gonio.cli.options import table_console

    table = Table("figure", "value", "std. uncertainty", "unit")
    for name, value in content["camera"].items():
        u = content["uncertainty"][name]
        shown = "unknown" if value is None else f"{value:.6g}"
        table.add_row(name, shown, "" if u is None else f"{u:.2g}", UNITS.get(name, ""))
    table_console().print(table)
    fit = content["fit"]
    click.echo(
        f"{sum(fit['used'])} of {len(fit['used'])} exposures below saturation; they depart from "
        f"the law of the nonlinearity by up to {100 * fit['largest_departure']:.2g} %; the light "
        f"scatters by {100 * fit['lamp_sd']:.2g} % from frame to frame."
    )
