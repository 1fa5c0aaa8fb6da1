"""`gonio simulate`: what is recorded, what it tells, and what it refuses."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from gonio.cli import instruments as instruments_command
from gonio.cli import simulate as simulate_command
from gonio.errors import ConfigurationError
from gonio.instrument import preset
from gonio.session import Session, open_truth_images, read_truth

PLAN = ("--theta-i", "0,30", "--rotations", "0")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """An instrument of 26 x 26 pixels and two channels."""
    text = instruments_command_text("modern12")
    for old, new in (
        ('name = "modern12"', 'name = "small12"'),
        ("rows = 1664", "rows = 26"),
        ("columns = 1664", "columns = 26"),
        ("pitch_um = [3.45, 3.45]", "pitch_um = [220.8, 220.8]"),
        ("binning = 4 ", "binning = 1 "),
        ('name = "" ', 'name = "red" '),
        ("# wavelength_nm = 550.0", "wavelength_nm = 620.0"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    text += '[[channels]]\nname = "blue"\nrelative_rate = 0.5\n'
    path = tmp_path_factory.mktemp("rig") / "small12.toml"
    path.write_text(text, encoding="utf-8")
    return path


def instruments_command_text(name):
    return CliRunner().invoke(instruments_command.command, [name, "--toml"]).stdout


def run(*words):
    """Run the command; errors come through as exceptions."""
    words = [str(word) for word in words]
    result = CliRunner().invoke(simulate_command.command, words, catch_exceptions=False)
    assert result.exit_code == 0
    return result


def document(*words):
    return json.loads(run(*words, "--json").stdout)


class TestChannels:
    def test_parameters_have_one_value_or_one_for_each(self, rig, tmp_path):
        path = tmp_path / "s"
        told = document(
            "--model", "ward", "-p", "rho_d=0.1,0.3", "-p", "rho_s=0.05", "-p", "alpha_x=0.1,0.2",
            "-p", "alpha_y=0.1,0.2", "--instrument", rig, *PLAN, "-o", path,
        )  # fmt: skip
        assert [c["name"] for c in told["channels"]] == ["red", "blue"]
        assert told["channels"][0]["wavelength_nm"] == 620
        assert told["images"] == {"background": 2, "standard": 2, "sample": 2}
        assert told["frames"] == told["frames_added"] == 2 * 6 * 6
        assert (told["rows"], told["columns"]) == (26, 26)
        assert read_truth(path)["parameters"] == {
            "rho_d": [0.1, 0.3], "rho_s": 0.05, "alpha_x": [0.1, 0.2], "alpha_y": [0.1, 0.2],
        }  # fmt: skip
        Session.open(path).require_complete()

    def test_angles_are_degrees_in_every_channel(self, rig, tmp_path):
        run("--model", "oren_nayar", "-p", "sigma=10,20", "-p", "rho=0.5", "--instrument", rig,
            *PLAN, "-o", tmp_path / "s")  # fmt: skip
        sigma = read_truth(tmp_path / "s")["parameters"]["sigma"]
        assert sigma == pytest.approx([0.17453, 0.34907], abs=1e-5)

    @pytest.mark.parametrize(
        ("items", "message"),
        [
            (["rho=0.1,0.2,0.3"], "rho has 3 values and small12 has 2 channels; give one value or"),
            (["rho=0.1,"], "rho = '' is not a number; allowed is 0 to 1"),
            (["rho=0.1,2"], "rho = 2 is out of range; allowed is 0 to 1"),
            (["rho=0.1", "rho=0.2,0.3"], "-p rho is given twice; give it once"),
            (["0.1,0.2"], "-p '0.1,0.2' is not NAME=VALUE"),
        ],
    )
    def test_refusals(self, rig, tmp_path, items, message):
        words = [word for item in items for word in ("-p", item)]
        with pytest.raises(ConfigurationError, match=message):
            run("--model", "lambert", *words, "--instrument", rig, *PLAN, "-o", tmp_path / "s")
        assert not (tmp_path / "s").exists()

    def test_the_summary_names_them(self, rig, tmp_path):
        told = run("foam", "--instrument", rig, *PLAN, "-o", tmp_path / "s").stdout
        size, summary = told.splitlines()
        assert size.startswith(f"{tmp_path / 's'}: 72 frames, ")
        assert summary == (
            "reflection; images (takes x incidences): background 1 x 2, standard 1 x 2, "
            "sample 1 x 2; 6 exposures of 0.25 to 256 ms; 26 x 26 pixels; channels red, blue."
        )


class TestStandardAt:
    def test_one_incidence_is_enough(self, rig, tmp_path):
        told = document("foam", "--instrument", rig, *PLAN, "--standard-at", "20", "-o",
                        tmp_path / "s")  # fmt: skip
        assert told["mode"] == "reflection"
        assert told["standard_theta_i_deg"] == 20
        assert told["images"] == {"background": 3, "standard": 1, "sample": 2}

    @pytest.mark.parametrize(("given", "expected"), [((), 45), (("--standard-at", "10"), 10)])
    def test_transmission_takes_it_in_reflection(self, rig, tmp_path, given, expected):
        told = document("foam", "--instrument", rig, *PLAN, "--transmission", *given, "-o",
                        tmp_path / "s")  # fmt: skip
        assert told["mode"] == "transmission"
        assert told["standard_theta_i_deg"] == expected
        assert told["images"] == {"background": 3, "standard": 1, "sample": 2}

    def test_is_within_reach(self, tmp_path):
        with pytest.raises(
            ConfigurationError, match="--standard-at: 80 deg is out of reach of the"
        ):
            run("foam", "--standard-at", "80", "-o", tmp_path / "s")


class TestMirror:
    def test_is_recorded_on_both_sides(self, rig, tmp_path):
        told = document("--mirror", "--wedge", "8", "--theta-i=-30,15", "--rotations", "0,90",
                        "--instrument", rig, "-o", tmp_path / "s")  # fmt: skip
        assert told["sample"] == told["mode"] == "mirror"
        assert told["wedge_deg"] == 8
        assert told["theta_i_deg"] == [-30, 15]
        assert told["images"] == {"background": 2, "sample": 4}
        assert len(told["exposures_s"]) == 2

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["--mirror", "foam"], "--mirror records a mirror alone; leave a MATERIAL or --model"),
            (["--mirror", "--model", "ward"], "leave a MATERIAL or --model out"),
            (["--mirror", "-p", "rho=1"], "--mirror records a mirror alone; leave -p out"),
            (["--mirror", "--transmission"], "leave --transmission out"),
            (["--mirror", "--standard-at", "3"], "leave --standard-at out"),
            (["--wedge", "3", "foam"], "--wedge tilts a mirror; give --mirror with it"),
            (
                ["--mirror", "--wedge", "50"],
                "--wedge 50: the mirror's normal can be tilted by 0 to",
            ),
            (["--mirror", "--theta-i=-80"], "-80 deg is out of reach .* allowed is -75 to 75 deg"),
            (["--mirror", "--instrument", "ideal12"], "the lamp of ideal12 is a point"),
        ],
    )
    def test_refusals(self, tmp_path, words, message):
        with pytest.raises(ConfigurationError, match=message):
            run(*words, "-o", tmp_path / "s")
        assert not (tmp_path / "s").exists()


class TestTruthImages:
    @pytest.mark.parametrize("switch", ["--truth-images", "--no-truth-images"])
    def test_are_written_on_demand(self, rig, tmp_path, switch):
        run("foam", "--instrument", rig, *PLAN, switch, "-o", tmp_path / "s")
        assert (open_truth_images(tmp_path / "s") is None) == (switch == "--no-truth-images")


def test_instruments_shows_channels_one_by_one(rig):
    shown = CliRunner().invoke(instruments_command.command, [str(rig)]).stdout
    lines = {line.split()[1]: line for line in shown.splitlines() if "." in line}
    assert "red" in lines["channels.1.name"]
    assert "620 nm" in lines["channels.1.wavelength_nm"]
    assert "not stated" in lines["channels.2.wavelength_nm"]
    assert "0.5" in lines["channels.2.relative_rate"]


def test_the_file_of_a_preset_is_the_preset(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(instruments_command_text("lbl1992"), encoding="utf-8")
    told = json.loads(CliRunner().invoke(instruments_command.command, [str(path), "--json"]).stdout)
    assert told == preset("lbl1992").model_dump(mode="json")
