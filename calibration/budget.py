"""The uncertainty budget of BRDF samples, as metrologists write it (GUM, JCGM 100).

Every source with its effect on f, sample by sample. Errors of direction act through the slope of
f, which is taken from the neighbouring samples of the image. A blur acts through its curvature and
a turn of the sample through both directions at once. Samples do not determine these well enough:
they are left to the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.budget_page import page
from gonio.errors import DataError
from gonio.geometry import FloatArray, unit_vectors
from gonio.samples import BRDFSamples
from gonio.shared_term import Evaluation, SharedTerm

COVERAGE = 2.0  # k of the expanded uncertainty: 95 % of a normal distribution
TELLING = 3.0  # standard uncertainties that f must stand above 0 for a relative one to mean much
NEIGHBOURS = 10  # samples that a slope is taken from

Action = Literal["factor", "offset", "factor and offset", "turns", "blurs"]
SAMPLE, IMAGE, INCIDENCE, SOME, ALL = "sample", "image", "incidence", "incidences", "all"


@dataclass(frozen=True)
class Source:
    """One source of uncertainty.

    Parameters
    ----------
    name, meaning : str
    kind : {"A", "B"}
        A: from counts or from a fit to calibration frames; B: stated by certificate or operator.
    shared_by : str
        The samples that have one draw of it in common: one sample, those of an image, of an
        incidence or of neighbouring incidences, or all samples.
    acts : str
        As a factor on f, an offset or both, or by turning or blurring the viewing direction.
    u : ndarray, shape (N,), or None
        Standard uncertainty of every sample by it, sr^-1; None if samples do not determine it.
    effect : str, optional
        Key of the effect that it belongs to; None for noise and where it is not known.
    """

    name: str
    meaning: str
    kind: Evaluation
    shared_by: str
    acts: Action
    u: FloatArray | None
    effect: str | None = None


@dataclass(frozen=True)
class Budget:
    """Sources of uncertainty of samples, and the sources that are not included.

    Parameters
    ----------
    samples : BRDFSamples
    sources : tuple of Source
    unknown : tuple of str
        Sources whose size nobody stated: not counted.

    Notes
    -----
    `print` shows the table that `gonio budget` prints.
    """

    samples: BRDFSamples
    sources: tuple[Source, ...]
    unknown: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(page(self.describe()))

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    @property
    def counted(self) -> tuple[Source, ...]:
        """Sources that take part in the combined uncertainty."""
        return tuple(source for source in self.sources if source.u is not None)

    @property
    def combined(self) -> FloatArray:
        """Combined standard uncertainty of every sample, sr^-1."""
        squares = [source.u**2 for source in self.sources if source.u is not None]
        return np.asarray(np.sqrt(np.sum(squares, axis=0)))

    @property
    def telling(self) -> NDArray[np.int64]:
        """Indices of the samples whose f stands clear of 0."""
        u = self.samples.u_independent
        floor = np.zeros(len(self.samples)) if u is None else TELLING * u
        return np.flatnonzero(self.samples.value > floor).astype(np.int64)

    def nearest(self, theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> int:
        """Index of the sample closest to a pair of directions, radians."""
        w_i, w_r = self.samples.directions.vectors()
        off = np.square(w_i - unit_vectors(theta_i, phi_i)).sum(axis=1)
        off = off + np.square(w_r - unit_vectors(theta_r, phi_r)).sum(axis=1)
        return int(np.argmin(off))

    def describe(self, at: int | None = None) -> dict[str, Any]:
        """The budget over all samples, or of one, as data for JSON.

        Parameters
        ----------
        at : int, optional
            Index of a sample.

        Raises
        ------
        DataError
            If no sample stands clear of 0.
        """
        index = self.telling if at is None else np.array([at])
        if len(index) == 0:
            raise DataError(
                "every sample is 0 within its noise: relative uncertainties have no meaning."
            )
        combined, f = self.combined[index], np.abs(self.samples.value[index])
        sources = []
        for source in self.sources:
            row: dict[str, Any] = {
                "name": source.name,
                "meaning": source.meaning,
                "effect": source.effect,
                "kind": source.kind,
                "shared_by": source.shared_by,
                "acts": source.acts,
                "relative": None,
                "share_of_variance": None,
            }
            if source.u is not None:
                row["relative"] = _summary(source.u[index] / f)
                row["share_of_variance"] = float(np.mean((source.u[index] / combined) ** 2))
            sources.append(row)
        d = self.samples.directions
        names = ("theta_i", "phi_i", "theta_r", "phi_r")
        n = len(self.samples)
        here = None if at is None else {
            name: float(np.degrees(np.broadcast_to(getattr(d, name), n)[at])) for name in names
        } | {"value": float(self.samples.value[at])}  # fmt: skip
        return {
            "schema": "gonio.budget/1",
            "quantity": self.samples.quantity,
            "n_samples": n,
            "n_left_out": 0 if at is not None else n - len(index),
            "at": here,
            "sources": sources,
            "combined": _summary(combined / f),
            "expanded": _summary(COVERAGE * combined / f),
            "coverage_factor": COVERAGE,
            "degrees_of_freedom": None,
            "unknown": list(self.unknown),
        }


def budget(samples: BRDFSamples) -> Budget:
    """Collect the sources of uncertainty of samples.

    Parameters
    ----------
    samples : BRDFSamples

    Returns
    -------
    Budget

    Raises
    ------
    DataError
        If the samples state no uncertainty at all.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> theta = np.linspace(0.1, 1.2, 5)
    >>> samples = BRDFSamples(
    ...     Directions(0.3 * np.ones(5), 0.0, theta, 0.0), 0.1 + 0 * theta, 0.001 + 0 * theta
    ... )
    >>> [source.name for source in budget(samples).sources]
    ['independent']
    """
    if samples.u_independent is None and not samples.shared:
        raise DataError(
            "the samples state no uncertainty; reduce a session, or give a file with a column "
            "u_brdf."
        )
    sources = _noise(samples)
    slopes: _Slopes | None = None
    for term in samples.shared:
        acts: Action = "factor"
        u: FloatArray | None = np.abs(term.change(samples.value))
        if term.shift is not None:
            slopes = slopes or _Slopes(samples)
            acts, u = "turns", slopes.change(term.shift)
        elif term.turn > 0:
            acts, u = "turns", None
        elif term.blur > 0:
            acts, u = "blurs", None
        elif term.offset is not None:
            acts = "factor and offset" if term.relative else "offset"
        shared_by = _shared_by(samples, term)
        sources.append(
            Source(term.name, term.meaning, term.evaluation or "B", shared_by, acts, u, term.effect)
        )
    unknown = samples.metadata.get("unknown")
    if unknown is None:
        unknown = ["everything that the file does not state"]
    return Budget(samples, tuple(sources), tuple(unknown))


def _noise(samples: BRDFSamples) -> list[Source]:
    if samples.u_independent is None:
        return []
    u = samples.u_independent
    if samples.u_reference is None:
        return [Source("independent", "as the file states it", "B", SAMPLE, "offset", u)]
    own = np.sqrt(np.maximum(u**2 - samples.u_reference**2, 0.0))
    sharing = samples.reference_sharing
    same = f"{sharing} images" if sharing > 1 else SAMPLE
    return [
        Source("noise, sample", "photon and read noise of its frames", "A", SAMPLE, "offset", own),
        Source("noise, reference", "photon and read noise of standard and background", "A", same,
               "offset", samples.u_reference),
    ]  # fmt: skip


def _shared_by(samples: BRDFSamples, term: SharedTerm) -> str:
    """The samples that have one draw of a term in common."""
    if term.group is None or len(np.unique(term.group)) == 1:
        return ALL
    theta_i = np.broadcast_to(samples.directions.theta_i, (len(samples),))
    if samples.image is not None and _same_partition(term.group, samples.image):
        return INCIDENCE if _same_partition(term.group, theta_i) else IMAGE
    return INCIDENCE if _same_partition(term.group, theta_i) else SOME


def _same_partition(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two labels divide the samples into the same groups."""
    numbers = [np.unique(label, return_inverse=True)[1] for label in (a, b)]
    pairs = np.unique(np.stack(numbers), axis=1).shape[1]
    return bool(pairs == numbers[0].max() + 1 == numbers[1].max() + 1)


class _Slopes:
    """Slope of f at every sample from its neighbours in the image.

    A plane is fitted to the nearest samples; what its own noise adds to the square of a change is
    subtracted.
    """

    def __init__(self, samples: BRDFSamples) -> None:
        from scipy.spatial import cKDTree

        n = len(samples)
        image = np.zeros(n, np.int64) if samples.image is None else samples.image
        u = samples.u_independent
        weight = np.ones(n) if u is None else 1 / u**2
        _, w_r = samples.directions.vectors()
        self._gradient, self._covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
        for one in np.unique(image):
            at = np.flatnonzero(image == one)
            if len(at) < 4:
                continue
            _, near = cKDTree(w_r[at]).query(w_r[at], k=min(NEIGHBOURS, len(at)))
            self._fit(at, at[near], w_r, samples.value, weight)
        self._has_uncertainty = u is not None

    def _fit(
        self, at: Any, near: Any, w_r: FloatArray, value: FloatArray, weight: FloatArray
    ) -> None:
        """Weighted least squares of a + g.d over neighbours at the tangent vectors d."""
        here = w_r[at]
        d = w_r[near] - here[:, None, :]
        d -= np.einsum("nkj,nj->nk", d, here)[..., None] * here[:, None, :]
        e1 = np.cross(here, np.where(np.abs(here[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
        e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
        axes = np.stack([e1, np.cross(here, e1)], axis=1)
        plane = np.einsum("nkj,naj->nka", d, axes)
        scale = np.sqrt(np.mean(plane**2, axis=(1, 2)))[:, None, None]
        a = np.concatenate([np.ones((*near.shape, 1)), plane / np.maximum(scale, 1e-12)], axis=2)
        w = weight[near]
        top = w.max(axis=1, keepdims=True)
        normal = np.einsum("nka,nk,nkb->nab", a, w / top, a) + 1e-9 * np.eye(3)
        inverse = np.linalg.inv(normal)
        right = np.einsum("nka,nk,nk->na", a, w / top, value[near])
        fitted = np.einsum("nab,nb->na", inverse, right)
        back = axes / np.maximum(scale, 1e-12)
        self._gradient[at] = np.einsum("na,naj->nj", fitted[:, 1:], back)
        spread = inverse[:, 1:, 1:] / top[..., None]
        self._covariance[at] = np.einsum("nai,nab,nbj->nij", back, spread, back)

    def change(self, shift: FloatArray) -> FloatArray:
        """Size of the change of f where directions move by `shift` (N, 3)."""
        change = np.einsum("nj,nj->n", self._gradient, shift)
        if not self._has_uncertainty:
            return np.asarray(np.abs(change))
        noise = np.einsum("ni,nij,nj->n", shift, self._covariance, shift)
        return np.asarray(np.sqrt(np.maximum(change**2 - noise, 0.0)))


def _summary(relative: FloatArray) -> dict[str, float]:
    """Median, 5th and 95th percentile."""
    low, middle, high = np.percentile(relative, [5, 50, 95])
    return {"median": float(middle), "p5": float(low), "p95": float(high)}
