"""Which model: truths come first, nested models stay together, linear models have exact values."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gonio import formats, models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.comparison import predictive_scores
from gonio.fitting.comparison.compare import compare
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm

WARD = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.2, "alpha_y": 0.25}
ISOTROPIC = {"rho_d": 0.2, "rho_s": 0.1, "alpha": 0.2}


def scans(name, truth, *, noise=0.02, stated=True, seed=5, n=60, incidences=(0, 15, 30, 45, 60)):
    """Samples of a model: each incidence viewed in n directions, noise a share of the median."""
    rng = np.random.default_rng(seed)
    theta_i = np.radians(np.repeat(np.array(incidences, float), n))
    theta_r = np.radians(np.tile(np.linspace(0, 70, n), len(incidences)))
    phi_r = rng.choice([np.pi, 0.9 * np.pi, np.pi / 2, 0.0], len(theta_i))
    directions = Directions(theta_i, 0 * theta_i, theta_r, phi_r)
    f = models.get(name)(directions, **truth)
    sd = noise * np.median(f)
    value = f + sd * rng.standard_normal(len(f))
    return BRDFSamples(directions, value, np.full(len(f), sd) if stated else None)


@pytest.fixture(scope="module")
def matt():
    return scans("lambert", {"rho": 0.5})


@pytest.fixture(scope="module")
def matt_compared(matt):
    return compare(matt, ["oren_nayar", "lambert"], seed=2)


# ---------------------------------------------------------------- known truths


@pytest.mark.parametrize(
    ("name", "truth", "rival"),
    [
        ("ward", WARD, "ward_duer"),
        ("ward_duer", WARD, "ward"),
        ("oren_nayar", {"rho": 0.7, "sigma": np.radians(25)}, "lambert"),
    ],
)
def test_the_true_model_comes_first_by_every_criterion(name, truth, rival):
    found = compare(scans(name, truth), [rival, name])
    assert [e.model for e in found.entries] == [name, rival]
    assert found.noise_model == name
    assert found.ok
    other = found.entry(rival)
    assert other.held_out.told_apart
    assert other.loo.told_apart
    assert other.held_out.difference < -8
    assert other.loo.difference < -8
    assert found.best.log_evidence > other.log_evidence + 5
    assert found.conclusion == (
        f"Of these models {name} fits. By the held-out score {name} predicts better than every "
        "other model scored."
    )


def test_noise_of_unknown_size_is_estimated_from_the_scatter():
    found = compare(scans("ward_duer", WARD, stated=False), ["ward", "ward_duer"])
    assert found.best.model == "ward_duer"
    assert found.weights == "none"
    sd = 0.02 * np.median(models.get("ward_duer")(scans("ward_duer", WARD).directions, **WARD))
    assert found.noise_scale == pytest.approx(sd, rel=0.15)
    # One incidence makes nearly all of the difference: no scatter to judge it by, and it is said.
    other = found.entries[1].held_out
    assert not other.told_apart
    assert other.difference < -2 * found.best.held_out.stderr
    assert f"though it predicts better than ward at {other.worse} of 5 incidences" in (
        found.conclusion
    )
    assert "the scatter of its weighted residuals" in found.notes[0]
    assert "This noise includes the misfit" in found.notes[0]


def test_errors_that_the_samples_state_are_the_noise(matt, matt_compared):
    assert matt_compared.notes[0].endswith("fits best: the stated uncertainties times 1.")
    far = replace(matt, u_independent=matt.u_independent / 3)
    found = compare(far, ["oren_nayar", "lambert"])
    assert found.noise_scale == pytest.approx(3, rel=0.1)
    assert "This noise includes the misfit" in found.notes[0]
    # Scaled back to the scatter, the scores are those of the uncertainties as they were.
    same = matt_compared.entry("lambert").held_out
    assert found.entry("lambert").held_out.value == pytest.approx(same.value, abs=2)


def test_a_parameter_that_is_zero_is_not_distinguished_from_none(matt_compared):
    other = matt_compared.entries[1]
    assert not other.held_out.told_apart
    assert "cannot distinguish" in matt_compared.conclusion
    assert other.model in matt_compared.conclusion


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_axes_of_an_isotropic_surface_are_not_distinguished(seed):
    samples = scans("ward_isotropic", ISOTROPIC, seed=seed)
    found = compare(samples, ["ward_isotropic", "ward"])
    assert not found.entries[1].held_out.told_apart
    # Occam: the wider prior of the second axis costs evidence.
    evidence = {e.model: e.log_evidence for e in found.entries}
    assert evidence["ward_isotropic"] > evidence["ward"]


@pytest.mark.parametrize(("paint", "nm"), [("garnet_red", 650), ("krylon_blue", 450)])
def test_duer_before_ward_on_the_paints_of_cornell(real_data, paint, nm):
    path = real_data / "cornell" / f"{paint}.brdf"
    samples = formats.read(path, select={"wavelength": str(nm)})
    samples = samples.limited(max_theta_i=np.radians(65), max_theta_r=np.radians(70))
    found = compare(samples, ["ward", "ward_duer"], weights="coscos")
    assert found.noise_model == "ward_duer"
    assert [e.model for e in found.entries] == ["ward_duer", "ward"]
    assert found.entries[1].loo.difference < 0
    assert found.best.log_evidence > found.entries[1].log_evidence
    assert [round(g["theta_i_deg"]) for g in found.groups] == [10, 20, 30, 40, 50, 60]


# ---------------------------------------------------------------- exact values


def test_evidence_of_a_linear_model_is_the_integral(matt, matt_compared):
    entry = matt_compared.entry("lambert")
    sd = matt_compared.noise_scale * matt.u_independent
    # y = rho/pi + noise, rho flat in 0..1: a Gaussian integral, far from both ends.
    rho, var = np.pi * matt.value.mean(), np.pi**2 * sd[0] ** 2 / len(matt)
    peak = np.sum(stats.norm.logpdf(matt.value, rho / np.pi, sd))
    exact = peak + 0.5 * np.log(2 * np.pi * var)
    assert entry.log_evidence_stderr < 0.02
    assert abs(entry.log_evidence - exact) < 4 * entry.log_evidence_stderr


def test_leave_one_out_of_a_linear_model_is_exact(matt, matt_compared):
    sd = matt_compared.noise_scale * matt.u_independent[0]
    n = len(matt)
    others = (matt.value.sum() - matt.value) / (n - 1)
    exact = stats.norm.logpdf(matt.value, others, sd * np.sqrt(1 + 1 / (n - 1)))
    entry = matt_compared.entry("lambert")
    assert entry.loo.value == pytest.approx(exact.sum(), abs=0.05)
    assert entry.loo.stderr == pytest.approx(np.sqrt(n) * exact.std(ddof=1), rel=0.01)
    assert entry.loo_k_hat < 0.7


def test_held_out_density_is_that_of_the_whole_group(matt):
    """A shared scale and an offset of each image, against the dense covariance."""
    image = np.repeat(np.arange(5), 60)
    scale = SharedTerm("scale", "common", relative=0.03)
    offset = SharedTerm("lamp", "by image", group=image, relative=0.0, offset=np.full(300, 0.004))
    samples = replace(matt, shared=(scale, offset))
    found = compare(samples, ["lambert", "oren_nayar"])
    sd = found.noise_scale * matt.u_independent[0]
    exact = []
    for k in range(5):
        inside = image == k
        mean = matt.value[~inside].mean()
        # The common scale moves the prediction as it moves the samples and cancels; the lamp of
        # this image is its own, the mean of the four others is in the prediction.
        rank_one = sd**2 / 240 + 0.004**2 * (1 + 1 / 4)
        covariance = sd**2 * np.eye(60) + rank_one
        exact.append(
            stats.multivariate_normal.logpdf(matt.value[inside], np.full(60, mean), covariance)
        )
    entry = found.entry("lambert")
    assert entry.held_out_by_group == pytest.approx(exact, abs=1e-6)
    assert entry.held_out.value == pytest.approx(sum(exact))
    assert entry.held_out.stderr == pytest.approx(np.sqrt(5) * np.std(exact, ddof=1))
    assert any("(scale, lamp) are in the held-out predictions and not" in n for n in found.notes)


def test_too_many_draws_of_a_shared_error_are_left_out_and_said(matt, monkeypatch):
    monkeypatch.setattr(predictive_scores, "MAX_SHARED", 3)
    lamp = SharedTerm("lamp", "by image", group=np.repeat(np.arange(5), 60), relative=0.01)
    found = compare(replace(matt, shared=(lamp,)), ["lambert", "oren_nayar"])
    assert "the held-out score leaves out lamp: each has more than 3 draws." in found.best.notes


def test_a_degenerate_sum_predicts_as_its_one_known_direction(matt):
    found = compare(matt, ["lambert", "lambert+lambert"])
    double = found.entry("lambert+lambert")
    assert double.undetermined == ("rho_1", "rho_2")
    assert double.held_out_by_group == pytest.approx(found.entry("lambert").held_out_by_group)
    assert double.log_evidence is None
    assert "no evidence: not determined: rho_1, rho_2." in double.notes


def test_a_sum_at_its_limit_is_at_a_bound(matt):
    p = {"rho_d": 0.7, "rho_s": 0.6, "alpha_x": 0.2, "alpha_y": 0.3}  # more than there is
    f = models.get("ward_gmd")(matt.directions, **p)
    noise = 0.01 * f * np.random.default_rng(1).standard_normal(len(f))
    found = compare(replace(matt, value=f + noise, u_independent=0.01 * f), ["ward_gmd", "lambert"])
    entry = found.entry("ward_gmd")
    assert entry.at_bound == ("rho_d", "rho_s")
    assert entry.undetermined == ()
    assert "no evidence: at a bound: rho_d, rho_s." in entry.notes


# ---------------------------------------------------------------- what is not known is None


def test_no_evidence_at_a_bound():
    samples = scans("lambert", {"rho": 0.5}, seed=8)
    entry = compare(samples, ["oren_nayar", "lambert"]).entry("oren_nayar")
    assert entry.at_bound == ("sigma",)
    assert entry.log_evidence is None
    assert entry.log_evidence_stderr is None
    assert "no evidence: at a bound: sigma." in entry.notes


def test_few_incidences_give_no_held_out_score():
    samples = scans("lambert", {"rho": 0.5}, incidences=(10, 30, 60))
    found = compare(samples, ["lambert", "oren_nayar"])
    assert all(e.held_out is None for e in found.entries)
    assert all(e.loo is not None for e in found.entries)
    assert any(n.startswith("no held-out score: the samples have 3 groups") for n in found.notes)
    assert ". By the leave-one-out score the data cannot distinguish" in found.conclusion


def test_bad_importance_weights_are_flagged_and_give_no_evidence(monkeypatch, matt):
    monkeypatch.setattr(predictive_scores, "MAX_K_HAT", -5.0)
    entry = compare(matt, ["lambert", "oren_nayar"]).entry("lambert")
    assert entry.log_evidence is None
    assert any(n.startswith("no evidence: the importance weights fail (k-hat") for n in entry.notes)
    assert any("for 300 of 300 samples" in n for n in entry.notes)


def test_leave_one_out_from_a_part_of_many_samples(monkeypatch, matt, matt_compared):
    monkeypatch.setattr(predictive_scores, "LOO_SAMPLES", 100)
    found = compare(matt, ["lambert", "oren_nayar"])
    whole = matt_compared.entry("lambert").loo
    part = found.entry("lambert").loo
    assert abs(part.value - whole.value) < 4 * part.stderr
    assert part.stderr > 1.2 * whole.stderr
    assert any("estimated from 100 of 300 samples" in n for n in found.notes)


def test_progress_counts_the_models(matt):
    seen = []
    compare(
        matt, ["oren_nayar", "lambert"], progress=lambda done, total: seen.append((done, total))
    )
    assert seen == [(1, 2), (2, 2)]


def test_scattered_incidences_make_few_groups():
    theta_i = np.random.default_rng(1).uniform(0, 1.3, 500)
    groups = predictive_scores.incidence_groups(theta_i)
    assert 10 < len(groups) <= predictive_scores.MAX_GROUPS
    assert np.array_equal(np.sort(np.concatenate(groups)), np.arange(500))
    assert max(np.ptp(theta_i[g]) for g in groups) < np.radians(8)


def test_one_seed_one_result_whatever_threads_and_order(matt):
    first = compare(matt, ["oren_nayar", "lambert"], seed=7, threads=1)
    again = compare(matt, ["lambert", "oren_nayar"], seed=7, threads=2)
    other = compare(matt, ["oren_nayar", "lambert"], seed=8)
    assert first.to_json() == again.to_json()
    assert first.entry("lambert").log_evidence != other.entry("lambert").log_evidence


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["ward"], "a comparison needs at least two models and got ward;"),
        ([], "a comparison needs at least two models and got none;"),
        ("ward", "a comparison needs at least two models and got ward;"),
        (["ward", "ward_duers"], "unknown model 'ward_duers': did you mean 'ward_duer'"),
        (["ward", "ward"], "model ward is given twice; give it once."),
    ],
)
def test_models_that_cannot_be_compared(matt, names, text):
    with pytest.raises(ConfigurationError, match=text):
        compare(matt, names)


def test_no_noise_to_judge_by(matt):
    exact = replace(matt, value=np.full(300, 0.1), u_independent=None)
    with pytest.raises(DataError, match="there is no noise to judge the other models by"):
        compare(exact, ["lambert", "oren_nayar"])


# ---------------------------------------------------------------- the command


@pytest.fixture
def table(tmp_path, matt):
    def write(channels=()):
        d = matt.directions
        angles = [np.degrees(a) for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)]
        lines = ["theta_i,phi_i,theta_r,phi_r,brdf,u_brdf" + (",channel" if channels else "")]
        for k, row in enumerate(zip(*angles, matt.value, matt.u_independent, strict=True)):
            cells = [repr(float(v)) for v in row]
            lines.append(",".join([*cells, *channels[k % 2 : k % 2 + 1]]))
        path = tmp_path / "samples.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write


def test_the_table_fits_eighty_columns(gonio, table, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "80")
    target = tmp_path / "compared.json"
    code, out, err = gonio("compare", table(), "--models", "oren_nayar, lambert", "-o", target)
    assert code == 0
    assert f"written to {target}" in err
    assert "300 samples, 5 incidences; weights: 1/uncertainty" in out
    rows = out.split("held-out score of")[0].splitlines()[1:]
    assert max(map(len, rows)) <= 80
    header = next(line for line in rows if "model" in line)
    assert header.split() == ["model", "verdict", "P", "chi2/dof", "held-out", "LOO", "log", "Z"]
    assert "cannot distinguish" in out
    assert "status: all converged" in out
    data = json.loads(target.read_text(encoding="utf-8"))
    assert data["schema"] == "gonio.compare/1"
    assert data["source"]["input"].endswith("samples.csv")


def test_json_is_one_document_with_cuts(gonio, table):
    code, out, _ = gonio(
        "compare", table(channels=("red", "green")), "--models", "lambert,oren_nayar", "--select",
        "channel=red", "--max-theta-r", "60", "--max-theta-i", "50", "--weights", "cos", "--json",
        "--seed", "4",
    )  # fmt: skip
    assert code == 0
    data = json.loads(out)
    assert data["cuts"] == {
        "select": {"channel": "red"}, "max_theta_i_deg": 50.0, "max_theta_r_deg": 60.0,
    }  # fmt: skip
    assert (data["weights"], data["seed"]) == ("cos", 4)
    assert len(data["groups"]) == 4
    assert {e["model"] for e in data["entries"]} == {"lambert", "oren_nayar"}


def test_refusals_of_the_command(gonio, table):
    code, _, err = gonio("compare", table(), "--models", "lambert")
    assert code == 2
    assert "--models 'lambert': give two models at least" in err
    code, _, err = gonio("compare", table(), "--models", "lambert,wardd")
    assert code == 2
    assert "unknown model 'wardd': did you mean 'ward'" in err
    code, _, err = gonio("compare", table(("red", "green")), "--models", "lambert,ward")
    assert code == 2
    assert "holds 2 channels; choose one with --select channel=VALUE" in err
