"""The directive `console`: commands that run when the site is built, shown with their output.

    ```{console}
    $ gonio evaluate ward --angles directions.csv
    ```

A line that begins with "$ " begins a command, the lines below it belong to it. The commands of a
page run one after the other in one empty folder; one that fails is an error of the build. `:lines:`
shows so many lines of each output.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util.docutils import SphinxDirective

LIMIT = 120  # seconds for one command
WIDTH = 88  # characters of a line
BOX = re.compile("[─-╿]")
CLOCK = re.compile(r" in \d+\.\d s$", re.MULTILINE)


class Console(SphinxDirective):
    """Commands in a shell and what they print."""

    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {"lines": directives.positive_int}

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()  # what is printed depends on the program, not on the page alone
        shown = []
        for command in commands("\n".join(self.content)):
            try:
                output = run(command, self._folder())
            except RuntimeError as failure:
                raise self.error(str(failure)) from None
            shown += [f"$ {command}", *map(fold, cut(output, self.options.get("lines")))]
        text = "\n".join(shown)
        return [nodes.literal_block(text, text, language="console")]

    def _folder(self) -> Path:
        """An empty folder for each page, which lives as long as the build."""
        folders: dict[str, Any] = self.env.app.__dict__.setdefault("_console_folders", {})
        page = folders.setdefault(self.env.docname, tempfile.TemporaryDirectory())
        return Path(page.name)


def commands(text: str) -> list[str]:
    """The commands of a block.

    Examples
    --------
    >>> commands("$ cat > a <<'END'\\n1\\nEND\\n$ cat a")
    ["cat > a <<'END'\\n1\\nEND", 'cat a']
    """
    return [part.rstrip() for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]]


def run(command: str, folder: Path) -> str:
    """What a command prints, the messages of progress included."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", command],
        cwd=folder,
        env={**os.environ, "PATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"exit code {done.returncode} from: {command}\n{done.stdout}")
    return CLOCK.sub("", done.stdout).rstrip()


def cut(output: str, lines: int | None) -> list[str]:
    """The first lines of an output, and a sign where others are left out."""
    every = output.splitlines()
    return every if lines is None or len(every) <= lines else [*every[:lines], "..."]


def fold(line: str) -> str:
    """A line of prose in the width of the page; a table keeps its lines."""
    if len(line) <= WIDTH or BOX.search(line):
        return line
    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_long_words=False)


def setup(app: Any) -> dict[str, Any]:
    app.add_directive("console", Console)
    return {"parallel_read_safe": False}
