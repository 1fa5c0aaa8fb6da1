"""The cells of one image, as the reduction makes them and the effects use them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.samples import Cells


@dataclass(frozen=True)
class ImageCells:
    """The n cells of one image, frame of the sample.

    Parameters
    ----------
    theta_i : float
        Incidence, radians.
    psi : float
        Turn of the sample about its normal, radians.
    incidence, rotation, channel : int
        Numbers of the image's incidence, rotation and channel in the plan.
    means : ndarray, shape (4, n)
        f in sr^-1, its own variance, the variance of standard and background, and the slope of
        the own variance with f.
    centroid : ndarray, shape (n, 3)
        Mean direction from sample to dome.
    at : ndarray, shape (n, 2)
        Mean column and row, pixels.
    stray : ndarray, shape (n, 2)
        Stray light as f, and in the standard's image as a part of its signal.
    solid_angle : ndarray, shape (n,)
        Solid angle of a cell on the side of the sample, sr.
    partial : ndarray of bool, shape (n,)
        Whether part of the cell was masked.
    members : Cells
        Directions over which the model is averaged for each cell.
    n_used, n_saturated, n_reference : int
        Pixels that are used, saturated, and without a usable reference.
    entry : bool
        Whether these are the cells of the lamp's entry patch.
    left : float
        Relative standard error that the correction of multi-bounce leaves.
    bend : ndarray, shape (n,), optional
        Change of f by a nonlinearity of 1 per decade, sr^-1; None where nothing asks for it.
    """

    theta_i: float
    psi: float
    incidence: int
    rotation: int
    means: FloatArray
    centroid: FloatArray
    at: FloatArray
    stray: FloatArray
    solid_angle: FloatArray
    partial: NDArray[np.bool_]
    members: Cells
    n_used: int
    n_saturated: int
    n_reference: int
    entry: bool
    channel: int
    left: float = 0.0
    bend: FloatArray | None = None
