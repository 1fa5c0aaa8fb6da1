"""Whether parts share a parameter where the model does not hold."""

from __future__ import annotations

import numpy as np
import pytest
from hemisphere import grid

import gonio
from gonio import models
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.uncertainty.clustered import by_groups
from gonio.fitting.uncertainty.incidence_groups import incidence_groups
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.sample_jackknife import by_samples
from gonio.fitting.uncertainty.second_derivatives import SecondDerivatives
from gonio.samples import BRDFSamples

WHERE = grid(incidences=(5, 25, 45, 60), viewing=14, azimuths=(0, 60, 120, 165, 180))


def phong(n=20.0, *, sd=0.01, seed=1):
    """A lobe that Ward's model has not, with known noise."""
    f = models.get("phong")(WHERE, rho_d=0.2, rho_s=0.2, n=n) * np.ones(len(WHERE.theta_r))
    noise = np.random.default_rng(seed).standard_normal(len(f))
    return BRDFSamples(WHERE, f * (1 + sd * noise), sd * f)


def shared(a, b):
    fit = gonio.fit({"a": a, "b": b}, model="ward_isotropic", share="alpha", threads=1)
    return fit.sharing, fit


def test_random_halves_of_one_sheet_share_their_roughness():
    """chi-squared grows by many times its expectation, and that means nothing here."""
    samples, rng = phong(), np.random.default_rng(2)
    chances, growths = [], []
    for _ in range(12):
        order = rng.permutation(len(samples))
        half = len(order) // 2
        test, _ = shared(
            samples.select(np.sort(order[:half]), "one"),
            samples.select(np.sort(order[half:]), "other"),
        )
        assert test.distance is not None
        chances.append(test.p_value)
        growths.append(test.growth)
    assert min(chances) > 0.01
    assert np.count_nonzero(np.array(chances) < 0.05) <= 2
    assert np.ptp(chances) > 0.3


def test_another_roughness_is_refused_all_the_same():
    test, fit = shared(phong(seed=1), phong(n=8.0, seed=2))
    assert test.refused
    assert test.p_value < 0.001
    assert test.change > 0.01
    assert any("separate estimates differ by up to" in text for text in fit.warnings)
    assert "misfit allowed for" in str(fit)


def test_a_clear_difference_that_changes_nothing_is_not_refused():
    """Channels with one misfit: their difference is known far better than either."""
    test, fit = shared(phong(sd=0.001), phong(20.4, sd=0.001))
    assert test.p_value < 0.01
    assert test.change < 0.01
    assert not test.refused
    assert "but sharing changes f by 0." in str(fit)


def test_where_the_model_holds_chi_squared_decides():
    f = models.get("ward_isotropic")(WHERE, rho_d=0.2, rho_s=0.1, alpha=0.2)
    rng = np.random.default_rng(3)
    a, b = (
        BRDFSamples(WHERE, f * (1 + 0.02 * rng.standard_normal(len(f))), 0.02 * f) for _ in range(2)
    )
    test, fit = shared(a, b)
    assert test.distance is None
    assert "chi2 grows by" in str(fit)


@pytest.mark.parametrize("of", ["samples", "incidences"])
def test_the_covariance_of_combinations_is_that_of_the_parameters_combined(of):
    minimum = find_minimum(phong(), models.get("ward_isotropic"))
    rows = np.array([[1.0, 0.0, -1.0], [0.5, 0.5, 0.0]])
    informed = Informed.of(minimum)

    def spread(own):
        if of == "samples":
            return by_samples(own, SecondDerivatives(minimum))
        return by_groups(own, incidence_groups(minimum.problem))[0]

    whole, combined = spread(informed), spread(informed.of_combinations(rows))
    np.testing.assert_allclose(combined.covariance, rows @ whole.covariance @ rows.T, rtol=1e-8)
    same = spread(informed.of_combinations(np.eye(3)))
    np.testing.assert_allclose(same.dof, whole.dof, rtol=1e-8)
