"""Size and kind of a picture from its header, before anything is decoded.

A header tells a picture that would fill the memory, or that is no raw frame, at the cost of some
hundred bytes. OpenCV has no such function, and it would turn palettes, packed bits and alpha
channels silently into something else.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from gonio.errors import DataError
from gonio.session import MAX_FRAME_PIXELS

KINDS = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF", ".exr": "EXR"}
_LARGEST_TABLE = 4096  # entries of a TIFF directory, bytes of an EXR attribute that is read
_SLACK_BYTES = 1 << 24  # metadata that a file may hold beside its pixels


@dataclass(frozen=True)
class Header:
    """What a picture's header says.

    Parameters
    ----------
    kind : str
        "PNG", "TIFF" or "EXR", or "raw" of a camera.
    rows, columns : int
    bits : int
        Of a pixel's number: 8, 16, 32 or 64.
    is_float : bool
    """

    kind: str
    rows: int
    columns: int
    bits: int
    is_float: bool = False

    @property
    def depth(self) -> str:
        """Kind of numbers, for a sentence."""
        return f"{self.bits}-bit {'float' if self.is_float else 'integer'}"


def read_header(path: Path, name: str) -> Header:
    """Header of a PNG, TIFF or EXR file that holds one grey picture.

    Parameters
    ----------
    path : Path
        An existing file.
    name : str
        What to call it in messages.

    Raises
    ------
    DataError
        If the file is not what its name says, not grey, not of 8 or 16 bits or float, of too
        many pixels, or holds several pages.
    """
    kind = KINDS[path.suffix.lower()]
    try:
        with path.open("rb") as file:
            header = {"PNG": _png, "TIFF": _tiff, "EXR": _exr}[kind](file, name)
    except (struct.error, ValueError, IndexError):
        raise DataError(
            f"{name}: the {kind} header cannot be understood; the file is truncated or damaged.",
            value=name,
        ) from None
    except OSError as error:
        raise DataError(f"{name}: cannot be read ({error.strerror}).", value=name) from None
    check_size(header.rows, header.columns, name)
    return header


def check_bytes(path: Path, header: Header, name: str) -> None:
    """Refuse a file that is far larger than its pixels, before it is read."""
    size = path.stat().st_size
    if size > 2 * header.rows * header.columns * header.bits // 8 + _SLACK_BYTES:
        raise DataError(
            f"{name}: the file has {size} bytes, far more than {header.columns} x {header.rows} "
            "pixels need; it is not a frame.",
            value=name,
        )


def check_size(rows: int, columns: int, name: str) -> None:
    """Refuse a frame without pixels or with too many."""
    if rows < 1 or columns < 1 or rows * columns > MAX_FRAME_PIXELS:
        raise DataError(
            f"{name}: {columns} x {rows} pixels; frames of 1 to {MAX_FRAME_PIXELS} pixels are "
            "allowed.",
            value=name,
        )


def _png(file: BinaryIO, name: str) -> Header:
    start = file.read(33)
    if start[:8] != b"\x89PNG\r\n\x1a\n" or start[12:16] != b"IHDR":
        raise _not_of_kind(name, "PNG", start)
    columns, rows, bits, colour = struct.unpack(">IIBB", start[16:26])
    if colour == 3:
        raise _not_grey(name, "holds colours of a palette")
    if colour != 0:
        raise _not_grey(name, f"has {({2: 3, 4: 2, 6: 4}).get(colour, 'several')} channels")
    return Header("PNG", rows, columns, _allowed_bits(bits, name))


def _allowed_bits(bits: int, name: str) -> int:
    if bits not in (8, 16):
        raise DataError(
            f"{name}: holds integers of {bits} bits; write frames with 8 or 16 bits a pixel.",
            value=name,
        )
    return bits


def _tiff(file: BinaryIO, name: str) -> Header:
    pages = list(_tiff_pages(file, name))
    # Cameras put reduced copies beside the picture: bit 0 of NewSubfileType.
    whole = [page for page in pages if not page.get(254, 0) & 1]
    if len(whole) != 1:
        raise DataError(f"{name}: holds {len(whole)} pages; write one frame to a file.", value=name)
    (page,) = whole
    if page.get(262) == 32803:
        raise DataError(
            f"{name}: holds the colour mosaic of a raw file; name it .dng, so that it is read as "
            "one, and choose frames.plane.",
            value=name,
        )
    if page.get(277, 1) != 1 or page.get(262, 1) not in (0, 1):
        what = {2: "is an RGB picture", 3: "holds colours of a palette", 6: "is a YCbCr picture"}
        said = what.get(page.get(262, 1), f"has {page.get(277, 1)} channels")
        raise _not_grey(name, said)
    if page.get(262, 1) == 0:
        raise DataError(
            f"{name}: is stored as a negative (white is 0); write counts that grow with the light.",
            value=name,
        )
    if page.get(274, 1) != 1:
        raise DataError(
            f"{name}: is marked as turned or mirrored (TIFF orientation {page[274]}); write the "
            "rows and columns as the sensor has them, with orientation 1.",
            value=name,
        )
    bits, sample_format = page.get(258, 1), page.get(339, 1)
    if sample_format == 3 and bits in (32, 64):
        return Header("TIFF", page[257], page[256], bits, is_float=True)
    if sample_format != 1:
        kind = {2: "signed integers", 3: "floats"}.get(sample_format, "numbers of another kind")
        raise DataError(
            f"{name}: holds {kind} of {bits} bits; write frames as unsigned integers of 8 or 16 "
            "bits or as floats of 32 or 64.",
            value=name,
        )
    return Header("TIFF", page[257], page[256], _allowed_bits(bits, name))


def _tiff_pages(file: BinaryIO, name: str) -> Iterator[dict[int, int]]:
    """First number of each small tag of each page, by tag; BigTIFF too."""
    start = file.read(16)
    order = {b"II": "<", b"MM": ">"}.get(start[:2])
    if order is None or len(start) < 8:
        raise _not_of_kind(name, "TIFF", start)
    version = struct.unpack(order + "H", start[2:4])[0]
    if version not in (42, 43):
        raise _not_of_kind(name, "TIFF", start)
    big = version == 43
    count, entry, offset = ("Q", "HHQ", "Q") if big else ("H", "HHI", "I")
    at = struct.unpack_from(order + offset, start, 8 if big else 4)[0]
    visited: set[int] = set()
    while at:
        if at in visited or len(visited) > 64:
            raise ValueError("pages in a circle")
        visited.add(at)
        file.seek(at)
        (n,) = _unpack(file, order + count)
        if n > _LARGEST_TABLE:
            raise ValueError("too many tags")
        page: dict[int, int] = {}
        for _ in range(n):
            tag, kind, number = _unpack(file, order + entry)
            value = file.read(8 if big else 4)
            form = {1: "B", 3: "H", 4: "I", 16: "Q"}.get(kind)
            size = struct.calcsize(order + form) if form else 0
            if form and number and number * size <= len(value):
                page[tag] = struct.unpack_from(order + form, value)[0]
            elif form and tag == 258 and number:
                # Bits of several channels stand elsewhere; how many channels is said by tag 277.
                page[tag] = 0
        yield page
        (at,) = _unpack(file, order + offset)


def _unpack(file: BinaryIO, form: str) -> tuple[int, ...]:
    return struct.unpack(form, file.read(struct.calcsize(form)))


def _exr(file: BinaryIO, name: str) -> Header:
    start = file.read(8)
    if start[:4] != b"\x76\x2f\x31\x01":
        raise _not_of_kind(name, "EXR", start)
    flags = start[5]
    if flags & 0x10 or flags & 0x08:
        raise DataError(
            f"{name}: holds several parts or deep pixels; write one frame to a file.", value=name
        )
    kind, rows, columns = None, 0, 0
    while attribute := _text(file):
        _text(file)  # the attribute's type
        (size,) = struct.unpack("<I", file.read(4))
        if attribute == b"channels":
            kind = _exr_channel(file.read(_small(size)), name)
        elif attribute == b"dataWindow":
            x0, y0, x1, y1 = struct.unpack("<4i", file.read(_small(size)))
            rows, columns = y1 - y0 + 1, x1 - x0 + 1
        else:
            file.seek(size, 1)
    if kind is None:
        raise ValueError("no channels")
    return Header("EXR", rows, columns, 16 if kind == 1 else 32, is_float=True)


def _exr_channel(content: bytes, name: str) -> int:
    """Kind of the pixels of the one channel: 1 is half, 2 is float."""
    channels = []
    while content[:1] != b"\0":
        label, rest = content.split(b"\0", 1)
        channels.append((label.decode("utf-8", "replace"), struct.unpack_from("<i", rest)[0]))
        content = rest[16:]
    if len(channels) != 1:
        listed = ", ".join(label for label, _ in channels)
        raise _not_grey(name, f"has {len(channels)} channels ({listed})")
    kind = int(channels[0][1])
    if kind not in (1, 2):
        raise DataError(
            f"{name}: holds integers of 32 bits; write EXR frames as half or float.", value=name
        )
    return kind


def _text(file: BinaryIO) -> bytes:
    """Bytes up to the next 0."""
    text = b""
    while (character := file.read(1)) != b"\0":
        text += character
        if not character or len(text) > 255:
            raise ValueError("no end of a name")
    return text


def _small(size: int) -> int:
    if size > _LARGEST_TABLE:
        raise ValueError("too large")
    return size


def _not_of_kind(name: str, kind: str, start: bytes) -> DataError:
    if not start:
        return DataError(f"{name}: the file is empty.", value=name)
    return DataError(f"{name}: is not a {kind} file, whatever its name says.", value=name)


def _not_grey(name: str, said: str) -> DataError:
    return DataError(
        f"{name}: {said} and should be grey, one raw count a pixel: write frames without colour "
        "and alpha, or hand over the camera's raw files.",
        value=name,
    )
