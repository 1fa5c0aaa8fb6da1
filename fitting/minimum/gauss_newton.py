"""Find the minimum: starts from the data, Gauss-Newton steps inside the bounds, and the checks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gonio.fitting.minimum.box import Box
from gonio.fitting.minimum.curvature import TAKES_PART, axes, within_sum
from gonio.fitting.minimum.optimum import DEEPER, Optimum
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.kernels import boxed
from gonio.kernels.boxed import next_point

INWARDS = 0.1  # relative change by which an exchange is followed away from a bound
AT_SUM = 1e-9  # distance from its limit at which a sum is at it
UNDETERMINED: float = boxed.UNDETERMINED  # smallest part of the curvature that is information
POLISH_STEPS = 300
STOP = 1e-5  # the polish ends where its next step is this part of the uncertainty
VERIFIED = 1e-3  # a minimum is verified where it is this part
ROUNDING = 1e-12  # of the norm of the data: what a step may change by rounding alone
NEAR_BOUND = 1e-6  # of the range: near enough to a bound to be put on it


@dataclass
class _State:
    """Where Gauss-Newton steps stand: a point, chi-squared there, its slope and its curvature."""

    problem: Problem
    box: Box
    size: float
    p: FloatArray
    chi2: float
    g: FloatArray
    h: FloatArray
    evaluations: int = 1

    @classmethod
    def at(cls, problem: Problem, p: FloatArray) -> _State:
        """The state at the point inside the bounds that is nearest to p."""
        box = Box.of(problem)
        p = box.inside(p)
        value = problem.samples.value
        size = math.sqrt(float(np.vdot(value * value, problem.inverse_variance)))
        return cls(problem, box, size, p, *problem.normal_equations(p))

    def step(self, damping: float = 0.0) -> tuple[FloatArray, float, bool]:
        """Where the next step leads, length of the undamped one, and whether the sum ends it.

        The length is in units of the uncertainty in its direction.
        """
        box = self.box
        point, decrease, limited = next_point(
            self.h, self.g, self.p, box.lower, box.upper, box.c, damping
        )
        return point, math.sqrt(max(decrease, 0.0)) / self.noise, limited

    @property
    def noise(self) -> float:
        """Root mean square of the weighted residuals, never 0."""
        dof = max(self.problem.n - len(self.p), 1)
        return math.sqrt(max(self.chi2 / dof, 1e-300))

    @property
    def rounding(self) -> float:
        """What a step may change by rounding alone, in units of the uncertainty."""
        return ROUNDING * self.size / self.noise

    def moved(self, p: FloatArray, chi2: float, g: FloatArray, h: FloatArray) -> None:
        """Stand at another point."""
        self.p, self.chi2, self.g, self.h = p, chi2, g, h


def _polish(problem: Problem, start: FloatArray | _State, evaluations: int) -> Optimum:
    """Levenberg-Marquardt with an active set of bounds, until the step is negligible.

    Where a point half an uncertainty away turns out deeper, it goes on from there.
    """
    for _ in range(3):
        state = start if isinstance(start, _State) else _marquardt(problem, start)
        if state is not start:
            evaluations += state.evaluations
        optimum = _at_rest(state, evaluations)
        deeper, n = _deeper_nearby(state, optimum)
        evaluations += n
        if deeper is None:
            return replace(optimum, evaluations=evaluations)
        start = deeper
    return replace(optimum, evaluations=evaluations, verified=False)


def _marquardt(
    problem: Problem, p: FloatArray, arrived: Callable[[_State], bool] | None = None
) -> _State:
    """Damped Gauss-Newton steps; a step between the bounds is the best one between them.

    They end early where `arrived` says that they need go no further.
    """
    state = _State.at(problem, p)
    damping = 1e-3
    for _ in range(POLISH_STEPS):
        if arrived is not None and arrived(state):
            break
        trial, distance, _ = state.step(damping)
        if distance <= max(STOP, state.rounding):
            break
        new = problem.normal_equations(trial)
        state.evaluations += 1
        if new[0] <= state.chi2:
            same = bool((abs(trial - state.p) <= 1e-14 * abs(state.p)).all())
            state.moved(trial, *new)
            damping = max(damping / 10, 1e-12)
            if same:
                break
        else:
            damping *= 10
            if damping > 1e10:
                break  # no step goes down: rounding limits the sum of squares
    return state


def _at_rest(state: _State, evaluations: int) -> Optimum:
    """The state with what is a hair from a bound put on it, and whether its step is negligible."""
    _snap(state)
    _leave_chance_bounds(state)
    _leave_chance_limits(state)
    _, distance, limited = state.step()
    held = tuple(map(int, np.flatnonzero(state.box.c))) if limited else ()
    verified = distance <= max(VERIFIED, 1e2 * state.rounding)
    p, box = state.p, state.box
    free = (p > box.lower) & (p < box.upper)
    return Optimum(p, state.chi2, state.g, state.h, free, evaluations, verified, held)


def _snap(state: _State) -> None:
    """Parameters a hair from a bound are put on it where chi2 does not mind."""
    box = state.box
    hair = NEAR_BOUND * (box.upper - box.lower)
    for bound in (box.lower, box.upper):
        gap = abs(state.p - bound)
        for j in np.flatnonzero((gap > 0) & (gap <= hair)):
            trial = state.p.copy()
            trial[j] = bound[j]
            new = state.problem.normal_equations(trial)
            state.evaluations += 1
            if new[0] <= state.chi2 * (1 + DEEPER) + (ROUNDING * state.size) ** 2:
                state.moved(trial, *new)


def _leave_chance_bounds(state: _State) -> None:
    """Amplitudes that only share out a sum are put between their bounds.

    Where f does not change along a line of amplitudes, the search may end where a bound cuts the
    line. That bound is chance: what remains would look as if the data determined it.
    """
    box = state.box
    flagged = np.array([q.linear for q in state.problem.parameters])
    linear = np.flatnonzero(flagged & (np.diag(state.h) > 0) & (box.upper > box.lower))
    at_bound = (state.p <= box.lower) | (state.p >= box.upper)
    if len(linear) < 2 or not at_bound[linear].any():
        return
    values, vectors, scale = axes(state.h, linear)
    for vector in vectors.T[values < UNDETERMINED]:
        line = np.zeros(len(state.p))
        line[linear] = np.where(np.abs(vector) > TAKES_PART, vector / scale, 0.0)
        some = line != 0
        ends = [(b - state.p)[some] / line[some] for b in (box.lower, box.upper)]
        first, last = np.minimum(*ends).max(), np.maximum(*ends).min()
        trial = np.clip(state.p + (first + last) / 2 * line, box.lower, box.upper)
        if not last > first or float(trial @ box.c) > 1:
            continue
        new = state.problem.normal_equations(trial)
        state.evaluations += 1
        if new[0] <= state.chi2 * (1 + DEEPER) + (ROUNDING * state.size) ** 2:
            state.moved(trial, *new)


def _leave_chance_limits(state: _State) -> None:
    """An exchange of any parameters is followed inwards where it has reached a bound or the sum.

    The samples do not tell where along it the search should have stopped.
    """
    box, p = state.box, state.p
    index = np.flatnonzero((np.diag(state.h) > 0) & (box.upper > box.lower))
    at_bound = (p <= box.lower) | (p >= box.upper)
    at_sum = bool(box.c.any()) and float(box.c @ p) >= 1 - AT_SUM
    if len(index) < 2 or not (at_bound[index].any() or at_sum):
        return
    values, vectors, scale = axes(state.h, index)
    for vector in vectors.T[values < UNDETERMINED]:
        line = np.zeros(len(p))
        line[index] = np.where(np.abs(vector) > TAKES_PART, vector / scale, 0.0)
        if not (line[at_bound].any() or (at_sum and abs(box.c @ line) > 0)):
            continue
        line *= INWARDS / float(np.max(np.abs(line[index]) / np.maximum(np.abs(p[index]), 1e-12)))
        for trial in (p + line, p - line):
            if not np.array_equal(box.inside(trial), trial):
                continue
            end = _marquardt(state.problem, trial)
            state.evaluations += end.evaluations
            if end.chi2 <= state.chi2 * (1 + DEEPER) + (ROUNDING * state.size) ** 2:
                state.moved(end.p, end.chi2, end.g, end.h)
                return


def _deeper_nearby(state: _State, optimum: Optimum) -> tuple[FloatArray | None, int]:
    """A point half an uncertainty away with a smaller chi2, or None; and how many were tried.

    The curvature J^T W J is never negative, also not on a saddle: only chi2 itself tells.
    """
    h, box = optimum.curvature, state.box
    index = np.flatnonzero(optimum.free & (np.diag(h) > 0))
    if len(index) == 0:
        return None, 0
    scale = 1 / np.sqrt(np.diag(h)[index])
    scaled = h[np.ix_(index, index)] * np.outer(scale, scale)
    along = within_sum(scale * box.c[index]) if optimum.limited else np.eye(len(index))
    values, vectors = np.linalg.eigh(along.T @ scaled @ along)
    is_determined = values >= UNDETERMINED
    steps = (0.5 * state.noise * scale)[:, None] * (along @ vectors[:, is_determined])
    steps = steps / np.sqrt(values[is_determined])
    trials = np.repeat(optimum.p[None], 2 * steps.shape[1], axis=0)
    trials[:, index] += np.concatenate([steps.T, -steps.T])
    trials = np.array([box.inside(trial) for trial in trials])
    if len(trials) == 0:
        return None, 0
    chi2 = state.problem.batch_chi2(trials)
    k = int(np.argmin(chi2))
    # Where the model leaves nothing over, rounding makes one point or the other deeper.
    floor = (ROUNDING * state.size) ** 2
    deeper = trials[k] if chi2[k] < optimum.chi2 * (1 - DEEPER) - floor else None
    return deeper, len(trials)
