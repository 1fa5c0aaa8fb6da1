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
    """Photographs of a board, with the information that `gonio.calibrate_lens` needs.

    Parameters
    ----------
    paths : list of Path
        The photographs.
    board : Board
    camera : BoardCamera
        Its ``pitch_mm`` is the pixel pitch of the photographs.
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

    The photographs show the board in the middle of the field, half-way and at the rim. The true
    poses are written to the folder ``truth`` next to them.

    Parameters
    ----------
    output : path
        New folder for the photographs.
    board : Board, optional
        Default: a charuco board of 12 x 9 squares of 20 mm.
    instrument : Instrument or str
        The instrument whose camera takes the photographs: a preset, a TOML file, or an object.
    camera : BoardCamera, optional
        The camera to use instead of that of the instrument.
    count : int
        Number of photographs.
    seed : int
        Seed of the random numbers: poses of the board and noise.
    bits : {8, 16}
        Bits per pixel of the PNG files.
    threads : int, optional
        Number of worker threads; the photographs do not depend on it.
    progress : callable, optional
        Called with (photographs done, total number of photographs).

    Returns
    -------
    BoardPhotos

    Raises
    ------
    ConfigurationError
        For an unknown instrument, fewer than one photograph, or a folder that is not empty.
    DataError
        If a file cannot be written.

    Examples
    --------
    >>> import gonio, tempfile
    >>> instrument = gonio.instrument.preset("ideal12").with_pixels(104)
    >>> photos = boards(tempfile.mkdtemp() + "/photos", instrument=instrument, count=1)
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
