"""The fitted model at directions that need not have been measured, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.errors import ConfigurationError
from gonio.fitting.result.record import FitRecord
from gonio.geometry import Directions, FloatArray
from gonio.models import Model
from gonio.wording import counted


@dataclass(frozen=True)
class Prediction:
    """Values of the fitted model.

    Parameters
    ----------
    value : ndarray
        BRDF, sr^-1, cosine not included; shape of the directions.
    u : ndarray or None
        Standard uncertainty that the parameters' covariance gives it, sr^-1, shared errors included
        as the fit propagated them. None where the fit has no covariance. How far the model itself
        is from the surface is not in it.
    """

    value: FloatArray
    u: FloatArray | None


def predict(record: FitRecord, model: Model, directions: Directions) -> Prediction:
    """The fitted model at these directions.

    Raises
    ------
    ConfigurationError
        If the fit is a joint one: its parts have parameters of their own; or for anything but
        `Directions`.
    """
    if record.parts:
        raise ConfigurationError(
            f"a joint fit of {counted(len(record.parts), 'part')} predicts by part; choose one, as "
            f"with result.part({record.parts[0].name!r}).predict(directions)."
        )
    if not isinstance(directions, Directions):
        raise ConfigurationError(
            f"a prediction takes gonio.Directions, angles in radians, not "
            f"{type(directions).__name__}; of samples give samples.directions."
        )
    w_i, w_r = directions.vectors()
    value, jacobian = model.gradient(w_i, w_r, model.vector(record.values()))
    if record.covariance is None:
        return Prediction(value, None)
    variance = np.einsum("...j,jk,...k->...", jacobian, np.asarray(record.covariance), jacobian)
    return Prediction(value, np.sqrt(np.maximum(variance, 0.0)))
