"""Gauss-Newton for material and field together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.fitting.dome_field.equations import Equations, Prior, Rows, rows_of, sums
from gonio.fitting.dome_field.evidence import FieldData, refined
from gonio.fitting.dome_field.part import Part, numbered
from gonio.fitting.dome_field.state import Layout, State
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.tangent_field import FieldPrior, Nodes

MOST_NODES = 1000
_STEPS = 8
_SETTLED = 0.3  # fall of chi-squared that further steps may promise
_REFINED = 0.1  # change of the correlation length, as a part of it, for which nodes are set anew
_HALVINGS = 4
_ROUNDING = 1e-5  # of the number of samples: fall that approximate derivatives cannot reach


@dataclass(frozen=True)
class Joint:
    """Material(s) and field of one rig.

    Parameters
    ----------
    parts : tuple of Part
        Sessions.
    nodes : Nodes
        With the refined prior.
    stated : FieldPrior
        The prior before it was refined.
    layout : Layout
    state : State
    rows : tuple of Rows
        About the state.
    equations : Equations
        The sums of the rows.
    information : ndarray, shape (U, U)
        With the priors.
    data : FieldData
    chi2_before : float
        chi-squared of the sessions without a field, each fitted by itself.
    settled : bool
        Whether the last step promised next to nothing.
    """

    parts: tuple[Part, ...]
    nodes: Nodes
    stated: FieldPrior
    layout: Layout
    state: State
    rows: tuple[Rows, ...]
    equations: Equations
    information: FloatArray
    data: FieldData
    chi2_before: float
    settled: bool

    @property
    def n(self) -> int:
        return self.equations.n

    @property
    def chi2(self) -> float:
        return self.equations.chi2

    @property
    def share(self) -> float:
        """Share of the misfit that the field and the draws took."""
        return float(np.clip(1 - self.chi2 / max(self.chi2_before, 1e-300), 0, 1))


def solve(minima: Sequence[Minimum], stated: FieldPrior) -> Joint:
    """Solve for all unknowns.

    Parameters
    ----------
    minima : sequence of Minimum
        Fits of the sessions without a field, from which the solution starts.
    stated : FieldPrior
    """
    problems = [minimum.problem for minimum in minima]
    draws, n_draws = numbered(problems)
    theta = max(float(np.max(np.broadcast_to(p.samples.directions.theta_r, p.n))) for p in problems)

    def set_up(prior: FieldPrior) -> _Search:
        nodes = Nodes.on_cap(prior, theta, MOST_NODES)
        parts = tuple(
            Part.of(problem, nodes, own) for problem, own in zip(problems, draws, strict=True)
        )
        layout = Layout(tuple(len(m.optimum.p) for m in minima), len(nodes), n_draws)
        return _Search(parts, nodes, layout, Prior.of(nodes, layout))

    search = set_up(stated)
    start = State(
        tuple(m.optimum.p.copy() for m in minima), np.zeros((2, len(search.nodes))),
        np.zeros(n_draws),
    )  # fmt: skip
    before = sum(minimum.chi2 for minimum in minima)
    state = search.run(start, settled=50.0)  # near enough for the size of the field
    if not search.settled:
        return search.solution(state, stated, before)
    factor, stretch = refined(search.field_data(), search.nodes)
    prior = stated.scaled(factor, stretch)
    if abs(stretch - 1) > _REFINED:
        old = search.nodes
        search = set_up(prior)
        near = old.interpolation(search.nodes.directions)
        state = replace(state, field=np.stack([near(component) for component in state.field]))
    else:
        nodes = Nodes(search.nodes.directions, prior)
        search = replace_nodes(search, nodes)
    state = search.run(state, settled=_SETTLED)
    return search.solution(state, stated, before)


class _Search:
    """Steps from one state to the next; it keeps the last linearisation."""

    def __init__(self, parts: tuple[Part, ...], nodes: Nodes, layout: Layout, prior: Prior) -> None:
        self.parts, self.nodes, self.layout, self.prior = parts, nodes, layout, prior
        self.limits = [_limits(part.problem) for part in parts]
        self.rows: tuple[Rows, ...] = ()
        self.equations: Equations | None = None
        self.state: State | None = None
        self.settled = False

    def run(self, state: State, *, settled: float) -> State:
        """Step until the expected fall of chi-squared is below `settled`.

        The weights are those of the first state: weights that moved on with the model would move
        the minimum at every step.
        """
        objective = self._linearise(state, None)
        weights = [rows.root**2 for rows in self.rows]
        for _ in range(_STEPS):
            step, fall = self._step(state)
            self.settled = fall < max(settled, _ROUNDING * self.n)
            if self.settled:
                return state
            for halving in range(_HALVINGS + 1):
                trial = state.moved(self.layout, step / 2**halving, self.limits)
                reached = self._linearise(trial, weights)
                if reached < objective:
                    break
            else:
                self._linearise(state, weights)
                return state
            state, objective = trial, reached
        return state

    @property
    def n(self) -> int:
        """Number of samples."""
        return sum(part.problem.n for part in self.parts)

    def _linearise(self, state: State, inverse: list[FloatArray] | None) -> float:
        """Rows and sums about a state; chi-squared with the priors."""
        self.rows = tuple(
            rows_of(part, k, self.layout, state, None if inverse is None else inverse[k])
            for k, part in enumerate(self.parts)
        )
        self.equations = sums(self.rows, self.layout)
        self.state = state
        return self.equations.chi2 + self.prior.chi2(state)

    def _step(self, state: State) -> tuple[FloatArray, float]:
        from scipy.linalg import cho_factor, cho_solve

        assert self.equations is not None
        gradient, information = self.prior.added(self.equations, state)
        held = self._held(state, gradient)
        gradient[held] = 0.0
        information[held] = information[:, held] = 0.0
        information[held, held] = 1.0
        scale = 1 / np.sqrt(np.diag(information))
        factor = cho_factor(information * np.outer(scale, scale), lower=True)
        step = scale * cho_solve(factor, scale * gradient)
        return step, float(gradient @ step)

    def _held(self, state: State, gradient: FloatArray) -> list[int]:
        """Parameters at a limit that would leave it, or on which no sample depends."""
        assert self.equations is not None
        held = []
        for k, p in enumerate(state.p):
            lower, upper = self.limits[k]
            for place, value, low, high in zip(
                self.layout.of_session(k).tolist(), p, lower, upper, strict=True
            ):
                pushed = gradient[place]
                outside = (value <= low and pushed < 0) or (value >= high and pushed > 0)
                if outside or self.equations.information[place, place] <= 0:
                    held.append(place)
        return held

    def field_data(self) -> FieldData:
        """What the samples say of the field about the last state."""
        assert self.equations is not None
        assert self.state is not None
        gradient, information = self.prior.added(self.equations, self.state)
        inside = self.layout.field
        gradient[inside] = self.equations.gradient[inside]
        information[inside, inside] = self.equations.information[inside, inside]
        held = self._held(self.state, gradient)
        gradient[held] = 0.0
        information[held] = information[:, held] = 0.0
        information[held, held] = 1.0
        return FieldData.of(gradient, information, self.layout, self.state)

    def solution(self, state: State, stated: FieldPrior, before: float) -> Joint:
        assert self.equations is not None
        gradient, information = self.prior.added(self.equations, state)
        held = self._held(state, gradient)
        information[held] = information[:, held] = 0.0
        information[held, held] = np.inf
        return Joint(
            self.parts, self.nodes, stated, self.layout, state, self.rows, self.equations,
            information, self.field_data(), before,
            self.settled,
        )  # fmt: skip


def replace_nodes(search: _Search, nodes: Nodes) -> _Search:
    """The search with another prior of the same nodes."""
    return _Search(search.parts, nodes, search.layout, Prior.of(nodes, search.layout))


def _limits(problem: Problem) -> FloatArray:
    lower = [q.lower for q in problem.parameters]
    upper = [q.upper for q in problem.parameters]
    return np.array([lower, upper])
