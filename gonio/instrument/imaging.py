"""Image formation: from a BRDF to photo-electrons a second in every pixel.

Every pixel averages a few rays. Each has its own place in the pixel, in the lens pupil and in the
source; it is traced through the lens, off the dome and down to the sample, and counts where it
lands on lit sample. The places are low-discrepancy points whose first and second moments are made
exact, so that the narrow kernels of pixel, pupil and source act on a lobe as the full integrals
would, to fourth order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from gonio.geometry import FloatArray, hemisphere_quadrature, rotated, unit_vectors
from gonio.kernels.threads import map_blocks
from gonio.models import Model

if TYPE_CHECKING:
    from gonio.instrument import Instrument


_BLOCK = 4096  # pixels whose rays are worked on at a time: some MB


def ray_pattern(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places of n rays in a pixel, a pupil and a source, each of shape (n, 2).

    The pixel is the square [-1/2, 1/2]^2, pupil and source are discs of radius 1. Means are 0,
    variances those of the uniform square (1/12) and disc (1/4), covariances 0.

    Examples
    --------
    >>> pixel, pupil, source = ray_pattern(16)
    >>> bool(abs(pixel.var(axis=0) - 1 / 12).max() < 1e-12)
    True
    """
    if n == 1:
        zero = np.zeros((1, 2))
        return zero, zero, zero
    points = qmc.Sobol(6, scramble=True, rng=20).random(n) - 0.5
    points -= points.mean(axis=0)
    values, vectors = np.linalg.eigh(points.T @ points / n)
    points = points @ (vectors / np.sqrt(values)) @ vectors.T
    return points[:, :2] / np.sqrt(12), points[:, 2:4] / 2, points[:, 4:] / 2


@dataclass(frozen=True)
class Rays:
    """Traced rays of all pixels inside the image circle, laboratory frame.

    Parameters
    ----------
    pixel : ndarray of int, shape (n,)
        Flat index of the pixel in the frame.
    throughput : ndarray, shape (n,)
        Relative illumination times solid angle of the pixel, 1 on the axis.
    w_r : ndarray, shape (n, rays, 3)
        Directions from sample to dome.
    landing : ndarray, shape (n, rays, 2)
        Where each ray meets the sample plane, mm from the target.
    source : ndarray, shape (rays, 2)
        Each ray's place in the source, unit disc.
    spread : float
        Largest angle between the first and another ray of one pixel, radians.
    reach : ndarray, shape (n,)
        Largest distance from the target at which a ray of the pixel lands, mm.
    """

    pixel: NDArray[np.int64]
    throughput: FloatArray
    w_r: FloatArray
    landing: FloatArray
    source: FloatArray
    spread: float
    reach: FloatArray


def trace_rays(instrument: Instrument, seed: int, *, threads: int | None = None) -> Rays:
    """Trace every pixel of the instrument through the lens, off the dome, to the sample.

    Parameters
    ----------
    instrument : Instrument
    seed : int
        Seed of the dome's slope errors.
    threads : int, optional
        The rays do not depend on it.
    """
    lens, dome, sensor = instrument.lens, instrument.dome, instrument.sensor
    in_pixel, in_pupil, in_source = ray_pattern(instrument.rays_per_pixel)
    x, y = sensor.positions_mm()
    columns, rows = (grid.ravel() for grid in np.meshgrid(x, y))
    theta_c = lens.polar_angle(np.hypot(columns, rows))
    pixel = np.flatnonzero(np.isfinite(theta_c))
    pitch = np.array(sensor.pitch_um) * 1e-3 * sensor.binning
    points = np.stack([columns[pixel], rows[pixel]], -1)[:, None, :] + in_pixel * pitch
    w_r = np.empty((len(pixel), len(in_pixel), 3))
    landing = np.empty((len(pixel), len(in_pixel), 2))
    chord, reach = np.empty(len(pixel)), np.empty(len(pixel))

    def work(start: int, stop: int) -> None:
        origin, direction = _through_lens(instrument, points[start:stop], in_pupil)
        meets = dome.hit(origin, direction)
        slope = None
        if dome.slope_error_deg or dome.rim_slope_error_deg:
            slope = dome.slope_errors(meets, np.random.default_rng(seed))
        w, at = dome.reflect(meets, direction, slope)
        w_r[start:stop], landing[start:stop] = w, at
        apart = w - w[:, :1]
        chord[start:stop] = np.sqrt(np.einsum("...i,...i->...", apart, apart).max(axis=1))
        reach[start:stop] = np.sqrt(np.einsum("...i,...i->...", at, at).max(axis=1))

    map_blocks(work, len(pixel), threads=threads, block=_BLOCK)
    theta_c = theta_c[pixel]
    throughput = lens.relative_illumination(theta_c) * lens.solid_angle(theta_c)
    spread = 2 * float(np.arcsin(min(chord.max() / 2, 1.0)))
    return Rays(pixel, throughput, w_r, landing, in_source, spread, reach)


def _through_lens(
    instrument: Instrument, points: FloatArray, in_pupil: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Origins (mm) and directions of the rays that points of the image see."""
    lens, dome = instrument.lens, instrument.dome
    radius = np.hypot(points[..., 0], points[..., 1])
    # A ray of a rim pixel may leave the field by a fraction of a pixel; it is held at the edge.
    edge = lens.radius(np.radians(lens.field_deg / 2))
    theta_c = lens.polar_angle(np.minimum(radius, edge))
    phi_c = np.arctan2(points[..., 1], points[..., 0])
    chief = unit_vectors(theta_c, phi_c)
    centre = np.array([0.0, -dome.D, 0.0])
    if lens.pupil_mm == 0:
        return np.broadcast_to(centre, chief.shape), chief
    # A fisheye's entrance pupil faces the chief ray and its distance of sharp focus is the same
    # in all directions: R/2, about where the dome brings parallel light to a focus, or R.
    u, v = in_pupil[:, 0] * lens.pupil_mm / 2, in_pupil[:, 1] * lens.pupil_mm / 2
    cos, sin = np.cos(phi_c), np.sin(phi_c)
    along = u * chief[..., 2]
    offset = np.stack([along * cos - v * sin, along * sin + v * cos, -u * np.sin(theta_c)], -1)
    direction = (dome.R / 2 if lens.focus == "R/2" else dome.R) * chief - offset
    direction /= np.sqrt(np.einsum("...i,...i->...", direction, direction))[..., None]
    return centre + offset, direction


def lit_weights(instrument: Instrument, rays: Rays, theta_i: float) -> FloatArray:
    """Share of each ray (n, rays) in its pixel: 1/rays where it lands on lit sample, else 0."""
    lamp, per_pixel = instrument.lamp, rays.w_r.shape[1]
    radius = instrument.holder.sample_diameter_mm / 2
    share = np.full(rays.w_r.shape[:2], 1 / per_pixel)
    # The footprint holds the beam's own disc at every incidence: only pixels that reach out of
    # it need a closer look.
    doubtful = np.flatnonzero(rays.reach > 0.999 * min(radius, lamp.lit_diameter_mm / 2))
    x, y = rays.landing[doubtful, :, 0], rays.landing[doubtful, :, 1]
    lands = (x * x + y * y <= radius**2) & (rays.w_r[doubtful, :, 2] > 0)
    share[doubtful] *= lamp.lit(theta_i, x, y) * lands
    return share


def white_rate(instrument: Instrument, rays: Rays) -> FloatArray:
    """Photo-electrons a second, shape (n,), from a perfect white lit at normal incidence."""
    dome, sensor = instrument.dome, instrument.sensor
    on_axis = instrument.lamp.white_rate_e_per_s * dome.transmittance * dome.reflectance
    return sensor.n_summed * on_axis * rays.throughput


def mean_brdf(
    model: Model,
    p: FloatArray,
    w_i: FloatArray,
    w_r: FloatArray,
    weights: FloatArray,
    *,
    threads: int | None = None,
) -> FloatArray:
    """f averaged over the rays of each pixel, shape (n,), sr^-1.

    Parameters
    ----------
    model, p : Model, ndarray
        Model and its parameter vector.
    w_i : ndarray, shape (rays, 3)
        Direction towards the source of each ray, frame of the sample.
    w_r : ndarray, shape (n, rays, 3)
        Viewing directions, frame of the sample.
    weights : ndarray, shape (n, rays)
        From `lit_weights`.
    """
    out = np.empty(len(w_r))
    work = model.loops.image
    map_blocks(
        lambda a, b: work(w_i, w_r[a:b], weights[a:b], p, out[a:b]),
        len(out),
        threads=threads,
        block=2048,
    )
    return out


def albedo(model: Model, p: FloatArray, w_i: FloatArray) -> float:
    """Directional-hemispherical reflectance for light from one direction (3,)."""
    w_r, projected = _hemisphere()
    return float(np.sum(model.evaluate(np.broadcast_to(w_i, w_r.shape), w_r, p) * projected))


@cache
def _hemisphere() -> tuple[FloatArray, FloatArray]:
    """Viewing directions and their projected solid angles."""
    theta, phi, weight = hemisphere_quadrature(96, 192)
    return unit_vectors(theta, phi), np.cos(theta) * weight


def stray_rate(instrument: Instrument, rays: Rays, theta_i: float) -> FloatArray:
    """Lamp light, e-/s, that reaches each pixel (n,) without the sample's help."""
    surroundings = instrument.surroundings
    w_lamp = unit_vectors(theta_i, 0.0)
    patch = np.arctan(instrument.lamp.lit_diameter_mm / 2 / instrument.dome.R)
    share = np.full(len(rays.w_r), surroundings.stray)
    near = np.flatnonzero(rays.w_r[:, 0] @ w_lamp > np.cos(min(patch + rays.spread, np.pi)))
    inside = np.einsum("...i,i->...", rays.w_r[near], w_lamp) > np.cos(patch)
    share[near] += surroundings.entry_patch * np.mean(inside, axis=1)
    return np.asarray(share * white_rate(instrument, rays))


def standard_brdf(instrument: Instrument, rays: Rays) -> FloatArray:
    """f of the white standard for every ray (n, rays), sr^-1."""
    theta_r = np.arccos(np.clip(rays.w_r[..., 2], 0, 1))
    return instrument.standard.brdf(theta_r)


def in_sample_frame(rays: Rays, psi: float) -> FloatArray:
    """The rays' viewing directions for a sample turned by `psi`: phi_sample = phi_lab - psi."""
    return np.ascontiguousarray(rotated(rays.w_r, psi)) if psi else rays.w_r
