"""Pareto-smoothed weights: against arviz of any version, and where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from arviz_versions import BEFORE_1, psislw

from gonio.fitting.comparison.pareto_smoothing import pareto_smoothed


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


@pytest.mark.skipif(not BEFORE_1, reason="these steps are those of arviz 0.23")
@pytest.mark.parametrize("rows", ROWS)
def test_weights_and_shape_are_those_of_arviz(rows: str) -> None:
    smoothed, k_hat = pareto_smoothed(ROWS[rows])
    expected, expected_k = psislw(ROWS[rows])
    np.testing.assert_array_equal(smoothed, expected)
    np.testing.assert_array_equal(k_hat, expected_k)


@pytest.mark.skipif(BEFORE_1, reason="arviz 1 counts the tail differently")
@pytest.mark.parametrize("rows", ["light", "heavy", "one row", "far down"])
def test_weights_and_shape_are_near_those_of_later_arviz(rows: str) -> None:
    smoothed, k_hat = pareto_smoothed(ROWS[rows])
    expected, expected_k = psislw(ROWS[rows])
    # Its tail is one weight shorter, and the shape from 100 weights is uncertain by 0.1.
    np.testing.assert_allclose(smoothed, expected, atol=0.06)
    np.testing.assert_allclose(k_hat, expected_k, atol=0.03)


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
