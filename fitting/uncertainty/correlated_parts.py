"""The covariance where the residuals of a joint fit's parts are correlated."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from gonio.fitting.minimum.curvature import inverse_curvature, where_determined
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.geometry import FloatArray, unit_vectors

CORRELATED = 0.1  # mean correlation of the parts' residuals that is no chance
FIRST = 16  # directions that are compared before all are
SAME = 1e-3  # directions, as unit vectors, that are the same


def with_correlated_parts(
    minimum: Minimum, errors: uncertainty.Uncertainty
) -> uncertainty.Uncertainty:
    """The covariance with residuals that all parts have in common counted once.

    Where a model does not fit, its parts leave the same residuals at the same directions: they are
    no independent evidence of what the parts share. With r_kl their correlation between parts,
    samples of parts k and l at one place have the covariance r_kl / sqrt(w_k w_l), and
    H^-1 (sum_kl r_kl J_k^T sqrt(W_k W_l) J_l) H^-1 replaces H^-1.
    """
    problem, optimum = minimum.problem, minimum.optimum
    r = residual_correlation(problem, optimum.p)
    if r is None:
        return errors
    columns = []
    for part, _, index in problem.pieces():
        columns.append(np.sqrt(part.inverse_variance)[:, None] * part.jacobian(optimum.p[index])[1])
    indices = [index for _, _, index in problem.pieces()]
    n_p = len(optimum.p)
    scatter = np.zeros((n_p, n_p))
    for (k, a), (m, b) in itertools.product(enumerate(indices), repeat=2):
        scatter[np.ix_(a, b)] += r[k, m] * columns[k].T @ columns[m]
    determined, inverse = inverse_curvature(optimum)
    covariance = errors.noise_scale**2 * inverse @ scatter @ inverse
    return replace(errors, independent=where_determined(determined, covariance))


def residual_correlation(problem: Problem, p: FloatArray) -> FloatArray | None:
    """Correlation of the residuals between the parts, or None where they are not correlated.

    Only several parts that were measured at the same directions can be compared.
    """
    if not _same_directions(problem):
        return None
    z = []
    for part, _, index in problem.pieces():
        residual = (part.samples.value - part.values(p[index])) * np.sqrt(part.inverse_variance)
        z.append(residual / max(float(np.linalg.norm(residual)), 1e-300))
    r = np.array(z) @ np.array(z).T
    np.fill_diagonal(r, 1.0)
    return r if mean_correlation(r) > CORRELATED else None


def mean_correlation(r: FloatArray) -> float:
    """Mean of the correlations between different parts."""
    return float((r.sum() - len(r)) / (len(r) * (len(r) - 1)))


def _same_directions(problem: Problem) -> bool:
    first, *others = (part for part, _, _ in problem.pieces())
    return bool(others) and all(
        part.n == first.n
        and _first_alike(part, first)
        and np.allclose(part.w_i, first.w_i, atol=SAME)
        and np.allclose(_centroids(part), _centroids(first), atol=SAME)
        for part in others
    )


def _first_alike(part: Problem, first: Problem) -> bool:
    """Whether the first viewing directions are the same, which most parts fail already."""

    def directions(own: Problem) -> FloatArray:
        d = own.samples.directions
        theta, phi = (np.broadcast_to(angle, (own.n,))[:FIRST] for angle in (d.theta_r, d.phi_r))
        return unit_vectors(theta, phi)

    return np.allclose(directions(part), directions(first), atol=SAME)


def _centroids(part: Problem) -> FloatArray:
    return part.samples.directions.vectors()[1]
