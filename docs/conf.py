"""Settings of the documentation site; `make docs` builds it.

Pages that follow from the program are written to docs/_generated before Sphinx looks for pages:
models, commands, Python, and the texts that stand at the root of the project. git ignores them.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl

HERE = Path(__file__).parent
ROOT = HERE.parent
GENERATED = HERE / "_generated"
sys.path.insert(0, str(HERE / "_ext"))
mpl.use("Agg")

import angles  # noqa: E402
import calibration_pages  # noqa: E402
import command_pages  # noqa: E402
import model_pages  # noqa: E402
import notebook_pages  # noqa: E402
import question_pages  # noqa: E402
import render_pictures  # noqa: E402

import gonio  # noqa: E402

project = "gonio"
author = "The gonio developers"
version = release = gonio.__version__
html_title = f"gonio {version}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "console"]
exclude_patterns = ["_ext", "examples", "recovery", "papers"]
nitpicky = True
# A name in backquotes may be a parameter or a field, which have no place to link to.
# The questions are a table of the file formats' page; their records have no page.
nitpick_ignore_regex = [("py:obj", ".*"), ("py:class", r"gonio\.checks\.questions\..*")]

myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3

default_role = "py:obj"  # `name` in a docstring: a link where there is something of that name
autodoc_typehints = "none"  # the docstrings state types, shapes and units
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
python_use_unqualified_type_names = True
toc_object_entries = False

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["gonio.css"]
html_show_copyright = False
html_copy_source = False

# Texts at the root of the project that are pages of the site too.
ROOT_PAGES = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}


def generate(app: Any) -> None:
    """Write everything below docs/_generated anew."""
    shutil.rmtree(GENERATED, ignore_errors=True)
    for name in ("models", "commands", "python", "papers", "render", "calibration"):
        (GENERATED / name).mkdir(parents=True)
    model_pages.write(GENERATED / "models", (HERE / "errata.md").read_text(encoding="utf-8"))
    command_pages.write_commands(GENERATED / "commands")
    command_pages.write_python(GENERATED / "python")
    notebook_pages.write(GENERATED / "papers", ROOT / "notebooks", HERE / "papers")
    calibration_pages.write(GENERATED / "calibration")
    question_pages.write(GENERATED / "checks")
    angles.draw(GENERATED / "angles.png")
    render_pictures.write(GENERATED / "render")
    for source, target in ROOT_PAGES.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        (GENERATED / target).write_text(text.replace("](docs/", "](../"), encoding="utf-8")


def relink(app: Any, docname: str, source: list[str]) -> None:
    """Point links to texts at the root of the project to their pages."""
    up = "../" * docname.count("/")
    for name, page in ROOT_PAGES.items():
        link = rf"\]\((?:\.\./)+{re.escape(name)}"
        source[0] = re.sub(link, f"]({up}_generated/{page}", source[0])


def list_decisions(app: Any, docname: str, source: list[str]) -> None:
    """Put every decision into the site's navigation; a code host needs no such list."""
    if docname == "adr/README":
        source[0] += "\n```{toctree}\n:hidden:\n:glob:\n\n0*\n```\n"


def as_written(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are plain text: |a - b|, rho*cos and names that end in _ are no marks."""
    for k, line in enumerate(lines):
        if not re.match(r"\s*(>>>|\.\.\. |\*+\w+ :)", line):
            parts = re.split(r"(``.+?``)", line)
            parts[::2] = [re.sub(r"([*|]|(?<=\w)_(?!\w))", r"\\\1", part) for part in parts[::2]]
            lines[k] = "".join(parts)


def setup(app: Any) -> None:
    app.connect("builder-inited", generate)
    app.connect("source-read", relink)
    app.connect("source-read", list_decisions)
    app.connect("autodoc-process-docstring", as_written, priority=400)  # before numpydoc
