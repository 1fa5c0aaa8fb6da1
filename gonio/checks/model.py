"""Checks of the claims of a model: reciprocity, sign, energy, isotropy, seams."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gonio.checks.model_report import SAME, Finding, ModelReport, above_bound
from gonio.geometry import (
    FloatArray,
    angles,
    rotated,
    unit_vectors,
)
from gonio.models import Model
from gonio.models.albedo import Albedo, bihemispherical_albedo, directional_albedo
from gonio.wording import counted

ALBEDO_ANGLES_DEG = (0.0, 30.0, 45.0, 60.0, 75.0, 85.0)
SEAM_STEP = 1e-7  # radians to either side of a seam
SEAM_SAME = 1e-4
DRAWS = 20_000  # random directions instead of the quadrature, for a costly model
CHECK_DRAWS = 8_000  # random directions that check a quadrature


def check_model(
    model: Model,
    parameters: Mapping[str, float] | None = None,
    *,
    rng: np.random.Generator | None = None,
    n_pairs: int = 4000,
) -> ModelReport:
    """Test the claims of a model with these parameters, and test for a gain of energy.

    Parameters
    ----------
    model : Model
    parameters : mapping, optional
        Parameters by name, angles in radians; the others have their defaults.
    rng : numpy.random.Generator, optional
        Generator of the pairs of directions; by default the pairs are always the same.
    n_pairs : int
        Number of pairs of directions: half of them anywhere, half near the mirror direction.

    Returns
    -------
    ModelReport

    Notes
    -----
    The albedo is compared with the bound that the model claims, usually a sum of amplitudes such as
    rho_d + rho_s, which may itself exceed 1. Without a claim it is compared with 1; a larger albedo
    is then reported but is no failure. `ModelReport.conserves_energy` states it for every model.

    Albedos are quadratures, checked by importance-sampled directions. If the two disagree by more
    than chance allows, the stated error is their difference. The bihemispherical albedo
    of a costly model is the mean weight of such directions, its error twice the standard error.

    Examples
    --------
    >>> from gonio import models
    >>> report = check_model(models.get("ward_gmd"), {"rho_d": 0.1, "rho_s": 0.3})
    >>> report.passed, report.conserves_energy
    (True, True)
    >>> report.finding("energy").text
    'largest albedo 0.3970, claimed at most 0.4000 (rho_d + rho_s)'
    """
    p = model.vector(parameters or {})
    named = _named(model, p)
    rng = np.random.default_rng(0) if rng is None else rng
    w_i, w_r = _pairs(rng, n_pairs)
    f = model.evaluate(w_i, w_r, p)
    albedos = {theta: _directional(model, p, theta, rng) for theta in ALBEDO_ANGLES_DEG}
    f_rotated = model.evaluate(rotated(w_i, 0.7), rotated(w_r, 0.7), p)
    findings = (
        _compared("reciprocity", model.claims.reciprocal, f, model.evaluate(w_r, w_i, p), w_i, w_r),
        _positivity(model, f, w_i, w_r),
        _energy(model, named, albedos),
        _compared("isotropy", model.claims.isotropic, f, f_rotated, w_i, w_r),
        _seams(model, p),
    )
    uniform = _bihemispherical(model, p, rng)
    return ModelReport(model.name, named, findings, albedos, uniform, model.parameters)


def _pairs(rng: np.random.Generator, n: int) -> tuple[FloatArray, FloatArray]:
    """Pairs of directions: half anywhere, half near the mirror direction at all widths."""
    theta, phi = rng.uniform(0, 1.55, (2, n)), rng.uniform(0, 2 * np.pi, (2, n))
    near = np.arange(n) % 2 == 1
    width = 10 ** rng.uniform(-3, -0.5, n)
    offset = width * rng.standard_normal((2, n))
    theta_mirror = np.clip(theta[0] + offset[0], 0, 1.55)
    theta_r = np.where(near, theta_mirror, theta[1])
    phi_r = np.where(near, phi[0] + np.pi + offset[1], phi[1])
    return unit_vectors(theta[0], phi[0]), unit_vectors(theta_r, phi_r)


def _compared(
    name: str, claimed: bool, f: FloatArray, other: FloatArray, w_i: FloatArray, w_r: FloatArray
) -> Finding:
    """Relative difference between two values that the property makes equal."""
    # Far from the peak of a lobe, values are negligible and may have lost digits.
    floor = max(1e-12 * float(np.nanmax(np.abs(f))), 1e-300)
    difference = np.abs(f - other) / np.maximum(np.maximum(np.abs(f), np.abs(other)), floor)
    difference = np.where(np.isfinite(difference), difference, np.inf)
    k = int(np.argmax(difference))
    worst = float(difference[k])
    return Finding(
        name,
        claimed,
        worst <= SAME,
        worst,
        _degrees(w_i[k], w_r[k]),
        f"largest relative difference {worst:.2g}",
    )


def _positivity(model: Model, f: FloatArray, w_i: FloatArray, w_r: FloatArray) -> Finding:
    finite = np.where(np.isfinite(f), f, -np.inf)
    k = int(np.argmin(finite))
    smallest = float(finite[k])
    return Finding(
        "positivity",
        model.claims.non_negative,
        smallest >= 0,
        smallest,
        _degrees(w_i[k], w_r[k]),
        f"smallest value {smallest:.4g} sr^-1",
    )


def _energy(
    model: Model, parameters: Mapping[str, float], albedos: Mapping[float, Albedo]
) -> Finding:
    """Compare the albedo with the claimed bound, or with 1."""
    names = model.claims.albedo_at_most
    bound = model.claims.albedo_bound(parameters)
    # NaN also counts as a violation.
    theta, worst = max(
        albedos.items(),
        key=lambda item: math.inf if math.isnan(item[1].value) else item[1].value,
    )
    over = above_bound(1.0 if bound is None else bound, albedos)
    text = f"largest albedo {worst.value:.4f}"
    if bound is not None:
        text += f", claimed at most {bound:.4f}"
        text += f" ({' + '.join(names)})" if names else ""
        text += f", which is exceeded at {_listed(over)} deg" if over else ""
    if above := above_bound(1.0, albedos):
        text += f"; above 1 at {_listed(above)} deg"
    return Finding("energy", bound is not None, not over, worst.value, (theta, 0.0), text)


def _listed(angles_deg: list[float]) -> str:
    return ", ".join(f"{angle:g}" for angle in angles_deg)


def _directional(model: Model, p: FloatArray, theta_deg: float, rng: np.random.Generator) -> Albedo:
    theta_i = math.radians(theta_deg)
    albedo = directional_albedo(model, _named(model, p), theta_i)
    if model.costly:
        return albedo
    w_i = np.broadcast_to(unit_vectors(theta_i, 0.0), (CHECK_DRAWS, 3))
    return _with_larger_error(albedo, model.sample(w_i, p, rng).weight)


def _bihemispherical(model: Model, p: FloatArray, rng: np.random.Generator) -> Albedo:
    # cos^2(theta_i) of uniform light is even on (0, 1): one draw in each of as many steps.
    n = DRAWS if model.costly else CHECK_DRAWS
    cos2 = (np.arange(n) + 1 - rng.random(n)) / n
    w_i = unit_vectors(np.arccos(np.sqrt(cos2)), rng.uniform(0, 2 * np.pi, n))
    weight = model.sample(w_i, p, rng).weight
    if model.costly:
        return Albedo(float(weight.mean()), 2 * _stderr(weight), n)
    return _with_larger_error(bihemispherical_albedo(model, _named(model, p)), weight)


def _with_larger_error(albedo: Albedo, weight: FloatArray) -> Albedo:
    """A quadrature with its error, or with its difference from random draws if that is larger.

    All nodes may miss a lobe that is narrow across and long along its ridge. Two rules then agree,
    and both are wrong.
    """
    difference, chance = abs(albedo.value - float(weight.mean())), 4 * _stderr(weight)
    if difference > albedo.error + chance:
        return replace(albedo, error=difference + chance)
    return albedo


def _stderr(weight: FloatArray) -> float:
    return float(weight.std()) / math.sqrt(len(weight))


def _named(model: Model, p: FloatArray) -> dict[str, float]:
    return dict(zip(model.names, p.tolist(), strict=True))


def _seams(model: Model, p: FloatArray) -> Finding:
    worst, where = 0.0, None
    for seam in model.claims.seams:
        on = _at(model, seam, np.zeros(4), p)
        for step in SEAM_STEP * np.concatenate([np.eye(4), -np.eye(4)]):
            beside = _at(model, seam, step, p)
            jump = abs(beside - on) / max(abs(on), abs(beside), 1e-300)
            if jump > worst:
                worst, where = jump, tuple(math.degrees(angle) for angle in seam)
    count = len(model.claims.seams)
    text = (
        f"largest jump {worst:.2g} at {counted(count, 'seam')}"
        if count
        else "the formula has no seams"
    )
    return Finding("seams", count > 0, worst <= SEAM_SAME, worst, where, text)


def _at(model: Model, seam: tuple[float, ...], step: FloatArray, p: FloatArray) -> float:
    """f next to a seam; a polar angle below 0 lies on the other side of the normal."""
    w_i = unit_vectors(seam[0] + step[0], seam[1] + step[1])
    w_r = unit_vectors(seam[2] + step[2], seam[3] + step[3])
    return float(model.evaluate(w_i, w_r, p))


def _degrees(w_i: FloatArray, w_r: FloatArray) -> tuple[float, ...]:
    four = (*angles(w_i), *angles(w_r))
    return tuple(round(float(np.degrees(angle)), 3) for angle in four)
