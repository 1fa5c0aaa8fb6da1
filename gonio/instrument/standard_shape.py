"""The true shape of a virtual white standard, which no certificate and no reduction knows whole.

f(theta_i, theta_r, dphi) over f at the normal is s(theta_i) s(theta_r) e(theta_i, theta_r, dphi):
s falls as (theta/75 deg)^4 by the rolloff, and e is drawn: a fall or rise towards the rim of a
drawn steepness, and light that goes forward or back. With `reciprocal` false, s(theta_i) is left
out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gonio.certificate import FACTOR_AT_DEG, SHAPE_AT_DEG, TOTAL_AT_DEG, Kind
from gonio.geometry import FloatArray

_STEEPNESS = (2.5, 8.0)  # powers of the sine that a drawn shape may have
_STEPS = 720  # of theta_r in an integral over the hemisphere
_AZIMUTHS = 48


@dataclass(frozen=True)
class TrueShape:
    """f over f at the normal.

    Parameters
    ----------
    rolloff : float
        Loss at 75 deg.
    reciprocal : bool
        Whether the rolloff holds in theta_i as well.
    rim : float
        Drawn: logarithm of f at 75 deg, besides the rolloff.
    steepness : float
        Drawn: power of the sine with which `rim` grows.
    forward : float
        Drawn: logarithm of f at 75 deg in both angles, forwards; the opposite on the lamp's side.
    """

    rolloff: float = 0.0
    reciprocal: bool = False
    rim: float = 0.0
    steepness: float = 4.0
    forward: float = 0.0

    @classmethod
    def drawn(cls, rolloff: float, reciprocal: bool, sd: float, seed: int) -> TrueShape:
        """A shape whose departure from the rolloff has the standard deviation `sd` at 75 deg."""
        if not sd:
            return cls(rolloff, reciprocal)
        rng = np.random.default_rng(seed)
        rim, forward = sd * rng.standard_normal(2)
        return cls(rolloff, reciprocal, float(rim), float(rng.uniform(*_STEEPNESS)), float(forward))

    @property
    def is_drawn(self) -> bool:
        """Whether it departs from its rolloff."""
        return bool(self.rim or self.forward)

    @property
    def depends_on_incidence(self) -> bool:
        """Whether f changes with theta_i."""
        return self.is_drawn or (self.reciprocal and self.rolloff > 0)

    def factor(self, theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike) -> FloatArray:
        """f over f at the normal; angles in radians.

        Examples
        --------
        >>> shape = TrueShape.drawn(0.05, True, 0.03, seed=1)
        >>> bool(np.isclose(shape.factor(0.3, 1.2, 2.0), shape.factor(1.2, 0.3, 2.0)))
        True
        """
        theta_i, theta_r = np.asarray(theta_i, float), np.asarray(theta_r, float)
        f = self._falls(theta_r)
        if self.reciprocal:
            f = f * self._falls(theta_i)
        if not self.is_drawn:
            return np.asarray(f)
        s_i, s_r = (np.sin(t) / np.sin(np.radians(SHAPE_AT_DEG)) for t in (theta_i, theta_r))
        # Both directions leave the surface: forwards is phi_r - phi_i = 180 deg.
        forwards = -self.forward * (s_i * s_r) ** 2 * np.cos(dphi)
        return np.asarray(
            f * np.exp(self.rim * (s_i**self.steepness + s_r**self.steepness) + forwards)
        )

    def certified_mean(self, kind: Kind) -> float:
        """pi f over pi f at the normal, as a certificate of this kind averages it."""
        if kind == "total":
            return self.albedo(np.radians(TOTAL_AT_DEG))
        if kind == "0/45":
            theta_i, theta_r = np.radians(FACTOR_AT_DEG)
            return float(self.factor(theta_i, theta_r, 0.0))
        return 1.0

    def albedo(self, theta_i: float) -> float:
        """Directional-hemispherical reflectance over pi f at the normal."""
        # The middles of steps of theta_r and dphi.
        theta = (np.arange(_STEPS) + 0.5) * np.pi / 2 / _STEPS
        dphi = (np.arange(_AZIMUTHS) + 0.5) * np.pi / _AZIMUTHS
        f = self.factor(theta_i, theta[:, None], dphi).mean(axis=1) * np.ones(_STEPS)
        weight = np.sin(theta) * np.cos(theta)
        return float(np.sum(f * weight) / np.sum(weight))

    def _falls(self, theta: FloatArray) -> FloatArray:
        return np.asarray(1 - self.rolloff * (theta / np.radians(SHAPE_AT_DEG)) ** 4)
