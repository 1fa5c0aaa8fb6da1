"""Faults of a session: each is named, or its effect lies inside the stated uncertainty."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from virtual import small

import gonio
from gonio import cli
from gonio.calibration.faults import all_questions
from gonio.calibration.faults import session as faults
from gonio.calibration.faults.float_frame import of_float_frame
from gonio.errors import DataError
from gonio.instrument import Instrument, preset, preset_names
from gonio.instrument.records import channels
from gonio.metadata import Metadata, Plan
from gonio.samples import FLAG_ENTRY, BRDFSamples
from gonio.session import Session

LOBE = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.25, "alpha_y": 0.25}
TIMES = (1e-3, 16e-3, 128e-3)
THETAS = (0.0, 15.0, 30.0, 45.0, 60.0, 70.0)
BLACK, TOP = 256, 4 * 4095  # of a 2 x 2 bin

Change = Callable[[str, int, int, np.ndarray], np.ndarray]


def coarse(name: str = "ideal12", **parts) -> Instrument:
    """A preset with 104 x 104 pixels; lbl1992 has 80 x 108 as it is."""
    return preset(name) if name == "lbl1992" else small(name, **parts)


def record(path: Path, rig: Instrument, thetas=THETAS, times=TIMES, seed=3, **planned) -> Session:
    plan = Plan(
        theta_i_deg=thetas,
        rotations_deg=(0.0,),
        exposures_s=times,
        channels=channels(rig),
        **planned,
    )
    return gonio.simulate(
        model="ward", parameters=LOBE, output=path, instrument=rig, plan=plan, seed=seed
    )


class Altered(Session):
    """A session whose frames are changed while they are read."""

    def __init__(self, session: Session, change: Change, metadata: Metadata | None = None) -> None:
        super().__init__(session.path, metadata or session.metadata, {})
        self.session, self.change = session, change

    def require_complete(self) -> None:
        pass

    def bracket(self, role, take, incidence, *, channel=0):
        frames = self.change(role, take, incidence, self.session.bracket(role, take, incidence))
        return np.clip(np.rint(frames), 0, 65535).astype(np.uint16)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Session:
    return record(tmp_path_factory.mktemp("good") / "s", coarse())


def found(session: Session, change: Change, metadata: Metadata | None = None) -> dict[str, str]:
    findings = faults.check_session(Altered(session, change, metadata))
    return {finding.code: f"{finding.severity}: {finding.text}" for finding in findings}


def fitted(session: Session) -> dict[str, float]:
    """How many standard uncertainties each parameter is off."""
    fit = gonio.fit(gonio.reduce(session), model="ward")
    found = fit.parameters
    return {name: (found[name].value - true) / found[name].stderr for name, true in LOBE.items()}


def reads(session: Session, role: str, incidence: int) -> np.ndarray:
    return session.bracket(role, 0, incidence)


def same(role, take, incidence, frames):
    return frames


def test_a_good_session_has_no_fault(good):
    assert found(good, same) == {}
    samples = gonio.reduce(good)
    assert samples.metadata["findings"] == []
    assert not any("warning" in line or "error" in line for line in samples.history)


@pytest.mark.parametrize("name", preset_names())
def test_no_false_alarm(name, tmp_path):
    rig = coarse(name)
    times = rig.sensor.exposures_s
    session = record(tmp_path / "s", rig, thetas=(0.0, 20.0, 40.0, 55.0, 70.0), times=times)
    assert found(session, same) == {}


def test_no_false_alarm_of_an_instrument_with_quirks(tmp_path):
    """What an instrument may do without a fault: a curved response, an uneven dome and beam."""
    rig = coarse(
        sensor={"gamma": 0.45, "dark_e_per_s": 20.0, "dsnu_e_per_s": 4.0, "prnu": 0.02},
        dome={"reflectance_variation": 0.1, "transmittance_variation": 0.01},
        lamp={"edge_falloff": 0.5, "slow_drift": 0.002},
        lens={"psf_px": 1.0},
        surroundings={"ambient": 0.05, "ambient_reflected": 0.01},
    )
    session = record(tmp_path / "s", rig)
    assert found(session, same) == {}
    assert all(abs(z) < 4 for z in fitted(session).values())


@pytest.mark.parametrize("question", all_questions(), ids=lambda question: question.key)
def test_a_question_is_named_as_its_file_and_has_words(question):
    assert question.ask.__module__ == f"gonio.calibration.faults.{question.key}"
    assert question.asks.endswith("?")
    assert question.compares
    assert question.codes


def test_no_two_questions_have_one_place():
    assert len({question.order for question in all_questions()}) == len(all_questions())


# ---------------------------------------------------------------- the drill


def bad_places(kind: int, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Pixels apart from each other, well inside the image circle."""
    rows, columns = np.meshgrid(np.arange(25, 80, 4), np.arange(25, 80, 4))
    order = np.random.default_rng(5).permutation(rows.size)[kind * n : (kind + 1) * n]
    return rows.ravel()[order], columns.ravel()[order]


def with_bad_pixels(role, take, incidence, frames):
    frames = frames.astype(float)
    frames[:, *bad_places(0)] = BLACK
    hot = 4e5 * np.array(TIMES)[:, None]  # an eighth of the white standard's light
    frames[:, *bad_places(1)] += 0.38 * np.random.default_rng(incidence).poisson(hot, (3, 40))
    return np.minimum(frames, TOP)


def test_dead_and_hot_pixels_are_counted_and_left_out(good):
    named = found(good, with_bad_pixels)
    assert set(named) == {"dead_pixels", "hot_pixels"}
    assert named["dead_pixels"].startswith("warning: 40 dead pixels left out: less than a fifth")
    assert named["hot_pixels"].startswith("warning: 40 hot pixels left out: far brighter than ")
    assert all(abs(z) < 4 for z in fitted(Altered(good, with_bad_pixels)).values())


def test_a_saturated_standard_stops_the_reduction(good):
    def change(role, take, incidence, frames):
        return (
            np.minimum((frames - float(BLACK)) * 300 + BLACK, TOP) if role == "standard" else frames
        )

    named = found(good, change)
    assert named["saturated_standard"].startswith("error: standard at 0 deg: 100")
    with pytest.raises(DataError, match=r"standard at 0 deg: 100.*% of the pixels are saturated"):
        gonio.reduce(Altered(good, change))


def test_a_standard_of_which_a_few_pixels_are_left_stops_the_reduction(good):
    def change(role, take, incidence, frames):
        if role != "standard":
            return frames
        bright = np.minimum((frames - float(BLACK)) * 300 + BLACK, TOP)
        middle = tuple(slice(n // 2 - 1, n // 2 + 1) for n in frames.shape[-2:])
        bright[..., *middle] = frames[..., *middle]
        return bright

    assert found(good, change)["saturated_standard"].startswith("error: standard at 0 deg: 99.")


def test_a_saturated_sample_is_named_and_left_out(good):
    def change(role, take, incidence, frames):
        if (role, incidence) == ("sample", 2):
            frames = frames.copy()
            frames[:, 40:60, 30:50] = TOP
        return frames

    named = found(good, change)
    assert set(named) == {"saturated_sample"}
    assert named["saturated_sample"].startswith("warning: sample at 30 deg: 6.")
    assert all(abs(z) < 4 for z in fitted(Altered(good, change)).values())


def test_a_dark_level_that_drifts(good):
    def change(role, take, incidence, frames):
        return frames + 30.0 if role == "sample" else frames

    named = found(good, change)
    assert set(named) == {"dark_drift"}
    text = "outside the image circle the level is +30"
    assert text in named["dark_drift"]
    assert "18 frames are off" in named["dark_drift"]


def test_a_small_dark_drift_is_inside_the_uncertainty(good):
    def change(role, take, incidence, frames):
        return frames + 0.3 if role == "sample" else frames

    assert all(abs(z) < 4 for z in fitted(Altered(good, change)).values())


def test_an_image_off_its_centre(good):
    named = found(good, lambda role, take, incidence, frames: np.roll(frames, (-1, 2), (1, 2)))
    assert "off_centre" in named
    assert "the image circle lies +2.0 columns and -1.0 rows from where" in named["off_centre"]


def test_standard_frames_of_two_incidences_exchanged(good):
    def change(role, take, incidence, frames):
        return (
            reads(good, role, {1: 4, 4: 1}.get(incidence, incidence))
            if role == "standard"
            else frames
        )

    named = found(good, change)
    assert "the standard's signals at 15 and 60 deg would follow" in named["exchanged_frames"]
    assert named["exchanged_frames"].startswith("error")
    with pytest.raises(DataError, match="if the frames of the two were exchanged"):
        gonio.reduce(Altered(good, change))


def test_background_frames_of_two_incidences_exchanged(good):
    def change(role, take, incidence, frames):
        return (
            reads(good, role, {1: 4, 4: 1}.get(incidence, incidence))
            if role == "background"
            else frames
        )

    named = found(good, change)
    text = "error: background at 15 deg: the lamp's entry patch lies at 60 deg; the frames of two"
    assert named["exchanged_frames"].startswith(text)


def test_sample_frames_of_two_incidences_exchanged(good):
    def change(role, take, incidence, frames):
        return (
            reads(good, role, {1: 4, 4: 1}.get(incidence, incidence))
            if role == "sample"
            else frames
        )

    named = found(good, change)
    assert named["darker_than_background"].startswith("error: sample at ")
    assert "frames of two incidences are exchanged" in named["darker_than_background"]


def test_sample_and_standard_exchanged(good):
    other = {"sample": "standard", "standard": "sample", "background": "background"}
    named = found(good, lambda role, take, i, frames: reads(good, other[role], i))
    # A glossy sample makes a poor standard, and the white one a very bright sample.
    assert {"wrong_standard", "brighter_than_white"} <= set(named)
    assert "sample and standard are exchanged" in named["brighter_than_white"]


def test_exposures_exchanged(good):
    def change(role, take, incidence, frames):
        return frames[[0, 2, 1]] if (role, incidence) == ("sample", 3) else frames

    named = found(good, change)
    assert named["exposure_order"].startswith("error: sample at 45 deg, ")
    assert "frames are exchanged, or plan.exposures_s is not what" in named["exposure_order"]


def test_counts_cut_off_at_zero(good):
    metadata = good.metadata
    camera = metadata.camera.model_copy(update={"black_dn": 0.0})
    named = found(
        good,
        lambda role, take, incidence, frames: frames.astype(float) - BLACK,
        metadata.model_copy(update={"camera": camera}),
    )
    assert "clipped_at_zero" in named
    assert "of the counts are 0" in named["clipped_at_zero"]
    assert "Raise the camera's offset." in named["clipped_at_zero"]


def test_a_glossy_standard_is_not_the_certified_one(good):
    def change(role, take, incidence, frames):
        if role != "standard":
            return frames
        # Gloss of a fifth of the diffuse light at its peak, which moves with the lamp.
        columns, rows = np.meshgrid(np.arange(104), np.arange(104))
        peak = 52 - THETAS[incidence] / 1.8
        gloss = 0.3 * np.exp(-((columns - peak) ** 2 + (rows - 52) ** 2) / 2 / 15**2)
        return np.minimum((frames - float(BLACK)) * (1 + gloss) + BLACK, TOP)

    named = found(good, change)
    assert named["wrong_standard"].startswith("warning: standard at ")
    assert "it is not the certified standard, or it is dirty or glossy" in named["wrong_standard"]


def test_a_grey_standard_makes_the_sample_brighter_than_white(good):
    def change(role, take, incidence, frames):
        grey = 0.2 * (frames - float(BLACK)) + BLACK
        return grey if role == "standard" else frames

    named = found(good, change)
    assert "brighter_than_white" in named
    assert "the standard is not the certified one" in named["brighter_than_white"]


def test_a_standard_off_by_its_uncertainty_is_inside_the_uncertainty(tmp_path):
    rig = coarse(standard={"uncertainty": 0.02})
    session = record(tmp_path / "s", rig, thetas=THETAS[::2])
    assert found(session, same) == {}
    assert all(abs(z) < 4 for z in fitted(session).values())


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.nan, r"dark\.tif: 1 of 6 pixels are NaN or infinite; take the frame again or mask"),
        (np.inf, r"dark\.tif: 1 of 6 pixels are NaN or infinite"),
        (-3.0, r"dark\.tif: 1 of 6 pixels are below 0; give raw counts, not frames from which"),
        (1.5, r"dark\.tif: 1 of 6 pixels are not whole counts; give raw frames, not processed"),
    ],
)
def test_a_float_frame_that_holds_no_counts(value, message):
    frame = np.full((2, 3), 70.0)
    assert of_float_frame(frame, "dark.tif") == ()
    frame[1, 2] = value
    (finding,) = of_float_frame(frame, "dark.tif")
    assert finding.severity == "error"
    assert re.match(message, finding.text)


def test_eight_bits_that_pass_for_more(good):
    # The camera's 14 bits of a bin, shifted down to 8, and the metadata left as they were.
    named = found(good, lambda role, take, incidence, frames: frames >> 6)
    assert named["saturates_early"].startswith("error: ")
    assert (
        "counts stop at 255, and camera.saturation_dn is 16380; 255 is what"
        in named["saturates_early"]
    )


def test_eight_bits_in_a_wider_container(good):
    named = found(good, lambda role, take, incidence, frames: frames >> 6 << 6)
    assert "all counts are multiples of 64 apart" in named["coarse_counts"]


def test_a_lamp_that_drifts_more_than_stated(good):
    output = 1 + 0.03 * np.random.default_rng(2).standard_normal((3, len(THETAS)))

    def change(role, take, incidence, frames):
        row = ("background", "standard", "sample").index(role)
        return (frames - float(BLACK)) * output[row, incidence] + BLACK

    named = found(good, change)
    assert "lamp_drift" in named
    assert "0 is stated for the lamp" in named["lamp_drift"]
    assert "shared uncertainty is too small" in named["lamp_drift"]


def test_a_lamp_that_drifts_as_stated_is_inside_the_uncertainty(tmp_path):
    session = record(tmp_path / "s", coarse(lamp={"drift": 0.01}))
    assert found(session, same) == {}
    assert all(abs(z) < 4 for z in fitted(session).values())


def test_repeats_show_a_drift_where_incidences_are_few(tmp_path):
    session = record(tmp_path / "s", coarse(), thetas=(0.0, 30.0), times=TIMES[:2], repeats=3)

    def change(role, take, incidence, frames):
        return (frames - float(BLACK)) * (1 + 0.03 * take) + BLACK if role == "standard" else frames

    assert "scatter by 0.029 among its repeats" in found(session, change)["lamp_drift"]


def test_a_background_that_was_not_taken(good):
    def change(role, take, incidence, frames):
        return np.zeros_like(frames) if (role, incidence) == ("background", 2) else frames

    named = found(good, change)
    assert named["missing_background"].startswith("error: background at 30 deg: every count is 0")
    with pytest.raises(DataError, match="background at 30 deg: every count is 0; it was not taken"):
        gonio.reduce(Altered(good, change))


def test_a_background_that_is_the_sample(good):
    def change(role, take, incidence, frames):
        return reads(good, "sample", 2) if (role, incidence) == ("background", 2) else frames

    named = found(good, change)
    assert named["missing_background"].startswith("error: background at 30 deg, ")
    assert "are the same frame, including its noise" in named["missing_background"]


def test_a_response_that_session_json_does_not_know(good):
    def change(role, take, incidence, frames):
        share = np.maximum(frames - float(BLACK), 0) / (TOP - BLACK)
        return BLACK + (TOP - BLACK) * share**0.8

    named = found(good, change)
    assert "not_linear" in named
    assert "the response is not what camera.gamma = 1 says" in named["not_linear"]


def test_force_goes_on_and_writes_down_what_is_wrong(good):
    def change(role, take, incidence, frames):
        return np.zeros_like(frames) if (role, incidence) == ("background", 2) else frames

    samples = gonio.reduce(Altered(good, change), force=True)
    assert any(line.startswith("error: background at 30 deg: every") for line in samples.history)
    assert samples.metadata["findings"][0]["code"] == "missing_background"


# ---------------------------------------------------------------- the command


def test_the_command_stops_at_an_error_and_goes_on_by_force(good, tmp_path, capsys, monkeypatch):
    def bracket(self, role, take, incidence, *, channel=0):
        frames = true_bracket(self, role, take, incidence)
        return np.zeros_like(frames) if (role, incidence) == ("background", 2) else frames

    true_bracket = Session.bracket
    monkeypatch.setattr(Session, "bracket", bracket)

    def run(*words):
        with pytest.raises(SystemExit) as left:
            cli.main(["reduce", str(good.path), "-o", str(tmp_path / "x.nc"), *words])
        return left.value.code, *capsys.readouterr()

    code, out, err = run()
    assert (code, out) == (3, "")
    assert "background at 30 deg: every count is 0; it was not taken." in err
    assert not list(tmp_path.iterdir())
    code, out, _ = run("--force", "--json")
    assert code == 0
    assert json.loads(out)["findings"][0]["code"] == "missing_background"


def test_the_command_keeps_the_entry_patch_where_asked(good, tmp_path, capsys):
    path = tmp_path / "x.nc"
    with pytest.raises(SystemExit) as left:
        cli.main(["reduce", str(good.path), "-o", str(path), "--retro"])
    assert left.value.code == 0
    assert "- retro: " in capsys.readouterr().out
    assert np.any(BRDFSamples.load(path).flags & FLAG_ENTRY)
