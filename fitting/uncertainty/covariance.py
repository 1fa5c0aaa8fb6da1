"""From a minimum to uncertainties: covariance by source, what is undetermined, bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum import curvature
from gonio.fitting.minimum.gauss_newton import Optimum, minimise, pinned_at, within_sum
from gonio.fitting.problem.losses import CHI2
from gonio.fitting.problem.problem import Problem
from gonio.geometry import FloatArray, rotated
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
    learnt : tuple of str
        Shared terms that the likelihood of the fit holds; the others are only propagated.
    """

    determined: NDArray[np.bool_]
    independent: FloatArray
    noise_scale: float
    shared: dict[str, FloatArray]
    learnt: tuple[str, ...] = ()

    @property
    def covariance(self) -> FloatArray:
        """Covariance with every source, shape (P, P)."""
        return self._with(tuple(self.shared))

    @property
    def of_likelihood(self) -> FloatArray:
        """Covariance with the sources that the likelihood holds, shape (P, P)."""
        return self._with(self.learnt)

    @property
    def propagated(self) -> dict[str, FloatArray]:
        """The part of `shared` that the likelihood does not hold."""
        return {name: moves for name, moves in self.shared.items() if name not in self.learnt}

    def _with(self, names: tuple[str, ...]) -> FloatArray:
        total = self.independent.copy()
        for name in names:
            total += self.shared[name].T @ self.shared[name]
        return total

    def components(self, j: int) -> dict[str, float]:
        """Standard uncertainty of parameter j by source."""
        parts = {"independent": float(np.sqrt(self.independent[j, j]))}
        for name, moves in self.shared.items():
            parts[name] = float(np.sqrt(np.sum(moves[:, j] ** 2)))
        return parts


def evaluate(
    problem: Problem,
    optimum: Optimum,
    noise_scale: float,
    *,
    changes: Sequence[FloatArray] | None = None,
    learnt: tuple[str, ...] = (),
) -> Uncertainty:
    """Covariance at a minimum.

    Parameters
    ----------
    problem : Problem
        With the weights that the minimum was found with.
    optimum : Optimum
    noise_scale : float
        Factor by which the independent errors exceed what the weights say.
    changes : sequence of ndarray, optional
        Change of the samples (N,) for one standard deviation of every shared term, in their order;
        `shared_change` at the minimum where not given.
    learnt : tuple of str
        Terms that the weights of the problem hold. The independent part is then what the gain
        makes of the independent errors, so that all sources together are the covariance.
    """
    if not problem.quadratic:
        return _sandwich(problem, optimum, noise_scale)
    determined, inverse = inverse_curvature(optimum)
    shared = {}
    if problem.samples.shared:
        f = problem.values(optimum.p)
        if changes is None:
            changes = [shared_change(problem, t, optimum.p, f) for t in problem.samples.shared]
        shared = _moves(problem, optimum.p, inverse, changes)
    independent = inverse * noise_scale**2
    if learnt:
        gain = inverse @ problem.weighted(problem.jacobian(optimum.p)[1]).T
        weight = problem.inverse_variance
        # A sample without weight has no part in the gain either.
        variance = np.divide(noise_scale**2, weight, out=np.zeros_like(weight), where=weight > 0)
        independent = (gain * variance) @ gain.T
    return Uncertainty(determined, independent, noise_scale, shared, learnt)


def _sandwich(problem: Problem, optimum: Optimum, noise_scale: float) -> Uncertainty:
    """Covariance where another loss than chi-squared was made small (Huber 1967).

    The scatter of the residuals stands for the noise, sample by sample, whatever the weights say.
    """
    p, law = optimum.p, problem.law
    f, jac = problem.jacobian(p)
    data = problem.samples.value, f, problem.inverse_variance, problem.components[5]
    bread = law.bread(*data)
    r, weight = law.linearised(*data)
    bent = (jac * bread[:, None]).T @ jac
    determined, inverse = inverse_curvature(replace(optimum, curvature=bent))
    score = jac * (weight * r)[:, None]
    meat = score.T @ score * problem.n / max(problem.n - len(p), 1)
    # An error of the data moves the estimate as under least squares with these weights.
    squared = replace(problem, inverse_variance=bread, loss=CHI2.name)
    changes = [shared_change(problem, term, p, f) for term in problem.samples.shared]
    shared = _moves(squared, p, inverse, changes) if changes else {}
    return Uncertainty(determined, inverse @ meat @ inverse, noise_scale, shared)


def inverse_curvature(optimum: Optimum) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which free parameters the data determine, and the inverse curvature of these, (P, P)."""
    determined = curvature.determined(optimum.curvature, optimum.free)
    index = np.flatnonzero(determined)
    n_p = len(optimum.p)
    inverse = np.zeros((n_p, n_p))
    if len(index):
        scale = 1 / np.sqrt(np.diag(optimum.curvature)[index])
        scaled = optimum.curvature[np.ix_(index, index)] * np.outer(scale, scale)
        # Along a sum that is held at its limit the parameters can move, but not away from it.
        along = within_sum(scale * np.isin(index, optimum.limited))
        inside = along @ np.linalg.inv(along.T @ scaled @ along) @ along.T
        inverse[np.ix_(index, index)] = inside * np.outer(scale, scale)
    determined[list(optimum.limited)] = False
    return determined, inverse


def _moves(
    problem: Problem, p: FloatArray, inverse: FloatArray, changes: Sequence[FloatArray]
) -> dict[str, FloatArray]:
    """Parameter changes for one standard deviation of every draw of every term, (groups, P)."""
    terms = []
    for term, change in zip(problem.samples.shared, changes, strict=True):
        group = np.zeros(problem.n, np.int64)
        if term.group is not None:
            group = np.unique(term.group, return_inverse=True)[1]
        moves = np.zeros((int(group.max()) + 1, len(p)))
        terms.append((change, group, moves))
    for piece, where, place in problem.pieces():
        weighted = piece.weighted(piece.jacobian(p[place])[1])
        for change, group, moves in terms:
            columns = (weighted * change[where, None]).T
            score = [np.bincount(group[where], weights=c, minlength=len(moves)) for c in columns]
            moves += np.transpose(inverse[:, place] @ score)
    found: dict[str, FloatArray] = {}
    for term, (_, _, moves) in zip(problem.samples.shared, terms, strict=True):
        # Errors of several sources may have one name: they are draws of their own.
        found[term.name] = np.concatenate([found.get(term.name, moves[:0]), moves])
    return found


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
    pieces = problem.pieces()
    if pieces[0][0] is not problem:
        changes = [
            shared_change(piece, term.select(np.arange(problem.n)[where]), p[place], f[where])
            for piece, where, place in pieces
        ]
        return np.concatenate(changes)
    if term.shift is not None:
        return _shifted(problem, term.shift, p)
    if term.turn:
        ends = [moved_problem(problem, turn=side * term.turn).values(p) for side in (1, -1)]
        change = (ends[0] - ends[1]) / 2
        return change if term.profile is None else change * term.profile
    if term.blur:
        change = _blurred(problem, term.blur, p) - f
        return change if term.profile is None else change * term.profile
    return term.change(f)


def _shifted(problem: Problem, shift: FloatArray, p: FloatArray) -> FloatArray:
    """Half the difference of the model with all viewing directions moved by +shift and -shift."""
    step = np.repeat(shift, np.diff(problem.cells.offsets), axis=0)
    return (_moved(problem, step, p) - _moved(problem, -step, p)) / 2


def moved_problem(
    problem: Problem, *, shift: FloatArray | None = None, turn: float | FloatArray = 0.0
) -> Problem:
    """The problem with its directions elsewhere.

    Parameters
    ----------
    problem : Problem
        Of one piece.
    shift : ndarray, shape (N, 3), optional
        Change of the viewing directions of a sample's members, tangent vectors in radians.
    turn : float or ndarray, shape (N,)
        Turn of the sample about its normal, radians: seen from a sample that lies turned
        counter-clockwise both azimuths are smaller.
    """
    cells, w_i, w_r = problem.cells, problem.w_i, problem.cells.w_r
    members = np.diff(cells.offsets)
    if shift is not None:
        w_r = w_r + np.repeat(shift, members, axis=0)
        w_r /= np.linalg.norm(w_r, axis=1, keepdims=True)
    if np.any(turn):
        each = np.broadcast_to(turn, problem.n)
        w_i = np.ascontiguousarray(rotated(w_i, each))
        w_r = np.ascontiguousarray(rotated(w_r, np.repeat(each, members)))
    return replace(problem, w_i=w_i, cells=replace(cells, w_r=w_r))


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


def around(
    problem: Problem, optimum: Optimum, j: int
) -> tuple[Problem, Optimum, NDArray[np.int64]]:
    """The smallest problem in which parameter j can be followed, its minimum, and the places of
    its parameters in the whole."""
    small, place = problem.around(optimum.p, optimum.curvature, j)
    if small is problem:
        return problem, optimum, place
    p = optimum.p[place]
    chi2, g, h = small.normal_equations(p)
    return small, replace(optimum, p=p, chi2=chi2, gradient=g, curvature=h,
                          free=optimum.free[place]), place  # fmt: skip


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
    problem, optimum, place = around(problem, optimum, j)
    j = int(np.flatnonzero(place == j)[0])
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
