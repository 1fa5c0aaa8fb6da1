"""Figures of a camera from flat and dark frames, against frames of an independent camera."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from rig_files import change, small_rig
from scipy import stats

import gonio
from gonio import cli
from gonio.calibration.frames.photon_transfer import photon_transfer
from gonio.errors import ConfigurationError, DataError
from gonio.instrument import preset
from gonio.instrument.records import metadata
from gonio.metadata import Plan
from gonio.rig import session_file

N, WELL, TOP = 96, 10700.0, 4095
TRUE = {
    "gain_dn_per_e": 0.38, "black_dn": 64.0, "read_noise_e": 2.3, "dark_e_per_s": 20.0,
    "nonlinearity_per_decade": 0.005, "prnu": 0.006, "dsnu_e_per_s": 8.0,
}  # fmt: skip
TIMES = tuple((0.256 * np.geomspace(1 / 200, 1, 12)).tolist())
SEEDS = 40


class Camera:
    """A camera of numpy's random numbers alone, whose response is the stated law."""

    def __init__(self, seed, lamp=5e-4, black=TRUE["black_dn"], power=1.0, times=TIMES):
        rng = np.random.default_rng(seed)
        gain, spread = TRUE["gain_dn_per_e"], TRUE["dsnu_e_per_s"] ** 2 / TRUE["dark_e_per_s"]
        response = 1 + TRUE["prnu"] * rng.standard_normal((N, N))
        dark = rng.gamma(TRUE["dark_e_per_s"] / spread, spread, (N, N))
        light = 1.3 * (TOP - TRUE["black_dn"]) / gain / TIMES[-1]
        self.frames = {}
        for k, time in enumerate(times):
            for take in (0, 1):
                for role in ("flat", "dark"):
                    output = light * (1 + lamp * rng.standard_normal()) * (role == "flat")
                    e = np.minimum(rng.poisson(time * (output * response + dark)), WELL)
                    law = 1 + TRUE["nonlinearity_per_decade"] * np.log10(np.maximum(e, 1) / WELL)
                    e = WELL * (e * law / WELL) ** power
                    noise = TRUE["read_noise_e"] * rng.standard_normal((N, N))
                    counts = np.rint(gain * (e + noise) + black)
                    self.frames[role, k, take] = np.clip(counts, 0, TOP).astype(np.uint16)
        self.times = times

    def figures(self):
        return photon_transfer(lambda *key: self.frames[key], self.times, 2)


@pytest.fixture(scope="module")
def results():
    return [Camera(seed).figures() for seed in range(SEEDS)]


@pytest.mark.parametrize("name", TRUE)
def test_intervals_of_95_per_cent_hold(results, name):
    """What a camera draws once, such as its mean dark current, is part of what is uncertain."""
    once = TRUE["dsnu_e_per_s"] / N if name == "dark_e_per_s" else 0.0
    # The scatter of the light is itself estimated, from the exposures.
    dof = results[0].dof if name == "nonlinearity_per_decade" else np.inf
    k = stats.t.ppf(0.975, dof)
    figures = [result.figures[name] for result in results]
    hit = sum(abs(f.value - TRUE[name]) < k * np.hypot(f.u, once) for f in figures)
    assert stats.binomtest(hit, SEEDS, 0.95).pvalue > 0.01 / len(TRUE)


def test_they_are_precise_enough_to_be_of_use(results):
    """Relative standard uncertainties of frames of 96 x 96 pixels."""
    largest = {"gain_dn_per_e": 0.006, "read_noise_e": 0.008, "prnu": 0.02}
    for name, bound in largest.items():
        figure = results[0].figures[name]
        assert figure.u / figure.value < bound
    assert results[0].figures["nonlinearity_per_decade"].u < 5e-4


def test_saturation_and_full_well_are_those_of_the_converter(results):
    found = results[0].figures
    assert found["saturation_dn"].value == TOP
    expected = (TOP - TRUE["black_dn"]) / TRUE["gain_dn_per_e"]
    assert abs(found["full_well_e"].value - expected) < 3 * found["full_well_e"].u
    assert "the converter ends before a pixel is full" in results[0].warnings[0]


def test_without_saturation_full_well_is_unknown_and_not_0():
    result = Camera(1, times=TIMES[:8]).figures()
    for name in ("saturation_dn", "full_well_e"):
        assert result.figures[name].value is None
        assert result.figures[name].u is None
    assert any("no exposure saturates" in line for line in result.warnings)


def test_an_unsteady_lamp_is_named_and_widens_the_nonlinearity(results):
    result = Camera(2, lamp=0.03).figures()
    assert any("the light scatters by" in line for line in result.warnings)
    steady = results[0].figures["nonlinearity_per_decade"].u
    assert result.figures["nonlinearity_per_decade"].u > 10 * steady


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (
            lambda: Camera(1, power=0.6),
            r"counts grow as the exposure to the power of 0\.6\d.*gamma",
        ),
        (lambda: Camera(1, black=1.0), "of a dark frame hold 0 counts: the black level is cut"),
        (lambda: Camera(1, times=TIMES[-4:]), "3 of 4 exposures are below saturation; 4 are"),
    ],
    ids=["gamma", "black", "few"],
)
def test_frames_that_cannot_give_the_figures_are_refused(camera, message):
    with pytest.raises(DataError, match=message):
        camera().figures()


def test_a_copied_frame_is_refused():
    camera = Camera(1)
    camera.frames["flat", 3, 1] = camera.frames["flat", 3, 0]
    with pytest.raises(DataError, match=r"the first two flat frames of .* ms are the same"):
        camera.figures()


# ---------------------------------------------------------------- files


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    rig = preset("modern12").with_pixels(104).altered(
        sensor={"nonlinearity_per_decade": 0.005}, lamp={"drift": 5e-4}
    )  # fmt: skip
    made = gonio.flats(tmp_path_factory.mktemp("flats") / "flats", instrument=rig, seed=3)
    return rig, made


def test_virtual_flats_give_what_the_virtual_camera_is(folder):
    rig, made = folder
    found = gonio.calibrate_camera(made)
    plan = Plan(theta_i_deg=(0,), rotations_deg=(0,), exposures_s=(0.1,))
    camera = metadata(rig, plan, "", "").camera
    end = (camera.saturation_dn - camera.black_dn) / camera.gain_dn_per_e
    expected = {
        "gain_dn_per_e": camera.gain_dn_per_e,
        "black_dn": camera.black_dn,
        "full_well_e": min(end, camera.full_well_e),
        "read_noise_e": camera.noise_dn / camera.gain_dn_per_e,
        "dark_e_per_s": camera.dark_e_per_s,
        "nonlinearity_per_decade": 0.005,
        "prnu": rig.sensor.prnu / rig.sensor.binning,
    }
    for name, value in expected.items():
        assert abs(found["camera"][name] - value) < 3.5 * found["uncertainty"][name], name


def test_the_command_writes_a_file_that_an_import_reads(folder, tmp_path):
    _, made = folder
    rig = small_rig(tmp_path / "rig")
    result = CliRunner().invoke(
        cli.group, ["calibrate", "camera", str(made), "-o", str(rig / "camera.toml"), "--json"]
    )
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    text = (rig / "session.toml").read_text(encoding="utf-8")
    start, stop = text.index("[camera]"), text.index("[standard]")
    own = '[camera]\nfile = "camera.toml"\npitch_um = [59.8, 59.8]\n\n'
    (rig / "session.toml").write_text(text[:start] + own + text[stop:], encoding="utf-8")
    camera = session_file.read(rig).table.camera
    for name in ("gain_dn_per_e", "black_dn", "nonlinearity_per_decade", "read_noise_e"):
        assert getattr(camera, name) == pytest.approx(found["camera"][name])
    expected = found["uncertainty"]["nonlinearity_per_decade"]
    assert camera.u_nonlinearity_per_decade == pytest.approx(expected)
    change(rig, ("pitch_um", "black_dn = 64.0\npitch_um"))
    with pytest.raises(ConfigurationError, match=r"camera\.toml says black_dn of the camera"):
        session_file.read(rig)


def test_tiff_frames_named_in_another_way_are_read(folder, tmp_path):
    _, made = folder
    for path in made.glob("*.png"):
        role, ms, take = path.stem.split("_")
        target = tmp_path / role / f"{take}-{ms}.tif"
        target.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(target), cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    text = (made / "flats.toml").read_text(encoding="utf-8")
    text = text.replace(
        "{role}_{exposure_ms:g}ms_{take}.png", "{role}/{take}-{exposure_ms:g}ms.tif"
    )
    (tmp_path / "flats.toml").write_text(text, encoding="utf-8")
    assert gonio.calibrate_camera(tmp_path) == gonio.calibrate_camera(made)


def test_a_folder_without_description_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"flats\.toml: no such file; it says which"):
        gonio.calibrate_camera(tmp_path)
