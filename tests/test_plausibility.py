"""What is implausible in samples is found and named, and what is right passes in silence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plausible_files import GLOSSY, codes, glossy, hemisphere, noisy, only, plane, turned, values

import gonio as package
from gonio import formats
from gonio.checks import UNDECIDED, check_samples, measurements, plausible
from gonio.checks import questions as room
from gonio.checks.questions import LEVELS, all_questions
from gonio.errors import DataError
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

HEADER = "theta_i,phi_i,theta_r,phi_r,brdf"
BRUSHED = {"rho_d": 0.02, "rho_s": 0.6, "alpha_x": 0.5, "alpha_y": 0.03}
MIRROR = {"rho_d": 0.001, "rho_s": 0.8, "alpha_x": 0.01, "alpha_y": 0.01}


def anywhere(n=400) -> Directions:
    rng = np.random.default_rng(5)
    theta_i, theta_r = np.arccos(np.sqrt(rng.uniform(0.05, 1, (2, n))))
    return Directions(theta_i, np.zeros(n), theta_r, rng.uniform(0, 2 * np.pi, n))


def retroreflecting(d: Directions) -> np.ndarray:
    w_i, w_r = d.vectors()
    return 0.2 + 0.3 * np.exp(-((np.arccos(np.clip(np.sum(w_i * w_r, -1), -1, 1)) / 0.15) ** 2))


@pytest.fixture
def put(tmp_path: Path):
    """Write samples, or lines, as a gonio CSV."""

    def write(content, name="data.csv") -> Path:
        path = tmp_path / name
        if isinstance(content, BRDFSamples):
            content.save(path)
        else:
            path.write_text("\n".join([HEADER, *content]) + "\n", encoding="utf-8")
        return path

    return write


# ---------------------------------------------------------------- silence


def dark_scan() -> tuple[Directions, np.ndarray]:
    """Sixty readings of a dark gloss in its plane."""
    d = plane((20.0, 50.0), 150 / 29)
    return d, values(d, rho_d=0.006, rho_s=0.05, alpha_x=0.2, alpha_y=0.2)


MATERIALS = {
    "white": ("lambert", {"rho": 0.98}),
    "dark": ("lambert", {"rho": 0.03}),
    "glossy": ("ward", GLOSSY),
    "mirror": ("ward", MIRROR),
    "brushed": ("ward", BRUSHED),
    "rough": ("oren_nayar", {"rho": 0.7, "sigma": 0.5}),
    "off-specular": ("torrance_sparrow", {"k_s": 0.3, "sigma": 0.25}),
    "microfacets": ("ggx", {}),
    "Fresnel": ("cook_torrance", {}),
}
PLANS = {
    "hemisphere": hemisphere(),
    "turned": hemisphere((20.0, 50.0), turns=(0.0, 45.0, 90.0)),
    "plane": plane(),
    "one scan": plane((45.0,), 2.0),
    "anywhere": anywhere(),
}


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("material", MATERIALS)
def test_a_right_file_passes_in_silence(material, plan):
    d = PLANS[plan]
    name, parameters = MATERIALS[material]
    f = values(d, name, **parameters)
    for noise, stated in ((0.0, False), (0.01, True), (0.05, False), (0.15, True)):
        samples = BRDFSamples(d, f) if noise == 0 else noisy(d, f, noise, stated=stated)
        assert codes(samples) == [], (noise, stated)


@pytest.mark.parametrize("plan", PLANS)
def test_a_retroreflecting_surface_is_not_warned_of(plan):
    d = PLANS[plan]
    assert codes(noisy(d, retroreflecting(d)), "warning", "refuse") == []


def test_noise_around_zero_is_no_fault():
    d = hemisphere()
    dark = 0.001 * np.random.default_rng(2).standard_normal(len(d.theta_i)) + 0.0005
    assert codes(BRDFSamples(d, dark)) == []
    assert check_samples(BRDFSamples(d, dark)).quantity == UNDECIDED


def test_few_samples_are_not_judged():
    d = Directions(np.full(6, 0.8), 0.0, np.array([0.1, 0.3, 0.5, 0.8, 1.0, 1.2]), np.pi)
    assert codes(BRDFSamples(d, [0.1, 0.2, 3.0, 40.0, 2.0, 0.1])) == []
    nothing = BRDFSamples(Directions(*np.zeros((4, 0))), np.zeros(0))
    assert plausible(nothing).findings == ()


def test_real_measurements_are_not_warned_of(real_data):
    for wavelength in ("351", "1064"):
        path = real_data / "nist_ptfe" / "PTFE.data.csv"
        assert codes(formats.read(path, select={"wavelength": wavelength})) == []
    for name, wavelength in (("garnet_red", "650"), ("krylon_blue", "450")):
        path = real_data / "cornell" / f"{name}.brdf"
        samples = formats.read(path, select={"wavelength": wavelength})
        # At 80 deg the published values spike, and two of them are 0.
        samples = samples.limited(max_theta_i=np.radians(65), max_theta_r=np.radians(70))
        assert codes(samples, "warning", "refuse") == []


# ---------------------------------------------------------------- angles


@pytest.mark.parametrize("d", [hemisphere(), plane(), anywhere()], ids=["grid", "plane", "random"])
def test_angles_in_radians_are_refused(d, put):
    written = turned(
        glossy(d),
        **{
            name: np.radians(np.round(getattr(d, name), 4))
            for name in ("theta_i", "phi_i", "theta_r", "phi_r")
        },
    )
    text = only(written, "radians", "refuse")
    assert "theta and phi are in radians. Multiply them by 57.29577951 (180/pi)." in text
    with pytest.raises(DataError, match=r"data\.csv: taken as degrees, theta reaches 1\.\d+ deg"):
        package.fit(package.load(put(written)), model="ward_isotropic")


def test_azimuths_alone_in_radians_are_refused():
    samples = glossy(plane())
    written = turned(samples, phi_r=np.radians(np.round(samples.directions.phi_r, 4)))
    assert "phi are in radians" in only(written, "radians", "refuse")


def test_small_angles_in_degrees_are_no_radians():
    theta = np.radians(np.tile([0.1, 0.2, 0.33, 0.5, 1.0, 1.5], 5))
    d = Directions(np.radians(np.repeat([0.0, 0.5, 1.0, 1.2, 1.4], 6)), 0.0, theta, np.pi)
    assert codes(noisy(d, np.full(30, 0.2))) == []


@pytest.mark.parametrize("d", [hemisphere(), plane()], ids=["grid", "plane"])
def test_elevations_are_named(d):
    right = glossy(d)
    up = turned(right, theta_i=np.pi / 2 - d.theta_i, theta_r=np.pi / 2 - d.theta_r)
    text = only(up, "elevation", "warning")
    assert "theta is an elevation above the surface. Theta is counted from the normal" in text


def test_light_at_the_horizon_is_named():
    d = hemisphere((30.0, 60.0, 90.0))
    text = only(noisy(d, np.full(len(d.theta_i), 0.2)), "light_at_horizon", "warning")
    assert "84 samples are lit at theta_i = 90 deg, where no light falls." in text


def test_an_azimuth_from_the_forward_side_is_named():
    right = glossy()
    text = only(turned(right, phi_r=right.directions.phi_r + np.pi), "azimuth_zero", "warning")
    assert "the azimuth is counted from the forward side. Add 180 deg to phi_r." in text


@pytest.mark.parametrize("turns", [(0.0,), (0.0, 45.0, 90.0)])
def test_a_narrow_lobe_on_the_wrong_side_of_a_hemisphere_is_warned_of(turns):
    """Its samples are too few to tell its shape; a retroreflector is named as well."""
    d = hemisphere(turns=turns)
    right = noisy(d, values(d, **{**GLOSSY, "alpha_x": 0.08, "alpha_y": 0.08}))
    text = only(turned(right, phi_r=d.phi_r + np.pi), "azimuth_zero_possible", "warning")
    assert "A retroreflecting surface does so" in text
    assert "add 180 deg to phi_r" in text


def test_in_one_plane_the_azimuth_may_be_that_of_a_retroreflector():
    right = noisy(plane(), values(plane(), rho_d=0.1, rho_s=0.2, alpha_x=0.1, alpha_y=0.1))
    found = plausible(turned(right, phi_r=right.directions.phi_r + np.pi)).findings
    assert [f.code.removesuffix("_possible") for f in found] == ["azimuth_zero"]
    assert "add 180 deg to phi_r" in found[0].text.replace("Add", "add")


def test_signed_polar_angles_are_read_and_noted(put):
    lines = [f"{-t},0,{r},0,{0.1 + 0.001 * r}" for t in (20, 40) for r in (10, 20, 30)]
    samples = formats.read(put(lines))
    assert np.degrees(samples.directions.theta_i).tolist() == pytest.approx([20] * 3 + [40] * 3)
    assert np.degrees(samples.directions.phi_i).tolist() == pytest.approx([180] * 6)
    text = only(samples, "signed_theta", "note")
    assert text.startswith("theta_i is negative on 6 lines (2, 3, 4, 5, 6 and 1 more); such a")
    assert package.fit(samples, model="lambert").warnings == package.fit(
        replace(samples, metadata={}), model="lambert"
    ).warnings  # fmt: skip


def test_a_side_that_is_stated_twice_is_refused(put):
    lines = [f"30,0,{r},{180 if r < 0 else 0},0.1" for r in (-30, -20, -10, 10, 20)]
    path = put(lines)
    with pytest.raises(DataError, match="sign and azimuth state the side of the normal twice"):
        formats.read(path)


# ---------------------------------------------------------------- unit and quantity


def test_a_reflectance_factor_shows_where_its_albedo_is_above_one():
    d = hemisphere()
    white = noisy(d, np.pi * values(d, "lambert", rho=0.9))
    text = only(white, "albedo", "warning")
    assert "reflect at least 2.38 times the light" in text
    assert "a reflectance factor pi*BRDF would be so (divided by pi: at least 0.76)" in text
    assert codes(noisy(d, np.pi * values(d, "lambert", rho=0.3))) == []


def test_per_cent_show():
    d = hemisphere()
    assert "divided by 100 pi" in only(
        noisy(d, 100 * np.pi * values(d, **GLOSSY)), "albedo", "warning"
    )
    flat = noisy(plane(), 100 * values(plane(), "lambert", rho=0.4))
    assert "with the darkest sample of the plane" in only(flat, "albedo", "warning")


def test_a_peak_that_one_sample_has_alone_is_no_gain_of_light():
    d = hemisphere()
    f = values(d, **MIRROR)
    assert f.max() > 100
    assert codes(noisy(d, f)) == []


@pytest.mark.parametrize("which", ["theta_r", "theta_i"])
def test_a_cosine_is_decided_by_its_power(which):
    d = hemisphere()
    samples = noisy(d, values(d, **GLOSSY) * np.cos(getattr(d, which)))
    report = check_samples(samples)
    assert report.quantity == f"BRDF*cos({which})"
    assert report.power == pytest.approx(1 if which == "theta_r" else -1, abs=0.05)
    (found,) = report.findings
    assert (found.code, found.level) == ("cosine", "warning")
    assert f"Divide them by cos({which})." in found.text
    exchanged = "with the columns of light and viewer exchanged" in found.text
    assert exchanged == (which == "theta_i")


def test_seven_against_fourteen_per_cent_is_decided():
    """Each pair of polar angles has its own error, as in a tape that is not reciprocal itself."""
    d = hemisphere((20.0, 30.0, 40.0, 50.0), 10.0)
    keep = (d.theta_r > 0.3) & (d.theta_r < 0.9)
    d = Directions(*(a[keep] for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)))
    f = values(d, **GLOSSY) * np.cos(d.theta_r)
    rng = np.random.default_rng(4)
    broken = rng.lognormal(0, 0.055, (10, 10))
    shared = broken[np.round(d.theta_i * 5).astype(int), np.round(d.theta_r * 5).astype(int)]
    report = check_samples(BRDFSamples(d, f * shared * rng.lognormal(0, 0.03, f.shape)))
    assert 0.05 < report.candidates["BRDF*cos(theta_r)"] < 0.10
    assert 0.12 < report.candidates["BRDF"] < 0.18
    assert report.quantity == "BRDF*cos(theta_r)"


def test_a_loss_at_grazing_directions_is_no_cosine():
    d = hemisphere()
    samples = noisy(d, values(d, "lambert", rho=0.5) / (1 + 0.03 * np.tan(d.theta_r) ** 2), 0.01)
    report = check_samples(samples)
    assert report.quantity == "BRDF"
    assert "No surface does so" in only(samples, "not_reciprocal", "note")
    assert report.passed


# ---------------------------------------------------------------- values that are no measurements


@pytest.mark.parametrize("code", [-9999.0, -999.0, -1.0, 999.0, 1e30, 9.96921e36])
def test_a_code_for_a_missing_reading_is_left_out(code, put):
    right = glossy(stated=True)
    value = right.value.copy()
    value[[3, 40, 41]] = code
    path = put(replace(right, value=value))
    text = f"3 of {len(value)} values are {code:g}, which stands for a missing or overflown reading"
    found = plausible(formats.read(path))
    assert len(found.samples) == len(value) - 3
    (finding,) = found.findings
    assert finding.text.startswith(f"{text} (lines 5, 42, 43); they were left out.")
    assert (finding.samples, finding.lines, finding.left_out) == ((3, 40, 41), (5, 42, 43), True)
    result = package.fit(formats.read(path), model="ward_isotropic")
    assert result.n_samples == len(value) - 3
    assert any(warning.startswith(text) for warning in result.warnings)
    assert json.loads(result.to_json())["diagnostics"]["plausibility"][0]["lines"] == [5, 42, 43]
    loaded = package.load(path)
    assert loaded.value.max() < 10
    assert loaded.value.min() > 0
    assert "values that are no measurements left out" in loaded.history[-1]
    assert codes(loaded) == ["missing_code"]


@pytest.mark.parametrize("given", [False, True])
def test_a_picture_is_drawn_of_the_samples_that_the_fit_kept(gonio, put, tmp_path, given):
    """Codes that a fit left out do not make its file another one, named or found."""
    right = glossy(stated=True)
    value = right.value.copy()
    value[[3, 20]] = -9999.0
    path, fit = put(replace(right, value=value)), tmp_path / "fit.json"
    assert gonio("fit", path, "--model", "lambert", "-o", fit)[0] in (0, 1)
    samples = ("--samples", path) if given else ()
    drawn = gonio("plot", fit, "--kind", "slices", *samples, "-o", tmp_path / "a.png")
    assert (drawn[0], (tmp_path / "a.png").is_file()) == (0, True)


def test_codes_in_most_lines_refuse_the_file(gonio, put):
    right = glossy()
    path = put(replace(right, value=np.where(np.arange(len(right)) % 3, -9999.0, right.value)))
    code, out, err = gonio("fit", path, "--model", "lambert")
    assert (code, out) == (3, "")
    assert "too few measurements are left. Remove these lines." in " ".join(err.split())
    code, out, _ = gonio("check", path)
    assert code == 1
    assert "REFUSED by a fit (missing_code): " in out


def test_a_value_that_is_no_code_does_not_break_the_json():
    right = glossy(stated=True)
    for odd in (-5000.3, 3e7):
        value = right.value.copy()
        value[7] = odd
        for model in ("ward_isotropic", "lambert"):
            document = package.fit(replace(right, value=value), model=model).to_json()
            assert "NaN" not in document
            assert "Infinity" not in document


def test_zeros_among_bright_values_are_missing():
    right = glossy()
    value = np.where(np.arange(len(right)) % 11 == 4, 0.0, right.value)
    found = plausible(replace(right, value=value))
    assert np.all(found.samples.value > 0)
    (finding,) = found.findings
    assert finding.code == "zero_is_missing"
    assert "they mark missing readings and were left out" in finding.text


def test_zeros_in_bulk_are_named_and_kept():
    d = hemisphere()
    f = values(d, rho_d=0.0, rho_s=0.5, alpha_x=0.15, alpha_y=0.15)
    cut = BRDFSamples(d, np.where(f < 1e-3, 0.0, f))
    count = int(np.count_nonzero(cut.value == 0))
    text = only(cut, "zeros_in_bulk", "warning")
    assert text.startswith(f"{count} of {len(f)} values are exactly 0")
    assert len(measurements(cut).samples) == len(f)


def test_cells_without_a_reading_are_left_out_and_named(put):
    cells = ["0.1", "n/a", "0.102", "NaN", "0.099", "", "0.101", "0.1", "0.098", "0.1", "inf"]
    lines = [f"30,0,{5 * k},0,{cell}" for k, cell in enumerate(cells)]
    samples = formats.read(put(lines))
    assert samples.value.tolist() == [0.1, 0.102, 0.099, 0.101, 0.1, 0.098, 0.1]
    assert samples.line.tolist() == [2, 4, 6, 8, 9, 10, 11]
    text = only(samples, "no_reading", "warning")
    assert text == (
        "4 of 11 lines hold no number as their reading and were left out (lines 3, 5, 7, 12). "
        "Correct or remove them."
    )
    assert text in package.fit(samples, model="lambert").warnings


def test_uncertainties_that_are_not_positive_are_left_out_and_named(put):
    lines = [f"30,0,{5 * k},0,0.1,{u}" for k, u in enumerate([0.01, 0, 0.01, -1, 0.01, 0.01])]
    path = put([])
    path.write_text("\n".join([HEADER + ",u_brdf", *lines]) + "\n", encoding="utf-8")
    samples = formats.read(path)
    assert samples.line.tolist() == [2, 4, 6, 7]
    text = only(samples, "no_uncertainty", "warning")
    assert text.startswith("2 of 6 lines have no positive u_brdf and were left out (lines 3, 5).")


def test_a_slip_in_a_cell_is_still_refused(put):
    path = put(["30,0,0,0,0.1", "30,0,5,0,0.1o", "30,0,10,0,0.1"])
    with pytest.raises(DataError, match=r"line 3, column brdf: '0\.1o' is not a finite number"):
        formats.read(path)


# ---------------------------------------------------------------- readings that are none


def test_a_floor_is_named():
    d = hemisphere()
    right = noisy(d, values(d, rho_d=0.003, rho_s=0.2, alpha_x=0.1, alpha_y=0.1), 0.3)
    cut = replace(right, value=np.maximum(right.value, 1e-3))
    assert "the smallest" in only(cut, "floor", "warning")
    assert "upper limits" in only(cut, "floor", "warning")


def test_a_floor_need_not_be_a_round_number():
    right = noisy(*dark_scan(), 0.1)
    cut = replace(right, value=np.maximum(right.value, np.sort(right.value)[7]))
    text = only(cut, "floor", "warning")
    assert "8 of 60 values are exactly" in text
    assert "upper limits" in text


def test_a_coarse_resolution_is_no_floor():
    d, f = dark_scan()
    right = noisy(d, f, 0.1)
    step = 0.00217
    coarse = replace(right, value=step * np.maximum(np.rint(right.value / step), 1))
    found = [f.text for f in plausible(coarse).findings if f.code == "floor"]
    assert all("all values are multiples of 0.00217 sr^-1: the resolution" in t for t in found)


def test_a_formula_without_noise_repeats_its_diffuse_level_in_silence():
    d = hemisphere()
    f = values(d, rho_d=0.0067, rho_s=0.2, alpha_x=0.1, alpha_y=0.1)
    assert "floor" not in codes(BRDFSamples(d, np.array([float(f"{v:.6g}") for v in f])))


def test_a_saturated_detector_is_named():
    right = glossy()
    cut = replace(right, value=np.minimum(right.value, np.quantile(right.value, 0.95)))
    assert "the detector was saturated" in only(cut, "ceiling", "warning")


def test_a_stuck_reading_is_named():
    right = glossy()
    value = right.value.copy()
    value[40:50] = value[40]
    text = only(replace(right, value=value), "stuck", "warning")
    assert text.startswith(f"10 of {len(value)} values stand in 1 row of equal values")


def test_a_block_that_was_copied_is_named():
    right = glossy(plane())
    value = right.value.copy()
    block = len(value) // 4
    value[2 * block : 3 * block] = value[block : 2 * block]
    text = only(replace(right, value=value), "copied_block", "warning")
    assert "readings at theta_i 30 and 45 deg are the same to all digits" in text


def test_values_that_do_not_depend_on_the_incidence_are_no_copies():
    d = plane()
    assert codes(BRDFSamples(d, 0.2 + 0.1 * np.cos(d.theta_r) ** 2)) == []


def test_a_spike_is_named_and_a_lobe_is_not():
    right = glossy(plane(), stated=True)
    value = right.value.copy()
    value[[4, 70]] *= 5
    text = only(replace(right, value=value), "spikes", "warning")
    assert text.startswith(f"2 of {len(value)} values are 5")
    assert "stray light or a reading error" in text


def test_a_reading_far_above_all_around_it_is_named_out_of_the_plane():
    d = hemisphere()
    right = noisy(d, values(d, **BRUSHED))
    value = right.value.copy()
    k = int(np.argmin(np.abs(d.theta_i - 0.5) + np.abs(d.theta_r - 0.87) + np.abs(d.phi_r - 1.57)))
    value[k] *= 12
    text = only(replace(right, value=value), "isolated", "warning")
    assert text.startswith(f"1 of {len(value)} values is 1")
    assert "phi_r 90" in text


def test_repeats_are_silent_and_pooled_wavelengths_are_not():
    d = plane()
    three = Directions(*(np.tile(a, 3) for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)))
    f = np.tile(values(d, **GLOSSY), 3)
    assert codes(noisy(three, f, 0.05)) == []
    assert codes(noisy(three, f, 0.05, stated=True)) == []
    wavelengths = noisy(three, f * np.repeat([1.0, 1.4, 0.7], len(d.theta_i)))
    text = only(wavelengths, "inconsistent_repeats", "warning")
    assert "Name them in a column channel or wavelength_nm." in text
    named = replace(wavelengths, channel=np.repeat(["red", "green", "blue"], len(d.theta_i)))
    assert codes(named) == []


def test_columns_in_the_wrong_order_are_named():
    right = glossy()
    d = right.directions
    swapped = turned(right, theta_i=np.zeros(len(right)), phi_i=d.theta_i)
    assert "Columns stand in the wrong order" in only(swapped, "azimuth_at_pole", "warning")
    stated = glossy(stated=True)
    exchanged = replace(stated, value=stated.u_independent, u_independent=stated.value)
    assert "u_and_brdf_exchanged" in codes(exchanged, "warning")


@pytest.mark.parametrize(
    ("nm", "level"), [(0.55, "warning"), (5.5e-7, "warning"), (10.6, "note"), (550.0, None)]
)
def test_the_unit_of_wavelengths(nm, level):
    samples = replace(glossy(), wavelength_nm=np.full(len(glossy()), nm))
    found = plausible(samples).findings
    assert [(f.code, f.level) for f in found] == ([("wavelength_unit", level)] if level else [])


def test_channels_called_by_wavelengths_are_noted():
    right = glossy()
    names = np.where(np.arange(len(right)) % 2, "0.45", "0.65")
    assert "in micrometres" in only(replace(right, channel=names), "channel_is_wavelength", "note")
    assert codes(replace(right, channel=np.full(len(right), "red"))) == []


# ---------------------------------------------------------------- the room, and those who ask


def test_every_question_says_what_it_is():
    for question in all_questions():
        assert question.ask.__module__ == f"gonio.checks.questions.{question.key}"
        assert question.asks.endswith("?")
        assert question.codes
    codes_of_all = [code for question in all_questions() for code in question.codes]
    assert len(set(codes_of_all)) == len(codes_of_all)
    assert LEVELS == ("refuse", "warning", "note")


ANOTHER = """
from gonio.checks.questions.base import Finding, Question
def ask(evidence):
    if evidence.n == 3:
        yield Finding("three", "warning", "3 samples are three.")
QUESTION = Question(key="three", order=900, asks="Are there three?", compares="the number with 3",
                    codes=("three",), ask=ask)
"""


def test_a_new_question_is_one_file(tmp_path, monkeypatch, gonio, put):
    (tmp_path / "three.py").write_text(ANOTHER, encoding="utf-8")
    monkeypatch.setattr(room, "__path__", [*room.__path__, str(tmp_path)])
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "docs" / "_ext"))
    import question_pages

    all_questions.cache_clear()
    try:
        path = put([f"30,0,{t},0,0.{t}" for t in (10, 20, 30)])
        assert "3 samples are three." in package.fit(package.load(path), model="lambert").warnings
        assert "Warning (three): 3 samples are three." in gonio("check", path)[1]
        row = "| Are there three? | the number with 3 | `three` |"
        assert row in question_pages.questions_table()
    finally:
        all_questions.cache_clear()
        monkeypatch.delattr(room, "three", raising=False)
        __import__("sys").modules.pop("gonio.checks.questions.three", None)


def test_check_prints_level_evidence_and_cure(gonio, put):
    right = glossy()
    path = put(turned(right, phi_r=right.directions.phi_r + np.pi))
    code, out, _ = gonio("check", path)
    assert code == 1
    assert "Warning (azimuth_zero): a lobe about theta_r = theta_i, phi_r = phi_i" in out
    assert "Add 180 deg to phi_r." in " ".join(out.split())
    document = json.loads(gonio("check", path, "--json")[1])
    assert document["passed"] is False
    (finding,) = document["findings"]
    assert (finding["code"], finding["level"]) == ("azimuth_zero", "warning")
    code, out, _ = gonio("check", put(right, "right.csv"))
    assert code == 0
    assert "Warning" not in out


def test_fit_and_compare_say_what_check_says(gonio, put):
    right = glossy()
    path = put(turned(right, phi_r=right.directions.phi_r + np.pi))
    (finding,) = plausible(formats.read(path)).findings
    document = json.loads(gonio("fit", path, "--model", "ward_isotropic", "--json")[1])
    assert document["warnings"][0] == finding.text
    notes = package.compare(package.load(path), ["lambert", "phong"]).notes
    assert notes[0] == finding.text


def test_inputs_of_a_joint_fit_are_asked_by_name():
    right = glossy()
    wrong = turned(right, phi_r=right.directions.phi_r + np.pi)
    result = package.fit({"a": right, "b": wrong}, model="lambert", share="")
    said = [text for text in result.warnings if "counted from the forward side" in text]
    assert len(said) == 1
    assert said[0].startswith("b: a lobe about")


def test_one_of_several_wavelengths_is_named():
    right, d = glossy(), hemisphere()
    both = Directions(*(np.tile(a, 2) for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)))
    samples = BRDFSamples(
        both,
        np.r_[right.value, 3.2 * right.value],
        wavelength_nm=np.repeat([450.0, 650.0], len(right)),
    )
    assert only(samples, "albedo", "warning").startswith("650 nm: the ")


def test_samples_that_gonio_reduced_are_not_asked():
    right = glossy()
    wrong = turned(right, phi_r=right.directions.phi_r + np.pi)
    reduced = replace(wrong, image=np.zeros(len(right), np.int64))
    assert package.fit(reduced, model="lambert").diagnostics.get("plausibility") is None
