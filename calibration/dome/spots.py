"""Finds the lamp's mirror image in frames of a mirror: position and covariance of each spot.

A plane mirror in place of the sample sends the lamp's beam into one direction, so that the pixel
at the middle of the spot sees that direction. A centroid is not quite the middle: the spot is a
few pixels wide and its edge is sharp, and the map from pixels to directions bends. Both are
modelled with the map itself and subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.frames.exposure import Rate, average, merge
from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, unit_vectors
from gonio.session import Session

MIN_SIGNAL = 10.0  # standard deviations that a spot must stand above its surroundings
EDGE_SHARE = 0.05  # of the brightest pixel: below it a pixel does not belong to the spot
RIVAL_SHARE = 0.2  # of the spot's light: a second spot as bright leaves open which is meant
_MARGIN = 2  # pixels around the spot that still count
_FINE = 16  # points across a pixel where the spot is modelled
_ROUNDS = 3


@dataclass(frozen=True)
class Spot:
    """The lamp seen in the mirror.

    Parameters
    ----------
    name : str
        The image, for messages.
    theta_i : float
        Angle of the lamp, radians; below 0 it stands at azimuth 180 deg.
    psi, wedge : float
        Azimuth that the mirror's normal is tilted towards and by how much, radians.
    at : ndarray, shape (2,)
        Column and row that see the middle of the lamp.
    covariance : ndarray, shape (2, 2)
        From noise, px^2.
    """

    name: str
    theta_i: float
    psi: float
    wedge: float
    at: FloatArray
    covariance: FloatArray


def mirrored(theta_i: FloatArray, psi: FloatArray, wedge: FloatArray) -> FloatArray:
    """Directions (..., 3) into which a mirror sends the light of the lamp.

    Parameters
    ----------
    theta_i : array_like
        Angle of the lamp, radians; below 0 it stands at azimuth 180 deg.
    psi, wedge : array_like
        Azimuth and size of the tilt of the mirror's normal, radians.

    Examples
    --------
    A level mirror sends light at 30 deg to the other side:

    >>> np.round(mirrored(np.radians(30.0), 0.0, 0.0), 3).tolist()
    [-0.5, 0.0, 0.866]
    """
    w_i, n = unit_vectors(theta_i, 0.0), unit_vectors(wedge, psi)
    return np.asarray(2 * np.sum(w_i * n, axis=-1, keepdims=True) * n - w_i)


def find_spots(session: Session, pixel_map: PixelMap) -> tuple[list[Spot], dict[str, str]]:
    """The spots of a session of a mirror, and why other images have none.

    Parameters
    ----------
    session : Session
        Of a mirror; its background is subtracted. The first channel is used.
    pixel_map : PixelMap
        Gives the edge of the image and the shape of a spot; it need not be aligned.

    Returns
    -------
    spots : list of Spot
    lost : dict
        Name of an image and what is wrong with it.

    Raises
    ------
    ConfigurationError
        If the session is not one of a mirror.
    """
    plan, camera = session.metadata.plan, session.metadata.camera
    if plan.mode != "mirror":
        raise ConfigurationError(
            f"{session.path}: shows {session.metadata.sample}, not a mirror; an alignment needs a "
            "session whose plan has mode = mirror.",
            value=session.path,
        )
    session.require_complete()
    columns, rows = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    inside = np.isfinite(pixel_map.directions(columns, rows)[..., 0])

    def taken(role: str, take: int, incidence: int) -> Rate:
        return merge(session.bracket(role, take, incidence), plan.exposures_s, camera)

    spots: list[Spot] = []
    lost: dict[str, str] = {}
    for incidence, theta_deg in enumerate(plan.theta_i_deg):
        background = average([taken("background", k, incidence) for k in range(plan.repeats)])
        for rotation, psi_deg in enumerate(plan.rotations_deg):
            name = f"theta_i = {theta_deg:g} deg, rotation {psi_deg:g} deg"
            located = locate(taken("sample", rotation, incidence), background, inside)
            if isinstance(located, str):
                lost[name] = located
                continue
            at, covariance = located
            half_angle = session.metadata.lamp.half_angle_deg
            spots.append(
                Spot(
                    name,
                    float(np.radians(theta_deg)),
                    float(np.radians(psi_deg)),
                    float(np.radians(plan.wedge_deg)),
                    at if half_angle is None else _middle(pixel_map, at, np.radians(half_angle)),
                    covariance,
                )
            )
    return spots, lost


def locate(
    image: Rate, background: Rate, inside: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray] | str:
    """Centroid of the one bright spot of an image, column and row, with its covariance.

    Parameters
    ----------
    image, background : Rate
    inside : ndarray of bool, shape (rows, columns)
        Pixels within the image circle.

    Returns
    -------
    (at, covariance) or str
        px and px^2; or what is wrong.
    """
    signal = np.where(background.saturated, 0.0, image.value - background.value)
    variance = image.variance(image.value) + background.variance(background.value)
    saturated = image.saturated & ~background.saturated
    floor = np.maximum(MIN_SIGNAL * np.sqrt(variance), EDGE_SHARE * signal.max())
    blobs, n = ndimage.label((signal > floor) | saturated, np.ones((3, 3)))
    if n == 0:
        return "no spot"
    each = np.arange(1, n + 1)
    if np.any(clipped := ndimage.sum_labels(saturated, blobs, each)):
        return f"saturated in {int(clipped.sum())} pixels"
    light = ndimage.sum_labels(signal, blobs, each)
    largest = int(np.argmax(light))
    rivals = np.count_nonzero(light > RIVAL_SHARE * light[largest])
    if rivals > 1:
        return f"{rivals} spots"
    spot = ndimage.binary_dilation(blobs == largest + 1, np.ones((3, 3)), _MARGIN)
    if not inside[spot].all() or spot[[0, -1]].any() or spot[:, [0, -1]].any():
        return "at the edge of the image"
    if background.saturated[spot].any():
        return "on a pixel that is saturated without the mirror"
    row, column = np.nonzero(spot)
    positions = np.stack([column, row], axis=1)
    weight, noise = signal[spot], variance[spot]
    at = weight @ positions / weight.sum()
    away = positions - at
    return at, (away * noise[:, None]).T @ away / weight.sum() ** 2


def _middle(pixel_map: PixelMap, centroid: FloatArray, half_angle: float) -> FloatArray:
    """Column and row of the middle of a lamp of this half-angle whose centroid is given.

    The centroid of the light of a lamp in the middle m is c(m), by the solid angle of each pixel
    and the share of it that looks into the lamp's cone; c(m) = centroid is solved by repeated
    m <- m + centroid - c(m).
    """
    middle = centroid.copy()
    for _ in range(_ROUNDS if half_angle else 0):
        middle = middle + centroid - _centroid_of(pixel_map, middle, half_angle)
    return middle


def _centroid_of(pixel_map: PixelMap, middle: FloatArray, half_angle: float) -> FloatArray:
    """Column and row of the centroid of the light of a lamp that has its middle at a pixel."""
    w = pixel_map.directions(*middle)
    beside = pixel_map.directions(
        middle[0] + np.array([1.0, 0.0]), middle[1] + np.array([0.0, 1.0])
    )
    per_pixel = np.linalg.norm(beside - w, axis=1).min()
    # The scale changes over the cone: half as much again is looked at, and a pixel around.
    reach = int(np.ceil(1.5 * half_angle / per_pixel)) + 1
    near = np.arange(-reach, reach + 1)
    columns, rows = np.round(middle[0]) + near, np.round(middle[1]) + near
    fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    x, y = (columns[:, None] + fine).ravel(), (rows[:, None] + fine).ravel()
    sees = pixel_map.directions(*np.meshgrid(x, y)) @ w >= np.cos(half_angle)
    light = sees.reshape(len(rows), _FINE, len(columns), _FINE).mean(axis=(1, 3))
    light *= np.nan_to_num(pixel_map.camera_solid_angles(*np.meshgrid(columns, rows)))
    moments = np.array([light.sum(axis=0) @ columns, light.sum(axis=1) @ rows])
    return np.asarray(moments / light.sum())
