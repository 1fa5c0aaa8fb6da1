"""Every model keeps what it claims, and every model's errors say what to do."""

import math

import numpy as np
import pytest

from gonio import models
from gonio.checks import directional_albedo
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import Directions, rotated, unit_vectors
from gonio.models.base import Claims, Model, Parameter

NAMES = models.names()
every_model = pytest.mark.parametrize("name", NAMES)


def start_range(parameter: Parameter) -> tuple[float, float]:
    return parameter.start or (parameter.lower, parameter.upper)


def random_parameters(model: Model, rng: np.random.Generator) -> np.ndarray:
    """A parameter vector strictly inside the range in which a fit searches."""
    values = []
    for parameter in model.parameters:
        low, high = start_range(parameter)
        t = rng.uniform(0.05, 0.95)
        if parameter.scale == "log":
            values.append(low * (high / low) ** t)
        else:
            values.append(low + (high - low) * t)
    return np.array(values)


def random_pairs(rng: np.random.Generator, n: int, theta_max: float = 1.55) -> tuple:
    theta, phi = rng.uniform(0, theta_max, (2, n)), rng.uniform(0, 2 * np.pi, (2, n))
    return unit_vectors(theta[0], phi[0]), unit_vectors(theta[1], phi[1])


def corners(model: Model) -> list[np.ndarray]:
    """Defaults, and all parameters at either end of their range."""
    p = model.parameters
    return [np.array([getattr(x, end) for x in p]) for end in ("default", "lower", "upper")]


@every_model
def test_f_and_its_derivatives_are_numbers_along_the_normal(name):
    # Loops put the normal where a direction is below the horizon, with weight 0.
    model = models.get(name)
    normal = np.array([[0.0, 0.0, 1.0]])
    f, jac = model.gradient(normal, normal, np.array([q.default for q in model.parameters]))
    assert np.isfinite(f).all()
    assert np.isfinite(jac).all()


@every_model
def test_swapping_light_and_viewer_changes_nothing(name):
    model, rng = models.get(name), np.random.default_rng(1)
    if not model.claims.reciprocal:
        pytest.skip("not claimed")
    w_i, w_r = random_pairs(rng, 2000)
    for p in [model.vector({}), *(random_parameters(model, rng) for _ in range(4))]:
        f, swapped = model.evaluate(w_i, w_r, p), model.evaluate(w_r, w_i, p)
        np.testing.assert_allclose(f, swapped, rtol=1e-12, atol=1e-300)


@every_model
def test_values_are_finite_and_non_negative_where_claimed(name):
    model, rng = models.get(name), np.random.default_rng(2)
    w_i, w_r = random_pairs(rng, 2000, theta_max=np.pi / 2 - 1e-6)
    for p in [*corners(model), *(random_parameters(model, rng) for _ in range(4))]:
        f = model.evaluate(w_i, w_r, p)
        assert np.all(np.isfinite(f))
        if model.claims.non_negative:
            assert f.min() >= 0


@every_model
def test_turning_the_sample_matters_exactly_where_claimed(name):
    model, rng = models.get(name), np.random.default_rng(3)
    w_i, w_r = random_pairs(rng, 500)
    p = random_parameters(model, rng)
    f = model.evaluate(w_i, w_r, p)
    turned = model.evaluate(rotated(w_i, 0.7), rotated(w_r, 0.7), p)
    if model.claims.isotropic:
        np.testing.assert_allclose(f, turned, rtol=1e-9, atol=1e-13 * f.max())
    else:
        assert np.max(np.abs(f - turned)) > 1e-3 * np.max(np.abs(f))


def at_seam(model: Model, seam: tuple, step: tuple, p: np.ndarray) -> float:
    """f beside a seam; a polar angle stepped below 0 comes up on the other side of the normal."""
    w = []
    for k in (0, 2):
        w.append(unit_vectors(seam[k] + step[k], seam[k + 1] + step[k + 1]))
    return float(model.evaluate(w[0], w[1], p))


@every_model
def test_f_is_continuous_across_its_seams(name):
    model, rng = models.get(name), np.random.default_rng(4)
    steps = [sign * step for step in 1e-7 * np.eye(4) for sign in (-1, 1)]
    for p in [model.vector({}), *(random_parameters(model, rng) for _ in range(3))]:
        for seam in model.claims.seams:
            on = at_seam(model, seam, (0, 0, 0, 0), p)
            for step in steps:
                assert at_seam(model, seam, step, p) == pytest.approx(on, rel=1e-4)


@pytest.mark.parametrize(
    "name", [name for name in NAMES if models.get(name).claims.lambert_limit is not None]
)
def test_the_lambert_limit_is_exact(name):
    model, rng = models.get(name), np.random.default_rng(5)
    albedo = "rho" if "rho" in model.names else "rho_d"
    p = model.vector({**model.claims.lambert_limit, albedo: 0.37})
    f = model.evaluate(*random_pairs(rng, 500), p)
    np.testing.assert_allclose(f, 0.37 / np.pi, rtol=1e-15)


@every_model
def test_scalar_array_and_broadcast_agree(name):
    model = models.get(name)
    theta_i, theta_r = np.array([[0.0], [0.4], [1.1]]), np.linspace(0.0, 1.5, 7)
    grid = model(Directions(theta_i, 0.2, theta_r, 2.9))
    assert grid.shape == (3, 7)
    row = model(Directions(0.4, 0.2, theta_r, 2.9))
    np.testing.assert_array_equal(grid[1], row)
    one = model(Directions(0.4, 0.2, theta_r[3], 2.9))
    assert one.shape == ()
    assert float(one) == row[3]


@every_model
def test_compiled_code_equals_its_plain_python_twin(name):
    model, rng = models.get(name), np.random.default_rng(6)
    w_i, w_r = random_pairs(rng, 300)
    for p in [*corners(model), random_parameters(model, rng)]:
        f, gradient = model.gradient(w_i, w_r, p)
        plain = np.array([model.plain(i, r, p) for i, r in zip(w_i, w_r, strict=True)])
        np.testing.assert_allclose(f, plain[:, 0], rtol=1e-13, atol=1e-300)
        np.testing.assert_allclose(gradient, plain[:, 1:], rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(model.evaluate(w_i, w_r, p), f)


@every_model
def test_derivatives_equal_central_differences(name):
    model, rng = models.get(name), np.random.default_rng(7)
    w_i, w_r = random_pairs(rng, 60, theta_max=1.4)
    for _ in range(4):
        p = random_parameters(model, rng)
        for i, r in zip(w_i, w_r, strict=True):
            exact = model.plain(i, r, p)
            for j in range(len(p)):
                # Richardson: two central differences leave an error of step^4.
                central = []
                for step in (1e-3 * p[j], 5e-4 * p[j]):
                    up, down = p.copy(), p.copy()
                    up[j] += step
                    down[j] -= step
                    difference = model.plain(i, r, up)[0] - model.plain(i, r, down)[0]
                    central.append(difference / (2 * step))
                best = (4 * central[1] - central[0]) / 3
                noise = 1e-11 * abs(exact[0]) / p[j]
                assert exact[j + 1] == pytest.approx(best, rel=1e-7, abs=noise + 1e-12)


def bend(model: Model, moved: set[int], rng: np.random.Generator) -> float:
    """How far f is from affine in the parameters `moved`, all at once, as a share of f."""
    w_i, w_r = random_pairs(rng, 200, theta_max=1.2)
    ends = [random_parameters(model, rng) for _ in range(2)]
    for j in set(range(len(model.parameters))) - moved:
        ends[1][j] = ends[0][j]
    f = [model.evaluate(w_i, w_r, p) for p in (ends[0], (ends[0] + ends[1]) / 2, ends[1])]
    return float(np.max(np.abs(f[0] - 2 * f[1] + f[2])) / np.max(np.abs(f)))


@every_model
def test_f_is_linear_in_all_parameters_called_linear_together_and_in_no_more(name):
    model, rng = models.get(name), np.random.default_rng(8)
    linear = {j for j, parameter in enumerate(model.parameters) if parameter.linear}
    for _ in range(4):
        assert bend(model, linear, rng) < 1e-13
    for j in set(range(len(model.parameters))) - linear:
        assert max(bend(model, linear | {j}, rng) for _ in range(4)) > 1e-6


@every_model
def test_no_incidence_and_no_parameters_pass_the_albedo_that_is_claimed(name):
    model, rng = models.get(name), np.random.default_rng(10)
    if model.claims.albedo_at_most is None:
        pytest.skip("not claimed")
    assert set(model.claims.albedo_at_most) <= set(model.names)
    some = random_parameters(model, rng)
    # All that scales f, or a part of it, at its largest.
    full = [
        1.0 if (p.lower, p.upper) == (0, 1) else x
        for p, x in zip(model.parameters, some, strict=True)
    ]
    for values in (some.tolist(), full):
        given = dict(zip(model.names, values, strict=True))
        bound = model.claims.albedo_bound(given)
        for theta in (0.0, 60.0, 85.0, 89.0) if not model.costly else (60.0, 89.0):
            phi = float(rng.uniform(0, 2 * np.pi))
            albedo = directional_albedo(model, given, math.radians(theta), phi, rtol=1e-3)
            assert albedo.value - albedo.error <= bound + 1e-12


# Why nothing is claimed: theta_i in degrees and parameters whose albedo exceeds all amplitudes.
WITHOUT_BOUND = {
    "ward": (89.9, {"rho_d": 0, "rho_s": 1, "alpha_x": 0.4, "alpha_y": 0.4}),
    "ward_isotropic": (89.9, {"rho_d": 0, "rho_s": 1, "alpha": 0.4}),
    "ward_approx": (89.9, {"rho_d": 0, "rho_s": 1, "alpha_x": 0.4, "alpha_y": 0.4}),
    "ward_duer": (85, {"rho_d": 0, "rho_s": 1, "alpha_x": 0.2, "alpha_y": 0.2}),
    "minnaert": (60, {"rho": 1, "k": 0.7}),
    "oren_nayar": (75, {"rho": 1, "sigma": 0.1}),
    "oren_nayar_qualitative": (80, {"rho": 1, "sigma": 0.1}),
    "oren_nayar_torrance_sparrow": (75, {"rho": 1, "sigma": 0.1, "ks_over_kb": 0}),
    "abg": (0, {"A": 0.1, "B": 1e-4, "g": 2}),
}


@pytest.mark.parametrize("name", WITHOUT_BOUND)
def test_no_bound_is_claimed_where_there_is_none(name):
    theta, given = WITHOUT_BOUND[name]
    assert models.get(name).claims.albedo_at_most is None
    albedo = directional_albedo(models.get(name), given, math.radians(theta), rtol=1e-3)
    assert albedo.value - albedo.error > 1


def test_a_bound_is_a_sum_of_parameters_or_1_or_none():
    given = {"rho_d": 0.25, "rho_s": 0.5}
    assert Claims(albedo_at_most=("rho_d", "rho_s")).albedo_bound(given) == 0.75
    assert Claims(albedo_at_most=()).albedo_bound(given) == 1
    assert Claims().albedo_bound(given) is None


@every_model
def test_f_is_zero_below_the_horizon(name):
    model = models.get(name)
    below = Directions([1.6, 0.3, 2.5], 0.0, [0.3, 1.6, 2.5], np.pi)
    assert model(below).tolist() == [0, 0, 0]
    w_i, w_r = below.vectors()
    f, gradient = model.gradient(w_i, w_r, model.vector({}))
    assert not f.any()
    assert not gradient.any()
    assert not any(model.plain(w_i[0], w_r[0], model.vector({})))


@every_model
def test_f_is_zero_exactly_at_the_horizon(name):
    horizon = np.pi / 2
    at = Directions([horizon, 0.3, horizon, horizon], 0.0, [0.3, horizon, horizon, 0.0], np.pi)
    assert models.get(name)(at).tolist() == [0, 0, 0, 0]


@every_model
def test_f_is_no_nan_at_the_horizon(name):
    horizon = np.pi / 2
    for theta_i, theta_r in ((horizon, 0.3), (0.3, horizon), (horizon, 0.0), (horizon, horizon)):
        at = Directions(theta_i, 0.0, theta_r, [0.0, 1.0, np.pi / 2, np.pi])
        assert not np.any(np.isnan(models.get(name)(at)))


@every_model
def test_one_thread_and_two_give_the_same_bits(name):
    model, rng = models.get(name), np.random.default_rng(9)
    # More than one block of pairs, or a second thread would have nothing to do.
    w_i, w_r = random_pairs(rng, 2_000 if model.costly else 140_000)
    p = random_parameters(model, rng)
    one, two = (model.gradient(w_i, w_r, p, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])


@every_model
def test_the_record_is_complete(name):
    model = models.get(name)
    assert model.name == name
    assert model.title
    assert any(mark in model.reference for mark in ("19", "20", "17"))
    assert model.validity.endswith(".")
    assert len(set(model.names)) == len(model.names)
    description = model.describe()
    assert "f =" in description["documentation"]
    for p in model.parameters:
        assert p.symbol
        assert p.meaning
        low, high = start_range(p)
        assert p.lower <= low < high <= p.upper
        assert p.lower <= p.default <= p.upper
        if p.scale == "log":
            assert low > 0
    assert isinstance(model.claims, Claims)


@every_model
def test_a_wrong_parameter_name_is_answered_with_the_nearest(name):
    model = models.get(name)
    wanted = model.names[0]
    nearest = f"unknown parameter '{wanted}x' of {name}: did you mean '{wanted}'. "
    match = nearest + ("The only one is" if len(model.names) == 1 else "Choose from")
    with pytest.raises(ConfigurationError, match=match):
        model(Directions(0, 0, 0, 0), **{wanted + "x": 0.1})


@every_model
def test_values_out_of_range_are_refused_with_name_value_and_range(name):
    model = models.get(name)
    for p in model.parameters:
        for value in (p.upper * 1.5 + 1, p.lower - 1, math.nan, math.inf):
            match = rf"{p.name} = {value:.6g}.* is out of range; allowed is {p.lower:.6g}.* to "
            with pytest.raises(ConfigurationError, match=match) as caught:
                model(Directions(0, 0, 0, 0), **{p.name: value})
            assert caught.value.exit_code == 2
        with pytest.raises(
            ConfigurationError, match=rf"{p.name} = 'much' is not a number; allowed"
        ):
            model(Directions(0, 0, 0, 0), **{p.name: "much"})


@every_model
def test_the_ends_of_each_range_are_allowed_after_a_round_trip_through_file_units(name):
    for p in models.get(name).parameters:
        for value in (p.lower, p.upper, p.default):
            assert p.check(p.from_file(p.to_file(value))) == pytest.approx(value, rel=1e-14)


def test_an_angle_parameter_in_degrees_is_refused_with_both_units():
    match = r"sigma = 20 rad \(1145.92 deg\) is out of range; allowed is 0 rad \(0 deg\) to 1.0472"
    with pytest.raises(ConfigurationError, match=match):
        models.get("oren_nayar")(Directions(0, 0, 0, 0), sigma=20)


def test_an_unknown_model_is_answered_with_the_nearest():
    with pytest.raises(ConfigurationError, match="unknown model 'oren_nayer': did you mean 'oren_"):
        models.get("oren_nayer")


def test_all_models_of_the_two_papers_are_found():
    assert {
        "lambert",
        "ward",
        "ward_isotropic",
        "ward_approx",
        "oren_nayar",
        "oren_nayar_qualitative",
        "torrance_sparrow",
        "oren_nayar_torrance_sparrow",
    } <= set(NAMES)
    assert sorted(NAMES) == NAMES


def test_a_direction_that_is_no_number_is_refused():
    with pytest.raises(DataError, match="theta_r holds a value that is not finite; remove it"):
        Directions(0.1, 0.0, [0.2, math.nan], 0.0)


def test_degrees_given_for_radians_are_refused():
    with pytest.raises(DataError, match=r"theta_i = 45 is outside \[0, pi\]; polar angles are rad"):
        Directions(45, 0, 30, 180)
