"""Pages of the notebooks, made from their percent scripts and the results of the last full run.

A markdown cell becomes text, a code cell becomes code, and behind it stand the figures and tables
that it writes, from docs/papers/. Nothing runs when the site is built: `make papers` does that.
"""

from __future__ import annotations

import ast
import csv
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from model_pages import escape

CELL = re.compile(r"^# %%(?P<rest>.*)$", re.MULTILINE)
HIDDEN = "hide-input"  # tag of a cell whose code is folded, such as one that draws
HOW = """*This page is made from a percent script of the sources, which runs as it stands,
in Jupyter or by `python notebooks/{name}.py`.*"""


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
    for name in names:
        script = (notebooks / f"{name}.py").read_text(encoding="utf-8")
        titles[name] = title_of(script)
        for picture in sorted((papers / name).glob("*.png")):
            shutil.copyfile(picture, folder / f"{name}_{picture.name}")
        own = [row for row in rows if row["notebook"] == name]
        text = "\n\n".join(page(name, script, papers / name, own))
        (folder / f"{name}.md").write_text(text + "\n", encoding="utf-8")
    (folder / "agreement.txt").write_text(agreement(rows, titles) + "\n", encoding="utf-8")
    (folder / "index.md").write_text(index(titles) + "\n", encoding="utf-8")
    return names


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
            # Links lead from notebooks/ to docs/; the page stands below docs/_generated/papers/,
            # and so do those of the other notebooks.
            text = cell.source.replace("](../docs/", "](../../")
            yield re.sub(r"\]\((\w+)\.py\)", r"](\1.md)", text)
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
    head = "# Notebooks\n\nThe papers' tables and figures, computed and explained."
    lines = "\n".join(f"- [{title}]({name}.md)" for name, title in titles.items())
    entries = "\n".join(titles)
    return "\n\n".join([head, lines, f"```{{toctree}}\n:hidden:\n\n{entries}\n```"])
