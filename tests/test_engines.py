"""Engines: every way to the minimum ends in the same one."""

from __future__ import annotations

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.errors import ConfigurationError
from gonio.fitting.minimum import engines
from gonio.fitting.minimum.minimise import minima
from gonio.fitting.problem import losses
from gonio.fitting.problem.single import SingleProblem
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

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
    assert result.engine == engine
    assert result.status == "converged"
    np.testing.assert_allclose(list(result.values().values())[:2], TRUTHS["ward"][:2], rtol=0.02)


@pytest.mark.parametrize("engine", [name for name in engines.ENGINES if name != engines.DEFAULT])
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
