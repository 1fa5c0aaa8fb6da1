"""Components of unit vectors from angles, in one compiled pass.

Imported where many directions are turned into vectors at once; it needs numba.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import math

from numba import njit

from gonio.kernels import fastmath
from gonio.kernels.scalar import compiled

HORIZON = math.pi / 2
_sincos = compiled(fastmath.sincos)


@njit(nogil=True, cache=True, error_model="numpy")
def components(theta, phi, x, y, z):
    """x, y and z of directions; the horizon is exactly horizontal."""
    for k in range(theta.shape[0]):
        sin_theta, cos_theta = _sincos(theta[k])
        sin_phi, cos_phi = _sincos(phi[k])
        x[k] = sin_theta * cos_phi
        y[k] = sin_theta * sin_phi
        z[k] = 0.0 if theta[k] == HORIZON else cos_theta
