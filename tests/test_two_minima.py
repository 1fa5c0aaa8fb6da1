"""Chi-squared with two minima: the deeper one is found, or taken where the posterior shows it."""

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.fitting.minimum import minimise as minimise_module
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.posterior import sample as posterior
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

# With ggx an index below 1 and one above it make lobes that are much alike.
METAL = {"rho_d": 0.175, "k_s": 0.8, "alpha_x": 0.139, "alpha_y": 0.155, "eta": 0.956,
         "kappa": 0.275}  # fmt: skip
ELSEWHERE = np.array([0.14, 0.86, 0.32, 0.32, 1.6, 0.0])  # leads to eta = 1.44


def glossy_metal(n=600):
    rng = np.random.default_rng(3)
    theta_i = np.radians(rng.choice([10, 30, 50, 70], n))
    theta_r = np.abs(np.clip(theta_i + rng.normal(0, 0.3, n), 0, 1.3))
    where = Directions(theta_i, np.zeros(n), theta_r, np.pi + rng.normal(0, 0.4, n))
    f = models.get("ggx")(where, **METAL)
    u = 0.03 * f + 1e-3
    return BRDFSamples(where, f + u * rng.standard_normal(n), u_independent=u)


def test_the_deeper_of_two_minima_is_found():
    samples = glossy_metal()
    found = gonio.fit(samples, model="ggx")
    assert found.status == "converged"
    assert found.chi2 / found.dof == pytest.approx(1, abs=0.1)
    problem = find_minimum(samples, models.get("ggx")).problem
    other = minimise(problem, ELSEWHERE, search=False)
    assert other.verified
    assert other.chi2 > 10 * found.chi2


def one_incidence_of_a_narrow_lobe():
    """A lobe that three samples of a grid of 10 deg show, with alpha_x below the usual range."""
    mesh = np.meshgrid(np.arange(0.0, 80, 10), np.arange(0.0, 360, 30), indexing="ij")
    theta_r, phi_r = (np.radians(axis.ravel()) for axis in mesh)
    where = Directions(np.full(len(phi_r), np.radians(29.2)), np.zeros(len(phi_r)), theta_r, phi_r)
    truth = {"rho_d": 0.32, "rho_s": 0.17, "alpha_x": 0.0112, "alpha_y": 0.234}
    f = models.get("ward_gmd")(where, **truth)
    u = 0.003 * f
    rng = np.random.default_rng(2)
    return BRDFSamples(where, f + u * rng.standard_normal(len(f)), u_independent=u), truth


def test_a_lobe_between_the_range_of_starts_and_the_bound_is_found():
    samples, truth = one_incidence_of_a_narrow_lobe()
    found = find_minimum(samples, models.get("ward_gmd"))
    of_truth = minimise(found.problem, found.problem.vector(truth), search=False)
    assert found.optimum.chi2 <= of_truth.chi2 + 1e-3


def test_a_deeper_minimum_among_the_draws_is_taken(monkeypatch):
    monkeypatch.setattr(minimise_module, "starts", lambda problem, n=None: [ELSEWHERE])
    long = posterior.sample
    monkeypatch.setattr(posterior, "sample", lambda *a, **k: long(*a, **k, max_steps=1000))
    samples = glossy_metal()
    assert gonio.fit(samples, model="ggx").chi2 > 7000
    found = gonio.fit(samples, model="ggx", posterior=True, seed=1)
    assert found.chi2 / found.dof == pytest.approx(1, abs=0.1)
    assert found.parameters["eta"].value == pytest.approx(METAL["eta"], abs=0.03)
    low, high = found.parameters["eta"].interval_95
    assert low < found.parameters["eta"].value < high
    (told,) = (text for text in found.warnings if "the posterior led to a deeper" in text)
    assert told.startswith("the search found a minimum at rho_d = 0.14")
