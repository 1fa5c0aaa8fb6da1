"""Fit channels, wavelengths or materials together, and test whether they share what they should."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from gonio.errors import ConfigurationError, DataError
from gonio.fitting.minimum import gauss_newton
from gonio.fitting.minimum.find import (
    MISFIT,
    Minimum,
    find_minimum,
    goodness,
    rival,
    without_spikes,
)
from gonio.fitting.minimum.gauss_newton import Optimum
from gonio.fitting.problem.joint import Channel, JointProblem, Source, base_name, split
from gonio.fitting.problem.problem import Problem, Weights
from gonio.fitting.result import PartFit, Sharing
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.geometry import FloatArray
from gonio.kernels.boxed import UNDETERMINED
from gonio.models import Model, Parameter

REFUSED = 0.01  # chance below which the data refuse the sharing
EXACT = 1e-6  # of the values: residuals that are no noise, but must not weigh infinitely
POINTS = (9, 9, 5, 3)  # of the grid along each shared nonlinear parameter, by how many there are
SUBSET = 4000  # samples that choose among the points of the grid
FOLLOWED = 2  # points of the grid that are followed to their minimum
ALIKE = 0.1  # mean correlation of the parts' residuals that is no chance
SAME = 1e-3  # directions, as unit vectors, that are the same
LISTED = 3  # parts that a warning names
TINY = 1e-15  # a chance below which its digits mean nothing


def find_joint_minimum(
    samples: Source,
    model: Model,
    share: Sequence[str],
    *,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    threads: int | None = None,
) -> Minimum:
    """Each part alone first, for starts and noise, then all with what they share.

    Parameters
    ----------
    samples : BRDFSamples, or a sequence or mapping of them
        Split into channels and wavelengths; several are several materials.
    model : Model
    share : sequence of str
        Parameters that all parts have in common.
    start : mapping, optional
        Starting values by the model's names, for all parts, or by names such as `rho_d[red]`.

    Raises
    ------
    ConfigurationError
        For an unknown name, fewer than two parts, or uncertainties in some parts only.
    DataError
        If a part has not more samples than the model has parameters.

    Notes
    -----
    Every part counts by its own noise: its independent uncertainties are multiplied by what its
    fit alone needs, sqrt(chi2/dof), at least 1 where they are stated. A part that the model does
    not fit, or one in bright units, then does not decide for the others.
    """
    for name in share:
        model.parameter(name)
    channels = split(samples)
    _check(channels, weights)
    alone = _alone(channels, model, weights, start, threads)
    # Copies of samples were taken out.
    channels = [replace(c, samples=m.problem.samples) for c, m in zip(channels, alone, strict=True)]
    problem = JointProblem.from_parts(
        channels, [m.problem for m in alone], share, [_scale(m) for m in alone]
    )
    problem, optimum, doubts = _find(problem, alone, start)
    faults = [
        _named(problem, k, name)
        for k, (part, _, place) in enumerate(problem.pieces())
        for name in gauss_newton.gradient_faults(part, optimum.p[place])
    ]
    _, dof, scale = goodness(problem, optimum)
    test, apart = _tested(problem, optimum, alone, channels)
    parts = _parts(problem, optimum, apart, channels, scale)
    told = _misfits(problem, parts) + _refusal(problem, optimum, parts, test)
    told += _likeness_told(problem, optimum)
    return Minimum(
        problem, optimum, told + doubts, list(dict.fromkeys(faults)),
        sum(part.chi2 for part in parts), dof, scale, parts, test if share else None,
    )  # fmt: skip


def _check(channels: Sequence[Channel], weights: Weights | None) -> None:
    if len(channels) < 2:
        raise ConfigurationError(
            "the samples are of one channel: there is nothing to share; leave 'share' out, or give "
            "samples of several channels, wavelengths or materials."
        )
    known = [channel.samples.u_independent is not None for channel in channels]
    if weights is None and any(known) and not all(known):
        raise ConfigurationError(
            f"{channels[known.index(False)].label} has no uncertainties and "
            f"{channels[known.index(True)].label} has; give u_brdf for all, or name the weights: "
            "none, cos or coscos."
        )


def _alone(
    channels: Sequence[Channel],
    model: Model,
    weights: Weights | None,
    start: Mapping[str, float] | None,
    threads: int | None,
) -> list[Minimum]:
    """The minimum of every part by itself."""
    found = []
    for channel in channels:
        own = None if start is None else _start_of(channel.label, model, start)
        try:
            found.append(
                find_minimum(channel.samples, model, weights=weights, start=own, threads=threads)
            )
        except DataError as error:
            raise DataError(f"{channel.label}: {error}", value=error.value) from None
    return found


def _start_of(label: str, model: Model, start: Mapping[str, float]) -> dict[str, float]:
    """Starting values of one part: those by its name, else those for all."""
    values = {name: start.get(f"{name}[{label}]", start.get(name)) for name in model.names}
    return {name: value for name, value in values.items() if value is not None}


def _scale(alone: Minimum) -> float:
    """Factor on a part's independent uncertainties, from its fit alone."""
    problem = alone.problem
    size = np.sqrt(np.mean(problem.samples.value**2 * problem.inverse_variance))
    return float(max(alone.noise_scale, EXACT * size)) or 1.0


def _find(
    problem: JointProblem, alone: Sequence[Minimum], start: Mapping[str, float] | None
) -> tuple[JointProblem, Optimum, list[str]]:
    """The deepest minimum found, the problem with its weights, and what to know about it."""
    if start is not None:
        candidates = [problem.vector(start)]
    else:
        candidates = _starts(problem, alone)
    problem, optimum = _settled(
        problem, gauss_newton.minimise(problem, candidates[0], search=False)
    )
    doubts: list[str] = []
    for candidate in candidates[1:]:
        other = gauss_newton.minimise(problem, candidate, search=False)
        deepest = gauss_newton.better(optimum, other)
        if deepest is optimum:
            doubts += rival(problem, optimum, other)
        else:
            doubts = rival(problem, other, optimum)
            problem, optimum = _settled(problem, other)
    if not optimum.verified:
        optimum, told = without_spikes(problem, optimum)
        doubts = told or doubts
    return problem, optimum, doubts


def _settled(problem: JointProblem, optimum: Optimum) -> tuple[JointProblem, Optimum]:
    """Weights taken at the model's values, as in a fit of one BRDF."""
    slopes = [part.samples.noise_slope is not None for part in problem.parts]
    if problem.weights == "sd" and any(slopes):
        for _ in range(2):
            problem = problem.reweighted(optimum.p)
            optimum = gauss_newton.minimise(problem, optimum.p, search=False)
    return problem, optimum


# ---------------------------------------------------------------------- starts


def _starts(problem: JointProblem, alone: Sequence[Minimum]) -> list[FloatArray]:
    """What the separate fits agree on, and the best points of a grid over what is shared."""
    agreed = _agreed(problem, alone)
    shared = [
        j for j, q in enumerate(problem.parameters) if q.name == base_name(q.name) and not q.linear
    ]
    if not shared:
        return [agreed]
    coarse = problem.subset(SUBSET)
    n = POINTS[min(len(shared), len(POINTS)) - 1]
    varied = [problem.parameters[j] for j in shared]
    axes = [_grid(q, n) for q in varied]
    nearest = [
        int(np.argmin(np.abs(_even(q, axis) - _even(q, agreed[j]))))
        for q, axis, j in zip(varied, axes, shared, strict=True)
    ]
    inside = all(q.lower < agreed[j] < q.upper for q, j in zip(varied, shared, strict=True))
    scored: list[tuple[float, FloatArray]] = []
    for index in itertools.product(range(n), repeat=len(shared)):
        p = agreed.copy()
        p[shared] = [a[i] for a, i in zip(axes, index, strict=True)]
        near = inside and all(abs(i - k) <= 1 for i, k in zip(index, nearest, strict=True))
        chi2, solved = _amplitudes_solved(coarse, p)
        # A neighbour of what the parts agree on leads to the same minimum.
        scored.append((chi2, agreed if near else solved))
    scored.sort(key=lambda item: item[0])
    return [agreed, *(p for _, p in scored[:FOLLOWED] if p is not agreed)]


def _even(q: Parameter, value: Any) -> Any:
    """Values on the scale on which the points of the grid lie evenly."""
    return np.log(value) if q.scale == "log" else value


def _agreed(problem: JointProblem, alone: Sequence[Minimum]) -> FloatArray:
    """Mean of the separate minima, weighted by their curvature."""
    n_p = len(problem.parameters)
    h, g = np.zeros((n_p, n_p)), np.zeros(n_p)
    fallback = np.zeros(n_p)
    for minimum, place, scale in zip(alone, problem.places, problem.scales, strict=True):
        own = minimum.optimum.curvature / scale**2
        h[np.ix_(place, place)] += own
        g[place] += own @ minimum.optimum.p
        fallback[place] = minimum.optimum.p
    known = np.diag(h) > 0
    unit = np.where(known, 1 / np.sqrt(np.where(known, np.diag(h), 1.0)), 0.0)
    mean = unit * (np.linalg.pinv(h * np.outer(unit, unit), rcond=UNDETERMINED) @ (unit * g))
    lower = np.array([q.lower for q in problem.parameters])
    upper = np.array([q.upper for q in problem.parameters])
    return np.clip(np.where(known, mean, fallback), lower, upper)


def _grid(q: Parameter, n: int) -> FloatArray:
    low, high = q.start or (q.lower, q.upper)
    return np.geomspace(low, high, n) if q.scale == "log" else np.linspace(low, high, n)


def _amplitudes_solved(problem: JointProblem, p: FloatArray) -> tuple[float, FloatArray]:
    """chi2 and the point with each part's own linear parameters at their best: parts separate."""
    total, solved = 0.0, p.copy()
    names = [q.name for q in problem.parameters]
    for part, _, place in problem.pieces():
        own = [
            k
            for k, j in enumerate(place)
            if problem.parameters[j].linear and names[j] != base_name(names[j])
        ]
        chi2, g, h = part.normal_equations(p[place])
        step = np.linalg.pinv(h[np.ix_(own, own)], rcond=UNDETERMINED) @ g[own]
        ends = [problem.parameters[j] for j in place[own]]
        new = np.clip(p[place[own]] + step, [q.lower for q in ends], [q.upper for q in ends])
        d = new - p[place[own]]
        total += float(chi2 - 2 * g[own] @ d + d @ h[np.ix_(own, own)] @ d)
        solved[place[own]] = new
    return total, solved


# ---------------------------------------------------------------------- what is shared


def _tested(
    problem: JointProblem,
    optimum: Optimum,
    alone: Sequence[Minimum],
    channels: Sequence[Channel],
) -> tuple[Sharing, list[dict[str, tuple[float, float | None]]]]:
    """Likelihood ratio of the joint fit to separate ones; the shared parameters part by part.

    Both with the weights of the joint fit, so that the growth of chi-squared is never negative.
    """
    apart, growth = [], 0.0
    for minimum, (part, _, place) in zip(alone, problem.pieces(), strict=True):
        own = gauss_newton.minimise(part, minimum.optimum.p, search=False)
        other = gauss_newton.minimise(part, optimum.p[place], search=False)
        apart.append(gauss_newton.better(own, other))
        growth += max(part.chi2(optimum.p[place]) - apart[-1].chi2, 0.0)
    separate = JointProblem.from_parts(channels, problem.parts, ())
    errors = uncertainty.evaluate(separate, _stacked(apart), 1.0)
    names = tuple(q.name for q in problem.parameters if q.name == base_name(q.name))
    dof = sum(_rank(own) for own in apart) - _rank(optimum)
    p_value = None
    if dof > 0:
        allowed = growth * _allowance(problem.model, names, separate, apart, errors)
        left = problem.n - sum(int(np.count_nonzero(own.free)) for own in apart)
        p_value = _chance(problem, allowed, dof, left)
    told = []
    for own, place in zip(apart, separate.places, strict=True):
        pairs: dict[str, tuple[float, float | None]] = {}
        for j, q in enumerate(problem.model.parameters):
            if q.name in names:
                sd = float(np.sqrt(errors.covariance[place[j], place[j]]))
                known = errors.determined[place[j]] and sd < q.upper - q.lower
                pairs[q.name] = (q.to_file(float(own.p[j])), q.to_file(sd) if known else None)
        told.append(pairs)
    refused = p_value is not None and p_value < REFUSED
    return Sharing(names, growth, max(dof, 0), p_value, refused), told


def _chance(problem: JointProblem, growth: float, dof: int, left: int) -> float:
    """Chance of a larger growth; where the scatter stands for the noise, by its F distribution."""
    if problem.weights == "sd" and max(problem.scales) == 1.0:
        return float(stats.chi2.sf(growth, dof))
    return float(stats.f.sf(growth / dof, dof, left))


def _allowance(
    model: Model,
    names: Sequence[str],
    separate: JointProblem,
    apart: Sequence[Optimum],
    errors: uncertainty.Uncertainty,
) -> float:
    """Share of the disagreement that is left with the errors that not all parts have in common.

    The parameters that separate fits find scatter about a common value by their independent
    errors, and by shared errors that act otherwise in one part than in another.
    """
    if not errors.shared:
        return 1.0
    index, value, column = [], [], []
    for own, place in zip(apart, separate.places, strict=True):
        for j, q in enumerate(model.parameters):
            if q.name in names and errors.determined[place[j]]:
                index.append(place[j])
                value.append(own.p[j])
                column.append(names.index(q.name))
    design = np.eye(len(names))[column]
    at = np.ix_(index, index)
    known = errors.independent[at], errors.covariance[at]
    plain, full = (_disagreement(np.array(value), design, c) for c in known)
    return float(np.clip(full / plain, 0.0, 1.0)) if plain > 0 else 1.0


def _disagreement(value: FloatArray, design: FloatArray, covariance: FloatArray) -> float:
    """Weighted sum of squares about the best common values."""
    unit = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(unit, unit) + 1e-12 * np.eye(len(unit)))
    y, x = np.linalg.solve(root, value / unit), np.linalg.solve(root, design / unit[:, None])
    return float(np.sum((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2))


def _stacked(apart: Sequence[Optimum]) -> Optimum:
    """Separate minima as the minimum of a joint problem that shares nothing."""
    from scipy.linalg import block_diag

    return Optimum(
        np.concatenate([own.p for own in apart]),
        sum(own.chi2 for own in apart),
        np.concatenate([own.gradient for own in apart]),
        block_diag(*(own.curvature for own in apart)),
        np.concatenate([own.free for own in apart]),
        sum(own.evaluations for own in apart),
        all(own.verified for own in apart),
    )


def _rank(optimum: Optimum) -> int:
    """How many free parameters the data determine."""
    index = np.flatnonzero(optimum.free & (np.diag(optimum.curvature) > 0))
    scale = 1 / np.sqrt(np.diag(optimum.curvature)[index])
    scaled = optimum.curvature[np.ix_(index, index)] * np.outer(scale, scale)
    return int(np.count_nonzero(np.linalg.eigvalsh(scaled) > UNDETERMINED))


def alike(
    problem: JointProblem, optimum: Optimum, errors: uncertainty.Uncertainty
) -> uncertainty.Uncertainty:
    """The covariance with residuals that are alike in all parts counted once.

    Where a model does not fit, its parts leave the same residuals at the same directions: they are
    no independent evidence of what the parts share. With r_kl their correlation between parts,
    samples of parts k and l at one place have the covariance r_kl / sqrt(w_k w_l), and
    H^-1 (sum_kl r_kl J_k^T sqrt(W_k W_l) J_l) H^-1 takes the place of H^-1.
    """
    r = likeness(problem, optimum.p)
    if r is None:
        return errors
    columns = []
    for part, _, place in problem.pieces():
        columns.append(np.sqrt(part.inverse_variance)[:, None] * part.jacobian(optimum.p[place])[1])
    n_p = len(optimum.p)
    scatter = np.zeros((n_p, n_p))
    for (k, a), (m, b) in itertools.product(enumerate(problem.places), repeat=2):
        scatter[np.ix_(a, b)] += r[k, m] * columns[k].T @ columns[m]
    _, inverse = uncertainty.inverse_curvature(optimum)
    return replace(errors, independent=errors.noise_scale**2 * inverse @ scatter @ inverse)


def likeness(problem: JointProblem, p: FloatArray) -> FloatArray | None:
    """Correlation of the residuals between the parts, or None where they are not alike.

    Only parts that were measured at the same directions can be compared.
    """
    if not _same_directions(problem):
        return None
    z = []
    for part, _, place in problem.pieces():
        residual = (part.samples.value - part.values(p[place])) * np.sqrt(part.inverse_variance)
        z.append(residual / max(float(np.linalg.norm(residual)), 1e-300))
    r = np.array(z) @ np.array(z).T
    np.fill_diagonal(r, 1.0)
    return r if _mean_likeness(r) > ALIKE else None


def _mean_likeness(r: FloatArray) -> float:
    return float((r.sum() - len(r)) / (len(r) * (len(r) - 1)))


def _same_directions(problem: JointProblem) -> bool:
    first = problem.parts[0]
    return all(
        part.n == first.n
        and np.allclose(part.w_i, first.w_i, atol=SAME)
        and np.allclose(_centroids(part), _centroids(first), atol=SAME)
        for part in problem.parts[1:]
    )


def _centroids(part: Problem) -> FloatArray:
    return part.samples.directions.vectors()[1]


# ---------------------------------------------------------------------- what is told


def _parts(
    problem: JointProblem,
    optimum: Optimum,
    alone: Sequence[Mapping[str, tuple[float, float | None]]],
    channels: Sequence[Channel],
    scale: float,
) -> tuple[PartFit, ...]:
    """What the fit says of each part."""
    found = []
    own = [q.name != base_name(q.name) for q in problem.parameters]
    pieces = zip(problem.pieces(), problem.scales, channels, alone, strict=True)
    for k, ((part, _, place), factor, channel, pairs) in enumerate(pieces):
        n_own = sum(int(own[j] and optimum.free[j]) for j in place)
        found.append(
            PartFit(
                name=channel.label,
                parameters={q: _named(problem, k, q) for q in problem.model.names},
                alone=pairs,
                chi2=_chi2(part, optimum.p[place], factor),
                dof=part.n - n_own,
                noise_scale=factor * scale,
                n_samples=part.n,
                n_negative=part.samples.n_negative,
                select=channel.select,
                input=channel.material or None,
            )
        )
    return tuple(found)


def _chi2(part: Problem, p: FloatArray, factor: float) -> float:
    """chi-squared of a part by its stated uncertainties, without the factor on them."""
    if part.weights != "sd":
        return part.chi2(p) * factor**2
    f = part.values(p)
    return float(np.sum((part.samples.value - f) ** 2 / part.variance(f)))


def _named(problem: JointProblem, part: int, name: str) -> str:
    """Name among all parameters of one of a part's."""
    place = int(problem.places[part][problem.model.names.index(name)])
    return str(problem.parameters[place].name)


def _misfits(problem: JointProblem, parts: Sequence[PartFit]) -> list[str]:
    """Parts that the model does not fit even when they are fitted alone."""
    bad = [part for part, s in zip(parts, problem.scales, strict=True) if s**2 > MISFIT]
    if problem.weights != "sd" or not bad:
        return []
    where = ", ".join(part.name for part in bad[:LISTED])
    where += f" and {len(bad) - LISTED} more" if len(bad) > LISTED else ""
    return [
        f"chi2/dof is {_range([part.chi2 / part.dof for part in bad])} in {where}: the model or "
        "effects it does not hold, not the noise, make the residuals; the independent "
        f"uncertainties there were multiplied by {_range([part.noise_scale for part in bad])}."
    ]


def _refusal(
    problem: JointProblem, optimum: Optimum, parts: Sequence[PartFit], test: Sharing
) -> list[str]:
    if not test.refused or test.p_value is None:
        return []
    chance = f"p = {test.p_value:.2g}" if test.p_value > TINY else f"p < {TINY:g}"
    return [
        f"the data refuse one {' and one '.join(test.parameters)} for all: chi2 grows by "
        f"{test.growth:.4g} over separate fits, of which noise explains {test.dof} or so "
        f"({chance}). {_farthest(problem, optimum, parts)}"
    ]


def _likeness_told(problem: JointProblem, optimum: Optimum) -> list[str]:
    r = likeness(problem, optimum.p)
    if r is None:
        return []
    return [
        f"the residuals of the parts are alike (correlation {_mean_likeness(r):.2g} at the same "
        "directions): the model lacks the same in all of them. The standard uncertainties count "
        "that once; the test of the sharing, limits at bounds and a posterior do not."
    ]


def _range(numbers: Sequence[float]) -> str:
    low, high = f"{min(numbers):.3g}", f"{max(numbers):.3g}"
    return low if low == high else f"{low} to {high}"


def _farthest(problem: JointProblem, optimum: Optimum, parts: Sequence[PartFit]) -> str:
    """Which part disagrees most with a shared value, by its own uncertainty."""
    worst = (0.0, "")
    for q, value in zip(problem.parameters, optimum.p, strict=True):
        for part in parts:
            alone, sd = part.alone.get(q.name, (0.0, None))
            if sd:
                distance = abs(alone - q.to_file(float(value))) / sd
                unit = f" {q.file_unit}" if q.file_unit else ""
                text = (
                    f"Farthest is {part.name}: {q.name} alone {alone:.4g} +/- {sd:.2g}{unit}, "
                    f"together {q.to_file(float(value)):.4g}{unit}."
                )
                worst = max(worst, (distance, text))
    return worst[1]
