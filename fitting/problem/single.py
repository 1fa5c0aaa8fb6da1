"""Samples of one BRDF and a model: residuals, chi-squared and normal equations, in blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import DataError
from gonio.fitting.problem import by_jacobian, losses, unknowns, weighting
from gonio.fitting.problem.losses import CHI2, Loss
from gonio.fitting.problem.noise_law import NoiseLaw, noise_law
from gonio.fitting.problem.protocol import Problem, ProfiledDraw, Weights
from gonio.fitting.problem.shared_change import shared_changes
from gonio.fitting.problem.unknowns import KernelParameters, Reported
from gonio.fitting.problem.viewed_samples import (
    PASS,
    ViewedSamples,
    bright_and_even,
    read_only,
)
from gonio.geometry import Directions, FloatArray
from gonio.kernels import map_blocks
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells
from gonio.wording import counted

BLOCK = 8192  # cells of one pass
COSTLY_BLOCK = 256  # of a costly model, to share the work out


@dataclass(frozen=True)
class SingleProblem:
    """A least-squares problem over the samples of one BRDF; see `Problem`.

    Parameters
    ----------
    view : ViewedSamples
    model : Model
    parameters : tuple of Parameter
        Those of the model, perhaps with other bounds.
    weights : {"none", "cos", "coscos", "relative", "sd"}
        What each residual is multiplied by: 1, cos(theta_r), cos(theta_i) cos(theta_r), one over
        the model's value, or one over its standard uncertainty.
    inverse_variance : ndarray, shape (N,)
        Squares of those factors.
    law : Loss
        What is summed over the samples (`gonio.fitting.problem.losses`).
    noise_law : NoiseLaw, optional
        By which the stated uncertainties follow the readings, where they do.
    """

    view: ViewedSamples
    model: Model
    parameters: tuple[Parameter, ...]
    weights: Weights
    inverse_variance: FloatArray
    law: Loss = CHI2
    noise_law: NoiseLaw | None = None

    @classmethod
    def from_samples(
        cls,
        samples: BRDFSamples,
        model: Model,
        weights: Weights | None = None,
        threads: int | None = None,
        loss: str = CHI2.name,
        n_unknowns: int | None = None,
    ) -> SingleProblem:
        """Set the problem up; the weights default to "sd" where uncertainties are known.

        `n_unknowns` is the number of parameters that are fitted, by default all of the model's.

        Raises
        ------
        ConfigurationError
            For unknown weights, "sd" where the samples hold no uncertainty, or weights that the
            loss does not take.
        DataError
            If there are not more samples than unknowns, or the loss is not defined for a value.
        """
        law = losses.get(loss)
        chosen = weighting.checked_weights(weights, law, samples)
        n_p = len(model.parameters) if n_unknowns is None else n_unknowns
        if len(samples) <= n_p:
            raise DataError(
                f"{counted(len(samples), 'sample')} cannot determine the "
                f"{counted(n_p, 'parameter')} of {model.name}; "
                f"give at least {n_p + 1}."
            )
        view = ViewedSamples.of(samples, threads)
        law.check_values(samples.value, view.components[5])
        inverse = weighting.inverse_variance(samples, chosen, law, None)
        return cls(view, model, model.parameters, chosen, inverse, law)

    @property
    def samples(self) -> BRDFSamples:
        return self.view.samples

    @property
    def name(self) -> str:
        return self.model.name

    @cached_property
    def n(self) -> int:
        return len(self.view)

    @property
    def reported(self) -> tuple[Reported, ...]:
        return tuple(Reported(q, j) for j, q in enumerate(self.parameters))

    @property
    def threads(self) -> int | None:
        return self.view.threads

    @property
    def w_i(self) -> FloatArray:
        return self.view.w_i

    @property
    def cells(self) -> Cells:
        return self.view.cells

    @property
    def cos_theta_r(self) -> FloatArray:
        return np.asarray(self.view.components[5])

    @property
    def quadratic(self) -> bool:
        return self.law is CHI2

    @property
    def finds_scale(self) -> bool:
        return weighting.finds_scale(self.weights, self.law)

    @property
    def weights_follow_model(self) -> bool:
        by_law = self.noise_law is not None and self.weights == "sd"
        return by_law or weighting.follow_model(self.samples, self.weights, self.law)

    @property
    def noise_laws(self) -> tuple[NoiseLaw | None, ...]:
        return (self.noise_law,)

    @property
    def sum_limit(self) -> FloatArray:
        return unknowns.sum_limit(self.model, self.parameters)

    @cached_property
    def terms_of_sum(self) -> list[tuple[str, NDArray[np.int64]]]:
        return unknowns.terms_of_sum(self.model, self.parameters)

    @property
    def kernel_parameters(self) -> KernelParameters | None:
        return KernelParameters.every(len(self.parameters)) if self.quadratic else None

    @property
    def independent(self) -> SingleProblem:
        return self

    @property
    def profiled(self) -> tuple[str, ...]:
        return ()

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        return self.model.vector(values)

    # ------------------------------------------------------------------ problems made from this one

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> SingleProblem:
        return replace(self, parameters=parameters)

    def with_weights(self, inverse_variance: FloatArray) -> SingleProblem:
        return replace(self, inverse_variance=inverse_variance)

    def as_least_squares(self, p: FloatArray | None = None) -> SingleProblem:
        if p is None or self.quadratic:
            return replace(self, law=CHI2)
        f = self.values(p)
        residual, weight = self.law.pseudo_residuals(
            self.samples.value, f, self.inverse_variance, self.cos_theta_r
        )
        view = self.view.with_values(f + residual)
        weights: Weights = "relative" if self.law.relative else self.weights
        return replace(self, law=CHI2, view=view, weights=weights, inverse_variance=weight)

    def reweighted(self, p: FloatArray | None) -> SingleProblem:
        f = None
        if p is not None and (self.weights in ("sd", "relative") or self.finds_scale):
            f = self.values(p)
        inverse = weighting.inverse_variance(
            self.samples, self.weights, self.law, f, self.noise_law
        )
        return replace(self, inverse_variance=inverse)

    def with_noise_law(self, p: FloatArray) -> SingleProblem:
        s = self.samples
        if s.u_independent is None or s.noise_slope is not None or s.u_reference is not None:
            return self
        return replace(self, noise_law=noise_law(s.value, s.u_independent, self.values(p)))

    def with_directions(
        self, *, shift: FloatArray | None = None, turn: float | FloatArray = 0.0
    ) -> SingleProblem:
        return replace(self, view=self.view.moved(shift, turn))

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        return [(self, slice(0, self.n), np.arange(len(self.parameters)))]

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        return self, np.arange(len(p))

    def at(self, index: NDArray[np.int64]) -> SingleProblem:
        return replace(
            self, view=self.view.at(index), inverse_variance=self.inverse_variance[index]
        )

    @cached_property
    def _subsets(self) -> dict[int, SingleProblem]:
        return {}

    def subset(self, n: int) -> SingleProblem:
        if n not in self._subsets:
            index = bright_and_even(self.samples.value, n) if self.n > n else None
            inverse = self.inverse_variance if index is None else self.inverse_variance[index]
            view = self.view.centroids(index)
            if self.weights == "sd":
                # Far from the optimum a few bright samples must not decide all.
                inverse = 1 / (1 / inverse + (0.1 * view.samples.value) ** 2)
            self._subsets[n] = replace(self, view=view, inverse_variance=inverse)
        return self._subsets[n]

    # ------------------------------------------------------------------ values and sums

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        return weighting.variance_about(self.samples, f, sharing=sharing, law=self.noise_law)

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        out = np.empty(self.n)
        if cells is None and self.view.are_points:
            parts, evaluate = tuple(self.view.components), self.model.loops.evaluate
            self._map(lambda a, b: evaluate(*(x[a:b] for x in parts), p, out[a:b]), PASS)
            return out
        c, w_i = _contiguous(cells or self.cells), np.ascontiguousarray(self.w_i)
        work = self.model.loops.cell_values
        self._map(lambda a, b: work(w_i, c.w_r, c.weight, c.offsets, a, p, out[a:b]), BLOCK)
        return out

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        out = np.empty(self.n)
        if self.view.are_points:
            parts, evaluate = tuple(self.view.components), self.model.loops.evaluate_gradient
            rows = np.empty((len(p), self.n))
            self._map(
                lambda a, b: evaluate(*(x[a:b] for x in parts), p, out[a:b], rows[:, a:b]), PASS
            )
            return out, rows.T
        jac = np.empty((self.n, len(p)))
        c, w_i = self.cells, np.ascontiguousarray(self.w_i)
        work = self.model.loops.cell_gradient
        self._map(
            lambda a, b: work(w_i, c.w_r, c.weight, c.offsets, a, p, out[a:b], jac[a:b]), BLOCK
        )
        return out, jac

    def model_at(self, directions: Directions, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        samples = BRDFSamples(directions, np.zeros(directions.shape[0]))
        there = ViewedSamples.of(samples, self.threads)
        return replace(self, view=there, inverse_variance=np.ones(len(there))).jacobian(p)

    def chi2(self, p: FloatArray) -> float:
        if self.quadratic and self.view.are_points:
            return float(self.batch_chi2(p[None])[0])
        return by_jacobian.loss(self, p)

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        if not (self.quadratic and self.view.are_points):
            return np.array([self.chi2(p) for p in batch])
        batch = np.ascontiguousarray(batch)
        s, value, inverse = self.view.components, self.view.value, self._inverse
        work = self.model.loops.sums_of_squares
        block = self._block(PASS)
        parts = np.empty((-(-self.n // block), len(batch)))
        self._map(lambda a, b: work(s, value, inverse, batch, a, b, parts[a // block]), PASS)
        return parts[0] if len(parts) == 1 else np.asarray(parts.sum(axis=0))

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        if not self.quadratic:
            return by_jacobian.normal_equations(self, p)
        g = self.products(p[None], np.arange(len(p) + 1))[0]
        return float(g[0, 0]), g[0, 1:].copy(), g[1:, 1:].copy()

    def products(self, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        if not self.quadratic:
            return by_jacobian.products(self, points, rows)
        size = (len(points), len(rows), len(rows))
        points = np.ascontiguousarray(points)
        value, inverse, loops = self.view.value, self._inverse, self.model.loops
        if self.view.are_points:
            s, block = self.view.components, self._block(PASS)
            parts = np.empty((-(-self.n // block), *size))
            sums = loops.normal_equations
            self._map(
                lambda a, b: sums(s, value, inverse, points, rows, a, b, parts[a // block]), PASS
            )
            return parts[0] if len(parts) == 1 else np.asarray(parts.sum(axis=0))
        block = self._block(BLOCK)
        parts = np.empty((-(-self.n // block), *size))
        c, w_i = self.cells, np.ascontiguousarray(self.w_i)
        work = loops.cell_normal_equations
        for k, p in enumerate(points):

            def run(a: int, b: int, k: int = k, p: FloatArray = p) -> None:
                work(
                    w_i, c.w_r, c.weight, c.offsets, value, inverse, p, rows, a, b,
                    parts[a // block, k : k + 1],
                )  # fmt: skip

            self._map(run, BLOCK)
        return np.asarray(parts.sum(axis=0))

    def weighted(self, columns: FloatArray) -> FloatArray:
        return weighting.weighted(columns, self.inverse_variance)

    def profiled_draws(self, p: FloatArray, informed: NDArray[np.bool_]) -> list[ProfiledDraw]:
        return []

    def profiled_columns(self) -> FloatArray:
        return np.zeros((self.n, 0))

    def profiled_change(self) -> FloatArray:
        return np.zeros(self.n)

    def shared_changes(self, p: FloatArray) -> list[FloatArray]:
        return shared_changes(self, p)

    @cached_property
    def _inverse(self) -> FloatArray:
        return read_only(self.inverse_variance)

    def _map(self, work: Any, block: int) -> None:
        map_blocks(work, self.n, threads=self.threads, block=self._block(block))

    def _block(self, block: int) -> int:
        """Samples that one call of a loop takes."""
        return COSTLY_BLOCK if self.model.costly else block


def _contiguous(c: Cells) -> Cells:
    """The cells in the layout for which the loops are compiled."""
    return Cells(np.ascontiguousarray(c.w_r), np.ascontiguousarray(c.weight), c.offsets)
