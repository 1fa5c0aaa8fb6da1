"""Channels, wavelengths or materials as one least-squares problem with shared parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gonio.errors import unknown_name
from gonio.fitting.problem import by_jacobian, unknowns, weighting
from gonio.fitting.problem.channels import Channel
from gonio.fitting.problem.joined_samples import cells_within, joined, joined_cells
from gonio.fitting.problem.losses import Loss
from gonio.fitting.problem.noise_law import NoiseLaw
from gonio.fitting.problem.penalised import PenalisedProblem
from gonio.fitting.problem.protocol import Problem, ProfiledDraw, Weights
from gonio.fitting.problem.shared_change import shared_changes
from gonio.fitting.problem.unknowns import KernelParameters, Reported
from gonio.geometry import Directions, FloatArray
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells


@dataclass(frozen=True)
class JointProblem:
    """Several problems of one model as one: some parameters are shared, the others each part's own.

    See `Problem` for what it answers. Samples, weights and cells are those of the parts one after
    the other; unknowns are the shared ones, then those of part after part, named `rho_d[red]`.

    Parameters
    ----------
    samples : BRDFSamples
        Of all parts, with the errors that they share.
    parts : tuple of Problem
        Each over one BRDF, with weights divided by the square of `scales`.
    labels : tuple of str
    indices : tuple of ndarray of int64
        Where each part's unknowns stand among all.
    parameters : tuple of Parameter
    reported : tuple of Reported
    scales : tuple of float
        Factor on the independent uncertainties of each part.
    cells : Cells
        Of all samples, as they are stated.
    """

    samples: BRDFSamples
    parts: tuple[Problem, ...]
    labels: tuple[str, ...]
    indices: tuple[NDArray[np.int64], ...]
    parameters: tuple[Parameter, ...]
    reported: tuple[Reported, ...]
    scales: tuple[float, ...]
    cells: Cells

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
        parameters, indices = _named_parameters(first, labels, share)
        joint = cls(
            samples=joined(channels),
            parts=tuple(problems),
            labels=labels,
            indices=indices,
            parameters=parameters,
            reported=_reported(first, labels, parameters, indices),
            scales=(1.0,) * len(labels),
            cells=joined_cells([problem.cells for problem in problems]),
        )
        return joint if scales is None else joint.scaled(scales)

    def scaled(self, scales: Sequence[float]) -> JointProblem:
        """The problem with other factors on the independent uncertainties of its parts."""
        parts = tuple(
            part.with_weights(part.inverse_variance * (old / new) ** 2)
            for part, old, new in zip(self.parts, self.scales, scales, strict=True)
        )
        return replace(self, parts=parts, scales=tuple(float(s) for s in scales))

    def names_of_part(self, k: int) -> dict[str, str]:
        """Name among all parameters of each of the model's, in part k."""
        names = {r.parameter.name for r in self.reported}
        own = {q: f"{q}[{self.labels[k]}]" for q in self.model.names}
        return {q: name if name in names else q for q, name in own.items()}

    @property
    def model(self) -> Model:
        return self.parts[0].model

    @property
    def name(self) -> str:
        return self.model.name

    @property
    def n(self) -> int:
        return len(self.samples)

    @property
    def weights(self) -> Weights:
        return self.parts[0].weights

    @property
    def law(self) -> Loss:
        return self.parts[0].law

    @property
    def threads(self) -> int | None:
        return self.parts[0].threads

    @cached_property
    def inverse_variance(self) -> FloatArray:
        return np.concatenate([part.inverse_variance for part in self.parts])

    @cached_property
    def w_i(self) -> FloatArray:
        return np.concatenate([part.w_i for part in self.parts])

    @property
    def cos_theta_r(self) -> FloatArray:
        return np.concatenate([part.cos_theta_r for part in self.parts])

    @property
    def quadratic(self) -> bool:
        return all(part.quadratic for part in self.parts)

    @property
    def finds_scale(self) -> bool:
        return any(part.finds_scale for part in self.parts)

    @property
    def weights_follow_model(self) -> bool:
        return any(part.weights_follow_model for part in self.parts)

    @property
    def noise_laws(self) -> tuple[NoiseLaw | None, ...]:
        return tuple(part.noise_laws[0] for part in self.parts)

    @property
    def sum_limit(self) -> FloatArray:
        return unknowns.sum_limit(self.model, self.parameters)

    @property
    def terms_of_sum(self) -> list[tuple[str, NDArray[np.int64]]]:
        return unknowns.terms_of_sum(self.model, self.parameters)

    @property
    def kernel_parameters(self) -> KernelParameters | None:
        return None

    @property
    def independent(self) -> JointProblem:
        return self

    @property
    def profiled(self) -> tuple[str, ...]:
        return ()

    @property
    def slices(self) -> list[slice]:
        """The samples of each part among all."""
        ends = np.cumsum([0, *(part.n for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Checked vector of the unknowns; `rho_d` stands for every part's not named itself."""
        names = [q.name for q in self.parameters]
        for name in values:
            if name not in names and name not in self.model.names:
                raise unknown_name("parameter", name, {*names, *self.model.names}, of=self.name)
        return np.array(
            [
                q.check(values.get(q.name, values.get(base_name(q.name), q.default)))
                for q in self.parameters
            ]
        )

    # ------------------------------------------------------------------ problems made from this one

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> JointProblem:
        return replace(self, parameters=parameters)

    def with_weights(self, inverse_variance: FloatArray) -> JointProblem:
        pairs = zip(self.parts, self.slices, strict=True)
        parts = tuple(part.with_weights(inverse_variance[where]) for part, where in pairs)
        return replace(self, parts=parts)

    def as_least_squares(self, p: FloatArray | None = None) -> JointProblem:
        return replace(self, parts=tuple(part.as_least_squares() for part in self.parts))

    def reweighted(self, p: FloatArray | None) -> JointProblem:
        parts = []
        for part, own_indices, scale in zip(self.parts, self.indices, self.scales, strict=True):
            new = part.reweighted(None if p is None else p[own_indices])
            parts.append(new.with_weights(new.inverse_variance / scale**2))
        return replace(self, parts=tuple(parts))

    def with_noise_law(self, p: FloatArray) -> JointProblem:
        pairs = zip(self.parts, self.indices, strict=True)
        return replace(self, parts=tuple(q.with_noise_law(p[own]) for q, own in pairs))

    def with_directions(
        self, *, shift: FloatArray | None = None, turn: float | FloatArray = 0.0
    ) -> JointProblem:
        each = np.broadcast_to(turn, self.n)
        parts = tuple(
            part.with_directions(shift=None if shift is None else shift[where], turn=each[where])
            for part, where in zip(self.parts, self.slices, strict=True)
        )
        return replace(self, parts=parts)

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        return list(zip(self.parts, self.slices, self.indices, strict=True))

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        """For a part's own unknown the part, its shared unknowns held as the others hold them.

        What the others say of the shared parameters is chi-squared's growth to second order, their
        own parameters following. A shared parameter needs the whole.
        """
        owners = [k for k, own_indices in enumerate(self.indices) if j in own_indices]
        if len(owners) > 1:
            return self, np.arange(len(p))
        part, own_indices = self.parts[owners[0]], self.indices[owners[0]]
        part = part.with_parameters(tuple(self.parameters[m] for m in own_indices))
        others = h.copy()
        others[np.ix_(own_indices, own_indices)] -= part.normal_equations(p[own_indices])[2]
        rest = np.setdiff1d(np.arange(len(p)), own_indices)
        lower = np.array([q.lower for q in self.parameters])
        upper = np.array([q.upper for q in self.parameters])
        rest = rest[(p[rest] > lower[rest]) & (p[rest] < upper[rest]) & (np.diag(h)[rest] > 0)]
        across = others[np.ix_(own_indices, rest)]
        unit = 1 / np.sqrt(np.diag(h)[rest])
        inner = np.linalg.pinv(h[np.ix_(rest, rest)] * np.outer(unit, unit), hermitian=True)
        stiffness = (
            others[np.ix_(own_indices, own_indices)] - (across * unit) @ inner @ (across * unit).T
        )
        return PenalisedProblem(part, p[own_indices], stiffness), own_indices

    def at(self, index: NDArray[np.int64]) -> JointProblem:
        index = np.sort(np.asarray(index, np.int64))
        parts = tuple(
            part.at(index[(index >= where.start) & (index < where.stop)] - where.start)
            for part, where in zip(self.parts, self.slices, strict=True)
        )
        return self._of(parts, self.samples.select(index, "some samples"))

    def subset(self, n: int) -> JointProblem:
        """At most n samples, as evenly from all parts as `SingleProblem.subset` takes them."""
        each = max(n // len(self.parts), 2 * len(self.model.parameters))
        parts = tuple(part.subset(each) for part in self.parts)
        channels = [
            Channel(label, label, 0, {}, part.samples)
            for label, part in zip(self.labels, parts, strict=True)
        ]
        return self._of(parts, joined(channels))

    def _of(self, parts: tuple[Problem, ...], samples: BRDFSamples) -> JointProblem:
        cells = joined_cells([part.cells for part in parts])
        return replace(self, parts=parts, samples=samples, cells=cells)

    # ------------------------------------------------------------------ values and sums

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        return np.concatenate(
            [
                scale**2 * part.variance(None if f is None else f[where], sharing=sharing)
                for part, where, scale in zip(self.parts, self.slices, self.scales, strict=True)
            ]
        )

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        out = np.empty(self.n)
        for part, own_indices, where in zip(self.parts, self.indices, self.slices, strict=True):
            own = None if cells is None else cells_within(cells, where)
            out[where] = part.values(p[own_indices], own)
        return out

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values (N,) and their derivatives (N, P): mostly zeros, see `pieces`."""
        f, jac = np.empty(self.n), np.zeros((self.n, len(p)))
        for part, own_indices, where in zip(self.parts, self.indices, self.slices, strict=True):
            f[where], own = part.jacobian(p[own_indices])
            jac[where, own_indices] = own
        return f, jac

    def model_at(self, directions: Directions, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The model of part after part at these directions."""
        by_part = [
            part.model_at(directions, p[own_indices])
            for part, own_indices in zip(self.parts, self.indices, strict=True)
        ]
        jac = np.zeros((sum(len(f) for f, _ in by_part), len(p)))
        start = 0
        for (f, own), own_indices in zip(by_part, self.indices, strict=True):
            jac[start : start + len(f), own_indices] = own
            start += len(f)
        return np.concatenate([f for f, _ in by_part]), jac

    def chi2(self, p: FloatArray) -> float:
        pairs = zip(self.parts, self.indices, strict=True)
        return float(sum(part.chi2(p[own_indices]) for part, own_indices in pairs))

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        pairs = zip(self.parts, self.indices, strict=True)
        sums = [part.batch_chi2(batch[:, own_indices]) for part, own_indices in pairs]
        return np.asarray(np.sum(sums, axis=0))

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        n_p = len(self.parameters)
        chi2, g, h = 0.0, np.zeros(n_p), np.zeros((n_p, n_p))
        for part, own_indices in zip(self.parts, self.indices, strict=True):
            own = part.normal_equations(p[own_indices])
            chi2 += own[0]
            g[own_indices] += own[1]
            h[np.ix_(own_indices, own_indices)] += own[2]
        return chi2, g, h

    def products(self, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        return by_jacobian.products(self, points, rows)

    def weighted(self, columns: FloatArray) -> FloatArray:
        return weighting.weighted(columns, self.inverse_variance)

    def profiled_draws(self, p: FloatArray, informed: NDArray[np.bool_]) -> list[ProfiledDraw]:
        return []

    def profiled_columns(self) -> FloatArray:
        return np.zeros((self.n, 0))

    def profiled_change(self) -> FloatArray:
        return np.zeros(self.n)

    def shared_changes(self, p: FloatArray) -> list[FloatArray]:
        return shared_changes(self, p)


def base_name(name: str) -> str:
    """The model's name of a joint problem's parameter.

    Examples
    --------
    >>> base_name("rho_d[650 nm]"), base_name("alpha_x")
    ('rho_d', 'alpha_x')
    """
    return name.partition("[")[0]


def _named_parameters(
    part: Problem, labels: Sequence[str], share: Sequence[str]
) -> tuple[tuple[Parameter, ...], tuple[NDArray[np.int64], ...]]:
    """All unknowns, and where each part finds its own among them."""
    # To share a tied parameter is to share the one that it is tied to.
    common = {r.tied_to or r.parameter.name for r in part.reported if r.parameter.name in share}
    parameters = [q for q in part.parameters if q.name in common]
    shared = {q.name: j for j, q in enumerate(parameters)}
    indices = []
    for label in labels:
        own_indices = []
        for q in part.parameters:
            own_indices.append(shared.get(q.name, len(parameters)))
            if q.name not in shared:
                meaning = f"{q.meaning}, {label}"
                parameters.append(replace(q, name=f"{q.name}[{label}]", meaning=meaning))
        indices.append(np.array(own_indices, dtype=np.int64))
    return tuple(parameters), tuple(indices)


def _reported(
    part: Problem,
    labels: Sequence[str],
    parameters: tuple[Parameter, ...],
    indices: tuple[NDArray[np.int64], ...],
) -> tuple[Reported, ...]:
    """Parameters that all parts have in common, fixed ones among them, then those of each part."""
    shared = {q.name for q in parameters}
    common: list[Reported] = []
    own: list[Reported] = []
    for r in part.reported:
        in_common = r.unknown is None or part.parameters[r.unknown].name in shared
        (common if in_common else own).append(r)
    reported = [replace(r, unknown=None if r.unknown is None else int(indices[0][r.unknown]))
             for r in common]  # fmt: skip
    for label, own_indices in zip(labels, indices, strict=True):
        for r in own:
            assert r.unknown is not None
            name = f"{r.parameter.name}[{label}]"
            meaning = f"{r.parameter.meaning}, {label}"
            reported.append(
                Reported(
                    replace(r.parameter, name=name, meaning=meaning),
                    int(own_indices[r.unknown]),
                    tied_to=None if r.tied_to is None else f"{r.tied_to}[{label}]",
                )
            )
    return tuple(reported)
