"""The notebooks: quick mode of each, the table of agreement, the runner, the pages of the site."""

from __future__ import annotations

import base64
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = ROOT / "notebooks"
PAPERS = ROOT / "docs" / "papers"
sys.path.insert(0, str(NOTEBOOKS))
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import _common  # noqa: E402
import notebook_files  # noqa: E402
import notebook_pages  # noqa: E402
import run  # noqa: E402

HEADER = """# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---
"""
TOY = """from _common import Notebook

nb = Notebook("toy", paper="A paper")
nb.record("a claim", 1, {value}, {value} == 1)
nb.absent("a photograph", "not published")
nb.done()
"""


@pytest.fixture
def quick(tmp_path, monkeypatch) -> Path:
    """Folder for the results of a quick run."""
    monkeypatch.setenv("GONIO_QUICK", "1")
    monkeypatch.setenv("GONIO_PAPERS", str(tmp_path))
    return tmp_path


# ---------------------------------------------------------------- the notebooks themselves


@pytest.mark.parametrize("name", run.notebooks())
def test_every_row_of_a_notebook_is_as_expected(name, quick, monkeypatch, capsys):
    path = NOTEBOOKS / f"{name}.py"
    monkeypatch.chdir(NOTEBOOKS)
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), {"__name__": "__main__"})
    plt.close("all")
    rows = _common.read_rows(quick / name / "rows.csv")
    assert rows
    assert [row["item"] for row in rows if row["agrees"] == _common.UNEXPECTED] == []
    assert len({(row["paper"], row["item"]) for row in rows}) == len(rows)
    assert {row["paper"] for row in rows} <= set(_common.PAPERS)
    assert all(row["why"] for row in rows if row["agrees"] in (_common.NO, _common.NOT_COMPUTED))
    shown = [
        f"{result}.{'png' if kind == 'figure' else 'md'}"
        for cell in notebook_pages.cells(path.read_text(encoding="utf-8"))
        if not cell.markdown
        for kind, result, _ in notebook_pages.results(cell.source)
    ]
    made = [p.name for p in (quick / name).iterdir() if p.suffix in {".png", ".md"}]
    # What a page shows is what the notebook makes: names are literal, and none is used twice.
    assert sorted(made) == sorted(shown)
    assert f"{len(rows)} rows, 0 not as expected" in capsys.readouterr().out


LESSONS = sorted(f"lessons/{path.stem}" for path in (NOTEBOOKS / "lessons").glob("*.py"))


@pytest.mark.parametrize("name", [*run.notebooks(), *LESSONS])
def test_a_notebook_is_a_percent_script_without_output(name):
    script = (NOTEBOOKS / f"{name}.py").read_text(encoding="utf-8")
    assert script.startswith(HEADER)
    cells = notebook_pages.cells(script)
    assert cells[0].markdown
    assert cells[0].source.startswith("# ")
    for cell in cells:
        if cell.markdown:
            assert re.search(r"^[^#\n]", cell.source, re.MULTILINE), "a heading without text"
        else:
            compile(cell.source, name, "exec")


@pytest.mark.skipif(not (PAPERS / "agreement.csv").is_file(), reason="no full run yet")
def test_the_table_of_the_last_full_run_has_every_row_and_none_is_unexpected():
    rows = _common.read_rows(PAPERS / "agreement.csv")
    assert {row["notebook"] for row in rows} == set(run.notebooks())
    assert [row for row in rows if row["agrees"] == _common.UNEXPECTED] == []
    assert rows == run.in_order(rows)
    for picture in PAPERS.rglob("*.png"):
        assert picture.stat().st_size <= _common.LARGEST_FIGURE


# ---------------------------------------------------------------- rows


def test_a_row_that_should_agree_and_one_that_should_not(quick, capsys):
    nb = _common.Notebook("toy", paper="A paper")
    assert nb.record("a", 1, 1.0, True)
    assert not nb.record("b", 1, 2.0, False)
    assert nb.record("c", 1, 2.0, False, differs="print is wrong")
    assert not nb.record("d", 1, 1.0, True, "how", differs="print is wrong", paper="Another")
    nb.absent("e | f", "not published")
    nb.done()
    rows = _common.read_rows(quick / "toy" / "rows.csv")
    assert [row["agrees"] for row in rows] == ["yes", "UNEXPECTED", "no", "UNEXPECTED",
                                               "not computed"]  # fmt: skip
    assert rows[3]["why"] == "print is wrong; how"
    assert rows[3]["paper"] == "Another"
    assert "5 rows, 2 not as expected.\n  b\n  d" in capsys.readouterr().out
    assert r"e \| f" in _common.markdown(["item"], [[rows[4]["item"]]])


def test_a_figure_that_is_too_large_is_refused(quick):
    import numpy as np

    nb = _common.Notebook("toy", paper="A paper")
    figure = plt.figure(figsize=(8, 8))
    figure.figimage(np.random.default_rng(1).random((880, 880)))
    with pytest.raises(ValueError, match=r"noise.png has \d+ bytes, more than 60000"):
        nb.figure(figure, "noise", "Noise.")
    plt.close(figure)


# ---------------------------------------------------------------- the runner


@pytest.fixture
def toy(tmp_path, monkeypatch) -> Path:
    """A folder with one notebook, which the runner takes for its own."""
    folder = tmp_path / "notebooks"
    folder.mkdir()
    (folder / "_common.py").write_bytes((NOTEBOOKS / "_common.py").read_bytes())
    (folder / "toy.py").write_text(TOY.format(value=1), encoding="utf-8")
    monkeypatch.setattr(run, "HERE", folder)
    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run, "PAGES", tmp_path / "papers")
    (tmp_path / "papers").mkdir()
    return tmp_path


def test_a_notebook_that_is_done_is_not_run_again_until_it_changes(toy, capsys):
    assert run.main(["--jobs", "1"]) == 0
    told = capsys.readouterr()
    assert "toy: " in told.err
    assert "2 rows: 1 not computed, 1 yes. 0 notebooks failed." in told.out
    assert run.main([]) == 0
    assert "toy: done before, 2 rows" in capsys.readouterr().err
    assert len(_common.read_rows(toy / "papers" / "agreement.csv")) == 2
    (toy / "notebooks" / "toy.py").write_text(TOY.format(value=2), encoding="utf-8")
    assert run.main([]) == 1
    assert "1 NOT AS EXPECTED" in capsys.readouterr().err


def test_a_notebook_that_fails_is_reported_with_its_error(toy, capsys):
    (toy / "notebooks" / "toy.py").write_text("raise ArithmeticError('no sum')\n", encoding="utf-8")
    assert run.main(["--quick"]) == 1
    told = capsys.readouterr().err
    assert "FAILED" in told
    assert "ArithmeticError: no sum" in told
    assert not (toy / "papers" / "agreement.csv").exists()


def test_a_name_that_no_notebook_has(toy, capsys):
    with pytest.raises(SystemExit) as left:
        run.main(["tale"])
    assert left.value.code == 2
    assert "no notebook tale; there are toy" in capsys.readouterr().err


def test_rows_of_other_notebooks_stay(toy):
    other = dict.fromkeys(_common.FIELDS, "x") | {"notebook": "other", "paper": "A paper"}
    gone = other | {"notebook": "gone"}
    _common.write_rows(toy / "papers" / "agreement.csv", [other, gone])
    (toy / "notebooks" / "other.py").write_text("", encoding="utf-8")
    assert run.main(["toy"]) == 0
    rows = _common.read_rows(toy / "papers" / "agreement.csv")
    assert [row["notebook"] for row in rows] == ["other", "toy", "toy"]


def test_a_notebook_runs_as_a_plain_script(toy):
    done = subprocess.run(
        [sys.executable, "toy.py"],
        cwd=toy / "notebooks",
        env={**os.environ, "GONIO_PAPERS": str(toy / "out")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "toy: 2 rows, 0 not as expected." in done.stdout


# ---------------------------------------------------------------- the pages


def test_a_page_shows_text_code_figures_and_rows(tmp_path):
    notebooks, papers, pages = (tmp_path / name for name in ("notebooks", "papers", "pages"))
    for folder in (notebooks, papers / "toy", pages):
        folder.mkdir(parents=True)
    script = (
        f"{HEADER}\n# %% [markdown]\n# # Title *here*\n#\n"
        "# See [errata](../docs/errata.md), [b](toy.py).\n\n"
        '# %% tags=["hide-input"]\nnb.figure(fig, "one", "What [it] shows.")\n\n'
        '# %%\nnb.table("two", head, rows)\nnb.figure(fig, "never", "Not made.")\n'
    )
    (notebooks / "toy.py").write_text(script, encoding="utf-8")
    (papers / "toy" / "one.png").write_bytes(b"png")
    (papers / "toy" / "two.md").write_text("| a |\n| --- |\n| 1 |\n", encoding="utf-8")
    row = dict(zip(_common.FIELDS, ("P", "it*m", "1", "2", "no", "why", "toy"), strict=True))
    _common.write_rows(papers / "agreement.csv", [row])
    assert notebook_pages.write(pages, notebooks, papers) == ["toy"]
    page = (pages / "toy.md").read_text(encoding="utf-8")
    assert "](../../errata.md), [b](toy.md)." in page
    assert "<details><summary>Code</summary>" in page
    assert "![What it shows.](toy_one.png)" in page
    assert "| 1 |" in page
    assert "never.png" not in page
    assert "| it\\*m | 1 | 2 | no: why |" in page
    assert (pages / "toy_one.png").read_bytes() == b"png"
    assert "[Title *here*](toy.md)" in (pages / "index.md").read_text(encoding="utf-8")
    shown = (pages / "agreement.txt").read_text(encoding="utf-8")
    assert "## P\n\n**[Title *here*](_generated/papers/toy.md)**\n\n| item |" in shown


def test_the_page_of_a_notebook_has_the_notebook_with_its_output(tmp_path):
    notebooks, papers, pages = (tmp_path / name for name in ("notebooks", "papers", "pages"))
    for folder in (notebooks, papers / "toy", pages):
        folder.mkdir(parents=True)
    script = (
        f"{HEADER}\n# %% [markdown]\n# # Title\n#\n# See [errata](../docs/errata.md).\n\n"
        '# %% tags=["hide-input"]\nnb.figure(fig, "one", "Shows.")\n\n'
        '# %%\nnb.table("two", head, rows)\n'
    )
    (notebooks / "toy.py").write_text(script, encoding="utf-8")
    (papers / "toy" / "one.png").write_bytes(b"png")
    (papers / "toy" / "two.md").write_text("| a |\n", encoding="utf-8")
    notebook_pages.write(pages, notebooks, papers)
    assert "{download}`toy.ipynb`" in (pages / "toy.md").read_text(encoding="utf-8")
    document = json.loads((pages / "toy.ipynb").read_text(encoding="utf-8"))
    require_format_4(document)
    text, figure, table = document["cells"]
    assert "".join(text["source"]).startswith("# Title\n\nSee errata.")  # a link would lead nowhere
    assert figure["metadata"] == {"tags": ["hide-input"]}
    assert base64.b64decode(figure["outputs"][0]["data"]["image/png"]) == b"png"
    assert table["outputs"][0]["data"]["text/markdown"] == ["| a |\n"]


def require_format_4(document):
    """What nbformat's schema of version 4.5 asks for."""
    assert (document["nbformat"], document["nbformat_minor"]) == (4, 5)
    assert set(document) == {"cells", "metadata", "nbformat", "nbformat_minor"}
    assert document["metadata"]["kernelspec"]["name"] == "python3"
    assert len({cell["id"] for cell in document["cells"]}) == len(document["cells"])
    for cell in document["cells"]:
        own = {"execution_count", "outputs"} if cell["cell_type"] == "code" else set()
        assert set(cell) == {"cell_type", "id", "metadata", "source"} | own
        assert isinstance(cell["source"], list)
        for output in cell.get("outputs", ()):
            streams = {"output_type", "name", "text"}, {"output_type", "data", "metadata"}
            assert set(output) == streams[output["output_type"] != "stream"]


def test_cells_show_what_jupyter_would():
    first = "import matplotlib.pyplot as plt\nplt.plot([1, 2])\nprint('said')\n1 + 1"
    outputs = notebook_files.executed([first, "x = 3", "x"], "toy")
    assert [output.kind for output in outputs[0]] == ["text/plain", "text/plain", "image/png"]
    assert [output.text for output in outputs[0][:2]] == ["said\n", "2"]
    assert outputs[1:] == [[], [notebook_files.Output("text/plain", "3")]]
    with pytest.raises(RuntimeError, match=r"toy, code cell 2: NameError"):
        notebook_files.executed(["x = 1", "y"], "toy")


@pytest.mark.parametrize("name", LESSONS)
def test_a_lesson_runs_and_shows_its_results(name, tmp_path):
    script = (NOTEBOOKS / f"{name}.py").read_text(encoding="utf-8")
    notebook_pages.write_lesson(tmp_path, Path(name).name, script)
    document = json.loads((tmp_path / f"{Path(name).name}.ipynb").read_text(encoding="utf-8"))
    require_format_4(document)
    code = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] for cell in code[1:])  # all but the imports show something
    pictures = [o for cell in code for o in cell["outputs"] if "image/png" in o.get("data", {})]
    assert len(pictures) >= 3
    page = (tmp_path / f"{Path(name).name}.md").read_text(encoding="utf-8")
    assert page.count("![") == len(pictures)
    assert not re.search(r"\]\([^)]*\.py\)", page)
