"""Checks of models and files, and the command `check`."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from gonio import formats, models
from gonio.checks import (
    UNDECIDED,
    bihemispherical_albedo,
    check_model,
    check_samples,
    directional_albedo,
)
from gonio.checks.pairs import MIN_PAIRS
from gonio.cli import check as check_command
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import Directions, unit_vectors
from gonio.models.base import Claims, Model, Parameter
from gonio.samples import BRDFSamples

# ---------------------------------------------------------------- albedo

LOBES = [
    # model, alpha, theta_i in degrees, albedo for rho_s = 1; by another quadrature, 3 digits
    ("ward", 0.04, 0, 0.995),
    ("ward", 0.1, 0, 0.971),
    ("ward", 0.1, 60, 0.489),
    ("ward", 0.1, 85, 0.120),
    ("ward", 0.5, 75, 0.277),
    ("ward_approx", 0.2, 45, 0.671),
    ("ward_duer", 0.2, 85, 1.128),
    ("ward_gmd", 0.5, 80, 0.765),
]


@pytest.mark.parametrize(("name", "alpha", "theta_deg", "expected"), LOBES)
def test_albedo_of_ward_lobes(name, alpha, theta_deg, expected):
    p = {"rho_d": 0, "rho_s": 1, "alpha_x": alpha, "alpha_y": alpha}
    albedo = directional_albedo(models.get(name), p, math.radians(theta_deg))
    assert albedo.value == pytest.approx(expected, abs=6e-4)
    assert albedo.error < 2e-5 * albedo.value


@pytest.mark.parametrize("phi_deg", [0, 40, 90])
def test_albedo_of_the_narrowest_lobe_is_found(phi_deg):
    # Loss at normal incidence about 2.9 alpha^2, and nearly cos(theta_i) elsewhere.
    p = {"rho_d": 0, "rho_s": 1, "alpha_x": 0.005, "alpha_y": 0.005}
    phi = math.radians(phi_deg)
    assert directional_albedo(models.get("ward"), p, 0.0, phi).value == pytest.approx(
        1 - 2.9 * 0.005**2, abs=1e-5
    )
    at_60 = directional_albedo(models.get("ward"), p, math.radians(60), phi)
    assert at_60.value == pytest.approx(0.5, abs=2e-4)


def test_albedo_of_an_anisotropic_lobe_follows_the_azimuth():
    p = {"rho_d": 0, "rho_s": 1, "alpha_x": 0.05, "alpha_y": 0.16}
    found = [
        directional_albedo(models.get("ward"), p, math.radians(60), phi).value
        for phi in (0, math.pi / 2)
    ]
    assert found == pytest.approx([0.481, 0.488], abs=6e-4)


@pytest.mark.parametrize("theta_deg", [0, 45, 89.9])
def test_albedo_of_lambert_is_exact(theta_deg):
    albedo = directional_albedo(models.get("lambert"), {"rho": 0.37}, math.radians(theta_deg))
    assert albedo.value == pytest.approx(0.37, abs=1e-12)
    assert albedo.error < 1e-10


def test_error_is_stated_where_evaluations_run_out():
    model, p = models.get("ward_isotropic"), {"rho_d": 0, "rho_s": 1, "alpha": 0.02}
    exact = directional_albedo(model, p, 0.5, rtol=1e-8)
    rough = directional_albedo(model, p, 0.5, rtol=1e-12, max_evaluations=30_000)
    assert rough.n_evaluations <= 30_000
    assert 1e-12 < abs(rough.value - exact.value) <= rough.error


def test_albedo_refuses_light_from_the_horizon():
    with pytest.raises(ConfigurationError, match=r"theta_i = 1.5708 rad is not in \[0, pi/2\)"):
        directional_albedo(models.get("lambert"), {}, math.pi / 2)


def test_bihemispherical_albedo():
    lambert = bihemispherical_albedo(models.get("lambert"), {"rho": 0.8})
    assert lambert.value == pytest.approx(0.8, abs=1e-9)
    # Minnaert: f = rho (k + 1)/2 /pi (cos_i cos_r)^(k - 1), albedo by hand.
    minnaert = models.get("minnaert")
    f = float(minnaert(Directions(0, 0, 0, 0), rho=0.5, k=1.5))
    expected = 4 * math.pi * f / 2.5**2
    albedo = bihemispherical_albedo(minnaert, {"rho": 0.5, "k": 1.5})
    assert albedo.value == pytest.approx(expected, rel=1e-3)
    assert abs(albedo.value - expected) <= albedo.error


# ---------------------------------------------------------------- models

QUICK = [name for name in models.names() if name != "oren_nayar_numeric"]


@pytest.mark.parametrize("name", QUICK)
def test_every_model_keeps_its_claims_at_its_defaults(name):
    model = models.get(name)
    report = check_model(model, n_pairs=500)
    assert report.passed, [f for f in report.findings if not f.passed]
    assert report.conserves_energy
    energy = report.finding("energy")
    assert energy.holds
    assert energy.claimed == (model.claims.albedo_at_most is not None)


def test_the_bound_of_a_model_is_what_its_albedo_is_held_to():
    given = {"rho_d": 0.3, "rho_s": 0.5}
    energy = check_model(models.get("ward_gmd"), given, n_pairs=10).finding("energy")
    assert energy.text == "largest albedo 0.7950, claimed at most 0.8000 (rho_d + rho_s)"
    # A bound may be above 1: the claim is kept and energy is not.
    report = check_model(models.get("ward_gmd"), {"rho_d": 0.9, "rho_s": 0.8}, n_pairs=10)
    assert report.passed
    assert report.finding("energy").holds
    assert not report.conserves_energy
    assert "claimed at most 1.7000 (rho_d + rho_s); above 1 at 0, 30," in (
        report.finding("energy").text
    )
    lambert = models.get("lambert")
    up_to_1 = replace(lambert, claims=replace(lambert.claims, albedo_at_most=()))
    energy = check_model(up_to_1, {"rho": 0.9}, n_pairs=10).finding("energy")
    assert energy.text == "largest albedo 0.9000, claimed at most 1.0000"


def test_an_albedo_above_its_bound_breaks_the_claim():
    ward = models.get("ward_duer")
    claims = replace(ward.claims, albedo_at_most=("rho_d", "rho_s"))
    given = {"rho_d": 0, "rho_s": 0.5, "alpha_x": 0.2, "alpha_y": 0.2}
    report = check_model(replace(ward, claims=claims), given, n_pairs=10)
    assert not report.passed
    assert report.conserves_energy
    energy = report.finding("energy")
    assert energy.claimed
    assert not energy.holds
    assert energy.worst == pytest.approx(0.564, abs=6e-4)
    assert energy.text.endswith("0.5000 (rho_d + rho_s), which is exceeded at 85 deg")


def test_the_bihemispherical_albedo_of_a_model_stands_in_its_report():
    given = {"rho_d": 0.1, "rho_s": 0.4}
    report = check_model(models.get("ward"), given, n_pairs=10)
    assert report.bihemispherical == bihemispherical_albedo(models.get("ward"), given)


def test_a_fan_of_light_is_not_missed():
    # Facets of slope 0.005 in x and 1 in y: at normal incidence the light goes into a narrow fan.
    ward, given = models.get("ward_gmd"), {"rho_d": 0, "rho_s": 1, "alpha_x": 0.005, "alpha_y": 1}
    n = 200_000
    for theta_i, phi_i in ((0.0, 0.0), (0.7, 0.3)):
        albedo = directional_albedo(ward, given, theta_i, phi_i)
        w_i = np.broadcast_to(unit_vectors(theta_i, phi_i), (n, 3))
        weight = ward.sample(w_i, ward.vector(given), np.random.default_rng(1)).weight
        assert albedo.value == pytest.approx(weight.mean(), abs=4 * weight.std() / n**0.5)


def test_draws_tell_of_a_quadrature_that_missed_something(monkeypatch):
    model, given = models.get("ward_gmd"), {"rho_d": 0, "rho_s": 1}
    right = check_model(model, given, n_pairs=10).albedos[0.0]
    assert right == directional_albedo(model, given, 0.0)

    def missed(*arguments, **options):
        found = directional_albedo(*arguments, **options)
        return replace(found, value=0.95 * found.value)

    monkeypatch.setattr("gonio.checks.model.directional_albedo", missed)
    albedo = check_model(model, given, n_pairs=10).albedos[0.0]
    assert albedo.value == 0.95 * right.value
    assert 0.04 < albedo.error / right.value < 0.1


@pytest.mark.parametrize("name", ["eon", "ward_gmd", "ggx"])
def test_a_costly_model_is_asked_for_fewer_directions(name):
    model = models.get(name)
    exact = bihemispherical_albedo(model, {})
    drawn = check_model(replace(model, costly=True), n_pairs=10).bihemispherical
    assert drawn.n_evaluations == 20_000
    assert 1e-4 < drawn.error < 0.01 * drawn.value
    # The error that is told is two standard errors.
    assert abs(drawn.value - exact.value) < 1.5 * drawn.error + exact.error
    again = check_model(replace(model, costly=True), n_pairs=10).bihemispherical
    assert again == drawn


def broken(xi, yi, zi, xr, yr, zr, rho):
    """Not reciprocal, negative towards +y, no rotational symmetry, albedo far above 1, a step."""
    f = 4 * rho * zi + yr + (1.0 if zr > 0.5 else 0.0)
    return f, 4 * zi


BROKEN = Model(
    name="broken",
    title="Everything wrong",
    reference="none",
    parameters=(Parameter("rho", "ρ", "size", 0.5, 0.0, 1.0, linear=True),),
    kernel=broken,
    claims=Claims(isotropic=True, seams=((0.3, 0.0, math.pi / 3, 0.0),)),
)


def test_a_broken_model_is_caught():
    report = check_model(BROKEN)
    assert not report.passed
    assert [f.name for f in report.findings if not f.holds] == [
        "reciprocity",
        "positivity",
        "energy",
        "isotropy",
        "seams",
    ]
    assert report.finding("positivity").worst < -0.5
    theta_i, _, theta_r, phi_r = report.finding("positivity").where
    assert theta_i > 60
    assert theta_r > 60
    assert phi_r < 0
    assert report.finding("reciprocity").worst > 0.5
    assert "above 1 at 0, 30, 45" in report.finding("energy").text
    assert report.finding("energy").passed  # not claimed
    json.dumps(report.describe(), allow_nan=False)


def holes(xi, yi, zi, xr, yr, zr, rho):
    """No number where the light falls steeply."""
    return (math.nan if zi > 0.9 else rho), 1.0


def test_a_model_with_a_hidden_nan_is_caught():
    model = Model("holes", "", "", BROKEN.parameters, holes)
    report = check_model(model, n_pairs=200)
    assert not report.finding("reciprocity").passed
    assert not report.finding("positivity").passed
    assert not report.finding("energy").holds
    json.dumps(report.describe(), allow_nan=False)


# ---------------------------------------------------------------- samples


def directions(turned: bool = False) -> Directions:
    """A grid that holds reciprocal partners; with the sample turned if asked for."""
    theta = np.radians(np.arange(10, 80, 10.0))
    turn = np.radians(np.arange(0, 360, 60.0)) if turned else np.zeros(1)
    phi = np.radians(np.arange(-180, 180, 30.0))
    grids = np.meshgrid(theta, turn, theta, phi, indexing="ij")
    theta_i, phi_i, theta_r, delta = (grid.ravel() for grid in grids)
    return Directions(theta_i, phi_i, theta_r, phi_i + delta)


def measured(
    d: Directions, factor, noise: float = 0.02, seed: int = 3, **parameters
) -> BRDFSamples:
    f = models.get("ward")(d, **{"rho_d": 0.2, "rho_s": 0.1, **parameters})
    noisy = f * (1 + noise * np.random.default_rng(seed).standard_normal(f.shape))
    return BRDFSamples(d, noisy * factor)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("name", ["BRDF", "BRDF*cos(theta_r)", "BRDF*cos(theta_i)"])
def test_the_quantity_is_recognised(name, turned):
    d = directions(turned)
    factor = {
        "BRDF": 1.0,
        "BRDF*cos(theta_r)": np.cos(d.theta_r),
        "BRDF*cos(theta_i)": np.cos(d.theta_i),
    }[name]
    # A brushed surface has reciprocal partners only where the sample was turned.
    alphas = {"alpha_x": 0.1, "alpha_y": 0.3} if turned else {"alpha_x": 0.2, "alpha_y": 0.2}
    report = check_samples(measured(d, factor, **alphas))
    assert report.quantity == name
    assert report.passed == (name == "BRDF")
    assert report.assumed_isotropic is not turned
    # Two values of 2 % noise each: median |difference| is 0.674 * 2 % * sqrt(2).
    assert report.candidates[name] == pytest.approx(0.019, abs=0.004)
    assert all(v > 0.2 for other, v in report.candidates.items() if other != name)
    assert report.mirror.n_pairs > 50
    assert (report.mirror.rms > 0.1) == turned


def test_a_cosine_of_both_angles_and_a_constant_stay_unseen_and_it_says_so():
    d = directions()
    both = check_samples(measured(d, np.cos(d.theta_i) * np.cos(d.theta_r)))
    assert both.quantity == "BRDF"
    assert any("cos(theta_i)*cos(theta_r)" in note for note in both.notes)
    factor = check_samples(measured(d, np.pi, rho_d=0.8))
    assert factor.quantity == "BRDF"
    assert factor.albedo > 2
    text = " ".join(factor.notes)
    assert "cannot see a constant factor" in text
    (above,) = factor.findings
    assert (above.code, above.level) == ("albedo", "warning")
    assert "a reflectance factor pi*BRDF would be so" in above.text
    assert not factor.passed
    assert check_samples(measured(d, 1.0, rho_d=0.8)).findings == ()


def test_too_few_pairs_and_too_much_noise_leave_it_undecided():
    d = directions()
    samples = measured(d, 1.0)
    chosen = (d.theta_i < 0.4) & (d.theta_r < 0.4)
    few = check_samples(samples.select(chosen, "small angles"))
    assert few.quantity == UNDECIDED
    assert few.n_telling < MIN_PAIRS
    assert few.passed
    assert f"{few.n_telling} reciprocal pairs tell the quantities apart" in few.notes[0]
    noisy = check_samples(measured(d, 1.0, noise=3.0))
    assert noisy.quantity == UNDECIDED
    assert "pairs stand out of the noise" in noisy.notes[0]
    assert noisy.n_negative > 50
    one = check_samples(samples.select(np.array([5]), "one"))
    assert (one.quantity, one.reciprocity.n_pairs, one.reciprocity.median) == (UNDECIDED, 0, None)
    assert one.albedo is None


def test_values_are_compared_within_one_wavelength_only():
    d = directions()
    n = len(d.theta_i)
    lit = np.radians(35) > d.theta_i
    # Partners lie in different wavelengths, except where both angles are on one side.
    samples = BRDFSamples(d, np.where(lit, 1.0, 2.0), wavelength_nm=np.where(lit, 450.0, 650.0))
    report = check_samples(samples)
    assert 0 < report.reciprocity.n_pairs < n
    assert report.reciprocity.rms == 0


def test_ptfe_is_a_brdf(real_data):
    report = check_samples(formats.read(real_data / "nist_ptfe" / "PTFE.data.csv"))
    assert report.quantity == "BRDF"
    assert report.assumed_isotropic
    assert report.candidates["BRDF"] < 0.015
    assert min(report.candidates["BRDF*cos(theta_r)"], report.candidates["BRDF*cos(theta_i)"]) > 0.3
    assert report.mirror.rms == pytest.approx(0.015, abs=0.006)
    assert report.albedo == pytest.approx(0.984, abs=0.02)


def test_garnet_red_is_a_brdf(real_data):
    path = real_data / "cornell" / "garnet_red.brdf"
    report = check_samples(formats.read(path, select={"wavelength": "650"}))
    assert report.quantity == "BRDF"
    assert report.n_telling > 200
    assert report.candidates["BRDF"] == pytest.approx(0.025, abs=0.005)
    assert report.candidates["BRDF*cos(theta_r)"] > 0.5
    # In its dark band the noise hides the quantity.
    dark = check_samples(formats.read(path, select={"wavelength": "400"}))
    assert dark.quantity == UNDECIDED


# ---------------------------------------------------------------- the command


def run(*arguments):
    """Run the command and return its result; errors come through as exceptions."""
    words = [str(argument) for argument in arguments]
    return CliRunner().invoke(check_command.command, words, catch_exceptions=False)


@pytest.fixture
def files(tmp_path):
    """Samples of a BRDF and of a BRDF with a cosine left in."""
    d = directions()
    paths = {}
    for name, factor in (("brdf", 1.0), ("cosine", np.cos(d.theta_r))):
        paths[name] = tmp_path / f"{name}.nc"
        measured(d, factor).save(paths[name])
    return paths


def narrow(text: str) -> bool:
    return max(map(len, text.splitlines())) <= 80


def test_check_of_a_model():
    result = run("ward", "-p", "rho_d=0.1", "-p", "rho_s=0.3")
    assert result.exit_code == 0
    assert "ward: rho_d = 0.1, rho_s = 0.3" in result.stdout
    assert "The model keeps what it claims." in result.stdout
    uniform = bihemispherical_albedo(models.get("ward"), {"rho_d": 0.1, "rho_s": 0.3})
    line = next(line for line in result.stdout.splitlines() if line.startswith(" uniform"))
    assert line.split()[1:3] == [f"{uniform.value:.5f}", f"{uniform.error:.1g}"]
    assert narrow(result.stdout)


def test_check_of_a_sum():
    result = run("lambert+ward_gmd", "-p", "rho=0.3")
    assert result.exit_code == 0
    assert "claimed at most 0.6000" in result.stdout
    assert "(rho + rho_d + rho_s)" in result.stdout
    with pytest.raises(ConfigurationError, match="unknown model 'wrd': did you mean 'ward'"):
        run("lambert+wrd")


def test_check_of_a_material_in_degrees():
    document = json.loads(run("wall_plaster", "--json", "-p", "sigma=20", "-p", "rho=1").stdout)
    assert document["schema"] == "gonio.check_model/1"
    assert document["parameters"]["sigma"] == pytest.approx(20)
    assert document["units"]["sigma"] == "deg"
    assert [row["theta_i_deg"] for row in document["albedo"]] == [0, 30, 45, 60, 75, 85]
    assert document["conserves_energy"] is False
    uniform = document["bihemispherical_albedo"]
    assert 0.95 < uniform["value"] < 1
    assert 0 < uniform["error"] < 1e-3
    assert uniform["n_evaluations"] > 1000


def test_gain_of_energy_is_reported_and_fails_nothing():
    result = run("ward", "-p", "rho_d=0.9", "-p", "rho_s=0.9")
    assert result.exit_code == 0
    assert "above 1 at 0, 30, 45, 60" in result.stdout
    assert "reflects more light than falls on it" in " ".join(result.stdout.split())
    assert narrow(result.stdout)


def test_a_broken_claim_is_exit_code_1(monkeypatch):
    monkeypatch.setattr(models, "names", lambda: ["broken"])
    monkeypatch.setattr(models, "get", lambda name: BROKEN)
    result = run("broken")
    assert result.exit_code == 1
    assert "The model does not keep what it claims: reciprocity, positivity" in result.stdout
    assert narrow(result.stdout)
    result = run("broken", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["passed"] is False


def test_check_of_files(files):
    result = run(files["brdf"])
    assert result.exit_code == 0
    assert "Quantity: BRDF\n" in result.stdout
    assert "partners within 2 deg" in result.stdout
    assert "light and viewer exchanged" in result.stdout
    result = run(files["cosine"])
    assert result.exit_code == 1
    assert "Quantity: BRDF*cos(theta_r)\n" in result.stdout
    assert "Divide the values by cos(theta_r)" in result.stdout
    # The first line names the file, and a long folder is not broken.
    assert narrow(result.stdout.partition("\n\n")[2])


def test_json_of_a_file_is_one_document(files):
    result = run(files["cosine"], "--json")
    assert result.exit_code == 1
    document = json.loads(result.stdout)
    assert document["quantity"] == "BRDF*cos(theta_r)"
    assert document["schema"] == "gonio.check_samples/1"
    assert set(document["candidates"]) == {"BRDF", "BRDF*cos(theta_r)", "BRDF*cos(theta_i)"}
    assert result.stderr == ""


def test_select_takes_one_wavelength(tmp_path):
    d = directions()
    path = tmp_path / "two.nc"
    nm = np.where(np.arange(len(d.theta_i)) % 2, 450.0, 650.0)
    BRDFSamples(d, np.full(len(nm), 0.1), wavelength_nm=nm).save(path)
    document = json.loads(run(path, "--select", "wavelength=650", "--json").stdout)
    assert document["n_samples"] == len(nm) // 2


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        (["wrd"], ConfigurationError, "unknown model, material or file 'wrd': did you mean 'ward'"),
        (["missing.csv"], DataError, "missing.csv: no such file"),
        (["ward", "--select", "wavelength=650"], ConfigurationError, "--select is for files"),
        (["ward", "-p", "alpha=1"], ConfigurationError, "unknown parameter 'alpha' of ward"),
        (["a.csv", "-p", "rho=1"], ConfigurationError, "a.csv is a file; -p is for models"),
        (["a.csv", "--select", "650"], ConfigurationError, "give KEY=VALUE, for instance"),
    ],
)
def test_wrong_usage_is_reported(arguments, error, match):
    with pytest.raises(error, match=match):
        run(*arguments)
