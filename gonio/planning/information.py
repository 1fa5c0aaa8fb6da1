"""Fisher information of candidate images, and the uncertainties of a fit to a choice of them.

Every candidate image has the samples that a measurement would deliver: directions, cells,
variances and shared errors. From these follow, for any choice of images,

- the uncertainties that a fit will state: weighted least squares over the independent errors,
  shared errors propagated linearly (`gonio.fitting.uncertainty`): H^-1 + sum_g m_g m_g^T with
  H = J^T W J and m_g = H^-1 J^T W u_g for every draw g of a shared error u;
- the information of an estimator that knows the sizes of the shared errors: these are unknowns
  with a unit prior, marginalised by a Schur complement. Its inverse is a lower bound of the first
  (Cramer and Rao).

With 1e5 pixels an image the noise of the counts is nearly nothing; the lamp and the standard
dominate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum import curvature
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.reduced import ReducedProblem
from gonio.fitting.problem.shared_change import shared_change
from gonio.fitting.problem.single import SingleProblem
from gonio.geometry import FloatArray
from gonio.models import Model
from gonio.samples import BRDFSamples
from gonio.shared_term import SharedTerm


@dataclass(frozen=True)
class Design:
    """A choice of images: every rotation at every incidence, by their numbers.

    Parameters
    ----------
    incidences, rotations : tuple of int
        Numbers in the candidates' lists, growing.
    repeats : int
        Takes of each background and standard.

    Examples
    --------
    >>> Design((0, 3), (1,), 2).n_images
    10
    """

    incidences: tuple[int, ...]
    rotations: tuple[int, ...]
    repeats: int = 1

    @property
    def n_images(self) -> int:
        """Images of the sample, the standard and the background."""
        return (len(self.rotations) + 2 * self.repeats) * len(self.incidences)


@dataclass(frozen=True)
class Expected:
    """Standard uncertainties that a fit to the images of a design will state.

    Parameters
    ----------
    u : ndarray, shape (P,)
        In the unit of Python; infinite where the images do not determine the parameter.
    components : mapping of str to ndarray, shape (P,)
        The same by source.
    determined : ndarray of bool, shape (P,)
    """

    u: FloatArray
    components: dict[str, FloatArray]
    determined: NDArray[np.bool_]

    def largest_source(self, j: int) -> tuple[str, float]:
        """The largest source of parameter j and its standard uncertainty."""
        name = max(self.components, key=lambda source: float(self.components[source][j]))
        return name, float(self.components[name][j])


@dataclass(frozen=True)
class _Image:
    """Derivatives (cells, P), changes by shared errors (cells, T), and variances of an image."""

    columns: FloatArray  # (cells, P + T)
    independent: FloatArray
    reference: FloatArray
    groups: tuple[int, ...]  # which draw of each shared error is in the image


class Candidates:
    """Candidate images, with the information on the parameters that each gives.

    Parameters
    ----------
    samples : BRDFSamples
        Of every candidate image, number incidence * n_rotations + rotation, with one take of each
        background and standard. Shared errors with `averages` become smaller with more takes.
    model : Model
    p : ndarray, shape (P,)
        Values of the parameters at which the information is computed.
    n_incidences, n_rotations : int
    threads : int, optional
        The result does not depend on it.
    constraints : Constraints, optional
        Parameters that are fixed or tied; P then counts the unknowns in `Expected`.
    """

    def __init__(
        self,
        samples: BRDFSamples,
        model: Model,
        p: FloatArray,
        *,
        n_incidences: int,
        n_rotations: int,
        threads: int | None = None,
        constraints: Constraints | None = None,
    ) -> None:
        assert samples.image is not None
        self.n_incidences, self.n_rotations = n_incidences, n_rotations
        self.terms = tuple(term.name for term in samples.shared)
        self._averaged = np.array([bool(term.averages) for term in samples.shared], dtype=bool)
        # The reference counted twice separates its variance from the rest.
        problem: Problem = SingleProblem.from_samples(
            replace(samples, reference_sharing=2), model, "sd", threads
        )
        if constraints:
            problem = ReducedProblem.of(problem, constraints)
            named = dict(zip(model.names, p, strict=True))
            p = np.array([named[q.name] for q in problem.parameters])
        self.model, self.p = model, p
        f, jacobian = problem.jacobian(p)
        once = problem.variance(f)
        reference = problem.variance(f, sharing=True) - once
        changes = [shared_change(problem, term, p, f) for term in samples.shared]
        columns = np.column_stack([jacobian, *changes])
        groups = [_compact(term, len(samples)) for term in samples.shared]
        self._images: dict[int, _Image] = {}
        for k in range(n_incidences * n_rotations):
            rows = np.flatnonzero(samples.image == k)
            if len(rows):
                self._images[k] = _Image(
                    columns[rows],
                    (once - reference)[rows],
                    reference[rows],
                    tuple(int(group[rows[0]]) for group in groups),
                )
        self._position = {k: n for n, k in enumerate(self._images)}
        self._groups = np.array(
            [image.groups for image in self._images.values()], dtype=np.int64
        ).reshape(len(self._images), len(self.terms))
        self._grouped = set(np.flatnonzero(self._groups.any(axis=0)).tolist())
        self._matrices: dict[tuple[int, float], FloatArray] = {}
        self._parameter_rows: dict[float, FloatArray] = {}

    @property
    def everything(self) -> Design:
        """Every candidate image, once."""
        return Design(tuple(range(self.n_incidences)), tuple(range(self.n_rotations)))

    def expected(self, design: Design) -> Expected:
        """Uncertainties that a fit to these images will state."""
        return self._expected(self._numbers(design), design)

    def information(self, design: Design) -> FloatArray:
        """Information of the parameters, shared errors marginalised, shape (P, P).

        Another incidence or take never lowers it. Nor does another rotation, but for the noise of
        the standard's frames, which is counted in full in every image that they serve.
        """
        return self._information(self._numbers(design), design)

    def bound(self, design: Design) -> FloatArray:
        """Standard uncertainty (P,) of the best estimator; infinite without information."""
        return _standard(self.information(design))

    def helps_most(self, design: Design) -> list[tuple[int, int, float] | None]:
        """For each parameter the image without which its uncertainty grows most.

        Returns
        -------
        list of (incidence, rotation, growth), or None
            Numbers of the image, and the factor by which `Expected.u` grows without it; None
            where the design does not determine the parameter.
        """
        numbers = self._numbers(design)
        whole = self._expected(numbers, design).u
        without = np.array(
            [self._expected([n for n in numbers if n != k], design).u for k in numbers]
        ).reshape(len(numbers), len(self.p))
        most_helpful: list[tuple[int, int, float] | None] = []
        for j, u in enumerate(whole):
            if not np.isfinite(u):
                most_helpful.append(None)
                continue
            best = int(np.argmax(without[:, j]))
            incidence, rotation = divmod(numbers[best], self.n_rotations)
            most_helpful.append((incidence, rotation, float(without[best, j] / u)))
        return most_helpful

    def _numbers(self, design: Design) -> list[int]:
        """Images of a design that have samples."""
        numbers = (i * self.n_rotations + r for i in design.incidences for r in design.rotations)
        return [k for k in numbers if k in self._images]

    def _matrix(self, k: int, design: Design) -> FloatArray:
        """X^T W X of an image, with X = [J, shared errors], (P + T, P + T)."""
        # All rotations share a standard; a fit counts its noise once for each of them.
        sharing = len(design.rotations) / design.repeats
        if (k, sharing) not in self._matrices:
            image = self._images[k]
            weight = 1 / (image.independent + sharing * image.reference)
            self._matrices[k, sharing] = image.columns.T @ (image.columns * weight[:, None])
        return self._matrices[k, sharing]

    def _rows(self, design: Design) -> FloatArray:
        """The rows of `_matrix` that belong to parameters, of every image, (images, P, P + T)."""
        sharing = len(design.rotations) / design.repeats
        if sharing not in self._parameter_rows:
            n_p = len(self.p)
            rows = [self._matrix(k, design)[:n_p] for k in self._images]
            self._parameter_rows[sharing] = np.array(rows).reshape(len(rows), n_p, -1)
        return self._parameter_rows[sharing]

    def _scale(self, design: Design) -> FloatArray:
        """Factor on every shared error (T,) by the takes over which it is averaged."""
        return np.where(self._averaged, 1 / np.sqrt(design.repeats), 1.0)

    def _expected(self, numbers: list[int], design: Design) -> Expected:
        n_p = len(self.p)
        # J^T W [J, u] of every image.
        rows = self._rows(design)[[self._position[k] for k in numbers]]
        summed = rows.sum(axis=0)
        inverse, determined = _inverse(summed[:, :n_p])
        variances = {"independent": np.diag(inverse)}
        scale = self._scale(design)
        common = (inverse @ summed[:, n_p:] * scale) ** 2
        for t, name in enumerate(self.terms):
            variance = common[:, t]
            if t in self._grouped:
                groups = self._groups[[self._position[k] for k in numbers], t]
                pull = np.zeros((groups.max(initial=0) + 1, n_p))
                np.add.at(pull, groups, rows[:, :, n_p + t] * scale[t])
                variance = np.sum((pull @ inverse) ** 2, axis=0)
            variances[name] = variances.get(name, 0.0) + variance
        total = np.sum(list(variances.values()), axis=0)
        return Expected(
            np.where(determined, np.sqrt(total), np.inf),
            {name: np.sqrt(np.maximum(v, 0.0)) for name, v in variances.items()},
            determined,
        )

    def _information(self, numbers: list[int], design: Design) -> FloatArray:
        n_p = len(self.p)
        scale = np.concatenate([np.ones(n_p), self._scale(design)])
        draws = {d for k in numbers for d in enumerate(self._images[k].groups)}
        column = {draw: n_p + z for z, draw in enumerate(sorted(draws))}
        joint = np.zeros((n_p + len(column),) * 2)
        for k in numbers:
            at = [*range(n_p), *(column[draw] for draw in enumerate(self._images[k].groups))]
            joint[np.ix_(at, at)] += self._matrix(k, design) * np.outer(scale, scale)
        # Each draw is an unknown of mean 0 and variance 1.
        nuisance = joint[n_p:, n_p:] + np.eye(len(column))
        cross = joint[:n_p, n_p:]
        schur = joint[:n_p, :n_p] - cross @ np.linalg.solve(nuisance, cross.T)
        return np.asarray((schur + schur.T) / 2)


def _compact(term: SharedTerm, n: int) -> NDArray[np.int64]:
    """Draws of a term counted from 0."""
    if term.group is None:
        return np.zeros(n, dtype=np.int64)
    return np.asarray(np.unique(term.group, return_inverse=True)[1])


def _inverse(information: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inverse over the directions with information, and the parameters that it determines."""
    every = np.ones(len(information), np.bool_)
    determined, inverse = curvature.marginal_inverse(information, every)
    return inverse, determined


def _standard(information: FloatArray) -> FloatArray:
    """Standard uncertainties (P,) of an information; infinite where there is none."""
    inverse, determined = _inverse(information)
    return np.where(determined, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.inf)
