"""Pages of the notebooks, made from their percent scripts and the results of the last full run.

A markdown cell becomes text, a code cell becomes code, and behind it stand the figures and tables
that it writes, from docs/papers/: `make papers` makes them. The lessons in notebooks/lessons/ run
when the site is built. Each page has its notebook with output as a file to download.
"""

from __future__ import annotations

import ast
import base64
import csv
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from model_pages import escape
from notebook_files import HTML, MARKDOWN, PNG, Output, document, executed, picture

CELL = re.compile(r"^# %%(?P<rest>.*)$", re.MULTILINE)
HIDDEN = "hide-input"  # tag of a cell whose code is folded, such as one that draws
HOW = """Download {{download}}`{name}.ipynb`, this page as a notebook with its output. *It is made
from a percent script of the sources, which runs as it stands: `python notebooks/{name}.py`.*"""
LESSON = """Download {{download}}`{name}.ipynb`, this page as a notebook with its output. It runs
wherever gonio is installed."""
NOTE = """*The output is that of the last full run. The notebook runs in the folder `notebooks` of
gonio's sources.*"""
LESSON_NOTE = "*It runs wherever gonio is installed.*"


@dataclass(frozen=True)
class Cell:
    """A cell of a percent script.

    Parameters
    ----------
    markdown : bool
        Text, with the comment signs taken off; else code.
    tags : tuple of str
    source : str
    """

    markdown: bool
    tags: tuple[str, ...]
    source: str


def cells(script: str) -> list[Cell]:
    """The cells of a percent script, as jupytext reads them; the header is left out.

    Examples
    --------
    >>> cells('# %% [markdown]\\n# # Title\\n#\\n# Text.\\n\\n# %% tags=["hide-input"]\\nx = 1\\n')
    [Cell(markdown=True, tags=(), source='# Title\\n\\nText.'), \
Cell(markdown=False, tags=('hide-input',), source='x = 1')]
    """
    marks = list(CELL.finditer(script))
    ends = [mark.start() for mark in marks[1:]] + [len(script)]
    found = []
    for mark, end in zip(marks, ends, strict=True):
        body = script[mark.end() : end].strip("\n")
        text = "[markdown]" in mark["rest"]
        if text:
            body = re.sub(r"^# ?", "", body, flags=re.MULTILINE)
        tags = re.search(r"tags=(\[.*?\])", mark["rest"])
        found.append(Cell(text, tuple(ast.literal_eval(tags[1])) if tags else (), body))
    return found


def results(code: str) -> list[tuple[str, str, str]]:
    """Kind, name and caption of the figures and tables that a code cell writes, in order.

    Examples
    --------
    >>> results('nb.figure(fig, "fig6", "The fit.")\\nnb.table("t", head, rows)')
    [('figure', 'fig6', 'The fit.'), ('table', 't', '')]
    """
    found = []
    for node in ast.walk(ast.parse(code)):
        match node:
            case ast.Call(
                func=ast.Attribute(attr="figure"), args=[_, ast.Constant(str(name)), caption]
            ):
                told = caption.value if isinstance(caption, ast.Constant) else ""
                found.append((node.lineno, "figure", name, str(told)))
            case ast.Call(func=ast.Attribute(attr="table"), args=[ast.Constant(str(name)), *_]):
                found.append((node.lineno, "table", name, ""))
    return [(kind, name, caption) for _, kind, name, caption in sorted(found)]


def write(folder: Path, notebooks: Path, papers: Path) -> list[str]:
    """Write the page of each notebook and the table of agreement; returns the pages' names.

    Parameters
    ----------
    folder : Path
        Where to; it exists, two levels below docs.
    notebooks, papers : Path
        The scripts, and what the last full run left: figures, tables, agreement.csv.
    """
    rows = read(papers / "agreement.csv")
    names = sorted(p.stem for p in notebooks.glob("[!_]*.py") if p.stem != "run")
    titles = {}
    for path in sorted((notebooks / "lessons").glob("*.py")):
        script = path.read_text(encoding="utf-8")
        titles[path.stem] = title_of(script)
        write_lesson(folder, path.stem, script)
    for name in names:
        script = (notebooks / f"{name}.py").read_text(encoding="utf-8")
        titles[name] = title_of(script)
        for path in sorted((papers / name).glob("*.png")):
            shutil.copyfile(path, folder / f"{name}_{path.name}")
        own = [row for row in rows if row["notebook"] == name]
        text = "\n\n".join(page(name, script, papers / name, own))
        (folder / f"{name}.md").write_text(text + "\n", encoding="utf-8")
        every = cells(script)
        made = [list(outputs(c.source, papers / name)) for c in every if not c.markdown]
        (folder / f"{name}.ipynb").write_text(document(every, made, NOTE), encoding="utf-8")
    (folder / "agreement.txt").write_text(agreement(rows, titles) + "\n", encoding="utf-8")
    (folder / "index.md").write_text(index(titles) + "\n", encoding="utf-8")
    return names


def write_lesson(folder: Path, name: str, script: str) -> None:
    """Run a lesson; write its page and its notebook, both with what the cells show."""
    every = cells(script)
    made = executed([cell.source for cell in every if not cell.markdown], name)
    (folder / f"{name}.ipynb").write_text(document(every, made, LESSON_NOTE), encoding="utf-8")
    parts = []
    of_code = iter(made)
    number = 0
    for k, cell in enumerate(every):
        if cell.markdown:
            parts.append(relinked(cell.source))
            parts += [LESSON.format(name=name)] if k == 0 else []
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in next(of_code):
            if output.kind == PNG:
                number += 1
                file = f"{name}_{number}.png"
                (folder / file).write_bytes(base64.b64decode(output.text))
                parts.append(f"![What the cell above draws]({file})")
            elif output.kind == HTML:
                parts.append(f"```{{raw}} html\n{output.text}\n```")
            else:
                parts.append(f"```text\n{output.text.rstrip()}\n```")
    (folder / f"{name}.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def relinked(text: str) -> str:
    """Text whose links lead from notebooks/ to docs/, to be read below docs/_generated/papers/."""
    text = re.sub(r"\]\((?:\.\./)+docs/", "](../../", text)
    text = re.sub(r"\]\((?:\.\./)+CONTRIBUTING\.md", "](../contributing.md", text)
    return re.sub(r"\]\((?:\.\./)*(\w+)\.py\)", r"](\1.md)", text)


def outputs(code: str, made: Path) -> Iterator[Output]:
    """Figures and tables of a cell, where the last full run has made them."""
    for kind, result, _ in results(code):
        if kind == "figure" and (made / f"{result}.png").is_file():
            yield picture((made / f"{result}.png").read_bytes())
        if kind == "table" and (made / f"{result}.md").is_file():
            yield Output(MARKDOWN, (made / f"{result}.md").read_text(encoding="utf-8"))


def read(path: Path) -> list[dict[str, str]]:
    """The rows of the table of agreement; none before the first full run."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def page(name: str, script: str, made: Path, rows: list[dict[str, str]]) -> Iterator[str]:
    """The parts of a notebook's page."""
    first = True
    for cell in cells(script):
        if cell.markdown:
            yield relinked(cell.source)
            if first:
                yield HOW.format(name=name)
            first = False
            continue
        block = f"```python\n{cell.source}\n```"
        if HIDDEN in cell.tags:
            block = f"<details><summary>Code</summary>\n\n{block}\n\n</details>"
        yield block
        yield from shown(name, cell.source, made)
    if rows:
        yield "## Print and ours"
        yield table(rows)


def shown(name: str, code: str, made: Path) -> Iterator[str]:
    """Figures and tables behind a cell, where the last full run has made them."""
    for kind, result, caption in results(code):
        if kind == "figure" and (made / f"{result}.png").is_file():
            alt = re.sub(r"[\[\]]", "", caption)
            yield f"![{escape(alt)}]({name}_{result}.png)\n\n*{escape(caption)}*"
        if kind == "table" and (made / f"{result}.md").is_file():
            yield (made / f"{result}.md").read_text(encoding="utf-8").rstrip()


def table(rows: list[dict[str, str]]) -> str:
    """Rows of the table of agreement in Markdown."""
    lines = ["| item | printed | ours | agrees |", "|---|---|---|---|"]
    for row in rows:
        verdict = row["agrees"] + (f": {row['why']}" if row["why"] else "")
        every = (row["item"], row["printed"], row["ours"], verdict)
        lines.append("| " + " | ".join(escape(cell) for cell in every) + " |")
    return "\n".join(lines)


def agreement(rows: list[dict[str, str]], titles: dict[str, str]) -> str:
    """Tables by paper and notebook, for a page of the folder docs."""
    parts = []
    for paper in dict.fromkeys(row["paper"] for row in rows):
        parts.append(f"## {paper}")
        about = [row for row in rows if row["paper"] == paper]
        for name in dict.fromkeys(row["notebook"] for row in about):
            title = titles.get(name, name)
            parts.append(f"**[{title}](_generated/papers/{name}.md)**")
            parts.append(table([row for row in about if row["notebook"] == name]))
    return "\n\n".join(parts) or "`make papers` makes the table."


def title_of(script: str) -> str:
    """The first heading."""
    found = re.search(r"^# # (.*)$", script, re.MULTILINE)
    return found[1] if found else ""


def index(titles: dict[str, str]) -> str:
    """A list of the pages by their titles."""
    head = (
        "# Notebooks\n\nA lesson to begin with, then the papers' tables and figures, computed and "
        "explained. Each page has its notebook, with output, to download."
    )
    lines = "\n".join(f"- [{title}]({name}.md)" for name, title in titles.items())
    entries = "\n".join(titles)
    return "\n\n".join([head, lines, f"```{{toctree}}\n:hidden:\n\n{entries}\n```"])
