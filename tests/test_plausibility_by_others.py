"""Faults of files that others wrote: each is named, and right files that resemble them pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plausible_files import codes, glossy, hemisphere, noisy, only, plane, turned, values

from gonio.checks import plausible
from gonio.geometry import Directions
from gonio.models import get
from gonio.samples import BRDFSamples

GLOSSY = {"rho_d": 0.2, "rho_s": 0.2, "alpha_x": 0.2, "alpha_y": 0.2}
ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
PLANS = {"hemisphere": hemisphere((10.0, 25.0, 45.0, 60.0)), "plane": plane()}
both_plans = pytest.mark.parametrize("d", PLANS.values(), ids=PLANS)


def lobed(d: Directions, noise=0.02, **options) -> BRDFSamples:
    return noisy(d, values(d, **GLOSSY), noise, stated=True, **options)


def around_the_mirror_direction(n: int, seed: int) -> Directions:
    """Viewing directions anywhere about the mirror direction of any incidence."""
    rng = np.random.default_rng(seed)
    theta_i = rng.uniform(5, 70, n)
    theta_r = np.clip(theta_i + rng.normal(0, 12, n), 0, 85)
    return Directions(*np.radians([theta_i, 0 * theta_i, theta_r, 180 + rng.normal(0, 20, n)]))


def scaled(d: Directions, factor: float, *names: str) -> dict[str, np.ndarray]:
    """Angles times a factor, as they are written with two digits."""
    return {n: np.radians(np.round(np.degrees(getattr(d, n)) * factor, 4)) for n in names or ANGLES}


def rounded(f: np.ndarray, digits: int) -> np.ndarray:
    return np.array([float(f"{v:.{digits}g}") for v in f])


# ---------------------------------------------------------------- copied readings


def copied(where: str) -> BRDFSamples:
    right = lobed(PLANS["hemisphere"])
    value, n = right.value.copy(), len(right) // 4
    if where == "in part":
        value[2 * n + 10 : 2 * n + 50] = value[n + 10 : n + 50]
    elif where == "at other directions":
        value[2 * n : 3 * n] = np.roll(value[n : 2 * n], 12)
    else:
        value[2 * n : 3 * n] = value[n : 2 * n]
    samples = replace(right, value=value)
    if where == "in shuffled lines":
        samples = samples[np.random.default_rng(1).permutation(len(samples))]
    return samples


@pytest.mark.parametrize(
    "where", ["in order", "in part", "at other directions", "in shuffled lines"]
)
def test_a_copied_block_is_named_wherever_it_stands(where):
    text = only(copied(where), "copied_block", "warning")
    count = "40 of the readings" if where == "in part" else "the 84 readings"
    assert text.startswith(f"{count} at theta_i 25 and 45 deg are the same to all digits")


def test_a_block_copied_to_a_turned_sample_is_named_where_readings_have_noise():
    d = hemisphere((40.0,), turns=(0.0, 45.0, 90.0))
    right = lobed(d)
    value, n = right.value.copy(), len(right) // 3
    value[n : 2 * n] = value[:n]
    text = only(replace(right, value=value), "copied_block", "warning")
    assert "at theta_i 40 deg, phi_i 0 and 45 deg are the same to all digits" in text


@pytest.mark.parametrize("digits", [3, 4, 6, 16])
@pytest.mark.parametrize("turns", [(0.0,), (0.0, 90.0, 180.0)])
def test_a_symmetric_formula_is_no_copy(digits, turns):
    d = hemisphere((20.0, 40.0, 60.0), turns=turns)
    f = values(d, **GLOSSY)
    assert "copied_block" not in codes(BRDFSamples(d, rounded(f, digits)))


@pytest.mark.parametrize("digits", [2, 3])
def test_few_digits_are_no_copy(digits):
    d = hemisphere((10.0, 25.0, 45.0, 60.0))
    white = noisy(d, np.full(len(d.theta_i), 0.3), 0.01)
    assert codes(replace(white, value=rounded(white.value, digits))) == []


# ---------------------------------------------------------------- angles


@both_plans
@pytest.mark.parametrize("name", ["theta_i", "theta_r"])
@pytest.mark.parametrize("alpha", [0.1, 0.3])
def test_an_elevation_of_one_column_is_named(d, name, alpha):
    right = noisy(d, values(d, rho_d=0.2, rho_s=0.2, alpha_x=alpha, alpha_y=alpha))
    found = plausible(turned(right, **{name: np.pi / 2 - getattr(d, name)})).findings
    (text,) = [f.text for f in found if f.code == "one_elevation"]
    assert "the lobe stands at theta_r = 90 deg - theta_i, so one of both angles is an" in text
    assert f"by the shape of the lobe {name}. Theta is counted from the normal: write" in text


@both_plans
def test_gradians_are_named(d):
    text = only(turned(lobed(d), **scaled(d, 1 / 0.9)), "gradians", "warning")
    assert "the angles are in gradians, 400 to a turn. Multiply theta and phi by 0.9." in text
    assert "is in whole degrees once it is multiplied by 0.9" in text


def test_gradians_that_are_round_themselves_show_by_their_turn():
    d = hemisphere((10.0, 30.0, 50.0, 70.0))
    phi = np.tile(np.radians(np.arange(0.0, 400.0, 400 / 12)), len(d.phi_r) // 12)
    text = only(turned(lobed(d), phi_r=phi), "gradians", "warning")
    assert "phi_r reaches 366.67 in steps of 33.33, which close a turn at 400" in text


def test_grids_in_thirds_of_ten_degrees_are_no_gradians():
    grid = np.meshgrid(
        np.linspace(10, 70, 4), np.linspace(0, 80, 25), np.linspace(0, 360, 13), indexing="ij"
    )
    theta_i, theta_r, phi = (np.radians(a.ravel()) for a in grid)
    assert codes(lobed(Directions(theta_i, 0 * theta_i, theta_r, phi))) == []


def test_azimuths_that_pass_a_turn_with_the_sample_turned_are_no_gradians():
    assert codes(lobed(hemisphere(turns=(0.0, 20.0, 70.0)))) == []


@both_plans
def test_azimuths_in_turns_are_named(d):
    text = only(turned(lobed(d), **scaled(d, 1 / 360, "phi_i", "phi_r")), "azimuth_in_turns",
                "warning")  # fmt: skip
    assert text.endswith("deg: they are turns. Multiply phi by 360.")


def test_azimuths_that_are_off_by_less_than_a_degree_are_no_turns():
    d = hemisphere((10.0, 40.0, 60.0))
    few = np.abs(d.phi_r) < 0.1
    off = np.random.default_rng(2).uniform(0, 0.3, np.count_nonzero(few))
    d = Directions(d.theta_i[few], 0.0, d.theta_r[few], np.radians(np.round(off, 2)))
    assert "azimuth_in_turns" not in codes(noisy(d, np.full(len(off), 0.2)))


# ---------------------------------------------------------------- uncertainties


@both_plans
@pytest.mark.parametrize("per_cent", [1.0, 2.0, 5.0])
def test_one_uncertainty_in_per_cent_is_named(d, per_cent):
    samples = replace(lobed(d), u_independent=np.full(len(d.theta_i), per_cent))
    text = only(samples, "u_per_cent", "warning")
    assert text.startswith(f"u_brdf is {per_cent:g} on every line, larger than {len(samples)} of")
    assert "write u_brdf = brdf*u_brdf/100, in sr^-1." in text


def test_uncertainties_in_per_cent_line_by_line_are_named():
    right = lobed(hemisphere())
    u = np.random.default_rng(1).uniform(1, 3, len(right))
    text = only(replace(right, u_independent=u), "u_per_cent", "warning")
    assert "It looks like per cent of the reading" in text


def test_dark_readings_below_their_noise_are_right():
    d = hemisphere()
    f = np.full(len(d.theta_i), 0.002)
    noise = 0.005 * np.random.default_rng(1).standard_normal(len(f))
    assert codes(BRDFSamples(d, f + noise, np.full(len(f), 0.005))) == []


# ---------------------------------------------------------------- values


@both_plans
@pytest.mark.parametrize("log", [np.log10, np.log], ids=["log10", "ln"])
def test_logarithms_are_named(d, log):
    right = lobed(d)
    text = only(replace(right, value=log(right.value), u_independent=None), "logarithm", "warning")
    assert "a BRDF is not negative, and noise does not do so. They look like logarithms" in text
    low, high = right.value.min(), right.value.max()
    assert f"{low:.2g} to {high:.2g} sr^-1" in text
    assert "leaving the negative lines out would be wrong" in text


@pytest.mark.parametrize("noise", [0.01, 0.1])
@pytest.mark.parametrize(
    ("log", "inverse"),
    [(np.log10, "10^brdf"), (np.log, "exp(brdf)"), (lambda f: 10 * np.log10(f), "10^(brdf / 10)")],
    ids=["log10", "ln", "dB"],
)
@pytest.mark.parametrize(
    ("model", "truth"),
    [
        ("oren_nayar", {"rho": 0.5, "sigma": 0.4}),
        ("ward_isotropic", {"rho_d": 0.01, "rho_s": 0.3, "alpha": 0.08}),
    ],
    ids=["diffuse", "glossy"],
)
def test_logarithms_around_the_mirror_direction_are_named(model, truth, log, inverse, noise):
    # Neighbours of a narrow lobe differ by more than a decade: their scatter is not the noise.
    d = around_the_mirror_direction(400, seed=1)
    rng = np.random.default_rng(2)
    f = get(model)(d, **truth) * np.exp(noise * rng.standard_normal(len(d.theta_i)))
    text = only(BRDFSamples(d, log(f)), "logarithm", "warning")
    assert " values are negative, " in text
    assert inverse in text


def test_a_glossy_logarithm_tells_that_its_negative_values_follow_each_other():
    d = around_the_mirror_direction(400, seed=1)
    f = get("ward_isotropic")(d, rho_d=0.01, rho_s=0.3, alpha=0.08)
    text = only(BRDFSamples(d, np.log10(f)), "logarithm", "warning")
    assert "and they follow each other: their rank correlation with the median" in text
    assert "independent noise about 0 does not do so. They look like logarithms: as log10" in text


@pytest.mark.parametrize("bias", [0.0, -0.3, -1.0])
@pytest.mark.parametrize("model", ["diffuse", "glossy"])
def test_noise_about_a_dark_surface_is_no_logarithm(model, bias):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        for d in (around_the_mirror_direction(400, seed), hemisphere()):
            f = get("lambert")(d, rho=0.01)
            if model == "glossy":
                f = get("ward_isotropic")(d, rho_d=0.001, rho_s=0.02, alpha=0.1)
            sd = 3 * float(np.median(f))
            value = f + sd * (rng.standard_normal(len(f)) + bias)
            assert "logarithm" not in codes(BRDFSamples(d, value))


def test_a_smooth_offset_below_zero_is_an_offset():
    d = around_the_mirror_direction(400, seed=1)
    f = get("ward_isotropic")(d, rho_d=0.01, rho_s=0.3, alpha=0.08)
    noise = 1e-5 * np.random.default_rng(2).standard_normal(len(f))
    text = only(BRDFSamples(d, f - 0.02 + noise), "logarithm", "warning")
    assert "An offset that is too large was subtracted" in text


def test_an_offset_below_zero_within_its_noise_is_no_logarithm():
    d = hemisphere()
    noise = 0.001 * np.random.default_rng(3).standard_normal(len(d.theta_i))
    assert codes(BRDFSamples(d, noise - 0.002)) == []


@both_plans
def test_one_value_everywhere_is_named(d):
    samples = BRDFSamples(d, np.full(len(d.theta_i), 0.21))
    text = only(samples, "constant", "warning")
    assert text.startswith(f"all {len(samples)} values are exactly 0.21, at ")
    assert "so these were not measured" in text


@both_plans
def test_a_floor_and_a_ceiling_are_both_named(d):
    right = lobed(d)
    low, high = np.quantile(right.value, [0.1, 0.97])
    found = plausible(replace(right, value=np.clip(right.value, low, high))).findings
    assert [f.code for f in found] == ["floor", "ceiling"]
    assert all("A fit takes each for a measurement." in f.text for f in found)
    assert all("emove these lines" in f.text for f in found)


@both_plans
def test_a_ceiling_of_four_readings_is_named(d):
    right = lobed(d)
    cut = replace(right, value=np.minimum(right.value, np.sort(right.value)[-4]))
    assert only(cut, "ceiling", "warning").startswith(f"4 of {len(cut)} values are exactly")


@pytest.mark.parametrize("digits", [3, 6])
def test_a_flat_peak_is_no_ceiling(digits):
    d = plane((45.0,), 2.0)
    f = values(d, "torrance_sparrow", k_s=0.3, sigma=0.15)
    for seed in range(5):
        right = noisy(d, f, 0.005, seed=seed)
        assert codes(replace(right, value=rounded(right.value, digits))) == []


# ---------------------------------------------------------------- repeats


def takes(d: Directions, factor: float, u=0.014) -> BRDFSamples:
    """Each geometry read twice, with a factor between the takes."""
    twice = Directions(*(np.tile(getattr(d, name), 2) for name in ANGLES))
    f = np.tile(values(d, **GLOSSY), 2) * np.repeat([1.0, factor], len(d.theta_i))
    return noisy(twice, f, u, stated=True)


@both_plans
def test_takes_of_another_scale_are_not_covered_by_u(d):
    text = only(takes(d, 1.06), "repeats_beyond_u", "warning")
    assert "values that differ by 4." in text
    assert "times their u_brdf (typically 1.4%): u_brdf does not cover it" in text
    assert "one factor between the takes, 5." in text or "one factor between the takes, 6." in text
    assert "State that as a scale (--u-scale)" in text


def test_takes_whose_lines_are_shuffled_are_named_too():
    both = takes(PLANS["plane"], 1.06)
    mixed = both[np.random.default_rng(3).permutation(len(both))]
    assert "u_brdf does not cover it" in only(mixed, "repeats_beyond_u", "warning")


@both_plans
def test_takes_within_their_noise_are_right(d):
    for seed_u in (0.005, 0.014, 0.05):
        assert codes(takes(d, 1.0, seed_u)) == []


def test_one_reading_that_is_off_is_not_the_noise_of_all():
    both = takes(PLANS["plane"], 1.0)
    value = both.value.copy()
    value[5] *= 1.3
    assert "repeats_beyond_u" not in codes(replace(both, value=value))


def test_glossy_files_of_the_other_tests_stay_silent():
    for d in (hemisphere(), plane()):
        assert codes(glossy(d, stated=True)) == []
