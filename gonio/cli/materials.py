"""`gonio materials`: the named materials of the papers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.completion import complete_material

if TYPE_CHECKING:
    from gonio.materials import Material


@click.command(name="materials")
@click.argument("name", required=False, shell_complete=complete_material)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(name: str | None, as_json: bool) -> None:
    """List the materials published in papers, or show one.

    With NAME, the note on that material is also shown. Angles are in degrees.
    """
    import gonio.materials as materials
    from gonio.cli.options import echo_json

    chosen = [materials.get(each) for each in ([name] if name else materials.names())]
    if as_json:
        documents = [material.describe() for material in chosen]
        echo_json(documents[0] if name else documents)
    elif name:
        _show_one(chosen[0])
    else:
        _show_all(chosen)


def _show_all(chosen: list[Material]) -> None:
    """One line per material, under a heading for each table or figure of a paper."""
    heading = ""
    width = max(len(material.name) for material in chosen)
    for material in chosen:
        # Author and year: the full reference stands in the view of one material.
        short = material.paper.partition(",")[0]
        if heading != (source := f"{short}, {material.where} (model {material.model})"):
            click.echo(("\n" if heading else "") + source)
            heading = source
        click.echo(f"  {material.name:<{width}}  {_parameters(material, ' ')}")


def _show_one(material: Material) -> None:
    from gonio.cli.options import table_console

    rows = {
        "name": material.name,
        "title": material.title,
        "model": material.model,
        "parameters": _parameters(material),
        "anisotropic": "yes" if material.anisotropic else "no",
        "paper": material.paper,
        "where": material.where,
        "note": material.note,
    }
    console = table_console()
    for label, text in rows.items():
        console.print(f"{label:<12} {text}")


def _parameters(material: Material, separator: str = ", ") -> str:
    import gonio.models as models
    from gonio.cli.options import file_text

    model = models.get(material.model)
    return separator.join(
        f"{name}={file_text(model.parameter(name), value)}"
        for name, value in material.parameters.items()
    )
