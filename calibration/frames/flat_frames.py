"""Flat and dark frames at several exposures: what photon transfer needs to know of them.

Two frames at one exposure differ by their noise alone: half the variance of their difference is
the variance in time, however uneven light and pixels are. Two frames of one fixed pattern have it
in common: their covariance over the pixels is the variance of the pattern, without the noise.

References
----------
EMVA Standard 1288, "Standard for characterization of image sensors and cameras", release 4.0
(2021), sections 6 to 8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from gonio.errors import DataError
from gonio.geometry import FloatArray

# Called with a role, the number of an exposure and that of a take, both from 0 on.
Frames = Callable[[Literal["flat", "dark"], int, int], NDArray[np.uint16]]

BLIND, HOT = 0.2, 10.0  # share of the usual signal, deviations from the usual dark count
_WINDOW = 5  # pixels; unevenness of light over more than this is not a pattern of the pixels
_PATTERN = 1 + 1 / (_WINDOW**2 - 1)  # variance of a pattern less the mean of its neighbours


@dataclass(frozen=True)
class Levels:
    """Statistics of flat and dark frames, one row for each exposure.

    Parameters
    ----------
    time_s : ndarray, shape (K,)
    flat, dark : ndarray, shape (K, takes)
        Mean counts of every frame.
    flat_variance, dark_variance : ndarray, shape (K,)
        Variance in time of a pixel, counts^2.
    spread : ndarray, shape (K,)
        Standard deviation of a flat frame's counts over the pixels.
    top_share : ndarray, shape (K,)
        Share of a flat frame's pixels at the largest count of all frames.
    top : int
        That count.
    zero_share : float
        Share of the dark frames' pixels that hold 0.
    n_pixels, n_pairs, n_bad : int
        Pixels used, pairs of frames at an exposure, and pixels left out as blind or hot.
    """

    time_s: FloatArray
    flat: FloatArray
    dark: FloatArray
    flat_variance: FloatArray
    dark_variance: FloatArray
    spread: FloatArray
    top_share: FloatArray
    top: int
    zero_share: float
    n_pixels: int
    n_pairs: int
    n_bad: int

    @property
    def of_variance(self) -> float:
        """Relative standard uncertainty of a variance in time."""
        return float(np.sqrt(2 / (self.n_pixels * self.n_pairs)))


def levels(
    frames: Frames, exposures_s: tuple[float, ...], takes: int
) -> tuple[Levels, NDArray[np.bool_]]:
    """Statistics of the frames, and a mask of pixels that are neither blind nor hot.

    Parameters
    ----------
    frames : callable
    exposures_s : tuple of float
        Growing.
    takes : int
        Frames of a kind at an exposure, 2 or more.

    Raises
    ------
    DataError
        If two takes are the same file.
    """
    number = len(exposures_s)
    good = _good(frames, number, takes)
    rows: list[tuple[FloatArray, FloatArray, float, float, float]] = []
    zeros = 0.0
    top = max(int(frames("flat", k, 0)[good].max()) for k in range(number))
    shares = []
    for k, time in enumerate(exposures_s):
        flat = np.stack([frames("flat", k, j)[good] for j in range(takes)]).astype(float)
        dark = np.stack([frames("dark", k, j)[good] for j in range(takes)]).astype(float)
        for words, stack in (("flat", flat), ("dark", dark)):
            # Frames that are saturated all over, or cut off at 0, are alike and no copies.
            same = bool((stack[0] == stack[1]).all())
            if same and stack.max() > 0 and stack.min() < top:
                raise DataError(
                    f"the first two {words} frames of {1e3 * time:g} ms are the same in every "
                    "pixel: one was copied. Noise is measured by two frames; take another.",
                    value=time,
                )
        zeros = max(zeros, float((dark == 0).mean()))
        shares.append(float((flat >= top).mean()))
        rows.append((
            flat.mean(axis=1), dark.mean(axis=1), in_time(flat), in_time(dark),
            float(flat[0].std()),
        ))  # fmt: skip
    flats, darks, of_flat, of_dark, spread = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    made = Levels(
        np.array(exposures_s), flats, darks, of_flat, of_dark, spread, np.array(shares), top, zeros,
        int(good.sum()), takes // 2, int((~good).sum()),
    )  # fmt: skip
    return made, good


def in_time(stack: FloatArray) -> float:
    """Variance in time from the differences of pairs of frames (takes, pixels)."""
    pairs = len(stack) // 2
    return float(np.mean([np.var(stack[2 * j] - stack[2 * j + 1]) / 2 for j in range(pairs)]))


def _good(frames: Frames, number: int, takes: int) -> NDArray[np.bool_]:
    dark = np.mean([frames("dark", number - 1, j) for j in range(takes)], axis=0)
    flat = np.mean([frames("flat", number - 1, j) for j in range(takes)], axis=0) - dark
    usual = float(np.median(dark))
    sd = max(1.4826 * float(np.median(np.abs(dark - usual))), 0.5)
    return np.asarray((dark < usual + HOT * sd) & (flat > BLIND * np.median(flat)))


def pattern_variance(
    one: FloatArray, two: FloatArray, good: NDArray[np.bool_]
) -> tuple[float, float]:
    """Variance of a pattern that two images with independent noise have in common.

    Parameters
    ----------
    one, two : ndarray, shape (rows, columns)
        Less, or over, the `smooth` mean of their neighbours.
    good : ndarray of bool
        Pixels that are used.

    Returns
    -------
    variance, u : float
        And its standard uncertainty, that of a finite number of pixels included.
    """
    a, b = (image[good] - image[good].mean() for image in (one, two))
    common = float(np.mean(a * b)) / _PATTERN
    alone = float(np.var(a) * np.var(b)) / _PATTERN**2
    return common, float(np.sqrt((common**2 + alone) / good.sum()))


def smooth(image: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
    """Mean of the pixels around each, without the pixel itself and bad ones' counts."""
    filled = np.where(good, image, np.median(image[good]))
    n = _WINDOW**2
    mean = uniform_filter(filled, size=_WINDOW, mode="reflect")
    return np.asarray((n * mean - filled) / (n - 1))
