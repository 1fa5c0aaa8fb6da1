"""Checks of a model: reciprocity, sign, energy, isotropy, seams, against what it claims."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from gonio.geometry import (
    FloatArray,
    angles,
    rotated,
    unit_vectors,
)
from gonio.models import Model
from gonio.models.albedo import Albedo, bihemispherical_albedo, directional_albedo

ALBEDO_ANGLES_DEG = (0.0, 30.0, 45.0, 60.0, 75.0, 85.0)
SAME = 1e-9  # relative difference up to which two values of a formula are equal
SEAM_STEP = 1e-7  # radians to either side of a seam
SEAM_SAME = 1e-4
DRAWS = 20_000  # directions that stand in for the quadrature of a costly model
CHECK_DRAWS = 8_000  # directions that are drawn to check a quadrature


@dataclass(frozen=True)
class Finding:
    """One property of a model: what it claims and what was found.

    Parameters
    ----------
    name : str
        The property.
    claimed : bool
        Whether the model claims it.
    holds : bool
        Whether it was found to hold.
    worst : float
        Largest violation, smallest value or largest albedo; `text` says which.
    where : tuple of float or None
        theta_i, phi_i, theta_r, phi_r in degrees of the worst case; two angles for an albedo.
    text : str
        What was found, in words and numbers.
    """

    name: str
    claimed: bool
    holds: bool
    worst: float
    where: tuple[float, ...] | None
    text: str

    @property
    def passed(self) -> bool:
        """False only where a claim does not hold."""
        return self.holds or not self.claimed


@dataclass(frozen=True)
class ModelReport:
    """What `check_model` found.

    Parameters
    ----------
    model : str
    parameters : mapping
        All parameters, angles in radians.
    findings : tuple of Finding
        Reciprocity, positivity, energy, isotropy, seams.
    albedos : mapping
        `Albedo` by angle of incidence in degrees, phi_i = 0.
    bihemispherical : Albedo
        Albedo for uniform light from the whole hemisphere.
    """

    model: str
    parameters: Mapping[str, float]
    findings: tuple[Finding, ...]
    albedos: Mapping[float, Albedo]
    bihemispherical: Albedo

    @property
    def conserves_energy(self) -> bool:
        """Whether no directional albedo exceeds 1 with these parameters."""
        return not _above(1.0, self.albedos)

    @property
    def passed(self) -> bool:
        """Whether everything that the model claims holds."""
        return all(finding.passed for finding in self.findings)

    def finding(self, name: str) -> Finding:
        """The finding with this name."""
        return next(finding for finding in self.findings if finding.name == name)

    def describe(self) -> dict[str, Any]:
        """The report as plain data, for --json."""
        return {
            "schema": "gonio.check_model/1",
            "model": self.model,
            "parameters": dict(self.parameters),
            "passed": self.passed,
            "findings": [
                {**_plain(finding), "passed": finding.passed} for finding in self.findings
            ],
            "albedo": [
                {"theta_i_deg": theta, **_plain(albedo)} for theta, albedo in self.albedos.items()
            ],
            "bihemispherical_albedo": _plain(self.bihemispherical),
            "conserves_energy": self.conserves_energy,
        }


def _plain(record: Finding | Albedo) -> dict[str, Any]:
    """A record as JSON can hold it: a number that is not finite becomes None."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in asdict(record).items()
    }


def check_model(
    model: Model,
    parameters: Mapping[str, float] | None = None,
    *,
    rng: np.random.Generator | None = None,
    n_pairs: int = 4000,
) -> ModelReport:
    """Hold a model with these parameters to its claims, and look for a gain of energy.

    Parameters
    ----------
    model : Model
    parameters : mapping, optional
        Parameters by name, angles in radians; those left out take their defaults.
    rng : numpy.random.Generator, optional
        Draws the pairs of directions; always the same pairs where not given.
    n_pairs : int
        Half of them anywhere, half about the mirror direction.

    Returns
    -------
    ModelReport

    Notes
    -----
    The albedo is held to the bound that the model claims, most often a sum of amplitudes such as
    rho_d + rho_s, which may itself be above 1. Where nothing is claimed it is held to 1, and an
    albedo above that is reported and fails nothing; `ModelReport.conserves_energy` tells it of
    every model.

    Albedos are quadratures, which importance-sampled directions check: where the two disagree by
    more than chance allows, the stated error is their difference. The bihemispherical albedo
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
    turned = model.evaluate(rotated(w_i, 0.7), rotated(w_r, 0.7), p)
    findings = (
        _compared("reciprocity", model.claims.reciprocal, f, model.evaluate(w_r, w_i, p), w_i, w_r),
        _positivity(model, f, w_i, w_r),
        _energy(model, named, albedos),
        _compared("isotropy", model.claims.isotropic, f, turned, w_i, w_r),
        _seams(model, p),
    )
    return ModelReport(model.name, named, findings, albedos, _bihemispherical(model, p, rng))


def _pairs(rng: np.random.Generator, n: int) -> tuple[FloatArray, FloatArray]:
    """Pairs of directions: half anywhere, half about the mirror direction at every width."""
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
    # Far out in a lobe values are too small to matter or to have all their digits.
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
    """The albedo against the bound that is claimed, else against 1."""
    names = model.claims.albedo_at_most
    bound = model.claims.albedo_bound(parameters)
    # A value that is no number keeps no energy either.
    theta, worst = max(
        albedos.items(),
        key=lambda item: math.inf if math.isnan(item[1].value) else item[1].value,
    )
    over = _above(1.0 if bound is None else bound, albedos)
    text = f"largest albedo {worst.value:.4f}"
    if bound is not None:
        text += f", claimed at most {bound:.4f}"
        text += f" ({' + '.join(names)})" if names else ""
        text += f", which is exceeded at {_listed(over)} deg" if over else ""
    if above := _above(1.0, albedos):
        text += f"; above 1 at {_listed(above)} deg"
    return Finding("energy", bound is not None, not over, worst.value, (theta, 0.0), text)


def _above(bound: float, albedos: Mapping[float, Albedo]) -> list[float]:
    """Angles of incidence at which the albedo is larger than a bound, or no number."""
    return [t for t, a in albedos.items() if not a.value - a.error <= bound + SAME]


def _listed(angles_deg: list[float]) -> str:
    return ", ".join(f"{angle:g}" for angle in angles_deg)


def _directional(model: Model, p: FloatArray, theta_deg: float, rng: np.random.Generator) -> Albedo:
    theta_i = math.radians(theta_deg)
    albedo = directional_albedo(model, _named(model, p), theta_i)
    if model.costly:
        return albedo
    w_i = np.broadcast_to(unit_vectors(theta_i, 0.0), (CHECK_DRAWS, 3))
    return _doubted(albedo, model.sample(w_i, p, rng).weight)


def _bihemispherical(model: Model, p: FloatArray, rng: np.random.Generator) -> Albedo:
    # cos^2(theta_i) of uniform light is even on (0, 1): one draw in each of as many steps.
    n = DRAWS if model.costly else CHECK_DRAWS
    cos2 = (np.arange(n) + 1 - rng.random(n)) / n
    w_i = unit_vectors(np.arccos(np.sqrt(cos2)), rng.uniform(0, 2 * np.pi, n))
    weight = model.sample(w_i, p, rng).weight
    if model.costly:
        return Albedo(float(weight.mean()), 2 * _stderr(weight), n)
    return _doubted(bihemispherical_albedo(model, _named(model, p)), weight)


def _doubted(albedo: Albedo, weight: FloatArray) -> Albedo:
    """A quadrature with its error, or with how far draws are from it where that is more.

    All nodes may lie beside a lobe that is narrow across and long along its ridge: two rules then
    agree, and both are wrong.
    """
    apart, chance = abs(albedo.value - float(weight.mean())), 4 * _stderr(weight)
    if apart > albedo.error + chance:
        return replace(albedo, error=apart + chance)
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
    text = f"largest jump {worst:.2g} at {count} seams" if count else "the formula has no seams"
    return Finding("seams", count > 0, worst <= SEAM_SAME, worst, where, text)


def _at(model: Model, seam: tuple[float, ...], step: FloatArray, p: FloatArray) -> float:
    """f beside a seam; a polar angle stepped below 0 comes up on the other side of the normal."""
    w_i = unit_vectors(seam[0] + step[0], seam[1] + step[1])
    w_r = unit_vectors(seam[2] + step[2], seam[3] + step[3])
    return float(model.evaluate(w_i, w_r, p))


def _degrees(w_i: FloatArray, w_r: FloatArray) -> tuple[float, ...]:
    four = (*angles(w_i), *angles(w_r))
    return tuple(round(float(np.degrees(angle)), 3) for angle in four)
