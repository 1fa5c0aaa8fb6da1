"""The command line as a whole: help, exit codes, error texts, --json, interruption."""

from __future__ import annotations

import errno
import importlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from gonio import __version__, cli, materials, session, simulation
from gonio.instrument import preset_names
from gonio.samples import BRDFSamples
from gonio.session import Session
from gonio.verbs import doctor

COMMANDS = list(cli._COMMANDS)
# What the help must not load, since each takes a second or more of its own.
HEAVY = {"numba", "emcee", "cv2", "matplotlib", "scipy", "zarr", "xarray", "arviz", "nlopt"}
PLAN = ("--theta-i", "0,30", "--rotations", "0")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """ideal12 with frames of 52 x 52: pixels eight times as large, the same image circle."""
    done = subprocess.run(
        [sys.executable, "-m", "gonio", "instruments", "ideal12", "--toml"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    text = done.stdout
    for old, new in (
        ('name = "ideal12"', 'name = "small12"'),
        ("rows = 1664", "rows = 208"),
        ("columns = 1664", "columns = 208"),
        ("pitch_um = [3.45, 3.45]", "pitch_um = [27.6, 27.6]"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = tmp_path_factory.mktemp("rig") / "small12.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def recorded(rig, tmp_path_factory):
    """A complete session; tests that damage it take a copy."""
    path = tmp_path_factory.mktemp("recorded") / "brass.gonio"
    with pytest.raises(SystemExit) as left:
        cli.main(simulate_words(rig, path))
    assert left.value.code == 0
    return path


@pytest.fixture
def damaged(recorded, tmp_path):
    return Path(shutil.copytree(recorded, tmp_path / "copy.gonio"))


def simulate_words(rig, output, *, surface=("rolled_brass",), plan=PLAN):
    return ["simulate", *surface, "--instrument", str(rig), *plan, "-o", str(output)]


def one_document(stdout):
    """The document; json.loads refuses anything before or after it."""
    assert stdout.endswith("\n")
    return json.loads(stdout)


# ---------------------------------------------------------------- help and start


def test_help_lists_every_command(gonio):
    for words in (["--help"], ["-h"]):
        code, out, err = gonio(*words)
        assert (code, err) == (0, "")
        for name, line in cli._COMMANDS.items():
            assert name in out
            assert line in out
        assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command(gonio, name):
    code, out, err = gonio(name, "--help")
    assert (code, err) == (0, "")
    assert f"Usage: gonio {name}" in out
    command = importlib.import_module(f"gonio.cli.{cli._FILES.get(name, name)}").command
    summary = command.help.strip().partition("\n")[0]
    assert summary in " ".join(out.split())
    # Every option says what it does.
    assert all(p.help for p in command.params if p.param_type_name == "option")


def test_help_imports_no_command_and_nothing_heavy():
    program = (
        "import sys\n"
        "from gonio.cli import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit:\n    print(*sys.modules, file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    loaded = set(done.stderr.split())
    assert "gonio.cli" in loaded
    assert not loaded & {
        *HEAVY,
        "numpy",
        *(f"gonio.cli.{cli._FILES.get(name, name)}" for name in COMMANDS),
    }


def test_version(gonio):
    assert gonio("--version") == (0, f"gonio {__version__}\n", "")


def test_no_command_is_a_usage_error_with_the_help(gonio):
    code, out, err = gonio()
    assert (code, out) == (2, "")
    assert "Commands" in err


# ---------------------------------------------------------------- usage and configuration: 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("simulat", "unknown command 'simulat': did you mean 'simulate'?"),
        ("--versio", "No such option '--versio'."),
        ("simulate foam", "Missing option '-o' / '--output'."),
        ("simulate foam -o OUT --seed x", "Invalid value for '--seed': 'x' is not a valid integer"),
        ("simulate foam -o OUT --threads 0", "0 is not in the range x>=1."),
        ("materials foam sand", "Got unexpected extra argument (sand)"),
        ("reduce", "Missing argument 'SESSION'."),
    ],
)
def test_usage_errors(gonio, tmp_path, words, message):
    code, out, err = gonio(*words.replace("OUT", str(tmp_path / "s")).split())
    assert (code, out) == (2, "")
    usage, hint, error = err.splitlines()
    assert usage.startswith("Usage: gonio ")
    assert hint.startswith("Try 'gonio ")
    assert error.startswith("Error: ")
    assert message in error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("simulate rolled_bras", "unknown material 'rolled_bras': did you mean 'rolled_brass'?"),
        ("simulate --model wrd", "unknown model 'wrd': did you mean 'ward'?"),
        ("simulate --model ward -p rho_x=1", "unknown parameter 'rho_x' of ward: did you mean"),
        ("simulate --model ward -p rho_d", "-p 'rho_d' is not NAME=VALUE; write for example"),
        ("simulate --model ward -p rho_d=2", "rho_d = 2 is out of range; allowed is 0 to 1."),
        ("simulate --model ward -p rho_d=a", "rho_d = 'a' is not a number; allowed is 0 to 1."),
        ("simulate", "give a MATERIAL or --model NAME; neither was given."),
        ("simulate foam --model ward", "give a MATERIAL or --model NAME; both were given."),
        ("simulate foam -p rho=1", "-p goes with --model, and foam has its own parameters;"),
        ("simulate foam --instrument modren12", "unknown instrument 'modren12': did you mean "),
        ("simulate foam --instrument none.toml", "none.toml: cannot be read as text"),
        ("simulate foam --theta-i 0,80", "80 deg is out of reach of the lamp arm of modern12; all"),
        ("simulate foam --theta-i -1", "-1 deg is out of reach of the lamp arm of modern12; allow"),
        ("simulate foam --theta-i nan", "--theta-i 'nan' is not a list of angles in degrees such"),
        ("simulate foam --rotations 0,", "--rotations '0,' is not a list of angles in degrees su"),
        ("simulate foam --seed -1", "seed = -1 is out of range; allowed is 0 to 2^63 - 1."),
    ],
)
def test_settings_that_are_refused(gonio, tmp_path, words, message):
    code, out, err = gonio(*words.split(), "-o", tmp_path / "s")
    assert (code, out) == (2, "")
    error = err.splitlines()[-1]
    assert error.startswith("Error: ")
    assert message in error
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_angles_out_of_range_are_reported_in_degrees(gonio, tmp_path):
    code, out, err = gonio(
        "simulate", "--model", "oren_nayar", "-p", "sigma=100", "-o", tmp_path / "s"
    )
    assert (code, out) == (2, "")
    assert "100 deg" in err
    assert "60 deg" in err


def test_wrong_key_of_an_instrument_file(gonio, rig, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(rig.read_text().replace("vignetting =", "vigneting ="))
    code, out, err = gonio(*simulate_words(file, tmp_path / "s"))
    assert (code, out) == (2, "")
    assert "mine.toml: lens.vigneting: unknown key 'vigneting': did you mean 'vignetting'?" in err
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("instruments lbl", "unknown instrument 'lbl': did you mean 'lbl1992'?"),
        ("instruments --toml", "--toml prints the file of one preset; without --json, give one of"),
        ("instruments ideal12 --toml --json", "without --json, give one of"),
        ("materials foma", "unknown material 'foma': did you mean 'foam'?"),
        ("models wrd --json", "unknown model 'wrd': did you mean 'ward'?"),
    ],
)
def test_lists_refuse_unknown_names(gonio, words, message):
    code, out, err = gonio(*words.split())
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1


def test_reduce_checks_its_target_before_the_work(gonio, recorded, tmp_path, monkeypatch):
    monkeypatch.setattr(Session, "frame", None)
    (tmp_path / "folder.nc").mkdir()
    for target, code, message in (
        (tmp_path / "none" / "x.nc", 3, "does not exist; make it first."),
        (tmp_path / "x.csv", 2, "give a name that ends in .nc."),
        (tmp_path / "folder.nc", 2, "is a folder; give the name of a file."),
    ):
        found, out, err = gonio("reduce", recorded, "-o", target)
        assert (found, out) == (code, "")
        assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["folder.nc"]


def test_another_session_is_not_overwritten(gonio, rig, recorded, tmp_path):
    code, _, err = gonio(*simulate_words(rig, recorded), "--seed", 3)
    assert code == 2
    assert "made with other settings or another seed than the one asked for" in err
    assert "give another folder or delete it." in err
    (tmp_path / "notes.txt").write_text("mine")
    code, _, err = gonio(*simulate_words(rig, tmp_path))
    assert code == 2
    assert "exists and is not a session; give another name." in err
    assert (tmp_path / "notes.txt").read_text() == "mine"


# ---------------------------------------------------------------- data: 3


def chunk(path):
    return path / "frames.zarr" / "sample" / "c" / "0" / "1" / "2" / "0" / "0"


def cut_metadata(path):
    file = path / "session.json"
    file.write_bytes(file.read_bytes()[:200])


def drop_metadata(path):
    (path / "session.json").unlink()


def cut_frame(path):
    file = chunk(path)
    file.write_bytes(file.read_bytes()[:40])


def change_crc(path):
    file = path / "manifest.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    for line in lines:
        line["crc32"] ^= line["frame"] == "sample/0/1/2"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))


def cut_manifest(path):
    file = path / "manifest.jsonl"
    file.write_bytes(file.read_bytes()[:-10])


def garble_manifest(path):
    file = path / "manifest.jsonl"
    file.write_text(file.read_text().replace('"crc32"', '"crc"', 1))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (shutil.rmtree, "copy.gonio: no such session; give a folder that 'gonio simulate' or"),
        (drop_metadata, "copy.gonio: not a session, session.json is missing."),
        (cut_metadata, "session.json: content: "),
        (cut_frame, "frame sample/0/1/2 cannot be read"),
        (change_crc, "frame sample/0/1/2 fails its crc32 check; it is damaged, take it again."),
        (cut_manifest, "35 of 36 frames are there; run the same 'gonio simulate' or"),
        (garble_manifest, "manifest.jsonl: line 1 is not a frame's line."),
    ],
)
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_sessions_that_cannot_be_used(gonio, damaged, tmp_path, damage, message, options):
    damage(damaged)
    before = sorted(tmp_path.iterdir())
    code, out, err = gonio("reduce", damaged, "-o", tmp_path / "x.nc", *options)
    assert (code, out) == (3, "")
    assert message in err.splitlines()[-1]
    assert "Traceback" not in err
    assert sorted(tmp_path.iterdir()) == before


def test_a_torn_session_is_finished_by_the_same_command(gonio, rig, damaged, recorded):
    cut_manifest(damaged)
    code, out, _ = gonio(*simulate_words(rig, damaged))
    assert code == 0
    assert "36 frames, 35 of them from before" in out
    assert manifest(damaged) == manifest(recorded)


def full_after(n):
    """`os.fsync` of a disk that is full after n calls."""
    real, calls = os.fsync, []

    def fsync(handle):
        calls.append(handle)
        if len(calls) > n:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(handle)

    return fsync


def test_full_disk_while_simulating(gonio, rig, recorded, tmp_path, monkeypatch):
    path = tmp_path / "s"
    with monkeypatch.context() as patch:
        patch.setattr(session.os, "fsync", full_after(40))
        code, out, err = gonio(*simulate_words(rig, path))
    assert (code, out) == (3, "")
    assert (
        "s: cannot be written (No space left on device); free space and run the same command "
        "again, frames already acknowledged are kept."
    ) in err.splitlines()[-1]
    kept = Session.open(path).n_done
    assert 0 < kept < 36
    code, out, _ = gonio(*simulate_words(rig, path), "--json")
    assert code == 0
    assert one_document(out)["frames_added"] == 36 - kept
    assert manifest(path) == manifest(recorded)


def test_full_disk_while_reducing(gonio, recorded, tmp_path, monkeypatch):
    target = tmp_path / "x.nc"
    target.write_text("older")
    monkeypatch.setattr(session.os, "fsync", full_after(0))
    code, out, err = gonio("reduce", recorded, "-o", target)
    assert (code, out) == (3, "")
    assert "x.nc: cannot be written (No space left on device); nothing was left behind" in err
    assert target.read_text() == "older"
    assert [path.name for path in tmp_path.iterdir()] == ["x.nc"]


def test_refusals_of_the_system_are_one_sentence(gonio, tmp_path, monkeypatch):
    def refuse(*words, **options):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "/some/file")

    monkeypatch.setattr(simulation, "simulate", refuse)
    code, out, err = gonio("simulate", "foam", "-o", tmp_path / "s")
    assert (code, out) == (3, "")
    assert err.splitlines()[-1] == "Error: /some/file: Permission denied."


# ---------------------------------------------------------------- faults: 1


def test_a_fault_is_one_sentence(gonio, tmp_path, monkeypatch):
    def fail(*words, **options):
        raise ValueError("first\nsecond")

    monkeypatch.delenv("GONIO_DEBUG", raising=False)
    monkeypatch.setattr(simulation, "simulate", fail)
    code, out, err = gonio("simulate", "foam", "-o", tmp_path / "s")
    assert (code, out) == (1, "")
    assert err.splitlines()[-1] == (
        "Error: unexpected ValueError: first second. This is a fault in gonio: run it again with "
        "GONIO_DEBUG=1 and report what it prints, together with the output of 'gonio doctor'."
    )
    monkeypatch.setenv("GONIO_DEBUG", "1")
    code, out, err = gonio("simulate", "foam", "-o", tmp_path / "s")
    assert (code, out) == (1, "")
    assert "Traceback" in err


def test_a_reader_that_goes_away_is_no_error():
    process = subprocess.Popen(
        [sys.executable, "-m", "gonio", "materials"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 1


# ---------------------------------------------------------------- interruption: 4


def manifest(path):
    """crc32 of every frame: equal manifests are equal frames."""
    lines = (path / "manifest.jsonl").read_text().splitlines()
    return {line["frame"]: line["crc32"] for line in map(json.loads, lines)}


def test_interrupted_simulation_is_continued_by_the_same_command(gonio, rig, tmp_path):
    path, whole = tmp_path / "s", tmp_path / "whole"
    plan = ("--theta-i", "0,10,20,30,40,50,60,70")
    n = 8 * 5 * 6
    words = simulate_words(rig, path, plan=plan)
    process = subprocess.Popen(
        [sys.executable, "-m", "gonio", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # A shell that runs the tests in its background has them ignore this signal, and all that
        # they start.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (path / "manifest.jsonl").is_file() or not manifest_size(path):
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (4, "")
    kept = Session.open(path).n_done
    assert 0 < kept < n
    assert err.splitlines()[-1] == (
        f"interrupted; run the same command again to continue. {kept} of {n} frames are safe in "
        f"{path}."
    )
    code, out, _ = gonio("reduce", path, "-o", tmp_path / "x.nc")
    assert (code, out) == (3, "")

    code, out, _ = gonio(*words, "--json")
    assert code == 0
    assert one_document(out)["frames_added"] == n - kept
    assert gonio(*simulate_words(rig, whole, plan=plan))[0] == 0
    assert manifest(path) == manifest(whole)


def manifest_size(path):
    return (path / "manifest.jsonl").stat().st_size


def test_interrupted_reduction_leaves_nothing(gonio, recorded, tmp_path, monkeypatch):
    def interrupt(*words, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(BRDFSamples, "save", interrupt)
    code, out, err = gonio("reduce", recorded, "-o", tmp_path / "x.nc")
    assert (code, out) == (4, "")
    assert err.splitlines()[-1] == "interrupted; run the same command again."
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- simulate and reduce


def test_simulate_tells_what_it_made(gonio, rig, tmp_path):
    path = tmp_path / "s"
    words = simulate_words(
        rig, path, surface=("--model", "lambert", "-p", "rho=0.5"), plan=PLAN[:2]
    )
    code, out, err = gonio(*words)
    assert code == 0
    assert out.startswith(f"{path}: 36 frames, ")
    start, end = err.splitlines()
    assert start == "simulating lambert on small12 ..."
    assert end.startswith("simulating lambert on small12: 36 of 36 frames in ")

    code, out, err = gonio(*words)
    assert code == 0
    assert out.startswith(f"{path}: already complete, 36 frames, ")


def test_simulate_json(gonio, rig, recorded):
    code, out, _ = gonio(*simulate_words(rig, recorded), "--json")
    document = one_document(out)
    assert code == 0
    assert document.pop("bytes") > 10_000
    assert document == {
        "schema": "gonio.simulate/1",
        "session": str(recorded),
        "sample": "rolled_brass",
        "instrument": "small12",
        "seed": 0,
        "mode": "reflection",
        "theta_i_deg": [0, 30],
        "rotations_deg": [0],
        "exposures_s": [0.25e-3, 1e-3, 4e-3, 16e-3, 64e-3, 256e-3],
        "standard_theta_i_deg": None,
        "wedge_deg": 0,
        "channels": [{"name": "", "wavelength_nm": None}],
        "images": {"background": 2, "standard": 2, "sample": 2},
        "rows": 52,
        "columns": 52,
        "frames": 36,
        "frames_added": 0,
    }


@pytest.mark.parametrize(
    ("surface", "rotations"),
    [
        (("rolled_brass",), [0, 45, 90]),
        (("plastic_laminate",), [0]),
        (("wall_plaster",), [0]),
        (("--model", "ward", "-p", "alpha_x=0.2"), [0, 45, 90]),
        (("--model", "ward"), [0]),
    ],
)
def test_rotations_follow_the_surface(gonio, rig, tmp_path, surface, rotations):
    plan = ("--theta-i", "0")
    code, out, err = gonio(
        *simulate_words(rig, tmp_path / "s", surface=surface, plan=plan), "--json"
    )
    assert code == 0
    assert one_document(out)["rotations_deg"] == rotations
    assert ("Default values are used for" in err) == ("ward" in surface)


def test_the_plan_of_the_command_line_is_that_of_python(gonio, rig, tmp_path):
    """Left to its defaults the command continues what Python began: one fingerprint."""

    class StopError(Exception):
        pass

    def stop(done, total):
        raise StopError

    path = tmp_path / "s"
    with pytest.raises(StopError):
        simulation.simulate("rolled_brass", output=path, instrument=str(rig), progress=stop)
    code, _, err = gonio("simulate", "rolled_brass", "--instrument", rig, "-o", path, "--seed", 1)
    assert code == 2
    assert "another seed" in err
    code, out, _ = gonio("simulate", "rolled_brass", "--instrument", rig, "-o", path)
    assert code == 0
    assert re.search(r"630 frames, [12] of them from before", out)


def test_reduce_tells_what_it_made(gonio, recorded, tmp_path):
    path = tmp_path / "x.nc"
    code, out, err = gonio("reduce", recorded, "-o", path, "--threads", 1)
    assert code == 0
    samples = BRDFSamples.load(path)
    *history, summary = out.splitlines()
    assert [line.removeprefix("- ") for line in history] == list(samples.history)
    negative = int((samples.value < 0).sum())
    assert summary.startswith(f"{path}: {len(samples)} samples, {negative} of them negative")
    assert err.splitlines()[-1].startswith("reducing brass.gonio: 2 of 2 images in ")

    code, out, _ = gonio("reduce", recorded, "-o", path, "--json")
    document = one_document(out)
    assert code == 0
    assert document["schema"] == "gonio.reduce/1"
    assert (document["sample"], document["instrument"]) == ("rolled_brass", "small12")
    assert (document["n_samples"], document["n_negative"]) == (len(samples), negative)
    assert document["history"] == list(samples.history)
    assert [file.name for file in tmp_path.iterdir()] == ["x.nc"]


# ---------------------------------------------------------------- lists and doctor


def test_instruments(gonio, rig):
    code, out, err = gonio("instruments")
    assert (code, err) == (0, "")
    assert all(name in out for name in preset_names())
    documents = one_document(gonio("instruments", "--json")[1])
    assert [document["name"] for document in documents] == preset_names()

    code, out, err = gonio("instruments", rig)
    assert (code, err) == (0, "")
    assert "small12" in out
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines()]
    values = {row[0]: row[1] for row in rows if len(row) == 3}
    assert values["dome.R"] == "150 mm"
    assert values["sensor.pitch_um"] == "27.6, 27.6 µm"
    assert values["sensor.dark_e_per_s"] == "2 e-/s"
    assert values["usable_theta_r_deg"] == "80 deg"
    document = one_document(gonio("instruments", rig, "--json")[1])
    assert document["dome"]["R"] == 150
    named = {key for key, value in document.items() if not isinstance(value, dict | list)}
    assert values["channels.1.relative_rate"] == "1"
    parts = {
        f"{part}.{key}"
        for part, fields in document.items()
        if isinstance(fields, dict)
        for key in fields
    }
    assert (named - {"name", "description"}) | parts <= set(values)


def test_the_file_of_a_preset_can_be_used(gonio, tmp_path):
    file = tmp_path / "mine.toml"
    code, out, err = gonio("instruments", "lbl1992", "--toml")
    assert (code, err) == (0, "")
    file.write_text(out, encoding="utf-8")
    assert out.startswith("# ")
    as_json = [gonio("instruments", name, "--json")[1] for name in ("lbl1992", file)]
    assert as_json[0] == as_json[1]


@pytest.mark.parametrize("words", ["materials", "models", "materials foam", "models ward"])
def test_lists_print_one_document(gonio, words):
    code, out, err = gonio(*words.split(), "--json")
    assert (code, err) == (0, "")
    document = one_document(out)
    if words == "materials":
        assert [each["name"] for each in document] == materials.names()


def test_doctor(gonio):
    code, out, err = gonio("doctor")
    assert (code, err) == (0, "")
    assert out.count("\npass ") == 2
    assert out.endswith("Everything works.\n")
    code, out, err = gonio("doctor", "--json")
    assert (code, err) == (0, "")
    document = one_document(out)
    assert document["ok"] is True
    assert document["gonio"] == __version__
    assert document["cores"] >= 1
    assert document["missing"] == []
    assert document["dependencies"]["numba"]
    assert "pytest" not in document["dependencies"]
    assert all(check["ok"] for check in document["checks"])


@pytest.mark.parametrize("compute", [lambda: (1.0 + 1e-11, 1.0), lambda: 1 / 0])
def test_doctor_finds_a_wrong_number(gonio, monkeypatch, compute):
    monkeypatch.setattr(doctor, "_CHECKS", (("one", compute),))
    code, out, _ = gonio("doctor")
    assert code == 1
    assert "\nFAIL           one: " in out
    assert out.endswith("Something is wrong: see above.\n")
    code, out, _ = gonio("doctor", "--json")
    assert code == 1
    assert one_document(out)["ok"] is False


def test_doctor_without_a_dependency(gonio, monkeypatch):
    real = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "zarr" else real(name))
    code, out, _ = gonio("doctor")
    assert code == 1
    assert "zarr         MISSING; install gonio again with its dependencies" in out
    assert one_document(gonio("doctor", "--json")[1])["missing"] == ["zarr"]


def test_doctor_says_what_the_extras_are_for_and_how_to_get_them(gonio, monkeypatch):
    real = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "rawpy" else real(name))
    code, out, _ = gonio("doctor")
    assert code == 0
    assert (
        "extra raw      for raw files of digital cameras: not installed; "
        "python -m pip install 'gonio[raw]'\n"
    ) in out
    monkeypatch.setattr(doctor, "_version", lambda name: "1.2" if name == "rawpy" else real(name))
    assert "extra raw      for raw files of digital cameras: rawpy 1.2\n" in gonio("doctor")[1]
    document = one_document(gonio("doctor", "--json")[1])
    assert document["extras"]["raw"] == {
        "for": "raw files of digital cameras",
        "packages": {"rawpy": "1.2"},
        "installed": True,
        "install": "python -m pip install 'gonio[raw]'",
    }
    _, every = doctor._requirements()
    assert set(document["extras"]) == set(doctor.EXTRAS) == set(every) - {"docs", "test"}


def test_doctor_without_a_cache(gonio, monkeypatch, tmp_path):
    from gonio import cache

    (tmp_path / "file").write_text("")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("GONIO_CACHE_DIR", str(tmp_path / "file" / "cache"))
    cache.folder.cache_clear()
    try:
        code, out, _ = gonio("doctor")
    finally:
        monkeypatch.undo()
        cache.folder.cache_clear()
    assert code == 0
    assert "CANNOT be written" in out
