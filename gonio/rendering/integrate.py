"""Radiance of the surfaces in a scene, by the reflection equation.

L_r(r) = int f(i, r) L_i(i) cos(theta_i) dw_i

Light from a solid angle is summed by two draws for each sample of a pixel, one towards the light
and one as the surface reflects, both divided by the sum of their densities (Veach & Guibas 1995,
the balance heuristic of their eq. (14) with one draw of each): where one of the two has a large
variance, the other has a small one.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

import gonio.models as models
from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks
from gonio.models import Model
from gonio.models.sampling import drawn, mixed_density
from gonio.rendering.lights import Directional, Light, Towards
from gonio.rendering.scene import Camera, Scene
from gonio.rendering.scene import scene as named_scene
from gonio.rendering.shapes import Hits, hidden, trace

Progress = Callable[[int, int], None]
LARGEST = 8192  # pixels along an edge
_TASK = 1 << 15  # rays in one task: some MB
_LIFT = 1e-6  # height above its surface at which a ray starts, over the scene's extent


@dataclass(frozen=True)
class _Surface:
    """The material of a scene, and its shapes."""

    model: Model
    p: FloatArray
    scene: Scene
    turn: float

    @property
    def named(self) -> dict[str, float]:
        return dict(zip(self.model.names, self.p.tolist(), strict=True))

    def brdf(self, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
        """f of pairs (n, 3); negative values of a formula count as 0."""
        return np.maximum(self.model.evaluate(w_i, w_r, self.p, threads=1), 0.0)


def render(
    scene: Scene | str,
    light: Light,
    model: Model | str,
    p: Mapping[str, float] | None = None,
    *,
    camera: Camera | None = None,
    size: tuple[int, int] = (256, 256),
    samples: int = 16,
    turn: float = 0.0,
    bounces: int = 0,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> FloatArray:
    r"""Picture of a scene of one material: linear radiance, one grey channel.

    Parameters
    ----------
    scene : Scene or str
        A scene or the name of one: sphere, vase, plane, objects.
    light : Light
        `Directional`, `Rectangle` or `Environment`.
    model : Model or str
    p : mapping, optional
        Parameters by name, angles in radians; those left out take their defaults.
    camera : Camera, optional
        The scene's own view where not given.
    size : tuple of int
        Rows and columns; the shorter edge of what the scene shows fits the picture.
    samples : int
        Rays for each pixel, a square number: one in each cell of a grid over the pixel, at a
        random position.
    turn : float
        Angle by which the brushed direction, the model's x axis, is turned on the surface about
        its normal, radians. At 0 it runs along circles of latitude of sphere, vase and block,
        horizontally on a cube and along x on a plane.
    bounces : int
        Largest number of reflections between surfaces before the light reaches the camera. 0 is
        direct light only.
    seed : int
        Seed of all random numbers; the picture does not depend on the number of threads.
    threads : int, optional
        All cores where not given.
    progress : callable, optional
        Called with the number of rows that are done and their total.

    Returns
    -------
    ndarray, shape (rows, columns)
        Radiance in the unit of the light, top row first. Where a ray meets no surface, it is
        the radiance of the light in that direction, 0 for a distant lamp.

    Raises
    ------
    ConfigurationError
        For an unknown name, a parameter out of range, or a size or number that is not allowed.

    Notes
    -----
    Surfaces are lit on the side that faces the camera. Negative values of f, which the
    approximations of Oren and Nayar have at grazing directions, count as 0 in this module only.

    Examples
    --------
    A white Lambertian sphere, lit from the camera, has radiance cos(theta):

    >>> image = render("sphere", Directional(), "lambert", {"rho": 1.0}, size=(3, 3), samples=1)
    >>> bool(0.8 < image[1, 1] <= 1)
    True
    """
    scene = named_scene(scene) if isinstance(scene, str) else scene
    model = models.get(model)
    _check(size, samples, bounces)
    camera = camera or Camera(*scene.view, projection=scene.projection)
    surface = _Surface(model, model.vector(p or {}), scene, turn)
    rows, columns = size
    image = np.empty(size)
    step = max(1, _TASK // (columns * samples))
    blocks = -(-rows // step)
    seeds = np.random.SeedSequence(seed).spawn(blocks)
    done, lock = [0], threading.Lock()

    def work(first: int, last: int) -> None:
        for block in range(first, last):
            rng = np.random.default_rng(seeds[block])
            top, end = block * step, min((block + 1) * step, rows)
            image[top:end] = _rows(surface, light, camera, size, (top, end), samples, bounces, rng)
            with lock:
                done[0] += end - top
                if progress is not None:
                    progress(done[0], rows)

    map_blocks(work, blocks, threads=threads, block=1)
    return image


def _check(size: tuple[int, int], samples: int, bounces: int) -> None:
    for name, edge in zip(("rows", "columns"), size, strict=True):
        if not 1 <= edge <= LARGEST:
            raise ConfigurationError(
                f"{edge} {name} were asked for; a picture has 1 to {LARGEST}.", value=edge
            )
    if samples < 1 or math.isqrt(samples) ** 2 != samples:
        raise ConfigurationError(
            f"{samples} samples a pixel were asked for; give a square number such as 1, 4, 16 or "
            "64, one for each cell of a grid over the pixel.",
            value=samples,
        )
    if not 0 <= bounces <= 64:
        raise ConfigurationError(
            f"{bounces} bounces were asked for; allowed is 0 (direct light only) to 64.",
            value=bounces,
        )


def _rows(
    surface: _Surface,
    light: Light,
    camera: Camera,
    size: tuple[int, int],
    rows: tuple[int, int],
    samples: int,
    bounces: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Radiance of some rows of the picture."""
    x, y = _positions(surface.scene, size, rows, samples, rng)
    origin, along = camera.rays(surface.scene, x, y)
    hits = trace(surface.scene.shapes, origin, along, surface.turn)
    lamp = light.incoming(origin, along)
    radiance = np.where(hits.distance > lamp.distance, lamp.radiance, 0.0)
    radiance = np.where(hits.met, radiance, lamp.radiance)
    onto = np.flatnonzero(hits.met & ~(hits.distance > lamp.distance))
    radiance[onto] = _reflected(
        surface, light, _at(hits, onto), -along[onto], samples, bounces, rng
    )
    shape = (rows[1] - rows[0], size[1], samples)
    return np.asarray(radiance.reshape(shape).mean(axis=2))


def _positions(
    scene: Scene,
    size: tuple[int, int],
    rows: tuple[int, int],
    samples: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Positions right and up from the picture's middle, one in each cell of each pixel's grid."""
    pitch = max(scene.extent[0] / size[1], scene.extent[1] / size[0])
    k = math.isqrt(samples)
    shape = (rows[1] - rows[0], size[1], samples)
    # A single sample lies in the middle of its pixel.
    jitter = rng.random((2, *shape)) if samples > 1 else np.full((2, *shape), 0.5)
    cell = np.arange(samples)
    row, column = np.arange(*rows)[:, None, None], np.arange(size[1])[None, :, None]
    x = column + (cell % k + jitter[0]) / k - size[1] / 2
    y = size[0] / 2 - row - (cell // k + jitter[1]) / k
    return (x * pitch).ravel(), (y * pitch).ravel()


def _reflected(
    surface: _Surface,
    light: Light,
    hits: Hits,
    back: FloatArray,
    samples: int,
    bounces: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Radiance of n points along `back` (n, 3), with the light from other surfaces."""
    total, weight = np.zeros(len(back)), np.ones(len(back))
    index = np.arange(len(back))
    for bounce in range(bounces + 1):
        w_r = _into(hits.frame, back)
        above = w_r[:, 2] > 0
        hits, w_r, index, weight = _at(hits, above), w_r[above], index[above], weight[above]
        if not len(index):
            break
        point = hits.point + _LIFT * max(surface.scene.extent) * hits.frame[:, :, 2]
        start = replace(hits, point=point)
        # After the first reflection the samples no longer follow the cells of the pixel.
        cells = samples if bounce == 0 else 1
        total[index] += weight * _direct(surface, light, start, w_r, cells, rng)
        if bounce == bounces:
            break
        w_i = drawn(surface.model.lobes, surface.named, w_r, rng.random((3, len(w_r))))
        density = mixed_density(surface.model.lobes, surface.named, w_r, w_i)
        possible = density > 0
        f = surface.brdf(w_i[possible], w_r[possible])
        weight = weight[possible] * f * w_i[possible, 2] / density[possible]
        along = _out_of(hits.frame[possible], w_i[possible])
        hits = trace(surface.scene.shapes, point[possible], along, surface.turn)
        onto = hits.met & (hits.distance < light.incoming(point[possible], along).distance)
        hits, back = _at(hits, onto), -along[onto]
        index, weight = index[possible][onto], weight[onto]
    return total


def _direct(
    surface: _Surface,
    light: Light,
    hits: Hits,
    w_r: FloatArray,
    samples: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Radiance by light that comes straight from the light."""
    n = len(w_r)
    if isinstance(light, Directional):
        lamp = light.draw(hits.point, np.empty((2, 0)))
        w_i = _into(hits.frame, lamp.along)
        return _part(surface, hits, lamp, w_i, w_r, np.ones(n))
    lamp = light.draw(hits.point, _stratified(n, samples, rng))
    w_i = _into(hits.frame, lamp.along)
    total = _part(surface, hits, lamp, w_i, w_r, lamp.density + _density(surface, w_r, w_i))
    u = np.concatenate([rng.random((1, n)), _stratified(n, samples, rng)])
    w_i = drawn(surface.model.lobes, surface.named, w_r, u)
    density = _density(surface, w_r, w_i)
    lamp = light.incoming(hits.point, _out_of(hits.frame, w_i))
    return total + _part(surface, hits, lamp, w_i, w_r, lamp.density + density)


def _density(surface: _Surface, w_r: FloatArray, w_i: FloatArray) -> FloatArray:
    """Density in which the surface draws directions of light for the viewer w_r, by reciprocity."""
    return mixed_density(surface.model.lobes, surface.named, w_r, w_i)


def _part(
    surface: _Surface,
    hits: Hits,
    lamp: Towards,
    w_i: FloatArray,
    w_r: FloatArray,
    density: FloatArray,
) -> FloatArray:
    """f L cos(theta_i)/density where the light is not hidden."""
    total = np.zeros(len(w_r))
    lit = np.flatnonzero((w_i[:, 2] > 0) & (lamp.radiance > 0) & (density > 0))
    dark = hidden(
        surface.scene.shapes, hits.point[lit], lamp.along[lit], lamp.distance[lit] * (1 - 1e-9)
    )
    lit = lit[~dark]
    f = surface.brdf(w_i[lit], w_r[lit])
    total[lit] = f * lamp.radiance[lit] * w_i[lit, 2] / density[lit]
    return total


def _stratified(n: int, samples: int, rng: np.random.Generator) -> FloatArray:
    """Numbers (2, n) in [0, 1): each run of `samples` has one in each cell of a square grid."""
    u = rng.random((2, n))
    k = math.isqrt(samples)
    if k < 2:
        return u
    whole = -(-n // samples)
    cell = rng.permuted(np.tile(np.arange(samples), (whole, 1)), axis=1).ravel()[:n]
    return np.asarray((np.stack([cell % k, cell // k]) + u) / k)


def _into(frame: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (n, 3) of the scene in the frame of the surface at n points."""
    return np.asarray(np.einsum("nij,ni->nj", frame, v))


def _out_of(frame: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (n, 3) of the surface's frame in that of the scene."""
    return np.asarray(np.einsum("nij,nj->ni", frame, v))


def _at(hits: Hits, index: np.ndarray) -> Hits:
    return Hits(hits.distance[index], hits.point[index], hits.frame[index])
