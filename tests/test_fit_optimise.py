"""The minimum: every start ends in it, saddles and spikes are left, a wrong kernel is caught."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.fitting.minimum import gauss_newton, starting_values
from gonio.fitting.minimum.derivative_check import gradient_faults
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.minimum.minimise import minima, minimise
from gonio.fitting.minimum.optimum import better
from gonio.fitting.minimum.variable_projection import scored
from gonio.fitting.problem.single import SingleProblem
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

TRUTHS = {
    "ward": {"rho_d": 0.15, "rho_s": 0.19, "alpha_x": 0.088, "alpha_y": 0.13},
    "ward_isotropic": {"rho_d": 0.15, "rho_s": 0.19, "alpha": 0.1},
    "oren_nayar": {"rho": 0.8, "sigma": 0.4},
    "oren_nayar_torrance_sparrow": {"sigma": 0.35, "rho": 0.8, "ks_over_kb": 0.05},
}


def directions(n, rng, theta_max=70):
    theta = np.radians(rng.uniform(0, theta_max, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def noisy(name, n=2000, noise=0.01, seed=1, where=None, **changed):
    """Samples of a model with relative noise."""
    rng = np.random.default_rng(seed)
    where = where or directions(n, rng)
    f = models.get(name)(where, **(TRUTHS.get(name, {}) | changed))
    return BRDFSamples(where, f * (1 + noise * rng.standard_normal(len(f))))


def random_start(model, rng):
    start = {}
    for q in model.parameters:
        low, high = q.start or (q.lower, q.upper)
        if q.name.startswith("alpha"):
            start[q.name] = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))
        else:
            start[q.name] = float(rng.uniform(0.02, 0.9) if "rho" in q.name else
                                  rng.uniform(low, high))  # fmt: skip
    return start


# A start alone may lead ggx to a second minimum, with another refractive index; a fit does not stay
# there, which the test after this one counts.
SECOND_MINIMA = {"ggx"}


@pytest.mark.parametrize("name", [name for name in models.names() if name not in SECOND_MINIMA])
def test_fifty_random_starts_of_fifty_reach_one_minimum(name):
    model = models.get(name)
    # Some are a thousand times slower than a closed formula.
    problem = SingleProblem.from_samples(
        noisy(name, n=40 if model.costly else 1000), model, threads=1
    )
    rng = np.random.default_rng(2)
    some = [model.vector(random_start(model, rng)) for _ in range(50)]
    ends = [minimise(problem, start) for start in some]
    assert all(end.verified for end in ends)
    chi2 = np.array([end.chi2 for end in ends])
    np.testing.assert_allclose(chi2, chi2.min(), rtol=1e-9)
    free = minima(problem)[0]
    assert free.chi2 == pytest.approx(chi2.min(), rel=1e-9)
    determined = (np.diag(ends[0].curvature) > 0) & ends[0].free
    index = np.ix_(determined, determined)
    # The polish stops where its next step is 1e-5 of the uncertainties.
    sd = np.sqrt(np.diag(np.linalg.inv(ends[0].curvature[index])) * chi2.min() / problem.n)
    assert np.all(np.ptp([end.p[determined] for end in ends], axis=0) < 1e-3 * sd)


def test_fifty_fits_of_fifty_end_in_the_deeper_minimum_and_tell_of_the_other():
    model = models.get("ggx")
    samples = noisy("ggx", n=1000)
    free = find_minimum(samples, model)
    rng = np.random.default_rng(2)
    said = "the start led to another minimum, at rho_d = "
    other = []
    for _ in range(50):
        start = random_start(model, rng)
        given = find_minimum(samples, model, start=start)
        assert given.status == "converged"
        assert given.chi2 == pytest.approx(free.chi2, rel=1e-9)
        if any(text.startswith(said) for text in given.warnings):
            other.append((start, given))
    assert other
    # A fit goes on from there: the uncertainties are of the minimum, and the warning is kept.
    start, given = other[0]
    result = gonio.fit(samples, model="ggx", start=start)
    assert (result.status, result.chi2) == ("converged", given.chi2)
    assert any(text.startswith(said) for text in result.warnings)


def test_twenty_wards_of_twenty_come_back():
    rng = np.random.default_rng(8)
    for seed in range(20):
        truth = {
            "rho_d": float(rng.uniform(0.05, 0.5)),
            "rho_s": float(rng.uniform(0.05, 0.4)),
            "alpha_x": float(np.exp(rng.uniform(np.log(0.04), np.log(0.4)))),
            "alpha_y": float(np.exp(rng.uniform(np.log(0.04), np.log(0.4)))),
        }
        samples = noisy("ward", n=4000, seed=100 + seed, **truth)
        problem = SingleProblem.from_samples(samples, models.get("ward"))
        end = minima(problem)[0]
        assert end.verified
        np.testing.assert_allclose(end.p, list(truth.values()), rtol=0.05)


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("lambert+ward+ward", [0.1, 0.05, 0.12, 0.05, 0.07, 0.05, 0.2, 0.3, 0.25]),
        ("ward+ward+ward", [0.1, 0.1, 0.04, 0.05, 0.02, 0.15, 0.12, 0.15, 0.0, 0.25, 0.5, 0.4]),
    ],
)
def test_several_lobes_are_found_without_a_start(name, truth):
    model = models.get(name)
    where = directions(6000, np.random.default_rng(9))
    true = np.array(truth)
    f = model.evaluate(*where.vectors(), true)
    samples = BRDFSamples(where, f * (1 + 0.01 * np.random.default_rng(10).standard_normal(6000)))
    problem = SingleProblem.from_samples(samples, model)
    end = minima(problem)[0]
    assert end.verified
    assert end.chi2 <= problem.chi2(true)
    # The diffuse terms are one, so only their sum is known.
    found = starting_values.ordered(problem, end.p)
    true = starting_values.ordered(problem, true)
    lobes = [j for j, q in enumerate(model.parameters) if q.name.startswith(("rho_s", "alpha"))]
    np.testing.assert_allclose(found[lobes], true[lobes], rtol=0.1)
    np.testing.assert_allclose(problem.values(found), f, rtol=0.02)


def test_the_search_for_a_start_is_bounded(monkeypatch):
    asked = []
    original = scored
    monkeypatch.setattr(
        starting_values,
        "scored",
        lambda problem, box, p: (asked.append(len(p)), original(problem, box, p))[1],
    )
    for name in ("ggx", "lambert+ward+ward+ward", "ggx+ggx"):
        asked.clear()
        where = directions(300, np.random.default_rng(1))
        problem = SingleProblem.from_samples(
            BRDFSamples(where, 0.1 + models.get("ward")(where)), models.get(name)
        )
        assert len(starting_values.candidates(problem, 2)) == 2
        assert sum(asked) <= 2000


def test_no_more_light_is_reflected_than_comes():
    """Where the data ask for rho_d + k_s > 1 the sum stays at 1, and the fit says so."""
    where = directions(400, np.random.default_rng(11))
    f = models.get("ward_gmd")(where, rho_d=0.75, rho_s=0.25, alpha_x=0.2, alpha_y=0.2)
    f = f + 0.1 / np.pi + 0.002 * np.random.default_rng(12).standard_normal(400)
    result = gonio.fit(BRDFSamples(where, f), model="ward_gmd")
    assert result.status == "converged"
    held = [result.parameters[name] for name in ("rho_d", "rho_s")]
    assert sum(estimate.value for estimate in held) == pytest.approx(1, abs=1e-12)
    for estimate in held:
        assert estimate.stderr is None
        assert estimate.at_bound == "upper"
        low, high = estimate.interval_95
        assert low <= estimate.value <= high <= 1
    assert result.parameters["alpha_x"].stderr is not None
    assert any(
        text.startswith("rho_d + rho_s is at its bound 1, beyond which the surface would reflect ")
        for text in result.warnings
    )
    # The best point on the bound, found by another program.
    from scipy.optimize import minimize

    problem = SingleProblem.from_samples(BRDFSamples(where, f), models.get("ward_gmd"))
    other = minimize(
        lambda q: problem.chi2(np.array([1 - q[0], *q])), [0.3, 0.3, 0.3], method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000},
    )  # fmt: skip
    assert result.chi2 == pytest.approx(other.fun, rel=1e-8)


@pytest.mark.parametrize("name", TRUTHS)
def test_fit_from_given_starts_is_the_fit_from_the_data(name):
    samples = noisy(name, n=500)
    free = gonio.fit(samples, model=name)
    assert free.status == "converged"
    rng = np.random.default_rng(3)
    for _ in range(5):
        given = gonio.fit(samples, model=name, start=random_start(models.get(name), rng))
        assert given.status == "converged"
        for key, estimate in given.parameters.items():
            assert abs(estimate.value - free.values()[key]) < 1e-3 * estimate.stderr


def test_the_saddle_at_sigma_0_is_left():
    """f depends on sigma^2: its derivative vanishes at sigma = 0 whatever the data say."""
    problem = SingleProblem.from_samples(noisy("oren_nayar"), models.get("oren_nayar"), threads=1)
    stuck = minimise(problem, np.array([0.7, 0.0]), search=False)
    end = minimise(problem, np.array([0.7, 0.0]))
    assert stuck.chi2 > 10 * end.chi2
    assert abs(end.p[1] - 0.4) < 0.01


def test_a_lobe_switched_off_at_the_start_is_found():
    problem = SingleProblem.from_samples(noisy("ward"), models.get("ward"), threads=1)
    end = minimise(problem, np.array([0.2, 0.0, 2.0, 0.005]))
    assert end.verified
    np.testing.assert_allclose(end.p, list(TRUTHS["ward"].values()), rtol=0.02)


def test_a_noiseless_fit_is_exact():
    result = gonio.fit(noisy("ward", n=300, noise=0), model="ward")
    assert result.status == "converged"
    for key, true in TRUTHS["ward"].items():
        assert result.values()[key] == pytest.approx(true, rel=1e-10)


def test_the_minimum_is_that_of_scipy():
    from scipy.optimize import least_squares

    samples = noisy("ward", n=300)
    model = models.get("ward")
    end = minimise(SingleProblem.from_samples(samples, model), np.array([0.1, 0.1, 0.1, 0.1]))
    w_i, w_r = samples.directions.vectors()
    found = least_squares(
        lambda p: samples.value - model.evaluate(w_i, w_r, p), [0.1, 0.1, 0.1, 0.1],
        xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    # chi2 is flat to its rounding 1e-16 within 1e-8 of the uncertainties, which are 1e-2 of p.
    np.testing.assert_allclose(end.p, found.x, rtol=1e-6)
    assert end.chi2 == pytest.approx(2 * found.cost, rel=1e-12)


def wrong_kernel(xi, yi, zi, xr, yr, zr, rho, k):
    """Minnaert's law with a derivative by k that forgets the logarithm."""
    f = rho / 3.141592653589793 * (zi * zr) ** (k - 1)
    return f, f / rho, f


def right_kernel(xi, yi, zi, xr, yr, zr, rho, k):
    f = rho / 3.141592653589793 * (zi * zr) ** (k - 1)
    return f, f / rho, f * np.log(zi * zr)


def minnaert(kernel):
    return models.Model(
        name="sketch",
        title="",
        reference="",
        parameters=(
            models.Parameter("rho", "rho", "", 0.5, 0.01, 1.0),
            models.Parameter("k", "k", "", 1.0, 0.1, 2.0),
        ),
        kernel=kernel,
    )


def test_a_wrong_derivative_is_caught_by_name():
    rng = np.random.default_rng(4)
    where = directions(200, rng)
    value = 0.1 * np.cos(where.theta_r) ** 0.3 + 0.001 * rng.standard_normal(200)
    samples = BRDFSamples(where, value)
    good = gonio.fit(samples, model=minnaert(right_kernel))
    assert good.status == "converged"
    assert not any("derivative" in text for text in good.warnings)
    bad = gonio.fit(samples, model=minnaert(wrong_kernel))
    assert bad.status == "not_converged"
    assert not bad.ok
    assert (
        "the derivative of sketch with respect to k does not agree with its formula: the fit "
        "cannot be trusted until the model's kernel is corrected." in bad.warnings
    )
    assert not any("with respect to rho" in text for text in bad.warnings)


@pytest.mark.parametrize("name", models.names())
def test_the_derivatives_of_every_model_pass(name):
    model = models.get(name)
    rng = np.random.default_rng(5)
    where = directions(200, rng)
    problem = SingleProblem.from_samples(BRDFSamples(where, model(where) + 1e-3), model)
    for point in ("default", "lower", "upper"):
        p = np.array([getattr(q, point) for q in model.parameters])
        assert gradient_faults(problem, p) == []


def test_an_unfinished_minimum_is_not_converged(monkeypatch):
    monkeypatch.setattr(gauss_newton, "POLISH_STEPS", 1)  # a search would leave less to do
    result = gonio.fit(noisy("ward", n=200, noise=1e-4), model="ward", engine="gauss_newton")
    assert result.status == "not_converged"
    assert (
        "the minimum was not reached: the next step would still change the fit." in result.warnings
    )


def test_the_deeper_of_two_minima_wins():
    problem = SingleProblem.from_samples(noisy("ward", n=100), models.get("ward"))
    a = minimise(problem, np.array([0.1, 0.1, 0.1, 0.1]))
    deeper, same = replace(a, chi2=a.chi2 * 0.9, verified=False), replace(a, verified=False)
    assert better(a, deeper) is deeper
    assert better(deeper, a) is deeper
    assert better(a, same) is a
    assert better(same, a) is a


def test_the_start_subset_does_not_miss_a_narrow_lobe():
    samples = noisy("ward", n=30_000, alpha_x=0.01, alpha_y=0.01)
    problem = SingleProblem.from_samples(samples, models.get("ward"))
    subset = problem.subset(2000)
    assert 1900 < subset.n <= 2000
    assert subset.samples.value.max() == samples.value.max()
    assert gonio.fit(samples, model="ward").values()["alpha_x"] == pytest.approx(0.01, rel=0.05)
