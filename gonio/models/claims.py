"""What a model promises; the contract tests demand exactly this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Claims:
    """What a model promises over its whole range; the contract tests demand exactly this.

    Parameters
    ----------
    reciprocal : bool
        f(i, r) = f(r, i).
    non_negative : bool
        f >= 0 for all directions above the horizon.
    isotropic : bool
        f depends on phi_i - phi_r only.
    seams : tuple of (theta_i, phi_i, theta_r, phi_r)
        Direction pairs, radians, on every branch of the formula: f is continuous across them.
    lambert_limit : mapping, optional
        Parameter values at which the model is exactly rho/pi, with `rho` or `rho_d` free.
    albedo_at_most : tuple of str, optional
        Names of the parameters whose sum the directional albedo never exceeds, at any incidence
        and with any parameters that are allowed; 1 where there are none in it. None claims
        nothing.
    """

    reciprocal: bool = True
    non_negative: bool = True
    isotropic: bool = False
    seams: tuple[tuple[float, float, float, float], ...] = ()
    lambert_limit: Mapping[str, float] | None = None
    albedo_at_most: tuple[str, ...] | None = None

    def albedo_bound(self, parameters: Mapping[str, float]) -> float | None:
        """Largest directional albedo that is claimed with these parameters; None if none is.

        Examples
        --------
        >>> Claims(albedo_at_most=("rho_d", "rho_s")).albedo_bound({"rho_d": 0.25, "rho_s": 0.5})
        0.75
        """
        if self.albedo_at_most is None:
            return None
        return sum(parameters[name] for name in self.albedo_at_most) if self.albedo_at_most else 1.0
