"""Whitened residuals of the spots of a mirror, for a state of the geometry.

A state is a set of changes of quantities, by their names in `gonio.metadata`, with those of a
wedge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.dome.spots import Spot, mirrored
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import FloatArray, angles
from gonio.metadata import GEOMETRY_QUANTITIES, Geometry, Limits, Uncertain

# The quantities that an alignment determines; those of the lens join them if they are uncertain.
QUANTITIES = tuple(dict.fromkeys((*GEOMETRY_QUANTITIES, "centre_x", "centre_y")))
WEDGE = ("wedge", "wedge_azimuth")


@dataclass(frozen=True)
class Length:
    """A length that was measured otherwise: value and standard uncertainty, mm."""

    value: float
    u: float

    def __post_init__(self) -> None:
        if not (self.value > 0 and self.u > 0):
            raise ConfigurationError(
                f"a known length of {self.value:g} mm with the uncertainty {self.u:g} mm: both "
                "must be positive.",
                value=(self.value, self.u),
            )


@dataclass(frozen=True)
class Task:
    """Spots, other measurements, and the whitened residuals of a state.

    Parameters
    ----------
    spots : tuple of Spot
    start : PixelMap
        The exact mapping from which the changes of a state count.
    limits : Limits
        Influence quantities: slope errors of the dome.
    R, separation : Length or None
        Lengths that were measured otherwise.
    scale : float
        Factor on the stated uncertainties of the spots.
    """

    spots: tuple[Spot, ...]
    start: PixelMap
    limits: Limits
    R: Length | None
    separation: Length | None
    scale: float = 1.0
    whiten: FloatArray = field(init=False)
    lens: Prior = field(init=False)

    def __post_init__(self) -> None:
        root = np.linalg.cholesky(_covariance(self))
        object.__setattr__(self, "whiten", self.scale * root)
        object.__setattr__(self, "lens", Prior.of(self.start.lens.uncertain))

    @property
    def at(self) -> FloatArray:
        """Columns and rows of the spots, shape (n, 2)."""
        return np.array([spot.at for spot in self.spots]).reshape(-1, 2)

    @property
    def names(self) -> tuple[str, ...]:
        """Every quantity that a state may hold."""
        wedge = WEDGE if any(spot.wedge for spot in self.spots) else ()
        other = (name for name in self.lens.names if name not in QUANTITIES)
        return (*QUANTITIES, *other, *wedge)

    def pixel_map(self, state: Mapping[str, float]) -> PixelMap:
        """The mapping of a state: changes of the quantities from the start."""
        pixel_map = self.start
        for name, step in state.items():
            if name not in WEDGE and step:
                pixel_map = pixel_map.changed(name, step)
        return pixel_map

    def wanted(self, state: Mapping[str, float]) -> FloatArray:
        """Directions (n, 3) into which the mirror sends the lamp."""
        tilted = np.array([spot.wedge for spot in self.spots])
        wedge = tilted + np.radians(state.get("wedge", 0.0)) * (tilted > 0)
        psi = np.array([spot.psi for spot in self.spots])
        psi = psi + np.radians(state.get("wedge_azimuth", 0.0))
        return mirrored(np.array([spot.theta_i for spot in self.spots]), psi, wedge)

    def residuals(self, state: Mapping[str, float]) -> FloatArray:
        """Whitened residuals of the spots and of the other measurements."""
        pixel_map, wanted = self.pixel_map(state), self.wanted(state)
        off = pixel_map.directions(*self.at.T) - wanted
        t_x, t_y = _tangents(wanted)
        along = np.stack([np.sum(off * t_x, axis=1), np.sum(off * t_y, axis=1)], axis=1)
        white = solve_triangular(self.whiten, along.ravel(), lower=True)
        return np.concatenate([white, self._beside(pixel_map.geometry, state)])

    def _beside(self, geometry: Geometry, state: Mapping[str, float]) -> FloatArray:
        rest = []
        if self.R is not None:
            rest.append((geometry.R - self.R.value) / self.R.u)
        if self.separation is not None:
            apart = np.hypot(2 * geometry.D - geometry.pupil_mm[1], geometry.pupil_mm[0])
            rest.append((apart - self.separation.value) / self.separation.u)
        step = np.array([state.get(name, 0.0) for name in self.lens.names])
        return np.concatenate([rest, self.lens.whiten @ step])

    @property
    def n_beside(self) -> int:
        """How many residuals are not of spots."""
        return len(self._beside(self.start.geometry, {}))

    def without(self, keep: NDArray[np.bool_]) -> Task:
        """The task with some of its spots."""
        spots = tuple(s for s, k in zip(self.spots, keep, strict=True) if k)
        return replace(self, spots=spots)


@dataclass(frozen=True)
class Prior:
    """Prior of the lens's quantities, from its calibration."""

    names: tuple[str, ...]
    sd: FloatArray
    whiten: FloatArray  # turns changes of the quantities into independent unit normals

    @classmethod
    def of(cls, uncertain: Uncertain | None) -> Prior:
        """The prior of a covariance; an empty one if it is unknown: then the lens is held."""
        if uncertain is None:
            return cls((), np.zeros(0), np.zeros((0, 0)))
        covariance = np.array(uncertain.covariance)
        sd = np.sqrt(covariance.diagonal())
        doubtful = sd > 0  # the others are held
        names = tuple(n for n, d in zip(uncertain.names, doubtful, strict=True) if d)
        sd = sd[doubtful]
        # The quantities have different units: only the correlations have meaningful eigenvalues.
        correlation = covariance[np.ix_(doubtful, doubtful)] / np.outer(sd, sd)
        values, vectors = np.linalg.eigh(correlation)
        positive = values > 1e-12
        return cls(names, sd, (vectors[:, positive] / np.sqrt(values[positive])).T / sd)


def _covariance(task: Task) -> FloatArray:
    """Covariance (2 n, 2 n) of the directions at the spots, rad^2: noise and slope errors."""
    n = len(task.spots)
    columns, rows = task.at.T
    w = task.start.directions(columns, rows)
    if not np.isfinite(w).all():
        raise DataError("a spot lies outside the image circle of the lens; check the calibration.")
    t_x, t_y = _tangents(w)
    total = np.zeros((n, 2, n, 2))
    for k, spot in enumerate(task.spots):
        by_pixel = (
            np.stack(
                [
                    task.start.directions(columns[k] + dx, rows[k] + dy) - w[k]
                    for dx, dy in ((1e-3, 0.0), (0.0, 1e-3))
                ]
            )
            / 1e-3
        )
        turn = by_pixel @ np.stack([t_x[k], t_y[k]], axis=1)
        total[k, :, k, :] = turn.T @ spot.covariance @ turn
    limits = task.limits
    theta = angles(w)[0]
    rim = (limits.rim_slope_error_deg or 0.0) * (theta / (np.pi / 2)) ** 6
    slope = 2 * np.radians((limits.slope_error_deg or 0.0) + rim)
    apart = np.linalg.norm(w[:, None] - w, axis=-1) / np.radians(limits.slope_correlation_deg)
    slope_covariance = np.outer(slope, slope) * np.exp(-(apart**2) / 2)
    for axis in range(2):
        total[:, axis, :, axis] += slope_covariance
    flat = total.reshape(2 * n, 2 * n)
    # Spots that are equal within rounding make a slope's covariance singular.
    return np.asarray(flat + 1e-12 * np.diag(np.diag(flat)))


def _tangents(w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors across w that lie closest to x and y."""
    t_x = np.array([1.0, 0.0, 0.0]) - w[:, :1] * w
    t_x /= np.linalg.norm(t_x, axis=1, keepdims=True)
    return t_x, np.cross(w, t_x)
