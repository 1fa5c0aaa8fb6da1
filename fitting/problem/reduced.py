"""A problem some of whose parameters are fixed or tied: it has fewer unknowns than its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.errors import unknown_name
from gonio.fitting.problem import unknowns
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.losses import Loss
from gonio.fitting.problem.noise_law import NoiseLaw
from gonio.fitting.problem.protocol import Problem, ProfiledDraw, Weights
from gonio.fitting.problem.shared_change import shared_changes
from gonio.fitting.problem.unknowns import KernelParameters, Reported
from gonio.geometry import Directions, FloatArray
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells


@dataclass(frozen=True)
class ReducedProblem:
    """The problem of the unknowns that fixed and tied parameters leave; see `Problem`.

    With x the parameters of the model and p the unknowns, x = x_0 + E p: a row of E is zero where
    a parameter is fixed, and tied ones have their 1 in the same column. Derivatives by p are those
    by x times E.

    Parameters
    ----------
    whole : Problem
        Over one BRDF, of all parameters of the model.
    parameters : tuple of Parameter
        The unknowns.
    kernel : KernelParameters
        x_0 and E.
    reported : tuple of Reported
    """

    whole: Problem
    parameters: tuple[Parameter, ...]
    kernel: KernelParameters
    reported: tuple[Reported, ...]

    @classmethod
    def of(cls, whole: Problem, constraints: Constraints) -> ReducedProblem:
        """The problem with parameters of its model fixed or tied."""
        return cls(whole, *constraints.unknowns(whole.model))

    @property
    def samples(self) -> BRDFSamples:
        return self.whole.samples

    @property
    def model(self) -> Model:
        return self.whole.model

    @property
    def name(self) -> str:
        return self.whole.name

    @property
    def n(self) -> int:
        return self.whole.n

    @property
    def weights(self) -> Weights:
        return self.whole.weights

    @property
    def law(self) -> Loss:
        return self.whole.law

    @property
    def threads(self) -> int | None:
        return self.whole.threads

    @property
    def w_i(self) -> FloatArray:
        return self.whole.w_i

    @property
    def cells(self) -> Cells:
        return self.whole.cells

    @property
    def cos_theta_r(self) -> FloatArray:
        return self.whole.cos_theta_r

    @property
    def inverse_variance(self) -> FloatArray:
        return self.whole.inverse_variance

    @property
    def quadratic(self) -> bool:
        return self.whole.quadratic

    @property
    def finds_scale(self) -> bool:
        return self.whole.finds_scale

    @property
    def weights_follow_model(self) -> bool:
        return self.whole.weights_follow_model

    @property
    def noise_laws(self) -> tuple[NoiseLaw | None, ...]:
        return self.whole.noise_laws

    @property
    def sum_limit(self) -> FloatArray:
        """Of the unknowns, what is fixed taken off; a single one is limited by its bound."""
        c = unknowns.sum_limit(self.model, self.model.parameters)
        shares = self.kernel.reduced(c[None])[0]
        if np.count_nonzero(shares) < 2:
            return np.zeros(len(self.parameters))
        return np.asarray(shares / (1 - float(c @ self.kernel.values)))

    @property
    def terms_of_sum(self) -> list[tuple[str, NDArray[np.int64]]]:
        terms: list[tuple[str, NDArray[np.int64]]] = []
        taken: set[int] = set()
        for k, (name, arguments) in enumerate(self.whole.terms_of_sum):
            indices = self.kernel.source[arguments]
            own = [j for j in dict.fromkeys(indices.tolist()) if j >= 0 and j not in taken]
            taken |= set(own)
            # A term with fixed or tied parameters cannot change places with another one.
            whole = len(own) == len(arguments)
            shared = any(np.count_nonzero(self.kernel.source == j) > 1 for j in own)
            label = name if whole and not shared else f"{name}, term {k}"
            if own:
                terms.append((label, np.array(own, np.int64)))
        return terms

    @property
    def kernel_parameters(self) -> KernelParameters | None:
        return self.kernel if self.whole.kernel_parameters is not None else None

    @property
    def independent(self) -> ReducedProblem:
        return self

    @property
    def profiled(self) -> tuple[str, ...]:
        return ()

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        names = [q.name for q in self.parameters]
        for name in values:
            if name not in names:
                raise unknown_name("free parameter", name, names, of=self.name)
        return np.array([q.check(values.get(q.name, self._default(q))) for q in self.parameters])

    def _default(self, q: Parameter) -> float:
        return min(max(q.default, q.lower), q.upper)

    # ------------------------------------------------------------------ problems made from this one

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> ReducedProblem:
        return replace(self, parameters=parameters)

    def with_weights(self, inverse_variance: FloatArray) -> ReducedProblem:
        return replace(self, whole=self.whole.with_weights(inverse_variance))

    def as_least_squares(self, p: FloatArray | None = None) -> ReducedProblem:
        x = None if p is None else self.kernel.expanded(p)
        return replace(self, whole=self.whole.as_least_squares(x))

    def reweighted(self, p: FloatArray | None) -> ReducedProblem:
        x = None if p is None else self.kernel.expanded(p)
        return replace(self, whole=self.whole.reweighted(x))

    def with_noise_law(self, p: FloatArray) -> ReducedProblem:
        return replace(self, whole=self.whole.with_noise_law(self.kernel.expanded(p)))

    def with_directions(
        self, *, shift: FloatArray | None = None, turn: float | FloatArray = 0.0
    ) -> ReducedProblem:
        return replace(self, whole=self.whole.with_directions(shift=shift, turn=turn))

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        return [(self, slice(0, self.n), np.arange(len(self.parameters)))]

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        return self, np.arange(len(p))

    def at(self, index: NDArray[np.int64]) -> ReducedProblem:
        return replace(self, whole=self.whole.at(index))

    def subset(self, n: int) -> ReducedProblem:
        return replace(self, whole=self.whole.subset(n))

    # ------------------------------------------------------------------ values and sums

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        return self.whole.variance(f, sharing=sharing)

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        return self.whole.values(self.kernel.expanded(p), cells)

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        f, jac = self.whole.jacobian(self.kernel.expanded(p))
        return f, self.kernel.reduced(jac)

    def model_at(self, directions: Directions, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        f, jac = self.whole.model_at(directions, self.kernel.expanded(p))
        return f, self.kernel.reduced(jac)

    def chi2(self, p: FloatArray) -> float:
        return self.whole.chi2(self.kernel.expanded(p))

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        return self.whole.batch_chi2(self.kernel.expanded(batch))

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        chi2, g, h = self.whole.normal_equations(self.kernel.expanded(p))
        return chi2, self.kernel.reduced(g[None])[0], self._squared(h)

    def products(self, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        # The columns of the whole problem that the wanted ones are sums of, the residual first.
        wanted = {int(j): k for k, j in enumerate(rows)}
        columns = [(0, 0)] if 0 in wanted else []
        columns += [(x + 1, wanted[j + 1]) for x, j in enumerate(self.kernel.source.tolist())
                    if j >= 0 and j + 1 in wanted]  # fmt: skip
        full = self.whole.products(
            self.kernel.expanded(points), np.array([x for x, _ in columns], np.int64)
        )
        adds = np.zeros((len(columns), len(rows)))
        adds[np.arange(len(columns)), [k for _, k in columns]] = 1.0
        return np.asarray(adds.T @ full @ adds)

    def weighted(self, columns: FloatArray) -> FloatArray:
        return self.whole.weighted(columns)

    def profiled_draws(self, p: FloatArray, informed: NDArray[np.bool_]) -> list[ProfiledDraw]:
        return []

    def profiled_columns(self) -> FloatArray:
        return np.zeros((self.n, 0))

    def profiled_change(self) -> FloatArray:
        return np.zeros(self.n)

    def shared_changes(self, p: FloatArray) -> list[FloatArray]:
        return shared_changes(self, p)

    def _squared(self, h: FloatArray) -> FloatArray:
        """E^T h E."""
        return self.kernel.reduced(self.kernel.reduced(h).T)
