"""A problem whose parameters other data hold near a centre: a quadratic penalty is added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem import by_jacobian
from gonio.fitting.problem.losses import Loss
from gonio.fitting.problem.noise_law import NoiseLaw
from gonio.fitting.problem.protocol import Problem, ProfiledDraw, Weights
from gonio.fitting.problem.unknowns import KernelParameters, Reported
from gonio.geometry import Directions, FloatArray
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells


@dataclass(frozen=True)
class PenalisedProblem:
    """(p - centre)^T stiffness (p - centre) added to the chi-squared of a problem; see `Problem`.

    Parameters
    ----------
    data : Problem
        Over one BRDF.
    centre : ndarray, shape (P,)
    stiffness : ndarray, shape (P, P)
    """

    data: Problem
    centre: FloatArray
    stiffness: FloatArray

    @property
    def samples(self) -> BRDFSamples:
        return self.data.samples

    @property
    def model(self) -> Model:
        return self.data.model

    @property
    def name(self) -> str:
        return self.data.name

    @property
    def n(self) -> int:
        return self.data.n

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.data.parameters

    @property
    def reported(self) -> tuple[Reported, ...]:
        return self.data.reported

    @property
    def weights(self) -> Weights:
        return self.data.weights

    @property
    def law(self) -> Loss:
        return self.data.law

    @property
    def threads(self) -> int | None:
        return self.data.threads

    @property
    def w_i(self) -> FloatArray:
        return self.data.w_i

    @property
    def cells(self) -> Cells:
        return self.data.cells

    @property
    def cos_theta_r(self) -> FloatArray:
        return self.data.cos_theta_r

    @property
    def inverse_variance(self) -> FloatArray:
        return self.data.inverse_variance

    @property
    def quadratic(self) -> bool:
        return self.data.quadratic

    @property
    def finds_scale(self) -> bool:
        return self.data.finds_scale

    @property
    def weights_follow_model(self) -> bool:
        return self.data.weights_follow_model

    @property
    def noise_laws(self) -> tuple[NoiseLaw | None, ...]:
        return self.data.noise_laws

    @property
    def sum_limit(self) -> FloatArray:
        return self.data.sum_limit

    @property
    def terms_of_sum(self) -> list[tuple[str, NDArray[np.int64]]]:
        return self.data.terms_of_sum

    @property
    def kernel_parameters(self) -> KernelParameters | None:
        return None

    @property
    def independent(self) -> Problem:
        return self

    @property
    def profiled(self) -> tuple[str, ...]:
        return self.data.profiled

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        return self.data.vector(values)

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> PenalisedProblem:
        return replace(self, data=self.data.with_parameters(parameters))

    def with_weights(self, inverse_variance: FloatArray) -> PenalisedProblem:
        return replace(self, data=self.data.with_weights(inverse_variance))

    def as_least_squares(self, p: FloatArray | None = None) -> PenalisedProblem:
        return replace(self, data=self.data.as_least_squares(p))

    def reweighted(self, p: FloatArray | None) -> PenalisedProblem:
        return replace(self, data=self.data.reweighted(p))

    def with_noise_law(self, p: FloatArray) -> PenalisedProblem:
        return replace(self, data=self.data.with_noise_law(p))

    def with_directions(
        self, *, shift: FloatArray | None = None, turn: float | FloatArray = 0.0
    ) -> PenalisedProblem:
        return replace(self, data=self.data.with_directions(shift=shift, turn=turn))

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        return [(self, slice(0, self.n), np.arange(len(self.parameters)))]

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        return self, np.arange(len(p))

    def at(self, index: NDArray[np.int64]) -> PenalisedProblem:
        return replace(self, data=self.data.at(index))

    def subset(self, n: int) -> PenalisedProblem:
        return replace(self, data=self.data.subset(n))

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        return self.data.variance(f, sharing=sharing)

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        return self.data.values(p, cells)

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.data.jacobian(p)

    def model_at(self, directions: Directions, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.data.model_at(directions, p)

    def chi2(self, p: FloatArray) -> float:
        step = p - self.centre
        return by_jacobian.loss(self.data, p) + float(step @ self.stiffness @ step)

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        return np.array([self.chi2(p) for p in batch])

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        chi2, g, h = by_jacobian.normal_equations(self.data, p)
        step = p - self.centre
        pull = self.stiffness @ step
        return chi2 + float(step @ pull), g - pull, h + self.stiffness

    def products(self, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        return by_jacobian.products(self, points, rows)

    def weighted(self, columns: FloatArray) -> FloatArray:
        return self.data.weighted(columns)

    def profiled_draws(self, p: FloatArray, informed: NDArray[np.bool_]) -> list[ProfiledDraw]:
        return self.data.profiled_draws(p, informed)

    def profiled_columns(self) -> FloatArray:
        return self.data.profiled_columns()

    def profiled_change(self) -> FloatArray:
        return self.data.profiled_change()

    def shared_changes(self, p: FloatArray) -> list[FloatArray]:
        return self.data.shared_changes(p)
