"""What a nonlinearity that is left in the counts does to f.

Counts above black are times 1 + n log10(e/Q), with e the electrons of an exposure, Q the full well
and n the nonlinearity per decade. A merged rate is the sum of its exposures: it is off by the mean
of log10(e/Q) over them, each weighted by its electrons, which are in proportion to its time.
"""

from __future__ import annotations

import numpy as np

from gonio.calibration.frames.exposure import Rate
from gonio.calibration.frames.standard import Reference
from gonio.geometry import FloatArray
from gonio.metadata import Metadata


def excess(rate: Rate, metadata: Metadata) -> FloatArray:
    """Change of a merged rate by a nonlinearity of 1 per decade, e-/s, shape (rows, columns).

    Notes
    -----
    The total time of a pixel tells which exposures it used, the shortest ones. For an average of
    takes that used different ones this is an interpolation.
    """
    times = np.array(metadata.plan.exposures_s)
    total = np.cumsum(times)
    mean_log_time = np.cumsum(times * np.log10(times)) / total
    # An average of takes has the sum of their times.
    takes = max(round(float(rate.time.max(initial=0.0) / total[-1])), 1)
    shown = np.interp(rate.time / takes, total, mean_log_time)
    electrons = np.maximum(np.abs(rate.value) * 10**shown, 1.0)
    return np.asarray(rate.value * np.log10(electrons / metadata.camera.full_well_e))


def change_of_f(
    f: FloatArray, measured: Rate, reference: Reference, metadata: Metadata
) -> FloatArray:
    """Change of f by a nonlinearity of 1 per decade, sr^-1, shape (rows, columns).

    Eq. (2) has four images, each off by its own `excess`: f = (M - B)/(S - B_0) f_std.
    """
    sample = excess(measured, metadata) - excess(reference.background, metadata)
    standard, own_background = (excess(rate, metadata) for rate in reference.signal)
    share = f / reference.f_standard
    return np.asarray(reference.f_per_rate * (sample - share * (standard - own_background)))
