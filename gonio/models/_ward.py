"""What the normalisations of Ward's lobe share: parameters, and how much the lobe reflects."""

from __future__ import annotations

import numpy as np

from gonio.geometry import FloatArray
from gonio.models.base import Parameter
from gonio.models.sampling import Named

_SLOPES = tuple(
    Parameter(
        f"alpha_{axis}",
        f"α_{axis}",
        f"slope of the facets in {axis}",
        0.1,
        0.005,
        2.0,
        scale="log",
        start=(0.02, 0.8),
    )
    for axis in "xy"
)


def elliptical(rho_s: str = "amplitude of the specular lobe") -> tuple[Parameter, ...]:
    """rho_d, rho_s, alpha_x, alpha_y; `rho_s` says what rho_s means in this normalisation."""
    return (
        Parameter("rho_d", "ρ_d", "diffuse reflectance", 0.2, 0.0, 1.0, linear=True),
        Parameter("rho_s", "ρ_s", rho_s, 0.1, 0.0, 1.0, linear=True),
        *_SLOPES,
    )


def falling(p: Named, cos_i: FloatArray) -> FloatArray:
    """About the albedo of Ward's own lobe: it falls as rho_s cos(theta_i), and no further where
    light at grazing incidence meets facets of slope alpha."""
    alpha = max(value for name, value in p.items() if name.startswith("alpha"))
    return p["rho_s"] * np.minimum(cos_i + alpha, 1.0)
