"""Many small fits in one call: the same answers as `fit` gives one by one, and no false ones."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.texels import BLOCK, STATUS, fit_texels
from gonio.fitting.uncertainty.covariance import evaluate
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

N = 120
WARD = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.1, "alpha_y": 0.2}
SURFACES = {
    "ward": (WARD, {"rho_d": 0.4, "rho_s": 0.05, "alpha_x": 0.25, "alpha_y": 0.08}),
    "oren_nayar_torrance_sparrow": (
        {"rho": 0.7, "sigma": 0.4, "ks_over_kb": 0.1},
        {"rho": 0.3, "sigma": 0.15, "ks_over_kb": 0.3},
    ),
    "lambert": ({"rho": 0.2}, {"rho": 0.9}),
}


@pytest.fixture(scope="module")
def seen():
    """Four incidences, each seen about the mirror direction and further away."""
    rng = np.random.default_rng(2)
    theta_i, phi_i = (np.repeat(a, N // 4) for a in ([0.1, 0.5, 0.9, 1.1], rng.uniform(-3, 3, 4)))
    theta_r = np.clip(np.abs(theta_i + rng.normal(0, 0.3, N)), 0, 1.4)
    return Directions(theta_i, phi_i, theta_r, phi_i + np.pi + rng.normal(0, 0.4, N))


def stack(model, surfaces, seen, noise=0.02, seed=0):
    """Values (T, N) of some surfaces with noise, and its size for each sample."""
    f = np.stack([models.get(model)(seen, **p) for p in surfaces])
    u = noise * f.mean(axis=0)
    return f + u * np.random.default_rng(seed).standard_normal(f.shape), u


@pytest.mark.parametrize("model", SURFACES)
@pytest.mark.parametrize("known", [True, False])
def test_every_texel_is_fitted_as_fit_does_it(model, known, seen):
    values, u = stack(model, SURFACES[model], seen)
    found = fit_texels(seen, values, model, u=u if known else None)
    assert [STATUS[s] for s in found.status] == ["converged"] * len(values)
    for t, value in enumerate(values):
        samples = BRDFSamples(seen, value, u if known else None)
        one = find_minimum(samples, models.get(model), threads=1)
        # A texel counts on its noise; only `fit` looks whether that follows the value.
        stderr = np.sqrt(np.diag(evaluate(one).covariance))
        # Both stop where the next step is a thousandth of the uncertainty or less.
        assert found.chi2[t] == pytest.approx(one.chi2, rel=1e-6)
        assert np.all(np.abs(found.parameters[t] - one.optimum.p) < 2e-3 * stderr)
        np.testing.assert_allclose(found.stderr[t], stderr, rtol=1e-2)


def test_errors_are_as_large_as_stated(seen):
    values, u = stack("ward", [WARD] * 2000, seen, seed=1)
    found = fit_texels(seen, values, "ward", u=u)
    z = (found.parameters - list(WARD.values())) / found.stderr
    # 2000 texels: the standard deviation is known to 1.6 %, the mean to 0.022.
    assert np.abs(z.std(axis=0) - 1).max() < 0.08
    assert np.abs(z.mean(axis=0)).max() < 0.1


def test_threads_and_neighbours_do_not_matter(seen):
    values, u = stack("ward", [WARD] * (2 * BLOCK + 7), seen, seed=2)
    values[5, 3] = np.nan
    one, two = (fit_texels(seen, values, "ward", u=u, threads=n) for n in (1, 2))
    some = fit_texels(seen, values[4:9], "ward", u=u)
    for name in ("parameters", "stderr", "chi2", "status", "at_bound", "determined", "n_samples"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        np.testing.assert_array_equal(getattr(one, name)[4:9], getattr(some, name))


def test_each_texel_may_have_its_own_directions(seen):
    values, u = stack("ward", SURFACES["ward"], seen)
    own = Directions(*(np.stack([a, a]) for a in vars(seen).values()))
    common, each = (fit_texels(d, values, "ward", u=u) for d in (seen, own))
    # The grids of starts differ, and with them the last thousandths of an uncertainty.
    assert np.max(np.abs(common.parameters - each.parameters) / common.stderr) < 2e-3
    # The second texel seen from elsewhere: its values belong to those directions.
    turn = np.array([[0.0], [np.pi / 2]])
    turned = Directions(seen.theta_i, seen.phi_i + turn, seen.theta_r, seen.phi_r + turn)
    found = fit_texels(turned, values, "ward", u=u)
    assert found.parameters[1, 2:] == pytest.approx(common.parameters[1, :1:-1], rel=1e-4)


def test_what_is_masked_or_not_a_number_is_left_out(seen):
    values, u = stack("ward", [WARD] * 4, seen)
    values[1:] = values[0]
    left_out = np.zeros((4, N), bool)
    left_out[1, ::3] = True
    values[1, ::3] = 1e9  # masked, whatever it is
    values[2, ::3] = np.nan
    each = np.tile(u, (4, 1))
    each[3, ::3] = np.nan
    found = fit_texels(seen, values, "ward", u=each, mask=left_out)
    kept = np.arange(N) % 3 != 0
    fewer = Directions(*(np.asarray(a)[kept] for a in vars(seen).values()))
    reference = fit_texels(fewer, values[:1, kept], "ward", u=u[kept])
    assert found.n_samples.tolist() == [N, 80, 80, 80]
    for t in (1, 2, 3):
        assert found.parameters[t] == pytest.approx(reference.parameters[0], rel=1e-9)
        assert found.chi2[t] == pytest.approx(reference.chi2[0], rel=1e-9)


def test_samples_on_and_below_the_horizon_are_left_out(seen):
    values, u = stack("ward", [WARD] * 2, seen)
    theta_r = np.array(np.broadcast_to(seen.theta_r, (N,)))
    theta_r[::3], theta_r[0] = 1.7, np.pi / 2
    low = Directions(seen.theta_i, seen.phi_i, theta_r, seen.phi_r)
    kept = np.arange(N) % 3 != 0
    fewer = Directions(*(np.broadcast_to(a, (N,))[kept] for a in vars(seen).values()))
    reference = fit_texels(fewer, values[:, kept], "ward", u=u[kept])
    own = Directions(*(np.broadcast_to(a, (2, N)) for a in vars(low).values()))
    for where in (low, own):
        found = fit_texels(where, values, "ward", u=u)
        assert found.n_samples.tolist() == [80, 80]
        assert found.chi2 == pytest.approx(reference.chi2, rel=1e-6)


def test_a_texel_without_data_has_no_numbers(seen):
    values, u = stack("ward", [WARD] * 5, seen)
    values[1] = np.nan
    values[2, 4:] = np.nan  # as many samples as parameters
    values[3] = np.inf
    found = fit_texels(seen, values, "ward", u=u)
    assert [STATUS[s] for s in found.status[1:4]] == ["no_data"] * 3
    assert found.n_samples[1:4].tolist() == [0, 4, 0]
    assert found.count("converged") == 2
    for name in ("parameters", "stderr", "chi2"):
        assert np.isnan(getattr(found, name)[1:4]).all()
        assert np.isfinite(getattr(found, name)[[0, 4]]).all()
    assert not found.determined[1:4].any()


def test_a_surface_without_a_lobe_has_no_width_of_it(seen):
    values, u = stack("ward", [WARD | {"rho_s": 0.0}] * 200, seen, seed=3)
    found = fit_texels(seen, values, "ward", u=u)
    # A lobe that follows one noisy sample has no minimum.
    assert found.count("converged") >= 190
    assert np.isnan(found.stderr[found.status == STATUS.index("not_converged")]).all()
    none = found.at_bound[:, 1] == -1
    assert none.any()  # few: a lobe finds a place and a width where noise is positive
    assert np.isnan(found.stderr[none, 1:]).all()
    assert not found.determined[none, 1:].any()
    # Only where noise alone looks like a lobe to two standard errors may it have a width.
    assert np.mean(found.determined[:, 2:].any(axis=1)) < 0.2
    assert np.isfinite(found.stderr[found.status == 0, 0]).all()


def test_a_value_on_a_bound_is_reported_and_has_no_uncertainty(seen):
    values, u = stack("lambert", [{"rho": 1.0}] * 2, seen, noise=1e-3)
    found = fit_texels(seen, values * [[0.5], [1.1]], "lambert", u=u)
    assert found.at_bound[:, 0].tolist() == [0, 1]
    assert found.parameters[1, 0] == 1.0
    assert np.isnan(found.stderr[1, 0])
    assert found.stderr[0, 0] > 0


def test_narrower_bounds_hold(seen):
    values, u = stack("ward", [WARD], seen)
    model = models.get("ward")
    narrow = tuple(
        replace(q, upper=0.15, start=(0.02, 0.15)) if q.name == "alpha_y" else q
        for q in model.parameters
    )
    found = fit_texels(seen, values, replace(model, parameters=narrow), u=u)
    assert found.parameters[0, 3] == 0.15
    assert found.at_bound[0].tolist() == [0, 0, 0, 1]
    assert found.chi2[0] > fit_texels(seen, values, "ward", u=u).chi2[0]


def test_memory_is_that_of_the_result_and_a_few_blocks(seen):
    values = np.broadcast_to(np.float32(0.1), (20_000, N))  # no memory of its own
    fit_texels(seen, values[:1], "lambert")
    tracemalloc.start()
    found = fit_texels(seen, values, "lambert", threads=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.count("converged") == 20_000
    assert peak < 20_000 * 64 + 20 * BLOCK * N * 8 < values.size * 8 / 2


def test_progress_counts_texels(seen):
    values, _ = stack("lambert", [{"rho": 0.2}] * (BLOCK + 1), seen)
    calls = []
    fit_texels(seen, values, "lambert", progress=lambda done, of: calls.append((done, of)))
    assert sorted(of for _, of in calls) == [BLOCK + 1] * 2
    assert calls[-1] == (BLOCK + 1, BLOCK + 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": np.ones(N)}, r"values are an array of float64 and shape \(120,\); give real "),
        ({"values": np.ones((2, N), complex)}, "values are an array of complex128 and shape"),
        ({"values": np.ones((2, 7))}, r"directions of shape \(120,\) do not belong to values of "),
        ({"mask": np.ones(N)}, r"mask is an array of float64 and shape \(120,\); give booleans of"),
        ({"mask": np.ones(3, bool)}, r"give booleans of shape \(120,\) or \(2, 120\), True for"),
        ({"u": np.ones(3)}, r"u has shape \(3,\); give a number or shape \(120,\), \(2, 1\) or "),
        ({"u": 0.0}, "u must be positive; give NaN for a sample to leave out."),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change, message, seen):
    given = {"values": np.ones((2, N))} | change
    with pytest.raises(DataError, match=message):
        fit_texels(seen, given.pop("values"), "lambert", **given)


def test_too_few_samples_are_refused():
    seen = Directions(0.3, 0.0, np.linspace(0, 1, 4), 0.0)
    with pytest.raises(
        DataError,
        match="4 samples a texel cannot determine the 4 parameters of ward; give at least 5",
    ):
        fit_texels(seen, np.ones((2, 4)), "ward")


# ---------------------------------------------------------------------- fixed and tied parameters


CONSTRAINTS = [
    {"tied": {"alpha_y": "alpha_x"}},
    {"tied": {"alpha_x": "alpha_y"}, "fixed": {"rho_d": 0.21}},
    {"fixed": {"alpha_y": 0.1}},
    {"fixed": {"rho_d": 0.2, "alpha_x": 0.12, "alpha_y": 0.12}},
]
ROUND = [WARD | {"alpha_x": a, "alpha_y": a} for a in (0.12, 0.2)]


@pytest.mark.parametrize("constraints", CONSTRAINTS)
def test_constraints_are_those_of_fit(constraints, seen):
    # So little noise that both searches stop much nearer the minimum than 1e-8.
    values, u = stack("ward", ROUND, seen, noise=1e-6)
    if "fixed" in constraints:
        fixed = constraints["fixed"]
        values, u = stack("ward", [p | fixed for p in ROUND], seen, noise=1e-6)
    found = fit_texels(seen, values, "ward", u=u, **constraints)
    assert found.names == models.get("ward").names
    assert found.count("converged") == len(values)
    for t, value in enumerate(values):
        one = gonio.fit(BRDFSamples(seen, value, u), model="ward", threads=1, **constraints)
        assert found.chi2[t] == pytest.approx(one.chi2, rel=1e-6)
        for j, (name, estimate) in enumerate(one.parameters.items()):
            assert found.parameters[t, j] == pytest.approx(estimate.value, rel=1e-8), name
            if estimate.fixed:
                assert np.isnan(found.stderr[t, j])
                assert not found.determined[t, j]
                assert found.at_bound[t, j] == 0
            else:
                assert found.stderr[t, j] == pytest.approx(estimate.stderr, rel=1e-4)


@pytest.mark.parametrize("known", [True, False])
def test_an_elliptical_lobe_with_tied_widths_is_the_isotropic_one(known, seen):
    values, u = stack("ward", ROUND, seen)
    u = u if known else None
    tied = fit_texels(seen, values, "ward", u=u, tied={"alpha_y": "alpha_x"})
    isotropic = fit_texels(seen, values, "ward_isotropic", u=u)
    columns = [0, 1, 2, 2]
    for name in ("parameters", "stderr"):
        np.testing.assert_allclose(
            getattr(tied, name), getattr(isotropic, name)[:, columns], rtol=1e-8
        )
    np.testing.assert_allclose(tied.chi2, isotropic.chi2, rtol=1e-10)


def test_constraints_hold_for_a_model_of_arrays(seen):
    def minnaert(directions, rho, k):
        cosines = np.cos(directions.theta_i) * np.cos(directions.theta_r)
        return rho * (k + 1) / (2 * np.pi) * cosines ** (k - 1)

    model = models.Model.from_function(minnaert, {"rho": (0.5, 0, 1), "k": (1, 0, 2)})
    values, u = stack("minnaert", [{"rho": 0.3, "k": 0.9}] * 2, seen, noise=1e-3)
    own, ours = (
        fit_texels(seen, values, m, u=u, fixed={"k": 0.9}) for m in (model, "minnaert")
    )  # fmt: skip
    np.testing.assert_allclose(own.parameters, ours.parameters, rtol=1e-5)
    assert (own.parameters[:, 1] == 0.9).all()


def test_a_texel_without_data_has_no_fixed_value(seen):
    held = CONSTRAINTS[-1]["fixed"]  # compiled already
    values, u = stack("ward", [p | held for p in ROUND], seen)
    values[1, 1:] = np.nan  # as many samples as unknowns
    found = fit_texels(seen, values, "ward", u=u, fixed=held)
    assert [STATUS[s] for s in found.status] == ["converged", "no_data"]
    assert np.isnan(found.parameters[1]).all()
    assert found.parameters[0, [0, 2, 3]].tolist() == list(held.values())


@pytest.mark.parametrize(
    ("constraints", "text"),
    [
        ({"fixed": {"alpha": 0.1}},
         "unknown fixed parameter 'alpha' of ward: did you mean 'alpha_y'?"),
        ({"fixed": {"alpha_y": 99}}, "alpha_y = 99 is out of range; allowed is 0.005 to 2."),
        ({"fixed": {"alpha_y": 0.1}, "tied": {"alpha_y": "alpha_x"}},
         "alpha_y is fixed and tied at once; leave one of the two out."),
        ({"fixed": dict(WARD)}, "all parameters of ward are fixed or tied to fixed ones: nothing "
         "is left to fit; leave one of them free."),
    ],
)  # fmt: skip
def test_bad_constraints_are_refused(constraints, text, seen):
    with pytest.raises(ConfigurationError) as error:
        fit_texels(seen, np.ones((2, N)), "ward", **constraints)
    assert text in str(error.value)


def test_fewer_parameters_need_fewer_samples():
    few = Directions(0.3, 0.0, np.linspace(0, 1, 3), 0.0)
    with pytest.raises(
        DataError,
        match="3 samples a texel cannot determine the 3 free parameters of ward; give at least 4",
    ):
        fit_texels(few, np.ones((2, 3)), "ward", tied={"alpha_y": "alpha_x"})
