"""The plan of an instrument for a surface: which images determine its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf

import numpy as np

from gonio.calibration.reduction.reduce import reduce
from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.fitting.problem.constraints import Constraints
from gonio.geometry import FloatArray
from gonio.instrument import Instrument, load
from gonio.instrument.plans import default_plan, is_anisotropic
from gonio.metadata import Plan
from gonio.models import Model
from gonio.models import get as get_model
from gonio.planning.criteria import Criterion, c_optimality, d_optimality
from gonio.planning.drawn_domes import N_DOMES, DrawnDomes
from gonio.planning.exchange import choose
from gonio.planning.information import Candidates, Design, Expected
from gonio.planning.result import AS_GOOD, DesignResult
from gonio.planning.verification import verify as verify_plan
from gonio.planning.virtual_session import (
    Setup,
    VirtualSession,
    coarse,
    one_channel,
    with_channels,
)
from gonio.progress import StagedProgress, begin
from gonio.samples import BRDFSamples

ROTATIONS_DEG = (0.0, 22.5, 45.0, 67.5, 90.0)  # for models whose f depends on phi_i
SMALLEST = 3  # images: one each of sample, standard and background
_TRIM = 0.02  # allowed growth of the criterion without an exposure: 1 % of an uncertainty
_COVERED = 0.995  # share of solid angle and light that must remain without them

Reached = Callable[[Expected], bool]


def design(
    model: Model | str,
    parameters: Mapping[str, float] | None = None,
    *,
    instrument: Instrument | str = "modern12",
    wanted: Mapping[str, float] | None = None,
    budget: int | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    verify: int | None = None,
    threads: int | None = None,
    progress: StagedProgress | None = None,
) -> DesignResult:
    """Choose which images to take for a wanted precision of parameters.

    Fisher information, with the errors that images share, decides on incidence angles, rotations,
    takes of standard and background, and exposures. The surface is taken to follow the model with
    these parameters exactly.

    Parameters
    ----------
    model : Model or str
        Model of the surface.
    parameters : mapping of str to float, optional
        Parameters about which to plan, radians for angles; the model's defaults for those that
        are left out.
    instrument : Instrument or str
        A preset, a TOML file, or an instrument.
    wanted : mapping of str to float, optional
        Relative standard uncertainties to reach, such as ``{"alpha_x": 0.01}``. Where neither this
        nor `budget` is given, those of the default plan.
    budget : int, optional
        Images of sample, standard and background together, at most; at least 3.
    fixed : mapping of str to float, optional
    tied : mapping of str to str, optional
        Parameters that a fit will hold fixed, or set equal to another one, as `gonio.fit` takes
        them. The plan does not have to determine them.
    verify : int, optional
        Number of seeds, at least 2, with which the plan is simulated, reduced and fitted; the
        scatter of the fits is compared with the expected uncertainties.
    threads : int, optional
        Number of worker threads; the result does not depend on it.
    progress : callable, optional
        Called with (stage, number done, number in all).

    Returns
    -------
    DesignResult
        The plan, ready for ``gonio.simulate(plan=...)``, and what is expected of it.

    Raises
    ------
    ConfigurationError
        For unknown names, parameters out of range, or a budget of fewer than 3 images.

    Examples
    --------
    >>> import gonio
    >>> ideal = gonio.instrument.preset("ideal12").with_pixels(52)
    >>> result = gonio.design("lambert", {"rho": 0.5}, instrument=ideal, budget=6)
    >>> result.plan.n_images <= 6
    True
    >>> bool(result.u_relative["rho"] < 0.01)
    True
    """
    chosen = get_model(model)
    instrument = load(instrument) if isinstance(instrument, str) else instrument
    constraints = Constraints.of(chosen, fixed, tied)
    constraints.refuse(wanted, "wanted uncertainty")
    values = {p.name: p.default for p in chosen.parameters} | dict(parameters or {})
    values |= constraints.fixed
    values |= {name: values[other] for name, other in constraints.tied.items()}
    targets = checked_targets(chosen, values, wanted or {})
    _check_counts(budget, verify)
    setup = Setup(
        coarse(one_channel(instrument)), chosen, chosen.vector(values), threads, constraints
    )
    result = _searched(setup, instrument, values, targets, budget, progress)
    if verify is None:
        return result
    return replace(result, verification=verify_plan(result, verify, progress=progress))


def checked_targets(
    model: Model, parameters: Mapping[str, float], wanted: Mapping[str, float]
) -> dict[str, float]:
    """Wanted relative standard uncertainties by name.

    Raises
    ------
    ConfigurationError
        If a name is no parameter of the model, a share is not positive, or a value is 0.

    Examples
    --------
    >>> checked_targets(get_model("ward"), {"alpha_x": 0.1}, {"alpha_x": 0.01})
    {'alpha_x': 0.01}
    """
    for name, share in wanted.items():
        if name not in model.names:
            raise unknown_name("parameter", name, model.names, of=model.name)
        if not 0 < share < inf:
            raise ConfigurationError(
                f"wanted {name} = {share}: a relative standard uncertainty is a positive number; "
                "0.01 is 1 %.",
                value=share,
            )
        if parameters[name] == 0:
            raise ConfigurationError(
                f"wanted {name} = {share}: {name} is 0, of which no share can be wanted; "
                f"give another value of {name}.",
                value=share,
            )
    return dict(wanted)


def _check_counts(budget: int | None, verify: int | None) -> None:
    if budget is not None and budget < SMALLEST:
        raise ConfigurationError(
            f"budget = {budget}: at least {SMALLEST} images are needed, one each of sample, "
            "standard and background.",
            value=budget,
        )
    if verify is not None and verify < 2:
        raise ConfigurationError(
            f"verify = {verify}: at least 2 seeds are needed for a scatter.", value=verify
        )


def _searched(
    setup: Setup,
    instrument: Instrument,
    parameters: Mapping[str, float],
    wanted: Mapping[str, float],
    budget: int | None,
    progress: StagedProgress | None,
) -> DesignResult:
    """The best plan; without targets and budget, one as good as the default plan."""
    model = setup.model
    default = default_plan(setup.instrument, anisotropic=is_anisotropic(model, parameters))
    rotations = (0.0,) if model.claims.isotropic else ROTATIONS_DEG
    everything = default.model_copy(update={"rotations_deg": rotations})
    candidates = _candidates(setup, everything, progress)
    of_default = candidates.expected(_design(everything, default))
    determined = candidates.expected(candidates.everything).determined
    unknowns = setup.unknowns
    sizes = np.abs([parameters[q.name] for q in unknowns])
    targets = np.array([wanted.get(q.name, np.nan) for q in unknowns]) * sizes
    if not wanted and budget is None:
        targets = np.where(of_default.determined, of_default.u, np.nan)
    has_target = np.isfinite(targets)
    criterion = c_optimality(targets) if has_target.any() else d_optimality(determined)

    def reached(expected: Expected) -> bool:
        # A parameter without a target must be determined too, or the fit does not converge.
        converges = bool(np.all(expected.determined[determined]))
        return converges and bool(np.all(expected.u[has_target] <= targets[has_target] * AS_GOOD))

    enough = reached if has_target.any() else None
    images = choose(candidates, criterion, budget=budget, reached=enough)
    full = _plan(everything, images)
    plan, final, samples = _without_idle_exposures(setup, full, criterion, enough, progress)
    whole = final.everything
    return DesignResult(
        setup=setup,
        instrument=instrument,
        parameters=dict(parameters),
        wanted=dict(wanted),
        plan=with_channels(plan, instrument),
        default_plan=with_channels(default, instrument),
        expected=final.expected(whole),
        expected_of_default=of_default,
        most_helpful=[
            None if h is None else (plan.theta_i_deg[h[0]], plan.rotations_deg[h[1]], h[2])
            for h in final.helps_most(whole)
        ],
        determined=determined.tolist(),
        meanings={"independent": "noise of the counts"}
        | {term.name: term.meaning for term in samples.shared},
        constant=frozenset(term.name for term in samples.shared if term.constant),
    )


def _candidates(setup: Setup, plan: Plan, progress: StagedProgress | None) -> Candidates:
    """Every image of a plan, from a virtual session of it."""
    doing = f"looking at {len(plan.theta_i_deg)} x {len(plan.rotations_deg)} images"
    session = setup.session(plan, progress=begin(progress, doing, "images"))
    return _judged(setup, session, DrawnDomes.draw(setup.instrument, 0))[0]


def _judged(
    setup: Setup, session: VirtualSession, domes: DrawnDomes
) -> tuple[Candidates, BRDFSamples]:
    """Candidates from a session's images, and its samples.

    The variances already contain its takes of standard and background.
    """
    plan = session.metadata.plan
    samples = reduce(session, threads=setup.threads)
    samples = domes.replace_slope_terms(samples)
    candidates = Candidates(
        samples,
        setup.model,
        setup.p,
        n_incidences=len(plan.theta_i_deg),
        n_rotations=len(plan.rotations_deg),
        threads=setup.threads,
        constraints=setup.constraints,
    )
    return candidates, samples


def _design(everything: Plan, plan: Plan) -> Design:
    """The numbers of a plan's angles among those of the candidates."""
    incidences = (everything.theta_i_deg.index(a) for a in plan.theta_i_deg)
    rotations = (everything.rotations_deg.index(a) for a in plan.rotations_deg)
    return Design(tuple(incidences), tuple(rotations), plan.repeats)


def _plan(everything: Plan, images: Design) -> Plan:
    return everything.model_copy(
        update={
            "theta_i_deg": tuple(everything.theta_i_deg[i] for i in images.incidences),
            "rotations_deg": tuple(everything.rotations_deg[r] for r in images.rotations),
            "repeats": images.repeats,
        }
    )


def _without_idle_exposures(
    setup: Setup,
    plan: Plan,
    criterion: Criterion,
    reached: Reached | None,
    progress: StagedProgress | None,
) -> tuple[Plan, Candidates, BRDFSamples]:
    """The plan without the exposures that no pixel needs, its candidates and its samples."""
    callback = begin(progress, "leaving out exposures", "images")
    session = setup.session(plan, progress=callback)
    # Domes other than those of the search, because the plan may be fitted to those.
    domes = DrawnDomes.draw(setup.instrument, N_DOMES)
    final, samples = _judged(setup, session, domes)
    expected = final.expected(final.everything)
    limit, area = criterion(expected) + _TRIM, _coverage(samples)
    good = reached is not None and reached(expected)
    keep = list(range(len(plan.exposures_s)))
    for k in range(len(plan.exposures_s)):
        fewer = [other for other in keep if other != k]
        if not fewer:
            break
        less = session.with_exposures(fewer)
        if not _still_covered(setup, less, area):
            continue
        tried, fewer_samples = _judged(setup, less, domes)
        then = tried.expected(tried.everything)
        if criterion(then) <= limit and (not good or (reached is not None and reached(then))):
            keep, final, samples = fewer, tried, fewer_samples
    exposures = tuple(plan.exposures_s[k] for k in keep)
    return plan.model_copy(update={"exposures_s": exposures}), final, samples


def _still_covered(setup: Setup, session: VirtualSession, coverage: tuple[float, float]) -> bool:
    """Whether nearly all of the solid angle and of the light is measured without an exposure."""
    if session.overexposed() > 1 - _COVERED:
        return False
    try:
        samples = reduce(session, threads=setup.threads)
    except DataError:
        return False  # without the exposure, frames are refused or no sample is left
    now = _coverage(samples)
    return all(after >= _COVERED * before for after, before in zip(now, coverage, strict=True))


def _coverage(samples: BRDFSamples) -> tuple[float, float]:
    """Solid angle over all images, sr, and light in it: a lost peak shows in the second."""
    assert samples.solid_angle is not None
    light: FloatArray = samples.solid_angle * samples.value * np.cos(samples.directions.theta_r)
    return float(np.sum(samples.solid_angle)), float(np.sum(light))
