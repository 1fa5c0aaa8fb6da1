"""Channels and materials together: against scipy, by information, by simulation, and refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares

import gonio
from gonio import models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.minimum.minimise import minimise, pinned_at
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.channels import Channel, split
from gonio.fitting.problem.joined_samples import joined
from gonio.fitting.problem.joint import JointProblem
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.result import FitResult
from gonio.fitting.uncertainty.profile_likelihood import profile_limit
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm

NM = (450.0, 550.0, 650.0)
RHO_D = (0.1, 0.2, 0.3)


def around_the_mirror(n, rng):
    """Half of the directions near the specular one, the others anywhere."""
    theta = np.radians(rng.uniform(5, 65, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    near = np.arange(n) < n // 2
    theta[1] = np.where(near, np.clip(theta[0] + rng.normal(0, 0.15, n), 0, 1.2), theta[1])
    phi[1] = np.where(near, phi[0] + np.pi + rng.normal(0, 0.3, n), phi[1])
    return [theta[0], phi[0], theta[1], phi[1]]


def spectrum(
    *,
    n=150,
    nm=NM,
    rho_d=RHO_D,
    rho_s=0.1,
    alpha=0.15,
    noise=0.02,
    seed=1,
    stated=True,
    alike=False,
    model="ward_isotropic",
    **columns,
):
    """Samples of one material at several wavelengths, each with directions and noise of its own."""
    rng = np.random.default_rng(seed)
    k = len(nm)
    angles, value, u = [], [], []
    where = around_the_mirror(n, rng)
    for j in range(k):
        where = where if alike else around_the_mirror(n, rng)
        f = models.get(model)(
            Directions(*where), rho_d=rho_d[j], rho_s=np.broadcast_to(rho_s, k)[j],
            alpha=np.broadcast_to(alpha, k)[j],
        )  # fmt: skip
        sd = noise * f.mean()
        angles.append(where)
        value.append(f + sd * rng.standard_normal(n))
        u.append(np.full(n, sd))
    return BRDFSamples(
        Directions(*np.concatenate(angles, axis=1)),
        np.concatenate(value),
        u_independent=np.concatenate(u) if stated else None,
        wavelength_nm=np.repeat(nm, n),
        **columns,
    )


def flat(value, *, n=60, u=0.001, seed=3, **columns):
    """A Lambertian surface in channels a, b, ... with these values of f."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0, 1.2, n * len(value))
    f = np.repeat(value, n)
    return BRDFSamples(
        Directions(theta, 0.0, theta[::-1], 0.0),
        f + u * rng.standard_normal(len(f)),
        u_independent=np.full(len(f), u),
        channel=np.repeat([chr(97 + k) for k in range(len(value))], n),
        **columns,
    )


def pinned(value):
    return pytest.approx(value, rel=1e-6)


# ---------------------------------------------------------------------- what a joint fit is


@pytest.mark.parametrize("stated", [True, False])
def test_a_joint_fit_is_one_least_squares_problem(stated):
    samples = spectrum(stated=stated)
    result = gonio.fit(samples, model="ward_isotropic", share=("alpha",))
    assert result.status == "converged"
    assert list(result.parameters) == [
        "alpha", "rho_d[450 nm]", "rho_s[450 nm]", "rho_d[550 nm]", "rho_s[550 nm]",
        "rho_d[650 nm]", "rho_s[650 nm]",
    ]  # fmt: skip
    model = models.get("ward_isotropic")
    w_i, w_r = samples.directions.vectors()
    # Every channel counts by the factor that its fit alone needs.
    alone = {}
    for nm in NM:
        part = samples.select(samples.wavelength_nm == nm, "one")
        alone[nm] = gonio.fit(part, model=model).noise_scale
    u = np.ones(len(samples)) if samples.u_independent is None else samples.u_independent
    sd = u * np.array([alone[nm] for nm in samples.wavelength_nm])
    which = np.searchsorted(NM, samples.wavelength_nm)

    def residual(x):
        f = np.empty(len(samples))
        for k in range(3):
            at = which == k
            p = np.array([x[1 + 2 * k], x[2 + 2 * k], x[0]])
            f[at] = model.evaluate(w_i[at], w_r[at], p)
        return (samples.value - f) / sd

    found = least_squares(
        residual, [0.2, 0.2, 0.1, 0.2, 0.1, 0.2, 0.1], jac="3-point", x_scale=0.1,
        xtol=1e-14, ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(list(result.values().values()), found.x, rtol=1e-6)
    expected = np.linalg.inv(found.jac.T @ found.jac) * result.noise_scale**2
    np.testing.assert_allclose(np.array(result.covariance), expected, rtol=1e-4, atol=1e-12)


def test_the_shared_parameter_has_the_information_of_all_channels():
    samples = spectrum(n=400)
    result = gonio.fit(samples, model="ward_isotropic", share=("alpha",))
    information = 0.0
    for nm in NM:
        part = samples.select(samples.wavelength_nm == nm, "one")
        alone = gonio.fit(part, model="ward_isotropic")
        information += 1 / alone.parameters["alpha"].stderr ** 2
    # The curvature of each is taken at another minimum.
    assert result.parameters["alpha"].stderr ** -2 == pytest.approx(information, rel=0.03)


def test_sharing_nothing_is_fitting_each_alone():
    samples = spectrum()
    result = gonio.fit(samples, model="ward_isotropic", share=())
    assert result.sharing is None
    for nm in NM:
        part = samples.select(samples.wavelength_nm == nm, "one")
        alone = gonio.fit(part, model="ward_isotropic")
        for name in ("rho_d", "rho_s", "alpha"):
            joint = result.parameters[f"{name}[{nm:g} nm]"]
            assert joint.value == pinned(alone.parameters[name].value)
            assert joint.stderr == pytest.approx(alone.parameters[name].stderr, rel=0.05)


def test_sharing_everything_is_fitting_all_as_one():
    samples = spectrum(rho_d=(0.2, 0.2, 0.2))
    names = ("rho_d", "rho_s", "alpha")
    result = gonio.fit(samples, model="ward_isotropic", share="rho_d, rho_s, alpha")
    assert tuple(result.parameters) == names
    pooled = gonio.fit(samples, model="ward_isotropic")
    for name in names:
        # The channels' factors on the noise differ by some per cent.
        value, u = pooled.parameters[name].value, pooled.parameters[name].stderr
        assert result.parameters[name].value == pytest.approx(value, abs=0.3 * u)
        assert result.parameters[name].stderr == pytest.approx(u, rel=0.1)
    assert not result.sharing.refused


def test_thirty_one_wavelengths_recover_a_spectrum():
    nm = np.linspace(400, 700, 31)
    rho_d = 0.2 + 0.15 * np.sin(nm / 50)
    rho_s = 0.05 + 0.02 * np.cos(nm / 80)
    samples = spectrum(n=500, nm=nm, rho_d=rho_d, rho_s=rho_s, noise=0.05)
    result = gonio.fit(samples, model="ward_isotropic", share=("alpha",))
    assert result.status == "converged"
    assert len(result.parameters) == 63
    estimates = result.parameters
    assert abs(estimates["alpha"].value - 0.15) < 4 * estimates["alpha"].stderr
    pulls = []
    for k, part in enumerate(result.parts):
        for name, true in (("rho_d", rho_d[k]), ("rho_s", rho_s[k])):
            estimate = estimates[part.parameters[name]]
            pulls.append((estimate.value - true) / estimate.stderr)
    # 62 squares of normal deviates of which alpha makes some a little alike.
    assert 0.001 < stats.chi2.sf(np.sum(np.square(pulls)), 62) < 0.999
    assert not result.sharing.refused


def test_the_order_of_the_channels_does_not_matter():
    samples = spectrum()
    mixed = samples.select(np.random.default_rng(1).permutation(len(samples)), "mixed")
    first, second = (gonio.fit(s, model="ward_isotropic", share=("alpha",))
                     for s in (samples, mixed))  # fmt: skip
    assert list(first.parameters) == list(second.parameters)
    for name, estimate in first.parameters.items():
        assert second.parameters[name].value == pinned(estimate.value)
        assert second.parameters[name].stderr == pinned(estimate.stderr)


def test_a_channel_without_a_lobe_leaves_the_others():
    samples = spectrum(rho_s=(0.1, 0.0, 0.1), seed=2)
    result = gonio.fit(samples, model="ward_isotropic", share=("alpha",))
    assert result.status == "converged"
    for name, true in (("alpha", 0.15), ("rho_d[450 nm]", 0.1), ("rho_s[650 nm]", 0.1)):
        estimate = result.parameters[name]
        assert abs(estimate.value - true) < 4 * estimate.stderr
    none = result.parameters["rho_s[550 nm]"]
    assert none.interval_95[0] == 0
    assert none.interval_95[1] < 0.003
    # Alone it says nothing of alpha, and is no evidence for or against the sharing.
    assert not result.sharing.refused


def test_an_undetermined_parameter_of_one_channel_is_that_channels_alone():
    samples = spectrum(rho_d=(0.2, 0.2, 0.2), rho_s=(0.1, 0.0, 0.1), seed=2)
    result = gonio.fit(samples, model="ward_isotropic", share=("rho_d",))
    assert result.parameters["alpha[550 nm]"].stderr is None
    for nm in (450, 650):
        estimate = result.parameters[f"alpha[{nm} nm]"]
        assert abs(estimate.value - 0.15) < 4 * estimate.stderr
    assert result.covariance is None


def test_data_without_noise_converge():
    result = gonio.fit(spectrum(noise=0.0, stated=False), model="ward_isotropic", share=("alpha",))
    assert result.status == "converged"
    assert result.parameters["alpha"].value == pytest.approx(0.15, rel=1e-9)


# ---------------------------------------------------------------------- the test of the sharing


def test_different_roughness_is_refused():
    samples = spectrum(alpha=(0.15, 0.15, 0.17), n=300)
    result = gonio.fit(samples, model="ward_isotropic", share=("alpha",))
    assert result.sharing.refused
    assert result.sharing.p_value < 1e-6
    assert result.sharing.dof == 2
    rejected = [text for text in result.warnings if text.startswith("the data reject one alpha")]
    assert len(rejected) == 1
    assert "of which noise explains about 2" in rejected[0]
    assert "The farthest is 650 nm: alpha alone is 0.1" in rejected[0]
    value, u = result.parts[2].alone["alpha"]
    assert abs(value - 0.17) < 4 * u
    # The misfit is that of the sharing, not of the model.
    assert not any("effects that it leaves out" in text for text in result.warnings)


@pytest.mark.parametrize("stated", [True, False])
def test_one_roughness_is_refused_as_rarely_as_the_chance_says(stated):
    chances = []
    for seed in range(30):
        samples = spectrum(nm=NM[:2], n=60, seed=seed, stated=stated)
        result = gonio.fit(samples, model="ward_isotropic", share=("alpha",), threads=1)
        chances.append(result.sharing.p_value)
    # Kolmogorov and Smirnov's test of 30 numbers against the uniform distribution.
    assert stats.kstest(chances, "uniform").pvalue > 0.01


@pytest.mark.parametrize(("own", "refused"), [(True, False), (False, True)])
def test_errors_of_the_channels_own_are_allowed_for(own, refused):
    """rho differs by 2 %: a standard of each channel explains that, one for all does not."""
    group = np.repeat([0, 1], 60).astype(np.int64) if own else None
    term = SharedTerm("standard", "its reflectance", 0.015, group)
    result = gonio.fit(flat([0.100, 0.102], shared=(term,)), model="lambert", share=("rho",))
    assert result.sharing.growth > 50
    assert result.sharing.refused is refused


# ---------------------------------------------------------------------- shared errors


def test_one_standard_for_all_channels_correlates_them_fully():
    term = SharedTerm("standard", "its reflectance", 0.02)
    truth = [0.05, 0.1, 0.2]
    result = gonio.fit(flat(truth, u=1e-5, shared=(term,)), model="lambert", share=())
    found = np.array(result.covariance)
    u = np.sqrt(np.diag(found))
    np.testing.assert_allclose(found / np.outer(u, u), 1.0, atol=1e-4)
    np.testing.assert_allclose(u, 0.02 * np.pi * np.array(truth), rtol=1e-3)


def test_the_covariance_is_that_of_repetitions():
    """A standard for all and a lamp that drifts from channel to channel, drawn 100 times."""
    n, truth = 60, [0.1, 0.2]
    group = np.repeat([4, 9], n).astype(np.int64)
    terms = (SharedTerm("standard", "", 0.02), SharedTerm("lamp", "", 0.01, group))
    rng = np.random.default_rng(5)
    draws = []
    for seed in range(100):
        samples = flat(truth, u=0.01, seed=seed, shared=terms)
        lamp = 1 + 0.01 * np.repeat(rng.standard_normal(2), n)
        value = samples.value * (1 + 0.02 * rng.standard_normal()) * lamp
        samples = BRDFSamples(samples.directions, value, samples.u_independent,
                              channel=samples.channel, shared=terms)  # fmt: skip
        result = gonio.fit(samples, model="lambert", share=(), threads=1)
        draws.append(list(result.values().values()))
    expected, seen = np.array(result.covariance), np.cov(np.array(draws).T)
    u = np.sqrt(np.diag(expected))
    # A covariance of 100 draws is good to about 1/sqrt(100) of the product of the deviations.
    np.testing.assert_allclose(seen / np.outer(u, u), expected / np.outer(u, u), atol=0.35)
    assert expected[0, 1] / (u[0] * u[1]) > 0.5


def test_errors_of_the_instrument_are_one_for_all_materials_and_the_lamp_is_not():
    group = np.repeat([0], 60).astype(np.int64)
    terms = (
        SharedTerm("standard", "its reflectance", 0.02),
        SharedTerm("lamp", "image to image", 0.01, group),
        SharedTerm("source cone", "its half-angle", blur=0.01),
    )
    one, two = (flat([0.1], shared=terms, metadata={"instrument": "a"}) for _ in range(2))
    together = joined(split({"paint": one, "cloth": two}))
    assert [t.name for t in together.shared] == ["standard", "lamp", "source cone", "lamp"]
    assert together.shared[0].group is None
    np.testing.assert_array_equal(together.shared[1].change(np.ones(120)), [0.01] * 60 + [0] * 60)
    np.testing.assert_array_equal(together.shared[3].change(np.ones(120)), [0] * 60 + [0.01] * 60)
    other = flat([0.1], shared=terms, metadata={"instrument": "b"})
    assert len(joined(split({"paint": one, "cloth": other})).shared) == 6


def test_a_blur_of_one_material_does_nothing_to_the_other():
    def ward(**columns):
        samples = spectrum(nm=NM[:1], n=200, seed=4, **columns)
        return BRDFSamples(samples.directions, samples.value, samples.u_independent,
                           shared=samples.shared, metadata=samples.metadata)  # fmt: skip

    blur = SharedTerm("source cone", "its half-angle", blur=0.02)
    mixed = {"a": ward(shared=(blur,)), "b": ward()}
    result = gonio.fit(mixed, model="ward_isotropic", share=())
    assert result.parameters["alpha[a]"].components["source cone"] > 1e-5
    assert result.parameters["alpha[b]"].components["source cone"] == 0.0


def test_a_misfit_that_all_channels_show_is_counted_once():
    """Phong's lobe by Ward's: the same residuals again are no new evidence of alpha."""
    rng = np.random.default_rng(1)
    where = around_the_mirror(300, rng)
    f = models.get("phong")(Directions(*where), rho_d=0.1, rho_s=0.3, n=20.0)
    angles = np.concatenate([where] * 4, axis=1)
    value = np.tile(f, 4) + 1e-6 * rng.standard_normal(1200)
    samples = BRDFSamples(
        Directions(*angles), value, wavelength_nm=np.repeat([400.0, 500, 600, 700], 300)
    )
    alone = gonio.fit(samples.select(np.arange(300), "one"), model="ward_isotropic")
    result = gonio.fit(samples, model="ward_isotropic", share=("alpha",))
    u = alone.parameters["alpha"].stderr
    assert result.parameters["alpha"].stderr == pytest.approx(u, rel=0.02)
    assert any(
        "the residuals of the parts are correlated (correlation 1" in w for w in result.warnings
    )
    # With noise instead they are evidence, and nothing is said.
    noisy = spectrum(alike=True, n=300)
    assert not any("alike" in w for w in
                   gonio.fit(noisy, model="ward_isotropic", share=("alpha",)).warnings)  # fmt: skip


# ---------------------------------------------------------------------- the problem


def joint_problem(samples, share=("alpha",), model="ward_isotropic"):
    channels = split(samples)
    problems = [SingleProblem.from_samples(c.samples, models.get(model)) for c in channels]
    return JointProblem.from_parts(channels, problems, share)


def test_the_members_of_a_problem_agree_with_each_other():
    problem = joint_problem(spectrum(n=40)).scaled((1.0, 2.0, 3.0))
    p = np.array([0.2, 0.1, 0.05, 0.2, 0.06, 0.3, 0.07])
    chi2, g, h = problem.normal_equations(p)
    f, jac = problem.jacobian(p)
    r = problem.samples.value - f
    np.testing.assert_allclose(f, problem.values(p, problem.cells), rtol=1e-15)
    assert chi2 == pytest.approx(np.sum(r**2 * problem.inverse_variance), rel=1e-12)
    assert problem.chi2(p) == pytest.approx(chi2, rel=1e-12)
    np.testing.assert_allclose(g, problem.weighted(jac).T @ r, rtol=1e-9)
    np.testing.assert_allclose(h, problem.weighted(jac).T @ jac, rtol=1e-9)
    np.testing.assert_allclose(problem.variance(f) * problem.inverse_variance, 1.0, rtol=1e-12)
    some = np.array([3, 50, 51, 110])
    np.testing.assert_allclose(problem.at(some).values(p), f[some], rtol=1e-15)
    # Half of a part's share are its brightest samples; they may be among the others.
    assert 45 <= problem.subset(60).n <= 60
    assert [where.stop for _, where, _ in problem.pieces()] == [40, 80, 120]


def test_a_parts_own_parameter_is_followed_in_the_part_alone():
    """Its limit is that of the whole problem, the other parts to second order."""
    samples = spectrum(rho_s=(0.002, 0.1, 0.1), n=80)
    problem = joint_problem(samples)
    optimum = minimise(problem, problem.vector({}), search=False)
    j = [q.name for q in problem.parameters].index("rho_s[450 nm]")
    limit = profile_limit(Minimum.of(problem, optimum), j, 3.84, side=1)

    def growth(value):
        p = np.where(np.arange(7) == j, value, optimum.p)
        held = minimise(pinned_at(problem, j, value), p, search=False)
        return held.chi2 - optimum.chi2

    # The limit is found to a thousandth of the distance.
    assert growth(limit) == pytest.approx(3.84, rel=0.01)


def test_starting_values_are_for_all_parts_or_for_one():
    problem = joint_problem(spectrum(n=20))
    names = [q.name for q in problem.parameters]
    p = problem.vector({"rho_d": 0.4, "rho_d[650 nm]": 0.5})
    assert p[names.index("rho_d[450 nm]")] == 0.4
    assert p[names.index("rho_d[650 nm]")] == 0.5
    with pytest.raises(ConfigurationError, match=r"unknown parameter 'rho_D' of ward_isotropic"):
        problem.vector({"rho_D": 0.4})


def test_channels_are_named_by_what_tells_them_apart():
    theta = np.full(4, 0.1)
    where = Directions(theta, 0.0, theta, 0.0)

    def labels(**columns):
        return [c.label for c in split(BRDFSamples(where, theta, **columns))]

    blue = np.array(["red", "blue", "red", "blue"])
    nm = np.array([620.0, 450.0, 620.0, 450.0])
    assert labels(channel=blue) == ["red", "blue"]
    assert labels(channel=blue, wavelength_nm=nm) == ["blue", "red"]
    assert labels(wavelength_nm=nm) == ["450 nm", "620 nm"]
    assert labels(channel=np.full(4, "x"), wavelength_nm=nm) == ["450 nm", "620 nm"]
    each = np.array([450.0, 450.0, 620.0, 620.0])
    assert labels(channel=blue, wavelength_nm=each) == [
        "red, 450 nm", "blue, 450 nm", "red, 620 nm", "blue, 620 nm",
    ]  # fmt: skip
    two = [BRDFSamples(where, theta, metadata={"sample": "paint"})] * 2
    assert [c.label for c in split(two)] == ["paint", "paint (2)"]
    assert isinstance(split(two)[0], Channel)


# ---------------------------------------------------------------------- the result, and mistakes


def test_the_result_comes_back_from_its_document(tmp_path):
    result = gonio.fit(spectrum(), model="ward_isotropic", share=("alpha",), seed=4)
    path = tmp_path / "fit.json"
    result.save(path)
    again = FitResult.load(path)
    assert (again.parts, again.sharing) == (result.parts, result.sharing)
    assert again.to_json() == result.to_json()
    assert json.loads(path.read_text(encoding="utf-8"))["sharing"]["parameters"] == ["alpha"]


def test_a_part_is_a_fit_of_one_brdf():
    result = gonio.fit(spectrum(), model="ward_isotropic", share=("alpha",))
    part = result.part("650 nm")
    assert list(part.parameters) == ["rho_d", "rho_s", "alpha"]
    assert part.parameters["rho_d"] == result.parameters["rho_d[650 nm]"]
    assert part.cuts["select"] == {"wavelength": "650"}
    assert (part.n_samples, part.parts, part.sharing) == (150, (), None)
    u = part.parameters["alpha"].stderr
    assert part.covariance[2][2] == pytest.approx(u**2)
    assert sum(p.chi2 for p in result.parts) == pytest.approx(result.chi2)
    with pytest.raises(ConfigurationError, match=r"unknown part '65 nm' of the fit: did you mean"):
        result.part("65 nm")


def test_an_unknown_name_is_reported_with_the_nearest():
    with pytest.raises(ConfigurationError, match=r"unknown parameter 'alpah' of ward_isotropic: "
                       r"did you mean 'alpha'\?"):  # fmt: skip
        gonio.fit(spectrum(n=20), model="ward_isotropic", share=("alpah",))


def test_one_channel_has_nothing_to_share():
    with pytest.raises(ConfigurationError, match=r"^the samples are of one channel: there "
                       r"is nothing to share; leave 'share' out, or give"):  # fmt: skip
        gonio.fit(spectrum(nm=NM[:1]), model="ward_isotropic", share=("alpha",))


def test_several_materials_need_to_share():
    with pytest.raises(ConfigurationError, match=r"^several samples are fitted together with "
                       r"'share', the names of the parameters that they have"):  # fmt: skip
        gonio.fit([spectrum(), spectrum()], model="ward_isotropic")


def test_uncertainties_in_some_channels_only_are_refused():
    one, two = flat([0.1]), flat([0.1])
    two = BRDFSamples(two.directions, two.value)
    with pytest.raises(ConfigurationError, match=r"^b has no uncertainties and a has; give u_brdf "
                       r"for all, or name the weights: none, relative, cos or "
                       r"coscos\.$"):  # fmt: skip
        gonio.fit({"a": one, "b": two}, model="lambert", share=("rho",))
    assert gonio.fit({"a": one, "b": two}, model="lambert", share=("rho",), weights="cos").ok


def test_a_channel_of_too_few_samples_is_named():
    samples = spectrum(n=20)
    keep = (samples.wavelength_nm != 550) | (np.arange(60) < 23)
    with pytest.raises(DataError, match=r"^550 nm: 3 samples cannot determine the 3 parameters"):
        gonio.fit(samples.select(keep, "few"), model="ward_isotropic", share=("alpha",))
