"""A plane mirror in place of the sample: sharp images of the lamp at known directions.

An alignment calibration uses them: the centroid of a spot gives the viewing direction of the
pixels.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument import imaging
from gonio.instrument.holder import tilted

if TYPE_CHECKING:
    from gonio.instrument import Instrument

REFLECTANCE = 0.9
_RAYS = 2048  # per pixel where the spot may lie; the centroid is then accurate to 0.003 pixels
_BLOCK = 16


def brightest_rate(instrument: Instrument, rays: imaging.Rays) -> float:
    """Largest number of photo-electrons per second in a pixel filled by the source."""
    return float(imaging.white_rate(instrument, rays).max()) * _over_white(instrument)


def spot_rate(
    instrument: Instrument,
    rays: imaging.Rays,
    theta_i: float,
    *,
    wedge: float,
    psi: float,
    seed: int,
) -> FloatArray:
    """Photo-electrons per second, shape (n,), from a mirror that reflects the source of the lamp.

    A ray counts where its mirrored direction falls into the source's cone and where it lands on
    lit mirror. Radiance is that of the source times the mirror's reflectance, whatever the angle.

    Parameters
    ----------
    instrument : Instrument
    rays : Rays
        From `imaging.trace_rays`.
    theta_i : float
        Angle of the lamp arm, radians; below 0 it stands at azimuth 180 deg.
    wedge, psi : float
        Tilt of the mirror's normal from the holder's axis, and the azimuth it is tilted towards,
        which is the rotation of the holder; radians.
    seed : int
        Seed of the dome, as for the rays.

    Raises
    ------
    ConfigurationError
        If the source is a point, whose image is smaller than any pixel.
    """
    over_white = _over_white(instrument)
    rate = np.zeros(len(rays.pixel))
    # A pixel with one ray near the source is traced again with many rays.
    near = np.radians(instrument.lamp.half_angle_deg) + _extent(instrument)
    first = _mirrored(instrument, rays.w_r[:, 0], wedge, psi)
    close = np.flatnonzero(first @ unit_vectors(theta_i, 0.0) > np.cos(min(near, np.pi)))
    white = imaging.white_rate(instrument, rays) * over_white
    for start in range(0, len(close), _BLOCK):
        some = close[start : start + _BLOCK]
        share = _share_of_source(instrument, rays.pixel[some], theta_i, wedge, psi, seed)
        rate[some] = white[some] * share
    return rate


def _extent(instrument: Instrument) -> float:
    """No two rays of a pixel lie farther apart at the sample, radians: diagonal and pupil.

    The reflection stretches angles by up to 1.3 (D/R = 0.15), the lens by little more than 1.
    """
    lens, sensor = instrument.lens, instrument.sensor
    diagonal = math.hypot(*sensor.pitch_um) * 1e-3 * sensor.binning
    return 1.5 * diagonal / lens.focal_length_mm + 2 * lens.pupil_mm / instrument.dome.R


def _over_white(instrument: Instrument) -> float:
    """Radiance of the source in the mirror over that of a white surface lit at normal incidence.

    E = L pi sin^2(a) for a source of radiance L and half-angle a; the white surface has E/pi.
    """
    if not instrument.lamp.half_angle_deg:
        raise ConfigurationError(
            f"the lamp of {instrument.name} is a point (half_angle_deg = 0): its mirror image "
            "falls into one pixel and has no centroid; give it a half-angle.",
            value=0.0,
        )
    return REFLECTANCE / math.sin(math.radians(instrument.lamp.half_angle_deg)) ** 2


def _share_of_source(
    instrument: Instrument,
    pixel: NDArray[np.int64],
    theta_i: float,
    wedge: float,
    psi: float,
    seed: int,
) -> FloatArray:
    """Mean of U over the rays of some pixels; 0 for rays that miss source or mirror."""
    sensor, lamp, holder = instrument.sensor, instrument.lamp, instrument.holder
    in_pixel, in_pupil = _dense_pattern()
    x, y = sensor.positions_mm()
    row, column = np.divmod(pixel, sensor.shape[1])
    pitch = np.array(sensor.pitch_um) * 1e-3 * sensor.binning
    points = np.stack([x[column], y[row]], -1)[:, None, :] + in_pixel * pitch
    _, w_r, landing = imaging.trace_points(instrument, points, in_pupil, seed)
    towards = _mirrored(instrument, w_r, wedge, psi) @ unit_vectors(theta_i, 0.0)
    sees = towards >= math.cos(math.radians(lamp.half_angle_deg))
    at_x, at_y = landing[..., 0], landing[..., 1]
    sees &= at_x**2 + at_y**2 <= (holder.sample_diameter_mm / 2) ** 2
    moved = holder.height_mm * math.tan(theta_i)
    return np.asarray(np.mean(sees * lamp.lit(theta_i, at_x - moved, at_y), axis=1))


def _mirrored(instrument: Instrument, w_r: FloatArray, wedge: float, psi: float) -> FloatArray:
    """Directions (..., 3) from which light comes that the mirror sends to w_r, laboratory frame."""
    holder = instrument.holder
    normal = tilted(np.array([0.0, 0.0, 1.0]), -wedge, psi)
    if holder.tilt_deg:
        tilt, azimuth = np.radians(holder.tilt_deg), np.radians(holder.tilt_azimuth_deg)
        normal = tilted(normal, -tilt, azimuth)
    return np.asarray(2 * (w_r @ normal)[..., None] * normal - w_r)


@cache
def _dense_pattern() -> tuple[FloatArray, FloatArray]:
    """Positions in a pixel (side 1) and in a pupil (radius 1), evenly distributed."""
    points = qmc.Sobol(4, scramble=True, rng=21).random(_RAYS)
    radius, angle = np.sqrt(points[:, 2]), 2 * np.pi * points[:, 3]
    return points[:, :2] - 0.5, np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
