"""Whether enough samples carry a parameter for its uncertainty to mean anything."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.uncertainty.informed import Informed
from gonio.geometry import FloatArray

ENOUGH = 10.0  # effective samples by which a parameter is established
LEVERAGE = 0.5  # mean share that its samples have in their own fitted values, above which it is not


def carriers(informed: Informed) -> tuple[FloatArray, FloatArray]:
    """Effective number of samples of each parameter and their mean leverage, (P,) each.

    The leverage of a sample is its share in its own fitted value; samples count by how much they
    move the parameter.
    """
    weight = informed.gain**2
    total = np.maximum(weight.sum(axis=0), 1e-300)
    return informed.effective_samples, np.asarray(informed.leverage @ weight / total)


def established(number: FloatArray, leverage: FloatArray) -> NDArray[np.bool_]:
    """Whether so many samples, with such a leverage, establish a parameter."""
    return np.asarray((number >= ENOUGH) & (leverage <= LEVERAGE))
