"""Importance sampling: directions drawn about as a model reflects, with their density.

The record of a model names its lobes. A draw chooses one of them by its share, about its part of
the albedo, and a direction within it; the density is the mean over all lobes,

pdf(r) = sum_k share_k pdf_k(r),

and f cos(theta_r)/pdf is the weight that makes the mean over draws the albedo. A draw may fall
below the horizon. It is kept, with weight 0: means are over all draws, and the density integrates
over the upper hemisphere to 1 less the share of those that are lost.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gonio.errors import DataError
from gonio.geometry import FloatArray

Named = Mapping[str, float]
Share = str | Callable[[Named, FloatArray], ArrayLike]

NADIR = np.array([0.0, 0.0, -1.0])  # where draws go that no facet sends anywhere


@dataclass(frozen=True)
class Draws:
    """One direction of reflection for each direction of incidence.

    Parameters
    ----------
    w_r : ndarray, shape (..., 3)
        Unit vectors; those below the horizon are lost.
    weight : ndarray, shape (...)
        f cos(theta_r)/density, 0 for lost draws. It has the sign of f.
    density : ndarray, shape (...)
        Probability density of w_r in sr^-1, 0 for lost draws.
    """

    w_r: FloatArray
    weight: FloatArray
    density: FloatArray


@dataclass(frozen=True, kw_only=True)
class Lobe(ABC):
    """One way to draw a direction of reflection; its fields are names of the model's parameters.

    Parameters
    ----------
    share : str or callable, optional
        About the albedo of the part of f that the lobe draws: the name of a parameter, or a
        function of the parameters (by name) and cos(theta_i); 1 where not given. It is positive
        wherever that part is.

    Notes
    -----
    `p` holds the parameters by name, `w_i` and `w_r` are unit vectors (n, 3) above the horizon.
    """

    share: Share | None = None

    def chance(self, p: Named, cos_i: FloatArray) -> ArrayLike:
        """How likely the lobe is chosen, against the other lobes of the model."""
        if self.share is None:
            return 1.0
        if isinstance(self.share, str):
            return p[self.share]
        return self.share(p, cos_i)

    @abstractmethod
    def draw(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        """Unit vectors (n, 3) from numbers u (2, n), uniform in [0, 1)."""

    @abstractmethod
    def density(self, p: Named, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
        """Probability density of `draw` at w_r, in sr^-1, shape (n,)."""


@dataclass(frozen=True, kw_only=True)
class Cosine(Lobe):
    """pdf(r) = (k + 1)/(2 pi) cos^k theta_r, uniform in azimuth.

    Parameters
    ----------
    k : str, optional
        Name of the exponent; 1 where not given, which suits any f without a peak.
    """

    k: str | None = None

    def _exponent(self, p: Named) -> float:
        return 1.0 if self.k is None else p[self.k]

    def draw(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        cos = (1 - u[0]) ** (1 / (self._exponent(p) + 1))
        sin, phi = np.sqrt(1 - cos * cos), 2 * np.pi * u[1]
        return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)

    def density(self, p: Named, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
        k = self._exponent(p)
        return np.asarray((k + 1) / (2 * np.pi) * w_r[:, 2] ** k)


class Facets(Lobe):
    """A lobe that mirrors the light at facets whose normals h are drawn.

    r = 2 (h.i) h - i and pdf(r) = pdf(h)/[4 (h.i)]; draws are lost whose h is below the horizon or
    turned away from the light.
    """

    @abstractmethod
    def normals(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        """Unit vectors h (n, 3) from numbers u (2, n), uniform in [0, 1)."""

    @abstractmethod
    def normal_density(self, p: Named, w_i: FloatArray, h: FloatArray) -> FloatArray:
        """Probability density of `normals` at h, in sr^-1, shape (n,)."""

    def draw(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        h = self.normals(p, w_i, u)
        cos = np.sum(h * w_i, axis=-1)
        mirrored = 2 * cos[:, None] * h - w_i
        return np.where(((cos > 0) & (h[:, 2] > 0))[:, None], mirrored, NADIR)

    def density(self, p: Named, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
        h = w_i + w_r
        length = np.linalg.norm(h, axis=-1)
        # h.i = |i + r|/2
        return np.asarray(self.normal_density(p, w_i, h / length[:, None]) / (2 * length))


def drawn(lobes: Sequence[Lobe], p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
    """One direction (n, 3) for each w_i (n, 3) from u (3, n): the first number chooses the lobe."""
    below = np.cumsum(_shares(lobes, p, w_i[:, 2]), axis=0)[:-1]
    chosen = np.sum(u[0] >= below, axis=0)
    w_r = np.empty(w_i.shape)
    for k, lobe in enumerate(lobes):
        own = chosen == k
        w_r[own] = lobe.draw(p, w_i[own], u[1:, own])
    return w_r


def mixed_density(lobes: Sequence[Lobe], p: Named, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
    """Density of `drawn` at w_r (n, 3), in sr^-1; 0 at and below the horizon."""
    above = w_r[:, 2] > 0
    w_i, w_r = w_i[above], w_r[above]
    shares = _shares(lobes, p, w_i[:, 2])
    pdf = np.zeros(len(above))
    pdf[above] = sum(q * lobe.density(p, w_i, w_r) for q, lobe in zip(shares, lobes, strict=True))
    return pdf


def _shares(lobes: Sequence[Lobe], p: Named, cos_i: FloatArray) -> FloatArray:
    """Probability of each lobe, (lobes, n); equal ones where no lobe reflects anything."""
    chances = [np.broadcast_to(lobe.chance(p, cos_i), cos_i.shape) for lobe in lobes]
    total = np.sum(chances, axis=0)
    nothing = total == 0
    shares: FloatArray = np.where(nothing, 1.0, chances) / np.where(nothing, len(lobes), total)
    return shares


def light(w_i: ArrayLike) -> FloatArray:
    """Directions of incidence as an array (..., 3), if they are unit vectors above the horizon.

    Raises
    ------
    DataError
        If one of them is not.
    """
    w_i = _unit("w_i", w_i)
    if w_i.size and not w_i[..., 2].min() > 0:
        lowest = float(w_i[..., 2].min())
        raise DataError(
            f"w_i has z = {lowest:.6g}, which is not above the horizon; give the direction "
            "towards the light, with z > 0.",
            value=lowest,
        )
    return w_i


def pairs(w_i: ArrayLike, w_r: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Directions of incidence and reflection, broadcast against each other.

    Raises
    ------
    DataError
        If they are no unit vectors, w_i is not above the horizon or the shapes do not broadcast.
    """
    i, r = light(w_i), _unit("w_r", w_r)
    try:
        i, r = np.broadcast_arrays(i, r)
    except ValueError:
        raise DataError(
            f"w_i of shape {i.shape} and w_r of shape {r.shape} do not broadcast; give equal "
            "shapes, or one direction."
        ) from None
    return i, r


def _unit(name: str, vectors: ArrayLike) -> FloatArray:
    v = np.asarray(vectors, float)
    if v.ndim == 0 or v.shape[-1] != 3:
        raise DataError(
            f"{name} has shape {v.shape}; give unit vectors of shape (..., 3), as "
            "gonio.geometry.unit_vectors makes them from angles.",
            value=v.shape,
        )
    length = np.linalg.norm(v, axis=-1)
    # Vectors read back from single precision pass.
    if not np.all(np.abs(length - 1) < 1e-6):
        worst = float(length.flat[np.argmax(np.where(np.isnan(length), np.inf, abs(length - 1)))])
        raise DataError(
            f"{name} holds a vector of length {worst:.6g}; give unit vectors, as "
            "gonio.geometry.unit_vectors makes them from angles.",
            value=worst,
        )
    return v
