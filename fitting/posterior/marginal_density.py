"""The marginal posterior of one model with independent noise, by compiled sums."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gonio.fitting.posterior.density import (
    Target,
)
from gonio.fitting.posterior.priors import Prior
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks, moment_loops_for

AMPLITUDES = 2  # integrated out at most
EXACT_MEMBERS = 50_000  # with so few cell members every likelihood integrates over the cells
SAMPLES = 4096  # of one piece of work: their directions fit the second cache
VECTORS = 64  # parameter vectors of one piece of work
EXPANSION = 4.0  # standard deviations over which the cell factors are expanded
LARGEST_FACTOR = 100.0


class MarginalTarget(Target):
    """The posterior of one model with independent noise, by compiled sums.

    Where samples have many cell members each part of f is taken at one of them a sample times a
    factor that integrates it over the cell; the factor is expanded to first order in the
    parameters about the mode, from differences a standard deviation wide. `worst_error` tells
    what this costs over the posterior; with few members the cells are integrated over every time.
    """

    def __init__(
        self,
        problem: Problem,
        mode: FloatArray,
        scale: float,
        priors: Sequence[Prior],
        spread: FloatArray,
        *,
        amplitudes: int = AMPLITUDES,
    ) -> None:
        kernel = problem.kernel_parameters
        assert kernel is not None, "one model with independent noise and chi-squared"
        flagged = [
            j for j, q in enumerate(problem.parameters)
            if q.linear and priors[j].gaussian is not None and kernel.argument(j) is not None
        ]  # fmt: skip
        super().__init__(problem, mode, scale, priors, flagged[:amplitudes])
        model = problem.model
        self.kernel = kernel
        self.arguments = np.array([kernel.argument(j) for j in self.linear], np.int64)
        self.loops = moment_loops_for(
            model.kernel, len(kernel.source), tuple(map(int, self.arguments))
        )
        self.plain = problem.samples.cells is None
        self.exact = self.plain or len(problem.cells.weight) <= EXACT_MEMBERS
        self.w_r = self._directions()
        components = np.concatenate([problem.w_i.T, self.w_r.T])
        self.blocks = [(a, min(a + SAMPLES, problem.n)) for a in range(0, problem.n, SAMPLES)]
        self.components = [np.ascontiguousarray(components[:, a:b]) for a, b in self.blocks]
        self.factors: list[FloatArray] = []
        # Beyond a few standard deviations a straight line is no guide: the factors stay.
        self.reach = EXPANSION * spread[self.sampled]
        if not self.exact:
            factors = self._factors(spread)
            self.factors = [np.ascontiguousarray(factors[:, :, a:b]) for a, b in self.blocks]

    def _directions(self) -> FloatArray:
        """One viewing direction a sample, (N, 3): of a cell the member that is brightest.

        At the foot of a lobe the middle of a cell may see a millionth of what the cell does.
        """
        problem = self.problem
        if self.exact:
            return np.ascontiguousarray(problem.samples.directions.vectors()[1])
        cells = problem.cells
        counts = np.diff(cells.offsets)
        f = problem.model.evaluate(
            np.repeat(problem.w_i, counts, axis=0),
            cells.w_r,
            self.kernel.expanded(self.mode),
            threads=problem.threads,
        )
        largest = np.repeat(np.maximum.reduceat(f, cells.offsets[:-1]), counts)
        owner = np.repeat(np.arange(problem.n), counts)
        brightest = np.flatnonzero(f == largest)
        _, first = np.unique(owner[brightest], return_index=True)
        return np.ascontiguousarray(cells.w_r[brightest[first]])

    def sums(self, p: FloatArray) -> FloatArray:
        """c, g and H: samples and vectors in pieces that do not depend on the threads."""
        problem = self.problem
        pieces = [(k, v) for k in range(len(self.blocks)) for v in range(0, len(p), VECTORS)]
        parts = np.empty((len(self.blocks), len(p), self.n_sums))
        batch = np.ascontiguousarray(p)
        arguments = np.ascontiguousarray(self.kernel.expanded(batch))

        def run(first: int, last: int) -> None:
            for k, v in pieces[first:last]:
                rows = slice(v, v + VECTORS)
                self._piece(k, batch[rows], arguments[rows], parts[k, rows])

        # Starting threads takes longer than a few walkers on a few samples.
        small = problem.n * len(p) < 200_000
        map_blocks(run, len(pieces), threads=1 if small else problem.threads, block=1)
        return np.asarray(parts.sum(axis=0))

    def _piece(self, k: int, batch: FloatArray, arguments: FloatArray, out: FloatArray) -> None:
        problem = self.problem
        a, b = self.blocks[k]
        value, weight = problem.samples.value[a:b], problem.inverse_variance[a:b]
        if self.plain:
            self.loops.moments(self.components[k], value, weight, arguments, out)
        elif self.exact:
            c = problem.cells
            self.loops.cell_moments(
                problem.w_i, c.w_r, c.weight, c.offsets, a, value, weight, arguments, out
            )
        else:
            steps = batch[:, self.sampled] - self.mode[self.sampled]
            self.loops.factored_moments(
                self.components[k], self.factors[k], np.clip(steps, -self.reach, self.reach),
                self.arguments, value, weight, arguments, out,
            )  # fmt: skip

    def _factors(self, spread: FloatArray) -> FloatArray:
        """Integral over the cell by value at its centre of every part, and its slopes."""
        ratio = self._ratio(self.mode)
        slopes = []
        for j in self.sampled:
            ends = [self.mode.copy(), self.mode.copy()]
            for p, side in zip(ends, (-1, 1), strict=True):
                p[j] = np.clip(p[j] + side * spread[j], self.lower[j], self.upper[j])
            width = ends[1][j] - ends[0][j]
            change = self._ratio(ends[1]) - self._ratio(ends[0])
            slopes.append(change / width if width > 0 else np.zeros_like(ratio))
        return np.stack([ratio, *slopes], axis=1)

    def _ratio(self, p: FloatArray) -> FloatArray:
        """Cell over centre of what stays without the amplitudes, and by amplitude, (1 + L, N)."""
        problem = self.problem
        arguments = self.kernel.expanded(p)
        centre_f, slopes = problem.model.gradient(
            problem.w_i, self.w_r, arguments, threads=problem.threads
        )
        cell_f, jac = problem.jacobian(p)
        parts = []
        for f, amplitudes in (
            (centre_f, slopes[:, self.arguments].T),
            (cell_f, jac[:, self.linear].T),
        ):
            rest = f - p[self.linear] @ amplitudes
            # What is left by rounding is nothing.
            rest[np.abs(rest) < 1e-12 * np.abs(f)] = 0.0
            parts.append(np.concatenate([rest[None, :], amplitudes]))
        centre, cell = parts
        ratio = np.ones_like(centre)
        ratio = np.divide(cell, centre, out=ratio, where=centre != 0)
        # Where the centre of a cell sees nothing of a lobe the ratio is no guide to other lobes.
        return np.asarray(np.clip(ratio, -LARGEST_FACTOR, LARGEST_FACTOR))
