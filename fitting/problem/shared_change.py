"""Change of the samples by a shared error of one standard deviation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.samples import SharedTerm

STEP = 0.1  # of the prior's standard deviation: over which the slope of a direction is taken


def shared_change(problem: Problem, term: SharedTerm, p: FloatArray, f: FloatArray) -> FloatArray:
    """Change of the samples (N,) for one standard deviation of a shared term.

    Parameters
    ----------
    problem : Problem
    term : SharedTerm
    p : ndarray
        Parameters.
    f : ndarray, shape (N,)
        Model values at p.
    """
    pieces = problem.pieces()
    if pieces[0][0] is not problem:
        changes = [
            shared_change(piece, term.select(np.arange(problem.n)[where]), p[index], f[where])
            for piece, where, index in pieces
        ]
        return np.concatenate(changes)
    if term.shift is not None:
        return _shifted(problem, term.shift, p)
    if term.turn:
        ends = [problem.with_directions(turn=side * term.turn).values(p) for side in (1, -1)]
        change = (ends[0] - ends[1]) / 2
        return change if term.profile is None else change * term.profile
    if term.blur:
        change = _blurred(problem, term.blur, p) - f
        return change if term.profile is None else change * term.profile
    return term.change(f)


def shared_changes(problem: Problem, p: FloatArray) -> list[FloatArray]:
    """`Problem.shared_changes` of a problem that profiles no shared error."""
    if not problem.samples.shared:
        return []
    f = problem.values(p)
    return [shared_change(problem, term, p, f) for term in problem.samples.shared]


def _shifted(problem: Problem, shift: FloatArray, p: FloatArray) -> FloatArray:
    """Half the difference of the model with all viewing directions moved by +shift and -shift."""
    step = np.repeat(shift, np.diff(problem.cells.offsets), axis=0)
    return (_moved(problem, step, p) - _moved(problem, -step, p)) / 2


def _blurred(problem: Problem, sd: float, p: FloatArray) -> FloatArray:
    """The model seen through a blur of the viewing direction, sd on each axis.

    Four directions at sqrt(2) sd along two tangents have the blur's second moments.
    """
    w_r = problem.cells.w_r
    across = np.cross(w_r, [0.0, 1.0, 0.0])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    along = np.cross(w_r, across)
    steps = [sign * np.sqrt(2) * sd * axis for axis in (across, along) for sign in (1, -1)]
    return np.asarray(sum(_moved(problem, step, p) for step in steps) / 4)


def _moved(problem: Problem, step: FloatArray, p: FloatArray) -> FloatArray:
    """The model with every member's viewing direction moved by a tangent vector."""
    w_r = problem.cells.w_r + step
    w_r /= np.linalg.norm(w_r, axis=1, keepdims=True)
    return problem.values(p, replace(problem.cells, w_r=w_r))


def draw_slope(
    problem: Problem,
    term: SharedTerm,
    p: FloatArray,
    f: FloatArray,
    factor: FloatArray,
    *,
    step: float = STEP,
) -> FloatArray:
    """dF/dz (N,) of a term; f are the values at the directions as they are now.

    What is profiled is known to a part of its prior: there the slope is wanted, and not the chord
    over a whole standard deviation that stands for what is only propagated.
    """
    if term.shift is not None:
        shorter = replace(term, shift=step * term.shift)
        return shared_change(problem, shorter, p, f) / step * factor
    if term.turn:
        shorter = replace(term, turn=step * term.turn)
        return shared_change(problem, shorter, p, f) / step * factor
    change = shared_change(problem, term, p, f)
    return change * factor if term.blur else change
