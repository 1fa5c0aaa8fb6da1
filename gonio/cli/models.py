"""`gonio models`: the reflectance models, their parameters and formulas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.completion import complete_model

if TYPE_CHECKING:
    from gonio.models import Model


@click.command(name="models")
@click.argument("name", required=False, shell_complete=complete_model)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(name: str | None, as_json: bool) -> None:
    """List the reflectance models, or show one.

    With NAME, the parameters (angles in degrees) and the formula of that model are shown; NAME may
    be FILE.py or FILE.py:NAME. A model of another package is listed with the name of the package.
    """
    import gonio.models as models
    from gonio.cli.options import echo_json

    chosen = [models.resolve(each) for each in ([name] if name else models.names())]
    if as_json:
        documents = [{**model.describe(), "origin": models.origin(model.name)} for model in chosen]
        echo_json(documents[0] if name else documents)
    elif name:
        _show_one(chosen[0])
    else:
        _show_all(chosen)


def _show_all(chosen: list[Model]) -> None:
    """Two lines per model: name and parameters, title and reference."""
    import gonio.models as models

    width = max(len(model.name) for model in chosen)
    for model in chosen:
        origin = models.origin(model.name)
        click.echo(f"{model.name:<{width}}  {', '.join(model.names)}")
        about = "; ".join(text for text in (model.title, model.reference) if text)
        click.echo(f"    {about}" + (f" (from {origin})" if origin != "gonio" else ""))


def _show_one(model: Model) -> None:
    from rich.table import Table

    import gonio.models as models
    from gonio.cli.options import file_range, file_text, table_console

    console = table_console()
    console.print(f"{model.name}: {model.title}")
    if model.reference:
        console.print(f"reference: {model.reference}")
    if (origin := models.origin(model.name)) != "gonio":
        console.print(f"from: {origin}")
    if model.validity:
        console.print(f"validity: {model.validity}")
    table = Table("parameter", "symbol", "unit", "allowed", "default", "meaning")
    for parameter in model.parameters:
        table.add_row(
            parameter.name,
            parameter.symbol,
            parameter.file_unit or "1",
            file_range(parameter),
            file_text(parameter, parameter.default),
            parameter.meaning,
        )
    console.print(table)
    console.print(str(model.describe()["documentation"]))
