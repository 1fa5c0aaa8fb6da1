"""From a minimum to uncertainties: covariance by source, what is undetermined, bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.curvature import inverse_curvature, where_determined
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_change import shared_change
from gonio.fitting.uncertainty.allowance import Allowance
from gonio.fitting.uncertainty.degrees_of_freedom import Spread, satterthwaite
from gonio.fitting.uncertainty.loss_sandwich import by_loss
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
    dof : ndarray, shape (P,), optional
        Degrees of freedom of `independent` as an estimate; infinity where it is known. None where
        the noise is stated.
    likelihood : ndarray, shape (P, P), optional
        What `independent` is by the noise alone, where it allows for more.
    allowance : Allowance or None
        What `independent` allows for beyond the noise.
    """

    determined: NDArray[np.bool_]
    independent: FloatArray
    noise_scale: float
    shared: dict[str, FloatArray]
    profiled: tuple[str, ...] = ()
    dof: FloatArray | None = None
    likelihood: FloatArray | None = None
    allowance: Allowance | None = None

    def with_spread(self, spread: Spread, allowance: Allowance) -> Uncertainty:
        """The same with another covariance from what is independent."""
        return replace(
            self,
            independent=spread.covariance,
            dof=spread.dof,
            likelihood=self.independent if self.likelihood is None else self.likelihood,
            allowance=allowance,
        )

    @property
    def covariance(self) -> FloatArray:
        """Covariance with every source, shape (P, P)."""
        return self._with(self.independent, tuple(self.shared))

    @property
    def of_likelihood(self) -> FloatArray:
        """Covariance of the likelihood: by noise alone, with the sources it holds, (P, P)."""
        noise = self.independent if self.likelihood is None else self.likelihood
        return self._with(noise, self.profiled)

    @property
    def without_propagated(self) -> FloatArray:
        """Covariance without the sources that the likelihood does not hold, shape (P, P)."""
        return self._with(self.independent, self.profiled)

    @property
    def propagated(self) -> dict[str, FloatArray]:
        """The part of `shared` that the likelihood does not hold."""
        return {name: moves for name, moves in self.shared.items() if name not in self.profiled}

    def _with(self, independent: FloatArray, names: tuple[str, ...]) -> FloatArray:
        total = independent.copy()
        for name in names:
            total += self.shared[name].T @ self.shared[name]
        return total

    def dof_of(self, j: int) -> float | None:
        """Degrees of freedom of the variance of parameter j; None where it is known."""
        if self.dof is None or not np.isfinite(self.dof[j]):
            return None
        own = self.independent[j, j]
        if self.allowance is None or own <= 0:
            return float(self.dof[j])
        # Shared errors have the size that is stated.
        variances = np.array([own, self.covariance[j, j] - own])
        found = satterthwaite(variances, np.array([self.dof[j], np.inf]))
        return found if np.isfinite(found) else None

    def chi2_unit(self, j: int) -> float:
        """Growth of chi-squared at one standard uncertainty of parameter j, without shared errors.

        The square of the noise scale, and more where the uncertainty allows for more than noise.
        """
        if self.likelihood is None or self.likelihood[j, j] <= 0:
            return self.noise_scale**2
        return float(self.noise_scale**2 * self.independent[j, j] / self.likelihood[j, j])

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
        return _of_loss(minimum)
    determined, inverse = inverse_curvature(optimum)
    shared = {}
    if problem.samples.shared:
        shared = _moves(problem, optimum.p, inverse, problem.shared_changes(optimum.p))
    independent = where_determined(determined, inverse * noise_scale**2)
    if problem.profiled:
        gain = inverse @ problem.weighted(problem.jacobian(optimum.p)[1]).T
        weight = problem.inverse_variance
        # A sample without weight has no part in the gain either.
        variance = np.divide(noise_scale**2, weight, out=np.zeros_like(weight), where=weight > 0)
        independent = where_determined(determined, (gain * variance) @ gain.T)
    dof = _dof(minimum)
    return Uncertainty(determined, independent, noise_scale, shared, problem.profiled, dof)


def _of_loss(minimum: Minimum) -> Uncertainty:
    """Covariance where another loss than chi-squared was made small."""
    problem, optimum = minimum.problem, minimum.optimum
    p = optimum.p
    spread = by_loss(minimum)
    f, jacobian = problem.jacobian(p)
    data = problem.samples.value, f, problem.inverse_variance, problem.cos_theta_r
    b = problem.law.expected_curvature(*data)
    curvature = (jacobian * b[:, None]).T @ jacobian
    determined, inverse = inverse_curvature(replace(optimum, curvature=curvature))
    # An error of the data moves the estimate as under least squares with these weights.
    squared = problem.with_weights(b).as_least_squares()
    changes = [shared_change(problem, term, p, f) for term in problem.samples.shared]
    shared = _moves(squared, p, inverse, changes) if changes else {}
    scale = minimum.noise_scale
    return Uncertainty(
        determined, spread.covariance, scale, shared, (), spread.dof,
        likelihood=where_determined(determined, inverse * scale**2),
    )  # fmt: skip


def _dof(minimum: Minimum) -> FloatArray | None:
    """Degrees of freedom of the noise where the scatter stands for it; None where it is stated."""
    if minimum.problem.weights == "sd":
        return None
    return np.full(len(minimum.optimum.p), float(minimum.dof))


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
