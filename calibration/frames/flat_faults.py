"""What is wrong with flat and dark frames: errors that stop, and sentences that warn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.frames.flat_frames import Levels
from gonio.errors import DataError
from gonio.geometry import FloatArray

FEWEST = 4  # exposures below saturation
CLIPPED = 1e-3  # share of dark pixels at 0
STRAIGHT = 0.04  # by which the exponent of counts against exposure may depart from 1
STEADY = 0.01  # relative scatter of the light from frame to frame


def check_darks(found: Levels) -> None:
    """Refuse a black level that is cut off at 0.

    Raises
    ------
    DataError
        If more than a thousandth of the pixels of a dark frame hold 0.
    """
    if found.zero_share > CLIPPED:
        raise DataError(
            f"{100 * found.zero_share:.3g} % of the pixels of a dark frame hold 0 counts: the "
            "black level is cut off, and neither it nor the read noise can be measured. Raise the "
            "camera's black level (offset) and take all frames again.",
            value=found.zero_share,
        )


def check_levels(found: Levels, signal: FloatArray, used: NDArray[np.bool_]) -> None:
    """Refuse too few exposures below saturation, and counts that do not follow the light.

    Raises
    ------
    DataError
        If so.
    """
    n, n_used = len(used), int(used.sum())
    if n_used < FEWEST:
        raise DataError(
            f"{n_used} of {n} exposures are below saturation; {FEWEST} are needed, and 10 over two "
            "decades are good. Take shorter exposures as well.",
            value=n_used,
        )
    if np.any(signal[used] <= 0):
        time = float(found.time_s[used][np.argmin(signal[used])])
        raise DataError(
            f"the flat frames of {1e3 * time:g} ms are no brighter than the dark ones; was the "
            "lamp on? Take them again, or leave the exposure out.",
            value=time,
        )
    x, y = np.log(found.time_s[used]), np.log(signal[used])
    power = float(np.polyfit(x, y, 1)[0])
    if abs(power - 1) > STRAIGHT:
        raise DataError(
            f"the counts grow as the exposure to the power of {power:.2f}, and not in proportion: "
            "the frames are gamma-encoded, or the exposures are not what is stated. Write raw "
            "frames without gamma, and check exposures_s.",
            value=power,
        )


def warnings(
    signal: FloatArray, lamp_sd: float, *, saturated: bool, by_converter: bool
) -> tuple[str, ...]:
    """Sentences about frames that give figures, but not all or not good ones.

    Parameters
    ----------
    signal : ndarray
        Mean counts of the exposures in use.
    lamp_sd : float
        Relative scatter of the light.
    saturated, by_converter : bool
        Whether an exposure saturates, and whether the converter ends first.
    """
    lines = []
    if lamp_sd > STEADY:
        lines.append(
            f"the light scatters by {100 * lamp_sd:.2g} % between frames of one exposure; let the "
            "lamp warm up, or the nonlinearity stays uncertain"
        )
    if not saturated:
        lines.append(
            "no exposure saturates: saturation and full well are unknown; add longer exposures"
        )
    elif by_converter:
        lines.append(
            "the converter ends before a pixel is full: full_well_e is the signal at its end"
        )
    if signal.max() < 10 * signal.min():
        lines.append(
            "the exposures span less than a decade of signal: the nonlinearity stays uncertain"
        )
    return tuple(lines)
