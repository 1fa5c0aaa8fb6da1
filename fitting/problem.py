"""Samples + model + weights: residuals, chi-squared and normal equations, in blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError, DataError
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells

Weights = Literal["none", "cos", "coscos", "sd"]
BLOCK = 8192


@dataclass(frozen=True)
class Problem:
    """A least-squares problem over BRDF samples.

    Parameters
    ----------
    samples : BRDFSamples
    model : Model
    weights : {"none", "cos", "coscos", "sd"}
        What each residual is multiplied by: 1, cos(theta_r), cos(theta_i) cos(theta_r), or one
        over its standard uncertainty.
    inverse_variance : ndarray, shape (N,)
        Squares of those factors.
    w_i : ndarray, shape (N, 3)
    cells : Cells
        Members over which the model is integrated; one a sample where the samples have none.
    threads : int, optional
    """

    samples: BRDFSamples
    model: Model
    weights: Weights
    inverse_variance: FloatArray
    w_i: FloatArray
    cells: Cells
    threads: int | None = None

    @classmethod
    def from_samples(
        cls,
        samples: BRDFSamples,
        model: Model,
        weights: Weights | None = None,
        threads: int | None = None,
    ) -> Problem:
        """Set the problem up; the weights default to "sd" where uncertainties are known.

        Raises
        ------
        ConfigurationError
            For unknown weights, or "sd" where the samples hold no uncertainty.
        DataError
            If there are not more samples than parameters.
        """
        if weights is None:
            weights = "none" if samples.u_independent is None else "sd"
        if weights not in get_args(Weights):
            raise ConfigurationError(
                f"weights {weights!r} are unknown; allowed are {', '.join(get_args(Weights))}."
            )
        if weights == "sd" and samples.u_independent is None:
            raise ConfigurationError(
                "weights 'sd' need uncertainties and the samples have none (no u_brdf column); "
                "use none, cos or coscos."
            )
        n_p = len(model.parameters)
        if len(samples) <= n_p:
            raise DataError(
                f"{len(samples)} samples cannot decide the {n_p} parameters of {model.name}; "
                f"give at least {n_p + 1}."
            )
        w_i, w_r = samples.directions.vectors()
        cells = samples.cells or Cells(
            np.ascontiguousarray(w_r),
            np.ones(len(samples)),
            np.arange(len(samples) + 1, dtype=np.int64),
        )
        problem = cls(
            samples, model, weights, np.ones(len(samples)), np.ascontiguousarray(w_i), cells,
            threads,
        )  # fmt: skip
        return problem.reweighted(None)

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.samples)

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.model.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is fitted, in the order of every parameter vector."""
        return self.model.parameters

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Checked parameter vector, defaults filled in."""
        return self.model.vector(values)

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> Problem:
        """The problem with other bounds of its parameters."""
        return replace(self, model=replace(self.model, parameters=parameters))

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        """Variance of each sample where its expectation is f, or as stated.

        A sample's own value would give low readings too much weight and bias the fit (-0.2 % on
        a dim surface). Shot noise grows with f, the noise of the standard with f^2; a floor of a
        tenth of the stated variance keeps the result positive where the model is far off.

        Parameters
        ----------
        f : ndarray, shape (N,), optional
            Model values.
        sharing : bool
            Count the noise of a standard's frame once for each image that uses it.
        """
        samples = self.samples
        assert samples.u_independent is not None
        stated = samples.u_independent**2
        reference = np.zeros(self.n) if samples.u_reference is None else samples.u_reference**2
        total = stated
        value = np.maximum(samples.value, 0.0)
        if f is not None and samples.noise_slope is not None:
            ratio = np.clip(f / np.where(value > 0, value, np.inf), 0.7, 1.4)
            moved = np.where(value > 0, reference * ratio**2, reference)
            total = stated - reference + moved + samples.noise_slope * (f - value)
            total = np.maximum(total, 0.1 * stated)
            reference = moved
        if sharing:
            total = total + (samples.reference_sharing - 1) * reference
        return np.asarray(total)

    def reweighted(self, p: FloatArray | None) -> Problem:
        """The problem with its weights taken at the model's values for p."""
        directions = self.samples.directions
        if self.weights == "sd":
            f = None if p is None else self.values(p)
            inverse = 1 / self.variance(f, sharing=True)
        elif self.weights == "none":
            inverse = np.ones(self.n)
        else:
            inverse = np.cos(directions.theta_r) ** 2 * np.ones(self.n)
            if self.weights == "coscos":
                inverse = inverse * np.cos(directions.theta_i) ** 2
        return replace(self, inverse_variance=np.asarray(inverse))

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        """The model integrated over every cell, shape (N,), sr^-1."""
        out = np.empty(self.n)
        c = cells or self.cells
        work = self.model.loops.cell_values
        map_blocks(
            lambda a, b: work(self.w_i, c.w_r, c.weight, c.offsets, a, p, out[a:b]),
            self.n,
            threads=self.threads,
            block=BLOCK,
        )
        return out

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Model values (N,) and their derivatives (N, parameters), in one pass."""
        out, jac = np.empty(self.n), np.empty((self.n, len(p)))
        c = self.cells
        work = self.model.loops.cell_gradient
        map_blocks(
            lambda a, b: work(self.w_i, c.w_r, c.weight, c.offsets, a, p, out[a:b], jac[a:b]),
            self.n,
            threads=self.threads,
            block=BLOCK,
        )
        return out, jac

    def chi2(self, p: FloatArray) -> float:
        """Sum of squared weighted residuals."""
        r = self.samples.value - self.values(p)
        return float(np.sum(r * r * self.inverse_variance))

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """chi2, J^T W r and J^T W J at p."""
        f, jac = self.jacobian(p)
        r = self.samples.value - f
        weighted = self.weighted(jac)
        return (
            float(np.sum(r * r * self.inverse_variance)),
            weighted.T @ r,
            weighted.T @ jac,
        )

    def weighted(self, columns: FloatArray) -> FloatArray:
        """Columns (N, k) times the inverse covariance of the samples."""
        return columns * self.inverse_variance[:, None]

    def at(self, index: NDArray[np.int64]) -> Problem:
        """The problem of these samples alone, with their cells and weights."""
        return replace(
            self,
            samples=self.samples.select(index, "some samples"),
            inverse_variance=self.inverse_variance[index],
            w_i=np.ascontiguousarray(self.w_i[index]),
            cells=self.cells.select(index),
        )

    def subset(self, n: int) -> Problem:
        """At most n samples, taken at their centroids: half the brightest, half over all.

        A narrow lobe is a small part of the hemisphere; an even choice alone could miss it.
        """
        if self.n <= n:
            index = np.arange(self.n)
        else:
            brightest = np.argpartition(self.samples.value, -n // 2)[-n // 2 :]
            # Multiples of the golden ratio: spread evenly, without the period of a scan.
            even = (np.arange(n // 2) * 0.6180339887498949) % 1.0 * self.n
            index = np.union1d(brightest, even.astype(np.int64))
        samples = replace(self.samples, cells=None).select(index, "start values")
        problem = Problem.from_samples(samples, self.model, self.weights, 1)
        inverse = self.inverse_variance[index]
        if self.weights == "sd":
            # Far from the optimum a few bright samples must not decide all.
            inverse = 1 / (1 / inverse + (0.1 * samples.value) ** 2)
        return replace(problem, inverse_variance=inverse)
