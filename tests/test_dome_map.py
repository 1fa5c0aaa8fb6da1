"""The map of a dome: its file, its use by the reduction, and a session under another's map."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gonio
from gonio import cli
from gonio.dome_map import DomeMap, is_dome_map
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import from_equal_area, unit_vectors
from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.tangent_field import FieldPrior, Nodes, tangents

RIG_SEED = 3


def command(*words: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as left:
        cli.main([str(word) for word in words])
    return int(left.value.code or 0), out.getvalue(), err.getvalue()


def drawn(seed: int = 0, informed: int = 20) -> DomeMap:
    """A map whose field and whose information are random."""
    rng = np.random.default_rng(seed)
    prior = FieldPrior(0.001, 0.004, float(np.radians(15)))
    nodes = Nodes.on_cap(prior, np.radians(80), 500)
    k = len(nodes)
    root = np.kron(np.eye(2), nodes.root)
    q, _ = np.linalg.qr(rng.normal(size=(2 * k, informed)))
    return DomeMap(
        rig="modern12 no. ea63f2b4", instrument="modern12", shape="ellipsoid", mapping="eq3",
        R=150.0, D=15.0, nodes=nodes, stated=prior,
        mean=(root @ rng.normal(size=2 * k)).reshape(2, k), gain=0.99 * root @ q,
        sessions=("a" * 64,), findings={"share": 0.9},
    )  # fmt: skip


def test_a_map_comes_back_from_its_file(tmp_path):
    dome = drawn()
    dome.save(tmp_path / "dome.nc")
    back = DomeMap.load(tmp_path / "dome.nc")
    assert is_dome_map(tmp_path / "dome.nc")
    assert (back.rig, back.sessions, back.findings) == (dome.rig, dome.sessions, dome.findings)
    assert back.nodes.prior == dome.nodes.prior
    w = unit_vectors(np.array([0.2, 0.9]), np.array([1.0, 3.0]))
    assert np.array_equal(back.displacement(w), dome.displacement(w))
    assert np.array_equal(back.sd(w)[0], dome.sd(w)[0])


def test_displacements_are_tangents_and_those_of_the_nodes_at_nodes():
    dome = drawn()
    nodes = dome.nodes.directions[:50]
    shift = dome.displacement(nodes)
    assert np.allclose(np.sum(shift * nodes, axis=1), 0, atol=1e-15)
    x, y = tangents(nodes)
    # The nugget of the prior leaves a part in a hundred.
    size = np.max(np.abs(dome.mean))
    assert np.allclose(np.sum(shift * x, axis=1), dome.mean[0, :50], atol=0.02 * size)
    assert np.allclose(np.sum(shift * y, axis=1), dome.mean[1, :50], atol=0.02 * size)
    corrected = dome.corrected(nodes)
    assert np.allclose(np.linalg.norm(corrected, axis=1), 1)
    assert np.allclose(corrected - nodes, shift, atol=size**2)


def test_pixels_without_a_direction_stay_so():
    nowhere = np.full((2, 3, 3), np.nan)
    assert np.all(np.isnan(drawn().corrected(nowhere)))


def test_what_is_left_is_the_ratio_of_dense_standard_deviations():
    dome = drawn()
    where = unit_vectors(np.array([0.3, 0.4]), np.array([0.2, 0.2]))
    tangent = np.array([[0.0, 1.0, 0.0]] * 2)
    near = dome.nodes.interpolation(where)
    k = len(dome.nodes)
    row = np.zeros(2 * k)
    for component, axis in enumerate(tangents(where)):
        for j, sign in enumerate((1.0, -1.0)):
            row[component * k + near.index[j]] += sign * (axis[j] @ tangent[j]) * near.weight[j]
    prior = np.kron(np.eye(2), dome.nodes.root @ dome.nodes.root.T)
    after = prior - dome.gain @ dome.gain.T
    expected = np.sqrt(row @ after @ row / (row @ prior @ row))
    assert dome.remaining(where, tangent, [1.0, -1.0]) == pytest.approx(expected, rel=1e-9)
    unknown = replace(dome, gain=1e-6 * dome.gain)
    assert unknown.remaining(where, tangent, [1.0, -1.0]) == 1.0


def test_interpolation_follows_the_process_between_nodes():
    """A draw on 1000 places given the nodes: the interpolation is good to a part of the sd."""
    prior = FieldPrior(1.0, 0.0, float(np.radians(12)))
    nodes = Nodes.on_cap(prior, np.radians(75), 600)
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-0.55, 0.55, size=(2, 400))
    places = from_equal_area(x, y)
    both = np.concatenate([nodes.directions, places])
    root = np.linalg.cholesky(prior.correlations(both, both) + 1e-9 * np.eye(len(both)))
    field = root @ rng.normal(size=len(both))
    found = nodes.interpolation(places)(field[: len(nodes)])
    assert np.std(found - field[len(nodes) :]) < 0.02


def test_nodes_have_the_tangents_of_the_zenith_everywhere():
    w = unit_vectors(np.array([0.0, 0.7, 1.5]), np.array([0.0, 2.0, -1.0]))
    x, y = tangents(w)
    for a, b, expected in ((x, x, 1), (y, y, 1), (x, y, 0), (x, w, 0), (y, w, 0)):
        assert np.allclose(np.sum(a * b, axis=1), expected, atol=1e-12)
    assert np.allclose(np.cross(x, y), w)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rig": "other"}, "the map is that of the dome of 'modern12 no. ea63f2b4'.*with 'other'"),
        ({"rig": None}, "with 'a rig without a name'"),
        ({"mapping": "exact"}, "reduce with --mapping eq3"),
        ({"session": "a" * 64}, "noise would count twice; fit its samples with --self-calibrate"),
    ],
)
def test_a_map_is_refused_where_it_does_not_belong(change, words):
    own = {"rig": "modern12 no. ea63f2b4", "shape": "ellipsoid", "mapping": "eq3", "session": "b"}
    drawn().check(**own)
    with pytest.raises(ConfigurationError, match=words):
        drawn().check(**(own | change))


def test_damaged_files_are_refused_in_a_sentence(tmp_path):
    path = tmp_path / "dome.nc"
    with pytest.raises(DataError, match="no such file; give a map of a dome"):
        DomeMap.load(path)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(DataError, match="not a readable map of a dome"):
        DomeMap.load(path)
    assert not is_dome_map(path)
    with pytest.raises(ConfigurationError, match=r"give a name that ends in \.nc"):
        drawn().save(tmp_path / "dome.txt")
    broken = replace(drawn(), mean=np.full_like(drawn().mean, np.nan))
    broken.save(path)
    with pytest.raises(DataError, match="a number is not finite"):
        DomeMap.load(path)


def test_sizes_are_checked_before_anything_is_read(tmp_path):
    import h5py

    path = tmp_path / "dome.nc"
    drawn().save(path)
    with h5py.File(path, "a") as file:
        scale = file.create_dataset("huge", shape=(10**12,), dtype="f8", chunks=(1024,))
        scale.make_scale("huge")
    with pytest.raises(DataError, match="are more than a map of a dome may hold"):
        DomeMap.load(path)


def test_samples_are_no_map(tmp_path):
    gonio.BRDFSamples(gonio.Directions(0.1, 0.0, [0.1], 0.0), [0.2]).save(tmp_path / "samples.nc")
    assert not is_dome_map(tmp_path / "samples.nc")
    with pytest.raises(DataError, match=r"the schema is 'gonio.samples/1', not 'gonio.dome/1'"):
        DomeMap.load(tmp_path / "samples.nc")


# ---------------------------------------------------------------- two sessions on one rig


@pytest.fixture(scope="module")
def rig(tmp_path_factory) -> tuple[Path, gonio.BRDFSamples, gonio.BRDFSamples]:
    """Folder with sessions of aluminum and brass on one rig, and their samples."""
    folder = tmp_path_factory.mktemp("rig")
    # Many rays a pixel: the lobe of a coarse camera is integrated well.
    virtual = preset("modern12").with_pixels(104).model_copy(update={"rays_per_pixel": 64})
    plan = Plan(
        theta_i_deg=(10, 15, 20, 25, 30, 35, 40, 45), rotations_deg=(0, 90),
        exposures_s=virtual.sensor.exposures_s,
    )  # fmt: skip
    for k, name in enumerate(("aluminum", "brass")):
        gonio.simulate(
            f"rolled_{name}", output=folder / name, instrument=virtual, plan=plan, seed=20 + k,
            rig_seed=RIG_SEED,
        )  # fmt: skip
    samples = [gonio.reduce(folder / name) for name in ("aluminum", "brass")]
    samples[0].save(folder / "aluminum.nc")
    return folder, samples[0], samples[1]


@pytest.fixture(scope="module")
def dome(rig) -> Path:
    folder, _, _ = rig
    code, out, err = command(
        "calibrate", "dome", folder / "aluminum.nc", "--model", "ward", "-o", folder / "dome.nc",
        "--json",
    )  # fmt: skip
    assert code == 0, err
    document = json.loads(out)
    assert document["schema"] == "gonio.calibrate.dome/1"
    assert document["rig"] == "modern12 no. ea63f2b4"
    assert document["failures"] == []
    assert document["findings"]["chi2_after"] == pytest.approx(1.0, abs=0.1)
    return folder / "dome.nc"


def test_samples_say_on_which_rig_they_were_measured(rig):
    _, one, two = rig
    for samples in (one, two):
        stated = samples.metadata["rig"]
        assert stated["identity"] == "modern12 no. ea63f2b4"
        assert (stated["R_mm"], stated["D_mm"], stated["shape"]) == (150.0, 15.0, "ellipsoid")
        assert (stated["slope_error_deg"], stated["rim_slope_error_deg"]) == (0.03, 0.2)
        turn = np.array(stated["turn_deg"])[samples.image]
        assert np.allclose(np.degrees(samples.directions.phi_i), -turn)
    assert one.metadata["session_sha256"] != two.metadata["session_sha256"]


def test_another_session_under_the_map(rig, dome):
    """chi2/dof falls to a third, and the widths of the other metal are good to 1e-3.

    The wider lobe of brass sees dome where that of aluminum never went.
    """
    folder, _, plain = rig
    mapped = gonio.reduce(folder / "brass", dome=dome)
    before, after = (gonio.fit(each, model="ward") for each in (plain, mapped))
    assert before.chi2 / before.dof > 8
    assert after.chi2 / after.dof < before.chi2 / before.dof / 3
    assert after.verdict.fits
    for name, true in (("alpha_x", 0.05), ("alpha_y", 0.16)):
        assert after.parameters[name].value == pytest.approx(true, rel=1e-3)
        assert after.parameters[name].stderr < before.parameters[name].stderr
    assert "corrected by a map of 1 other session(s)" in "\n".join(mapped.history)


def test_unvisited_dome_keeps_the_typical_terms(rig, dome):
    folder, _, plain = rig
    empty = replace(DomeMap.load(dome), mean=np.zeros_like(DomeMap.load(dome).mean))
    empty = replace(empty, gain=np.zeros_like(empty.gain))
    mapped = gonio.reduce(folder / "brass", dome=empty)
    for mine, theirs in zip(mapped.shared, plain.shared, strict=True):
        assert mine.name == theirs.name
        if mine.shift is not None:
            # Directions that a field of zeros corrects differ by rounding.
            assert np.allclose(mine.shift, theirs.shift, rtol=1e-9, atol=1e-15), mine.name


def test_a_session_is_not_reduced_with_its_own_map(rig, dome):
    folder, _, _ = rig
    code, _, err = command("reduce", folder / "aluminum", "--dome", dome, "-o", folder / "x.nc")
    assert code == 2
    assert "the map was made of this session" in err
    mapped = gonio.reduce(folder / "brass", dome=dome)
    with pytest.raises(ConfigurationError, match="were reduced with a map of the dome"):
        gonio.fit(mapped, model="ward", self_calibrate=True)


def test_a_map_is_drawn(dome, tmp_path):
    import matplotlib.pyplot as plt

    figure = gonio.plot(dome)
    titles = [ax.get_title() for ax in figure.axes]
    assert "dome of modern12 no. ea63f2b4" in titles
    plt.close(figure)
    with pytest.raises(ConfigurationError, match="it can be drawn as dome"):
        gonio.plot(dome, "frames")
    code, _, err = command("plot", dome, "-o", tmp_path / "dome.png")
    assert code == 0, err
    assert (tmp_path / "dome.png").stat().st_size > 10_000


def test_self_calibration_from_the_command_line(rig):
    folder, _, _ = rig
    code, out, err = command(
        "fit", folder / "aluminum.nc", "--model", "ward", "--self-calibrate", "--json"
    )
    assert code == 0, err
    document = json.loads(out)
    assert document["verdict"]["class"] == "fits"
    assert document["chi2"] / document["dof"] < 1.1
    assert document["diagnostics"]["self_calibration"]["notes"][0].startswith("self-calibrated: ")
