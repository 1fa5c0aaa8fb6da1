"""Normal equations of material, field and draws, accumulated over the samples in blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.dome_field.part import Part, Slope
from gonio.fitting.dome_field.state import Layout, State
from gonio.geometry import FloatArray
from gonio.tangent_field import Nodes

# What the formation of images and the integration over cells leave: a part of f, and parts of what
# the integration changes. Members have the first two moments of a cell. With b = change / f the
# fourth moments change f by some b^2 / 6 times the error of the kurtosis; on a rig without other
# errors 2 to 4 % of the change are left in the flank of a lobe, and more where b nears 1.
FLOOR = 5e-4
FLOOR_OF_BLUR = 0.03
FLOOR_OF_SQUARE = 0.06
FIXED = 1e30  # information on an unknown that is held


@dataclass(frozen=True)
class Rows:
    """The samples of one session about a state, divided by their noise.

    Parameters
    ----------
    index : ndarray of int64, shape (N, M)
        Unknowns that each sample depends on.
    column : ndarray, shape (N, M)
        Derivatives of its value by them.
    residual : ndarray, shape (N,)
    root : ndarray, shape (N,)
        One over the noise.
    slope : Slope
    """

    index: NDArray[np.int64]
    column: FloatArray
    residual: FloatArray
    root: FloatArray
    slope: Slope

    @property
    def chi2(self) -> float:
        return float(self.residual @ self.residual)


def rows_of(
    part: Part, number: int, layout: Layout, state: State, inverse: FloatArray | None = None
) -> Rows:
    """Rows of a session's samples.

    Parameters
    ----------
    part : Part
    number : int
        Of the session.
    layout : Layout
    state : State
    inverse : ndarray, shape (N,), optional
        Weights that are kept; from the model's values where not given.
    """
    slope = part.slope(state.p[number], state.field, state.z)
    if inverse is None:
        inverse = weights(part, slope)
    root = np.sqrt(inverse)
    near = part.interpolation
    columns = np.concatenate(
        [
            slope.by_parameter,
            slope.by_field[:, :1] * near.weight,
            slope.by_field[:, 1:] * near.weight,
            slope.by_draw,
        ],
        axis=1,
    )
    columns *= root[:, None]
    index = layout.sparse(number, near.index, [each.draw for each in part.draws])
    residual = root * (part.problem.samples.value - slope.value)
    return Rows(index, columns, residual, root, slope)


def weights(part: Part, slope: Slope) -> FloatArray:
    """One over the variance of the samples, by the model's values and with the floor."""
    variance = part.problem.variance(slope.value)
    return np.asarray(1 / (variance + floor(slope) ** 2))


def floor(slope: Slope) -> FloatArray:
    """What image formation and integration leave of every sample, sr^-1."""
    f, change = slope.f, slope.blur
    square = change**2 / np.maximum(f, 1e-300)
    parts = (FLOOR * f, FLOOR_OF_BLUR * change, FLOOR_OF_SQUARE * square)
    return np.asarray(slope.factor * np.sqrt(sum(part**2 for part in parts)))


@dataclass(frozen=True)
class Equations:
    """Gradient and information of the samples, without priors.

    Parameters
    ----------
    gradient : ndarray, shape (U,)
    information : ndarray, shape (U, U)
        Symmetric.
    chi2 : float
    n : int
        Number of samples.
    """

    gradient: FloatArray
    information: FloatArray
    chi2: float
    n: int


def sums(
    rows: Sequence[Rows], layout: Layout, chosen: Sequence[NDArray[np.bool_]] | None = None
) -> Equations:
    """The sums over the samples, or over those that are chosen.

    The order of the additions does not depend on the number of threads: it is that of the samples.
    """
    from gonio.kernels.information import add_information

    gradient, information = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    chi2, n = 0.0, 0
    for k, each in enumerate(rows):
        index, column, residual = each.index, each.column, each.residual
        if chosen is not None:
            own = chosen[k]
            index, column, residual = index[own], column[own], residual[own]
        add_information(index, column, residual, 0, len(residual), gradient, information)
        chi2, n = chi2 + float(residual @ residual), n + len(residual)
    lower = np.tril(information, -1)
    return Equations(gradient, information + lower.T, chi2, n)


@dataclass(frozen=True)
class Prior:
    """Prior information on the field and the draws.

    Parameters
    ----------
    layout : Layout
    inverse : ndarray, shape (K, K)
        Inverse covariance of a component of the field at the nodes.
    """

    layout: Layout
    inverse: FloatArray

    @classmethod
    def of(cls, nodes: Nodes, layout: Layout) -> Prior:
        from scipy.linalg import cho_solve

        inverse = cho_solve((nodes.root, True), np.eye(len(nodes)))
        return cls(layout, (inverse + inverse.T) / 2)

    def chi2(self, state: State) -> float:
        """What the prior adds to chi-squared."""
        field = float(np.sum(state.field * (state.field @ self.inverse)))
        return field + float(state.z @ state.z)

    def added(self, equations: Equations, state: State) -> tuple[FloatArray, FloatArray]:
        """Gradient and information with the prior."""
        gradient, information = equations.gradient.copy(), equations.information.copy()
        layout, k = self.layout, self.layout.nodes
        gradient[layout.field] -= (state.field @ self.inverse).ravel()
        gradient[layout.drawn] -= state.z
        for first in (layout.field.start, layout.field.start + k):
            information[first : first + k, first : first + k] += self.inverse
        places = np.arange(layout.size)[layout.drawn]
        information[places, places] += 1.0
        return gradient, information
