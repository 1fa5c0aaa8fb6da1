"""Variances of samples about a model, and the weights that follow from them."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np

from gonio.errors import ConfigurationError
from gonio.fitting.problem.losses import Loss
from gonio.fitting.problem.noise_law import NoiseLaw
from gonio.fitting.problem.protocol import Weights
from gonio.geometry import FloatArray
from gonio.samples import BRDFSamples

ROUNDING = 1e-15  # of the largest value: a residual that is rounding
DARKEST = 1e-9  # of the largest value: below, f counts as this in relative weights
LEAST_VARIANCE = 0.1  # of the stated variance: the least that a sample has about any model


def checked_weights(weights: Any, law: Loss, samples: BRDFSamples) -> Weights:
    """The weights, by default those that the loss takes for these samples.

    Raises
    ------
    ConfigurationError
        For unknown weights, "sd" where the samples hold no uncertainty, or weights that the loss
        does not take.
    """
    if weights not in (None, *get_args(Weights)):
        raise ConfigurationError(
            f"weights {weights!r} are unknown; allowed are {', '.join(get_args(Weights))}."
        )
    chosen: Weights = law.check_weights(weights, has_u=samples.u_independent is not None)
    if chosen == "sd" and samples.u_independent is None:
        raise ConfigurationError(
            "weights 'sd' need uncertainties and the samples have none (no u_brdf column); "
            "use none, relative, cos or coscos."
        )
    return chosen


def variance_about(
    samples: BRDFSamples,
    f: FloatArray | None = None,
    *,
    sharing: bool = False,
    law: NoiseLaw | None = None,
) -> FloatArray:
    """Variance of each sample where its expectation is f, or as stated.

    A sample's own value would give low readings too much weight and bias the fit (-0.2 % on a dim
    surface). Shot noise grows with f, the noise of the standard with f^2; a floor of a tenth of
    the stated variance keeps the result positive where the model is far off.

    Parameters
    ----------
    samples : BRDFSamples
        With uncertainties.
    f : ndarray, shape (N,), optional
        Model values.
    sharing : bool
        Count the noise of a standard's frame once for each image that uses it.
    law : NoiseLaw, optional
        By which the stated uncertainty follows the readings.
    """
    assert samples.u_independent is not None
    stated = samples.u_independent**2
    reference = np.zeros(len(samples)) if samples.u_reference is None else samples.u_reference**2
    if law is not None and f is not None:
        return np.maximum(law.variance(f), LEAST_VARIANCE * stated)
    total = stated
    value = np.maximum(samples.value, 0.0)
    if f is not None and samples.noise_slope is not None:
        ratio = np.clip(f / np.where(value > 0, value, np.inf), 0.7, 1.4)
        moved = np.where(value > 0, reference * ratio**2, reference)
        total = stated - reference + moved + samples.noise_slope * (f - value)
        total = np.maximum(total, LEAST_VARIANCE * stated)
        reference = moved
    if sharing:
        total = total + (samples.reference_sharing - 1) * reference
    return np.asarray(total)


def inverse_variance(
    samples: BRDFSamples,
    weights: Weights,
    loss: Loss,
    f: FloatArray | None,
    law: NoiseLaw | None = None,
) -> FloatArray:
    """Squares of the factors on residuals, (N,), where the model's values are f.

    As stated where f is None. A loss that needs the size of the noise finds it in the residuals.
    """
    if weights == "sd":
        inverse = 1 / variance_about(samples, f, sharing=True, law=law)
    elif weights == "none":
        inverse = np.ones(len(samples))
    elif weights == "relative":
        inverse = relative_weights(_without_darkest(samples.value) if f is None else f)
    else:
        directions = samples.directions
        inverse = np.cos(directions.theta_r) ** 2 * np.ones(len(samples))
        if weights == "coscos":
            inverse = inverse * np.cos(directions.theta_i) ** 2
    if finds_scale(weights, loss):
        root = np.sqrt(inverse)
        residual = samples.value - (0.0 if f is None else f)
        # Residuals that are rounding have no size of their own.
        least = ROUNDING * float(np.max(np.abs(samples.value * root))) or 1.0
        inverse = inverse / max(loss.scale(residual * root), least) ** 2
    return np.asarray(inverse)


def _without_darkest(y: FloatArray) -> FloatArray:
    """Sizes of readings, none below a tenth of their median: noise makes some of them small."""
    size = np.abs(y)
    return np.asarray(np.maximum(size, 0.1 * float(np.median(size))))


def relative_weights(f: FloatArray) -> FloatArray:
    """1/f^2, for noise that is a fixed part of the expectation f, (N,).

    The fitted value takes the place of the reading, which would count for more wherever noise
    makes it smaller.
    """
    size = np.abs(f)
    least = max(DARKEST * float(np.max(size)), np.finfo(float).tiny ** 0.25)
    return np.asarray(1 / np.maximum(size, least) ** 2)


def finds_scale(weights: Weights, law: Loss) -> bool:
    """Whether the loss needs the size of the noise and the samples do not state it."""
    return law.scaled and weights != "sd"


def follow_model(samples: BRDFSamples, weights: Weights, law: Loss) -> bool:
    """Whether the weights depend on the model's values."""
    if weights == "relative" or finds_scale(weights, law):
        return True
    return weights == "sd" and samples.noise_slope is not None


def weighted(columns: FloatArray, inverse_variance: FloatArray) -> FloatArray:
    """Columns (N, k), each row times the weight of its sample."""
    return columns * inverse_variance[:, None]
