"""From a minimum to uncertainties: covariance by source, what is undetermined, bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.optimise import UNDETERMINED, Optimum, minimise, pinned_at
from gonio.fitting.problem import Problem
from gonio.geometry import FloatArray
from gonio.samples import SharedTerm


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the parameters by source.

    Parameters
    ----------
    determined : ndarray of bool, shape (P,)
        Free parameters about which the data say something.
    independent : ndarray, shape (P, P)
        Covariance from the independent errors, `noise_scale` included; 0 elsewhere.
    noise_scale : float
        Factor on the independent uncertainties.
    shared : mapping of str to ndarray, shape (groups, P)
        Change of the parameters for one standard deviation of each draw of each shared term.
    """

    determined: NDArray[np.bool_]
    independent: FloatArray
    noise_scale: float
    shared: dict[str, FloatArray]

    @property
    def covariance(self) -> FloatArray:
        """Covariance with every source, shape (P, P)."""
        total = self.independent.copy()
        for moves in self.shared.values():
            total += moves.T @ moves
        return total

    def components(self, j: int) -> dict[str, float]:
        """Standard uncertainty of parameter j by source."""
        parts = {"independent": float(np.sqrt(self.independent[j, j]))}
        for name, moves in self.shared.items():
            parts[name] = float(np.sqrt(np.sum(moves[:, j] ** 2)))
        return parts


def evaluate(problem: Problem, optimum: Optimum, noise_scale: float) -> Uncertainty:
    """Covariance at a minimum.

    Parameters
    ----------
    problem : Problem
        With the weights that the minimum was found with.
    optimum : Optimum
    noise_scale : float
        Factor by which the independent errors exceed what the weights say.
    """
    determined = _determined(optimum.curvature, optimum.free)
    index = np.flatnonzero(determined)
    n_p = len(optimum.p)
    inverse = np.zeros((n_p, n_p))
    if len(index):
        scale = 1 / np.sqrt(np.diag(optimum.curvature)[index])
        scaled = optimum.curvature[np.ix_(index, index)] * np.outer(scale, scale)
        inverse[np.ix_(index, index)] = np.linalg.inv(scaled) * np.outer(scale, scale)
    shared = {}
    if problem.samples.shared:
        f, jac = problem.jacobian(optimum.p)
        gain = inverse @ problem.weighted(jac).T
        for term in problem.samples.shared:
            shared[term.name] = _moves(problem, term, optimum.p, f, gain)
    return Uncertainty(determined, inverse * noise_scale**2, noise_scale, shared)


def _determined(curvature: FloatArray, free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Free parameters that take no part in a direction without information."""
    determined = free & (np.diag(curvature) > 0)
    index = np.flatnonzero(determined)
    if len(index) == 0:
        return determined
    scale = 1 / np.sqrt(np.diag(curvature)[index])
    values, vectors = np.linalg.eigh(curvature[np.ix_(index, index)] * np.outer(scale, scale))
    for value, vector in zip(values, vectors.T, strict=True):
        if value < UNDETERMINED:
            determined[index[np.abs(vector) > 1e-3]] = False
    return determined


def _moves(
    problem: Problem, term: SharedTerm, p: FloatArray, f: FloatArray, gain: FloatArray
) -> FloatArray:
    """Parameter change for one standard deviation of every draw of a term, (groups, P)."""
    change = shared_change(problem, term, p, f)
    if term.group is None:
        return np.asarray(gain @ change)[None, :]
    _, group = np.unique(term.group, return_inverse=True)
    weighted = gain * change
    return np.stack([np.bincount(group, weights=row) for row in weighted], axis=1)


def shared_change(problem: Problem, term: SharedTerm, p: FloatArray, f: FloatArray) -> FloatArray:
    """Change of the samples (N,) for one standard deviation of a shared term.

    Parameters
    ----------
    problem : Problem
    term : SharedTerm
    p : ndarray
        Parameters.
    f : ndarray, shape (N,)
        Model values at p.
    """
    if term.shift is not None:
        return _shifted(problem, term.shift, p)
    if term.blur:
        return _blurred(problem, term.blur, p) - f
    return term.change(f)


def _shifted(problem: Problem, shift: FloatArray, p: FloatArray) -> FloatArray:
    """Half the difference of the model with all viewing directions moved by +shift and -shift."""
    step = np.repeat(shift, np.diff(problem.cells.offsets), axis=0)
    return (_moved(problem, step, p) - _moved(problem, -step, p)) / 2


def _blurred(problem: Problem, sd: float, p: FloatArray) -> FloatArray:
    """The model seen through a blur of the viewing direction, sd on each axis.

    Four directions at sqrt(2) sd along two tangents have the blur's second moments.
    """
    w_r = problem.cells.w_r
    across = np.cross(w_r, [0.0, 1.0, 0.0])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    along = np.cross(w_r, across)
    steps = [sign * np.sqrt(2) * sd * axis for axis in (across, along) for sign in (1, -1)]
    return np.asarray(sum(_moved(problem, step, p) for step in steps) / 4)


def _moved(problem: Problem, step: FloatArray, p: FloatArray) -> FloatArray:
    """The model with every member's viewing direction moved by a tangent vector."""
    w_r = problem.cells.w_r + step
    w_r /= np.linalg.norm(w_r, axis=1, keepdims=True)
    return problem.values(p, replace(problem.cells, w_r=w_r))


def profile_limit(
    problem: Problem,
    optimum: Optimum,
    j: int,
    increase: float,
    *,
    side: int,
    steps: int = 40,
) -> float | None:
    """How far parameter j can move before the minimum of chi-squared grows by `increase`.

    The other parameters follow to their minimum at each value. None where chi-squared never
    grows so much inside the bounds: the data do not limit the parameter.

    Parameters
    ----------
    side : {1, -1}
        +1 upwards, -1 downwards.
    """
    parameter = problem.parameters[j]
    near, far = float(optimum.p[j]), parameter.upper if side > 0 else parameter.lower

    def excess(value: float) -> float:
        start = np.where(np.arange(len(optimum.p)) == j, value, optimum.p)
        held = minimise(pinned_at(problem, j, value), start, search=False)
        return held.chi2 - optimum.chi2 - increase

    if excess(far) <= 0:
        return None
    low, high = near, far
    for _ in range(steps):
        middle = (low + high) / 2
        if excess(middle) > 0:
            high = middle
        else:
            low = middle
        if abs(high - low) <= 1e-3 * abs(high - near):
            break
    return (low + high) / 2
