"""`gonio boards`: photographs of a calibration board by a virtual camera, or the board to print."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_instrument
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.board import Board
    from gonio.instrument.board_camera import BoardCamera

_OPTIONS = (
    click.option(
        "--board",
        "kind",
        type=click.Choice(["charuco", "chessboard"]),
        default="charuco",
        show_default=True,
        help="A charuco board is detected even if only part of it is visible; a plain chessboard "
        "must be visible as a whole.",
    ),
    click.option(
        "--squares",
        default="12x9",
        show_default=True,
        metavar="COLUMNSxROWS",
        help="Number of columns and rows of squares, black and white together.",
    ),
    click.option(
        "--square-mm",
        type=float,
        default=20.0,
        show_default=True,
        metavar="MM",
        help="Side length of a square.",
    ),
    click.option(
        "--marker-mm",
        type=float,
        metavar="MM",
        help="Side length of a marker of a charuco board; default: 3/4 of the square.",
    ),
    click.option(
        "--dictionary",
        default="4x4_100",
        show_default=True,
        metavar="NAME",
        help="Marker dictionary of a charuco board: OpenCV's name without DICT_.",
    ),
)


def board_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that describe a board: kind, squares, square_mm, marker_mm, dictionary."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def chosen_board(
    kind: str, squares: str, square_mm: float, marker_mm: float | None, dictionary: str
) -> Board:
    """The board that the options describe."""
    from gonio.board import Board

    match = re.fullmatch(r"(\d+)[x×](\d+)", squares)
    if match is None:
        raise ConfigurationError(
            f"--squares {squares!r} is not COLUMNSxROWS such as 12x9.", value=squares
        )
    columns, rows = (int(each) for each in match.groups())
    return Board(kind, columns, rows, square_mm, marker_mm, dictionary)  # type: ignore[arg-type]


@click.command(name="boards")
@board_options
@click.option(
    "-o",
    "--output",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="New folder for the photographs.",
)
@click.option(
    "--print",
    "printed",
    metavar="BOARD.svg",
    type=click.Path(path_type=Path),
    help="Write the board to a file for printing, .svg or .png.",
)
@click.option(
    "--instrument",
    shell_complete=complete_instrument,
    default="modern12",
    show_default=True,
    metavar="PRESET|FILE.toml",
    help="Instrument whose camera takes the photographs; see 'gonio instruments'.",
)
@click.option(
    "--count",
    type=click.IntRange(min=1),
    default=25,
    show_default=True,
    metavar="N",
    help="Number of photographs.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of the random numbers: poses of the board and noise.",
)
@click.option(
    "--binning",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    metavar="N",
    help="Binning: N x N sensor pixels make one pixel of a photograph.",
)
@click.option(
    "--bits",
    type=click.Choice(["8", "16"]),
    default="8",
    show_default=True,
    help="Bits per pixel of the PNG files.",
)
@click.option(
    "--centre-offset-px",
    metavar="COLUMNS,ROWS",
    help="Offset of the lens axis from the middle of the sensor, in unbinned pixels; "
    "default: that of the instrument.",
)
@click.option(
    "--psf-px",
    type=float,
    metavar="SD",
    help="Blur of the lens, in unbinned pixels; default: that of the instrument.",
)
@click.option(
    "--field-deg",
    type=float,
    metavar="DEG",
    help="Full field of view of the lens, may exceed 180; default: that of the instrument.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of worker threads; the photographs do not depend on it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    kind: str,
    squares: str,
    square_mm: float,
    marker_mm: float | None,
    dictionary: str,
    output: Path | None,
    printed: Path | None,
    instrument: str,
    count: int,
    seed: int,
    binning: int,
    bits: str,
    centre_offset_px: str | None,
    psf_px: float | None,
    field_deg: float | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Photograph a calibration board with a virtual camera, or write the board to print.

    The photographs are written to FOLDER. They show the board in the middle of the field, half-way
    and at the rim. FOLDER/truth holds the true poses. 'gonio calibrate lens' turns the photographs
    into a calibrated lens.
    """
    if output is None and printed is None:
        raise ConfigurationError("give -o FOLDER for photographs or --print BOARD.svg for a board.")
    from gonio.instrument import load

    chosen_instrument = load(instrument)
    board = chosen_board(kind, squares, square_mm, marker_mm, dictionary)
    if printed is not None:
        _print_board(board, printed)
    if output is None:
        return
    from gonio.cli.progress import progress
    from gonio.instrument.board_camera import BoardCamera
    from gonio.verbs.boards import boards

    camera = BoardCamera.of(
        chosen_instrument,
        binning=binning,
        centre_offset_px=None if centre_offset_px is None else _pair(centre_offset_px),
        psf_px=psf_px,
        field_deg=field_deg,
    )
    with progress(f"photographing a {kind} board", "photographs") as callback:
        photos = boards(
            output,
            board=board,
            camera=camera,
            count=count,
            seed=seed,
            bits=8 if bits == "8" else 16,
            threads=threads,
            progress=callback,
        )
    _print(board, camera, output, photos.paths, as_json)


def _print_board(board: Board, path: Path) -> None:
    from gonio.plotting.board import save_board

    save_board(board, path)
    width, height = (side + 2 * board.margin_mm for side in board.size_mm)
    click.echo(f"{path}: {board}; {width:g} x {height:g} mm, to be printed at 100 %.", err=True)


def _pair(text: str) -> tuple[float, float]:
    try:
        x, y = (float(word) for word in text.split(","))
    except ValueError:
        raise ConfigurationError(
            f"--centre-offset-px {text!r} is not two numbers such as 3.5,-2.", value=text
        ) from None
    return x, y


def _print(
    board: Board, camera: BoardCamera, folder: Path, paths: list[Path], as_json: bool
) -> None:
    import json

    from gonio.cli.options import echo_json

    truth = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
    reach = max(photo["theta_max_deg"] for photo in truth["photos"])
    pitch = [1e3 * p for p in camera.pitch_mm.tolist()]
    if as_json:
        echo_json(
            {
                "schema": "gonio.boards/1",
                "board": str(board),
                "photos": [str(path) for path in paths],
                "theta_max_deg": reach,
                "pitch_um": pitch,
            }
        )
        return
    rows, columns = camera.sensor.shape
    click.echo(
        f"{folder}: {len(paths)} photographs of {columns} x {rows} pixels of "
        f"{pitch[0]:g} x {pitch[1]:g} um ({board}); corners to theta = {reach:.1f} deg."
    )
