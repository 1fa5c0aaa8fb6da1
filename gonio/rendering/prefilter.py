"""Environment maps that are filtered once and looked up afterwards, and their error.

Losasso's last section: all lighting is computed off-line for each direction and fetched at run
time. For a BRDF this takes a table over normal and viewer; with one over a single direction the
viewer is taken to look along the normal, and along the mirror direction of the true one:

M(d) = int f(i, d; n = d) L(i) cos(theta_i) dw_i,    L_r(n, r) ~ M(R) albedo(theta_r)/albedo(0)

with R = 2 (n.r) n - r for surfaces that shine, and n in place of R for matt ones. Both are right
where the viewer looks along the normal; elsewhere the true lobe is longer than that of the table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

import gonio.models as models
from gonio.errors import ConfigurationError, unknown_name
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks
from gonio.models import Model
from gonio.models.albedo import directional_albedo
from gonio.rendering.lights import Environment

About = Literal["mirror", "normal"]
_ALBEDO_AT = np.radians([0, 15, 30, 40, 50, 60, 70, 75, 80, 84, 87, 89])
_TURNS = 8  # of an anisotropic surface about its normal, over which a map is averaged
_MOST_PIXELS = 1 << 20  # pairs of directions in one task


@dataclass(frozen=True)
class Prefiltered:
    """A map that is looked up in place of an integral.

    Parameters
    ----------
    table : Environment
        Outgoing radiance along the normal, for each direction of the normal.
    about : {"mirror", "normal"}
        Direction in which it is looked up.
    albedo : ndarray
        Directional albedo at the angles `albedo_at`, over that at normal incidence.
    albedo_at : ndarray
        Radians.
    """

    table: Environment
    about: About
    albedo: FloatArray
    albedo_at: FloatArray

    def radiance(self, normal: FloatArray, back: FloatArray) -> FloatArray:
        """Approximate radiance of points with these normals, towards the viewer.

        Parameters
        ----------
        normal, back : ndarray, shape (n, 3)
            Unit vectors; `back` points to the viewer.

        Returns
        -------
        ndarray, shape (n,)
            0 where the viewer is below the horizon.
        """
        cos = np.sum(normal * back, axis=-1)
        at = normal if self.about == "normal" else 2 * cos[..., None] * normal - back
        share = np.interp(np.arccos(np.clip(cos, 0, 1)), self.albedo_at, self.albedo)
        return np.asarray(np.where(cos > 0, share * _between(self.table, at), 0.0))


def prefilter(
    environment: Environment,
    model: Model | str,
    p: Mapping[str, float] | None = None,
    *,
    about: About = "mirror",
    rows: int = 24,
    threads: int | None = None,
) -> Prefiltered:
    """Filter an environment by a model, for viewers along the normal.

    Parameters
    ----------
    environment : Environment
        Of 64 rows or more where it is not smooth: each pixel stands for its middle.
    model : Model or str
    p : mapping, optional
        Parameters by name, angles in radians.
    about : {"mirror", "normal"}
        Look the result up along the mirror direction (a lobe) or the normal (a matt surface).
    rows : int
        Rows of the table; it has twice as many columns.
    threads : int, optional

    Returns
    -------
    Prefiltered
        Of an anisotropic model the mean over eight turns about the normal.

    Raises
    ------
    ConfigurationError
        For an unknown name, or a table of less than 4 rows.
    """
    if about not in get_args(About):
        raise unknown_name("direction to look up", about, get_args(About))
    if rows < 4:
        raise ConfigurationError(f"rows = {rows}: a table has 4 rows or more.", value=rows)
    model = models.get(model)
    vector = model.vector(p or {})
    normal = Environment(np.ones((rows, 2 * rows))).directions().reshape(-1, 3)
    turns = np.arange(1 if model.claims.isotropic else _TURNS) * np.pi / _TURNS
    mean = np.mean(
        [outgoing(environment, model, vector, normal, normal, turn=t, threads=threads)
         for t in turns],
        axis=0,
    )  # fmt: skip
    named = dict(zip(model.names, vector.tolist(), strict=True))
    albedo = np.array([directional_albedo(model, named, t, rtol=1e-4).value for t in _ALBEDO_AT])
    table = Environment(np.maximum(mean, 0.0).reshape(rows, 2 * rows))
    return Prefiltered(table, about, albedo / (albedo[0] or 1.0), _ALBEDO_AT)


def outgoing(
    environment: Environment,
    model: Model,
    p: FloatArray,
    normal: FloatArray,
    back: FloatArray,
    *,
    turn: float = 0.0,
    threads: int | None = None,
) -> FloatArray:
    """Radiance of points with these normals, by the sum over every pixel of the environment.

    Parameters
    ----------
    environment : Environment
    model, p : Model, ndarray
        The model and its parameter vector.
    normal, back : ndarray, shape (n, 3)
        Unit vectors, outwards and to the viewer.
    turn : float
        Angle of the model's x axis from the circle of latitude about the upright, radians.
    threads : int, optional

    Returns
    -------
    ndarray, shape (n,)
    """
    along = environment.directions().reshape(-1, 3)
    flux = (environment.radiance * environment.solid_angle[:, None]).ravel()
    x = np.cross([0.0, 1.0, 0.0], normal)
    length = np.linalg.norm(x, axis=1, keepdims=True)
    x = np.where(length > 1e-9, x / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    y = np.cross(normal, x)
    x, y = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
    frame = np.stack([x, y, normal], axis=2)
    w_r = np.einsum("nij,ni->nj", frame, back)
    total = np.empty(len(normal))

    def work(first: int, last: int) -> None:
        w_i = along @ frame[first:last]  # (points, pixels, 3)
        f = model.evaluate(w_i, w_r[first:last, None, :], p, threads=1)
        total[first:last] = (np.maximum(w_i[..., 2], 0) * f) @ flux

    map_blocks(work, len(normal), threads=threads, block=max(1, _MOST_PIXELS // len(along)))
    return total


@dataclass(frozen=True)
class PrefilterError:
    """Looked-up radiance beside the sum over the environment, on a sphere.

    Parameters
    ----------
    theta_r : ndarray
        Angle between normal and viewer at each point, radians.
    exact, approximate : ndarray
        Radiance by the sum and by the table.
    """

    theta_r: FloatArray
    exact: FloatArray
    approximate: FloatArray

    @property
    def rms(self) -> float:
        """Root mean square difference over the root mean square radiance."""
        difference = np.sqrt(np.mean((self.approximate - self.exact) ** 2))
        return float(difference / np.sqrt(np.mean(self.exact**2)))


def prefilter_error(
    environment: Environment,
    model: Model | str,
    p: Mapping[str, float] | None = None,
    *,
    about: About = "mirror",
    rows: int = 24,
    n: int = 400,
) -> PrefilterError:
    """Compare the table with the sum, on a sphere and a distant viewer in front of it.

    Parameters
    ----------
    environment, model, p, about, rows
        As in `prefilter`.
    n : int
        Number of points, spread evenly over the picture of the sphere out to theta_r = 80 deg.

    Returns
    -------
    PrefilterError
    """
    model = models.get(model)
    table = prefilter(environment, model, p, about=about, rows=rows)
    # Even over the disc: a spiral by the golden angle.
    k = np.arange(n) + 0.5
    sin, phi = math.sin(math.radians(80)) * np.sqrt(k / n), k * math.pi * (3 - math.sqrt(5))
    normal = np.stack([sin * np.cos(phi), sin * np.sin(phi), np.sqrt(1 - sin**2)], axis=1)
    back = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
    exact = outgoing(environment, model, model.vector(p or {}), normal, back)
    return PrefilterError(np.arcsin(sin), exact, table.radiance(normal, back))


def _between(table: Environment, along: FloatArray) -> FloatArray:
    """Radiance between the middles of pixels, linear in both."""
    rows, columns = table.radiance.shape
    # A row stands for the middle of its solid angle, as in `directions`.
    up = np.cos(np.linspace(0, np.pi, rows + 1))
    polar = np.arccos(np.clip((up[1:] + up[:-1]) / 2, -1, 1))
    row = np.interp(np.arccos(np.clip(along[..., 1], -1, 1)), polar, np.arange(rows))
    column = (np.arctan2(along[..., 0], -along[..., 2]) / (2 * np.pi) + 0.5) * columns - 0.5
    r, c = np.minimum(row.astype(int), rows - 2), np.floor(column).astype(int)
    a, b = row - r, column - c
    left, right = c % columns, (c + 1) % columns
    v = table.radiance
    low = v[r, left] * (1 - b) + v[r, right] * b
    high = v[r + 1, left] * (1 - b) + v[r + 1, right] * b
    return np.asarray(low * (1 - a) + high * a)
