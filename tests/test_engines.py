"""Engines: every way to the minimum ends in the same one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.errors import ConfigurationError
from gonio.fitting.minimum import engines
from gonio.fitting.minimum import minimise as minimise_module
from gonio.fitting.minimum.minimise import minima
from gonio.fitting.minimum.search_objective import Objective
from gonio.fitting.problem import losses
from gonio.fitting.problem.single import SingleProblem
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm

TRUTHS = {
    "ward": (0.15, 0.19, 0.088, 0.13),
    "oren_nayar": (0.8, 0.4),
    "lambert": (0.4,),
    "lambert+ward_isotropic": (0.1, 0.05, 0.25, 0.12),
}


def samples_of(name, n=600, noise=0.01, seed=1):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, 70, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    where = Directions(theta[0], phi[0], theta[1], phi[1])
    model = models.get(name)
    f = model.evaluate(*where.vectors(), np.array(TRUTHS[name]))
    return BRDFSamples(where, f * (1 + noise * rng.standard_normal(n)))


@pytest.mark.parametrize("name", TRUTHS)
def test_all_engines_find_one_minimum(name):
    problem = SingleProblem.from_samples(samples_of(name), models.get(name), threads=1)
    ends = {key: minima(problem, engines.get(key))[0] for key in engines.ENGINES}
    assert all(end.verified for end in ends.values())
    chi2 = np.array([end.chi2 for end in ends.values()])
    np.testing.assert_allclose(chi2, chi2.min(), rtol=1e-9)
    f = [problem.values(end.p) for end in ends.values()]
    # Both diffuse terms of the sum are one: its parameters are not determined, its values are.
    np.testing.assert_allclose(f, np.tile(f[0], (len(f), 1)), rtol=1e-6)


@pytest.mark.parametrize("engine", engines.ENGINES)
def test_the_result_names_its_engine(engine):
    result = gonio.fit(samples_of("ward"), model="ward", engine=engine)
    assert (result.engine, result.polish) == (engine, "gauss_newton")
    if engine == engines.NO_SEARCH:
        assert "engine: Gauss-Newton\n" in str(result)
    else:
        assert f"engine: nlopt {engine}, then Gauss-Newton\n" in str(result)
    assert result.status == "converged"
    np.testing.assert_allclose(list(result.values().values())[:2], TRUTHS["ward"][:2], rtol=0.02)


@pytest.mark.parametrize("engine", [name for name in engines.ENGINES if name != engines.NO_SEARCH])
def test_an_engine_alone_comes_near_the_minimum(engine):
    """The Gauss-Newton steps that follow would hide an engine that does nothing."""
    problem = SingleProblem.from_samples(samples_of("ward"), models.get("ward"), threads=1)
    best = minima(problem)[0]
    start = np.array([0.3, 0.05, 0.4, 0.4])
    p, evaluations = engines.get(engine)(problem, start)
    assert evaluations > 5
    assert problem.chi2(p) < best.chi2 + 1e-3 * (problem.chi2(start) - best.chi2)


def test_the_command_line_lists_the_engines_and_losses():
    from gonio.cli import fit

    assert list(fit.ENGINES) == list(engines.ENGINES)
    assert list(fit.LOSSES) == list(losses.LOSSES)
    assert fit.ENGINES[0] == engines.DEFAULT


def test_one_seed_is_one_search():
    problem = SingleProblem.from_samples(samples_of("ward"), models.get("ward"), threads=1)
    start = np.array([0.3, 0.05, 0.4, 0.4])
    first, second = (engines.get("mlsl", seed=7)(problem, start) for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])
    assert first[1] == second[1]


def test_an_unknown_engine_is_named():
    with pytest.raises(
        ConfigurationError, match=r"^unknown engine 'bobyqqa': did you mean 'bobyqa'\?"
    ):
        gonio.fit(samples_of("ward"), model="ward", engine="bobyqqa")


def test_a_failure_of_nlopt_keeps_the_best_point(monkeypatch):
    import nlopt

    for error in (nlopt.RoundoffLimited("x"), nlopt.runtime_error("x"), ValueError("x")):
        monkeypatch.setattr(nlopt.opt, "optimize", lambda *_, e=error: (_ for _ in ()).throw(e))
        result = gonio.fit(samples_of("ward", 200), model="ward", engine="slsqp")
        assert result.status == "converged"


def two_sheets():
    """Two materials with the widths of one, and a common error of the standard."""
    sheets = []
    for seed, factor in ((1, 1.0), (2, 1.6)):
        samples = samples_of("ward", 300, seed=seed)
        f = factor * samples.value
        term = SharedTerm("standard", "reflectance of the standard", relative=0.01)
        sheets.append(replace(samples, value=f, u_independent=0.01 * f + 1e-3, shared=(term,)))
    return sheets


@pytest.mark.parametrize("engine", ["lbfgs", "bobyqa", "mlsl"])
def test_joint_fits_and_shared_errors_take_every_engine(engine):
    """Each leads where Gauss-Newton steps alone lead."""
    sheets = two_sheets()
    for options in (
        {"samples": sheets, "share": "alpha_x,alpha_y"},
        {"samples": sheets[0], "nuisance": "all"},
    ):
        searched = gonio.fit(model="ward", engine=engine, **options)
        alone = gonio.fit(model="ward", engine=engines.NO_SEARCH, **options)
        assert (searched.engine, searched.status) == (engine, "converged")
        assert searched.chi2 == pytest.approx(alone.chi2, rel=1e-6)
        for name, estimate in alone.parameters.items():
            shift = searched.parameters[name].value - estimate.value
            assert abs(shift) < 1e-2 * estimate.stderr


def test_the_deeper_end_is_taken(monkeypatch):
    """Where a search ends in another valley than Gauss-Newton steps from the same start do."""
    samples = samples_of("ward", 300)
    problem = SingleProblem.from_samples(samples, models.get("ward"), threads=1)
    best = minima(problem)[0]
    astray = np.array([0.2, 0.0, 1.9, 1.9])  # no lobe at all
    found = minima(problem, lambda problem, start: (astray, 1))
    assert found[0].chi2 == pytest.approx(best.chi2, rel=1e-9)
    # And the other way round: the start of the steps is astray, the search is not.
    monkeypatch.setattr(minimise_module, "starts", lambda problem, n=None: [astray])
    found = minima(problem, lambda problem, start: (best.p, 1))
    assert found[0].chi2 == pytest.approx(best.chi2, rel=1e-9)


def test_the_slope_of_the_objective_is_its_difference_quotient():
    """The amplitudes follow the searched parameters, and yet the slope holds them."""
    problem = SingleProblem.from_samples(samples_of("ward"), models.get("ward"), threads=1)
    objective = Objective(problem, np.array([0.3, 0.05, 0.2, 0.2]))
    assert len(objective.start) == 2
    assert objective(objective.start, np.empty(0)) == pytest.approx(1)
    x, step, slope = objective.start + np.array([0.01, -0.02]), 1e-6, np.empty(2)
    objective(x, slope)
    for k, e in enumerate(np.eye(2)):
        ends = [objective(x + side * step * e, np.empty(0)) for side in (1, -1)]
        assert slope[k] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)


def test_a_model_without_nonlinear_parameters_needs_no_search():
    problem = SingleProblem.from_samples(samples_of("lambert"), models.get("lambert"))
    point, passes = engines.SEARCH(problem, np.array([0.9]))
    assert len(Objective(problem, point).start) == 0
    assert passes == 1
    assert point[0] == pytest.approx(0.4, rel=0.01)
