"""Shapes that an error of the model may have over the samples, as columns of its covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.groups import classes, incidence_directions
from gonio.fitting.residual_tests.smooth_basis import Columns, FullColumns, SineProducts
from gonio.geometry import FloatArray, unit_vectors

WIDE, NARROW = 0.4, 0.15  # correlation lengths, as shares of the range of each coordinate
BEYOND = 1.4  # half width of the box of the basis, in half ranges of the coordinates
MOST_FACTORS = 60  # incidences with a factor each; more are put into classes
SAMPLES_EACH = 3  # at least so many samples have one factor

SMOOTH = "error that is smooth over half and difference angle"
FINE = "error that varies quickly over half and difference angle"
VIEW = "error that is smooth over viewing direction and angle of incidence"
AZIMUTH = "error that varies with the direction of the half vector on the sample"
FACTOR = "factor of each incidence"


def error_columns(problem: Problem, level: FloatArray) -> dict[str, Columns]:
    """Columns C by kind of error, so that C C^T is the covariance of such an error of the model.

    Parameters
    ----------
    problem : Problem
        Over one BRDF.
    level : ndarray, shape (N,)
        Model values in units of the noise.
    """
    theta_i, phi_i, theta_r, phi_r = _angles(problem)
    w_i, w_r = unit_vectors(theta_i, phi_i), unit_vectors(theta_r, phi_r)
    half = w_i + w_r
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
    theta_h = np.arccos(np.clip(half[:, 2], -1, 1))
    theta_d = np.arccos(np.clip(np.sum(half * w_i, axis=1), -1, 1))
    pair = np.column_stack([theta_h, theta_d])
    from_mirror = unit_vectors(theta_r, phi_r - phi_i)
    view = np.column_stack([from_mirror[:, 0], from_mirror[:, 1], theta_i])
    incidence = incidence_of(problem)
    factors = level[:, None] * (incidence[:, None] == np.arange(incidence.max() + 1)[None])
    return {
        SMOOTH: smooth_columns(pair, (6, 5), WIDE),
        FINE: smooth_columns(pair, (12, 9), NARROW),
        VIEW: smooth_columns(view, (6, 4, 4), WIDE),
        AZIMUTH: smooth_columns(half[:, :2], (9, 9), NARROW),
        FACTOR: FullColumns(factors),
    }


def smooth_columns(x: FloatArray, orders: Sequence[int], share: float) -> SineProducts:
    """Columns C with C C^T near a Matern-3/2 covariance of the coordinates x (N, D).

    Its lengths are `share` of the range of each coordinate. The columns are eigenfunctions of the
    Laplacian on a box about x, `orders` of them along each axis, times the root of the spectral
    density at their frequencies.

    References
    ----------
    Solin & Sarkka 2020, Statistics and Computing 30, 419.
    """
    reach = np.ptp(x, axis=0)
    centre = (x.max(axis=0) + x.min(axis=0)) / 2
    half = np.maximum(reach / 2, 1e-6) * BEYOND
    rate = np.sqrt(3) / (share * (reach + 1e-9))
    phases, sizes = [], []
    for axis, most in enumerate(orders):
        omega = np.pi * np.arange(1, most + 1) / (2 * half[axis])
        density = 4 * rate[axis] ** 3 / (rate[axis] ** 2 + omega**2) ** 2
        phases.append(omega[0] * (x[:, axis] - centre[axis] + half[axis]))
        sizes.append(np.sqrt(density / half[axis]))
    return SineProducts(phases, sizes)


def incidence_of(problem: Problem) -> NDArray[np.int64]:
    """Number of the incidence of each sample, (N,), from 0 on.

    Directions of incidence to 1 degree; equally filled classes of theta_i where they are many or
    have few samples each.
    """
    theta_i, _, _, _ = _angles(problem)
    number = incidence_directions(problem)
    count = int(number.max()) + 1
    if count <= min(MOST_FACTORS, max(1, problem.n // SAMPLES_EACH)):
        return number
    most = int(np.clip(problem.n // (4 * SAMPLES_EACH), 1, 12))
    return classes(np.degrees(theta_i), most)


def _angles(problem: Problem) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    d, n = problem.samples.directions, problem.n
    theta_i, phi_i, theta_r, phi_r = (
        np.asarray(np.broadcast_to(a, (n,)), float)
        for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)
    )
    return theta_i, phi_i, theta_r, phi_r
