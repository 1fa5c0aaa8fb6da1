"""Channels, wavelengths or materials fitted together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError, DataError
from gonio.fitting.minimum import engines
from gonio.fitting.minimum.derivative_check import gradient_faults
from gonio.fitting.minimum.find import LAW_ROUNDS, ROUNDS, find_minimum, settled, without_spikes
from gonio.fitting.minimum.joint_starts import SUBSET, joint_starts
from gonio.fitting.minimum.minimise import Engine, minimise
from gonio.fitting.minimum.optimum import Optimum, better
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.minimum.rivals import rival
from gonio.fitting.problem.channels import Channel, Source, split
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.joint import JointProblem
from gonio.fitting.problem.protocol import Weights
from gonio.models import Model

EXACT = 1e-6  # of the values: residuals that are no noise, but must not weigh infinitely


@dataclass(frozen=True)
class JointMinimum:
    """The minimum of a joint fit, with those of its parts alone.

    Parameters
    ----------
    problem : JointProblem
    whole : Minimum
        Of all parts together; without what `gonio.fitting.diagnostics.parts` says of each.
    alone : tuple of Minimum
        Of every part by itself.
    channels : tuple of Channel
    """

    problem: JointProblem
    whole: Minimum
    alone: tuple[Minimum, ...]
    channels: tuple[Channel, ...]


def find_joint_minimum(
    samples: Source,
    model: Model,
    share: Sequence[str],
    *,
    weights: Weights | None = None,
    start: Mapping[str, float] | None = None,
    threads: int | None = None,
    engine: Engine | None = engines.SEARCH,
    constraints: Constraints | None = None,
) -> JointMinimum:
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
    engine : callable or None
        As `engines.get` gives it; of every part alone, then of all together.
    constraints : Constraints, optional
        Parameters fixed or tied, in all parts.

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
    options: dict[str, Any] = {
        "weights": weights, "threads": threads, "constraints": constraints, "engine": engine,
    }  # fmt: skip
    alone = _alone(channels, model, start, options)
    # Copies of samples were taken out.
    channels = [replace(c, samples=m.problem.samples) for c, m in zip(channels, alone, strict=True)]
    problem = JointProblem.from_parts(
        channels, [m.problem for m in alone], share, [_scale(m) for m in alone]
    )
    problem, optimum, warnings = _find(problem, alone, start, engine)
    faults = [
        problem.names_of_part(k)[name]
        for k, (part, _, index) in enumerate(problem.pieces())
        for name in gradient_faults(part, optimum.p[index])
    ]
    whole = Minimum.of(problem, optimum, warnings=warnings, faults=list(dict.fromkeys(faults)))
    return JointMinimum(problem, whole, tuple(alone), tuple(channels))


def _check(channels: Sequence[Channel], weights: Weights | None) -> None:
    if len(channels) < 2:
        raise ConfigurationError(
            "the samples are of one channel: there is nothing to share; leave 'share' out, or give "
            "samples of several channels, wavelengths or materials."
        )
    has_u = [channel.samples.u_independent is not None for channel in channels]
    if weights is None and any(has_u) and not all(has_u):
        raise ConfigurationError(
            f"{channels[has_u.index(False)].label} has no uncertainties and "
            f"{channels[has_u.index(True)].label} has; give u_brdf for all, or name the weights: "
            "none, relative, cos or coscos."
        )


def _alone(
    channels: Sequence[Channel],
    model: Model,
    start: Mapping[str, float] | None,
    options: Mapping[str, Any],
) -> list[Minimum]:
    """The minimum of every part by itself; the options are those of `find_minimum`."""
    minima = []
    for channel in channels:
        own = None if start is None else _start_of(channel.label, model, start)
        try:
            minima.append(find_minimum(channel.samples, model, start=own, **options))
        except DataError as error:
            raise DataError(f"{channel.label}: {error}", value=error.value) from None
    return minima


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
    problem: JointProblem,
    alone: Sequence[Minimum],
    start: Mapping[str, float] | None,
    engine: Engine | None,
) -> tuple[JointProblem, Optimum, list[str]]:
    """The deepest minimum found, the problem with its weights, and what to know about it."""
    if start is not None:
        candidates = [problem.vector(start)]
    else:
        candidates = joint_starts(problem, alone)
    if engine is not None:
        some = problem.subset(SUBSET) if problem.n > SUBSET else problem
        candidates = [engine(some, candidates[0])[0], *candidates]
    problem, optimum = _reweighted_minimum(problem, minimise(problem, candidates[0], search=False))
    warnings: list[str] = []
    for candidate in candidates[1:]:
        other = minimise(problem, candidate, search=False)
        deepest = better(optimum, other)
        if deepest is optimum:
            warnings += rival(problem, optimum, other)
        else:
            warnings = rival(problem, other, optimum)
            problem, optimum = _reweighted_minimum(problem, other)
    if not optimum.verified:
        optimum, spikes = without_spikes(problem, optimum)
        warnings = spikes or warnings
    return problem, optimum, warnings


def _reweighted_minimum(problem: JointProblem, optimum: Optimum) -> tuple[JointProblem, Optimum]:
    """Weights taken at the model's values, as in a fit of one BRDF."""
    if problem.weights_follow_model:
        by_law = any(law is not None for law in problem.noise_laws)
        rounds = LAW_ROUNDS if by_law else 2 if problem.weights == "sd" else ROUNDS
        for _ in range(rounds):
            before = problem.inverse_variance
            problem = problem.reweighted(optimum.p)
            optimum = minimise(problem, optimum.p, search=False)
            if settled(problem, before):
                break
    return problem, optimum
