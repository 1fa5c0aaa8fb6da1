"""`gonio calibrate alignment`: frames of a mirror -> positions of dome and camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.calibration.dome.alignment import Alignment
    from gonio.calibration.dome.spot_residuals import Length


@click.command(name="alignment")
@click.argument(
    "sessions", metavar="SESSION...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="GEOMETRY.toml",
    type=click.Path(path_type=Path),
    help="File to write, for 'gonio reduce --geometry'.",
)
@click.option("--R-mm", "r_mm", type=float, metavar="MM", help="Measured radius R of the dome.")
@click.option(
    "--u-R-mm", "u_r_mm", type=float, metavar="MM", help="Standard uncertainty of --R-mm."
)
@click.option(
    "--separation-mm",
    type=float,
    metavar="MM",
    help="Measured distance 2 D from the pupil of the camera to the target.",
)
@click.option(
    "--u-separation-mm",
    type=float,
    metavar="MM",
    help="Standard uncertainty of --separation-mm.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    sessions: tuple[Path, ...],
    output: Path,
    r_mm: float | None,
    u_r_mm: float | None,
    separation_mm: float | None,
    u_separation_mm: float | None,
    as_json: bool,
) -> None:
    """Fit R, D, pupil, image centre and azimuth of the camera to the spots of a mirror.

    SESSION holds frames of a mirror in place of the sample ('gonio simulate --mirror'). Directions
    do not change if all lengths are scaled by the same factor. Give one measured length, or all
    lengths remain multiples of R. The output states which quantities the spots determine; the
    others keep their values. To determine all of them, put the lamp on both sides and use a wedge
    of at least 10 deg at three azimuths.
    """
    from gonio.cli.options import check_target
    from gonio.session import Session

    if output.suffix != ".toml":
        raise ConfigurationError(
            f"{output}: a geometry is written as TOML; give a name that ends in .toml.",
            value=output,
        )
    check_target(output)
    opened = [Session.open(path) for path in sessions]
    from gonio.calibration.dome.from_mirror import calibrate_alignment

    result = calibrate_alignment(
        opened,
        R=_length("R", r_mm, u_r_mm),
        separation=_length("separation", separation_mm, u_separation_mm),
    )
    result.save(output)
    _print(result.alignment, result.without_spot, output, as_json)


def _length(name: str, value: float | None, u: float | None) -> Length | None:
    from gonio.calibration.dome.spot_residuals import Length

    if value is None and u is None:
        return None
    if value is None or u is None:
        given, other = (f"--u-{name}-mm", f"--{name}-mm")[:: 1 if value is None else -1]
        raise ConfigurationError(
            f"{given} needs {other}: a known length is a value with its standard uncertainty."
        )
    return Length(value, u)


def _print(alignment: Alignment, lost: dict[str, str], output: Path, as_json: bool) -> None:
    from gonio.calibration.dome.alignment import UNITS
    from gonio.cli.options import echo_json

    units = {name: UNITS.get(name, "mm") for name in alignment.values}
    not_used = lost | dict(alignment.dropped)
    if as_json:
        echo_json(
            {
                "schema": "gonio.calibrate.alignment/1",
                "geometry": str(output),
                "figures": {
                    name: {"value": value, "stderr": alignment.sd[name], "unit": units[name]}
                    for name, value in alignment.values.items()
                },
                "not_determined": {k: list(v) for k, v in alignment.held_for.items()},
                "spots": len(alignment.names),
                "not_used": not_used,
                "rms_px": alignment.rms_px,
                "chi2": alignment.chi2,
                "dof": alignment.dof,
                "scale": alignment.scale,
                "lens_uncertainty_known": alignment.pixel_map.lens.uncertain is not None,
            }
        )
        return
    width = max(map(len, alignment.values))
    for name, value in alignment.values.items():
        sd = alignment.sd[name]
        uncertainty = _undetermined(name, alignment) if sd is None else f"+- {sd:.2g} {units[name]}"
        click.echo(f"{name:<{width}}  {value:12.5f}  {uncertainty}")
    click.echo(
        f"{len(alignment.names)} spots, residuals of {alignment.rms_px:.3g} px rms; chi2 "
        f"{alignment.chi2:.3g} with {alignment.dof} degrees of freedom"
        + (f", uncertainties widened {alignment.scale:.2g} times." if alignment.scale > 1 else ".")
    )
    if alignment.pixel_map.lens.uncertain is None:
        click.echo("The lens is taken as exact: the uncertainty of its calibration is unknown.")
    for name, why in not_used.items():
        click.echo(f"not used: {name}: {why}.")
    click.echo(f"{output}: geometry of {alignment.pixel_map.geometry.shape} and camera.")


def _undetermined(name: str, alignment: Alignment) -> str:
    if name == "R":
        return "mm, not determined: no length is known; the others are in proportion to it"
    others = " and ".join(alignment.held_for.get(name, ())) or "the others"
    return f"held, not determined: the spots cannot separate it from {others}"
