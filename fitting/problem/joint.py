"""Channels, wavelengths or materials as one least-squares problem with shared parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gonio.errors import unknown_name
from gonio.fitting.problem.channels import (
    Channel,
)
from gonio.fitting.problem.joined_samples import (
    cells_within,
    joined,
    joined_cells,
)
from gonio.fitting.problem.problem import Problem
from gonio.geometry import FloatArray
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells


@dataclass(frozen=True)
class JointProblem(Problem):
    """Several problems of one model as one: some parameters are shared, the others each part's own.

    It answers what `Problem` answers. Samples, weights and cells are those of the parts one after
    the other; parameters are the shared ones, then those of part after part, named `rho_d[red]`.

    Parameters
    ----------
    parts : tuple of Problem
        With weights divided by the square of `scales`.
    labels : tuple of str
    places : tuple of ndarray of int64
        Where each part's parameters stand among all.
    all_parameters : tuple of Parameter
    scales : tuple of float
        Factor on the independent uncertainties of each part.
    """

    parts: tuple[Problem, ...] = ()
    labels: tuple[str, ...] = ()
    places: tuple[NDArray[np.int64], ...] = ()
    all_parameters: tuple[Parameter, ...] = ()
    scales: tuple[float, ...] = ()

    @classmethod
    def from_parts(
        cls,
        channels: Sequence[Channel],
        problems: Sequence[Problem],
        share: Sequence[str],
        scales: Sequence[float] | None = None,
    ) -> JointProblem:
        """Join problems of one model and one kind of weights.

        Parameters
        ----------
        channels : sequence of Channel
        problems : sequence of Problem
            One for each channel, over its samples.
        share : sequence of str
            Parameters that all parts have in common; none and all are allowed.
        scales : sequence of float, optional
            Factor on the independent uncertainties of each part; 1 where not given.

        Raises
        ------
        ConfigurationError
            If a name is no parameter of the model, with the nearest one.
        """
        first = problems[0]
        for name in share:
            first.model.parameter(name)
        labels = tuple(channel.label for channel in channels)
        parameters, places = _named_parameters(first.model, labels, share)
        base = replace(
            first,
            samples=joined(channels),
            inverse_variance=np.concatenate([problem.inverse_variance for problem in problems]),
            w_i=np.concatenate([problem.w_i for problem in problems]),
            cells=joined_cells([problem.cells for problem in problems]),
        )
        plain = cls(
            **{item.name: getattr(base, item.name) for item in fields(base)},
            parts=tuple(problems),
            labels=labels,
            places=places,
            all_parameters=parameters,
            scales=(1.0,) * len(labels),
        )
        return plain if scales is None else plain.scaled(scales)

    def scaled(self, scales: Sequence[float]) -> JointProblem:
        """The problem with other factors on the independent uncertainties of its parts."""
        parts = tuple(
            replace(part, inverse_variance=part.inverse_variance * (old / new) ** 2)
            for part, old, new in zip(self.parts, self.scales, scales, strict=True)
        )
        return self._with(parts, tuple(float(s) for s in scales))

    def _with(self, parts: tuple[Problem, ...], scales: tuple[float, ...]) -> JointProblem:
        weights = np.concatenate([part.inverse_variance for part in parts])
        return replace(self, parts=parts, scales=scales, inverse_variance=weights)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Shared parameters, then those of part after part."""
        return self.all_parameters

    @property
    def plain(self) -> bool:
        """Whether the samples are points and not cells."""
        return all(part.plain for part in self.parts)

    @property
    def slices(self) -> list[slice]:
        """The samples of each part among all."""
        ends = np.cumsum([0, *(part.n for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Checked parameter vector; `rho_d` stands for every part's that is not named itself."""
        names = [q.name for q in self.all_parameters]
        for name in values:
            if name not in names and name not in self.model.names:
                raise unknown_name(f"parameter of {self.name}", name, {*names, *self.model.names})
        return np.array(
            [
                q.check(values.get(q.name, values.get(base_name(q.name), q.default)))
                for q in self.all_parameters
            ]
        )

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> JointProblem:
        """The problem with other bounds of its parameters."""
        return replace(self, all_parameters=parameters)

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        """Variance of each sample, with the parts' factors; as `Problem.variance`."""
        return np.concatenate(
            [
                scale**2 * part.variance(None if f is None else f[where], sharing=sharing)
                for part, where, scale in zip(self.parts, self.slices, self.scales, strict=True)
            ]
        )

    def reweighted(self, p: FloatArray | None) -> JointProblem:
        """The problem with its weights taken at the model's values for p."""
        parts = []
        for part, place, scale in zip(self.parts, self.places, self.scales, strict=True):
            new = part.reweighted(None if p is None else p[place])
            parts.append(replace(new, inverse_variance=new.inverse_variance / scale**2))
        return self._with(tuple(parts), self.scales)

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        """The model integrated over every cell, shape (N,), sr^-1."""
        out = np.empty(self.n)
        for part, place, where in zip(self.parts, self.places, self.slices, strict=True):
            own = None if cells is None else cells_within(cells, where)
            out[where] = part.values(p[place], own)
        return out

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Model values (N,) and their derivatives (N, parameters): mostly zeros, see `pieces`."""
        f, jac = np.empty(self.n), np.zeros((self.n, len(p)))
        for part, place, where in zip(self.parts, self.places, self.slices, strict=True):
            f[where], own = part.jacobian(p[place])
            jac[where, place] = own
        return f, jac

    def chi2(self, p: FloatArray) -> float:
        """Sum of squared weighted residuals."""
        pairs = zip(self.parts, self.places, strict=True)
        return float(sum(part.chi2(p[place]) for part, place in pairs))

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        """`chi2` for each parameter vector of a batch, shape (B,)."""
        pairs = zip(self.parts, self.places, strict=True)
        sums = [part.batch_chi2(batch[:, place]) for part, place in pairs]
        return np.asarray(np.sum(sums, axis=0))

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """chi2, J^T W r and J^T W J at p, summed part by part."""
        n_p = len(self.all_parameters)
        chi2, g, h = 0.0, np.zeros(n_p), np.zeros((n_p, n_p))
        for part, place in zip(self.parts, self.places, strict=True):
            own = part.normal_equations(p[place])
            chi2 += own[0]
            g[place] += own[1]
            h[np.ix_(place, place)] += own[2]
        return chi2, g, h

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        """Each part with its samples' and its parameters' places among all."""
        return list(zip(self.parts, self.slices, self.places, strict=True))

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        """For a part's own parameter the part, its shared parameters held as the others hold them.

        What the others say of the shared parameters is chi-squared's growth to second order, their
        own parameters following. A shared parameter needs the whole.
        """
        owners = [k for k, place in enumerate(self.places) if j in place]
        if len(owners) > 1:
            return super().around(p, h, j)
        part, place = self.parts[owners[0]], self.places[owners[0]]
        part = part.with_parameters(tuple(self.all_parameters[m] for m in place))
        others = h.copy()
        others[np.ix_(place, place)] -= part.normal_equations(p[place])[2]
        rest = np.setdiff1d(np.arange(len(p)), place)
        lower, upper = (np.array([getattr(q, e) for q in self.all_parameters])
                        for e in ("lower", "upper"))  # fmt: skip
        rest = rest[(p[rest] > lower[rest]) & (p[rest] < upper[rest]) & (np.diag(h)[rest] > 0)]
        across = others[np.ix_(place, rest)]
        unit = 1 / np.sqrt(np.diag(h)[rest])
        inner = np.linalg.pinv(h[np.ix_(rest, rest)] * np.outer(unit, unit), hermitian=True)
        stiffness = others[np.ix_(place, place)] - (across * unit) @ inner @ (across * unit).T
        known = {item.name: getattr(part, item.name) for item in fields(part)}
        return HeldProblem(**known, centre=p[place], stiffness=stiffness), place

    def at(self, index: NDArray[np.int64]) -> JointProblem:
        """The problem of these samples alone, part after part, with their cells and weights."""
        index = np.sort(np.asarray(index, np.int64))
        parts = tuple(
            part.at(index[(index >= where.start) & (index < where.stop)] - where.start)
            for part, where in zip(self.parts, self.slices, strict=True)
        )
        return self._of(parts, self.samples.select(index, "some samples"))

    def subset(self, n: int) -> JointProblem:
        """At most n samples, as evenly from all parts as `Problem.subset` takes them."""
        each = max(n // len(self.parts), 2 * len(self.model.parameters))
        parts = tuple(part.subset(each) for part in self.parts)
        channels = [
            Channel(label, label, 0, {}, part.samples)
            for label, part in zip(self.labels, parts, strict=True)
        ]
        return self._of(parts, joined(channels))

    def _of(self, parts: tuple[Problem, ...], samples: BRDFSamples) -> JointProblem:
        return replace(
            self,
            samples=samples,
            parts=parts,
            inverse_variance=np.concatenate([part.inverse_variance for part in parts]),
            w_i=np.concatenate([part.w_i for part in parts]),
            cells=joined_cells([part.cells for part in parts]),
        )


@dataclass(frozen=True)
class HeldProblem(Problem):
    """A problem whose parameters other data hold: (p - centre)^T stiffness (p - centre) is added.

    Parameters
    ----------
    centre : ndarray, shape (P,)
    stiffness : ndarray, shape (P, P)
    """

    centre: FloatArray = field(default_factory=lambda: np.zeros(0))
    stiffness: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def chi2(self, p: FloatArray) -> float:
        """Sum of squared weighted residuals, and what holds the parameters."""
        step = p - self.centre
        return super().chi2(p) + float(step @ self.stiffness @ step)

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """chi2, J^T W r and J^T W J at p."""
        chi2, g, h = super().normal_equations(p)
        step = p - self.centre
        pull = self.stiffness @ step
        return chi2 + float(step @ pull), g - pull, h + self.stiffness


def base_name(name: str) -> str:
    """The model's name of a joint problem's parameter.

    Examples
    --------
    >>> base_name("rho_d[650 nm]"), base_name("alpha_x")
    ('rho_d', 'alpha_x')
    """
    return name.partition("[")[0]


def _named_parameters(
    model: Model, labels: Sequence[str], share: Sequence[str]
) -> tuple[tuple[Parameter, ...], tuple[NDArray[np.int64], ...]]:
    """All parameters, and where each part finds its own among them."""
    parameters = [q for q in model.parameters if q.name in share]
    shared = {q.name: j for j, q in enumerate(parameters)}
    places = []
    for label in labels:
        place = []
        for q in model.parameters:
            place.append(shared.get(q.name, len(parameters)))
            if q.name not in shared:
                meaning = f"{q.meaning}, {label}"
                parameters.append(replace(q, name=f"{q.name}[{label}]", meaning=meaning))
        places.append(np.array(place, dtype=np.int64))
    return tuple(parameters), tuple(places)


# ---------------------------------------------------------------------- one list of samples


def parameter_of_part(problem: JointProblem, part: int, name: str) -> str:
    """Name among all parameters of one of a part's."""
    place = int(problem.places[part][problem.model.names.index(name)])
    return str(problem.parameters[place].name)
