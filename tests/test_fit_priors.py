"""Priors: read and refused by their text, and what they do to a posterior."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import gonio
from gonio import models
from gonio.errors import ConfigurationError
from gonio.fitting.posterior import priors
from gonio.geometry import Directions
from gonio.models import Parameter
from gonio.samples import BRDFSamples

RHO = Parameter("rho", "rho", "reflectance", 0.5, 0.0, 1.0)
SIGMA = Parameter("sigma", "sigma", "slope angle", 0.3, 0.01, 1.5, "rad")
EXACT = {
    "normal(20, 5)": lambda p: stats.norm(20, 5).logpdf(np.degrees(p)),
    "lognormal(20, 1.3)": lambda p: stats.lognorm(np.log(1.3), scale=20).logpdf(np.degrees(p)),
    "half_normal(10)": lambda p: stats.halfnorm(np.degrees(0.01), 10).logpdf(np.degrees(p)),
    "log": lambda p: -np.log(p),
    "flat": lambda p: 0 * p,
}


@pytest.mark.parametrize("text", EXACT)
def test_a_prior_has_the_density_it_names_in_degrees(text):
    p = np.linspace(0.1, 1.2, 7)
    prior = priors.parse(SIGMA, text)
    difference = prior.log_density(p) - EXACT[text](p)
    np.testing.assert_allclose(difference, difference[0], atol=1e-12)
    assert prior.text(SIGMA) == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gauss(1, 2)", r"^the prior 'gauss\(1, 2\)' of rho is not understood; allowed are flat, "
         r"log, normal\(mean, sd\), lognormal\(median, factor\) or half_normal\(sd\)\.$"),
        ("__import__('os')", r"is not understood; allowed are flat"),
        ("normal(0.1)", r"^the prior 'normal\(0\.1\)' of rho must have mean and sd, as in "
         r"normal\(mean, sd\)\.$"),
        ("normal", r"must have mean and sd"),
        ("normal(a, b)", r"must have mean and sd"),
        ("normal(nan, 1)", r"must have mean and sd"),
        ("flat(1)", r"^the prior 'flat\(1\)' of rho must have no number: write flat\.$"),
        ("normal(0.1, 0)", r"^the prior 'normal\(0\.1, 0\)' of rho needs an sd above 0\.$"),
        ("half_normal(-1)", r"of rho needs an sd above 0\.$"),
        ("normal(3, 0.1)", r"has its mean 20 sd outside the bounds 0 to 1\.$"),
        ("lognormal(0.1, 1)", r"needs a factor above 1 \(1\.2 means about 20 %\)\.$"),
        ("lognormal(2, 2)", r"needs a median above 0 within the bounds 0 to 1\.$"),
        ("log", r"^the prior 'log' of rho needs a lower bound above 0, and that of rho is 0: ln p "
         r"would be unbounded\.$"),
    ],
)  # fmt: skip
def test_a_bad_prior_is_refused(text, message):
    with pytest.raises(ConfigurationError, match=message):
        priors.parse(RHO, text)


def test_priors_are_given_by_parameter_or_declared_with_it():
    declared = Parameter("sigma", "s", "", 0.3, 0.01, 1.5, "rad", prior="normal(20, 5)")
    red, blue = (Parameter(f"rho[{c}]", "r", "", 0.5, 0.0, 1.0) for c in ("red", "blue"))
    found = priors.resolve(
        (declared, red, blue), {"rho": "half_normal(0.2)", "rho[blue]": "normal(0.5, 0.1)"}
    )
    assert [prior.kind for prior in found] == ["normal", "half_normal", "normal"]
    with pytest.raises(
        ConfigurationError,
        match=r"^unknown parameter of a prior 'sigmo': did you mean 'sigma'\? Choose from ",
    ):
        priors.resolve((declared, red), {"sigmo": "flat"})


def lambertian(n=50, sd=0.01, rho=0.4):
    where = Directions(np.linspace(0, 1, n), 0.0, np.linspace(1, 0, n), 0.3)
    noise = np.random.default_rng(1).standard_normal(n)
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    return BRDFSamples(where, rho / np.pi + sd * noise, u_independent=np.full(n, sd))


@pytest.mark.parametrize("sampler", ["marginal", "emcee"])
def test_a_normal_prior_on_an_amplitude_is_conjugate(sampler):
    samples = lambertian()
    sd = np.pi * 0.01 / np.sqrt(50)
    result = gonio.fit(
        samples, model="lambert", posterior=True, sampler=sampler,
        priors={"rho": "normal(0.41, 0.005)"},
    )  # fmt: skip
    precision = sd**-2 + 0.005**-2
    mean = (0.4 * sd**-2 + 0.41 * 0.005**-2) / precision
    low, high = result.parameters["rho"].interval_68
    slack = 6 / np.sqrt(precision * result.posterior.ess)
    assert low == pytest.approx(mean - precision**-0.5, abs=slack)
    assert high == pytest.approx(mean + precision**-0.5, abs=slack)
    # The minimum and its standard uncertainty know nothing of it.
    assert result.parameters["rho"].value == pytest.approx(0.4, abs=1e-9)
    assert result.parameters["rho"].stderr == pytest.approx(sd, rel=1e-6)
    assert result.posterior.priors == {"rho": "normal(0.41, 0.005)"}


def test_a_lognormal_prior_on_an_amplitude_is_sampled_with_the_rest():
    samples = lambertian(rho=0.05)
    sd = np.pi * 0.01 / np.sqrt(50)
    result = gonio.fit(
        samples, model="lambert", posterior=True, priors={"rho": "lognormal(0.05, 1.05)"}
    )
    p = np.linspace(0.03, 0.07, 20001)
    density = stats.norm(0.05, sd).pdf(p) * stats.lognorm(np.log(1.05), scale=0.05).pdf(p)
    mass = np.cumsum(density) / density.sum()
    low, high = np.interp([0.15865525, 0.84134475], mass, p)
    slack = 3 * (high - low) / np.sqrt(result.posterior.ess)
    assert result.parameters["rho"].interval_68 == pytest.approx((low, high), abs=slack)


def test_a_prior_decides_where_the_data_do_not():
    """Two lobes' widths from samples far from any lobe: the prior comes back."""
    rng = np.random.default_rng(1)
    theta = np.linspace(0.3, 1.0, 40)
    where = Directions(theta, 0.0, theta, 0.1)  # towards the light, not the mirror direction
    model = models.get("ward_isotropic")
    f = model(where, rho_d=0.3, rho_s=0.1, alpha=0.1)
    samples = BRDFSamples(
        where, f + 0.01 * rng.standard_normal(40), u_independent=np.full(40, 0.01)
    )
    result = gonio.fit(
        samples, model="ward_isotropic", posterior=True, priors={"alpha": "normal(0.1, 0.01)"}
    )
    low, high = result.parameters["alpha"].interval_68
    assert (low, high) == pytest.approx((0.09, 0.11), abs=2e-3)


def test_priors_without_a_posterior_are_refused():
    message = "priors change the posterior only, and none was asked for; add posterior=True."
    with pytest.raises(ConfigurationError, match=f"^{message}$"):
        gonio.fit(lambertian(), model="lambert", priors={"rho": "normal(0.4, 0.1)"})
