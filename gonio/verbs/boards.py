"""Photographs of a calibration board by a virtual camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gonio.board import Board
from gonio.instrument import Instrument, load
from gonio.instrument.board_camera import BoardCamera
from gonio.instrument.board_files import save_photos
from gonio.progress import Progress


@dataclass(frozen=True)
class BoardPhotos:
    """Photographs of a board, with what `gonio.calibrate_lens` has to be told of them.

    Parameters
    ----------
    paths : list of Path
        The photographs.
    board : Board
    camera : BoardCamera
        Its ``pitch_mm`` is that of the photographs' pixels.
    """

    paths: list[Path]
    board: Board
    camera: BoardCamera


def boards(
    output: str | Path,
    *,
    board: Board | None = None,
    instrument: Instrument | str = "modern12",
    camera: BoardCamera | None = None,
    count: int = 25,
    seed: int = 0,
    bits: Literal[8, 16] = 8,
    threads: int | None = None,
    progress: Progress | None = None,
) -> BoardPhotos:
    """Photograph a calibration board with a virtual camera.

    The board is shown in the middle of the field, half-way and at the rim. What the photographs
    show is written to the folder ``truth`` beside them.

    Parameters
    ----------
    output : path
        New folder for the photographs.
    board : Board, optional
        A charuco board of 12 x 9 squares of 20 mm where not given.
    instrument : Instrument or str
        Whose camera takes the photographs: a preset, a TOML file, or an instrument.
    camera : BoardCamera, optional
        The camera, in place of the instrument's own.
    count : int
        Number of photographs.
    seed : int
        Poses of the board and noise follow from it.
    bits : {8, 16}
        Of the PNG files.
    threads : int, optional
        Number of worker threads; the photographs do not depend on it.
    progress : callable, optional
        Called with (photographs done, photographs in all).

    Returns
    -------
    BoardPhotos

    Raises
    ------
    ConfigurationError
        For an unknown instrument, fewer than one photograph, or a folder that holds something.
    DataError
        If a file cannot be written.

    Examples
    --------
    >>> import gonio, tempfile
    >>> rig = gonio.instrument.preset("ideal12").with_pixels(104)
    >>> photos = boards(tempfile.mkdtemp() + "/photos", instrument=rig, count=1)
    >>> [path.name for path in photos.paths]
    ['photo_00.png']
    """
    shown = board or Board("charuco", 12, 9, 20.0)
    if camera is None:
        camera = BoardCamera.of(load(instrument) if isinstance(instrument, str) else instrument)
    paths = save_photos(
        Path(output), shown, camera, n=count, seed=seed, bits=bits, threads=threads,
        progress=progress,
    )  # fmt: skip
    return BoardPhotos(paths, shown, camera)
