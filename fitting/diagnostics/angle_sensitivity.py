"""How far independent errors of the viewing directions move the parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray, unit_vectors

STEP = 0.1  # of the error: over which the slope of the model is taken
MOST = 5_000  # samples whose slope is taken


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
        own = gain[where]
        some, stands_for = _telling(own)
        here = piece if len(some) == piece.n else piece.at(some)
        root = np.sqrt(minimum.problem.inverse_variance[where][some])
        square = _slope_squared(here, p[index], STEP * u_angle) * u_angle**2 * root**2
        variance += (own[some] ** 2).T @ (square * stands_for)
    return np.sqrt(variance)


def _telling(gain: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Samples that move the parameters most, others evenly, and how many each stands for."""
    n, half = len(gain), MOST // 2
    if n <= MOST:
        return np.arange(n), np.ones(n)
    carried = np.zeros(n)
    for column in gain.T:
        square = column**2
        square /= max(float(square.sum()), 1e-300)
        carried += square
    most = np.argpartition(carried, n - half)[n - half :]
    is_other = np.ones(n, np.bool_)
    is_other[most] = False
    few = np.flatnonzero(is_other)[np.linspace(0, n - half - 1, half).astype(np.int64)]
    return np.concatenate([most, few]), np.repeat([1.0, (n - half) / half], half)


def _slope_squared(problem: Problem, p: FloatArray, step: float) -> FloatArray:
    """Squared gradient of the samples (N,) over their viewing directions, per radian squared."""
    d = problem.samples.directions
    w_r = np.broadcast_to(unit_vectors(d.theta_r, d.phi_r), (problem.n, 3))
    found = np.zeros(problem.n)
    for axis in _tangents(w_r):
        ends = [problem.with_directions(shift=s * step * axis).values(p) for s in (1, -1)]
        found += ((ends[0] - ends[1]) / (2 * step)) ** 2
    return found


def _tangents(w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors across each direction (N, 3)."""
    x, y, z = w[:, 0], w[:, 1], w[:, 2]
    zero = np.zeros(len(w))
    # Across x, where the direction is not near it, else across y.
    a = np.where(np.abs(x) < 0.9, [zero, z, -y], [-z, zero, x])
    a /= np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
    along = np.stack([y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]])
    return a.T, along.T
