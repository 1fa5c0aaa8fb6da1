"""Every command is a verb in Python: named, typed, documented, and light until it is used."""

from __future__ import annotations

import ast
import inspect
import json
import subprocess
import sys
import typing
from pathlib import Path

import numpy as np
import pytest
import rich_click as click
from virtual import small

import gonio
from gonio.errors import ConfigurationError, DataError
from gonio.verbs import PYTHON_NAMES, ROOMS, TYPES, VERBS, python_name

CLI = Path(inspect.getfile(gonio)).parent / "cli"


def commands() -> list[str]:
    """The words behind `gonio` of every command, without groups."""
    from gonio.cli import group

    def below(context: click.Context, words: str) -> list[str]:
        found = []
        for name in context.command.list_commands(context):
            _, command, _ = context.command.resolve_command(context, [name])
            called = f"{words} {name}".strip()
            if isinstance(command, click.Group):
                found += below(click.Context(command, parent=context, info_name=name), called)
            else:
                found.append(called)
        return found

    return below(click.Context(group, info_name="gonio"), "")


COMMANDS = commands()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_its_name_in_python(command: str) -> None:
    assert python_name(command) in dir(gonio)


def test_every_verb_is_a_command_or_reads_samples() -> None:
    assert set(VERBS) - {python_name(command) for command in COMMANDS} == {"load"}


def test_the_exceptions_are_commands() -> None:
    assert set(PYTHON_NAMES) <= set(COMMANDS)


@pytest.mark.parametrize("name", VERBS)
def test_a_verb_is_typed_documented_and_shown(name: str) -> None:
    verb = getattr(gonio, name)
    assert verb.__name__ == name
    signature = inspect.signature(verb)
    assert signature.return_annotation is not inspect.Signature.empty
    text = inspect.getdoc(verb)
    assert text is not None
    for parameter in signature.parameters.values():
        assert parameter.annotation is not inspect.Parameter.empty, parameter
        heading = text.partition("Parameters\n----------\n")[2].partition("\n\n")[0]
        assert any(
            parameter.name in line.partition(" : ")[0].split(", ")
            for line in heading.splitlines()
            if " : " in line
        ), f"{name}: say in Parameters what {parameter.name} is"
    assert "\nReturns\n-------\n" in text
    assert "\nExamples\n--------\n" in text
    assert ">>> " in text.partition("\nExamples\n")[2]


def test_the_root_shows_type_checkers_what_it_offers() -> None:
    source = Path(inspect.getfile(gonio)).read_text(encoding="utf-8")
    (block,) = [
        node
        for node in ast.parse(source).body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    rooms, verbs = {}, {}
    for node in block.body:
        if isinstance(node, ast.Import):
            rooms |= {alias.asname: alias.name for alias in node.names}
        else:
            assert isinstance(node, ast.ImportFrom)
            verbs |= {alias.name: node.module for alias in node.names}
    assert rooms == {name: f"gonio.{name}" for name in ROOMS}
    assert verbs == VERBS | TYPES
    assert set(gonio.__all__) == {"__version__", *ROOMS, *TYPES, *VERBS}


def fresh(code: str) -> typing.Any:
    """What a fresh interpreter prints as JSON."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_rooms_and_verbs_resolve_after_the_import_alone() -> None:
    heavy = fresh(
        "import json, sys, gonio\n"
        "gonio.models.get('lambert'), gonio.geometry.Directions(0.1, 0.0, 0.2, 0.0)\n"
        "gonio.formats.read, gonio.samples.BRDFSamples, gonio.instrument.preset\n"
        "listed = [name for name in dir(gonio) if not name.startswith('_')]\n"
        f"assert set({[*ROOMS, *TYPES, *VERBS]}) <= set(listed)\n"
        "print(json.dumps([m for m in ('numba', 'cv2', 'emcee', 'matplotlib', 'scipy', 'zarr', "
        "'xarray') if m in sys.modules]))"
    )
    assert heavy == []


def test_an_unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="module 'gonio' has no attribute 'simulat'"):
        gonio.simulat  # noqa: B018


# ---------------------------------------------------------------- commands hold no physics


@pytest.mark.parametrize("path", sorted(CLI.glob("*.py")), ids=lambda path: path.stem)
def test_a_command_computes_nothing(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        for name in names:
            assert name.split(".")[0] not in {"numpy", "scipy", "numba", "xarray", "cv2"}, name
            assert not name.startswith("gonio.kernels"), name


# ---------------------------------------------------------------- what is missing is said first

MISSING = {
    "fit": (["fit", "missing.nc", "--model", "ward"], 3),
    "fit of a session": (["fit", "missing.gonio", "--model", "ward"], 3),
    "compare": (["compare", "missing.nc", "--models", "ward,lambert"], 3),
    "reduce": (["reduce", "missing.gonio", "-o", "a.nc"], 3),
    "plot": (["plot", "missing.json"], 3),
    "report": (["report", "missing.json"], 3),
    "evaluate": (["evaluate", "ward", "--angles", "missing.csv"], 3),
    "budget": (["budget", "missing.nc"], 3),
    "check": (["check", "missing.csv"], 3),
    "import": (["import", "missing", "-o", "a.gonio"], 2),
    "lens": (["calibrate", "lens", "missing.png", "--pitch-um", "3", "-o", "lens.toml"], 3),
    "alignment": (["calibrate", "alignment", "missing.gonio", "-o", "geometry.toml"], 3),
    "simulate": (["simulate", "wall_plaster", "--instrument", "missing.toml", "-o", "a.gonio"], 2),
    "plan": (["simulate", "wall_plaster", "--plan", "missing.toml", "-o", "a.gonio"], 3),
    "design": (["design", "--model", "ward", "--instrument", "missing.toml"], 2),
    "boards": (["boards", "--instrument", "missing.toml", "-o", "photos"], 2),
    "render": (
        ["render", "sphere", "--model", "ward", "--light", "environment", "--map", "missing.hdr"],
        3,
    ),
}


def test_a_missing_file_is_said_before_anything_heavy_is_imported(tmp_path: Path) -> None:
    code = f"""
import contextlib, io, json, os, sys
os.chdir({str(tmp_path)!r})
from gonio.cli import main
found = {{}}
for name, (words, _) in {MISSING!r}.items():
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        try:
            main(words)
        except SystemExit as left:
            heavy = [m for m in ("numba", "cv2") if m in sys.modules]
            found[name] = [left.code, heavy, "missing" in said.getvalue()]
print(json.dumps(found))
"""
    assert fresh(code) == {name: [code, [], True] for name, (_, code) in MISSING.items()}


# ---------------------------------------------------------------- single verbs


@pytest.fixture(scope="module")
def tile(tmp_path_factory: pytest.TempPathFactory) -> gonio.session.Session:
    """A small session of a simulated tile."""
    plan = gonio.metadata.Plan(theta_i_deg=(10, 40), rotations_deg=(0,), exposures_s=(0.01, 0.1))
    folder = tmp_path_factory.mktemp("verbs") / "tile.gonio"
    return gonio.simulate("white_ceramic_tile", output=folder, instrument=small(), plan=plan)


def test_load_reduces_a_session_and_cuts_in_radians(tile: gonio.session.Session) -> None:
    stages = []
    samples = gonio.load(
        tile.path, max_theta_r=0.5, progress=lambda stage, done, total: stages.append(stage.doing)
    )
    assert samples.directions.theta_r.max() <= 0.5
    whole = gonio.reduce(tile)
    assert len(samples) == np.count_nonzero(whole.directions.theta_r <= 0.5)
    assert set(stages) == {"reducing tile.gonio"}


def test_what_a_fit_returns_goes_into_plot_and_report(tile: gonio.session.Session) -> None:
    samples = gonio.load(tile.path)
    result = gonio.fit(samples, model="lambert")
    figure = gonio.plot(result, "slices", samples=samples)
    assert len(figure.axes) >= 1
    made = gonio.report(result, samples=samples, session=tile)
    assert made.absent == ()
    assert "lambert" in made.html


def test_plot_says_what_cannot_be_drawn(tile: gonio.session.Session) -> None:
    with pytest.raises(ConfigurationError, match="kind lobe is drawn of model, and this BRDFS"):
        gonio.plot(gonio.load(tile.path), "lobe")
    with pytest.raises(ConfigurationError, match="parameters go with a model or a material"):
        gonio.plot(gonio.load(tile.path), parameters={"rho": 0.5})


def test_evaluate_takes_a_model_or_a_material() -> None:
    directions = gonio.geometry.Directions(0.3, 0.0, 0.3, np.pi)
    material = gonio.materials.get("rolled_brass")
    expected = gonio.models.get(material.model)(directions, **material.parameters)
    assert gonio.evaluate(directions=directions, material="rolled_brass") == expected
    with pytest.raises(ConfigurationError, match="give a model or a material; both were given"):
        gonio.evaluate("ward", directions, material="rolled_brass")


def test_check_takes_samples_as_well_as_names(tile: gonio.session.Session) -> None:
    samples = gonio.load(tile.path)
    assert gonio.check(samples).n_samples == len(samples)
    with pytest.raises(ConfigurationError, match="samples have no parameters"):
        gonio.check(samples, {"rho": 0.5})
    with pytest.raises(ConfigurationError, match="unknown model, material or file 'wrad'"):
        gonio.check("wrad")


def test_a_plan_goes_from_design_to_simulate_through_its_file(tmp_path: Path) -> None:
    rig = small().model_copy(update={"rays_per_pixel": 8})
    result = gonio.design("lambert", {"rho": 0.4}, instrument=rig, budget=6)
    file = result.save(tmp_path / "plan.toml")
    session = gonio.simulate(
        model="lambert", parameters={"rho": 0.4}, output=tmp_path / "s", instrument=rig, plan=file
    )
    plan = session.metadata.plan
    assert plan.theta_i_deg == pytest.approx(result.plan.theta_i_deg, rel=1e-9)
    assert plan.n_frames == result.plan.n_frames
    with pytest.raises(DataError, match=r"nowhere\.toml: cannot be read"):
        gonio.simulate("wall_plaster", output=tmp_path / "t", plan=tmp_path / "nowhere.toml")
    (tmp_path / "empty.toml").write_text("[rig]\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"holds no table \[plan\]; give a file that"):
        gonio.simulate("wall_plaster", output=tmp_path / "t", plan=tmp_path / "empty.toml")


def test_the_command_takes_the_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from gonio import cli

    file = tmp_path / "plan.toml"
    file.write_text(
        "[plan]\ntheta_i_deg = [0, 30]\nrotations_deg = [0]\nexposures_s = [0.002]\n",
        encoding="utf-8",
    )
    words = ["simulate", "wall_plaster", "--instrument", "lbl1992", "--plan", str(file)]
    with pytest.raises(SystemExit) as left:
        cli.main([*words, "-o", str(tmp_path / "s"), "--json"])
    assert left.value.code == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["theta_i_deg"], document["exposures_s"]) == ([0, 30], [0.002])
    with pytest.raises(SystemExit) as left:
        cli.main([*words, "--theta-i", "0,10", "-o", str(tmp_path / "t")])
    assert left.value.code == 2
    assert "says which images are taken; leave --theta-i out." in capsys.readouterr().err


def test_doctor_returns_its_checks() -> None:
    report = gonio.doctor()
    assert report["ok"]
    assert [check["ok"] for check in report["checks"]] == [True, True]
