"""Photon transfer: figures of a camera from flat and dark frames at several exposures.

The variance of a flat frame grows with its mean, and their ratio is the gain in counts for an
electron, since photo-electrons are Poisson numbers. The mean grows with the exposure; what it
departs from a straight line by is the nonlinearity, c = K e (1 + n log10(e/Q)).

References
----------
EMVA Standard 1288, release 4.0 (2021), sections 2 and 6 to 8.
Janesick 2007, "Photon transfer", SPIE Press, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.frames.flat_faults import check_darks, check_levels, warnings
from gonio.calibration.frames.flat_frames import Frames, Levels, levels, pattern_variance, smooth
from gonio.geometry import FloatArray

_LN10 = float(np.log(10))
_MARGIN = 0.98  # of the range of counts, above which no level is used
_SPREADS = 5.0  # standard deviations by which a level's mean stays below it
_ROUNDS = 20


@dataclass(frozen=True)
class Figure:
    """A measured figure with its standard uncertainty; None is unknown."""

    value: float | None
    u: float | None


@dataclass(frozen=True)
class CameraFigures:
    """What photon transfer finds of a camera, of one pixel of the frames.

    Parameters
    ----------
    figures : dict of str to Figure
        gain_dn_per_e, black_dn, saturation_dn, full_well_e, read_noise_e, dark_e_per_s,
        nonlinearity_per_decade, prnu, dsnu_e_per_s.
    levels : Levels
    used : ndarray of bool, shape (K,)
        Exposures of which no pixel is saturated.
    signal_dn : ndarray, shape (K,)
        Mean counts above black and dark current.
    departure : ndarray, shape (K,)
        Relative departure of the mean from the law of the nonlinearity; NaN where not used.
    lamp_sd : float
        Relative standard deviation of the light from frame to frame, by the pairs.
    dof : int
        Degrees of freedom of the nonlinearity's uncertainty.
    warnings : tuple of str
    """

    figures: dict[str, Figure]
    levels: Levels
    used: NDArray[np.bool_]
    signal_dn: FloatArray
    departure: FloatArray
    lamp_sd: float
    dof: int
    warnings: tuple[str, ...] = field(default=())


def photon_transfer(frames: Frames, exposures_s: tuple[float, ...], takes: int) -> CameraFigures:
    """Figures of a camera from flat and dark frames.

    Parameters
    ----------
    frames : callable
        Called with "flat" or "dark", number of the exposure and of the take.
    exposures_s : tuple of float
        Growing, the same for flats and darks.
    takes : int
        Frames of a kind at an exposure, 2 or more.

    Raises
    ------
    DataError
        If the frames cannot give the figures: too few exposures below saturation, a black level
        that is cut off, counts that do not grow in proportion, copied frames.
    """
    found, good = levels(frames, exposures_s, takes)
    check_darks(found)
    black, dark_slope = _dark_line(found)
    dark = black[0] + dark_slope[0] * found.time_s
    signal = found.flat.mean(axis=1) - dark
    end, by_converter = _saturation(found, signal)
    limit = found.top if end is None else end
    used = found.flat.mean(axis=1) + _SPREADS * found.spread < (
        black[0] + _MARGIN * (limit - black[0]) if end is not None else np.inf
    )
    check_levels(found, signal, used)
    span = (limit - black[0]) if end is not None else float(signal[used].max())
    bend, departure, lamp_sd = _nonlinearity(found, dark, used, span)
    gain = _gain(found, signal, used, span, bend)
    noise = _read_noise(found, gain, dark_slope)
    relative = gain[1] / gain[0]
    # Dark current is far below the full well, where the nonlinearity is largest.
    at_dark = max(dark_slope[0] * float(found.time_s[-1]), gain[0])
    dark_gain = gain[0] * float(_law(bend[0], np.array([at_dark]), span)[0])
    prnu, dsnu = _patterns(frames, found, used, good, dark_gain)
    figures = {
        "gain_dn_per_e": Figure(*gain),
        "black_dn": Figure(*black),
        "saturation_dn": Figure(None, None) if end is None else Figure(float(found.top), 0.0),
        "full_well_e": Figure(None, None) if end is None else Figure(
            span / gain[0], span / gain[0] * relative
        ),
        "read_noise_e": Figure(*noise),
        "dark_e_per_s": Figure(
            max(dark_slope[0], 0.0) / dark_gain,
            float(np.hypot(dark_slope[1], dark_slope[0] * relative)) / dark_gain,
        ),
        "nonlinearity_per_decade": Figure(*bend),
        "prnu": Figure(*prnu),
        "dsnu_e_per_s": Figure(*dsnu),
    }  # fmt: skip
    told = warnings(signal[used], lamp_sd, saturated=end is not None, by_converter=by_converter)
    return CameraFigures(
        figures, found, used, signal, departure, lamp_sd, int(used.sum()) - 2, told
    )


Pair = tuple[float, float]


def _dark_line(found: Levels) -> tuple[Pair, Pair]:
    """Black level and its growth in counts a second, by a straight line through the darks."""
    takes = found.dark.shape[1]
    y = found.dark.mean(axis=1)
    u = np.sqrt(np.maximum(found.dark_variance, 1 / 12) / (found.n_pixels * takes))
    design = np.stack([np.ones_like(y), found.time_s], axis=1) / u[:, None]
    covariance = np.linalg.inv(design.T @ design)
    line = covariance @ design.T @ (y / u)
    chi2 = float(np.sum((y / u - design @ line) ** 2))
    scale = max(chi2 / max(len(y) - 2, 1), 1.0) ** 0.5
    sd = scale * np.sqrt(np.diag(covariance))
    return (float(line[0]), float(sd[0])), (float(line[1]), float(sd[1]))


def _saturation(found: Levels, signal: FloatArray) -> tuple[float | None, bool]:
    """Count at which the frames saturate, and whether the converter ends there; None if none do."""
    if found.top_share[-1] > 0.5:
        return float(found.top), True
    growth = np.diff(np.log(np.maximum(signal[-2:], 1e-9)))[0]
    if growth < 0.5 * np.diff(np.log(found.time_s[-2:]))[0]:
        return float(found.flat[-1].mean()), False
    return None, False


def _nonlinearity(
    found: Levels, dark: FloatArray, used: NDArray[np.bool_], span: float
) -> tuple[Pair, FloatArray, float]:
    """n with its uncertainty, the levels' departures from the law, and the lamp's scatter.

    The light scatters from level to level by more than photon noise: by a variance that makes
    chi-squared the number of degrees of freedom (Paule and Mandel 1982).
    """
    counts = found.flat[used] - dark[used, None]
    rate = np.log(counts / found.time_s[used, None])
    lamp_sd = float(np.sqrt(np.mean(np.var(rate, axis=1, ddof=1))))
    mean = counts.mean(axis=1)
    takes, n = counts.shape[1], 0.0
    y = np.log(mean / found.time_s[used])
    photons = found.flat_variance[used] / (found.n_pixels * takes * mean**2)
    excess, u, rest = 0.0, 0.0, y
    for _ in range(_ROUNDS):
        decades = np.log10(mean / _law(n, mean, span) / span)
        slope = decades / (1 + n * decades)
        w = 1 / (photons + excess)
        x, z = slope - np.average(slope, weights=w), y - np.log1p(n * decades)
        step = float(np.sum(w * x * z) / np.sum(w * x**2))
        n, u = n + step, float(np.sum(w * x**2) ** -0.5)
        rest = z - np.average(z, weights=w) - step * x
        excess = _excess(rest, photons)
    departure = np.full(len(used), np.nan)
    departure[used] = rest
    return (n, u), departure, lamp_sd


def _law(n: float, counts: FloatArray, span: float) -> FloatArray:
    """1 + n log10(e/Q) of counts above black."""
    law = np.ones_like(counts)
    for _ in range(6):
        law = 1 + n * np.log10(counts / law / span)
    return law


def _excess(rest: FloatArray, own: FloatArray) -> float:
    """Variance that added to `own` makes chi-squared the number of degrees of freedom."""
    dof = len(rest) - 2
    low, high = 0.0, float(np.sum(rest**2)) + 1e-12
    if np.sum(rest**2 / own) <= dof:
        return 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if np.sum(rest**2 / (own + middle)) > dof else (low, middle)
    return high


def _gain(
    found: Levels, signal: FloatArray, used: NDArray[np.bool_], span: float, bend: Pair
) -> Pair:
    """Counts for an electron: variance over mean, less the nonlinearity's part in both."""
    x, total = signal[used], found.flat_variance[used]
    y = total - found.dark_variance[used]
    u = found.of_variance * np.hypot(total, found.dark_variance[used]) / x

    def mean(n: float) -> tuple[float, float]:
        law = _law(n, x, span)
        ratio = y / x * law / (law + n / _LN10) ** 2
        w = u**-2
        average = float(np.average(ratio, weights=w))
        chi2 = float(np.sum(w * (ratio - average) ** 2))
        return average, float((max(chi2 / (len(x) - 1), 1.0) / np.sum(w)) ** 0.5)

    gain, own = mean(bend[0])
    return gain, float(np.hypot(own, mean(bend[0] + bend[1])[0] - gain))


def _read_noise(found: Levels, gain: Pair, slope: Pair) -> Pair:
    """Read noise in electrons: dark variance less that of the dark current and of rounding."""
    variance = found.dark_variance - gain[0] * slope[0] * found.time_s
    w = np.maximum(found.dark_variance, 1e-3) ** -2.0
    mean = float(np.average(variance, weights=w)) - 1 / 12
    u = found.of_variance * float(np.sum(w) ** -0.5)
    noise = max(mean, 0.0) ** 0.5
    u_noise = u / (2 * noise) if noise**2 > u else u**0.5
    return noise / gain[0], float(np.hypot(u_noise, noise * gain[1] / gain[0])) / gain[0]


def _patterns(
    frames: Frames, found: Levels, used: NDArray[np.bool_], good: NDArray[np.bool_], gain: float
) -> tuple[Pair, Pair]:
    """PRNU, relative, and DSNU, e-/s: standard deviations from pixel to pixel."""
    sums: list[FloatArray] = []
    for take in (0, 1):
        total: FloatArray = np.zeros(good.shape)
        for k in np.flatnonzero(used).tolist():
            total = total + frames("flat", k, take) - frames("dark", k, take)
        sums.append(total / smooth(total, good))
    prnu = _root(*pattern_variance(sums[0], sums[1], good))
    last = len(found.time_s) - 1
    darks: list[FloatArray] = [
        np.asarray(frames("dark", last, j).astype(float) - frames("dark", 0, j)) for j in (0, 1)
    ]
    growth = [image - smooth(image, good) for image in darks]
    per_s = gain * float(found.time_s[-1] - found.time_s[0])
    dsnu, u = _root(*pattern_variance(growth[0], growth[1], good))
    return prnu, (dsnu / per_s, u / per_s)


def _root(variance: float, u: float) -> Pair:
    root = max(variance, 0.0) ** 0.5
    return root, u / (2 * root) if root**2 > u else u**0.5
