"""From a minimum to uncertainties: covariance by source, what is undetermined, bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.curvature import inverse_curvature, of_known
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_change import (
    shared_change,
)
from gonio.geometry import FloatArray


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
    profiled : tuple of str
        Shared terms that the likelihood of the fit holds; the others are only propagated.
    """

    determined: NDArray[np.bool_]
    independent: FloatArray
    noise_scale: float
    shared: dict[str, FloatArray]
    profiled: tuple[str, ...] = ()

    @property
    def covariance(self) -> FloatArray:
        """Covariance with every source, shape (P, P)."""
        return self._with(tuple(self.shared))

    @property
    def of_likelihood(self) -> FloatArray:
        """Covariance with the sources that the likelihood holds, shape (P, P)."""
        return self._with(self.profiled)

    @property
    def propagated(self) -> dict[str, FloatArray]:
        """The part of `shared` that the likelihood does not hold."""
        return {name: moves for name, moves in self.shared.items() if name not in self.profiled}

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


def evaluate(minimum: Minimum) -> Uncertainty:
    """Covariance at a minimum, its noise scale included.

    Notes
    -----
    Where the problem profiles shared errors the independent part is what the gain makes of the
    independent errors, so that all sources together are the covariance.
    """
    problem, optimum, noise_scale = minimum.problem, minimum.optimum, minimum.noise_scale
    if not problem.quadratic:
        return _sandwich(minimum)
    determined, inverse = inverse_curvature(optimum)
    shared = {}
    if problem.samples.shared:
        shared = _moves(problem, optimum.p, inverse, problem.shared_changes(optimum.p))
    independent = of_known(determined, inverse * noise_scale**2)
    if problem.profiled:
        gain = inverse @ problem.weighted(problem.jacobian(optimum.p)[1]).T
        weight = problem.inverse_variance
        # A sample without weight has no part in the gain either.
        variance = np.divide(noise_scale**2, weight, out=np.zeros_like(weight), where=weight > 0)
        independent = of_known(determined, (gain * variance) @ gain.T)
    return Uncertainty(determined, independent, noise_scale, shared, problem.profiled)


def _sandwich(minimum: Minimum) -> Uncertainty:
    """Covariance where another loss than chi-squared was made small (Huber 1967).

    The scatter of the residuals stands for the noise, sample by sample, whatever the weights say.
    """
    problem, optimum = minimum.problem, minimum.optimum
    p, law = optimum.p, problem.law
    f, jac = problem.jacobian(p)
    data = problem.samples.value, f, problem.inverse_variance, problem.cos_theta_r
    bread = law.bread(*data)
    r, weight = law.linearised(*data)
    bent = (jac * bread[:, None]).T @ jac
    determined, inverse = inverse_curvature(replace(optimum, curvature=bent))
    score = jac * (weight * r)[:, None]
    meat = score.T @ score * problem.n / max(problem.n - len(p), 1)
    # An error of the data moves the estimate as under least squares with these weights.
    squared = problem.with_weights(bread).as_least_squares()
    changes = [shared_change(problem, term, p, f) for term in problem.samples.shared]
    shared = _moves(squared, p, inverse, changes) if changes else {}
    independent = of_known(determined, inverse @ meat @ inverse)
    return Uncertainty(determined, independent, minimum.noise_scale, shared)


def _moves(
    problem: Problem, p: FloatArray, inverse: FloatArray, changes: Sequence[FloatArray]
) -> dict[str, FloatArray]:
    """Parameter changes for one standard deviation of every draw of every term, (groups, P)."""
    terms = []
    for term, change in zip(problem.samples.shared, changes, strict=True):
        terms.append((change, term.draw(problem.n), np.zeros((term.n_draws, len(p)))))
    for piece, where, index in problem.pieces():
        weighted = piece.weighted(piece.jacobian(p[index])[1])
        for change, group, moves in terms:
            columns = (weighted * change[where, None]).T
            score = [np.bincount(group[where], weights=c, minlength=len(moves)) for c in columns]
            moves += np.transpose(inverse[:, index] @ score)
    by_term: dict[str, FloatArray] = {}
    for term, (_, _, moves) in zip(problem.samples.shared, terms, strict=True):
        # Errors of several sources may have one name: they are draws of their own.
        by_term[term.name] = np.concatenate([by_term.get(term.name, moves[:0]), moves])
    return by_term
