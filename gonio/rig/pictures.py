"""From the file of a frame to the counts of a session's frame.

The counts are those of the file. Where the rig's description asks for it they are divided by a
whole number that divides them all, cut to a region, and summed over blocks; floats are scaled to
the counts that they stand for.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.faults.float_frame import of_float_frame
from gonio.calibration.frames.exposure import SATURATED
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import FloatArray
from gonio.metadata import Camera
from gonio.rig.headers import Header
from gonio.rig.raw import RawHeader, read_raw
from gonio.rig.tables import FramesTable
from gonio.session import Frame

# Floats that stand for counts may be off by their own rounding: 65535 in 24 bits.
_ROUNDING = 0.01


@dataclass(frozen=True)
class Sampling:
    """Which pixels of a file make a pixel of the session.

    Parameters
    ----------
    rows, columns : int
        Of the file.
    cell : int
        Distance of a plane's pixels on the sensor: 2 for one colour of a mosaic, else 1.
    positions : tuple of (int, int)
        Row and column in the cell of the pixels that are used; they are summed.
    region : tuple of int
        First column and row, columns and rows that are kept, counted in pixels of the plane.
    binning : int
        Side of the block of the plane's pixels whose counts are summed.
    """

    rows: int
    columns: int
    cell: int
    positions: tuple[tuple[int, int], ...]
    region: tuple[int, int, int, int]
    binning: int

    @classmethod
    def of(cls, header: Header, frames: FramesTable, name: str) -> Sampling:
        """What the description makes of files with this header.

        Raises
        ------
        ConfigurationError
            If the region lies outside the frame or is not made of whole blocks.
        """
        cell = 1
        positions: tuple[tuple[int, int], ...] = ((0, 0),)
        if isinstance(header, RawHeader):
            if frames.plane is None:
                raise ConfigurationError(
                    f"{name}: a raw file has pixels of several colours; say in frames.plane which "
                    "are used: green (the sum of both greens), green1, green2, red or blue, or "
                    "mono for a sensor without filters.",
                    value=name,
                )
            positions = header.positions(frames.plane, name)
            cell = 2 if header.pattern else 1
        elif frames.plane is not None:
            raise ConfigurationError(
                f"frames.plane = {frames.plane!r} is for raw files and {name} is a "
                f"{header.kind} file; leave it out.",
                value=frames.plane,
            )
        if frames.counts_per_unit is None and header.is_float:
            raise ConfigurationError(
                f"{name}: holds floats; say in frames.counts_per_unit how many counts 1.0 stands "
                "for: 1 where they are counts, 65535 where 16 bits were scaled to 0 to 1.",
                value=name,
            )
        if frames.counts_per_unit is not None and not header.is_float:
            raise ConfigurationError(
                f"frames.counts_per_unit is for frames of floats and {name} holds {header.depth} "
                "counts; leave it out.",
                value=frames.counts_per_unit,
            )
        columns, rows = header.columns // cell, header.rows // cell
        region = frames.region_px or (0, 0, columns, rows)
        left, top, width, height = region
        if left + width > columns or top + height > rows:
            raise ConfigurationError(
                f"frames.region_px = {list(region)} (first column, first row, columns, rows) "
                f"reaches beyond the {columns} x {rows} pixels of {name}.",
                value=region,
            )
        n = frames.binning
        if width % n or height % n:
            raise ConfigurationError(
                f"{width} x {height} pixels are not made of whole blocks of {n} x {n}; choose "
                f"{width - width % n} x {height - height % n} of them with frames.region_px.",
                value=region,
            )
        return cls(header.rows, header.columns, cell, positions, region, n)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the session's frames."""
        return self.region[3] // self.binning, self.region[2] // self.binning

    @property
    def n_summed(self) -> int:
        """Pixels of the sensor in a pixel of the session."""
        return len(self.positions) * self.binning**2

    @property
    def step(self) -> int:
        """Distance of the session's pixels in pixels of the file."""
        return self.cell * self.binning

    def moved(self, centre_px: tuple[float, float]) -> tuple[float, float]:
        """Column and row in the session of a point given in pixels of the file.

        Examples
        --------
        The middle between the first four pixels is the first pixel of frames binned 2 x 2:

        >>> Sampling(8, 8, 1, ((0, 0),), (0, 0, 8, 8), 2).moved((0.5, 0.5))
        (0.0, 0.0)
        """
        middle_of_positions = np.mean(self.positions, axis=0)[::-1]
        half = (self.binning - 1) / 2
        x, y = (
            ((c - position) / self.cell - first - half) / self.binning
            for c, position, first in zip(
                centre_px, middle_of_positions, self.region[:2], strict=True
            )
        )
        return float(x), float(y)

    def sampled(self, pixels: NDArray[Any], camera: Camera) -> Frame:
        """The session's frame from all pixels of a file, for the session's camera.

        A block that holds a saturated pixel counts as saturated: its sum would be too small and
        nobody would see it.
        """
        left, top, width, height = self.region
        planes = [pixels[row :: self.cell, column :: self.cell] for row, column in self.positions]
        kept = np.stack([plane[top : top + height, left : left + width] for plane in planes])
        if self.n_summed == 1:
            frame: Frame = kept[0].astype(np.uint16)
            return frame
        n = self.binning
        blocks = kept.reshape(len(kept), height // n, n, width // n, n)
        total = blocks.sum(axis=(0, 2, 4), dtype=np.uint32)
        full = (blocks >= full_count(camera) / self.n_summed).any(axis=(0, 2, 4))
        summed: Frame = np.where(full, camera.saturation_dn, total).astype(np.uint16)
        return summed


def full_count(camera: Camera) -> float:
    """Count from which a pixel is taken for saturated, as the merging of exposures does."""
    well_dn = camera.black_dn + camera.gain_dn_per_e * camera.full_well_e
    top = min(float(camera.saturation_dn), well_dn)
    return camera.black_dn + SATURATED * (top - camera.black_dn)


def read_pixels(
    path: Path, name: str, header: Header, frames: FramesTable, data: bytes
) -> NDArray[Any]:
    """All pixels of a frame's file as whole counts.

    Parameters
    ----------
    path : Path
    name : str
        What to call it.
    header : Header
    frames : FramesTable
    data : bytes
        Content of the file.

    Raises
    ------
    DataError
        If the file is damaged, or what it holds are no raw counts.
    """
    if header.kind == "raw":
        pixels: NDArray[Any] = read_raw(path, name)
    elif header.kind == "EXR":
        pixels = _read_exr(path, name)
    else:
        pixels = _read_by_opencv(data, name)
    expected = (header.rows, header.columns)
    if pixels.shape != expected or (pixels.dtype.kind == "f") != header.is_float:
        raise DataError(
            f"{name}: decodes to {pixels.dtype} of shape {pixels.shape}, and its header says "
            f"{header.depth} of shape {expected}; the file is damaged.",
            value=name,
        )
    if header.is_float:
        pixels = _counts_of_floats(pixels, frames.counts_per_unit or 1.0, name)
    return _divided(pixels, frames.divide_by, name)


@contextmanager
def opencv_silent() -> Iterator[None]:
    """OpenCV's own complaints about a file are left out: gonio says in its words what is wrong."""
    import cv2

    log = cv2.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(level)


def _read_by_opencv(data: bytes, name: str) -> NDArray[Any]:
    import cv2

    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None:
        raise DataError(
            f"{name}: cannot be decoded; the file is truncated or damaged, or in a compression "
            "that is not supported. Copy it again, or take the frame again.",
            value=name,
        )
    return np.asarray(picture)


def _read_exr(path: Path, name: str) -> NDArray[Any]:
    try:
        import OpenEXR
    except ImportError:
        raise ConfigurationError(
            f"{name}: EXR files are read by OpenEXR, which is not installed; run "
            "'python -m pip install OpenEXR', or write the frames as TIFF of 32-bit floats.",
            value=name,
        ) from None
    try:
        (channel,) = OpenEXR.File(str(path), separate_channels=True).channels().values()
        return np.asarray(channel.pixels)
    except Exception as error:  # what its bindings raise differs by fault
        raise DataError(
            f"{name}: cannot be decoded ({str(error).strip() or type(error).__name__}); the file "
            "is truncated or damaged.",
            value=name,
        ) from None


def _counts_of_floats(
    pixels: NDArray[Any], counts_per_unit: float, name: str
) -> NDArray[np.uint16]:
    """Whole counts from floats that stand for counts."""
    with np.errstate(invalid="ignore", over="ignore"):
        counts: FloatArray = pixels.astype(np.float64) * counts_per_unit
        whole = np.rint(counts)
        counts = np.where(np.abs(counts - whole) < _ROUNDING, whole, counts)
    for finding in of_float_frame(counts, name):
        raise DataError(finding.text, value=name)
    if counts.max() > 65535:
        raise DataError(
            f"{name}: counts reach {counts.max():.6g} with frames.counts_per_unit = "
            f"{counts_per_unit:g}, and a frame holds 65535 at most.",
            value=name,
        )
    return np.maximum(counts, 0).astype(np.uint16)


def _divided(pixels: NDArray[Any], divisor: int, name: str) -> NDArray[Any]:
    """Counts over what all of them are multiples of."""
    if divisor == 1:
        return pixels
    odd = int(np.count_nonzero(pixels % divisor))
    if odd:
        raise DataError(
            f"{name}: {odd} of {pixels.size} counts are no multiples of frames.divide_by = "
            f"{divisor}; dividing them would round them off.",
            value=name,
        )
    return np.asarray(pixels // divisor)
