"""Directional and bihemispherical albedo of a model, with the error reached."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gonio.errors import ConfigurationError
from gonio.geometry import (
    HORIZON,
    FloatArray,
    unit_vectors,
)
from gonio.models.base import Model


@dataclass(frozen=True)
class Albedo:
    """A directional or bihemispherical albedo.

    Parameters
    ----------
    value : float
        Fraction of the incident flux that is reflected.
    error : float
        Estimated error of the quadrature, absolute.
    n_evaluations : int
        How often the model was evaluated.
    """

    value: float
    error: float
    n_evaluations: int


# Graded from narrow lobes to wide ones, radians from a direction where f may peak or bend.
_GRADES = (0.01, 0.04, 0.15, 0.5)
_HIGH = np.polynomial.legendre.leggauss(6)
_LOW = np.polynomial.legendre.leggauss(4)


def _rule(rule: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Product rule on the square [-1, 1]^2, weights that sum to 1."""
    nodes, weights = rule
    x, y = np.meshgrid(nodes, nodes, indexing="ij")
    return x.ravel(), y.ravel(), np.outer(weights, weights).ravel() / 4


_RULES = (_rule(_HIGH), _rule(_LOW))


def directional_albedo(
    model: Model,
    parameters: Mapping[str, float],
    theta_i: float,
    phi_i: float = 0.0,
    *,
    rtol: float = 1e-5,
    max_evaluations: int = 1_000_000,
) -> Albedo:
    """Fraction of the light from one direction that is reflected into the hemisphere.

    Parameters
    ----------
    model : Model
    parameters : mapping
        Parameters by name, angles in radians; those left out take their defaults.
    theta_i, phi_i : float
        Direction of the light, radians, theta_i below pi/2.
    rtol : float
        Relative error at which the refinement ends.
    max_evaluations : int
        Number of evaluations at which it ends in any case.

    Returns
    -------
    Albedo
        The value and the error that was reached, which exceeds `rtol` where evaluations ran out.

    Raises
    ------
    ConfigurationError
        If theta_i is not in [0, pi/2) or a parameter is refused.

    Notes
    -----
    Integral of f cos(theta_r) sin(theta_r) over theta_r and phi_r. Cells are graded towards the
    mirror direction and the direction of the light, so that a lobe of 0.005 rad is not missed, and
    are quartered where Gauss rules of 6 x 6 and 4 x 4 nodes disagree. The error is the sum of the
    disagreements, which is that of the coarser rule.

    Examples
    --------
    >>> from gonio import models
    >>> round(directional_albedo(models.get("lambert"), {"rho": 0.5}, 0.7).value, 9)
    0.5
    """
    if not 0 <= theta_i < HORIZON:
        raise ConfigurationError(
            f"theta_i = {theta_i:.6g} rad is not in [0, pi/2); light from the horizon "
            "does not fall on the surface.",
            value=theta_i,
        )
    p = model.vector(parameters)
    w_i = unit_vectors(theta_i, phi_i)
    cells = _first_cells(theta_i, phi_i, isotropic=model.claims.isotropic)
    value, error = _cell_integrals(model, w_i, p, cells)
    per_cell = sum(len(rule[2]) for rule in _RULES)
    n = per_cell * len(cells)
    while error.sum() > rtol * abs(value.sum()):
        # Those that hold nearly all of the error: the rest is left as it is.
        order = np.argsort(error)[::-1]
        held = np.cumsum(error[order])
        split = order[: 1 + int(np.searchsorted(held, 0.9 * held[-1]))]
        if n + 4 * per_cell * len(split) > max_evaluations:
            break
        children = _quartered(cells[split])
        new_value, new_error = _cell_integrals(model, w_i, p, children)
        cells = np.concatenate([np.delete(cells, split, axis=0), children])
        value = np.concatenate([np.delete(value, split), new_value])
        error = np.concatenate([np.delete(error, split), new_error])
        n += per_cell * len(children)
    return Albedo(float(value.sum()), float(error.sum()), n)


def bihemispherical_albedo(
    model: Model, parameters: Mapping[str, float], *, rtol: float = 1e-3
) -> Albedo:
    """Fraction of uniform light from the whole hemisphere that is reflected.

    Parameters
    ----------
    model : Model
    parameters : mapping
        Parameters by name, angles in radians; those left out take their defaults.
    rtol : float
        Relative error of each directional albedo.

    Returns
    -------
    Albedo
        The error is the difference from a rule with fewer angles of incidence, plus the largest
        error of a directional albedo.

    Examples
    --------
    >>> from gonio import models
    >>> round(bihemispherical_albedo(models.get("lambert"), {"rho": 0.5}).value, 6)
    0.5
    """
    phis = [0.0] if model.claims.isotropic else [(k + 0.5) * math.pi / 4 for k in range(8)]
    sums, largest, n = [], 0.0, 0
    for order in (4, 7):
        nodes, weights = np.polynomial.legendre.leggauss(order)
        total = 0.0
        for z, w in zip(((nodes + 1) / 2).tolist(), (weights / 2).tolist(), strict=True):
            for phi in phis:
                one = directional_albedo(model, parameters, math.acos(z), phi, rtol=rtol)
                total += 2 * z * w * one.value / len(phis)
                largest, n = max(largest, one.error), n + one.n_evaluations
        sums.append(total)
    return Albedo(sums[1], abs(sums[1] - sums[0]) + largest, n)


def _first_cells(theta_i: float, phi_i: float, *, isotropic: bool) -> FloatArray:
    """Cells (theta low, theta high, phi low, phi high) over the hemisphere.

    Grooves spread light in a narrow ridge that may lie anywhere: it is met by finer cells in phi.
    """
    theta = {0.0, HORIZON, *np.linspace(0, HORIZON, 7)[1:-1].tolist()}
    for grade in (0.0, *_GRADES):
        theta |= {theta_i - grade, theta_i + grade, HORIZON - grade}
    theta_edges = _distinct([t for t in theta if 0 <= t <= HORIZON])
    n_phi = 8 if isotropic else 64
    phi = {k * 2 * math.pi / n_phi for k in range(n_phi + 1)}
    for centre in (0.0, math.pi, 2 * math.pi):
        phi |= {centre + sign * grade for grade in _GRADES for sign in (-1, 1)}
    phi_edges = phi_i + _distinct([x for x in phi if 0 <= x <= 2 * math.pi])
    low_t, low_p = np.meshgrid(theta_edges[:-1], phi_edges[:-1], indexing="ij")
    high_t, high_p = np.meshgrid(theta_edges[1:], phi_edges[1:], indexing="ij")
    return np.stack([low_t.ravel(), high_t.ravel(), low_p.ravel(), high_p.ravel()], axis=1)


def _distinct(edges: list[float]) -> FloatArray:
    """Sorted edges without those that rounding doubled."""
    e = np.sort(np.array(edges))
    distinct: FloatArray = e[np.concatenate([[True], np.diff(e) > 1e-9])]
    return distinct


def _quartered(cells: FloatArray) -> FloatArray:
    t0, t1, p0, p1 = cells.T
    t, p = (t0 + t1) / 2, (p0 + p1) / 2
    quarters = [(t0, t, p0, p), (t0, t, p, p1), (t, t1, p0, p), (t, t1, p, p1)]
    return np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])


def _cell_integrals(
    model: Model, w_i: FloatArray, p: FloatArray, cells: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Integral over each cell by the finer rule, and how far the coarser one is from it."""
    t0, t1, p0, p1 = cells.T[:, :, None]
    integrals = []
    for x, y, weight in _RULES:
        theta = (t0 + t1) / 2 + (t1 - t0) / 2 * x
        phi = (p0 + p1) / 2 + (p1 - p0) / 2 * y
        f = model.evaluate(w_i, unit_vectors(theta, phi), p)
        area = (t1 - t0) * (p1 - p0)
        integrals.append(np.sum(weight * area * f * np.cos(theta) * np.sin(theta), axis=1))
    return integrals[0], np.abs(integrals[0] - integrals[1])
