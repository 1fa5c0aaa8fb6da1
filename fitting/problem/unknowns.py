"""Which parameters of a model are unknown: all, or all but those that are fixed or tied."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.models import Model, Parameter
from gonio.models import get as get_model
from gonio.models._sums import SIGN


@dataclass(frozen=True)
class Reported:
    """A parameter as a result states it.

    Parameters
    ----------
    parameter : Parameter
        With the name that the result uses.
    unknown : int or None
        Its index among the unknowns; None where it is fixed.
    value : float or None
        What it is fixed to, in the unit of Python.
    tied_to : str or None
        Name of the parameter whose value it takes.
    """

    parameter: Parameter
    unknown: int | None
    value: float | None = None
    tied_to: str | None = None

    def of(self, p: FloatArray) -> float:
        """The value where the unknowns are p."""
        if self.unknown is not None:
            return float(p[self.unknown])
        assert self.value is not None
        return self.value


@dataclass(frozen=True)
class KernelParameters:
    """How unknowns fill the arguments of a model's kernel.

    Parameters
    ----------
    source : ndarray of int64, shape (K,)
        For each argument the index of its unknown; -1 where it is fixed.
    values : ndarray, shape (K,)
        What arguments are fixed to; 0 elsewhere.
    """

    source: NDArray[np.int64]
    values: FloatArray

    @classmethod
    def every(cls, n: int) -> KernelParameters:
        """Every argument an unknown of its own."""
        return cls(np.arange(n), np.zeros(n))

    def expanded(self, points: FloatArray) -> FloatArray:
        """Arguments (..., K) of vectors of unknowns (..., P)."""
        full = np.empty((*points.shape[:-1], len(self.source)))
        full[...] = self.values
        free = self.source >= 0
        full[..., free] = points[..., self.source[free]]
        return full

    def reduced(self, jacobian: FloatArray) -> FloatArray:
        """Derivatives by the unknowns (N, P) of derivatives by the arguments (N, K)."""
        out = np.zeros((len(jacobian), int(self.source.max(initial=-1)) + 1))
        for k, j in enumerate(self.source):
            if j >= 0:
                out[:, j] += jacobian[:, k]
        return out

    def argument(self, j: int) -> int | None:
        """The only argument that unknown j fills; None where it fills several."""
        (indices,) = np.nonzero(self.source == j)
        return int(indices[0]) if len(indices) == 1 else None


def sum_limit(model: Model, parameters: tuple[Parameter, ...]) -> FloatArray:
    """1 for the parameters whose sum the albedo never exceeds; all 0 where no sum is limited."""
    c = np.zeros(len(parameters))
    wanted = model.claims.albedo_at_most or ()
    names = [q.name for q in parameters]
    if len(wanted) > 1 and set(wanted) <= set(names):
        c[[names.index(name) for name in wanted]] = 1.0
    return c


def terms_of_sum(
    model: Model, parameters: tuple[Parameter, ...]
) -> list[tuple[str, NDArray[np.int64]]]:
    """Models that a model is the sum of, with the indices of their parameters.

    One term where the parameters are not those of the model, one after the other: several parts
    have some of their own, or some are fixed.
    """
    names = model.name.split(SIGN)
    every = np.arange(len(parameters))
    if len(names) < 2:
        return [(model.name, every)]
    counts = [len(get_model(name).parameters) for name in names]
    if sum(counts) != len(every):
        return [(model.name, every)]
    return list(zip(names, np.split(every, np.cumsum(counts)[:-1]), strict=True))


def held_at(parameters: tuple[Parameter, ...], j: int, value: float) -> tuple[Parameter, ...]:
    """The parameters with number j held at a value by its bounds."""
    changed = list(parameters)
    changed[j] = replace(changed[j], lower=value, upper=value, scale="linear", linear=False)
    return tuple(changed)
