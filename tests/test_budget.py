"""The uncertainty budget: what every source does to f, and what is not counted."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from virtual import Drawn, images, small

import gonio
from gonio import cli, models
from gonio.calibration.budget import budget
from gonio.errors import DataError
from gonio.fitting.fit import fit
from gonio.geometry import Directions, angles, unit_vectors
from gonio.metadata import Plan
from gonio.samples import BRDFSamples, SharedTerm

PER_IMAGE = 400


def hemisphere(n_images: int = 4, u: float = 1e-3, seed: int = 0) -> BRDFSamples:
    """f = 0.5 + 0.2 x on the upper hemisphere, two rotations at each of two incidences."""
    rng = np.random.default_rng(seed)
    k = np.arange(PER_IMAGE) + 0.5
    # Spread evenly, as a sunflower's seeds.
    theta_r = np.arccos(1 - 0.8 * k / PER_IMAGE)
    phi_r = k * np.pi * (3 - np.sqrt(5))
    image = np.repeat(np.arange(n_images), PER_IMAGE)
    theta_i = np.radians(np.array([10.0, 10.0, 50.0, 50.0]))[image]
    theta_r, phi_r = np.tile(theta_r, n_images), np.tile(phi_r, n_images)
    f = 0.5 + 0.2 * unit_vectors(theta_r, phi_r)[:, 0]
    return BRDFSamples(
        Directions(theta_i, 0.0, theta_r, phi_r),
        f + u * rng.standard_normal(len(f)),
        u_independent=np.full(len(f), u),
        u_reference=np.full(len(f), 0.6 * u),
        reference_sharing=2,
        image=image,
        metadata={"unknown": ["the weather"]},
    )


def with_terms(samples: BRDFSamples, *terms: SharedTerm) -> BRDFSamples:
    return replace(samples, shared=terms)


def rows(samples: BRDFSamples, at=None) -> dict[str, dict]:
    return {row["name"]: row for row in budget(samples).describe(at)["sources"]}


def test_noise_is_parted_into_that_of_the_sample_and_that_of_the_reference():
    samples = hemisphere()
    found = rows(samples)
    relative = 1e-3 / samples.value
    for name, part in (("noise, sample", 0.8), ("noise, reference", 0.6)):
        expected = np.percentile(part * relative, [50, 5, 95])
        seen = [found[name]["relative"][key] for key in ("median", "p5", "p95")]
        np.testing.assert_allclose(seen, expected, rtol=1e-12)
        assert found[name]["share_of_variance"] == pytest.approx(part**2)
        assert (found[name]["kind"], found[name]["acts"]) == ("A", "offset")
    assert found["noise, sample"]["shared_by"] == "sample"
    assert found["noise, reference"]["shared_by"] == "2 images"


def test_sources_add_in_squares_and_shares_to_one():
    samples = hemisphere()
    samples = with_terms(
        samples,
        SharedTerm("standard", "reflectance", 0.03),
        SharedTerm("shape", "of the standard", 0.04, profile=samples.directions.theta_r),
        SharedTerm("stray", "light", offset=np.full(len(samples), -0.002)),
        SharedTerm("lamp", "drift", 0.01, offset=0.003 * samples.directions.theta_r),
    )
    f, t = samples.value, samples.directions.theta_r
    expected = np.sqrt(1e-6 + (0.03 * f) ** 2 + (0.04 * t * f) ** 2 + 4e-6
                       + (0.01 * f + 0.003 * t) ** 2)  # fmt: skip
    found = budget(samples)
    np.testing.assert_allclose(found.combined, expected, rtol=1e-12)
    report = found.describe()
    assert report["combined"]["median"] == pytest.approx(np.median(expected / f))
    assert report["expanded"]["p95"] == pytest.approx(2 * report["combined"]["p95"])
    assert sum(row["share_of_variance"] for row in report["sources"]) == pytest.approx(1)
    acts = {row["name"]: row["acts"] for row in report["sources"]}
    assert acts["shape"] == "factor"
    assert acts["stray"] == "offset"
    assert acts["lamp"] == "factor and offset"


def test_what_a_term_has_in_common_follows_from_its_groups():
    samples = hemisphere()
    incidence = samples.image // 2
    groups = {
        "image": samples.image,
        "incidence": incidence,
        "all": None,
        "incidences": np.where(samples.image == 3, 1, 0),
    }
    terms = [SharedTerm(name, "", 0.01, group) for name, group in groups.items()]
    terms.append(SharedTerm("one group", "", 0.01, np.zeros(len(samples), int)))
    found = rows(with_terms(samples, *terms))
    for name in groups:
        assert found[name]["shared_by"] == name
    assert found["one group"]["shared_by"] == "all"


def along_x(samples: BRDFSamples, size: float) -> np.ndarray:
    """Shifts of one size towards +x, across each direction."""
    _, w = samples.directions.vectors()
    x = np.array([1.0, 0, 0]) - w[:, :1] * w
    return size * x / np.linalg.norm(x, axis=1, keepdims=True)


def test_a_shift_counts_by_the_slope_of_f_over_the_neighbours():
    samples = hemisphere(u=1e-6)
    shift = along_x(samples, 0.01)
    found = budget(with_terms(samples, SharedTerm("tilt", "", shift=shift)))
    (source,) = (s for s in found.sources if s.name == "tilt")
    # df = 0.2 dx, and a step along the sphere of 0.01 moves x by 0.01 sqrt(1 - x^2).
    expected = 0.2 * shift[:, 0]
    # Cells are 5 deg apart: f bends within them at the edge of the cap.
    np.testing.assert_allclose(source.u, expected, atol=2e-4)
    assert np.median(np.abs(source.u / expected - 1)) < 0.01
    assert source.acts == "turns"
    # A step across the slope changes nothing.
    _, w = samples.directions.vectors()
    across = 0.01 * np.cross(w, along_x(samples, 1.0))
    (none,) = budget(with_terms(samples, SharedTerm("t", "", shift=across))).sources[2:]
    assert np.median(none.u) < 0.02 * np.median(expected)


def test_noise_does_not_pass_for_a_slope():
    # Even light: what noise makes of a shift by ten cells' distances would be as large as f.
    samples = hemisphere(u=0.05)
    samples = replace(samples, value=samples.value - 0.2 * samples.directions.vectors()[1][:, 0])
    shift = along_x(samples, 0.5)
    (source,) = budget(with_terms(samples, SharedTerm("tilt", "", shift=shift))).sources[2:]
    # A plane through ten points with noise s at distances of 0.1 has slopes of s/0.1/sqrt(10).
    raw = 0.5 * 0.05 / 0.1 / np.sqrt(10)
    assert np.sqrt(np.mean(source.u**2)) < 1.1 * raw
    assert np.median(source.u) < 0.3 * raw


def test_the_effect_of_a_shift_is_that_of_a_fit():
    ward = models.get("ward")
    p = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.25, "alpha_y": 0.25}
    samples = hemisphere(u=1e-4)
    w_i, w_r = samples.directions.vectors()
    f = ward.evaluate(w_i, w_r, ward.vector(p))
    samples = replace(samples, value=f)
    shift = along_x(samples, 0.004)
    term = SharedTerm("tilt", "", shift=shift)
    (source,) = budget(with_terms(samples, term)).sources[2:]
    moved = [ward.evaluate(w_i, w_r + s * shift, ward.vector(p)) for s in (1, -1)]
    expected = np.abs(moved[0] - moved[1]) / 2
    steep = expected > 0.3 * expected.max()
    assert np.median(source.u[steep] / expected[steep]) == pytest.approx(1, abs=0.1)


def test_a_blur_is_left_to_the_fit():
    report = budget(with_terms(hemisphere(), SharedTerm("cone", "", blur=0.01))).describe()
    (cone,) = (row for row in report["sources"] if row["name"] == "cone")
    assert cone["acts"] == "blurs"
    assert cone["relative"] is None
    assert cone["share_of_variance"] is None
    json.dumps(report, allow_nan=False)


def test_one_sample_and_the_nearest_to_given_directions():
    samples = with_terms(hemisphere(), SharedTerm("standard", "", 0.03))
    found = budget(samples)
    k = found.nearest(np.radians(48), 0.0, *angles(samples.directions.vectors()[1][1000]))
    assert k == 1000  # its twin at the other rotation of 50 deg comes later
    report = found.describe(k)
    assert report["at"]["theta_i"] == pytest.approx(50)
    assert report["at"]["value"] == samples.value[1000]
    only = {row["name"]: row["relative"] for row in report["sources"]}
    assert only["standard"]["median"] == pytest.approx(0.03)
    assert only["noise, sample"]["median"] == pytest.approx(8e-4 / samples.value[1000])


def test_samples_that_are_0_within_their_noise_are_left_out():
    samples = hemisphere()
    value = samples.value.copy()
    value[:100] = 0.001
    report = budget(replace(samples, value=value)).describe()
    assert report["n_left_out"] == 100
    assert report["combined"]["p95"] < 0.01
    dark = budget(replace(samples, value=np.zeros(len(value))))
    with pytest.raises(DataError, match="every sample is 0 within its noise: relative"):
        dark.describe()


def test_samples_without_uncertainty_are_refused():
    samples = BRDFSamples(Directions([0.1], 0, [0.2], 0), np.array([0.3]))
    with pytest.raises(DataError, match="state no uncertainty; reduce a session, or give a file"):
        budget(samples)
    stated = replace(samples, u_independent=np.array([0.01]))
    (source,) = budget(stated).sources
    assert source.meaning == "as the file states it"
    assert budget(stated).unknown == ("everything that the file does not state",)


def test_an_offset_goes_through_a_fit():
    """A fit moves by what the offset adds, whatever the value of a sample is."""
    samples = hemisphere()
    lambert = replace(samples, value=np.full(len(samples), 0.2), noise_slope=None, u_reference=None)
    stray = with_terms(lambert, SharedTerm("stray", "", offset=np.full(len(samples), 0.004)))
    errors = fit(stray, model="lambert").parameters["rho"].components
    assert errors["stray"] == pytest.approx(0.004 * np.pi, rel=1e-6)


# ---------------------------------------------------------------- the command


@pytest.fixture(scope="module")
def reduced(tmp_path_factory):
    rig = small(n=52, lamp={"drift": 0.003}, standard={"uncertainty": 0.005})
    plan = Plan(theta_i_deg=(10.0, 45.0), rotations_deg=(0.0,), exposures_s=(1e-3, 16e-3))
    path = tmp_path_factory.mktemp("budget") / "clay.nc"
    gonio.reduce(Drawn(images(rig, plan, rho=0.4))).save(path)
    return path


def run(capsys, *words):
    with pytest.raises(SystemExit) as left:
        cli.main(["budget", *map(str, words)])
    return left.value.code, *capsys.readouterr()


def test_the_table(reduced, capsys):
    code, out, err = run(capsys, reduced)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert max(map(len, lines)) <= 80
    start = next(k for k, line in enumerate(lines) if line.startswith("source "))
    rows = [line for line in lines[start + 1 :] if line[:1].isalpha()]
    table = {line[:22].strip(): line[22:].split() for line in rows}
    assert table["standard"][:4] == ["B", "all", "factor", "0.5"]
    assert table["lamp, sample"][:3] == ["B", "incidence", "both"]
    assert table["noise, sample"][:3] == ["A", "sample", "offset"]
    assert len(table["combined"]) == 3
    assert "UNKNOWN, not counted: lens calibration (lens.uncertain)." in lines


def test_columns_do_not_run_together_with_rotations(reduced, tmp_path, capsys, monkeypatch):
    samples = BRDFSamples.load(reduced)
    # As of a session with rotations: a dome's slope errors are those of some incidences.
    groups = np.arange(len(samples)) % 3
    term = replace(samples.shared[0], name="dome slope, shear in plane and beyond it", group=groups)
    turned = replace(samples, shared=(term, *samples.shared))
    turned.save(tmp_path / "turned.nc")
    monkeypatch.chdir(tmp_path)
    for columns, gap in (("80", " "), ("120", "  ")):
        monkeypatch.setenv("COLUMNS", columns)
        _, out, _ = run(capsys, "turned.nc")  # a short name: it stands in the first line
        lines = out.splitlines()
        assert max(map(len, lines)) <= int(columns)
        at = next(k for k, line in enumerate(lines) if line.startswith("dome slope, shear in"))
        assert re.search(rf"B {gap}+incidences{gap}+[a-z]+ {gap}*[\d<]", lines[at])
        assert lines[at + 1] == "  and beyond it"


def test_the_document_and_one_sample(reduced, capsys):
    code, out, _ = run(capsys, reduced, "--json", "--at", "45,0,30,90")
    document = json.loads(out)
    assert code == 0
    assert document["schema"] == "gonio.budget/1"
    assert document["source"] == str(reduced)
    assert document["quantity"] == "BRDF"
    assert document["at"]["theta_i"] == pytest.approx(45)
    assert document["at"]["theta_r"] == pytest.approx(30, abs=8)  # cells are 15 deg wide
    assert document["coverage_factor"] == 2
    assert document["degrees_of_freedom"] is None
    _, text, _ = run(capsys, reduced, "--at", "45,0,30,90")
    assert f"sr^-1 at theta_i 45, phi_i 0, theta_r {document['at']['theta_r']:.4g}" in " ".join(
        text.split()
    )


@pytest.mark.parametrize("at", ["45,0,30", "a,b,c,d", "1,2,3,4,5"])
def test_directions_that_are_none(reduced, capsys, at):
    code, _, err = run(capsys, reduced, "--at", at)
    assert code == 2
    assert f"--at '{at}' is not four angles; write theta_i,phi_i,theta_r,phi_r in degrees" in err


def test_a_file_without_uncertainties(tmp_path, capsys):
    path = tmp_path / "bare.csv"
    path.write_text("theta_i,phi_i,theta_r,phi_r,brdf\n10,0,20,0,0.3\n", encoding="utf-8")
    code, _, err = run(capsys, path)
    assert code == 3
    assert "the samples state no uncertainty; reduce a session" in err


def test_a_selection_that_is_none(reduced, capsys):
    code, _, err = run(capsys, reduced, "--select", "red")
    assert code == 2
    assert "--select 'red': give KEY=VALUE" in err
