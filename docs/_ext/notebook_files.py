"""Notebooks as files for Jupyter, .ipynb, with output; they are made when the site is built.

A lesson runs cell by cell when the site is built. A notebook on a paper takes minutes; its output
is what the last full run left in docs/papers/: the figures and tables of each cell.
"""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import re
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PNG, MARKDOWN, PLAIN, HTML = "image/png", "text/markdown", "text/plain", "text/html"


@dataclass(frozen=True)
class Output:
    """What a code cell shows.

    Parameters
    ----------
    kind : str
        MIME type; text/plain that was printed.
    text : str
        The text; of a PNG, base64.
    """

    kind: str
    text: str


def picture(png: bytes) -> Output:
    return Output(PNG, base64.b64encode(png).decode("ascii"))


def executed(sources: Iterable[str], name: str) -> list[list[Output]]:
    """Run code cells one after the other in an empty folder; what each of them shows.

    Raises
    ------
    RuntimeError
        If a cell fails, with the name of the notebook and the cell.
    """
    space: dict[str, Any] = {"__name__": "__main__"}
    found = []
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for number, source in enumerate(sources, 1):
                try:
                    found.append(_shown(source, space, f"<{name}, cell {number}>"))
                except Exception as error:
                    raise RuntimeError(f"{name}, code cell {number}: {error!r}") from error
        finally:
            os.chdir(before)
    return found


def _shown(source: str, space: dict[str, Any], where: str) -> list[Output]:
    """Run one cell as Jupyter does: what it prints, its last expression, its figures."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    said = io.StringIO()
    with redirect_stdout(said):
        exec(compile(tree, where, "exec"), space)
        value = None
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), where, "eval"), space)
    outputs = [Output(PLAIN, said.getvalue())] if said.getvalue() else []
    if value is not None:
        html = getattr(value, "_repr_html_", lambda: None)()
        outputs.append(Output(PLAIN, repr(value)) if html is None else Output(HTML, html))
    return outputs + figures()


def figures() -> list[Output]:
    """The open figures of pyplot as PNG, which are closed then."""
    import matplotlib.pyplot as plt

    found = []
    for number in plt.get_fignums():
        stream = io.BytesIO()
        plt.figure(number).savefig(stream, format="png", dpi=110, metadata={})
        found.append(picture(stream.getvalue()))
    plt.close("all")
    return found


def document(cells: Sequence[Any], outputs: Sequence[Sequence[Output]], note: str) -> str:
    """A notebook of format 4.5 as JSON.

    Parameters
    ----------
    cells : sequence of Cell
        As `notebook_pages.cells` reads them.
    outputs : sequence
        Of the code cells, in their order.
    note : str
        Behind the first text, in Markdown.
    """
    written = []
    of_code = iter(outputs)
    count = 0
    for k, cell in enumerate(cells):
        source = _unlinked(cell.source) if cell.markdown else cell.source
        entry: dict[str, Any] = {"id": f"cell-{k}", "metadata": {}}
        if cell.markdown:
            source += f"\n\n{note}" if k == 0 else ""
            entry |= {"cell_type": "markdown"}
        else:
            count += 1
            if cell.tags:
                entry["metadata"] = {"tags": list(cell.tags)}
            entry |= {"cell_type": "code", "execution_count": count,
                      "outputs": [_written(output) for output in next(of_code)]}  # fmt: skip
        written.append({**entry, "source": source.splitlines(keepends=True)})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {
        "cells": written,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _written(output: Output) -> dict[str, Any]:
    lines = output.text.splitlines(keepends=True)
    if output.kind == PLAIN:
        return {"output_type": "stream", "name": "stdout", "text": lines}
    data: dict[str, Any] = {output.kind: output.text if output.kind == PNG else lines}
    return {"output_type": "display_data", "data": data, "metadata": {}}


def _unlinked(text: str) -> str:
    """Text without links to files of the sources, which a notebook by itself does not have."""
    return re.sub(r"\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", text)
