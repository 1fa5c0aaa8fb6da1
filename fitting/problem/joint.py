"""Channels, wavelengths or materials as one least-squares problem with shared parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import unknown_name
from gonio.fitting.problem.problem import Problem
from gonio.geometry import Directions, FloatArray
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells, SharedTerm

Source = BRDFSamples | Sequence[BRDFSamples] | Mapping[str, BRDFSamples]


@dataclass(frozen=True)
class Channel:
    """The samples of one part of a joint fit: one BRDF.

    Parameters
    ----------
    label : str
        "red", "650 nm", "paint_a", or "paint_a, red".
    material : str
        Name of the source, empty where there is one source only.
    source : int
        Which of the sources the samples are of.
    select : mapping of str to str
        Takes these samples out of their source, as `gonio.formats.choose` understands it.
    samples : BRDFSamples
    """

    label: str
    material: str
    source: int
    select: Mapping[str, str]
    samples: BRDFSamples


def split(samples: Source) -> list[Channel]:
    """Channels, wavelengths and materials, each for itself.

    Parameters
    ----------
    samples : BRDFSamples, or a sequence or mapping of them
        Several are several materials, named by the keys of the mapping, or else by their sample
        or file.

    Returns
    -------
    list of Channel
        Material by material; by wavelength where it is known, else in the order of the samples.

    Examples
    --------
    >>> theta = np.array([0.1, 0.2, 0.3])
    >>> two = BRDFSamples(
    ...     Directions(theta, 0.0, theta, 0.0), theta, wavelength_nm=np.array([650.0, 450.0, 650.0])
    ... )
    >>> [(c.label, c.samples.value.tolist()) for c in split(two)]
    [('450 nm', [0.2]), ('650 nm', [0.1, 0.3])]
    """
    named = _named(samples)
    found = []
    for k, (name, one) in enumerate(named.items()):
        material = name if len(named) > 1 else ""
        for label, select, keep in _channels_of(one):
            part = one if keep is None else one.select(keep, ", ".join(select.values()))
            both = ", ".join(word for word in (material, label) if word) or name
            found.append(Channel(both, material, k, select, part))
    return found


def _named(samples: Source) -> dict[str, BRDFSamples]:
    """The sources by name; names that occur twice are numbered."""
    if isinstance(samples, BRDFSamples):
        return {_own_name(samples) or "all": samples}
    if isinstance(samples, Mapping):
        return dict(samples)
    named: dict[str, BRDFSamples] = {}
    for k, one in enumerate(samples, 1):
        name = _own_name(one) or str(k)
        named[name if name not in named else f"{name} ({k})"] = one
    return named


def _own_name(samples: BRDFSamples) -> str:
    known = samples.metadata
    return str(known.get("sample") or Path(str(known.get("path") or "")).stem)


def _channels_of(
    samples: BRDFSamples,
) -> list[tuple[str, dict[str, str], NDArray[np.bool_] | None]]:
    """Label, selection and mask of every channel or wavelength; the mask is None where one is."""
    names, of_name = _distinct(samples.channel, len(samples))
    lengths, of_length = _distinct(samples.wavelength_nm, len(samples))
    pairs, first, part = np.unique(
        np.stack([of_name, of_length]), axis=1, return_index=True, return_inverse=True
    )
    n = pairs.shape[1]
    if n == 1:
        return [("", {}, None)]
    # A channel of one wavelength is called by its name alone, a wavelength of one channel by nm.
    by_name = len(names) == n or len(lengths) < n
    by_length = len(names) < n
    found = []
    for k in sorted(range(n), key=lambda k: (pairs[1, k], first[k])):
        select, words = {}, []
        if by_name:
            select["channel"] = str(names[pairs[0, k]])
            words.append(select["channel"])
        if by_length:
            select["wavelength"] = f"{lengths[pairs[1, k]]:.9g}"
            words.append(f"{select['wavelength']} nm")
        found.append((", ".join(words), select, part.ravel() == k))
    return found


def _distinct(column: NDArray[Any] | None, n: int) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Distinct values, and which of them each sample has."""
    values, index = np.unique(np.zeros(n) if column is None else column, return_inverse=True)
    return values, index.astype(np.int64)


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
            cells=_joined_cells([problem.cells for problem in problems]),
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
            own = None if cells is None else _cells_within(cells, where)
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
            cells=_joined_cells([part.cells for part in parts]),
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


def joined(channels: Sequence[Channel]) -> BRDFSamples:
    """All samples as one list, channel after channel, with the errors that they share.

    A shared error of one source acts across its channels as its groups say. In several sources
    an error of the same name, meaning and size is one and the same where it belongs to the
    instrument: it moves directions, or is one number for all samples (the standard). One that has
    groups and changes values, as a lamp that drifts, is each source's own; so is everything on
    instruments of different names.
    """
    parts = [channel.samples for channel in channels]
    angles = [
        np.concatenate([np.broadcast_to(getattr(s.directions, name), (len(s),)) for s in parts])
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    ]
    one = len({channel.source for channel in channels}) == 1
    return BRDFSamples(
        directions=Directions(*angles),
        value=np.concatenate([s.value for s in parts]),
        u_independent=_column(parts, "u_independent"),
        noise_slope=_column(parts, "noise_slope"),
        u_reference=_column(parts, "u_reference"),
        reference_sharing=max(s.reference_sharing for s in parts),
        shared=_joined_terms(channels),
        history=_history(channels, one=one),
        metadata=_common([s.metadata for s in parts]),
        quantity=parts[0].quantity,
    )


def _column(parts: Sequence[BRDFSamples], name: str) -> FloatArray | None:
    columns = [getattr(s, name) for s in parts]
    return None if any(c is None for c in columns) else np.concatenate(columns)


def _common(metadata: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What all sources say alike."""
    return {
        key: value
        for key, value in metadata[0].items()
        if all(key in other and other[key] == value for other in metadata[1:])
    }


def _history(channels: Sequence[Channel], *, one: bool) -> tuple[str, ...]:
    """Of one source what its channels have in common; of several every line once, with names."""
    if one:
        first = channels[0].samples.history
        return first[: -1 if len(channels) > 1 and channels[0].select else None]
    lines = [f"{c.material}: {line}" for c in channels for line in c.samples.history]
    return tuple(dict.fromkeys(lines))


def _joined_terms(channels: Sequence[Channel]) -> tuple[SharedTerm, ...]:
    found: dict[tuple[Any, ...], list[SharedTerm | None]] = {}
    for k, channel in enumerate(channels):
        seen: dict[tuple[Any, ...], int] = {}
        for term in channel.samples.shared:
            key = _identity(term, channel)
            # The same error twice in one source is two errors.
            seen[key] = seen.get(key, 0) + 1
            found.setdefault((*key, seen[key]), [None] * len(channels))[k] = term
    return tuple(_one_term(terms, channels) for terms in found.values())


def _identity(term: SharedTerm, channel: Channel) -> tuple[Any, ...]:
    """Terms with the same identity are one error."""
    of_instrument = term.moves_directions or term.group is None
    owner = str(channel.samples.metadata.get("instrument")) if of_instrument else channel.source
    return (owner, term.name, term.meaning, term.relative, term.blur, term.turn)


def _one_term(terms: Sequence[SharedTerm | None], channels: Sequence[Channel]) -> SharedTerm:
    """One term over all samples; it does nothing to channels that do not have it."""
    sizes = [len(channel.samples) for channel in channels]
    known = [term for term in terms if term is not None]
    partial = len(known) < len(terms)

    def column(name: str, shape: tuple[int, ...], unset: float) -> Any:
        filled = [
            np.full((n, *shape), unset if term is not None else 0.0)
            if term is None or getattr(term, name) is None
            else getattr(term, name)
            for term, n in zip(terms, sizes, strict=True)
        ]
        return np.concatenate(filled)

    def has(name: str) -> bool:
        return any(getattr(term, name) is not None for term in known)

    group = column("group", (), 0).astype(np.int64) if has("group") else None
    return replace(
        known[0],
        group=group,
        shift=column("shift", (3,), 0.0) if has("shift") else None,
        profile=column("profile", (), 1.0) if has("profile") or partial else None,
        offset=column("offset", (), 0.0) if has("offset") else None,
    )


def _joined_cells(cells: Sequence[Cells]) -> Cells:
    ends = np.cumsum([0, *(c.offsets[-1] for c in cells)])
    offsets = [c.offsets[1:] + end for c, end in zip(cells, ends, strict=False)]
    return Cells(
        np.concatenate([c.w_r for c in cells]),
        np.concatenate([c.weight for c in cells]),
        np.concatenate([[0], *offsets]).astype(np.int64),
    )


def _cells_within(cells: Cells, where: slice) -> Cells:
    """The cells of consecutive samples."""
    offsets = cells.offsets[where.start : where.stop + 1]
    first, last = int(offsets[0]), int(offsets[-1])
    return Cells(cells.w_r[first:last], cells.weight[first:last], offsets - first)
