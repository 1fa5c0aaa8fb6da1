"""The unknowns of a joint solution and their order: parameters, field, draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray


@dataclass(frozen=True)
class Layout:
    """Places of the unknowns.

    Parameters
    ----------
    parameters : tuple of int
        Number of parameters of each session.
    nodes : int
        Number of nodes, each with two components.
    draws : int
    """

    parameters: tuple[int, ...]
    nodes: int
    draws: int

    @property
    def n_parameters(self) -> int:
        return sum(self.parameters)

    @property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.n_parameters + 2 * self.nodes + self.draws

    @property
    def field(self) -> slice:
        """Both components at all nodes, the first component first."""
        return slice(self.n_parameters, self.n_parameters + 2 * self.nodes)

    @property
    def drawn(self) -> slice:
        return slice(self.size - self.draws, self.size)

    def of_session(self, number: int) -> NDArray[np.int64]:
        """Places of the parameters of one session."""
        ends = np.cumsum((0, *self.parameters))
        first, last = list(pairwise(ends))[number]
        return np.arange(first, last)

    def sparse(
        self,
        number: int,
        index: NDArray[np.int64],
        draws: Sequence[NDArray[np.int64]],
    ) -> NDArray[np.int64]:
        """Unknowns (N, M) that each sample of a session depends on.

        Parameters
        ----------
        number : int
            Of the session.
        index : ndarray of int64, shape (N, neighbours)
            Nodes near each sample.
        draws : sequence of ndarray of int64, shape (N,)
        """
        n = len(index)
        own = np.broadcast_to(self.of_session(number), (n, self.parameters[number]))
        first = self.field.start
        parts = [own, first + index, first + self.nodes + index]
        parts += [self.drawn.start + draw[:, None] for draw in draws]
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True)
class State:
    """Values of the unknowns.

    Parameters
    ----------
    p : tuple of ndarray
        Parameters of each session.
    field : ndarray, shape (2, K)
        Components of the displacement at the nodes, radians.
    z : ndarray, shape (draws,)
    """

    p: tuple[FloatArray, ...]
    field: FloatArray
    z: FloatArray

    def moved(self, layout: Layout, step: FloatArray, limits: Sequence[FloatArray]) -> State:
        """The state after a step of all unknowns, within the limits (2, P) of each session."""
        p = tuple(
            np.clip(own + step[layout.of_session(k)], *limits[k]) for k, own in enumerate(self.p)
        )
        field = self.field + step[layout.field].reshape(2, -1)
        return State(p, field, self.z + step[layout.drawn])
