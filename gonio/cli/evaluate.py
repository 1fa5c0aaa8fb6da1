"""`gonio evaluate`: a reflectance model at the directions of a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.completion import complete_material, complete_model
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.models import Model


@click.command(name="evaluate")
@click.argument("model", required=False, shell_complete=complete_model)
@click.option(
    "--material",
    shell_complete=complete_material,
    help="Named material to use instead of MODEL; see 'gonio materials'.",
)
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="Value of a parameter of the model, angles in degrees; repeat for each parameter. "
    "See 'gonio models MODEL'.",
)
@click.option(
    "--angles",
    required=True,
    type=click.Path(path_type=Path),
    help="CSV file with the columns theta_i, phi_i, theta_r, phi_r in degrees.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="CSV file to write; default: standard output.",
)
def command(
    model: str | None,
    material: str | None,
    items: tuple[str, ...],
    angles: Path,
    output: Path | None,
) -> None:
    """Evaluate a model: BRDF in sr^-1, cosine not included.

    MODEL is a name of 'gonio models', FILE.py or FILE.py:NAME.

    The output is a CSV with the four angles and the column brdf, with 17 significant digits. With
    --material, -p changes single parameters of the material.
    """
    from gonio.files import write_text
    from gonio.formats.gonio_csv import directions_table, read_directions
    from gonio.verbs.evaluate import evaluate

    chosen, parameters = _model_and_parameters(model, material, items)
    directions = read_directions(angles)
    text = directions_table(directions, evaluate(chosen, directions, parameters))
    if output is None:
        click.echo(text, nl=False)
    else:
        write_text(output, text)
        click.echo(f"written to {output}", err=True)


def _model_and_parameters(
    model: str | None, material: str | None, items: tuple[str, ...]
) -> tuple[Model, dict[str, float]]:
    import gonio.materials as materials
    import gonio.models as models
    from gonio.cli.options import file_text, parse_parameters

    if (model is None) == (material is None):
        given = "both were given" if model else "neither was given"
        raise ConfigurationError(f"give a MODEL or --material NAME; {given}.")
    if material is not None:
        named = materials.get(material)
        chosen = models.get(named.model)
        return chosen, {**named.parameters, **parse_parameters(chosen, items)}
    chosen = models.resolve(str(model))
    parameters = parse_parameters(chosen, items)
    left_out = [p for p in chosen.parameters if p.name not in parameters]
    if left_out:
        defaults = ", ".join(f"{p.name} = {file_text(p, p.default)}" for p in left_out)
        click.echo(f"Default values are used for {defaults}.", err=True)
    return chosen, parameters
