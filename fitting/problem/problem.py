"""Samples + model + weights + loss: residuals, chi-squared and normal equations, in blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError, DataError
from gonio.fitting.problem import losses
from gonio.fitting.problem.losses import CHI2, Loss
from gonio.geometry import Directions, FloatArray
from gonio.kernels import map_blocks
from gonio.models import Model, Parameter
from gonio.models import get as get_model
from gonio.models._sums import SIGN
from gonio.samples import BRDFSamples, Cells

Weights = Literal["none", "cos", "coscos", "sd"]
BLOCK = 8192  # cells
PASS = 65536  # plain samples; small enough for the second cache, large enough for a thread


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
        The results do not depend on it.
    loss : {"chi2", "log", "cube_root", "student_t"}
        What is summed over the samples (`gonio.fitting.problem.losses`).
    """

    samples: BRDFSamples
    model: Model
    weights: Weights
    inverse_variance: FloatArray
    w_i: FloatArray
    cells: Cells
    threads: int | None = None
    loss: str = CHI2.name

    @classmethod
    def from_samples(
        cls,
        samples: BRDFSamples,
        model: Model,
        weights: Weights | None = None,
        threads: int | None = None,
        loss: str = CHI2.name,
    ) -> Problem:
        """Set the problem up; the weights default to "sd" where uncertainties are known.

        Raises
        ------
        ConfigurationError
            For unknown weights, "sd" where the samples hold no uncertainty, or weights that the
            loss does not take.
        DataError
            If there are not more samples than parameters, or the loss is not defined for a value.
        """
        if weights not in (None, *get_args(Weights)):
            raise ConfigurationError(
                f"weights {weights!r} are unknown; allowed are {', '.join(get_args(Weights))}."
            )
        law = losses.get(loss)
        weights = law.check_weights(weights, known=samples.u_independent is not None)
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
        parts = components(samples.directions, threads)
        law.check_values(samples.value, parts[5])
        cells = samples.cells
        n = len(samples)
        if cells is None:
            # Of many samples nothing is copied that only the loops over cells read.
            every = np.broadcast_to(1.0, n)
            cells = Cells(parts[3:].T, every, np.arange(n + 1, dtype=np.int64))
        w_i = parts[:3].T if samples.cells is None else np.ascontiguousarray(parts[:3].T)
        inverse = np.ones(n)
        problem = cls(samples, model, weights, inverse, w_i, cells, threads, loss)
        problem.__dict__["components"] = parts
        return problem._keeping(problem.reweighted(None))

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

    @cached_property
    def components(self) -> FloatArray:
        """x, y and z of the directions to the light, then to the viewer, (6, N), read-only.

        Of a cell it is its centroid that the viewer sees.
        """
        if self.plain:
            return _read_only(np.concatenate([self.w_i.T, self.cells.w_r.T]))
        seen = components(self.samples.directions, self.threads)[3:]
        return _read_only(np.concatenate([self.w_i.T, seen]))

    @property
    def plain(self) -> bool:
        """Whether the samples are points and not cells."""
        return self.samples.cells is None

    @cached_property
    def _value(self) -> FloatArray:
        return _read_only(self.samples.value)

    @cached_property
    def _inverse(self) -> FloatArray:
        return _read_only(self.inverse_variance)

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Checked parameter vector, defaults filled in."""
        return self.model.vector(values)

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> Problem:
        """The problem with other bounds of its parameters."""
        return self._keeping(replace(self, model=replace(self.model, parameters=parameters)))

    def _keeping(self, other: Problem) -> Problem:
        """The other problem, of the same samples and directions, with what was made of them."""
        for name in ("components", "_value"):
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        if other.inverse_variance is self.inverse_variance and "_inverse" in self.__dict__:
            other.__dict__["_inverse"] = self.__dict__["_inverse"]
        return other

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
        """The problem with its weights, and the scale of its loss, taken at the model's values.

        As stated where p is None.
        """
        if self.weights == "sd":
            f = None if p is None else self.values(p)
            inverse = 1 / self.variance(f, sharing=True)
        elif self.weights == "none":
            inverse = np.ones(self.n)
        else:
            directions = self.samples.directions
            inverse = np.cos(directions.theta_r) ** 2 * np.ones(self.n)
            if self.weights == "coscos":
                inverse = inverse * np.cos(directions.theta_i) ** 2
        if self.finds_scale:
            residual = self.samples.value - (0.0 if p is None else self.values(p))
            inverse = inverse / self.law.scale(residual * np.sqrt(inverse)) ** 2
        return self._keeping(replace(self, inverse_variance=np.asarray(inverse)))

    @property
    def law(self) -> Loss:
        """The loss itself."""
        return losses.LOSSES[self.loss]

    @property
    def finds_scale(self) -> bool:
        """Whether the loss needs the size of the noise and the samples do not state it."""
        return self.law.scaled and self.weights != "sd"

    @property
    def settles(self) -> bool:
        """Whether the weights depend on the model's values, so that a fit must be repeated."""
        follows = self.weights == "sd" and self.samples.noise_slope is not None
        return follows or self.finds_scale

    @property
    def sum_at_most_one(self) -> tuple[int, ...]:
        """Parameters whose sum the albedo never exceeds, so that it must be at most 1."""
        wanted = self.model.claims.albedo_at_most or ()
        names = [q.name for q in self.parameters]
        if len(wanted) < 2 or not set(wanted) <= set(names):
            return ()
        return tuple(names.index(name) for name in wanted)

    @cached_property
    def terms_of_sum(self) -> list[tuple[str, NDArray[np.int64]]]:
        """Models that this one is the sum of, with the places of their parameters."""
        names = self.model.name.split(SIGN)
        every = np.arange(len(self.parameters))
        if len(names) < 2:
            return [(self.model.name, every)]
        counts = [len(get_model(name).parameters) for name in names]
        if sum(counts) != len(every):  # parameters that several channels have of their own
            return [(self.model.name, every)]
        return list(zip(names, np.split(every, np.cumsum(counts)[:-1]), strict=True))

    @property
    def quadratic(self) -> bool:
        """Whether chi2 is quadratic in the linear parameters."""
        return self.loss == CHI2.name

    @property
    def _fused(self) -> bool:
        """Whether compiled loops make the sums; derived classes have sums of their own."""
        return type(self) is Problem and self.quadratic

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        """The model integrated over every cell, shape (N,), sr^-1."""
        out = np.empty(self.n)
        if cells is None and self.plain:
            parts, plain = tuple(self.components), self.model.loops.evaluate
            self._map(lambda a, b: plain(*(x[a:b] for x in parts), p, out[a:b]), PASS)
            return out
        c, w_i = _contiguous(cells or self.cells), np.ascontiguousarray(self.w_i)
        work = self.model.loops.cell_values
        self._map(lambda a, b: work(w_i, c.w_r, c.weight, c.offsets, a, p, out[a:b]), BLOCK)
        return out

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Model values (N,) and their derivatives (N, parameters), in one pass."""
        out = np.empty(self.n)
        if self.plain:
            parts, plain = tuple(self.components), self.model.loops.evaluate_gradient
            rows = np.empty((len(p), self.n))
            self._map(lambda a, b: plain(*(x[a:b] for x in parts), p, out[a:b], rows[:, a:b]), PASS)
            return out, rows.T
        jac = np.empty((self.n, len(p)))
        c, w_i = self.cells, np.ascontiguousarray(self.w_i)
        work = self.model.loops.cell_gradient
        self._map(
            lambda a, b: work(w_i, c.w_r, c.weight, c.offsets, a, p, out[a:b], jac[a:b]), BLOCK
        )
        return out, jac

    def chi2(self, p: FloatArray) -> float:
        """Sum of squared weighted residuals, or the loss in their place."""
        if self._fused and self.plain:
            return float(self.batch_chi2(p[None])[0])
        y, w = self.samples.value, self.inverse_variance
        return self.law.total(y, self.values(p), w, self.components[5])

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        """`chi2` for each parameter vector of a batch.

        Where the loss is a likelihood: minus twice its logarithm, but for a constant.

        Parameters
        ----------
        batch : ndarray, shape (B, parameters)

        Returns
        -------
        ndarray, shape (B,)
        """
        if not (self._fused and self.plain):
            return np.array([self.chi2(p) for p in batch])
        batch = np.ascontiguousarray(batch)
        s, value, inverse = self.components, self._value, self._inverse
        work = self.model.loops.sums_of_squares
        block = self._block(PASS)
        parts = np.empty((-(-self.n // block), len(batch)))
        self._map(lambda a, b: work(s, value, inverse, batch, a, b, parts[a // block]), PASS)
        return np.asarray(parts.sum(axis=0))

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """chi2, J^T W r and J^T W J at p.

        For another loss than chi-squared: the loss, minus half its slope, and a curvature that is
        not negative.
        """
        if self._fused:
            g = self.products(p[None], np.arange(len(p) + 1))[0]
            return float(g[0, 0]), g[0, 1:].copy(), g[1:, 1:].copy()
        f, jac = self.jacobian(p)
        y, w, cos_r = self.samples.value, self.inverse_variance, self.components[5]
        r, v = self.law.linearised(y, f, w, cos_r)
        weighted = jac * v[:, None]
        return self.law.total(y, f, w, cos_r), weighted.T @ r, weighted.T @ jac

    def products(self, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        """Weighted sums of products of [residual, df/dp_1, ...] at each point.

        Parameters
        ----------
        points : ndarray, shape (B, parameters)
        rows : ndarray of int64, shape (R,)
            Columns that are wanted, 0 being the residual, which comes first.

        Returns
        -------
        ndarray, shape (B, R, R)
        """
        size = (len(points), len(rows), len(rows))
        if not self._fused:
            return np.array([_chosen(*self.normal_equations(p), rows) for p in points])
        points = np.ascontiguousarray(points)
        value, inverse, loops = self._value, self._inverse, self.model.loops
        if self.plain:
            s, block = self.components, self._block(PASS)
            parts = np.empty((-(-self.n // block), *size))
            plain = loops.normal_equations
            self._map(
                lambda a, b: plain(s, value, inverse, points, rows, a, b, parts[a // block]), PASS
            )
            return np.asarray(parts.sum(axis=0))
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

    def _map(self, work: Any, block: int) -> None:
        map_blocks(work, self.n, threads=self.threads, block=self._block(block))

    def _block(self, block: int) -> int:
        """Samples that one call of a loop takes; a costly model shares small blocks out."""
        return 256 if self.model.costly else block

    def weighted(self, columns: FloatArray) -> FloatArray:
        """Columns (N, k) times the inverse covariance of the samples."""
        return columns * self.inverse_variance[:, None]

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        """Problems of which this is the sum, with the places of their samples and parameters.

        A problem over one BRDF is its own only piece.
        """
        return [(self, slice(0, self.n), np.arange(len(self.parameters)))]

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        """A problem in which parameter j alone is followed, and its parameters' places in this one.

        Over one BRDF it is the problem itself.

        Parameters
        ----------
        p, h : ndarray
            A minimum of chi-squared and J^T W J there.
        j : int
        """
        return self, np.arange(len(p))

    def at(self, index: NDArray[np.int64]) -> Problem:
        """The problem of these samples alone, with their cells and weights."""
        return replace(
            self,
            samples=self.samples.select(index, "some samples"),
            inverse_variance=self.inverse_variance[index],
            w_i=np.ascontiguousarray(self.w_i[index]),
            cells=self.cells.select(index),
        )

    @cached_property
    def _subsets(self) -> dict[int, Problem]:
        return {}

    def subset(self, n: int) -> Problem:
        """At most n samples, taken at their centroids: half the brightest, half over all.

        A narrow lobe is a small part of the hemisphere; an even choice alone could miss it.
        """
        if n not in self._subsets:
            self._subsets[n] = self._subset(n)
        return self._subsets[n]

    def _subset(self, n: int) -> Problem:
        samples, inverse, parts = self.samples, self.inverse_variance, self.components
        if self.n > n:
            # Multiples of the golden ratio: spread evenly, without the period of a scan.
            even = (np.arange(n // 2) * 0.6180339887498949) % 1.0 * self.n
            taken = np.zeros(self.n, bool)
            taken[_brightest(samples.value, n // 2)] = True
            taken[even.astype(np.int64)] = True
            index = np.flatnonzero(taken)
            samples = samples.select(index, "start values")
            inverse, parts = inverse[index], _read_only(parts[:, index])
        if samples.cells is not None:
            samples = replace(samples, cells=None)
        if self.weights == "sd":
            # Far from the optimum a few bright samples must not decide all.
            inverse = 1 / (1 / inverse + (0.1 * samples.value) ** 2)
        members = len(samples)
        points = Cells(
            parts[3:].T, np.broadcast_to(1.0, members), np.arange(members + 1, dtype=np.int64)
        )
        chosen = replace(
            self, samples=samples, inverse_variance=inverse, w_i=parts[:3].T, cells=points,
            threads=1,
        )  # fmt: skip
        chosen.__dict__["components"] = parts
        return chosen


def components(directions: Directions, threads: int | None = None) -> FloatArray:
    """Components (6, N) of the unit vectors towards the light and towards the viewer."""
    from gonio.kernels import angles

    (n,) = directions.shape
    out = np.empty((6, n))
    given = [
        np.ascontiguousarray(np.broadcast_to(getattr(directions, name), (n,)))
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    ]

    def work(a: int, b: int) -> None:
        for k in (0, 1):
            theta, phi = (_read_only(each[a:b]) for each in given[2 * k : 2 * k + 2])
            angles.components(theta, phi, *(row[a:b] for row in out[3 * k : 3 * k + 3]))

    map_blocks(work, n, threads=threads, block=PASS)
    return _read_only(out)


def _chosen(chi2: float, g: FloatArray, h: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    """Normal equations as `products` gives them."""
    full = np.empty((len(g) + 1, len(g) + 1))
    full[0, 0], full[0, 1:], full[1:, 0], full[1:, 1:] = chi2, g, g, h
    return full[np.ix_(rows, rows)]


def _contiguous(c: Cells) -> Cells:
    """The cells in the layout for which the loops are compiled."""
    return Cells(np.ascontiguousarray(c.w_r), np.ascontiguousarray(c.weight), c.offsets)


def _read_only(array: FloatArray) -> FloatArray:
    """A view that may not be written: loops are compiled anew for arrays that may be."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def _brightest(value: FloatArray, n: int) -> NDArray[np.int64]:
    """Indices of the n largest values; of many, a threshold is found on a few of them first."""
    if len(value) > 16 * n:
        few = value[:: len(value) // (8 * n)]
        threshold = np.quantile(few, 1 - 2 * n / len(value))
        index = np.flatnonzero(value >= threshold)
        if len(index) >= n:
            return index[np.argpartition(value[index], -n)[-n:]]
    return np.argpartition(value, -n)[-n:]
