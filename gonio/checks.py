"""Checks of models and of measured samples: reciprocity, sign, energy, symmetry, quantity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError
from gonio.geometry import (
    HORIZON,
    Directions,
    FloatArray,
    angles,
    hemisphere_quadrature,
    rotated,
    unit_vectors,
)
from gonio.models import Model
from gonio.samples import BRDFSamples

ALBEDO_ANGLES_DEG = (0.0, 30.0, 45.0, 60.0, 75.0, 85.0)
SAME = 1e-9  # relative difference up to which two values of a formula are equal
SEAM_STEP = 1e-7  # radians to either side of a seam
SEAM_SAME = 1e-4
MIN_PAIRS = 12  # fewer reciprocal pairs decide nothing
# Pairs whose cosines differ by less than this fraction cannot tell the quantities apart.
MIN_CONTRAST = 0.05
# The best quantity must halve the disagreement of the next one.
CLEARLY_BETTER = 0.5
UNDECIDED = "undecided"
BRDF = "BRDF"
# Albedo of the nearest-sample sum beyond which a constant factor is suspected.
SUSPECT_ALBEDO = 1.2

# ---------------------------------------------------------------- albedo


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
    cells = _first_cells(theta_i, phi_i)
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
        for z, w in zip((nodes + 1) / 2, weights / 2, strict=True):
            for phi in phis:
                one = directional_albedo(model, parameters, math.acos(z), phi, rtol=rtol)
                total += 2 * z * w * one.value / len(phis)
                largest, n = max(largest, one.error), n + one.n_evaluations
        sums.append(total)
    return Albedo(sums[1], abs(sums[1] - sums[0]) + largest, n)


def _first_cells(theta_i: float, phi_i: float) -> FloatArray:
    """Cells (theta low, theta high, phi low, phi high) over the hemisphere."""
    theta = {0.0, HORIZON, *np.linspace(0, HORIZON, 7)[1:-1].tolist()}
    for grade in (0.0, *_GRADES):
        theta |= {theta_i - grade, theta_i + grade, HORIZON - grade}
    theta_edges = _distinct([t for t in theta if 0 <= t <= HORIZON])
    phi = {k * math.pi / 4 for k in range(9)}
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
    found = []
    for x, y, weight in _RULES:
        theta = (t0 + t1) / 2 + (t1 - t0) / 2 * x
        phi = (p0 + p1) / 2 + (p1 - p0) / 2 * y
        f = model.evaluate(w_i, unit_vectors(theta, phi), p)
        area = (t1 - t0) * (p1 - p0)
        found.append(np.sum(weight * area * f * np.cos(theta) * np.sin(theta), axis=1))
    return found[0], np.abs(found[0] - found[1])


# ---------------------------------------------------------------- models


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
    """

    model: str
    parameters: Mapping[str, float]
    findings: tuple[Finding, ...]
    albedos: Mapping[float, Albedo]

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
    """Hold a model with these parameters to its claims, and to the conservation of energy.

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
    No model claims to conserve energy, because the albedo depends on its amplitudes: that finding
    is reported and fails nothing.

    Examples
    --------
    >>> from gonio import models
    >>> report = check_model(models.get("ward"), {"rho_d": 0.1, "rho_s": 0.3})
    >>> report.passed, report.finding("energy").holds
    (True, True)
    """
    p = model.vector(parameters or {})
    named = dict(zip(model.names, p.tolist(), strict=True))
    rng = np.random.default_rng(0) if rng is None else rng
    w_i, w_r = _pairs(rng, n_pairs)
    f = model.evaluate(w_i, w_r, p)
    albedos = {
        theta: directional_albedo(model, named, math.radians(theta)) for theta in ALBEDO_ANGLES_DEG
    }
    turned = model.evaluate(rotated(w_i, 0.7), rotated(w_r, 0.7), p)
    findings = (
        _compared("reciprocity", model.claims.reciprocal, f, model.evaluate(w_r, w_i, p), w_i, w_r),
        _positivity(model, f, w_i, w_r),
        _energy(albedos),
        _compared("isotropy", model.claims.isotropic, f, turned, w_i, w_r),
        _seams(model, p),
    )
    return ModelReport(model.name, named, findings, albedos)


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


def _energy(albedos: Mapping[float, Albedo]) -> Finding:
    # A value that is no number keeps no energy either.
    theta, worst = max(
        albedos.items(),
        key=lambda item: math.inf if math.isnan(item[1].value) else item[1].value,
    )
    above = [f"{t:g}" for t, a in albedos.items() if not a.value - a.error <= 1]
    text = f"largest albedo {worst.value:.4f}"
    if above:
        text += f"; above 1 at {', '.join(above)} deg"
    return Finding("energy", False, not above, worst.value, (theta, 0.0), text)


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


# ---------------------------------------------------------------- samples


@dataclass(frozen=True)
class Pairing:
    """How well values agree that should be equal.

    Parameters
    ----------
    n_pairs : int
        How many pairs the data hold.
    median, rms : float or None
        Median and root mean square of |a - b| / mean(|a|, |b|); None without pairs.
    """

    n_pairs: int
    median: float | None
    rms: float | None


@dataclass(frozen=True)
class SamplesReport:
    """What `check_samples` found.

    Parameters
    ----------
    n_samples, n_negative : int
        How many samples, and how many of them are below zero.
    reciprocity : Pairing
        Values with light and viewer exchanged.
    mirror : Pairing
        Values at phi_r - phi_i = +x and -x, equal on an isotropic surface.
    assumed_isotropic : bool
        Whether reciprocal partners were sought at any azimuth of the sample and on either side of
        the plane of incidence, because the data hold too few others.
    quantity : str
        One of the names in `candidates`, or "undecided".
    candidates : mapping
        Median disagreement of reciprocal pairs if the file holds this quantity; empty without
        pairs that tell the quantities apart.
    n_telling : int
        How many pairs tell the quantities apart.
    albedo : float or None
        Largest directional albedo by a rough sum over nearest samples, after the quantity's cosine
        is removed; None where the data cover too little.
    notes : tuple of str
        What the numbers mean and what they cannot tell.
    """

    n_samples: int
    n_negative: int
    reciprocity: Pairing
    mirror: Pairing
    assumed_isotropic: bool
    quantity: str
    candidates: Mapping[str, float]
    n_telling: int
    albedo: float | None
    notes: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """False where the data say that they are not a BRDF."""
        return self.quantity in (BRDF, UNDECIDED)

    def describe(self) -> dict[str, Any]:
        """The report as plain data, for --json."""
        return {"schema": "gonio.check_samples/1", "passed": self.passed, **asdict(self)}


def check_samples(samples: BRDFSamples, *, tolerance_deg: float = 1.0) -> SamplesReport:
    """Look for reciprocal and mirrored pairs in data, and tell which quantity they hold.

    Parameters
    ----------
    samples : BRDFSamples
        Values that may be a BRDF or a BRDF with a cosine left in.
    tolerance_deg : float
        How far each direction of a pair may lie from the exact partner.

    Returns
    -------
    SamplesReport

    Notes
    -----
    A BRDF is reciprocal; with one cosine left in it is not, and dividing by the right cosine makes
    it so. What is symmetric in light and viewer stays unseen: a constant factor such as pi, or
    cos(theta_i) cos(theta_r). BRDF / cos(theta_i) breaks reciprocity exactly as
    BRDF * cos(theta_r) does.

    Examples
    --------
    >>> t = np.radians(np.arange(5, 80, 5.0))
    >>> theta_i, theta_r = (grid.ravel() for grid in np.meshgrid(t, t))
    >>> d = Directions(theta_i, np.zeros(225), theta_r, np.full(225, np.pi))
    >>> check_samples(BRDFSamples(d, 0.2 * np.cos(theta_r))).quantity
    'BRDF*cos(theta_r)'
    """
    tolerance = math.radians(tolerance_deg)
    group = _groups(samples)
    theta_i, phi_i, theta_r, phi_r = (
        np.broadcast_to(getattr(samples.directions, name), (len(samples),))
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    )
    delta = _azimuth_between(theta_i, phi_i, theta_r, phi_r)
    zero = np.zeros_like(delta)

    own = Directions(theta_i, phi_i, theta_r, phi_r)
    k, j = _partners(own, own.swapped(), group, tolerance)
    # Where the sample was never turned, only the plane of incidence holds such partners.
    assumed = _one_azimuth(phi_i[theta_i > tolerance], tolerance) or len(k) < MIN_PAIRS
    if assumed:
        folded = Directions(theta_i, zero, theta_r, np.abs(delta))
        exchanged = Directions(theta_r, zero, theta_i, np.abs(delta))
        k, j = _partners(folded, exchanged, group, tolerance)
    relative = Directions(theta_i, zero, theta_r, delta)
    opposite = Directions(theta_i, zero, theta_r, -delta)
    mirror = _partners(relative, opposite, group, tolerance)

    value = samples.value
    cosines = {
        BRDF: np.ones(len(samples)),
        "BRDF*cos(theta_r)": np.cos(theta_r),
        "BRDF*cos(theta_i)": np.cos(theta_i),
    }
    quantity, candidates, n_telling = _quantity(value, cosines, k, j)
    cosine = cosines.get(quantity, cosines[BRDF])
    usable = cosine > 0
    albedo = _rough_albedo(
        theta_i[usable],
        theta_r[usable],
        np.abs(delta)[usable],
        value[usable] / cosine[usable],
        group[usable],
    )
    return SamplesReport(
        n_samples=len(samples),
        n_negative=samples.n_negative,
        reciprocity=_pairing(value, k, j),
        mirror=_pairing(value, *mirror),
        assumed_isotropic=assumed,
        quantity=quantity,
        candidates=candidates,
        n_telling=n_telling,
        albedo=albedo,
        notes=_notes(quantity, candidates, n_telling, assumed, albedo),
    )


def _groups(samples: BRDFSamples) -> NDArray[np.int64]:
    """A number for each wavelength and channel: values are compared within one only."""
    n = len(samples)
    group = np.zeros(n, np.int64)
    for column in (samples.wavelength_nm, samples.channel):
        if column is not None:
            _, index = np.unique(column, return_inverse=True)
            group = group * (int(index.max(initial=0)) + 1) + index
    return group


def _wrapped(angle: FloatArray) -> FloatArray:
    """The same azimuth in [-pi, pi)."""
    result: FloatArray = (angle + np.pi) % (2 * np.pi) - np.pi
    return result


def _one_azimuth(phi: FloatArray, tolerance: float) -> bool:
    """Whether all azimuths are the same."""
    return not len(phi) or bool(np.all(np.abs(_wrapped(phi - phi[0])) < tolerance))


def _azimuth_between(
    theta_i: FloatArray, phi_i: FloatArray, theta_r: FloatArray, phi_r: FloatArray
) -> FloatArray:
    """phi_r - phi_i in [-pi, pi), 0 where a direction is the normal and has no azimuth."""
    at_normal = np.minimum(theta_i, theta_r) < 1e-9
    return np.where(at_normal, 0.0, _wrapped(phi_r - phi_i))


def _partners(
    have: Directions, want: Directions, group: NDArray[np.int64], tolerance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (k, j), each once: sample j lies where `want` asks for the partner of sample k."""
    from scipy.spatial import cKDTree

    if len(group) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    # Groups are farther from each other than any two directions.
    apart = 10.0 * group[:, None]
    points = np.hstack([*have.vectors(), apart])
    wanted = np.hstack([*want.vectors(), apart])
    distance, nearest = cKDTree(points).query(wanted, distance_upper_bound=1.5 * tolerance)
    k = np.flatnonzero(np.isfinite(distance))
    j = np.asarray(nearest[k], np.int64)
    off = np.maximum(
        np.linalg.norm(points[j, :3] - wanted[k, :3], axis=1),
        np.linalg.norm(points[j, 3:6] - wanted[k, 3:6], axis=1),
    )
    keep = (off <= tolerance) & (k != j)
    pairs = np.unique(np.sort(np.stack([k[keep], j[keep]], axis=1), axis=1), axis=0)
    return pairs[:, 0], pairs[:, 1]


def _disagreement(a: FloatArray, b: FloatArray) -> FloatArray:
    """|a - b| / mean(|a|, |b|), between 0 and 2; two zeros agree."""
    mean = (np.abs(a) + np.abs(b)) / 2
    return np.abs(a - b) / np.where(mean > 0, mean, 1.0)


def _pairing(value: FloatArray, k: NDArray[np.int64], j: NDArray[np.int64]) -> Pairing:
    if len(k) == 0:
        return Pairing(0, None, None)
    off = _disagreement(value[k], value[j])
    return Pairing(len(k), float(np.median(off)), float(np.sqrt(np.mean(off**2))))


def _quantity(
    value: FloatArray,
    cosines: Mapping[str, FloatArray],
    k: NDArray[np.int64],
    j: NDArray[np.int64],
) -> tuple[str, dict[str, float], int]:
    """The quantity whose cosine makes reciprocal pairs agree best, and all the numbers."""
    cos_r = cosines["BRDF*cos(theta_r)"]
    # The horizon has no cosine to divide by.
    above = np.min([np.minimum(c[k], c[j]) for c in cosines.values()], axis=0) > 1e-6
    telling = above & (_disagreement(cos_r[k], cos_r[j]) > MIN_CONTRAST)
    k, j = k[telling], j[telling]
    if len(k) == 0:
        return UNDECIDED, {}, 0
    found = {
        name: float(np.median(_disagreement(value[k] / c[k], value[j] / c[j])))
        for name, c in cosines.items()
    }
    best, second = sorted(found, key=lambda name: found[name])[:2]
    clear = len(k) >= MIN_PAIRS and found[best] < CLEARLY_BETTER * found[second]
    return best if clear else UNDECIDED, found, len(k)


def _rough_albedo(
    theta_i: FloatArray,
    theta_r: FloatArray,
    delta: FloatArray,
    f: FloatArray,
    group: NDArray[np.int64],
) -> float | None:
    """Largest directional albedo, each direction of the hemisphere given its nearest sample."""
    from scipy.spatial import cKDTree

    theta, phi, weight = hemisphere_quadrature(16, 32)
    grid = unit_vectors(theta, np.abs(_wrapped(phi)))
    largest = None
    incidence = np.round(np.degrees(theta_i)).astype(np.int64)
    keys = np.stack([group, incidence], axis=1)
    unique, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.ravel()
    counts = np.bincount(index, minlength=len(unique))
    for number in np.flatnonzero(counts >= 20):
        mine = index == number
        points = unit_vectors(theta_r[mine], delta[mine])
        distance, nearest = cKDTree(points).query(grid)
        # Nine tenths of the projected hemisphere lie within 20 degrees of a sample.
        if np.sum((weight * np.cos(theta))[distance < 0.35]) > 0.9 * np.pi:
            albedo = float(np.sum(weight * np.cos(theta) * f[mine][nearest]))
            largest = albedo if largest is None else max(largest, albedo)
    return largest


def _notes(
    quantity: str,
    candidates: Mapping[str, float],
    n_telling: int,
    assumed: bool,
    albedo: float | None,
) -> tuple[str, ...]:
    notes = []
    if quantity == UNDECIDED:
        if n_telling < MIN_PAIRS:
            notes.append(
                f"Undecided: {n_telling} reciprocal pairs tell the quantities apart, "
                f"{MIN_PAIRS} are needed."
            )
        else:
            best, second = sorted(candidates.values())[:2]
            notes.append(
                f"Undecided: the best quantity leaves {best:.1%}, the next {second:.1%}; "
                f"the best must leave less than {CLEARLY_BETTER:.0%} of the next."
            )
    elif quantity == BRDF:
        notes.append("BRDF*cos(theta_i)*cos(theta_r) is as reciprocal and cannot be excluded.")
    else:
        other = "i" if quantity.endswith("r)") else "r"
        notes.append(f"BRDF/cos(theta_{other}) would look the same.")
        notes.append(f"Divide the values by {quantity.removeprefix('BRDF*')} to get a BRDF.")
    if assumed and n_telling:
        notes.append(
            "Pairs were sought at any azimuth of the sample, on either side: "
            "the surface is taken as isotropic."
        )
    notes.append(
        "Reciprocity cannot see a constant factor: a reflectance factor (pi*BRDF) passes as well. "
        "Only an albedo above 1 hints at it."
    )
    if albedo is not None:
        hint = f"The rough albedo is {albedo:.2f} at most"
        if albedo > SUSPECT_ALBEDO:
            hint += f": pi*BRDF is possible (it would be {albedo / math.pi:.2f} as BRDF)"
        notes.append(f"{hint}.")
    return tuple(notes)
