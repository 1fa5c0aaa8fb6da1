"""`gonio flats`: flat and dark frames by the sensor of a virtual instrument."""

from __future__ import annotations

from pathlib import Path

import rich_click as click

from gonio.cli.completion import complete_instrument


@click.command(name="flats")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="New folder for the frames.",
)
@click.option(
    "--instrument",
    shell_complete=complete_instrument,
    default="modern12",
    show_default=True,
    metavar="PRESET|FILE.toml",
    help="Instrument whose sensor takes the frames; see 'gonio instruments'.",
)
@click.option(
    "--exposures",
    type=click.IntRange(min=4),
    default=12,
    show_default=True,
    metavar="N",
    help="Number of exposures, over two decades of signal; the longest saturates.",
)
@click.option(
    "--takes",
    type=click.IntRange(min=2),
    default=2,
    show_default=True,
    metavar="N",
    help="Number of flat frames, and of dark frames, at each exposure.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of the random numbers; the sensor is that of sessions with the same seed.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of worker threads; the frames do not depend on it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    output: Path,
    instrument: str,
    exposures: int,
    takes: int,
    seed: int,
    threads: int | None,
    as_json: bool,
) -> None:
    """Record flat and dark frames with the sensor of a virtual instrument.

    An even light falls on the sensor, without lens or dome. FOLDER gets the frames and a
    flats.toml that says which is which. 'gonio calibrate camera' turns them into figures of the
    camera.
    """
    from gonio.cli.options import echo_json
    from gonio.cli.progress import progress
    from gonio.verbs.flats import flats

    with progress(f"taking flat frames with {instrument}", "frames") as callback:
        flats(
            output,
            instrument=instrument,
            count=exposures,
            takes=takes,
            seed=seed,
            threads=threads,
            progress=callback,
        )
    n = 2 * exposures * takes
    if as_json:
        echo_json({"schema": "gonio.flats/1", "folder": str(output), "n_frames": n})
        return
    click.echo(f"{output}: {n} frames, {exposures} exposures, {takes} takes of flat and of dark.")
