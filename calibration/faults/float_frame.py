"""Frames of floating-point numbers that other programs wrote: what in them is no count."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.faults.base import Finding


def of_float_frame(frame: NDArray[Any], name: str) -> tuple[Finding, ...]:
    """What a frame of floating-point numbers holds that is no count.

    Parameters
    ----------
    frame : ndarray
        As another program wrote it.
    name : str
        What to call it.

    Examples
    --------
    >>> [finding.text for finding in of_float_frame(np.array([[1.0, np.nan]]), "dark.tif")]
    ['dark.tif: 1 of 2 pixels are NaN or infinite; take the frame again or mask them.']
    """
    bad = int(np.count_nonzero(~np.isfinite(frame)))
    if bad:
        text = f"{name}: {bad} of {frame.size} pixels are NaN or infinite; take the frame again or "
        return (Finding("not_finite", "error", text + "mask them."),)
    below = int(np.count_nonzero(frame < -0.5))
    if below:
        text = f"{name}: {below} of {frame.size} pixels are below 0; give raw counts, not frames "
        return (Finding("not_raw", "error", text + "from which something was subtracted."),)
    broken = int(np.count_nonzero(frame != np.rint(frame)))
    if broken:
        text = f"{name}: {broken} of {frame.size} pixels are not whole counts; give raw frames, "
        return (Finding("not_raw", "error", text + "not processed ones."),)
    return ()
