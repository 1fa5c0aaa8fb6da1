"""Pareto-smoothed weights: against arviz of either major version, and where the answer is known."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from gonio.fitting.comparison.pareto_smoothing import pareto_smoothed


def psislw(log_weights: np.ndarray) -> tuple[Any, Any]:
    """Smoothed weights by arviz, below version 1 and from it on."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # versions before 1 announce it
        arviz = pytest.importorskip("arviz")
        if hasattr(arviz, "psislw"):
            return arviz.psislw(log_weights.copy())
        from arviz_stats.base import array_stats

        # It gives the weights as they are, up to a constant.
        smoothed, k_hat = array_stats.psislw(log_weights.copy())
        top = smoothed.max(axis=-1, keepdims=True)
        return smoothed - top - np.log(np.sum(np.exp(smoothed - top), -1, keepdims=True)), k_hat


def pareto(shape: float, size: tuple[int, ...], seed: int = 3) -> np.ndarray:
    """ln of weights whose tail has this shape."""
    u = np.random.default_rng(seed).random(size)
    return np.log((u**-shape - 1) / shape + 10)


ROWS = {
    "light": pareto(-0.5, (4, 2000)),
    "heavy": pareto(0.9, (4, 2000)),
    "one row": pareto(0.3, (500,)),
    "few": pareto(0.3, (3, 20)),
    "far down": pareto(0.3, (3, 400)) - 1e4,
    "equal": np.zeros((2, 300)),
    "hardly any": np.where(np.arange(300) < 3, 0.0, -np.inf)[None],
}


@pytest.mark.parametrize("rows", ROWS)
def test_weights_and_shape_are_those_of_arviz(rows: str) -> None:
    smoothed, k_hat = pareto_smoothed(ROWS[rows])
    expected, expected_k = psislw(ROWS[rows])
    # arviz 0.23 to the last bit; later versions sum in another order.
    np.testing.assert_allclose(smoothed, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(k_hat, np.atleast_1d(expected_k), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rows", ROWS)
def test_weights_sum_to_one_and_keep_their_order(rows: str) -> None:
    raw = np.atleast_2d(ROWS[rows])
    smoothed = np.atleast_2d(pareto_smoothed(ROWS[rows])[0])
    np.testing.assert_allclose(np.exp(smoothed).sum(axis=1), 1.0, rtol=1e-12)
    for before, after in zip(raw, smoothed, strict=True):
        ordered = after[np.argsort(before, kind="stable")]
        assert np.all(ordered[1:] >= ordered[:-1])


@pytest.mark.parametrize("shape", [0.2, 0.5, 0.9])
def test_the_shape_is_that_of_the_tail(shape: float) -> None:
    _, k_hat = pareto_smoothed(pareto(shape, (50, 4000)))
    # The fit is drawn towards 0.5 by ten weights of the 190 in the tail.
    assert np.mean(k_hat) == pytest.approx((180 * shape + 5) / 190, abs=0.06)


def test_the_weights_given_stay_as_they_were() -> None:
    given = ROWS["heavy"].copy()
    pareto_smoothed(given)
    np.testing.assert_array_equal(given, ROWS["heavy"])
