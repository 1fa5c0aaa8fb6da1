"""`gonio instruments`: the virtual instruments and their parts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_instrument
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.table import Table

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
_CAUSES = {
    "pixel": "pixel",
    "pupil": "pupil, focus and aberrations",
    "psf": "point spread",
    "source": "source cone",
    "total": "all together",
}
_COVERAGE = {
    "any": "some rays land on lit sample",
    "whole": "99 % of the rays do",
    "usable": "some, inside the rim mask",
    "usable_whole": "99 %, inside the rim mask",
}


@click.command(name="instruments")
@click.argument(
    "name", required=False, metavar="[PRESET|FILE.toml]", shell_complete=complete_instrument
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.option(
    "--toml",
    "as_toml",
    is_flag=True,
    help="Print the file of the preset, as a start for your own instrument.",
)
@click.option(
    "--resolution",
    is_flag=True,
    help="Trace rays to find the resolution: smallest alpha, blur, visible directions.",
)
@click.option(
    "--map",
    "map_to",
    metavar="OUT.png",
    type=click.Path(path_type=Path),
    help="With --resolution: write a map of blur and coverage, .png, .pdf or .svg.",
)
def command(
    name: str | None, as_json: bool, as_toml: bool, resolution: bool, map_to: Path | None
) -> None:
    """List the virtual instruments, or show one with all of its parts.

    Your own instrument is a TOML file: print that of a preset with --toml, edit it, and pass its
    name to 'gonio simulate --instrument'.
    """
    import gonio.instrument as instrument
    from gonio.cli.options import echo_json

    if resolution or map_to is not None:
        if name is None or as_toml or not resolution:
            raise ConfigurationError(
                "--resolution traces one instrument, with --map OUT.png if you like; "
                f"without --toml, give one of {', '.join(instrument.preset_names())}, "
                "or a FILE.toml."
            )
        _resolution(instrument.load(name), as_json, map_to)
        return
    if as_toml:
        _print_file(name, as_json)
        return
    chosen = [instrument.load(each) for each in ([name] if name else instrument.preset_names())]
    if as_json:
        documents = [instrument.model_dump(mode="json") for instrument in chosen]
        echo_json(documents[0] if name else documents)
    elif name:
        _show_one(chosen[0])
    else:
        _show_all(chosen)


def _print_file(name: str | None, as_json: bool) -> None:
    from importlib import resources

    import gonio.instrument as instrument

    if name is None or as_json:
        raise ConfigurationError(
            "--toml prints the file of one preset; without --json, give one of "
            f"{', '.join(instrument.preset_names())}."
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
    for instrument in chosen:
        rows, columns = instrument.sensor.shape
        table.add_row(
            instrument.name,
            instrument.dome.shape,
            f"{columns} x {rows}",
            str(len(instrument.sensor.exposures_s)),
            instrument.description,
        )
    table_console().print(table)


def _show_one(instrument: Instrument) -> None:
    from rich.table import Table

    from gonio.cli.options import table_console

    console = table_console()
    console.print(f"{instrument.name}: {instrument.description}")
    table = Table("setting", "value", "meaning")
    table.columns[0].no_wrap = True
    table.columns[1].max_width = 18
    for prefix, part in {"": instrument, **_parts(instrument)}.items():
        for key, value, meaning in _rows(part):
            table.add_row(prefix + key, value, meaning)
        table.add_section()
    console.print(table)


def _parts(instrument: Instrument) -> dict[str, Part]:
    """The parts by the prefix of their settings' names; lists of parts are numbered from 1."""
    from gonio.instrument.part import Part

    parts: dict[str, Part] = {}
    for key, value in instrument:
        several = value if isinstance(value, tuple) else ()
        parts |= {f"{key}.": value} if isinstance(value, Part) else {}
        parts |= {f"{key}.{k}.": part for k, part in enumerate(several, 1)}
    return parts


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


def _resolution(instrument: Instrument, as_json: bool, map_to: Path | None) -> None:
    from gonio.cli.options import check_target, echo_json

    if map_to is not None:
        from gonio.plotting.style import format_of

        format_of(map_to)
        check_target(map_to)
    from gonio.instrument.resolution import report, resolve

    resolution = resolve(instrument)
    document = report(resolution)
    if as_json:
        echo_json(document)
    else:
        _show_resolution(document)
    if map_to is not None:
        from gonio.plotting import resolution_map, save

        save(resolution_map(resolution), map_to)
        click.echo(f"written to {map_to}", err=True)


def _show_resolution(document: dict[str, Any]) -> None:
    from gonio.cli.options import table_console

    console = table_console()
    console.print(
        f"{document['instrument']}: smallest alpha that it resolves, where the blur widens a lobe "
        f"by {100 * document['excess']:g} %"
    )
    console.print(_alpha_table(document["alpha"]))
    console.print("Blur of the viewing direction over the usable hemisphere, sd on an axis, deg")
    console.print(_blur_table(document["blur_deg"]))
    console.print("theta_r up to which everything is seen, deg; a sector is 10 deg of azimuth")
    console.print(_coverage_table(document["theta_r"]))
    for line in _resolution_notes(document):
        console.print(line)


def _alpha_table(rows: list[dict[str, Any]]) -> Table:
    from rich.table import Table

    table = Table("theta_i", "axis", "blur sd", "smallest alpha", "widened still after a fit")
    for row in rows:
        for axis, heading in (("in_plane", "in the plane"), ("across", "across it")):
            values = row[axis]
            cells = ["not seen", "unknown", "unknown"]
            if values is not None:
                left = 100 * values["excess_reduced"]
                cells = [f"{values['blur_deg']:.3f} deg", f"{values['alpha']:.4f}"]
                cells.append("< 0.01 %" if left < 0.01 else f"{left:.2f} %")
            table.add_row(f"{row['theta_i_deg']:g} deg", heading, *cells)
    return table


def _blur_table(causes: dict[str, dict[str, float | None]]) -> Table:
    from rich.table import Table

    table = Table("cause", "median, larger axis", "median, smaller axis", "largest")
    for key, values in causes.items():
        cells = ["unknown" if sd is None else f"{sd:.3f}" for sd in values.values()]
        table.add_row(_CAUSES[key], *cells)
    return table


def _coverage_table(coverage: dict[str, Any]) -> Table:
    from rich.table import Table

    table = Table("directions of which", "worst sector", "best sector", "of the hemisphere")
    for key, meaning in _COVERAGE.items():
        part = coverage[key]
        table.add_row(
            meaning,
            f"{part['min_deg']:.1f}",
            f"{part['max_deg']:.1f}",
            f"{100 * part['share_of_hemisphere']:.1f} %",
        )
    return table


def _resolution_notes(document: dict[str, Any]) -> Iterator[str]:
    coverage, arm, pointing = (document[k] for k in ("theta_r", "theta_i", "pointing_sd_deg"))
    yield (
        f"The lens sees {coverage['lens_field_deg']:g} deg; the reduction leaves out theta_r > "
        f"{coverage['rim_mask_deg']:g} deg. The arm reaches theta_i = {arm['arm_max_deg']:g} deg; "
        + (
            "the specular direction is not seen."
            if arm["specular_seen_max_deg"] is None
            else f"the specular direction is seen up to {arm['specular_seen_max_deg']:.1f} deg."
        )
    )
    yield (
        "Slope errors of the dome move directions and do not blur them: pointing error of sd "
        f"{pointing['zenith']:.2f} deg on an axis at the zenith, {pointing['usable_rim']:.2f} deg "
        "at the rim mask."
    )
    yield (
        "A fit integrates the model over pixels and source cone; the last column of the first "
        "table is what pupil and point spread do to the smallest alpha then."
    )
