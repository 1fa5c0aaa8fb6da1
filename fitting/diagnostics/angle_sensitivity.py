"""How far independent errors of the viewing directions move the parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

STEP = 0.1  # of the error: over which the slope of the model is taken
MOST = 20_000  # samples whose slope is taken


def moved_by_angles(minimum: Minimum, gain: FloatArray, u_angle: float) -> FloatArray:
    """Standard deviation (P,) of the parameters by errors of the viewing directions.

    Parameters
    ----------
    minimum : Minimum
    gain : ndarray, shape (N, P)
        Change of the parameters for a change of each sample times the root of its weight.
    u_angle : float
        Standard deviation of the error of each viewing direction along each of two axes, radians,
        independent from sample to sample.
    """
    problem, p = minimum.problem.independent, minimum.optimum.p
    variance = np.zeros(gain.shape[1])
    for piece, where, index in problem.pieces():
        some = np.arange(piece.n)
        if piece.n > MOST:
            some = np.unique(np.linspace(0, piece.n - 1, MOST).astype(np.int64))
        here = piece if len(some) == piece.n else piece.at(some)
        root = np.sqrt(minimum.problem.inverse_variance[where][some])
        square = _slope_squared(here, p[index], STEP * u_angle) * u_angle**2 * root**2
        variance += (gain[where][some] ** 2).T @ square * (piece.n / len(some))
    return np.sqrt(variance)


def _slope_squared(problem: Problem, p: FloatArray, step: float) -> FloatArray:
    """Squared gradient of the samples (N,) over their viewing directions, per radian squared."""
    _, w_r = problem.samples.directions.vectors()
    w_r = np.broadcast_to(w_r, (problem.n, 3))
    found = np.zeros(problem.n)
    for axis in _tangents(w_r):
        ends = [problem.with_directions(shift=s * step * axis).values(p) for s in (1, -1)]
        found += ((ends[0] - ends[1]) / (2 * step)) ** 2
    return found


def _tangents(w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors across each direction (N, 3)."""
    helper: NDArray[np.float64] = np.where(
        np.abs(w[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]
    )
    across = np.cross(w, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across, np.cross(w, across)
