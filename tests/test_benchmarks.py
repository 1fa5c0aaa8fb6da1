"""The benchmarks' report, without its figures: nothing here depends on a time."""

import importlib
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def benchmarks(monkeypatch):
    """Loads a module of the folder `benchmarks`, which is not installed with the package."""
    monkeypatch.syspath_prepend(ROOT)
    return lambda name: importlib.import_module(f"benchmarks.{name}")


@pytest.fixture
def report(benchmarks):
    row = benchmarks("timing").Row
    rows = [row("ward", 4.41e8, "numpy", 7.6, "one"), row("ggx", None, "peer", None, "skipped: no")]
    return {
        "command": "python -m benchmarks",
        "machine": {"processor": "CPU", "cores": 2},
        "versions": {"python": "3.11.7", "mitsuba": None},
        "sections": [{"section": "s", "cores_given": 1.9, "rows": [asdict(r) for r in rows]}],
        "start_up_s": {"gonio --help": 0.31, "python": 0.02},
        "first_call_s": {"ward, evaluate, compiled": 1.26},
    }


def test_the_terminal_shows_one_table(benchmarks, report):
    text = benchmarks("page").terminal(report)
    assert "s: 1.9 of 2 cores given" in text
    assert [line.split() for line in text.splitlines() if line.startswith(("ward ", "ggx"))] == [
        ["ward", "441", "M", "7.6", "numpy", "one"],
        ["ggx", "peer", "skipped:", "no"],
    ]
    assert "python 3.11.7." in text
    assert "first call of ward, evaluate, compiled: 1.26 s" in text
    assert "mitsuba" not in text


def test_the_page_holds_the_command_that_made_it(benchmarks, report, tmp_path):
    path = tmp_path / "benchmarks.md"
    benchmarks("page").write(path, report)
    text = path.read_text(encoding="utf-8")
    assert "```sh\npython -m benchmarks\n```" in text
    assert "| ward | 441 M | 7.6 | numpy | one |" in text
    assert "| ggx |  |  | peer | skipped: no |" in text
    assert "| ward, evaluate, compiled | 1.26 |" in text


def test_the_page_in_the_documentation_is_by_this_program(benchmarks):
    text = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert text.startswith(benchmarks("page").HEAD)
    assert "\npython -m benchmarks --markdown docs/benchmarks.md\n" in text


@pytest.mark.parametrize(
    ("value", "text"),
    [(4.41e8, "441 M"), (9.9951e8, "1.00 G"), (1e6, "1.00 M"), (12_345, "12.3 k"), (3.21, "3.21")],
)
def test_a_rate_has_three_digits(benchmarks, value, text):
    assert benchmarks("page").rate(value) == text


def test_a_peer_that_is_absent_is_skipped_with_a_word(benchmarks, monkeypatch):
    peers = benchmarks("peers")
    for name in ("mitsuba", "pySCATMECH", "pySCATMECH.brdf", "pyradiance"):
        monkeypatch.setitem(sys.modules, name, None)
    rows = peers.run()
    assert len(rows) == len(peers.COMPARISONS)
    assert all(row.ours_per_s is None and row.ratio is None for row in rows)
    assert {row.note for row in rows} == {
        f"skipped: {name} is not installed" for name in ("mitsuba", "pySCATMECH", "pyradiance")
    }


def test_every_section_can_be_run(benchmarks):
    for module in benchmarks("__main__").SECTIONS.values():
        assert callable(importlib.import_module(module).run)
