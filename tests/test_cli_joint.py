"""`gonio fit --share` and what other commands make of its result; real paints and PTFE."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from gonio import formats, models
from gonio.errors import ConfigurationError
from gonio.fitting.result import FitResult
from gonio.geometry import Directions
from gonio.samples import BRDFSamples


@pytest.fixture
def paint(tmp_path):
    """Write a paint of several colours or wavelengths as CSV and return the path."""

    def write(name="paint", *, column="channel", labels=("red", "blue"), alpha=0.18, seed=1):
        rng = np.random.default_rng(seed)
        angles = np.meshgrid([10, 25, 40, 55], np.arange(0, 75, 10), np.arange(0, 181, 30))
        theta_i, theta_r, phi_r = (a.ravel() for a in angles)
        where = Directions(np.radians(theta_i), 0.0, np.radians(theta_r), np.radians(phi_r))
        lines = [f"theta_i,phi_i,theta_r,phi_r,brdf,u_brdf,{column}"]
        for k, label in enumerate(labels):
            f = models.get("ward_isotropic")(where, rho_d=0.1 + 0.02 * k, rho_s=0.05, alpha=alpha)
            lines += [
                f"{i},0,{r},{phi},{v!r},0.002,{label}"
                for i, r, phi, v in zip(
                    theta_i, theta_r, phi_r, map(float, rng.normal(f, 0.002)), strict=True
                )
            ]
        path = tmp_path / f"{name}.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write


WARD = ("--model", "ward_isotropic")


def test_the_tables_read_well_at_80_columns(gonio, paint):
    path = paint(column="wavelength_nm", labels=range(400, 700, 10))
    code, out, err = gonio("fit", path, *WARD, "--share", "alpha")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    tables = [line for line in lines if re.match(r" (shared|alpha|wavelength|\d+ nm|─)", line)]
    assert max(map(len, tables)) <= 80
    assert re.search(r"^ alpha +0\.1[78]\d+ +0\.000\d+ +0\.1[78]\d+ \.\. 0\.1[78]\d+", out, re.M)
    assert re.search(r"^ wavelength +rho_d +rho_s +chi2/dof", out, re.M)
    rows = re.findall(r"^ (\d+) nm +0\.\d+ ± 0\.000\d+ +0\.0\d+ ± 0\.000\d+ +[01]\.\d+ ", out, re.M)
    assert rows == [str(nm) for nm in range(400, 700, 10)]
    assert re.search(r"^sharing: the data allow it; chi2 grows by [\d.]+ over separate fits, "
                     r"29 expected \(p = 0\.\d+\)$", out, re.M)  # fmt: skip


def test_wide_tables_are_cut_between_parameters(gonio, paint):
    code, out, _ = gonio("fit", paint(), *WARD, "--share", "none")
    assert code == 0
    assert "nothing is shared: each part was fitted by itself" in out
    assert re.search(r"^ channel +rho_d +rho_s +alpha +chi2/dof", out, re.M)
    code, out, _ = gonio("fit", paint(), "--model", "ward", "--share", "none")
    assert len(re.findall(r"^ channel", out, re.M)) == 2
    lines = [line for line in out.splitlines() if re.match(r" (red|blue|channel)", line)]
    assert max(map(len, lines)) <= 80


def test_the_document_holds_the_parts(gonio, paint, tmp_path):
    target = tmp_path / "fit.json"
    code, out, _ = gonio("fit", paint(), *WARD, "--share", "all", "--json", "-o", target)
    data = json.loads(out)
    assert code == 0
    assert list(data["parameters"]) == ["rho_d", "rho_s", "alpha"]
    assert [part["name"] for part in data["parts"]] == ["red", "blue"]
    assert data["parts"][1]["select"] == {"channel": "blue"}
    assert data["sharing"]["refused"]  # rho_d is not one number
    assert FitResult.load(target).parts[0].parameters["alpha"] == "alpha"


def test_several_files_are_several_materials(gonio, paint):
    one, two = paint(), paint("varnish", labels=("clear",), alpha=0.25)
    code, out, _ = gonio("fit", one, two, *WARD, "--share", "alpha", "--json")
    data = json.loads(out)
    assert code == 0
    assert [p["name"] for p in data["parts"]] == ["paint, red", "paint, blue", "varnish"]
    assert [p["input"] for p in data["parts"]] == [str(one), str(one), str(two)]
    assert data["source"]["input"] == [str(one), str(two)]
    assert any("The farthest is varnish: alpha alone is 0.2" in w for w in data["warnings"])


def test_true_parameters_of_channels_stand_beside(gonio, tmp_path):
    from virtual import small

    import gonio as package
    from gonio.instrument.filter import Filter
    from gonio.metadata import Plan

    rig = small().model_copy(update={"channels": (Filter(name="red"), Filter(name="blue"))})
    session = tmp_path / "two.gonio"
    package.simulate(
        model="lambert", parameters={"rho": (0.2, 0.6)}, output=session, instrument=rig, seed=3,
        plan=Plan(theta_i_deg=(10.0, 50.0), rotations_deg=(0.0,), exposures_s=(1e-3, 64e-3)),
    )  # fmt: skip
    samples = tmp_path / "two.nc"
    gonio("reduce", session, "-o", samples)
    _, out, _ = gonio("fit", samples, "--model", "lambert", "--share", "none", "--truth", session)
    assert re.search(r"^ red +0\.\d+ ± 0\.\d+ +0\.2 ", out, re.M)
    assert re.search(r"^ blue +0\.\d+ ± 0\.\d+ +0\.6 ", out, re.M)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "holds 2 channels; choose one with --select channel=VALUE, of blue, red. Or fit them "
         "together with --share NAME,..., the parameters that they have in common."),
        (("--share", "alhpa"), "unknown parameter 'alhpa' of ward_isotropic: did you mean "
         "'alpha'?"),
        (("--share", ","), "--share ',': give parameters of ward_isotropic, with commas, or all or "
         "none."),
        (("--share", "alpha", "--select", "channel=red"), "the samples are of one channel: there "
         "is nothing to share"),
        (("--share", "alpha", "--select", "wavelength>=600"), "--select 'wavelength>=600': a range "
         "is written wavelength=600.."),
        (("--share", "alpha", "--select", "wavelength<480"), "is written wavelength=..480"),
    ],
)  # fmt: skip
def test_mistakes_are_reported(gonio, paint, words, text):
    code, out, err = gonio("fit", paint(), *WARD, *words)
    assert (code, out) == (2, "")
    assert text in " ".join(err.split())


def test_several_files_ask_for_what_they_share(gonio, paint):
    path = paint()
    code, _, err = gonio("fit", path, paint("two"), *WARD)
    assert code == 2
    assert (
        "2 inputs are fitted together with --share NAME,..., the parameters that they have in "
        "common, or --share none."
    ) in " ".join(err.split())
    code, _, err = gonio("fit", path, path, *WARD, "--share", "alpha")
    assert code == 2
    assert f"{path} is given twice; give it once." in " ".join(err.split())


# ---------------------------------------------------------------------- one part of the fit


@pytest.fixture
def joint(gonio, paint, tmp_path):
    target = tmp_path / "fit.json"
    path = paint(column="wavelength_nm", labels=(450, 550, 650))
    assert gonio("fit", path, *WARD, "--share", "alpha", "-o", target)[0] == 0
    return target


def test_plot_draws_one_part(gonio, joint, tmp_path):
    picture = tmp_path / "part.png"
    code, _, err = gonio("plot", joint, "--select", "wavelength=650", "-o", picture)
    assert code == 0
    assert "drawn is" not in err
    assert picture.stat().st_size > 10_000
    code, _, err = gonio("plot", joint, "-o", picture)
    assert code == 0
    assert (
        f"{joint} is a fit of 3 parts: drawn is 550 nm; choose with --select wavelength=550." in err
    )


def test_report_tells_of_one_part(gonio, joint, tmp_path):
    page = tmp_path / "part.html"
    assert gonio("report", joint, "--select", "wavelength=650", "-o", page)[0] == 0
    text = page.read_text(encoding="utf-8")
    assert "Part of a joint fit" in text
    assert "--share alpha" in text
    code, _, err = gonio("report", joint, "-o", page)
    assert code == 2
    assert (
        f"{joint}: a joint fit of 3 parts; choose one, as with --select wavelength=450, of "
        "450 nm, 550 nm, 650 nm."
    ) in " ".join(err.split())


def test_a_part_that_is_not_there_is_reported(gonio, joint, paint, tmp_path):
    code, _, err = gonio("plot", joint, "--select", "wavelength=500")
    assert code == 2
    assert "no part of the fit is wavelength=500; its parts are 450 nm, 550 nm, 650 nm." in err
    code, _, err = gonio("plot", joint, "--select", "colour=red")
    assert code == 2
    assert "--select colour: of a joint fit wavelength, channel or part can be selected." in err
    single = tmp_path / "single.json"
    gonio("fit", paint(), *WARD, "--select", "channel=red", "-o", single)
    code, _, err = gonio("report", single, "--select", "channel=red")
    assert code == 2
    assert "a fit of one BRDF has no parts to select; leave --select out." in err


# ---------------------------------------------------------------------- ranges


@pytest.mark.parametrize(
    ("wanted", "kept"),
    [
        ("500..600", [500, 550, 600]), ("550..", [550, 600]), ("..500", [450, 500]),
        ("450,600", [450, 600]), ("..450, 600..", [450, 600]), ("500", [500]),
    ],
)  # fmt: skip
def test_wavelengths_are_selected_by_range_and_list(wanted, kept):
    nm = np.array([450.0, 500, 550, 600])
    samples = BRDFSamples(Directions(nm / 1e3, 0.0, nm / 1e3, 0.0), nm, wavelength_nm=nm)
    assert formats.choose(samples, {"wavelength": wanted}).value.tolist() == kept


def test_ranges_without_samples_are_reported():
    nm = np.array([450.0, 500.0])
    samples = BRDFSamples(Directions(nm / 1e3, 0.0, nm / 1e3, 0.0), nm, wavelength_nm=nm)
    for wanted, text in (
        ("600..700", r"no sample from 600 nm to 700\. Listed: 450, 500\.$"),
        ("600..", r"no sample from 600 nm up\. Listed"),
        ("700..600", r"wavelength '700\.\.600' is not a positive number; give it in nm, such as "
         r"650, or several as 450,650 or 600\.\.700, where one end may be left out\.$"),
        ("..", r"wavelength '\.\.' is not a positive number"),
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=text):
            formats.choose(samples, {"wavelength": wanted})


def test_several_channels_are_selected_by_name():
    where = Directions(np.full(3, 0.1), 0.0, 0.1, 0.0)
    samples = BRDFSamples(where, np.arange(3.0), channel=np.array(["red", "green", "blue"]))
    assert formats.choose(samples, {"channel": "red, blue"}).value.tolist() == [0.0, 2.0]
    with pytest.raises(ConfigurationError, match=r"'rod' of samples: did you mean 'red'\?"):
        formats.choose(samples, {"channel": "rod,blue"})


# ---------------------------------------------------------------------- real measurements


@pytest.mark.parametrize(
    ("file", "nm", "alpha", "refused"),
    [("garnet_red", "600..", 0.236, True), ("krylon_blue", "440..480", 0.121, False)],
)
def test_paints_of_cornell_share_their_roughness(gonio, real_data, file, nm, alpha, refused):
    code, out, _ = gonio(
        "fit", real_data / "cornell" / f"{file}.brdf", *WARD, "--share", "alpha", "--json",
        "--select", f"wavelength={nm}", "--weights", "coscos",
        "--max-theta-i", "65", "--max-theta-r", "70",
    )  # fmt: skip
    data = json.loads(out)
    assert code == 0
    estimate = data["parameters"]["alpha"]
    assert estimate["value"] == pytest.approx(alpha, abs=0.001)
    # All wavelengths were measured at the same directions, and one misfit is no new evidence.
    alone = [part["alone"]["alpha"][1] for part in data["parts"]]
    assert min(alone) / 2 < estimate["stderr"] < max(alone)
    assert any("the residuals of the parts are correlated (correlation 0.9" in w or
               "the residuals of the parts are correlated (correlation 1 " in w
               for w in data["warnings"])  # fmt: skip
    # Garnet red is less rough at 600 nm, where it is dark, than at 700 nm.
    assert data["sharing"]["refused"] is refused


def test_ptfe_has_no_roughness_at_any_wavelength(gonio, real_data):
    code, out, _ = gonio(
        "fit", real_data / "nist_ptfe" / "PTFE.data.csv", "--model", "oren_nayar", "--share",
        "sigma", "--json",
    )  # fmt: skip
    data = json.loads(out)
    assert (code, data["verdict"]["class"]) == (1, "does_not_fit")  # it explains nothing
    assert [p["name"] for p in data["parts"]] == ["351 nm", "532 nm", "633 nm", "1064 nm"]
    sigma = data["parameters"]["sigma"]
    assert (sigma["value"], sigma["stderr"], sigma["at_bound"]) == (0.0, None, "lower")
    assert any(w.startswith("sigma is at its lower bound (0 deg)") for w in data["warnings"])
    for part in data["parts"]:
        rho = data["parameters"][part["parameters"]["rho"]]
        assert 0.975 < rho["value"] < 0.99
    assert data["sharing"]["p_value"] is None
