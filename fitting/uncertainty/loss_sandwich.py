"""Uncertainties where another loss than chi-squared was made small.

The scatter of the residuals stands for the noise, sample by sample (Huber 1967). Its covariance
needs the whole curvature of the loss: under another loss than the likelihood of the noise the
residuals are large, and what they add to J^T B J can halve it or double it. Where the two differ
much the curvature at the minimum does not tell how far the estimate moves, and the fit is repeated
on samples drawn from the samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gonio.fitting.minimum.curvature import marginal_root, where_determined
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.uncertainty.degrees_of_freedom import Spread
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.sample_jackknife import by_samples
from gonio.fitting.uncertainty.second_derivatives import STEP, beside
from gonio.geometry import FloatArray

FLOOR = 0.02  # least curvature after a sample is left out, in units of that before
CURVED = 1.5  # ratio of standard uncertainties, with the whole curvature and without, that is large
REFITS = 100
FEWEST = 20  # that are made in any case,
PASSES = 20_000  # and over the data after which no more are
LARGEST = 20_000  # samples of a fit that is repeated
EACH = 5  # samples for each parameter that are drawn from, at least
ROUNDS = 4  # of new weights in a fit that is repeated
SETTLED = 1e-2  # relative change of the weights that ends them
SEED = 0  # of the samples that are drawn: one fit, one answer


def informed_by_loss(minimum: Minimum) -> Informed:
    """What the data inform under the loss, with its expected curvature B for the weights.

    `q` holds B^1/2 J `back` and `z` the slope of the loss over B^1/2.
    """
    problem, optimum = minimum.problem, minimum.optimum
    f, jacobian = problem.jacobian(optimum.p)
    data = problem.samples.value, f, problem.inverse_variance, problem.cos_theta_r
    b = problem.law.expected_curvature(*data)
    r, v = problem.law.linearised(*data)
    h = (jacobian * b[:, None]).T @ jacobian
    determined, whole = marginal_root(h, optimum.free, optimum.limited)
    determined[list(optimum.limited)] = False
    root = np.sqrt(b)
    z = np.divide(v * r, root, out=np.zeros_like(root), where=root > 0)
    return Informed(determined, z, root[:, None] * (jacobian @ whole), whole)


def by_loss(minimum: Minimum) -> Spread:
    """Covariance of the estimates that make a loss small, by leaving out each sample once.

    Parameters
    ----------
    minimum : Minimum
        Of any loss but chi-squared.

    Notes
    -----
    With the scores s_i, minus half the gradient of the loss of sample i, and own_i their
    derivatives, minus ds_i/dp = B_i J_i J_i^T - psi_i d2f_i, a Newton step without sample i moves
    the estimate by -(C - own_i)^-1 s_i, C = sum own_i. The scale of Student's t that is found in
    the residuals is an unknown like the others, with its own score.

    Where a standard uncertainty differs by more than 1.5 from that with B J J^T alone, the fit is
    repeated on 100 sets of samples drawn with replacement, each from the minimum on; on fewer, at
    least 20, where these take many passes over the data.

    References
    ----------
    Huber 1967, Proc. Fifth Berkeley Symp. 1, 221. Lange, Little & Taylor 1989, J. Am. Stat. Assoc.
    84, 881 (scale of t).
    """
    informed = informed_by_loss(minimum)
    dof = informed.effective_samples
    covariance = _newton(minimum, informed)
    plain = by_samples(informed).covariance
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(np.diag(covariance) / np.diag(plain))[informed.determined]
    curved = bool(np.any(~(np.maximum(ratio, 1 / ratio) <= CURVED))) if len(ratio) else False
    if curved and EACH * len(minimum.optimum.p) <= minimum.problem.n <= LARGEST:
        covariance = _refitted(minimum)
    return Spread(where_determined(informed.determined, covariance), dof)


def _newton(minimum: Minimum, informed: Informed) -> FloatArray:
    """sum d d^T, d the Newton step of the parameters when a sample is left out."""
    problem, n_p = minimum.problem, len(minimum.optimum.p)
    back = informed.whole
    if back.shape[1] == 0:
        return np.zeros((n_p, n_p))
    if problem.finds_scale:
        # About 1 is the expected curvature of ln(scale) for each sample.
        own = np.zeros((n_p + 1, back.shape[1] + 1))
        own[:n_p, :-1], own[-1, -1] = back, 1 / np.sqrt(problem.n)
        back = own
    scores = _scores(problem, minimum.optimum.p) @ back
    bent = np.einsum("pr,npq,qs->nrs", back, _curvatures(minimum), back, optimize=True)
    values, vectors = np.linalg.eigh(bent.sum(axis=0))
    root = vectors / np.sqrt(np.maximum(np.abs(values), FLOOR**2))
    rest = root.T @ bent.sum(axis=0) @ root - np.einsum(
        "ar,nab,bs->nrs", root, bent, root, optimize=True
    )
    values, vectors = np.linalg.eigh(rest)
    turned = np.einsum("nji,nj->ni", vectors, scores @ root) / np.maximum(values, FLOOR)
    steps = np.einsum("nij,nj->ni", vectors, turned) @ root.T @ back.T
    return np.asarray(steps[:, :n_p].T @ steps[:, :n_p])


def _scores(problem: Problem, p: FloatArray, log_scale: float = 0.0) -> FloatArray:
    """Minus half the gradient of each sample's loss by the parameters, and by ln(scale) if found.

    (N, P) or (N, P + 1); `log_scale` is the change of the scale's logarithm.
    """
    f, jacobian = problem.jacobian(p)
    w = problem.inverse_variance * np.exp(-2 * log_scale)
    r, v = problem.law.linearised(problem.samples.value, f, w, problem.cos_theta_r)
    scores = jacobian * (v * r)[:, None]
    return np.column_stack([scores, v * r * r - 1]) if problem.finds_scale else scores


def _curvatures(minimum: Minimum) -> FloatArray:
    """Minus the derivatives of the scores, (N, K, K), by differences; 0 for what is held."""
    problem, optimum = minimum.problem, minimum.optimum
    n_p = len(optimum.p)
    size = n_p + int(problem.finds_scale)
    found = np.zeros((problem.n, size, size))
    for j in np.flatnonzero(optimum.free):
        ends = np.array([optimum.p, optimum.p])
        ends[:, j] = beside(problem.parameters[j], float(optimum.p[j]))
        below, above = (_scores(problem, end) for end in ends)
        found[:, :, j] = (below - above) / (ends[1, j] - ends[0, j])
    if problem.finds_scale:
        below, above = (_scores(problem, optimum.p, s) for s in (-STEP, STEP))
        found[:, :, -1] = (below - above) / (2 * STEP)
    held = np.flatnonzero(~optimum.free)
    found[:, held, :] = 0.0
    return (found + found.transpose(0, 2, 1)) / 2


def _settled(problem: Problem, optimum: Optimum) -> Optimum:
    """The minimum with the weights that follow from it, from one near on."""
    for _ in range(ROUNDS if problem.weights_follow_model else 0):
        before = problem.inverse_variance
        problem = problem.reweighted(optimum.p)
        n = optimum.evaluations
        optimum = minimise(problem, optimum.p, search=False)
        optimum = replace(optimum, evaluations=n + optimum.evaluations)
        if np.all(np.abs(problem.inverse_variance - before) <= SETTLED * before):
            break
    return optimum


def _refitted(minimum: Minimum) -> FloatArray:
    """Covariance of fits to samples drawn with replacement."""
    problem, rng = minimum.problem, np.random.default_rng(SEED)
    points: list[FloatArray] = []
    passes = 0
    while len(points) < (REFITS if passes < PASSES else FEWEST):
        drawn = problem.at(np.sort(rng.integers(0, problem.n, problem.n)))
        optimum = _settled(drawn, minimise(drawn, minimum.optimum.p, search=False))
        passes += optimum.evaluations
        points.append(optimum.p)
    return np.atleast_2d(np.cov(np.array(points), rowvar=False))
