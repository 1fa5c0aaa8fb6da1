"""The bright disc that a fisheye throws on a larger sensor: first guess of centre and scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray

_LEVEL = 0.25  # of the way from the dark outside to the median inside
_LEAST_ARC = 0.25  # of the circle must lie within the picture
_LARGEST_SD = 0.02  # of the radius
_LEAST_STEP = 0.15  # of light across the edge, over that between dark and the median inside
_LARGEST_FILL = 0.98  # of the picture; brighter all over, it has no edge


@dataclass(frozen=True)
class ImageCircle:
    """Centre (column, row), radius and the scatter of the edge around it, pixels."""

    centre: tuple[float, float]
    radius: float
    sd: float


def fit_image_circle(bright: NDArray[np.generic], ratio: float = 1.0) -> ImageCircle | None:
    """Circle around the bright disc of a picture, or None where there is none.

    Parameters
    ----------
    bright : ndarray, shape (rows, columns)
        Best the brightest value of each pixel in many photographs, so that nothing dark stands at
        the rim.
    ratio : float
        Pitch of the pixels in x over that in y; the radius is in pixels of a row.
    """
    light = np.asarray(bright, np.float32)
    edge = _edge(light)
    if len(edge) < 16:
        return None
    squeeze = np.array([1.0, ratio])
    points = edge / squeeze
    keep = np.ones(len(points), bool)
    for _ in range(10):
        centre, radius = _circle(points[keep])
        off = np.hypot(*(points - centre).T) - radius
        sd = 1.4826 * float(np.median(np.abs(off[keep])))
        keep, before = np.abs(off) <= max(3 * sd, 1.0), keep
        if np.array_equal(keep, before) or keep.sum() < 16:
            break
    azimuth = np.arctan2(*(points[keep] - centre).T[::-1])
    arc = len(np.unique(np.floor(azimuth / np.radians(5)))) / 72
    inner, outer = (centre + s * (points[keep] - centre) for s in (0.98, 1.02))
    step = _is_step(light, inner * squeeze, outer * squeeze)
    if arc < _LEAST_ARC or sd > _LARGEST_SD * radius or not step:
        return None
    return ImageCircle((float(centre[0]), float(centre[1] * ratio)), float(radius), sd)


def _edge(bright: NDArray[np.float32]) -> FloatArray:
    """Columns and rows (n, 2) along the outline of the largest bright area, off the border."""
    import cv2

    rows, columns = bright.shape
    smooth = np.asarray(cv2.GaussianBlur(bright, (0, 0), 1.5), np.float32)
    dark = float(np.percentile(smooth, 0.5))
    level = dark + _LEVEL * (_inside(smooth) - dark)
    mask = (smooth > level).astype(np.uint8)
    if not 0 < mask.mean() < _LARGEST_FILL:
        return np.empty((0, 2))
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = np.reshape(max(outlines, key=cv2.contourArea), (-1, 2)).astype(float)
    free = (outline > 2).all(axis=1) & (outline < [columns - 3, rows - 3]).all(axis=1)
    return np.asarray(outline[free])


def _is_step(bright: NDArray[np.float32], inner: FloatArray, outer: FloatArray) -> bool:
    """Whether light ends at an edge between these points, and does not just fall off."""
    top = np.array(bright.shape[::-1]) - 1
    (xi, yi), (xo, yo) = (np.clip(np.round(p), 0, top).astype(int).T for p in (inner, outer))
    step = np.median(bright[yi, xi] - bright[yo, xo])
    return bool(step > _LEAST_STEP * (_inside(bright) - np.percentile(bright, 0.5)))


def _inside(bright: NDArray[np.float32]) -> float:
    rows, columns = bright.shape
    return float(np.median(bright[rows // 4 : -rows // 4, columns // 4 : -columns // 4]))


def _circle(points: FloatArray) -> tuple[FloatArray, float]:
    """Algebraic fit: x^2 + y^2 = 2 a x + 2 b y + c."""
    middle = points.mean(axis=0)
    q = points - middle
    a = np.column_stack([2 * q, np.ones(len(q))])
    coefficients = np.linalg.lstsq(a, (q**2).sum(axis=1), rcond=None)[0]
    return middle + coefficients[:2], float(
        np.sqrt(coefficients[2] + coefficients[0] ** 2 + coefficients[1] ** 2)
    )
