"""A model from outside the package in every verb: on the command line by file, in Python itself."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from virtual import images, small

import gonio
from gonio import models, rendering
from gonio.fitting.texels import fit_texels
from gonio.geometry import Directions
from gonio.metadata import Plan
from gonio.models import Model
from gonio.samples import BRDFSamples, SharedTerm
from gonio.session import read_truth

FILE = '''
"""A lobe of facets, f = rho/pi + s exp(-tan^2 delta / alpha^2) / (4 pi alpha^2)."""
import numpy as np
from gonio.models import Model


def lobe(directions, rho, s, alpha):
    tan2 = np.tan(directions.delta()) ** 2
    return rho / np.pi + s * np.exp(-tan2 / alpha**2) / (4 * np.pi * alpha**2)


MODEL = Model.from_function(
    lobe,
    {"rho": (0.2, 0, 1), "s": (0.1, 0, 1), "alpha": (0.2, 0.02, 1)},
    name="facets_by_file",
)
'''
ROOT = Path(__file__).resolve().parents[1]
TRUTH = {"rho": 0.3, "s": 0.2, "alpha": 0.25}
SPELLED = tuple(word for name, value in TRUTH.items() for word in ("-p", f"{name}={value}"))


def lobe(directions, rho, s, alpha):
    tan2 = np.tan(directions.delta()) ** 2
    return rho / np.pi + s * np.exp(-tan2 / alpha**2) / (4 * np.pi * alpha**2)


OWN = Model.from_function(
    lobe, {"rho": (0.2, 0, 1), "s": (0.1, 0, 1), "alpha": (0.2, 0.02, 1)}, name="facets"
)


@pytest.fixture(autouse=True)
def forgotten():
    """Nothing of one test is known by name in the next; figures are closed."""
    models._used.clear()
    with mpl.rc_context():
        yield
    pyplot.close("all")
    models._used.clear()


@pytest.fixture
def run(gonio, monkeypatch, tmp_path):
    """A command in an empty folder, as in a process of its own: (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    Path("facets.py").write_text(FILE, encoding="utf-8")

    def command(*words):
        models._used.clear()
        return gonio(*words)

    return command


def directions(n: int = 240, seed: int = 1) -> Directions:
    rng = np.random.default_rng(seed)
    theta_i = rng.choice([0.1, 0.4, 0.7, 1.0], n)
    return Directions(theta_i, 0.0, rng.uniform(0, 1.1, n), rng.uniform(0, 6.28, n))


def measured(n: int = 240, seed: int = 1, noise: float = 0.002, **shared) -> BRDFSamples:
    where = directions(n, seed)
    value = lobe(where, **TRUTH) + noise * np.random.default_rng(seed + 9).standard_normal(n)
    return BRDFSamples(where, value, u_independent=np.full(n, noise), **shared)


def near_truth(result, width: float = 4.5, of: str = "") -> None:
    for name, value in TRUTH.items():
        estimate = result.parameters[name + of]
        assert abs(estimate.value - value) < width * estimate.stderr


@pytest.fixture
def csv(run) -> Path:
    path = Path("samples.csv").absolute()
    measured().save(path)
    return path


@pytest.fixture
def fitted(run, csv) -> Path:
    code, _, err = run("fit", csv, "--model", "facets.py", "-o", "fit.json")
    assert code == 0, err
    return Path("fit.json").absolute()


class TestCommands:
    def test_fit_names_the_model_and_its_source(self, fitted):
        told = json.loads(fitted.read_text(encoding="utf-8"))
        assert told["model"] == "facets_by_file"
        assert told["model_source"]["file"] == "facets.py"
        assert len(told["model_source"]["sha256"]) == 64

    @pytest.mark.parametrize("loss", ["log", "cube_root", "student_t"])
    def test_fit_with_other_losses(self, run, csv, loss):
        code, out, err = run("fit", csv, "--model", "facets.py", "--loss", loss, "--json")
        assert code == 0, err
        values = {n: q["value"] for n, q in json.loads(out)["parameters"].items()}
        assert values == pytest.approx(TRUTH, rel=0.05)

    def test_fit_with_held_parameters_and_a_posterior(self, run, csv):
        words = ("--fix", "s=0.2", "--posterior", "-o", "fit.json", "--json")
        code, out, err = run("fit", csv, "--model", "facets.py:MODEL", *words)
        assert code == 0, err
        assert json.loads(out)["posterior"]["converged"]

    def test_models_of_one_name_are_compared_under_their_files(self, run, csv):
        text = FILE.replace("rho / np.pi + s", "0.9 * rho / np.pi + s")
        Path("other.py").write_text(text, encoding="utf-8")
        code, out, err = run("compare", csv, "--models", "facets.py,other.py", "--json")
        assert code == 0, err
        names = {entry["model"] for entry in json.loads(out)["entries"]}
        assert names == {"facets_by_file (facets.py)", "facets_by_file (other.py)"}
        code, _, err = run("compare", csv, "--models", "facets.py,facets.py")
        assert code == 2
        assert "model facets_by_file is given twice; give it once." in err

    def test_a_model_of_another_fit_is_refused(self, run, fitted):
        code, _, err = run("report", fitted, "--model", "ward")
        assert code == 2
        assert "--model ward is the model ward, and " in err
        assert "give the file that defines facets_by_file" in err

    def test_a_plot_takes_samples_that_were_moved(self, run, fitted, csv):
        moved = csv.rename(csv.with_name("moved.csv"))
        code, _, err = run("plot", fitted, "--model", "facets.py")
        assert code == 3
        assert "Give them with --samples FILE" in err
        for verb, output in (("plot", "a.png"), ("report", "a.html")):
            words = (verb, fitted, "--model", "facets.py", "--samples", moved, "-o", output)
            code, _, err = run(*words)
            assert code == 0, err

    def test_report_and_plot_take_the_file_again(self, run, fitted):
        for words in (("report", fitted), ("plot", fitted)):
            code, _, err = run(*words)
            assert code != 0
            assert "give it with --model FILE.py" in err
            code, _, err = run(*words, "--model", "facets.py")
            assert code == 0, err
        assert "facets_by_file" in fitted.with_suffix(".html").read_text(encoding="utf-8")
        assert fitted.with_suffix(".png").exists()

    @pytest.mark.parametrize("kind", ["lobe", "solid", "albedo"])
    def test_plot_of_the_model(self, run, kind):
        words = ("--kind", kind, "-o", "out.png", "--dpi", "30", *SPELLED)
        code, _, err = run("plot", "model:facets.py", *words)
        assert code == 0, err

    def test_compare(self, run, csv):
        code, out, err = run("compare", csv, "--models", "lambert,facets.py", "--json")
        assert code in (0, 1), err  # 1: Lambert's model does not fit
        assert json.loads(out)["entries"][0]["model"] == "facets_by_file"

    def test_simulate_reduce_and_fit_several_channels_with_parameters_in_common(self, run):
        self.tiny(channels="red,green")
        where = ("--instrument", "tiny.toml", "--theta-i", "10,40", "--rotations", "0")
        words = ("simulate", "--model", "facets.py", *where, *SPELLED, "-o", "s.gonio")
        code, _, err = run(*words)
        assert code == 0, err
        assert read_truth("s.gonio")["model"] == "facets_by_file"
        assert run("reduce", "s.gonio", "-o", "s.nc")[0] == 0
        words = ("--share", "s,alpha", "--nuisance", "all", "--truth", "s.gonio", "--json")
        code, out, err = run("fit", "s.nc", "--model", "facets.py", *words)
        assert code in (0, 1), err
        found = json.loads(out)
        assert found["model"] == "facets_by_file"
        assert {"rho[red]", "rho[green]", "s", "alpha"} <= set(found["parameters"])

    def test_design(self, run):
        self.tiny()
        words = ("--instrument", "tiny.toml", "--budget", "6", "-o", "plan.toml", *SPELLED)
        code, _, err = run("design", "--model", "facets.py", *words)
        assert code == 0, err
        assert "theta_i_deg" in Path("plan.toml").read_text(encoding="utf-8")

    @staticmethod
    def tiny(channels: str = "") -> None:
        """Write tiny.toml, an instrument of 52 x 52 pixels."""
        text = (ROOT / "data" / "instruments" / "ideal12.toml").read_text(encoding="utf-8")
        for old, new in (
            ("rows = 1664", "rows = 208"),
            ("columns = 1664", "columns = 208"),
            ("pitch_um = [3.45, 3.45]", "pitch_um = [27.6, 27.6]"),
        ):
            assert text.count(old) == 1
            text = text.replace(old, new)
        if channels:
            first, *others = channels.split(",")
            text = text.replace('name = "" ', f'name = "{first}" ')
            text += "".join(f'[[channels]]\nname = "{n}"\n' for n in others)
        Path("tiny.toml").write_text(text, encoding="utf-8")

    def test_check(self, run):
        code, out, err = run("check", "facets.py", *SPELLED)
        assert code == 0, err
        assert "facets_by_file" in out

    def test_evaluate_and_models(self, run):
        where = "theta_i,phi_i,theta_r,phi_r\n30,0,30,180\n"
        Path("angles.csv").write_text(where, encoding="utf-8")
        code, out, err = run("evaluate", "facets.py", "--angles", "angles.csv", *SPELLED)
        assert code == 0, err
        f = TRUTH["rho"] / np.pi + TRUTH["s"] / (4 * np.pi * TRUTH["alpha"] ** 2)
        assert float(out.split(",")[-1]) == pytest.approx(f, rel=1e-12)
        code, out, err = run("models", "facets.py")
        assert code == 0, err
        assert "facets_by_file" in out

    def test_render(self, run):
        words = ("--size", "12x12", "--samples", "1", "-o", "ball.png", *SPELLED)
        code, _, err = run("render", "sphere", "--model", "facets.py", *words)
        assert code == 0, err
        assert Path("ball.png").exists()


class TestPython:
    def test_simulate_reduce_and_fit(self, tmp_path):
        session = gonio.simulate(
            model=OWN,
            parameters=TRUTH,
            instrument=small("ideal12", 52),
            plan=Plan(theta_i_deg=(10.0, 40.0), rotations_deg=(0.0,), exposures_s=(1e-3, 32e-3)),
            output=tmp_path / "s.gonio",
            seed=1,
        )
        assert read_truth(session.path)["model"] == "facets"
        result = gonio.fit(gonio.reduce(session), OWN)
        assert result.status == "converged"
        near_truth(result)

    def test_a_sum_with_it_is_simulated_as_the_whole(self):
        plan = Plan(theta_i_deg=(10.0,), rotations_deg=(0.0,), exposures_s=(1e-2,))
        models.get(OWN)
        parts = {"rho_1": 0.1, "rho_2": 0.2, "s": 0.2, "alpha": 0.25}
        rig = small("ideal12", 26)
        image = ("sample", 0, 0, [1.0])
        whole = images(rig, plan, "facets", **TRUTH).rates(*image)
        summed = images(rig, plan, "lambert+facets", **parts).rates(*image)
        np.testing.assert_allclose(summed, whole, rtol=1e-12)

    @pytest.mark.parametrize("sampler", ["marginal", "emcee"])
    def test_fit_with_each_sampler(self, sampler):
        result = gonio.fit(measured(80), OWN, posterior=True, sampler=sampler, seed=1)
        assert result.posterior.converged
        near_truth(result)

    def test_fit_with_each_loss_engine_and_weights(self):
        samples = measured()
        for loss in ("chi2", "log", "cube_root", "student_t"):
            result = gonio.fit(samples, OWN, loss=loss)
            assert result.values() == pytest.approx(TRUTH, rel=0.05)
        for options in ({"engine": "lbfgs"}, {"engine": "bobyqa"}, {"weights": "coscos"}):
            assert gonio.fit(samples, OWN, **options).values() == pytest.approx(TRUTH, rel=0.05)

    def test_fit_with_shared_errors_learnt_from_the_data(self):
        image = np.unique(directions().theta_i, return_inverse=True)[1]
        lamp = SharedTerm("lamp", "lamp", 0.01, image)
        samples = measured(shared=(SharedTerm("standard", "standard", 0.005), lamp), image=image)
        result = gonio.fit(samples, OWN, nuisance="all", posterior=True, seed=2)
        assert len(result.nuisance) >= 2
        near_truth(result)

    def test_fixed_and_tied(self):
        result = gonio.fit(measured(), OWN, fixed={"alpha": 0.25}, posterior=True, seed=3)
        assert result.parameters["alpha"].value == 0.25
        near = {"rho": TRUTH["rho"], "s": TRUTH["s"]}
        assert {n: result.values()[n] for n in near} == pytest.approx(near, rel=0.02)
        tied = gonio.fit(measured(), OWN, tied={"s": "rho"}).values()
        assert tied["s"] == tied["rho"]

    def test_parts_share_parameters(self):
        parts = {"one": measured(), "two": measured(seed=2)}
        result = gonio.fit(parts, OWN, share="s,alpha")
        assert set(result.values()) == {"rho[one]", "rho[two]", "s", "alpha"}
        assert result.values()["alpha"] == pytest.approx(TRUTH["alpha"], rel=0.02)

    def test_texels(self):
        where = directions(60)
        levels = np.array([0.1, 0.2, 0.3])
        values = np.stack([lobe(where, **TRUTH | {"rho": rho}) for rho in levels])
        found = fit_texels(where, values, OWN, u=0.001)
        assert found.count("converged") == 3
        expected = [[rho, TRUTH["s"], TRUTH["alpha"]] for rho in levels]
        np.testing.assert_allclose(found.parameters, expected, rtol=1e-4)

    def test_compare(self):
        found = gonio.compare(measured(), ["lambert", OWN, "phong"])
        assert found.entries[0].model == "facets"

    def test_design_and_its_verification(self):
        rig = small("ideal12", 52)
        result = gonio.design(OWN, TRUTH, instrument=rig, budget=6, verify=2)
        assert result.plan.n_images <= 6
        assert result.verification is not None

    def test_check_evaluate_and_render(self):
        assert gonio.check(OWN, TRUTH).passed
        where = directions(20)
        np.testing.assert_allclose(
            gonio.evaluate(OWN, where, TRUTH), lobe(where, **TRUTH), rtol=1e-12
        )
        picture = gonio.render(
            "sphere", rendering.Directional(), OWN, TRUTH, size=(9, 9), samples=1
        )
        assert picture[4, 4] > 0
        bounced = gonio.render(
            "objects", rendering.Directional(), OWN, TRUTH, size=(9, 9), samples=1, bounces=1
        )
        assert np.isfinite(bounced).all()

    def test_plot_and_report(self, tmp_path):
        samples = measured()
        result = gonio.fit(samples, OWN, posterior=True, seed=1)
        for kind in ("lobe", "albedo"):
            gonio.plot(OWN, kind, parameters=TRUTH)
        for kind in ("summary", "slices", "residuals"):
            gonio.plot(result, kind, samples=samples)
        page = gonio.report(result, samples=samples)
        assert "facets" in page.html
        path = tmp_path / "fit.json"
        result.save(path)
        assert gonio.report(path).html
