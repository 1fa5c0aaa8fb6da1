"""Errors that the samples share, profiled in the fit: unknowns with priors from the budget.

A sample's expectation is F(p, z): every draw of every profiled error is an unknown z with a prior
of mean 0 and unit variance, in units of what the budget states. About the current z0,

y - F(p, z0) + U z0 = U z + noise,     U = dF/dz,

and the Gaussian z can be integrated out: least squares in p with the covariance of the samples
C = s^2 W^-1 + U U^T, W being the weights and s the factor on the independent errors. By Woodbury,

r^T C^-1 r = min over z of |r - U z|^2 W / s^2 + |z|^2.

U is taken at the model's values. Taken at noisy data, a common factor would be charged less on low
readings and pull the fit below all of them (Peelle's pertinent puzzle).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem import by_jacobian
from gonio.fitting.problem.losses import Loss
from gonio.fitting.problem.noise_law import NoiseLaw
from gonio.fitting.problem.protocol import Problem, ProfiledDraw, Weights
from gonio.fitting.problem.shared_change import draw_slope
from gonio.fitting.problem.unknowns import KernelParameters, Reported
from gonio.geometry import Directions, FloatArray
from gonio.kernels.boxed import UNDETERMINED
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells, SharedTerm


@dataclass(frozen=True)
class NuisanceProblem:
    """A least-squares problem that profiles some shared errors; see `Problem`.

    The draws of those errors are integrated out: `weighted` multiplies by s^2 C^-1, `chi2` is
    s^2 r^T C^-1 r, and `values` are those at the draws z0.

    Parameters
    ----------
    base : Problem
        The problem without them.
    moved : Problem
        The same with directions as z0 moves them, weights of now.
    profiled : tuple of str
        Names of the shared terms.
    draw : ndarray of int64, shape (terms, N)
        Number of the draw that each sample has of each profiled term.
    z0 : ndarray, shape (draws,)
        Draws about which the expectation is linear.
    basis : scipy.sparse.csr_array, shape (N, draws)
        U, at the parameters of the last `reweighted` and z0.
    factor, offset : ndarray, shape (N,)
        What z0 makes of the model's values.
    noise : float
        s, factor on the independent errors.
    """

    base: Problem
    moved: Problem
    profiled: tuple[str, ...]
    draw: NDArray[np.int64]
    z0: FloatArray
    basis: Any
    factor: FloatArray
    offset: FloatArray
    noise: float = 1.0

    @classmethod
    def of(cls, problem: Problem, names: Sequence[str]) -> NuisanceProblem:
        """The problem with these terms profiled; `reweighted` lets the data speak.

        Parameters
        ----------
        problem : Problem
            Over one BRDF, or a joint one.
        names : sequence of str
            Of shared terms of its samples, as `profiled_terms` gives them.
        """
        from scipy.sparse import csr_array

        terms = [term for term in problem.samples.shared if term.name in names]
        draw, n_draws = _draws(terms, problem.n)
        return cls(
            base=problem,
            moved=problem,
            profiled=tuple(dict.fromkeys(term.name for term in terms)),
            draw=draw,
            z0=np.zeros(n_draws),
            basis=csr_array((problem.n, n_draws)),
            factor=np.ones(problem.n),
            offset=np.zeros(problem.n),
        )

    @property
    def terms(self) -> list[SharedTerm]:
        """The profiled terms, in the order of the samples'."""
        return [term for term in self.samples.shared if term.name in self.profiled]

    @property
    def samples(self) -> BRDFSamples:
        return self.moved.samples

    @property
    def model(self) -> Model:
        return self.moved.model

    @property
    def name(self) -> str:
        return self.moved.name

    @property
    def n(self) -> int:
        return self.moved.n

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns, in the order of every parameter vector; the draws are not among them."""
        return self.base.parameters

    @property
    def reported(self) -> tuple[Reported, ...]:
        return self.base.reported

    @property
    def weights(self) -> Weights:
        return self.moved.weights

    @property
    def law(self) -> Loss:
        return self.moved.law

    @property
    def threads(self) -> int | None:
        return self.moved.threads

    @property
    def w_i(self) -> FloatArray:
        return self.moved.w_i

    @property
    def cells(self) -> Cells:
        return self.moved.cells

    @property
    def cos_theta_r(self) -> FloatArray:
        return self.moved.cos_theta_r

    @property
    def inverse_variance(self) -> FloatArray:
        return self.moved.inverse_variance

    @property
    def quadratic(self) -> bool:
        return self.moved.quadratic

    @property
    def finds_scale(self) -> bool:
        return self.moved.finds_scale

    @property
    def weights_follow_model(self) -> bool:
        return self.moved.weights_follow_model

    @property
    def noise_laws(self) -> tuple[NoiseLaw | None, ...]:
        return self.base.noise_laws

    @property
    def sum_limit(self) -> FloatArray:
        return self.moved.sum_limit

    @property
    def terms_of_sum(self) -> list[tuple[str, NDArray[np.int64]]]:
        return self.moved.terms_of_sum

    @property
    def kernel_parameters(self) -> KernelParameters | None:
        return None

    @property
    def independent(self) -> Problem:
        return self.base

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        return self.base.vector(values)

    # ------------------------------------------------------------------ problems made from this one

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> NuisanceProblem:
        moved = self.moved.with_parameters(parameters)
        return replace(self, moved=moved, base=self.base.with_parameters(parameters))

    def with_weights(self, inverse_variance: FloatArray) -> NuisanceProblem:
        return replace(self, moved=self.moved.with_weights(inverse_variance))

    def as_least_squares(self, p: FloatArray | None = None) -> NuisanceProblem:
        return replace(self, base=self.base.as_least_squares(), moved=self.moved.as_least_squares())

    def with_noise_law(self, p: FloatArray) -> NuisanceProblem:
        base, moved = self.base.with_noise_law(p), self.moved.with_noise_law(p)
        return replace(self, base=base, moved=moved)

    def with_directions(
        self, *, shift: FloatArray | None = None, turn: float | FloatArray = 0.0
    ) -> NuisanceProblem:
        """The problem with its directions moved from where z0 has them; U and z0 stay."""
        return replace(self, moved=self.moved.with_directions(shift=shift, turn=turn))

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        return [(self, slice(0, self.n), np.arange(len(self.parameters)))]

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        return self, np.arange(len(p))

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        return self.base.variance(f, sharing=sharing)

    def reweighted(self, p: FloatArray | None) -> NuisanceProblem:
        """The problem with z0 at the data's estimate for p; weights, U and s follow the model."""
        if p is None:
            return self
        z0 = self.draws(p)
        base = self.base.reweighted(p)
        moved = self._with_draws(base, z0).reweighted(p)
        f = moved.values(p)
        relative, offset = np.zeros(self.n), np.zeros(self.n)
        parts = list(zip(self.terms, z0[self.draw], strict=True))
        for term, z in parts:
            if not term.moves_directions:
                no_offset = replace(term, offset=None)
                relative += z * no_offset.change(np.ones(self.n))
                offset += 0.0 if term.offset is None else z * term.offset
        factor = 1 + relative
        changes = [draw_slope(moved, term, p, f, factor) for term, _ in parts]
        for (term, z), change in zip(parts, changes, strict=True):
            if term.blur:
                offset += z * change
        new = replace(
            self, moved=moved, base=base, z0=z0, basis=self._columns(changes), factor=factor,
            offset=offset,
        )  # fmt: skip
        return replace(new, noise=new.estimated_noise(p))

    def draws(self, p: FloatArray) -> FloatArray:
        """Estimate of every draw where the parameters are p, in units of its prior's sd."""
        return self._absorbed(self._residual(p)) / self.noise

    def profiled_draws(self, p: FloatArray, informed: NDArray[np.bool_]) -> list[ProfiledDraw]:
        """Name, group, estimate and standard uncertainty of every profiled draw.

        The covariance of all draws is that of parameters and draws together: (I + U^T W U/s^2 -
        B (J^T W J)^-1 B^T)^-1 with B = U^T W J, over the directions that the data inform.
        """
        weight = self.inverse_variance / self.noise**2
        _, jac = self.jacobian(p)
        inner = np.eye(len(self.z0)) + self.basis.T @ (weight[:, None] * self.basis.toarray())
        if informed.any():
            jac = jac[:, informed]
            scale = np.sqrt(np.sum(weight[:, None] * jac**2, axis=0))
            jac = jac / scale
            cross = np.asarray(self.basis.T @ (weight[:, None] * jac))
            square = jac.T @ (weight[:, None] * jac)
            square = np.linalg.pinv(square, rcond=UNDETERMINED, hermitian=True)
            inner -= cross @ square @ cross.T
        sd = np.sqrt(np.diag(np.linalg.inv((inner + inner.T) / 2)).clip(0, 1))
        z = self.draws(p)
        draws: list[ProfiledDraw] = []
        for term, draw in zip(self.terms, self.draw, strict=True):
            first = int(draw.min())
            draws += [
                (term.name, label, float(z[first + k]), float(sd[first + k]))
                for k, label in enumerate(term.labels)
            ]
        return draws

    def profiled_columns(self) -> FloatArray:
        return np.asarray(self.basis.toarray())

    def profiled_change(self) -> FloatArray:
        return np.asarray(self.basis @ self.z0)

    def shared_changes(self, p: FloatArray) -> list[FloatArray]:
        f = self.moved.values(p)
        return [
            draw_slope(self.moved, term, p, f, self.factor) if term.name in self.profiled
            else draw_slope(self.moved, term, p, f, self.factor, step=1.0)
            for term in self.samples.shared
        ]  # fmt: skip

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        """Expectation of every sample at p and z0, shape (N,), sr^-1."""
        return self.moved.values(p, cells) * self.factor + self.offset

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Expectations (N,) and their derivatives by the parameters (N, parameters)."""
        f, jac = self.moved.jacobian(p)
        return f * self.factor + self.offset, jac * self.factor[:, None]

    def chi2(self, p: FloatArray) -> float:
        """s^2 r^T C^-1 r."""
        r = self._residual(p)
        a = self._absorbed(r)
        rest = r - self._root @ a
        return float(np.sum(rest * rest * self.inverse_variance) + a @ a)

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        """`chi2` of every row of parameters (B, P), shape (B,)."""
        r = np.stack([self._residual(p) for p in batch], axis=1)
        a = self._absorbed(r)
        rest = r - self._root @ a
        return np.asarray(self.inverse_variance @ (rest * rest) + np.sum(a * a, axis=0))

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """chi2, s^2 J^T C^-1 r and s^2 J^T C^-1 J at p."""
        f, jac = self.jacobian(p)
        both = np.column_stack([jac, self._off(f)])
        a = self._absorbed(both)
        rest = both - self._root @ a
        square = rest.T @ (rest * self.inverse_variance[:, None]) + a.T @ a
        return float(square[-1, -1]), square[:-1, -1], square[:-1, :-1]

    def weighted(self, columns: FloatArray) -> FloatArray:
        """s^2 C^-1 times columns (N, k)."""
        rest = columns - self._root @ self._absorbed(columns)
        return np.asarray(rest * self.inverse_variance[:, None])

    def model_at(self, directions: Directions, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.base.model_at(directions, p)

    def products(self, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        return by_jacobian.products(self, points, rows)

    def at(self, index: NDArray[np.int64]) -> NuisanceProblem:
        """The problem of these samples alone, with their cells, weights and shared errors."""
        return replace(
            self,
            moved=self.moved.at(index),
            base=self.base.at(index),
            draw=self.draw[:, index],
            basis=self.basis[index],
            factor=self.factor[index],
            offset=self.offset[index],
        )

    def subset(self, n: int) -> Problem:
        """At most n samples for starting values, without the shared errors."""
        return self.moved.subset(n)

    def estimated_noise(self, p: FloatArray) -> float:
        """s: 1, or the size of the residuals over the weights where it is larger or all we know.

        The draws take up part of the residuals, the more the smaller s is: the s that fits its own
        residuals is looked for. chi-squared over s needs no pass over the data.
        """
        r = self._residual(p)
        size, vectors = np.linalg.eigh(self._gram)
        size = np.maximum(size, 0.0)
        score = vectors.T @ (self.basis.T @ (self.inverse_variance * r))
        all_r = float(np.sum(r * r * self.inverse_variance))
        dof = max(self.n - len(self.parameters), 1)
        least = 1.0 if self.weights == "sd" else 1e-300
        s = max(least, np.sqrt(all_r / dof))
        for _ in range(200):
            before = s
            chi2 = all_r - float(np.sum(score**2 / (size + s**2)))
            s = max(least, np.sqrt(max(chi2, 1e-24 * all_r) / dof))
            if abs(s - before) <= 1e-10 * before:
                break
        return float(s)

    def _with_draws(self, base: Problem, z0: FloatArray) -> Problem:
        """A problem with its directions as the draws move them."""
        shift, turn = np.zeros((self.n, 3)), np.zeros(self.n)
        for term, z in zip(self.terms, z0[self.draw], strict=True):
            if term.shift is not None:
                shift += z[:, None] * term.shift
            elif term.turn:
                turn += z * term.turn * (1.0 if term.profile is None else term.profile)
        if not (shift.any() or turn.any()):
            return base
        return base.with_directions(shift=shift, turn=turn)

    def _columns(self, changes: list[FloatArray]) -> Any:
        """U from the change by each profiled term."""
        from scipy.sparse import csr_array

        n_terms = len(changes)
        ends = np.arange(0, self.n * n_terms + 1, n_terms)
        values = np.stack(changes, axis=1).ravel()
        return csr_array((values, self.draw.T.ravel(), ends), shape=(self.n, len(self.z0)))

    def _residual(self, p: FloatArray) -> FloatArray:
        return self._off(self.values(p))

    def _off(self, f: FloatArray) -> FloatArray:
        """y - F(p, z0) + U z0 for the expectations F(p, z0)."""
        return np.asarray(self._target - f)

    @cached_property
    def _target(self) -> FloatArray:
        """y + U z0."""
        return np.asarray(self.samples.value + self.basis @ self.z0)

    @cached_property
    def _root(self) -> Any:
        """U/s."""
        return self.basis / self.noise

    @cached_property
    def _gram(self) -> FloatArray:
        """U^T W U (draws, draws)."""
        from scipy.sparse import diags_array

        return np.asarray(
            (self.basis.T @ diags_array(self.inverse_variance) @ self.basis).toarray()
        )

    @cached_property
    def _factored(self) -> Any:
        from scipy.linalg import cho_factor

        return cho_factor(np.eye(len(self.z0)) + self._gram / self.noise**2)

    def _absorbed(self, columns: FloatArray) -> FloatArray:
        """s times the draws that residuals (N,) or (N, k) call for."""
        from scipy.linalg import cho_solve

        weighted = (self.inverse_variance * columns.T).T
        return np.asarray(cho_solve(self._factored, self._root.T @ weighted))


def _draws(terms: Sequence[SharedTerm], n: int) -> tuple[NDArray[np.int64], int]:
    """Number of each sample's draw of each term (terms, N), counted through; how many there are."""
    draw, total = np.zeros((len(terms), n), np.int64), 0
    for row, term in zip(draw, terms, strict=True):
        row[:] = term.draw(n) + total
        total = int(row.max()) + 1
    return draw, total
