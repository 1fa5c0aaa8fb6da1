"""`gonio instruments`: the virtual instruments and their parts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.instrument import Instrument
    from gonio.instrument.part import Part

# The unit of a field is the end of its name, the longest that fits; the letters of the papers
# have none.
_UNITS = {
    "_e_per_s": "e-/s",
    "_dn_per_e": "count/e-",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_px": "px",
    "_deg": "deg",
    "_dn": "counts",
    "_e": "e-",
    "_s": "s",
    "bits": "bit",
}
_LETTERS = {"R": "mm", "D": "mm"}


@click.command(name="instruments")
@click.argument("name", required=False, metavar="[PRESET|FILE.toml]")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.option(
    "--toml", "as_toml", is_flag=True, help="Print the file of the preset, to start your own from."
)
def command(name: str | None, as_json: bool, as_toml: bool) -> None:
    """List the virtual instruments, or show one with all of its parts.

    An instrument of your own is a TOML file: take that of a preset with --toml, change it, and
    give its name to 'gonio simulate --instrument'.
    """
    from gonio import instrument
    from gonio.cli.options import echo_json

    if as_toml:
        _print_file(name, as_json)
        return
    chosen = [instrument.load(each) for each in ([name] if name else instrument.preset_names())]
    if as_json:
        documents = [rig.model_dump(mode="json") for rig in chosen]
        echo_json(documents[0] if name else documents)
    elif name:
        _show_one(chosen[0])
    else:
        _show_all(chosen)


def _print_file(name: str | None, as_json: bool) -> None:
    from importlib import resources

    from gonio import instrument

    if name is None or as_json:
        raise ConfigurationError(
            "--toml prints the file of one preset; give its name, and no --json. "
            f"Known: {', '.join(instrument.preset_names())}."
        )
    instrument.preset(name)
    file = resources.files("gonio.data") / "instruments" / f"{name}.toml"
    click.echo(file.read_text("utf-8"), nl=False)


def _show_all(chosen: list[Instrument]) -> None:
    from rich.table import Table

    from gonio.cli.options import table_console

    table = Table("name", "dome", "frame", "exposures", "description")
    for column in table.columns[:-1]:
        column.no_wrap = True
    for rig in chosen:
        rows, columns = rig.sensor.shape
        table.add_row(
            rig.name,
            rig.dome.shape,
            f"{columns} x {rows}",
            str(len(rig.sensor.exposures_s)),
            rig.description,
        )
    table_console().print(table)


def _show_one(rig: Instrument) -> None:
    from rich.table import Table

    from gonio.cli.options import table_console

    console = table_console()
    console.print(f"{rig.name}: {rig.description}")
    table = Table("setting", "value", "meaning")
    table.columns[0].no_wrap = True
    table.columns[1].max_width = 18
    for prefix, part in {"": rig, **_parts(rig)}.items():
        for key, value, meaning in _rows(part):
            table.add_row(prefix + key, value, meaning)
        table.add_section()
    console.print(table)


def _parts(rig: Instrument) -> dict[str, Part]:
    """The parts by what their settings' names begin with; lists of parts are counted from 1."""
    from gonio.instrument.part import Part

    found: dict[str, Part] = {}
    for key, value in rig:
        several = value if isinstance(value, tuple) else ()
        found |= {f"{key}.": value} if isinstance(value, Part) else {}
        found |= {f"{key}.{k}.": part for k, part in enumerate(several, 1)}
    return found


def _rows(part: Part) -> Iterator[tuple[str, str, str]]:
    """Name, value with unit, and meaning of every setting of a part."""
    from gonio.instrument.part import Part

    fields = type(part).model_fields
    for key, value in part:
        held = value[0] if isinstance(value, tuple) and value else value
        of_instrument = "description" in fields and key in ("name", "description")
        if isinstance(held, Part) or of_instrument:
            continue
        unit = "" if value is None else _unit(key)
        yield key, f"{_text(value)} {unit}".strip(), fields[key].description or ""


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(_text(each) for each in value)
    if value is None or value == "":
        return "not stated"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _unit(key: str) -> str:
    if key in _LETTERS:
        return _LETTERS[key]
    ends = sorted((end for end in _UNITS if key.endswith(end)), key=len)
    return _UNITS[ends[-1]] if ends else ""
