"""Resolution of an instrument: blur and coverage of every direction, smallest roughness.

Bundles of rays are traced from a grid over the lens's field through the same stages as in
`imaging`. The blur is their second moments; no optical formula is needed. It includes what spreads
the directions of one pixel: its area, the pupil with focus and aberrations of the dome, the point
spread and the source cone. Slope errors of the dome are correlated over distances much larger than
the footprint of a pixel: they shift directions and do not blur them. They are reported separately.
(They change a pixel's width by about 2 sd/correlation: 2 % at 0.1 deg and 10 deg.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import HORIZON, FloatArray, angles, equal_area, unit_vectors
from gonio.instrument import Instrument
from gonio.instrument.imaging import Rays, lit_weights, ray_pattern, trace_points
from gonio.kernels.threads import map_blocks

EXCESS = 0.05  # relative widening of the smallest alpha by the blur
WHOLE = 0.99  # share of a pixel's rays on lit sample that counts as all
RAYS = 32
STEP_DEG = 0.25  # of the grid, in the lens's polar angle
SHOWN_THETA_I_DEG = (0.0, 60.0)
_SECTORS = 36
_NEAR_DEG = 2.0  # a direction without a ray this close is not visible
_BLOCK = 2048  # bundles per block of work: some ten MB


@dataclass(frozen=True)
class Resolution:
    """Blur and coverage over a grid of camera directions, T polar angles by P azimuths.

    The tensors are variances and covariance of the direction, rad^2, on the tangents that lie
    closest to x and y. NaN where no ray of a pixel lands on lit sample.

    Parameters
    ----------
    instrument : Instrument
    w_r : ndarray, shape (T, P, 3)
        Mean directions from sample to dome, laboratory frame.
    share : ndarray, shape (T, P)
        m_p: share of a pixel's rays that land on lit sample, lamp at normal incidence, where the
        lit patch is smallest; 0 outside the frame.
    optics : ndarray, shape (T, P, 2, 2)
        Pixel and pupil together, of the rays that land on lit sample.
    pixel, pupil, psf : ndarray, shape (T, P, 2, 2)
        Each alone; the pupil with focus and the dome's aberrations.
    source : float
        Variance on each axis that the source cone of half-angle a acts as, (a/2)^2, rad^2.
    """

    instrument: Instrument
    w_r: FloatArray
    share: FloatArray
    optics: FloatArray
    pixel: FloatArray
    pupil: FloatArray
    psf: FloatArray
    source: float

    @property
    def blur(self) -> FloatArray:
        """All of the blur, shape (T, P, 2, 2), rad^2."""
        return self.optics + self.psf + self.source * np.eye(2)

    @property
    def residual(self) -> FloatArray:
        """The blur that remains in a fit to reduced samples, shape (T, P, 2, 2), rad^2.

        The cells of the reduction integrate over pixel and source cone.
        """
        return self.pupil + self.psf

    @property
    def theta_r(self) -> FloatArray:
        """Polar angles of the directions, shape (T, P), radians."""
        return np.minimum(angles(self.w_r)[0], HORIZON)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """True inside the rim mask of the reduction, shape (T, P)."""
        limit = np.radians(self.instrument.usable_theta_r_deg)
        return np.asarray(self.theta_r <= limit * (1 + 1e-12))

    @property
    def solid_angle(self) -> FloatArray:
        """Solid angle, sr, that each point of the grid stands for, shape (T, P)."""
        x, y = equal_area(self.w_r)
        x_t, y_t = np.gradient(x, axis=0), np.gradient(y, axis=0)
        x_p, y_p = ((np.roll(v, -1, axis=1) - np.roll(v, 1, axis=1)) / 2 for v in (x, y))
        area = 2 * np.abs(x_t * y_p - y_t * x_p)  # the disc of area pi holds 2 pi steradians
        area[-1] /= 2  # the edge of the field has cells on one side only
        return np.asarray(area)

    def at(self, tensor: FloatArray, theta_r: float, phi_r: float) -> FloatArray | None:
        """A tensor in one direction (radians), shape (2, 2); None where it is not visible."""
        near = self.w_r @ unit_vectors(theta_r, phi_r)
        near = np.where(self.share > 0, near, -1.0)
        k = np.unravel_index(int(np.argmax(near)), near.shape)
        visible = near[k] > np.cos(np.radians(_NEAR_DEG))
        return np.asarray(tensor[k]) if visible else None

    def reach(self, least: float) -> FloatArray:
        """Largest theta_r, radians, up to which `share` is at least `least`, by azimuth.

        Parameters
        ----------
        least : float
            Greater than 0.

        Returns
        -------
        ndarray, shape (36,)
            For sectors of phi_r of 10 deg from 0: the smallest angle in the sector that is
            not visible well enough, less one step of the grid, or the largest that the field holds.
        """
        theta, phi = self.theta_r, angles(self.w_r)[1]
        sector = np.floor(phi % (2 * np.pi) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
        failing = self.share < least
        limit = np.full(_SECTORS, np.inf)
        step = np.radians(self.instrument.lens.field_deg / 2) / (len(theta) - 1)
        np.minimum.at(limit, sector[failing], theta[failing] - step)
        largest = np.zeros(_SECTORS)
        np.maximum.at(largest, sector[~failing], theta[~failing])
        return np.asarray(np.clip(limit, 0, largest))


def resolve(
    instrument: Instrument,
    *,
    rays: int = RAYS,
    step_deg: float = STEP_DEG,
    threads: int | None = None,
) -> Resolution:
    """Trace bundles of rays over the field of the lens and take their moments.

    Parameters
    ----------
    instrument : Instrument
        Its dome is taken without slope errors, which do not blur.
    rays : int
        Rays of a bundle, a power of 2.
    step_deg : float
        Step of the grid in the lens's polar angle, degrees; ten times that, and at most
        10/3 deg, in azimuth.
    threads : int, optional
        Number of worker threads; the result does not depend on it.

    Examples
    --------
    >>> from gonio.instrument import preset
    >>> resolution = resolve(preset("ideal12"))
    >>> round(float(np.degrees(resolution.reach(WHOLE).min())))
    88
    """
    unperturbed = _without_slope_errors(instrument)
    edge_deg = unperturbed.lens.field_deg / 2
    theta = np.radians(np.linspace(0, edge_deg, int(np.ceil(edge_deg / step_deg)) + 1))
    n_phi = max(3 * _SECTORS, int(np.ceil(36 / step_deg)))
    phi = np.arange(n_phi) * 2 * np.pi / n_phi
    radius = unperturbed.lens.radius(theta)[:, None, None]
    points = radius * np.stack([np.cos(phi), np.sin(phi)], -1)
    pitch = np.array(unperturbed.sensor.pitch_um) * 1e-3 * unperturbed.sensor.binning
    in_pixel, in_pupil, _ = ray_pattern(rays)
    none = np.zeros_like(in_pupil)

    def moments(pixel: FloatArray, pupil: FloatArray, *, lit: bool) -> list[FloatArray]:
        return _moments(unperturbed, points, pixel * pitch, pupil, lit=lit, threads=threads)

    w_r, share, optics = moments(in_pixel, in_pupil, lit=True)
    pixel = moments(in_pixel, none, lit=False)[2]
    pupil = moments(none, in_pupil, lit=True)[2]
    # A pixel is a square of variance 1/12 on both axes, the point spread a Gaussian of psf^2.
    psf = pixel * 12 * (unperturbed.lens.psf_px / unperturbed.sensor.binning) ** 2
    share = np.where(_in_frame(unperturbed, points), share, 0.0)
    blank = np.where(share > 0, 1.0, np.nan)[..., None, None]
    return Resolution(
        instrument=instrument,
        w_r=w_r,
        share=share,
        optics=optics * blank,
        pixel=pixel * blank,
        pupil=pupil * blank,
        psf=psf * blank,
        source=float(np.radians(unperturbed.lamp.half_angle_deg) / 2) ** 2,
    )


def _without_slope_errors(instrument: Instrument) -> Instrument:
    smooth = {"slope_error_deg": 0.0, "rim_slope_error_deg": 0.0}
    return instrument.model_copy(update={"dome": instrument.dome.model_copy(update=smooth)})


def _in_frame(instrument: Instrument, points: FloatArray) -> NDArray[np.bool_]:
    """Whether points (..., 2) of the image, mm from the lens axis, lie on the sensor."""
    inside = np.ones(points.shape[:-1], bool)
    for axis, centres in enumerate(instrument.sensor.positions_mm()):
        half = instrument.sensor.pitch_um[axis] * 1e-3 * instrument.sensor.binning / 2
        inside &= (points[..., axis] >= centres[0] - half) & (
            points[..., axis] <= centres[-1] + half
        )
    return np.asarray(inside)


def _moments(
    instrument: Instrument,
    points: FloatArray,
    in_pixel: FloatArray,
    in_pupil: FloatArray,
    *,
    lit: bool,
    threads: int | None,
) -> list[FloatArray]:
    """Mean direction (..., 3), lit share (...) and variance (..., 2, 2) of bundles of rays.

    Parameters
    ----------
    points : ndarray, shape (..., 2)
        Chief rays on the sensor, mm from the lens axis.
    in_pixel, in_pupil : ndarray, shape (rays, 2)
        Offsets from them, mm, and positions in the pupil, unit disc.
    lit : bool
        Use the rays that land on the lit sample; use all rays if there are none, or if false.
    """
    flat = points.reshape(-1, 2)
    n = len(flat)
    mean, share, tensor = np.empty((n, 3)), np.empty(n), np.empty((n, 2, 2))

    def work(start: int, stop: int) -> None:
        points = flat[start:stop, None, :] + in_pixel
        _, w, at = trace_points(instrument, points, in_pupil, 0)
        weights = _lit(instrument, w, at) if lit else np.full(w.shape[:2], 1 / w.shape[1])
        share[start:stop] = np.mean(weights > 0, axis=1)
        weights[share[start:stop] == 0] = 1.0
        weights /= weights.sum(axis=1, keepdims=True)
        mean[start:stop], tensor[start:stop] = _weighted(w, weights)

    map_blocks(work, n, threads=threads, block=_BLOCK)
    shape = points.shape[:-1]
    return [mean.reshape(*shape, 3), share.reshape(shape), tensor.reshape(*shape, 2, 2)]


def _lit(instrument: Instrument, w_r: FloatArray, landing: FloatArray) -> FloatArray:
    """Weights (n, rays) of rays by what is lit where they land, lamp at normal incidence."""
    none, reach = np.empty(0), np.hypot(landing[..., 0], landing[..., 1]).max(axis=1)
    rays = Rays(none.astype(np.int64), none, w_r, landing, none, 0.0, reach, none)
    return lit_weights(instrument, rays, 0.0)


def _weighted(w: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean unit vectors (n, 3) and variances on the tangents (n, 2, 2) of bundles (n, rays, 3)."""
    mean = np.einsum("nk,nki->ni", weights, w)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    t_x = np.array([1.0, 0.0, 0.0]) - mean[:, :1] * mean
    t_x /= np.maximum(np.linalg.norm(t_x, axis=1, keepdims=True), 1e-12)
    tangents = np.stack([t_x, np.cross(mean, t_x)], axis=1)
    across = np.einsum("nki,nai->nka", w, tangents)
    across -= np.einsum("nk,nka->na", weights, across)[:, None]
    return mean, np.einsum("nk,nka,nkb->nab", weights, across, across)


def principal(tensor: FloatArray) -> FloatArray:
    """Standard deviations along the two principal axes, larger first, of tensors (..., 2, 2).

    Examples
    --------
    >>> principal(np.array([[1.0, 0.0], [0.0, 4.0]])).tolist()
    [2.0, 1.0]
    """
    a, b, d = tensor[..., 0, 0], tensor[..., 0, 1], tensor[..., 1, 1]
    middle, half = (a + d) / 2, np.hypot((a - d) / 2, b)
    return np.sqrt(np.maximum(np.stack([middle + half, middle - half], -1), 0))


def effective_alpha(alpha: float, sd: float, cosine: float = 1.0) -> float:
    """Apparent width of a blurred lobe.

    Parameters
    ----------
    alpha : float
        Width of the lobe, exp(-tan^2(delta)/alpha^2).
    sd : float
        Blur of the viewing direction in or across the plane of incidence, radians.
    cosine : float
        1 in the plane of incidence, cos(theta_i) across it.

    Notes
    -----
    A turn of the viewing direction by d turns the half vector by d/2 in the plane and by
    d/(2 cos theta_i) across it, and the lobe has the variance alpha^2/2 on each axis:
    alpha_eff^2 = alpha^2 + sd^2/(2 cosine^2).

    Examples
    --------
    A source cone of half-angle 1 deg blurs by 0.5 deg:

    >>> round(effective_alpha(0.04, float(np.radians(0.5))) / 0.04 - 1, 4)
    0.0118
    """
    return float(np.sqrt(alpha**2 + sd**2 / (2 * cosine**2)))


def smallest_alpha(sd: float, cosine: float = 1.0, excess: float = EXCESS) -> float:
    """The width that blur increases by the fraction `excess`: the inverse of `effective_alpha`."""
    return float(sd / (cosine * np.sqrt(2 * ((1 + excess) ** 2 - 1))))


def pointing_sd(instrument: Instrument, theta: float) -> float:
    """Sd on each axis, radians, by which slope errors move directions at a polar angle, radians.

    A mirror that leans by e turns the ray by 2e.
    """
    dome = instrument.dome
    rim = dome.rim_slope_error_deg * (theta / HORIZON) ** 6
    return float(2 * np.radians(dome.slope_error_deg + rim))


def report(resolution: Resolution) -> dict[str, Any]:
    """All quantities, angles in degrees, as a document of schema gonio.resolution/1.

    Returns
    -------
    dict
        `alpha`: the smallest alpha in and across the plane of incidence, None where the specular
        direction is not visible or the arm does not go there, and by what share the blur still
        widens it where the fit integrates over pixel and source cone.
        `blur_deg`: principal standard
        deviations by cause, median and largest over what is visible of the usable hemisphere.
        `pointing_sd_deg`: slope errors of the dome. `theta_r`, `theta_i`: what is visible.
    """
    instrument = resolution.instrument
    return {
        "schema": "gonio.resolution/1",
        "instrument": instrument.name,
        "excess": EXCESS,
        "alpha": [_alpha_at(resolution, theta) for theta in SHOWN_THETA_I_DEG],
        "blur_deg": {
            name: _over_hemisphere(resolution, t) for name, t in _causes(resolution).items()
        },
        "pointing_sd_deg": {
            "zenith": _degrees(pointing_sd(instrument, 0.0)),
            "usable_rim": _degrees(
                pointing_sd(instrument, np.radians(instrument.usable_theta_r_deg))
            ),
        },
        "theta_r": _coverage(resolution),
        "theta_i": {
            "arm_max_deg": instrument.theta_i_max_deg,
            "specular_seen_max_deg": _specular_max_deg(resolution),
        },
    }


def _causes(resolution: Resolution) -> dict[str, FloatArray]:
    source = np.where(np.isnan(resolution.pixel), np.nan, resolution.source * np.eye(2))
    return {
        "pixel": resolution.pixel,
        "pupil": resolution.pupil,
        "psf": resolution.psf,
        "source": source,
        "total": resolution.blur,
    }


def _over_hemisphere(resolution: Resolution, tensor: FloatArray) -> dict[str, float | None]:
    """Median by solid angle and maximum of both principal values that are usable and visible."""
    inside = resolution.usable & (resolution.share > 0)
    if not inside.any():
        return {"median_major": None, "median_minor": None, "max": None}
    values, weight = principal(tensor[inside]), resolution.solid_angle[inside]
    return {
        "median_major": _degrees(median(values[:, 0], weight)),
        "median_minor": _degrees(median(values[:, 1], weight)),
        "max": _degrees(float(values[:, 0].max())),
    }


def median(values: FloatArray, weight: FloatArray) -> float:
    """Weighted median of values (n,).

    Examples
    --------
    >>> median(np.array([3.0, 1.0, 2.0]), np.array([0.2, 0.2, 0.6]))
    2.0
    """
    order = np.argsort(values)
    share = np.cumsum(weight[order]) / np.sum(weight)
    return float(values[order][np.searchsorted(share, 0.5)])


def _alpha_at(resolution: Resolution, theta_i_deg: float) -> dict[str, Any]:
    """Smallest alpha in and across the plane of incidence, at the specular direction."""
    theta = np.radians(theta_i_deg)
    visible = theta_i_deg <= resolution.instrument.theta_i_max_deg
    blur = resolution.at(resolution.blur, theta, np.pi) if visible else None
    left = resolution.at(resolution.residual, theta, np.pi) if visible else None
    axes: dict[str, Any] = {"in_plane": None, "across": None}
    if blur is not None and left is not None:
        for axis, (name, cosine) in enumerate({"in_plane": 1.0, "across": np.cos(theta)}.items()):
            sd, remaining = float(np.sqrt(blur[axis, axis])), float(np.sqrt(left[axis, axis]))
            alpha = smallest_alpha(sd, cosine)
            excess = effective_alpha(alpha, remaining, cosine) / alpha - 1 if alpha else 0.0
            axes[name] = {"alpha": alpha, "blur_deg": _degrees(sd), "excess_reduced": excess}
    return {"theta_i_deg": theta_i_deg, **axes}


def _coverage(resolution: Resolution) -> dict[str, Any]:
    """How far all azimuths, and the best, are visible; shares of the hemisphere's solid angle."""
    instrument, area = resolution.instrument, resolution.solid_angle
    limit = np.radians(instrument.usable_theta_r_deg)
    parts: dict[str, Any] = {
        "lens_field_deg": instrument.lens.field_deg,
        "rim_mask_deg": instrument.usable_theta_r_deg,
    }
    smallest = np.nextafter(0, 1)
    for name, least, rim in (
        ("any", smallest, HORIZON),
        ("whole", WHOLE, HORIZON),
        ("usable", smallest, limit),
        ("usable_whole", WHOLE, limit),
    ):
        reach = np.minimum(resolution.reach(least), rim)
        inside = (resolution.share >= least) & (resolution.theta_r <= rim * (1 + 1e-12))
        parts[name] = {
            "least_share": WHOLE if least == WHOLE else 0.0,
            "min_deg": _degrees(float(reach.min())),
            "max_deg": _degrees(float(reach.max())),
            "by_azimuth_deg": [_degrees(float(angle)) for angle in reach],
            "share_of_hemisphere": float(area[inside].sum() / (2 * np.pi)),
        }
    return parts


def _specular_max_deg(resolution: Resolution) -> float | None:
    """Largest incidence angle whose specular direction is usable, by the arm and by the dome.

    The lamp stands at phi_i = 0, the specular direction at 180 deg: two sectors meet there.
    """
    middle = _SECTORS // 2
    dome = float(np.degrees(resolution.reach(np.nextafter(0, 1))[middle - 1 : middle + 1].min()))
    instrument = resolution.instrument
    reach = min(instrument.theta_i_max_deg, instrument.usable_theta_r_deg, dome)
    return round(reach, 6) if reach > 0 else None


def _degrees(radians: float) -> float:
    return float(np.degrees(radians))
