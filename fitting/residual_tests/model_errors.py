"""Shapes that an error of the model may have over the samples, as columns of its covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.groups import classes, directions_of, incidence_directions
from gonio.fitting.residual_tests.smooth_basis import Columns, FullColumns, SineProducts
from gonio.geometry import FloatArray

WIDE, NARROW = 0.4, 0.15  # correlation lengths, as shares of the range of each coordinate
BEYOND = 1.4  # half width of the box of the basis, in half ranges of the coordinates
MOST_FACTORS = 60  # incidences with a factor each; more are put into classes
SAMPLES_EACH = 3  # at least so many samples have one factor

SMOOTH = "error that is smooth over half and difference angle"
FINE = "error that varies quickly over half and difference angle"
VIEW = "error that is smooth over viewing direction and angle of incidence"
AZIMUTH = "error that varies with the direction of the half vector on the sample"
FACTOR = "factor of each incidence"


def error_columns(
    problem: Problem, vectors: tuple[FloatArray, FloatArray], level: FloatArray
) -> list[Columns]:
    """Columns C of each kind of error, so that C C^T is the covariance of such an error.

    Parameters
    ----------
    problem : Problem
        Over one BRDF.
    vectors : tuple of ndarray, shape (N, 3)
        Unit vectors towards the light and towards the viewer.
    level : ndarray, shape (N,)
        Model values in units of the noise.
    """
    theta_i, phi_i, theta_r, phi_r = directions_of(problem)
    light, viewer = ([w[:, k] for k in range(3)] for w in vectors)
    half = [a + b for a, b in zip(light, viewer, strict=True)]
    length = np.maximum(np.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2), 1e-12)
    half = [x / length for x in half]
    theta_h = np.arccos(np.clip(half[2], -1, 1))
    # The half vector is at equal angles to both.
    theta_d = np.arccos(np.minimum(length / 2, 1.0))
    from_mirror, sine = phi_r - phi_i, np.sin(theta_r)
    view = [sine * np.cos(from_mirror), sine * np.sin(from_mirror), theta_i]
    incidence = incidence_of(problem)
    factors = level[:, None] * (incidence[:, None] == np.arange(incidence.max() + 1)[None])
    return [
        smooth_columns([theta_h, theta_d], {SMOOTH: ((6, 5), WIDE), FINE: ((12, 9), NARROW)}),
        smooth_columns(view, {VIEW: ((6, 4, 4), WIDE)}),
        smooth_columns(half[:2], {AZIMUTH: ((9, 9), NARROW)}),
        FullColumns(FACTOR, factors),
    ]


def smooth_columns(
    coordinates: Sequence[FloatArray], kinds: Mapping[str, tuple[Sequence[int], float]]
) -> SineProducts:
    """Columns C with C C^T near a Matern-3/2 covariance of some coordinates, each (N,).

    By kind `kinds` holds how many columns there are along each axis, and the correlation lengths
    as a share of the range of each coordinate. The columns are eigenfunctions of the Laplacian on a
    box about the samples, times the root of the spectral density at their frequencies.

    References
    ----------
    Solin & Sarkka 2020, Statistics and Computing 30, 419.
    """
    phases: list[FloatArray] = []
    sizes: dict[str, list[FloatArray]] = {kind: [] for kind in kinds}
    for axis, x in enumerate(coordinates):
        least, largest = float(x.min()), float(x.max())
        reach = largest - least
        half = max(reach / 2, 1e-6) * BEYOND
        first = np.pi / (2 * half)
        phases.append(first * (x - ((least + largest) / 2 - half)))
        for kind, (orders, share) in kinds.items():
            rate = math.sqrt(3) / (share * (reach + 1e-9))
            omega = first * np.arange(1, orders[axis] + 1)
            sizes[kind].append(np.sqrt(4 * rate**3 / half) / (rate**2 + omega**2))
    return SineProducts(phases, sizes)


def incidence_of(problem: Problem) -> NDArray[np.int64]:
    """Number of the incidence of each sample, (N,), from 0 on.

    Directions of incidence to 1 degree; equally filled classes of theta_i where they are many or
    have few samples each.
    """
    theta_i, _, _, _ = directions_of(problem)
    number = incidence_directions(problem)
    count = int(number.max()) + 1
    if count <= min(MOST_FACTORS, max(1, problem.n // SAMPLES_EACH)):
        return number
    most = int(np.clip(problem.n // (4 * SAMPLES_EACH), 1, 12))
    return classes(np.degrees(theta_i), most)
