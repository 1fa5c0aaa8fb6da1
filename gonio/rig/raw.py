"""Raw files of a camera through LibRaw: one plane of its colour mosaic, counts as they are.

Nothing is subtracted, balanced or interpolated. The second colour filters repeat every 2 x 2
pixels: a plane holds a quarter of the pixels, two sensor pixels apart; `green` is the sum of both
greens of a cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError, DataError, GonioError
from gonio.rig.headers import Header, check_size

# Endings under which cameras write raw files.
RAW_ENDINGS = frozenset((
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq",
    ".kdc", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw",
    ".rw2", ".rwl", ".sr2", ".srf", ".srw",
))  # fmt: skip
Plane = Literal["red", "green", "green1", "green2", "blue", "mono"]
PLANES: tuple[Plane, ...] = get_args(Plane)
_LETTERS: dict[str, str] = {"red": "R", "blue": "B"}


@dataclass(frozen=True)
class RawHeader(Header):
    """What a raw file says of itself.

    Parameters
    ----------
    pattern : str
        Colours of the four filters of a cell, row by row, such as "RGGB"; "" without filters.
    black : tuple of float
        Black level at each position of the cell, counts.
    white : int
        Largest count.
    """

    pattern: str = ""
    black: tuple[float, ...] = (0.0,)
    white: int = 65535

    def positions(self, plane: Plane, name: str) -> tuple[tuple[int, int], ...]:
        """Row and column within the cell of the pixels of a plane.

        Raises
        ------
        ConfigurationError
            If the file has no such plane.
        """
        if plane == "mono" or not self.pattern:
            if bool(self.pattern) or plane != "mono":
                said = f"filters {self.pattern}" if self.pattern else "no colour filters"
                allowed = "red, green, green1, green2 or blue" if self.pattern else "mono"
                raise ConfigurationError(
                    f"{name}: the sensor has {said} and frames.plane is {plane!r}; "
                    f"allowed is {allowed}.",
                    value=plane,
                )
            return ((0, 0),)
        letter = _LETTERS.get(plane, "G")
        positions = tuple(divmod(k, 2) for k, c in enumerate(self.pattern) if c == letter)
        if plane in ("green1", "green2"):
            positions = positions[int(plane[-1]) - 1 :][:1]
        if not positions:
            raise ConfigurationError(
                f"{name}: the colour filters are {self.pattern} and none of them is {plane}.",
                value=plane,
            )
        return positions

    def black_of(self, positions: tuple[tuple[int, int], ...]) -> float:
        """Mean black level of these positions, counts of one pixel."""
        if not self.pattern:
            return self.black[0]
        return float(np.mean([self.black[2 * row + column] for row, column in positions]))


def read_raw_header(path: Path, name: str) -> RawHeader:
    """Size, filters, black level and largest count of a raw file.

    Raises
    ------
    ConfigurationError
        If rawpy is not installed.
    DataError
        If LibRaw cannot read the file, or its pixels are no counts of single filters.
    """
    with _opened(path, name) as raw:
        sizes = raw.sizes
        check_size(sizes.height, sizes.width, name)
        if raw.raw_type.name != "Flat":
            raise DataError(
                f"{name}: its pixels hold several colours each; give a raw file whose pixels are "
                "single counts.",
                value=name,
            )
        levels, white = raw.black_level_per_channel, int(raw.white_level or 65535)
        if raw.num_colors == 1:
            return RawHeader(
                "raw", sizes.height, sizes.width, 16, black=(float(levels[0]),), white=white
            )
        cell = _colour_cell(raw, name)
        return RawHeader(
            "raw",
            sizes.height,
            sizes.width,
            16,
            pattern="".join(chr(raw.color_desc[k]) for k in cell),
            black=tuple(float(levels[k]) for k in cell),
            white=white,
        )


def _colour_cell(raw: Any, name: str) -> list[int]:
    """LibRaw's numbers of the four filters of a cell, row by row."""
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    colours = [raw.raw_color(top + row, left + column) for row in range(6) for column in range(6)]
    if any(colour != colours[6 * (k // 6 % 2) + k % 2] for k, colour in enumerate(colours)):
        raise DataError(
            f"{name}: its colour filters do not repeat every 2 x 2 pixels; such sensors are not "
            "read, write the frames as TIFF.",
            value=name,
        )
    return [colours[k] for k in (0, 1, 6, 7)]


def read_raw(path: Path, name: str) -> NDArray[np.uint16]:
    """All visible pixels of a raw file, counts as the converter wrote them."""
    with _opened(path, name) as raw:
        return np.array(raw.raw_image_visible, dtype=np.uint16)


@contextmanager
def _opened(path: Path, name: str) -> Iterator[Any]:
    try:
        import rawpy
    except ImportError:
        raise ConfigurationError(
            f"{name}: raw files are read by rawpy, which is not installed; run "
            "'python -m pip install rawpy', or write the frames as TIFF.",
            value=name,
        ) from None
    try:
        with rawpy.imread(str(path)) as raw:
            yield raw
    except GonioError:
        raise
    except Exception as error:  # LibRaw's come with any reading, and have no public base
        said = error.args[0] if error.args else error
        text = said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
        raise DataError(f"{name}: LibRaw cannot read it ({text}).", value=name) from None
