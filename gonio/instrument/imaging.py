"""Image formation: from a BRDF to photo-electrons per second in every pixel.

Every pixel averages a few rays. Each ray has its own position in the pixel, in the lens pupil and
in the source. It is traced through the lens and off the dome to the sample, and counts if it lands
on the lit sample. The positions are low-discrepancy points with exact first and second moments, so
that the narrow kernels of pixel, pupil and source act on a lobe as the full integrals do, to fourth
order.

Each stage is a function of an instrument and traced rays; `images.py` defines their order. All
signals are relative to `white_rate`, the signal of a perfect white surface lit at normal incidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.special import ive
from scipy.stats import qmc

from gonio.geometry import FloatArray, angles, rotated, unit_vectors
from gonio.kernels.threads import map_blocks
from gonio.models import Model
from gonio.models.albedo import directional_albedo

if TYPE_CHECKING:
    from gonio.instrument import Instrument


_MOST_EVALUATIONS = 100_000  # of f for one albedo
# A few points have a skew, which a lobe would get; points and their opposites have no odd moments.
# Many have next to none. Fewer than six pairs leave one of the six axes out.
_PAIRED = (16, 32)
_SCRAMBLE = 268  # of 600 the one whose fourth moments, too, are next to those of square and discs
_BLOCK = 4096  # pixels per block of work: a few MB of rays


def ray_pattern(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions of n rays in a pixel, a pupil and a source, each of shape (n, 2).

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
    if n in _PAIRED:
        points = qmc.Sobol(6, scramble=True, rng=_SCRAMBLE).random(n // 2) - 0.5
        points = np.concatenate([points, -points])
        points = np.concatenate(
            [points[:, :2], _disc(points[:, 2:4]), _disc(points[:, 4:])], axis=1
        )
    else:
        points = qmc.Sobol(6, scramble=True, rng=20).random(n) - 0.5
        points -= points.mean(axis=0)
    values, vectors = np.linalg.eigh(points.T @ points / n)
    points = points @ (vectors / np.sqrt(values)) @ vectors.T
    return points[:, :2] / np.sqrt(12), points[:, 2:4] / 2, points[:, 4:] / 2


def _disc(square: FloatArray) -> FloatArray:
    """Points of [-1/2, 1/2]^2 on the unit disc by equal areas (Shirley & Chiu 1997)."""
    x, y = 2 * square.T
    steep = np.abs(y) > np.abs(x)
    radius = np.where(steep, y, x)
    turn = np.where(steep, x, y) / np.where(radius == 0, 1, radius) * np.pi / 4
    phi = np.where(steep, np.pi / 2 - turn, turn)
    return np.asarray(radius[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1))


@dataclass(frozen=True)
class Rays:
    """Traced rays of all pixels inside the image circle, laboratory frame.

    Parameters
    ----------
    pixel : ndarray of int, shape (n,)
        Flat index of the pixel in the frame.
    throughput : ndarray, shape (n,)
        Relative illumination times solid angle of the pixel times the dome's reflectance over
        its nominal value: 1 on the axis of an even dome.
    w_r : ndarray, shape (n, rays, 3)
        Directions from sample to dome.
    landing : ndarray, shape (n, rays, 2)
        Point where each ray meets the plane of the sample's surface, mm from its centre.
    source : ndarray, shape (rays, 2)
        Position of each ray in the source, unit disc.
    spread : float
        Largest angle between the first and another ray of one pixel, radians.
    reach : ndarray, shape (n,)
        Largest distance from the target at which a ray of the pixel lands, mm.
    point : ndarray, shape (n, 3)
        Mean point where the rays of the pixel meet the dome, mm.
    """

    pixel: NDArray[np.int64]
    throughput: FloatArray
    w_r: FloatArray
    landing: FloatArray
    source: FloatArray
    spread: float
    reach: FloatArray
    point: FloatArray


def trace_rays(instrument: Instrument, seed: int, *, threads: int | None = None) -> Rays:
    """Trace every pixel of the instrument through the lens, off the dome, to the sample.

    Parameters
    ----------
    instrument : Instrument
    seed : int
        Seed of the dome's slope errors and of its coating.
    threads : int, optional
        Number of worker threads; the rays do not depend on it.
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
    point = np.empty((len(pixel), 3))

    def work(start: int, stop: int) -> None:
        meets, w, at = trace_points(instrument, points[start:stop], in_pupil, seed)
        w_r[start:stop], landing[start:stop] = w, at
        point[start:stop] = meets.mean(axis=1)
        apart = w - w[:, :1]
        chord[start:stop] = np.sqrt(np.einsum("...i,...i->...", apart, apart).max(axis=1))
        reach[start:stop] = np.sqrt(np.einsum("...i,...i->...", at, at).max(axis=1))

    map_blocks(work, len(pixel), threads=threads, block=_BLOCK)
    theta_c = theta_c[pixel]
    throughput = lens.relative_illumination(theta_c) * lens.solid_angle(theta_c)
    if dome.reflectance_variation:
        throughput = throughput * coating_reflectance(instrument, point, seed)
    spread = 2 * float(np.arcsin(min(chord.max() / 2, 1.0)))
    return Rays(pixel, throughput, w_r, landing, in_source, spread, reach, point)


def coating_reflectance(instrument: Instrument, point: FloatArray, seed: int) -> FloatArray:
    """R_d at points of the dome (n, 3) over its nominal value; `seed` is that of the dome."""
    return instrument.dome.coating(point, _coating_rng(seed))[0]


def trace_points(
    instrument: Instrument, points: FloatArray, in_pupil: FloatArray, seed: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Follow rays from points of the image through the lens and off the dome to the sample.

    Parameters
    ----------
    instrument : Instrument
    points : ndarray, shape (n, rays, 2)
        On the sensor, mm from the lens axis.
    in_pupil : ndarray, shape (rays, 2)
        Position of each ray in the pupil, unit disc.
    seed : int
        Seed of the dome's slope errors.

    Returns
    -------
    meets, w_r : ndarray, shape (n, rays, 3)
        Points of the dome, mm, and directions from sample to dome.
    landing : ndarray, shape (n, rays, 2)
        As in `Rays`.
    """
    dome, height = instrument.dome, instrument.holder.height_mm
    origin, direction = _through_lens(instrument, points, in_pupil)
    meets = dome.hit(origin, direction)
    slope = None
    if dome.slope_error_deg or dome.rim_slope_error_deg:
        slope = dome.slope_errors(meets, np.random.default_rng(seed))
    w_r, landing = dome.reflect(meets, direction, slope)
    if height:
        landing = landing + height * w_r[..., :2] / np.maximum(w_r[..., 2:], 1e-9)
    return meets, w_r, landing


def _coating_rng(seed: int) -> np.random.Generator:
    """Generator of the coating, independent of that of the slope errors of the same dome."""
    return np.random.default_rng([seed, 1])


def _through_lens(
    instrument: Instrument, points: FloatArray, in_pupil: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Origins (mm) and directions of the rays that points of the image see."""
    lens, dome = instrument.lens, instrument.dome
    radius = np.hypot(points[..., 0], points[..., 1])
    # A ray of a rim pixel may leave the field by a fraction of a pixel; it is held at the edge.
    edge = lens.radius(np.radians(lens.field_deg / 2))
    theta_c = lens.polar_angle(np.minimum(radius, edge))
    phi_c = np.arctan2(points[..., 1], points[..., 0]) + np.radians(lens.azimuth_deg)
    chief = unit_vectors(theta_c, phi_c)
    centre = lens.pupil_centre(theta_c, dome.D)
    if lens.pupil_mm == 0:
        return centre, chief
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
    """Share of each ray (n, rays) in its pixel: U/rays where it lands on lit sample, else 0.

    Their sum over the rays of a pixel is m_p times the mean of the beam's U there.
    """
    lamp, per_pixel = instrument.lamp, rays.w_r.shape[1]
    radius = instrument.holder.sample_diameter_mm / 2
    share = np.full(rays.w_r.shape[:2], 1 / per_pixel)
    # The footprint holds the beam's own disc at every incidence: only pixels that reach out of
    # it need a closer look. On a sample that lies too high the footprint moves towards the lamp.
    moved = instrument.holder.height_mm * np.tan(theta_i)
    inside = 0.0 if lamp.edge_falloff else min(radius, lamp.lit_diameter_mm / 2 - abs(moved))
    doubtful = np.flatnonzero(rays.reach > 0.999 * inside)
    x, y = rays.landing[doubtful, :, 0], rays.landing[doubtful, :, 1]
    lands = (x * x + y * y <= radius**2) & (rays.w_r[doubtful, :, 2] > 0)
    share[doubtful] *= lamp.lit(theta_i, x - moved, y) * lands
    return share


def sample_share(instrument: Instrument, rays: Rays) -> FloatArray:
    """Share of the rays of each pixel (n,) that land on the sample, lit or not."""
    radius = instrument.holder.sample_diameter_mm / 2
    x, y = rays.landing[..., 0], rays.landing[..., 1]
    return np.asarray(np.mean((x * x + y * y <= radius**2) & (rays.w_r[..., 2] > 0), axis=1))


def white_rate(instrument: Instrument, rays: Rays) -> FloatArray:
    """Photo-electrons per second, shape (n,), from a perfect white lit at normal incidence."""
    dome, sensor = instrument.dome, instrument.sensor
    on_axis = instrument.lamp.white_rate_e_per_s * dome.transmittance * dome.reflectance
    return sensor.n_summed * on_axis * rays.throughput


def multibounce_gain(instrument: Instrument, rho: float, scale: float = 1.0) -> float:
    """Increase of the irradiance by light that lens and dome reflect back: 1 + g rho.

    `scale` is the true g over the value in the data sheet of the instrument.
    """
    return 1 + scale * instrument.surroundings.multibounce * rho


def irradiance(instrument: Instrument, theta_i: float, seed: int, *, below: bool = False) -> float:
    """Irradiance of the sample over that of a sample lit at normal incidence from above.

    T_d(P_i)/T_d cos(theta_i), with the angle to the true normal of the sample. Light from below
    does not pass the dome on its way in: cos(theta_i)/T_d.

    Parameters
    ----------
    instrument : Instrument
    theta_i : float
        Angle of the lamp arm, radians.
    seed : int
        Seed of the dome's coating.
    below : bool
        The lamp stands below the sample, for transmission.
    """
    cosine = float(instrument.holder.on_surface(unit_vectors(theta_i, 0.0))[2])
    if below:
        return cosine / instrument.dome.transmittance
    return cosine * entry_transmittance(instrument, theta_i, seed)


def entry_transmittance(instrument: Instrument, theta_i: float, seed: int) -> float:
    """T_d where the axis of the lamp's beam enters the dome, over its nominal value."""
    dome = instrument.dome
    if not dome.transmittance_variation:
        return 1.0
    return float(dome.coating(dome.entry_point(theta_i), _coating_rng(seed))[1])


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
    theta_i, phi_i = (float(angle) for angle in angles(w_i))
    named = dict(zip(model.names, p.tolist(), strict=True))
    # It changes the signal by some per cent: narrow lobes must be sampled, few digits suffice.
    return directional_albedo(
        model, named, theta_i, phi_i, rtol=1e-4, max_evaluations=_MOST_EVALUATIONS
    ).value


def stray_rate(
    instrument: Instrument, rays: Rays, theta_i: float, *, below: bool = False
) -> FloatArray:
    """Stray light of the lamp, e-/s, in each pixel (n,), without reflection by the sample.

    A beam from below does not enter the dome: there is no entry patch.
    """
    surroundings = instrument.surroundings
    share = np.full(len(rays.w_r), surroundings.stray)
    if below:
        return np.asarray(share * white_rate(instrument, rays))
    w_lamp = unit_vectors(theta_i, 0.0)
    patch = np.arctan(instrument.lamp.lit_diameter_mm / 2 / instrument.dome.R)
    near = np.flatnonzero(rays.w_r[:, 0] @ w_lamp > np.cos(min(patch + rays.spread, np.pi)))
    inside = np.einsum("...i,i->...", rays.w_r[near], w_lamp) > np.cos(patch)
    share[near] += surroundings.entry_patch * np.mean(inside, axis=1)
    return np.asarray(share * white_rate(instrument, rays))


def ambient_rate(instrument: Instrument, rays: Rays) -> FloatArray:
    """Room light, e-/s, that reaches each pixel (n,) with and without a sample."""
    return instrument.surroundings.ambient * white_rate(instrument, rays)


def reflected_ambient_rate(
    instrument: Instrument, rays: Rays, reflectance: FloatArray
) -> FloatArray:
    """Room light, e-/s, that the sample reflects to each pixel (n,).

    Parameters
    ----------
    reflectance : ndarray, shape (n,)
        Hemispherical-directional reflectance: radiance of a sample in even light relative to a
        perfect white. By reciprocity it is the albedo for light from that direction.
    """
    share = instrument.surroundings.ambient_reflected * sample_share(instrument, rays)
    return np.asarray(share * reflectance * white_rate(instrument, rays))


def standard_brdf(instrument: Instrument, rays: Rays, theta_i: float) -> FloatArray:
    """f of the white standard for every ray (n, rays), sr^-1.

    Parameters
    ----------
    instrument : Instrument
    rays : Rays
    theta_i : float
        Angle of the lamp, radians.
    """
    w_r = instrument.holder.on_surface(rays.w_r)
    theta_r = np.arccos(np.clip(w_r[..., 2], 0, 1))
    if not instrument.standard.shape.depends_on_incidence:
        return instrument.standard.brdf(0.0, theta_r, 0.0)
    w_i = instrument.holder.on_surface(instrument.lamp.directions(theta_i, rays.source))
    theta_l, phi_l = angles(w_i)
    return instrument.standard.brdf(theta_l, theta_r, np.arctan2(w_r[..., 1], w_r[..., 0]) - phi_l)


def standard_in_even_light(instrument: Instrument, rays: Rays) -> FloatArray:
    """Hemispherical-directional reflectance of the white standard in each pixel (n,)."""
    w_r = instrument.holder.on_surface(rays.w_r)
    theta_r = np.arccos(np.clip(w_r[..., 2], 0, 1))
    return np.asarray(instrument.standard.even_light(theta_r).mean(axis=1))


def in_sample_frame(instrument: Instrument, vectors: FloatArray, psi: float) -> FloatArray:
    """Laboratory vectors (..., 3) in the frame of a sample turned by `psi` on its holder.

    phi_sample = phi_lab - psi, about the sample's normal.
    """
    on_surface = instrument.holder.on_surface(vectors)
    return np.ascontiguousarray(rotated(on_surface, psi)) if psi else on_surface


_NODES_DEG = np.linspace(0, 88, 23)  # theta of the table of reflectances
_N_AZIMUTHS = 12


def even_light_reflectance(model: Model, p: FloatArray, w_r: FloatArray) -> FloatArray:
    """Hemispherical-directional reflectance for directions (n, 3), frame of the sample.

    Interpolated in a table over theta, and over phi if the model depends on it; room light is not
    known more accurately.
    """
    theta = np.radians(_NODES_DEG)
    phi = np.arange(1 if model.claims.isotropic else _N_AZIMUTHS) * 2 * np.pi / _N_AZIMUTHS
    table = np.array([[albedo(model, p, unit_vectors(t, f)) for f in phi] for t in theta])
    at_theta = np.degrees(np.arccos(np.clip(w_r[:, 2], 0, 1))) / _NODES_DEG[1]
    k = np.minimum(at_theta.astype(int), len(theta) - 2)
    a = np.minimum(at_theta - k, 1.0)
    at_phi = np.arctan2(w_r[:, 1], w_r[:, 0]) % (2 * np.pi) / (2 * np.pi / _N_AZIMUTHS)
    j = at_phi.astype(int)
    b = at_phi - j
    j, after = j % len(phi), (j + 1) % len(phi)
    low = table[k, j] * (1 - b) + table[k, after] * b
    high = table[k + 1, j] * (1 - b) + table[k + 1, after] * b
    return np.asarray(low * (1 - a) + high * a)


def point_spread(image: FloatArray, sd_px: float) -> FloatArray:
    """The image (rows, columns) blurred by a Gaussian of `sd_px` of its pixels on each axis.

    The weights are those of diffusion on a grid, exp(-s^2) I_n(s^2): they sum to 1 and have the
    variance s^2 whatever s is, where samples of a Gaussian do so only for s of a pixel and more.
    At the frame's edges the image is mirrored, so that no light is lost.

    References
    ----------
    Lindeberg 1990, "Scale-space for discrete signals", IEEE Trans. PAMI 12(3), pp. 234-254.
    """
    if not sd_px:
        return image
    reach = int(np.ceil(8 * sd_px)) + 3
    weights = ive(np.abs(np.arange(-reach, reach + 1)), sd_px**2)
    weights /= weights.sum()
    blurred = image
    for axis in (0, 1):
        blurred = convolve1d(blurred, weights, axis=axis, mode="reflect")
    return np.asarray(blurred)
