"""Statistics of every image, computed when it is read. `faults` judges a session by them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from gonio.calibration.frames.exposure import Rate, response_tables
from gonio.geometry import FloatArray, unit_vectors
from gonio.metadata import Metadata

GRID = 64  # blocks along the longer side of a frame, about
CLEAR = 6  # pixels beyond the image circle that still count as lit
MANY = 4000  # pixels that are enough for a statistic of a frame
BRIGHT = (0.1, 0.85)  # of the range of counts, between which exposures are compared
ZEROS = 0.01  # share of counts at 0 from which on they are cut off
FEWEST = 30  # pixels that an average takes at least
BEYOND = 1.3  # times the largest count that a frame before predicts where counts are cut off

ValueWithError = tuple[float, float]  # value and its standard error


@dataclass(frozen=True)
class Regions:
    """Regions of a frame: pixels that see the dome, pixels in the dark, and a coarse grid.

    Parameters
    ----------
    inside, dark : ndarray of bool, shape (rows, columns)
        Pixels of the usable hemisphere; pixels well outside the image circle.
    block : int
        Side of a block of the coarse grid, pixels.
    cover : ndarray
        Share of each block that lies inside.
    w_r : ndarray, shape (..., 3)
        Directions that the blocks see; 0 if they do not see the dome.
    some_inside, some_dark, some : ndarray of int64
        Flat indices of some pixels inside, in the dark, and anywhere: enough for a statistic.
    """

    inside: NDArray[np.bool_]
    dark: NDArray[np.bool_]
    block: int
    cover: FloatArray
    w_r: FloatArray
    some_inside: NDArray[np.int64]
    some_dark: NDArray[np.int64]
    some: NDArray[np.int64]

    @classmethod
    def of(cls, theta_r: FloatArray, phi_r: FloatArray, usable_theta_r: float) -> Regions:
        """Regions of a frame whose pixels look at (theta_r, phi_r), NaN outside the circle."""
        circle = np.isfinite(theta_r)
        inside = circle & (np.where(circle, theta_r, np.pi) <= usable_theta_r)
        block = -(-max(theta_r.shape) // GRID)
        w = np.where(circle[..., None], unit_vectors(np.nan_to_num(theta_r), phi_r), 0.0)
        w_r = np.stack([coarse(np.nan_to_num(part), block) for part in np.moveaxis(w, -1, 0)], -1)
        dark = ~binary_dilation(circle, iterations=CLEAR)
        length = np.linalg.norm(w_r, axis=-1, keepdims=True)
        return cls(
            inside=inside,
            dark=dark,
            block=block,
            cover=coarse(inside.astype(float), block),
            w_r=w_r / np.where(length > 0, length, 1.0),
            some_inside=_some(np.flatnonzero(inside), MANY),
            some_dark=_some(np.flatnonzero(dark), MANY),
            some=_some(np.arange(theta_r.size), MANY // 4),
        )


@dataclass(frozen=True)
class ImageStatistics:
    """Statistics of one image, a bracket of exposures.

    Parameters
    ----------
    rate, sd : ndarray
        Coarse image and its noise, e-/s; NaN where no pixel of a block could be used.
    saturated : float
        Share of the pixels of the usable hemisphere that no exposure holds.
    dark_dn : tuple of (float, float) or None
        Level well outside the image circle in each exposure, with its standard error.
    zeros : tuple of float
        Share of counts at 0 in each exposure, usable hemisphere.
    growth : tuple of (float, float) or None
        Linear signal of each exposure but the first over that of the one before.
    cut_off_dn : int or None
        Largest count of an exposure whose pixels should reach further by the one before it.
    step : int
        Greatest common divisor of the differences of counts.
    prints : tuple of int or None
        Fingerprint of each exposure; None for a frame that hardly has two different counts.
    """

    rate: FloatArray
    sd: FloatArray
    saturated: float
    dark_dn: tuple[ValueWithError | None, ...]
    zeros: tuple[float, ...]
    growth: tuple[ValueWithError | None, ...]
    cut_off_dn: int | None
    step: int
    prints: tuple[int | None, ...]


def middle(values: FloatArray) -> float:
    """Median of the finite values; NaN if there are none.

    Examples
    --------
    >>> middle(np.array([1.0, np.nan, 3.0])), middle(np.array([np.nan]))
    (2.0, nan)
    """
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def coarse(image: FloatArray, block: int) -> FloatArray:
    """Means over blocks of pixels; those at the lower and right edge may be smaller.

    Examples
    --------
    >>> coarse(np.arange(6.0).reshape(2, 3), 2).tolist()
    [[2.0, 3.5]]
    """
    rows, columns = (np.arange(0, n, block) for n in image.shape)
    total = np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1)
    height, width = (
        np.diff(np.append(at, n)) for at, n in zip((rows, columns), image.shape, strict=True)
    )
    return np.asarray(total / np.outer(height, width))


def image_statistics(
    bracket: NDArray[np.uint16], rate: Rate, metadata: Metadata, regions: Regions
) -> ImageStatistics:
    """Statistics of one image.

    Parameters
    ----------
    bracket : ndarray of uint16, shape (exposures, rows, columns)
    rate : Rate
        The merged image.
    metadata : Metadata
    regions : Regions
    """
    image, sd = _coarse_rate(rate, regions.block)
    flat = bracket.reshape(len(bracket), -1)
    counts = flat[:, regions.some_inside]
    levels = tuple(_level(frame) for frame in flat[:, regions.some_dark])
    growth, cut_off = _growth(counts, levels, metadata)
    few = flat[:, regions.some]
    return ImageStatistics(
        rate=image,
        sd=sd,
        saturated=float(np.mean(rate.saturated[regions.inside])) if regions.inside.any() else 0.0,
        dark_dn=levels,
        zeros=tuple(float(share) for share in np.mean(counts == 0, axis=1)),
        growth=growth,
        cut_off_dn=cut_off,
        step=_step(few),
        prints=tuple(_print(frame) for frame in few),
    )


def _some(index: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most `most` of the pixels, spread over all."""
    # An odd stride does not stay in the same columns.
    return index[:: max(len(index) // most, 1) | 1]


def _coarse_rate(rate: Rate, block: int) -> tuple[FloatArray, FloatArray]:
    used = (rate.time > 0) & ~rate.saturated
    share = coarse(used.astype(float), block)
    some = np.where(share > 0, share, np.nan)
    variance = np.where(used, rate.variance(rate.value), 0.0)
    # The sum of n variances over n^2, from their mean over a block of b pixels of which n count.
    n = some * block**2
    mean = coarse(np.where(used, rate.value, 0.0), block) / some
    return mean, np.sqrt(coarse(variance, block) / some / n)


def _level(counts: NDArray[np.uint16]) -> ValueWithError | None:
    """Mean and its error without outliers such as hot pixels; None if there are too few counts."""
    if len(counts) < FEWEST:
        return None
    x = counts.astype(float)
    middle = np.median(x)
    width = max(5 * 1.48 * float(np.median(np.abs(x - middle))), 3.0)
    x = x[np.abs(x - middle) <= width]
    return float(x.mean()), float(max(x.std(), 0.3) / np.sqrt(len(x)))


def _growth(
    counts: NDArray[np.uint16], levels: tuple[ValueWithError | None, ...], metadata: Metadata
) -> tuple[tuple[ValueWithError | None, ...], int | None]:
    """Growth from exposure to exposure, and the count at which one is cut off too early.

    A straight response is counted from the dark corners, where there are any: a dark level that
    drifts is another fault.
    """
    camera, times = metadata.camera, metadata.plan.exposures_s
    well_dn = camera.black_dn + camera.gain_dn_per_e * camera.full_well_e
    range_dn = min(float(camera.saturation_dn), well_dn) - camera.black_dn
    if camera.gamma == 1:
        dark = [camera.black_dn if level is None else level[0] for level in levels]
        linear = (counts - np.array(dark)[:, None]) / camera.gain_dn_per_e
    else:
        linear = response_tables(camera)[0][counts]
    growth: list[ValueWithError | None] = []
    cut_off = None
    for k in range(1, len(counts)):
        share = (counts[k] - camera.black_dn) / range_dn
        between = (share > BRIGHT[0]) & (share < BRIGHT[1])
        growth.append(_ratio(linear[k - 1][between], linear[k][between], metadata))
        largest = int(counts[k].max(initial=0))
        # Pixels that should reach further than any does, and all stop at one count.
        predicted = linear[k - 1] * times[k] / times[k - 1]
        clear = linear[k - 1] > 5 * camera.noise_dn / camera.gain_dn_per_e
        further = clear & (predicted > BEYOND * linear[k].max(initial=0.0))
        stopped = further & (counts[k] == largest)
        if largest < 0.97 * (camera.black_dn + range_dn) and stopped.sum() >= FEWEST:
            cut_off = largest if stopped.sum() > 0.9 * further.sum() else cut_off
    return tuple(growth), cut_off


def _ratio(before: FloatArray, now: FloatArray, metadata: Metadata) -> ValueWithError | None:
    """Sum of one exposure's electrons over that of the one before, with its error."""
    if len(now) < FEWEST or before.sum() <= 0:
        return None
    camera = metadata.camera
    read_e = np.sqrt(camera.noise_dn**2 + 1 / 12) / camera.gain_dn_per_e
    error = np.sqrt(np.abs(before).sum() + len(now) * read_e**2) / before.sum()
    ratio = float(now.sum() / before.sum())
    return ratio, float(ratio * error)


def _step(frames: NDArray[np.uint16]) -> int:
    values = np.unique(frames).astype(np.int64)
    return int(np.gcd.reduce(np.diff(values))) if len(values) > 4 else 1


def _print(frame: NDArray[np.uint16]) -> int | None:
    if len(np.unique(frame)) <= 4:
        return None
    return zlib.crc32(np.ascontiguousarray(frame).tobytes())
