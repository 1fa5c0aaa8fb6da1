"""How well a fitted model predicts: held-out incidences, leave-one-out by PSIS, evidence.

All three take the likelihood of `Problem`: independent normal errors whose standard deviation is
`noise_scale` times that of the weights. Models can be compared where weights and scale are the
same for all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from gonio.fitting.comparison.pareto_smoothing import pareto_smoothed
from gonio.fitting.minimum import curvature
from gonio.fitting.minimum.gauss_newton import UNDETERMINED
from gonio.fitting.minimum.minimise import minimise, pinned_at
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_change import shared_change
from gonio.geometry import FloatArray

GAP_DEG = 1.0  # incidences this near are one group
MIN_GROUPS = 4  # fewer give no standard error
MAX_GROUPS = 24
MAX_SHARED = 500  # draws of shared errors in a group of samples that a prediction can hold
DRAWS = 2000
MIN_DRAWS = 200
MEMBER_BUDGET = 200_000_000  # cell members that all draws of a model may visit
LOO_SAMPLES = 1000
DEGREES = 5.0  # of the Student-t that draws come from: heavier tails than the posterior's
MAX_K_HAT = 0.7
MIN_EFFECTIVE = 50.0  # draws that weighted ones must be worth
EVIDENCE_PARAMETERS = 6

Index = NDArray[np.int64]


def incidence_groups(theta_i: FloatArray) -> list[Index]:
    """Indices of the samples of each group of near-equal incidence, by rising theta_i.

    A group spans `GAP_DEG`, or the power of two times it that leaves `MAX_GROUPS` at most.

    Parameters
    ----------
    theta_i : ndarray, shape (N,)
        Radians.

    Examples
    --------
    >>> [list(map(int, g)) for g in incidence_groups(np.radians([30.0, 0.0, 30.4, 60.0]))]
    [[1], [0, 2], [3]]
    """
    order = np.argsort(theta_i, kind="stable")
    width = np.radians(GAP_DEG)
    while True:
        groups: list[list[int]] = []
        for k in order:
            if not groups or theta_i[k] - theta_i[groups[-1][0]] > width:
                groups.append([])
            groups[-1].append(int(k))
        if len(groups) <= MAX_GROUPS:
            return [np.sort(np.array(g, np.int64)) for g in groups]
        width *= 2


@dataclass(frozen=True)
class HeldOut:
    """Log densities of groups of samples that a fit has not seen.

    Parameters
    ----------
    by_group : ndarray, shape (groups,)
    unverified : int
        Fits to the other groups that did not reach a verified minimum.
    left_out : tuple of str
        Shared terms with too many draws to be in the predictions.
    """

    by_group: FloatArray
    unverified: int
    left_out: tuple[str, ...]


def held_out(minimum: Minimum, groups: list[Index]) -> HeldOut:
    """Predict each group from a fit to all others, which starts at the optimum of all.

    The density of a group is normal: independent noise, the uncertainty of the parameters that
    the other groups leave, and the errors that samples share, of which the fit has taken up its
    part.

    Parameters
    ----------
    minimum : Minimum
    groups : list of ndarray
        Indices, disjoint.
    """
    problem, optimum, noise_scale = minimum.problem, minimum.optimum, minimum.noise_scale
    held = _held_at_bounds(problem, optimum)
    names = [term.name for term in problem.samples.shared]
    scores, unverified, left_out = [], 0, set[str]()
    for group in groups:
        rest = np.setdiff1d(np.arange(problem.n), group)
        refit = minimise(held.at(rest), optimum.p, search=False)
        unverified += not refit.verified
        f, jac = problem.jacobian(refit.p)
        root = known_directions(refit, noise_scale)
        columns = [jac[group] @ root]
        gain = root @ root.T / noise_scale**2 @ problem.weighted(jac).T
        for name, term in zip(names, problem.samples.shared, strict=True):
            change = shared_change(problem, term, refit.p, f)
            column = _unseen(change, term.group, group, rest, jac, gain)
            if column is None:
                left_out.add(name)
            else:
                columns.append(column)
        variance = noise_scale**2 / problem.inverse_variance[group]
        residual = problem.samples.value[group] - f[group]
        scores.append(_log_normal(residual, variance, np.concatenate(columns, axis=1)))
    return HeldOut(np.array(scores), unverified, tuple(sorted(left_out)))


def _held_at_bounds(problem: Problem, optimum: Optimum) -> Problem:
    """The problem with what was put on its lower bound against the slope held there."""
    for j, q in enumerate(problem.parameters):
        if optimum.p[j] <= q.lower and optimum.gradient[j] > 0:
            problem = pinned_at(problem, j, q.lower)
    return problem


def known_directions(optimum: Optimum, noise_scale: float) -> FloatArray:
    """A with A A^T = covariance of the parameters, shape (parameters, known directions).

    A direction about which the data say nothing has no column: predictions do not depend on it.
    """
    index = np.flatnonzero(optimum.free & (np.diag(optimum.curvature) > 0))
    values, vectors, scale = curvature.axes(optimum.curvature, index)
    known = values > UNDETERMINED
    root = np.zeros((len(optimum.p), int(np.count_nonzero(known))))
    root[index] = noise_scale / scale[:, None] * vectors[:, known] / np.sqrt(values[known])
    return root


def _unseen(
    change: FloatArray,
    draw: Index | None,
    group: Index,
    rest: Index,
    jac: FloatArray,
    gain: FloatArray,
) -> FloatArray | None:
    """What a shared error does to the residuals of a group, (samples of the group, draws).

    It moves the group's samples, and the parameters through the other samples; the difference
    is what a prediction misses. None where there are too many draws.
    """
    if draw is None:
        draw = np.zeros(len(change), np.int64)
    draws, number = np.unique(draw, return_inverse=True)
    if len(draws) > MAX_SHARED:
        return None
    direct = np.zeros((len(group), len(draws)))
    direct[np.arange(len(group)), number[group]] = change[group]
    moves = [
        np.bincount(number[rest], row, minlength=len(draws)) for row in (gain * change)[:, rest]
    ]
    return np.asarray(direct - jac[group] @ np.stack(moves))


def _log_normal(residual: FloatArray, variance: FloatArray, columns: FloatArray) -> float:
    """Log density of N(0, diag(variance) + A A^T) by Woodbury's identity and the matrix
    determinant lemma.
    """
    scaled = columns / np.sqrt(variance)[:, None]
    r = residual / np.sqrt(variance)
    small = np.eye(columns.shape[1]) + scaled.T @ scaled
    root = np.linalg.cholesky(small)
    part = np.linalg.solve(root, scaled.T @ r)
    log_det = np.sum(np.log(variance)) + 2 * np.sum(np.log(np.diag(root)))
    return float(-0.5 * (r @ r - part @ part + log_det + len(r) * np.log(2 * np.pi)))


@dataclass(frozen=True)
class Draws:
    """Points about a mode with what importance sampling needs.

    Parameters
    ----------
    log_likelihood : ndarray, shape (inside,)
    log_proposal : ndarray, shape (inside,)
        Log density of the Student-t that they come from.
    pointwise : ndarray, shape (inside, chosen)
        Log-likelihood of each chosen sample.
    n : int
        How many were drawn, those outside the bounds included.
    """

    log_likelihood: FloatArray
    log_proposal: FloatArray
    pointwise: FloatArray
    n: int

    @property
    def log_weights(self) -> FloatArray:
        """Log of likelihood over proposal."""
        return self.log_likelihood - self.log_proposal


def draw(minimum: Minimum, chosen: Index, rng: np.random.Generator) -> Draws:
    """Draw parameters from a Student-t with the mode and the covariance of the posterior.

    Parameters on a bound, and directions about which the data say nothing, stay where they are.

    Parameters
    ----------
    minimum : Minimum
    chosen : ndarray of int64
        Samples whose own log-likelihood is wanted.
    rng : Generator
    """
    problem, optimum, noise_scale = minimum.problem, minimum.optimum, minimum.noise_scale
    parameters = problem.parameters
    n = int(np.clip(MEMBER_BUDGET // len(problem.cells.weight), MIN_DRAWS, DRAWS))
    root = known_directions(optimum, noise_scale)
    z = rng.standard_normal((n, root.shape[1]))
    z /= np.sqrt(rng.chisquare(DEGREES, (n, 1)) / DEGREES)
    points = optimum.p + z @ root.T
    lower = np.array([q.lower for q in parameters])
    upper = np.array([q.upper for q in parameters])
    inside = np.all((points >= lower) & (points <= upper), axis=1)
    variance = noise_scale**2 / problem.inverse_variance
    constant = -0.5 * np.sum(np.log(2 * np.pi * variance))
    log_likelihood = np.empty(int(np.count_nonzero(inside)))
    pointwise = np.empty((len(log_likelihood), len(chosen)))
    for k, p in enumerate(points[inside]):
        square = (problem.samples.value - problem.values(p)) ** 2 / variance
        log_likelihood[k] = constant - 0.5 * np.sum(square)
        pointwise[k] = -0.5 * (square[chosen] + np.log(2 * np.pi * variance[chosen]))
    return Draws(log_likelihood, _log_student(z[inside], root), pointwise, n)


def _log_student(z: FloatArray, root: FloatArray) -> FloatArray:
    """Log density of the Student-t draws whose standardised values are z."""
    d = z.shape[1]
    norm = gammaln((DEGREES + d) / 2) - gammaln(DEGREES / 2) - d / 2 * np.log(DEGREES * np.pi)
    norm -= np.sum(np.log(np.linalg.svd(root, compute_uv=False)))
    return np.asarray(norm - (DEGREES + d) / 2 * np.log1p(np.sum(z * z, axis=1) / DEGREES))


def leave_one_out(draws: Draws) -> tuple[FloatArray, FloatArray]:
    """Log density of each chosen sample given all others, and its k-hat.

    Vehtari, Gelman & Gabry 2017, Statistics and Computing 27, 1413-1432, with draws from the
    Student-t in place of the posterior: their importance is in the weights.
    """
    pointwise = draws.pointwise.T
    smooth, k_hat = pareto_smoothed(draws.log_weights - pointwise)
    return np.asarray(logsumexp(smooth + pointwise, axis=1)), k_hat


def log_evidence(draws: Draws, log_prior: float) -> tuple[float, float, float, float]:
    """Log of the integral of likelihood times prior by importance sampling.

    Parameters
    ----------
    draws : Draws
        Of all parameters.
    log_prior : float
        Log density of the flat prior between the bounds.

    Returns
    -------
    value, stderr, k_hat, effective : float
        `effective` is what the weighted draws are worth.
    """
    log_w = draws.log_weights
    top = float(log_w.max())
    w = np.zeros(draws.n)
    w[: len(log_w)] = np.exp(log_w - top)
    mean = float(w.mean())
    value = top + float(np.log(mean)) + log_prior
    stderr = float(w.std(ddof=1) / mean / np.sqrt(draws.n))
    _, k_hat = pareto_smoothed(log_w)
    return value, stderr, float(k_hat[0]), float(w.sum() ** 2 / np.sum(w * w))
