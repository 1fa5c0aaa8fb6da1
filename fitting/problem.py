"""Samples + model + weights: residuals, chi-squared and normal equations, in blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gonio.errors import ConfigurationError, DataError
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks
from gonio.models import Model
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

    def variance(self, model_values: FloatArray | None) -> FloatArray:
        """Variance of each sample, shot noise taken from the model where that is possible.

        A sample's own value would give low readings too much weight and bias the fit
        (-0.2 % on a dim surface); a floor of a tenth of the stated variance keeps the result
        positive where the model is far off.
        """
        samples = self.samples
        assert samples.u_independent is not None
        stated = samples.u_independent**2
        if model_values is None or samples.noise_slope is None:
            return stated
        moved = stated + samples.noise_slope * (model_values - samples.value)
        return np.maximum(moved, 0.1 * stated)

    def reweighted(self, p: FloatArray | None) -> Problem:
        """The problem with its weights taken at the model's values for p."""
        directions = self.samples.directions
        if self.weights == "sd":
            variance = self.variance(None if p is None else self.values(p))
            if self.samples.u_reference is not None:
                # Images that share a standard frame share its noise: counted once for each.
                variance = variance + (
                    (self.samples.reference_sharing - 1) * self.samples.u_reference**2
                )
            inverse = 1 / variance
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
        weighted = jac * self.inverse_variance[:, None]
        return (
            float(np.sum(r * r * self.inverse_variance)),
            weighted.T @ r,
            weighted.T @ jac,
        )

    def subset(self, n: int, rng: np.random.Generator) -> Problem:
        """At most n samples, taken at their centroids: half the brightest, half at random.

        A narrow lobe is a small part of the hemisphere; a random choice alone could miss it.
        """
        if self.n <= n:
            index = np.arange(self.n)
        else:
            brightest = np.argpartition(self.samples.value, -n // 2)[-n // 2 :]
            index = np.union1d(brightest, rng.choice(self.n, n // 2, replace=False))
        samples = replace(self.samples, cells=None).select(index, "start values")
        problem = Problem.from_samples(samples, self.model, self.weights, 1)
        inverse = self.inverse_variance[index]
        if self.weights == "sd":
            # Far from the optimum a few bright samples must not decide all.
            inverse = 1 / (1 / inverse + (0.1 * samples.value) ** 2)
        return replace(problem, inverse_variance=inverse)
