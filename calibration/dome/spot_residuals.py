"""What the spots of a mirror say of a state of the geometry: whitened residuals.

A state is a set of changes of figures, by their names in `gonio.metadata`, with those of a wedge.
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
from gonio.metadata import GEOMETRY_FIGURES, Geometry, Limits, Uncertain

# The figures that an alignment is about; those of the lens join them where they are doubtful.
FIGURES = tuple(dict.fromkeys((*GEOMETRY_FIGURES, "centre_x", "centre_y")))
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
    """Spots, what is known beside them, and the whitened residuals of a state.

    Parameters
    ----------
    spots : tuple of Spot
    start : PixelMap
        The exact mapping from which the changes of a state count.
    limits : Limits
        Slope errors of the dome.
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
        """Every figure that a state may hold."""
        wedge = WEDGE if any(spot.wedge for spot in self.spots) else ()
        other = (name for name in self.lens.names if name not in FIGURES)
        return (*FIGURES, *other, *wedge)

    def seen(self, state: Mapping[str, float]) -> PixelMap:
        """The mapping of a state: changes of the figures from the start."""
        seen = self.start
        for name, step in state.items():
            if name not in WEDGE and step:
                seen = seen.changed(name, step)
        return seen

    def wanted(self, state: Mapping[str, float]) -> FloatArray:
        """Directions (n, 3) into which the mirror sends the lamp."""
        tilted = np.array([spot.wedge for spot in self.spots])
        wedge = tilted + np.radians(state.get("wedge", 0.0)) * (tilted > 0)
        psi = np.array([spot.psi for spot in self.spots])
        psi = psi + np.radians(state.get("wedge_azimuth", 0.0))
        return mirrored(np.array([spot.theta_i for spot in self.spots]), psi, wedge)

    def residuals(self, state: Mapping[str, float]) -> FloatArray:
        """Whitened residuals of the spots, and those of whatever else is known."""
        seen, wanted = self.seen(state), self.wanted(state)
        off = seen.directions(*self.at.T) - wanted
        t_x, t_y = _tangents(wanted)
        along = np.stack([np.sum(off * t_x, axis=1), np.sum(off * t_y, axis=1)], axis=1)
        white = solve_triangular(self.whiten, along.ravel(), lower=True)
        return np.concatenate([white, self._beside(seen.geometry, state)])

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
    """What the calibration of the lens says of its figures."""

    names: tuple[str, ...]
    sd: FloatArray
    whiten: FloatArray  # turns changes of the figures into independent unit normals

    @classmethod
    def of(cls, uncertain: Uncertain | None) -> Prior:
        """The prior of a covariance; an empty one where it is unknown: the lens is held."""
        if uncertain is None:
            return cls((), np.zeros(0), np.zeros((0, 0)))
        covariance = np.array(uncertain.covariance)
        sd = np.sqrt(covariance.diagonal())
        doubtful = sd > 0  # the others are held
        names = tuple(n for n, d in zip(uncertain.names, doubtful, strict=True) if d)
        sd = sd[doubtful]
        # Figures of different units: eigenvalues mean something for the correlations only.
        correlation = covariance[np.ix_(doubtful, doubtful)] / np.outer(sd, sd)
        values, vectors = np.linalg.eigh(correlation)
        known = values > 1e-12
        return cls(names, sd, (vectors[:, known] / np.sqrt(values[known])).T / sd)


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
    alike = np.outer(slope, slope) * np.exp(-(apart**2) / 2)
    for axis in range(2):
        total[:, axis, :, axis] += alike
    flat = total.reshape(2 * n, 2 * n)
    # Spots closer than rounding can tell make a slope's covariance singular.
    return np.asarray(flat + 1e-12 * np.diag(np.diag(flat)))


def _tangents(w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors across w that lie closest to x and y."""
    t_x = np.array([1.0, 0.0, 0.0]) - w[:, :1] * w
    t_x /= np.linalg.norm(t_x, axis=1, keepdims=True)
    return t_x, np.cross(w, t_x)
