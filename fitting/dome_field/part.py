"""The samples of one session: their values and derivatives by material, field and other unknowns.

A sample's expectation is F = (1 + sum z_k r_k) f(p, w + d) + sum z_k o_k. The displacement d of a
viewing direction w is that of the field at w in the laboratory, and what further unknowns z with
unit variance add to it. They are the errors that the session's budget states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_change import shared_change
from gonio.geometry import FloatArray, rotated
from gonio.samples import Cells, SharedTerm
from gonio.tangent_field import Interpolation, Nodes, tangents

STEP = 1e-5  # radians, over which derivatives by direction are taken


def is_common_factor(term: SharedTerm) -> bool:
    """Whether a term is one factor on all values, which no data tell from the reflectances."""
    constant = term.group is None and term.profile is None and term.offset is None
    return constant and not term.moves_directions


def is_unknown(term: SharedTerm) -> bool:
    """Whether a term's draws are unknowns beside the field.

    The typical patterns of slope errors are the field itself. A blur does what the widths of a
    lobe do, but for shapes smaller than what image formation leaves: it is propagated instead.
    """
    return not (term.typical or is_common_factor(term) or term.blur)


@dataclass(frozen=True)
class TermDraws:
    """A shared error and the unknown that each sample has of it.

    Parameters
    ----------
    term : SharedTerm
    draw : ndarray of int64, shape (N,)
        Place of the unknown among all draws of the solution.
    """

    term: SharedTerm
    draw: NDArray[np.int64]


@dataclass(frozen=True)
class Slope:
    """F and its derivatives.

    Parameters
    ----------
    f, value : ndarray, shape (N,)
        The model's values at the moved directions, and F.
    factor : ndarray, shape (N,)
        F = factor f + offset.
    blur : ndarray, shape (N,)
        f less the model's value at the centre of the sample's cell; 0 for points.
    by_parameter : ndarray, shape (N, P)
    by_draw : ndarray, shape (N, T)
        By the draw of each term.
    by_field : ndarray, shape (N, 2)
        By the two components of the field at the sample.
    """

    f: FloatArray
    value: FloatArray
    factor: FloatArray
    blur: FloatArray
    by_parameter: FloatArray
    by_draw: FloatArray
    by_field: FloatArray


@dataclass(frozen=True)
class Part:
    """The samples of one session.

    Parameters
    ----------
    problem : Problem
        Of the samples in their own directions.
    interpolation : Interpolation
        Of the field at the samples.
    draws : tuple of TermDraws
    """

    problem: Problem
    interpolation: Interpolation
    draws: tuple[TermDraws, ...]

    @classmethod
    def of(cls, problem: Problem, nodes: Nodes, draws: tuple[TermDraws, ...]) -> Part:
        """The samples of a problem under a field with these nodes."""
        return cls(problem, nodes.interpolation(lab_directions(problem)), draws)

    @cached_property
    def axes(self) -> tuple[FloatArray, FloatArray]:
        """The field's two tangents (N, 3) at each sample, frame of the sample."""
        turn = azimuths(self.problem)
        along_x, along_y = tangents(lab_directions(self.problem))
        return rotated(along_x, -turn), rotated(along_y, -turn)

    def displacement(self, field: FloatArray) -> FloatArray:
        """Displacement (N, 3) of the viewing directions by a field (2, K), frame of the sample."""
        x, y = (self.interpolation(component)[:, None] for component in field)
        return np.asarray(x * self.axes[0] + y * self.axes[1])

    def moves(self, field: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray | float]:
        """Shift (N, 3) of the viewing directions and turn (N,) of the sample."""
        shift, turn = self.displacement(field), np.zeros(self.problem.n)
        for each in self.draws:
            if each.term.shift is not None:
                shift = shift + z[each.draw][:, None] * each.term.shift
            elif each.term.turn:
                turn = turn + z[each.draw] * each.term.turn
        return shift, turn if np.any(turn) else 0.0

    def correction(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Factor (N,) on the model's values, and what is added to them."""
        factor, offset = np.ones(self.problem.n), np.zeros(self.problem.n)
        for each, relative in zip(self.draws, self._relative, strict=True):
            factor += z[each.draw] * relative
            if each.term.offset is not None:
                offset += z[each.draw] * each.term.offset
        return factor, offset

    def slope(self, p: FloatArray, field: FloatArray, z: FloatArray) -> Slope:
        """F and its derivatives at parameters, a field (2, K) and draws."""
        shift, turn = self.moves(field, z)

        def moved(by: FloatArray | None = None, more: float = 0.0) -> FloatArray:
            where = shift if by is None else shift + by
            return self.problem.with_directions(shift=where, turn=turn + more).values(p)

        here = self.problem.with_directions(shift=shift, turn=turn)
        f, by_p = here.jacobian(p)
        factor, offset = self.correction(z)
        axes = self.axes
        by_field = np.stack([(moved(STEP * axis) - f) / STEP for axis in axes], axis=1)
        by_draw = [
            self._by_draw(each.term, relative, f, factor, by_field, moved)
            for each, relative in zip(self.draws, self._relative, strict=True)
        ]
        return Slope(
            f=f,
            value=factor * f + offset,
            factor=factor,
            blur=f - here.values(p, _centres(here.cells)),
            by_parameter=factor[:, None] * by_p,
            by_draw=np.stack(by_draw, axis=1) if by_draw else np.zeros((len(f), 0)),
            by_field=factor[:, None] * by_field,
        )

    def propagated_blur(self, p: FloatArray, field: FloatArray, z: FloatArray) -> FloatArray:
        """Change (N,) of F over f by blurs that are propagated and no unknowns."""
        shift, turn = self.moves(field, z)
        here = self.problem.with_directions(shift=shift, turn=turn)
        f = here.values(p)
        changes = [
            shared_change(here, term, p, f) / np.maximum(np.abs(f), 1e-300)
            for term in self.problem.samples.shared
            if term.blur
        ]
        return np.asarray(np.sqrt(sum((change**2 for change in changes), np.zeros(len(f)))))

    @cached_property
    def _relative(self) -> list[FloatArray | float]:
        """Relative change of the values by one standard deviation of each term."""
        return [
            0.0
            if each.term.moves_directions
            else each.term.relative * (1.0 if each.term.profile is None else each.term.profile)
            for each in self.draws
        ]

    def _by_draw(
        self,
        term: SharedTerm,
        relative: FloatArray | float,
        f: FloatArray,
        factor: FloatArray,
        by_field: FloatArray,
        moved: Callable[..., FloatArray],
    ) -> FloatArray:
        if term.shift is not None:
            along = [np.sum(term.shift * axis, axis=1) for axis in self.axes]
            return np.asarray(factor * (along[0] * by_field[:, 0] + along[1] * by_field[:, 1]))
        if term.turn:
            return np.asarray(factor * term.turn * (moved(more=STEP) - f) / STEP)
        change = relative * f
        return np.asarray(change if term.offset is None else change + term.offset)


def _centres(cells: Cells) -> Cells:
    """Cells of one member each, at the weighted mean of the members."""
    n = len(cells.offsets) - 1
    mean = np.add.reduceat(cells.weight[:, None] * cells.w_r, cells.offsets[:-1])
    mean /= np.sqrt(np.einsum("nk,nk->n", mean, mean))[:, None]
    return Cells(mean, np.ones(n), np.arange(n + 1, dtype=np.int64))


def azimuths(problem: Problem) -> FloatArray:
    """Azimuth phi_i (N,) of the lamp in the frame of the samples: minus the turn of the sample."""
    return np.asarray(np.broadcast_to(problem.samples.directions.phi_i, problem.n))


def lab_directions(problem: Problem) -> FloatArray:
    """Viewing directions (N, 3) in the laboratory, where the lamp stands at azimuth 0."""
    return rotated(problem.samples.directions.vectors()[1], azimuths(problem))


def numbered(problems: Sequence[Problem]) -> tuple[list[tuple[TermDraws, ...]], int]:
    """The draws of every session, numbered over all, and how many there are.

    An error of the rig has one draw for all sessions; a turn of the sample and an error of a
    session one for each.
    """
    place: dict[tuple[object, ...], int] = {}
    parts = []
    for number, problem in enumerate(problems):
        own = []
        for term in filter(is_unknown, problem.samples.shared):
            whose = "rig" if term.of_rig and not term.turn else number
            keys = [(whose, term.name, label) for label in term.labels]
            places = np.array([place.setdefault(key, len(place)) for key in keys], np.int64)
            own.append(TermDraws(term, places[term.draw(problem.n)]))
        parts.append(tuple(own))
    return parts, len(place)
