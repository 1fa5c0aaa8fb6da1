"""The commands `materials`, `models` and `evaluate`."""

from __future__ import annotations

import csv
import io
import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from gonio import materials, models
from gonio.cli import evaluate as evaluate_command
from gonio.cli import materials as materials_command
from gonio.cli import models as models_command
from gonio.cli.options import parse_parameters
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import Directions

DIRECTIONS = "theta_i,phi_i,theta_r,phi_r\n30.1,0,45,180\n0,0,60,12.5\n10,0,95,0\n"


def run(module, *arguments):
    """Run a command and return its result; errors come through as exceptions."""
    words = [str(argument) for argument in arguments]
    return CliRunner().invoke(module.command, words, catch_exceptions=False)


@pytest.fixture
def angles(tmp_path):
    path = tmp_path / "dirs.csv"
    path.write_text(DIRECTIONS)
    return path


# ---------------------------------------------------------------- materials


def test_materials_lists_all():
    result = run(materials_command)
    assert result.exit_code == 0
    for name in materials.names():
        assert re.search(rf"\b{name}\b", result.stdout)
    assert "sigma=30 deg" in result.stdout
    assert "Ward 1992" in result.stdout


def test_materials_json_is_one_document():
    result = run(materials_command, "--json")
    documents = json.loads(result.stdout)
    assert [document["name"] for document in documents] == materials.names()
    assert result.stderr == ""


def test_one_material():
    text = run(materials_command, "wall_plaster").stdout
    assert "equation (13)" in text
    document = json.loads(run(materials_command, "wall_plaster", "--json").stdout)
    assert document["parameters"] == {"sigma": 30, "rho": 0.9}
    assert document["units"] == {"sigma": "deg", "rho": ""}
    assert document["anisotropic"] is False


def test_unknown_material():
    with pytest.raises(ConfigurationError, match="did you mean 'rolled_brass'"):
        run(materials_command, "rolled_bras")


# ---------------------------------------------------------------- models


def test_models_lists_all():
    result = run(models_command)
    for name in models.names():
        assert re.search(rf"\b{name}\b", result.stdout)


def test_models_json_is_one_document():
    documents = json.loads(run(models_command, "--json").stdout)
    assert [document["name"] for document in documents] == models.names()


def test_one_model_shows_parameters_and_formula():
    text = run(models_command, "ward").stdout
    assert "alpha_x" in text
    assert "0.005 to 2" in text
    # Square brackets of the formula are not taken for markup.
    assert "[(h.x/alpha_x)^2 + (h.y/alpha_y)^2]" in text
    document = json.loads(run(models_command, "ward", "--json").stdout)
    assert [p["name"] for p in document["parameters"]] == ["rho_d", "rho_s", "alpha_x", "alpha_y"]


def test_angles_of_models_are_shown_in_degrees():
    text = run(models_command, "oren_nayar").stdout
    assert "deg" in text


def test_unknown_model():
    with pytest.raises(ConfigurationError, match="did you mean 'ward'"):
        run(models_command, "wrd")


# ---------------------------------------------------------------- parameters


def test_parameters_are_turned_to_radians():
    model = models.get("oren_nayar")
    assert parse_parameters(model, ["sigma=30", " rho = 0.5"]) == {
        "sigma": np.radians(30),
        "rho": 0.5,
    }


@pytest.mark.parametrize(
    ("items", "message"),
    [
        (["rho_d"], "-p 'rho_d' is not NAME=VALUE; write for example -p rho_d=0.2."),
        (["=1"], "-p '=1' is not NAME=VALUE"),
        (["rho_x=1"], "unknown parameter 'rho_x' of ward: did you mean 'rho_"),
        (["rho_d=.1", "rho_d=.2"], "-p rho_d is given twice; give it once."),
        (["rho_d=a"], "rho_d = 'a' is not a number; allowed is 0 to 1."),
        (["rho_d=1.5"], "rho_d = 1.5 is out of range; allowed is 0 to 1."),
        (["rho_d=nan"], "rho_d = nan is out of range; allowed is 0 to 1."),
    ],
)
def test_parameter_refusals(items, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        parse_parameters(models.get("ward"), items)


# ---------------------------------------------------------------- evaluate

WARD = ("-p", "rho_d=0.1", "-p", "rho_s=0.2", "-p", "alpha_x=0.1", "-p", "alpha_y=0.3")


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_evaluate_prints_the_model_to_the_last_bit(angles):
    result = run(evaluate_command, "ward", *WARD, "--angles", angles)
    rows = table(result.stdout)
    expected = models.get("ward")(
        Directions(*np.radians([[30.1, 0, 10], [0, 0, 0], [45, 60, 95], [180, 12.5, 0]])),
        rho_d=0.1,
        rho_s=0.2,
        alpha_x=0.1,
        alpha_y=0.3,
    )
    assert [float(row["brdf"]) for row in rows] == expected.tolist()
    assert [float(row["theta_i"]) for row in rows] == [30.1, 0, 10]
    assert [float(row["phi_r"]) for row in rows] == [180, 12.5, 0]
    assert float(rows[2]["brdf"]) == 0
    assert result.stderr == ""


def test_evaluate_writes_the_same_file(angles, tmp_path):
    out = tmp_path / "out.csv"
    printed = run(evaluate_command, "ward", *WARD, "--angles", angles).stdout
    result = run(evaluate_command, "ward", *WARD, "--angles", angles, "-o", out)
    assert result.stdout == ""
    assert out.read_text() == printed
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dirs.csv", "out.csv"]


def test_evaluate_material_with_a_changed_parameter(angles):
    brass = materials.get("rolled_brass")
    d = Directions(np.radians(30.1), 0, np.radians(45), np.pi)
    for extra, change in (((), {}), (("-p", "rho_d=0.3"), {"rho_d": 0.3})):
        result = run(evaluate_command, "--material", "rolled_brass", *extra, "--angles", angles)
        expected = models.get("ward")(d, **{**brass.parameters, **change})
        assert float(table(result.stdout)[0]["brdf"]) == float(expected)
        assert result.stderr == ""


def test_evaluate_tells_the_defaults_on_stderr(angles):
    result = run(evaluate_command, "ward", "-p", "rho_d=0.1", "--angles", angles)
    assert result.stderr == (
        "Default values are used for rho_s = 0.1, alpha_x = 0.1, alpha_y = 0.1.\n"
    )
    assert result.stdout.startswith("theta_i,phi_i,theta_r,phi_r,brdf\n")


def test_evaluate_wants_one_of_model_and_material(angles):
    with pytest.raises(ConfigurationError, match="neither was given"):
        run(evaluate_command, "--angles", angles)
    with pytest.raises(ConfigurationError, match="both were given"):
        run(evaluate_command, "ward", "--material", "foam", "--angles", angles)


def test_evaluate_without_its_files(angles, tmp_path):
    with pytest.raises(DataError, match="no such file"):
        run(evaluate_command, "lambert", "-p", "rho=1", "--angles", tmp_path / "none.csv")
    with pytest.raises(DataError, match=r"the folder .* does not exist"):
        run(
            evaluate_command, "lambert", "-p", "rho=1", "--angles", angles,
            "-o", tmp_path / "none" / "out.csv",
        )  # fmt: skip
