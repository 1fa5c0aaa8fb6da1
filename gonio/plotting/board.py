"""A calibration board to print: SVG in true size, or PNG with its resolution."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.board import Board
from gonio.errors import ConfigurationError
from gonio.files import atomic_path

SUFFIXES = (".svg", ".png")
DPI = 300
_MM_PER_INCH = 25.4
_CAPTION_MM = 4.0


def save_board(board: Board, path: str | Path, *, dpi: int = DPI) -> None:
    """Write a board to print, whole or not at all.

    Parameters
    ----------
    board : Board
        The board to draw.
    path : path
        File to write; its name ends in .svg (exact at any scale) or .png.
    dpi : int
        Dots an inch of the PNG; each square and marker is drawn to the nearest dot.

    Raises
    ------
    ConfigurationError
        For another suffix, or if a cell of a marker is smaller than two dots.
    DataError
        If the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise ConfigurationError(
            f"{path}: a board is written as {' or '.join(SUFFIXES)}; give a name that ends so.",
            value=path,
        )
    data = _svg(board).encode() if path.suffix == ".svg" else _png(board, dpi)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def rectangles(board: Board) -> list[tuple[float, float, float, float]]:
    """Inked rectangles, mm: x, y of a corner, width, height, in the frame of the board.

    Examples
    --------
    >>> rectangles(Board("chessboard", 4, 4, 10.0))[1]
    (20.0, 0.0, 10.0, 10.0)
    """
    content, markers = board.pattern()
    square, side = board.square_mm, board.marker_side
    boxes = []
    for (row, column), marker in np.ndenumerate(content):
        x, y = column * square, row * square
        if marker == -1:
            boxes.append((x, y, square, square))
        elif marker >= 0:
            edge, cell = (square - side) / 2, side / markers.shape[1]
            for j, i, width in _runs(~markers[marker]):
                boxes.append((x + edge + i * cell, y + edge + j * cell, width * cell, cell))
    return boxes


def _runs(ink: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """Row, first column and length of the runs of ink in a marker."""
    runs = []
    for j, row in enumerate(ink):
        steps = np.diff(np.concatenate([[0], row.astype(int), [0]]))
        starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
        runs += [(j, int(a), int(b - a)) for a, b in zip(starts, ends, strict=True)]
    return runs


def _svg(board: Board) -> str:
    width, height = board.size_mm
    margin = board.margin_mm
    size = f"{width + 2 * margin:g}", f"{height + 2 * margin:g}"
    ink = "".join(
        f'<rect x="{x:.6g}" y="{y:.6g}" width="{w:.6g}" height="{h:.6g}"/>\n'
        for x, y, w, h in rectangles(board)
    )
    # Neighbouring rectangles must not show a seam: no smoothing of their edges.
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size[0]}mm" height="{size[1]}mm" '
        f'viewBox="{-margin:g} {-margin:g} {size[0]} {size[1]}">\n'
        f'<rect x="{-margin:g}" y="{-margin:g}" width="{size[0]}" height="{size[1]}" '
        'fill="white"/>\n'
        f'<g fill="black" shape-rendering="crispEdges">\n{ink}</g>\n'
        f'<text x="0" y="{height + margin * 0.75:g}" font-family="sans-serif" '
        f'font-size="{min(_CAPTION_MM, margin / 3):g}">{board}; print at 100 %</text>\n</svg>\n'
    )


def _png(board: Board, dpi: int) -> bytes:
    from PIL import Image

    dots = dpi / _MM_PER_INCH
    _, markers = board.pattern()
    smallest = (board.marker_side / markers.shape[1] if len(markers) else board.square_mm) * dots
    if smallest < 2:
        raise ConfigurationError(
            f"{dpi} dots an inch leave {smallest:.2g} dots for the smallest cell of the {board}; "
            "2 or more are needed.",
            value=dpi,
        )
    margin = board.margin_mm
    width, height = (round((side + 2 * margin) * dots) for side in board.size_mm)
    image = np.full((height, width), 255, np.uint8)
    for x, y, w, h in rectangles(board):
        left, right = (round((margin + v) * dots) for v in (x, x + w))
        top, bottom = (round((margin + v) * dots) for v in (y, y + h))
        image[top:bottom, left:right] = 0
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", dpi=(dpi, dpi))  # so that it prints in true size
    return file.getvalue()
