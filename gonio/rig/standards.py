"""A standard that is described by a model becomes a table: the reduction never sees a model."""

from __future__ import annotations

import numpy as np

import gonio.models as models
from gonio.certificate import StandardTable
from gonio.errors import ConfigurationError
from gonio.geometry import Directions, FloatArray
from gonio.models import Model
from gonio.models.albedo import directional_albedo

REFLECTANCE_AT = np.radians(8.0)  # incidence at which certificates state it
TOLERANCE = 5e-4  # of f, by which interpolation in the table may be off
# Steps of theta_r and dphi, degrees, from coarse to the finest that is tried.
_STEPS = ((5.0, 15.0), (2.5, 7.5), (1.0, 3.0), (0.5, 1.5))
_LAST_DEG = 89.0  # some models end at the horizon; beyond it the nearest value holds
_LARGEST = 300_000  # numbers in a session's metadata


def tabulated(
    name: str, parameters: dict[str, float], theta_i_deg: tuple[float, ...]
) -> tuple[float, StandardTable, float]:
    """A model's f as a standard's reflectance and table.

    Parameters
    ----------
    name : str
        An isotropic model.
    parameters : dict
        All of its parameters, angles in degrees.
    theta_i_deg : tuple of float
        Incidences at which the standard was taken.

    Returns
    -------
    reflectance : float
        Directional-hemispherical, at 8 deg.
    table : StandardTable
        f over reflectance/pi.
    error : float
        Largest relative error of the interpolation between the nodes.

    Raises
    ------
    ConfigurationError
        If the model is unknown or not isotropic, a parameter is unknown, missing or out of range,
        or f changes too fast to be tabulated.

    Examples
    --------
    >>> reflectance, table, error = tabulated("lambert", {"rho": 0.98}, (0.0, 45.0))
    >>> round(reflectance, 6), table.factor[0][0][0], error
    (0.98, 1.0, 0.0)
    """
    model = models.get(name)
    if not model.claims.isotropic:
        raise ConfigurationError(
            f"standard.model: a white standard looks alike from all sides and {name} is not "
            "isotropic; choose an isotropic model, such as oren_nayar.",
            value=name,
        )
    values = _checked(model, parameters)
    reflectance = float(directional_albedo(model, values, float(REFLECTANCE_AT)).value)
    if not 0 < reflectance <= 1:
        raise ConfigurationError(
            f"standard.model: {name} with these parameters reflects {reflectance:.4g} of the light "
            "at 8 deg; a standard reflects more than 0 and at most 1.",
            value=reflectance,
        )
    incidences = tuple(sorted(set(theta_i_deg)))
    for step_r, step_phi in _STEPS:
        theta_r, dphi = _axis(_LAST_DEG, step_r), _axis(180.0, step_phi)
        f = _f(model, values, incidences, theta_r, dphi)
        if f.min() <= 0:
            raise ConfigurationError(
                f"standard.model: {name} with these parameters reflects nothing in some "
                "directions; no sample can be compared with it there.",
                value=name,
            )
        error = _interpolation_error(model, values, incidences, theta_r, dphi, f)
        if error <= TOLERANCE:
            return reflectance, _table(incidences, theta_r, dphi, np.pi * f / reflectance), error
    raise ConfigurationError(
        f"standard.model: f of {name} with these parameters changes too fast to be tabulated "
        f"(error {error:.1g} with steps of {step_r:g} deg); a white standard is nearly matt.",
        value=name,
    )


def _checked(model: Model, parameters: dict[str, float]) -> dict[str, float]:
    """All parameters of a model in the unit of Python, refused in the unit of files."""
    missing = [p.name for p in model.parameters if p.name not in parameters]
    for name in parameters:
        model.parameter(name)
    if missing:
        raise ConfigurationError(
            f"standard.parameters: {', '.join(missing)} of {model.name} is missing; give all of "
            f"{', '.join(model.names)}.",
            value=missing,
        )
    values = {}
    for p in model.parameters:
        number = parameters[p.name]
        try:
            values[p.name] = p.check(p.from_file(number))
        except ConfigurationError:
            unit = f" {p.file_unit}" if p.file_unit else ""
            raise ConfigurationError(
                f"standard.parameters: {p.name} = {number:g}{unit} is out of range; allowed is "
                f"{p.to_file(p.lower):.6g} to {p.to_file(p.upper):.6g}{unit}.",
                value=number,
            ) from None
    return values


def _axis(end: float, step: float) -> FloatArray:
    return np.append(np.arange(0.0, end, step), end)


def _f(
    model: Model,
    values: dict[str, float],
    theta_i_deg: tuple[float, ...],
    theta_r_deg: FloatArray,
    dphi_deg: FloatArray,
) -> FloatArray:
    theta_i, theta_r, dphi = np.radians(
        np.meshgrid(theta_i_deg, theta_r_deg, dphi_deg, indexing="ij")
    )
    return np.asarray(model(Directions(theta_i, 0.0, theta_r, dphi), **values))


def _interpolation_error(
    model: Model,
    values: dict[str, float],
    theta_i_deg: tuple[float, ...],
    theta_r: FloatArray,
    dphi: FloatArray,
    f: FloatArray,
) -> float:
    """Largest relative error halfway between neighbours, on each axis and on both."""
    means = {
        "r": ((f[:, 1:] + f[:, :-1]) / 2, _halfway(theta_r), dphi),
        "phi": ((f[..., 1:] + f[..., :-1]) / 2, theta_r, _halfway(dphi)),
    }
    errors = [
        np.abs(mean / _f(model, values, theta_i_deg, *axes) - 1).max()
        for mean, *axes in means.values()
    ]
    return float(max(errors))


def _halfway(axis: FloatArray) -> FloatArray:
    return np.asarray((axis[1:] + axis[:-1]) / 2)


def _table(
    theta_i_deg: tuple[float, ...], theta_r: FloatArray, dphi: FloatArray, factor: FloatArray
) -> StandardTable:
    """The table, without an axis along which nothing changes."""
    if np.ptp(factor, axis=2).max() <= 1e-12 * factor.max():
        dphi, factor = dphi[:1], factor[..., :1]
    if np.ptp(factor, axis=1).max() <= 1e-12 * factor.max():
        theta_r, factor = theta_r[:1], factor[:, :1]
    if factor.size > _LARGEST:
        raise ConfigurationError(
            f"standard.model: its table would hold {factor.size} numbers; at most {_LARGEST} go "
            "into a session. Take the standard at fewer incidences.",
            value=factor.size,
        )
    digits = [[[float(f"{x:.8g}") for x in row] for row in page] for page in factor.tolist()]
    return StandardTable(
        theta_i_deg=theta_i_deg,
        theta_r_deg=tuple(theta_r.tolist()),
        dphi_deg=tuple(dphi.tolist()),
        factor=tuple(tuple(tuple(row) for row in page) for page in digits),
    )
