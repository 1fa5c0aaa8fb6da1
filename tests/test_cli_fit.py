"""`gonio fit`: exit codes, texts, one JSON document, and real measurements."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from gonio import models
from gonio.fitting.minimum import find
from gonio.fitting.posterior import ensemble_sampler
from gonio.fitting.posterior import sample as posterior
from gonio.fitting.result import FitResult
from gonio.geometry import Directions


@pytest.fixture
def table(tmp_path):
    """Write samples of a model as CSV and return the path."""

    def write(name="oren_nayar", truth=None, n=200, noise=0.01, channel=None, u=True):
        truth = truth or {"rho": 0.8, "sigma": np.radians(25)}
        rng = np.random.default_rng(1)
        angles = rng.uniform(0, 70, n), rng.uniform(0, 360, n), rng.uniform(0, 70, n)
        columns = [angles[0], angles[1], angles[2], rng.uniform(0, 360, n)]
        f = models.get(name)(Directions(*map(np.radians, columns)), **truth)
        sd = noise * f.mean()
        value = f + sd * rng.standard_normal(n)
        header = "theta_i,phi_i,theta_r,phi_r,brdf" + (",u_brdf" if u else "")
        header += ",channel" if channel else ""
        lines = [header]
        for k in range(n):
            cells = [repr(float(c[k])) for c in columns] + [repr(float(value[k]))]
            cells += [repr(float(sd))] if u else []
            cells += [channel[k % len(channel)]] if channel else []
            lines.append(",".join(cells))
        path = tmp_path / "samples.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write


def fitted(gonio, *words):
    code, out, err = gonio("fit", *words, "--json")
    return code, json.loads(out), err


def test_json_is_one_document_on_stdout(gonio, table, tmp_path):
    target = tmp_path / "fit.json"
    code, data, err = fitted(gonio, table(), "--model", "oren_nayar", "-o", target, "--seed", "3")
    assert code == 0
    assert not [line for line in err.splitlines() if not line.startswith("compiling")]
    assert data["schema"] == "gonio.fit/1"
    assert (data["model"], data["status"], data["seed"]) == ("oren_nayar", "converged", 3)
    sigma = data["parameters"]["sigma"]
    assert sigma["unit"] == "deg"
    assert abs(sigma["value"] - 25) < 4 * sigma["stderr"]
    assert json.loads(target.read_text(encoding="utf-8")) == data
    assert FitResult.load(target).ok


def test_cuts_and_weights_are_in_the_result(gonio, table):
    path = table(channel=("red", "green"))
    code, data, _ = fitted(
        gonio, path, "--model", "oren_nayar", "--select", "channel=red", "--max-theta-i", "60",
        "--max-theta-r", "55", "--weights", "coscos",
    )  # fmt: skip
    assert code == 0
    assert data["weights"] == "coscos"
    assert data["cuts"] == {
        "select": {"channel": "red"}, "max_theta_i_deg": 60.0, "max_theta_r_deg": 55.0,
    }  # fmt: skip
    assert data["n_samples"] < 100
    assert any("theta_r <= 55 deg" in line for line in data["diagnostics"]["history"])


def test_the_table_says_what_was_fitted(gonio, table):
    code, out, err = gonio(
        "fit", table(), "--model", "oren_nayar", "--max-theta-r", "60", "--weights", "cos"
    )
    assert code == 0
    assert not [line for line in err.splitlines() if not line.startswith("compiling")]
    assert "Oren-Nayar, functional approximation (Oren & Nayar 1994" in out
    assert re.search(r"\d+ samples with theta_r <= 60 deg; weights: cos theta_r\n", out)
    assert re.search(r"sigma \[deg\] +2[45]\.\d+ +0\.\d+ +\d+\.\d+ \.\. \d+\.\d+", out)
    assert "status: converged" in out


def test_the_posterior_goes_beside_the_result(gonio, table, tmp_path):
    target = tmp_path / "fit.json"
    code, data, err = fitted(
        gonio, table("lambert", {"rho": 0.4}), "--model", "lambert", "--posterior", "-o", target
    )
    assert code == 0
    draws = tmp_path / "fit.draws.nc"
    assert draws.is_file()
    assert data["posterior"]["draws"] == str(draws)
    assert data["posterior"]["converged"]
    assert "{" not in err


def test_a_posterior_that_has_not_converged_leaves_with_1(gonio, table, monkeypatch):
    original = posterior.sample
    monkeypatch.setattr(ensemble_sampler, "BLOCK_STEPS", 10)
    monkeypatch.setattr(posterior, "sample", lambda *a, **k: original(*a, max_steps=10, **k))
    words = ("--model", "oren_nayar", "--posterior", "--sampler", "emcee")
    code, out, _ = gonio("fit", table(), *words)
    assert code == 1
    assert "status: converged" in out
    assert "posterior: NOT converged" in out
    assert "warning: the posterior has not converged (R-hat" in out.replace("\n", " ")


def test_a_fit_that_misses_its_checks_leaves_with_1(gonio, table, monkeypatch):
    monkeypatch.setattr(find, "gradient_faults", lambda *_: ["sigma"])
    code, data, _ = fitted(gonio, table(), "--model", "oren_nayar")
    assert code == 1
    assert data["status"] == "not_converged"
    assert any(
        "the derivative of oren_nayar with respect to sigma does not" in w for w in data["warnings"]
    )
    code, out, _ = gonio("fit", table(), "--model", "oren_nayar")
    assert code == 1
    assert "status: not converged" in out


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("--model", "wrad"), 2, "Error: unknown model 'wrad': did you mean 'ward'?"),
        (("--model", "ward", "--weights", "sine"), 2, "'sine' is not one of"),
        (("--model", "oren_nayar", "--start", "sigma"), 2, "Error: --start 'sigma' is not "
         "NAME=VALUE; write for example --start rho=0.8."),
        (("--model", "oren_nayar", "--start", "rho=2"), 2, "rho = 2 is out of range"),
        (("--model", "ward", "--select", "red"), 2,
         "--select 'red': give KEY=VALUE, for instance wavelength=650."),
        (("--model", "ward", "--select", "colour=red"), 2, "unknown selection 'colour'"),
        (("--model", "ward", "--select", "wavelength=650"), 2, "no wavelengths are stated"),
        (("--model", "ward", "--max-theta-i", "95"), 2, "95.0 is not in the range 0<=x<=90"),
        (("--model", "ward", "--max-theta-i", "0"), 3, "no sample has theta_i <= 0 deg; the "
         "smallest is"),
        (("--model", "ward", "-o", "no/such/folder/fit.json"), 3,
         "the folder no/such/folder does not exist; make it first."),
        (("--model", "ward", "--truth", "."), 3,
         ".: holds no truth; give a session that 'gonio simulate' wrote."),
        ((), 2, "Error: a fit needs --model MODEL, a name of 'gonio models' or a file; a FIT.json "
         "needs --score FILE."),
    ],
)  # fmt: skip
def test_mistakes_are_reported(gonio, table, words, code, text):
    found, out, err = gonio("fit", table(), *words)
    assert found == code
    assert out == ""
    assert text in " ".join(err.split())


def test_a_folder_is_no_target(gonio, table, tmp_path):
    code, _, err = gonio("fit", table(), "--model", "oren_nayar", "-o", tmp_path)
    assert code == 2
    assert f"Error: {tmp_path}: is a folder; give the name of a file." in err


def test_weights_by_uncertainty_need_one(gonio, table):
    code, _, err = gonio("fit", table(u=False), "--model", "oren_nayar", "--weights", "sd")
    assert code == 2
    assert "the samples have none (no u_brdf column); use none, relative, cos or coscos." in err


def test_bad_input_leaves_with_3(gonio, table, tmp_path):
    code, _, err = gonio("fit", tmp_path / "none.csv", "--model", "ward")
    assert code == 3
    assert "no such file; give a file of BRDF samples." in err
    code, _, err = gonio("fit", table(n=4), "--model", "ward")
    assert code == 3
    assert "4 samples cannot determine the 4 parameters of ward; give at least 5." in err


def test_several_channels_ask_for_a_choice(gonio, table):
    path = table(channel=("red", "green"))
    code, _, err = gonio("fit", path, "--model", "oren_nayar")
    assert code == 2
    assert (
        f"{path}: holds 2 channels; choose one with --select channel=VALUE, of green, red." in err
    )


# ---------------------------------------------------------------------- real measurements


@pytest.mark.parametrize(
    ("file", "nm", "expected"),
    [("garnet_red", 650, (0.174, 0.109, 0.239)), ("krylon_blue", 450, (0.268, 0.037, 0.121))],
)
def test_paints_of_cornell(gonio, real_data, file, nm, expected):
    code, data, _ = fitted(
        gonio, real_data / "cornell" / f"{file}.brdf", "--model", "ward_isotropic",
        "--select", f"wavelength={nm}", "--weights", "coscos",
        "--max-theta-i", "65", "--max-theta-r", "70",
    )  # fmt: skip
    assert code == 0
    assert data["n_samples"] == 855
    for name, value in zip(("rho_d", "rho_s", "alpha"), expected, strict=True):
        # The references are printed to three decimals.
        assert data["parameters"][name]["value"] == pytest.approx(value, rel=0.01, abs=6e-4)
    assert data["cuts"]["select"] == {"wavelength": str(nm)}


def test_ptfe_has_no_roughness_in_the_sense_of_oren_and_nayar(gonio, real_data):
    code, data, _ = fitted(
        gonio, real_data / "nist_ptfe" / "PTFE.data.csv", "--model", "oren_nayar",
        "--select", "wavelength=532",
    )  # fmt: skip
    # As Lambert's law it explains nothing of how PTFE varies.
    assert code == 1
    assert data["verdict"]["class"] == "does_not_fit"
    assert data["verdict"]["explained"] < 0.01
    sigma = data["parameters"]["sigma"]
    assert (sigma["value"], sigma["stderr"], sigma["at_bound"]) == (0.0, None, "lower")
    assert any(
        re.match(
            r"sigma is at its lower bound \(0 deg\): the data do not support a value above "
            r"[0-9.]+ deg \(95 %\) and do not determine it otherwise\.$",
            text,
        )
        for text in data["warnings"]
    )


@pytest.mark.parametrize(("rho", "sigma"), [(0.8, 20.0), (0.75, 42.0)])
def test_rough_cloths_with_a_lobe_come_back(gonio, table, rho, sigma):
    truth = {"rho": rho, "sigma": np.radians(sigma), "ks_over_kb": 0.05}
    path = table("oren_nayar_torrance_sparrow", truth, n=400)
    code, data, _ = fitted(gonio, path, "--model", "oren_nayar_torrance_sparrow")
    assert code == 0
    for name, true in (("rho", rho), ("sigma", sigma), ("ks_over_kb", 0.05)):
        estimate = data["parameters"][name]
        assert abs(estimate["value"] - true) < 4 * estimate["stderr"]
