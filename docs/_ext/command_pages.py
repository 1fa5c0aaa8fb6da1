"""Pages of the command line and of Python, made from the program when the site is built."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import rich_click as click
from model_pages import escape, literal, text, toctree
from notebook_files import PLAIN, executed

import gonio
from gonio.cli import group
from gonio.verbs import TYPES, VERBS, python_name

# Rooms of the package in the order of the work; rooms that are not named here follow.
ORDER = ["models", "geometry", "samples", "session", "materials", "instrument", "simulation"]
ORDER += ["calibration", "fitting", "checks", "formats", "plot"]
# What nobody imports by hand: the command line has pages of its own.
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"  # one a room, named as the room
HIDDEN = {"__main__", "cli", "kernels", "data"}
# The rooms that the installation adds from other folders.
ADDED = ["calibration", "fitting"]
# Modules that are of use beside what their package offers by name.
BESIDE = {"gonio.models": ["sampling"]}


# ---------------------------------------------------------------- command line


def write_commands(folder: Path) -> list[str]:
    """Write the page of each command and their index; returns the names of the pages."""
    found = commands()
    for words, command in found.items():
        path = folder / f"{words.replace(' ', '_')}.md"
        path.write_text(command_page(words, command), encoding="utf-8")
    (folder / "index.md").write_text(command_index(found), encoding="utf-8")
    return [words.replace(" ", "_") for words in found]


def commands() -> dict[str, click.Command]:
    """Every command by the words behind `gonio` that call it, those within groups included."""
    return dict(_below(click.Context(group, info_name="gonio"), ""))


def _below(context: click.Context, words: str) -> Iterator[tuple[str, click.Command]]:
    """The commands of a group, found as a command line finds them: they may be loaded late."""
    assert isinstance(context.command, click.Group)
    for name in context.command.list_commands(context):
        _, command, _ = context.command.resolve_command(context, [name])
        assert command is not None
        called = f"{words} {name}".strip()
        yield called, command
        if isinstance(command, click.Group):
            yield from _below(click.Context(command, parent=context, info_name=name), called)


def command_page(words: str, command: click.Command) -> str:
    """One command in Markdown: usage, what it does, arguments and options."""
    context = click.Context(command, info_name=f"gonio {words}", help_option_names=["-h", "--help"])
    usage = " ".join([f"gonio {words}", *command.collect_usage_pieces(context)])
    told = inspect.cleandoc(command.help or "").replace("\b\n", "").split("\n\n")
    parts = [f"# `gonio {words}`", literal(usage, "text"), *map(text, told)]
    if isinstance(command, click.Group):
        names = command.list_commands(context)
        parts.append("\n".join(f"- {command_link(f'{words} {name}')}" for name in names))
    records = [
        record
        for parameter in command.get_params(context)
        if (record := parameter.get_help_record(context)) is not None and record[1]
    ]
    if records:
        parts.append("## Options")
        parts.append("\n\n".join(f"`{names}`\n: {escape(told)}" for names, told in records))
    return "\n\n".join(parts) + "\n"


def command_link(words: str) -> str:
    return f"[`gonio {words}`]({words.replace(' ', '_')}.md)"


def command_index(found: dict[str, click.Command]) -> str:
    lines = [
        f"- {command_link(words)}: {escape(command.get_short_help_str(limit=200))}"
        for words, command in found.items()
    ]
    codes = inspect.getdoc(importlib.import_module("gonio.cli")) or ""
    parts = [
        "# Command line",
        "Angles on the command line and in files are degrees, values are BRDF in sr⁻¹ without the "
        "cosine ([conventions](../../conventions.md)). `gonio COMMAND --help` shows these pages in "
        "a terminal.",
        "\n".join(lines),
        "## Exit codes",
        text(codes[codes.index("Exit codes:") :].removeprefix("Exit codes:")),
        toctree(words.replace(" ", "_") for words in found),
    ]
    return "\n\n".join(parts) + "\n"


# ---------------------------------------------------------------- Python


def write_python(folder: Path) -> list[str]:
    """Write a page for each room of the package; returns their names."""
    names = rooms()
    seen: dict[int, str] = {}
    for name in names:
        page = python_page(name, seen) + example(name)
        (folder / f"{name}.rst").write_text(page, encoding="utf-8")
    (folder / "index.md").write_text(python_index(names), encoding="utf-8")
    return names


def example(name: str) -> str:
    """The example of a room with what it prints, in reStructuredText; it runs here."""
    path = EXAMPLES / f"{name.rpartition('.')[2]}.py"
    if not path.is_file():
        return ""
    source = path.read_text(encoding="utf-8")
    shown = "".join(o.text for o in executed([source], path.name)[0] if o.kind == PLAIN)
    return (
        f"\nExample\n-------\n\n.. code-block:: python\n\n{_indented(source)}\n\n"
        f"It prints\n\n.. code-block:: text\n\n{_indented(shown)}\n"
    )


def _indented(text: str) -> str:
    return textwrap.indent(text.rstrip(), "   ")


def rooms() -> list[str]:
    """Import names of the public modules and packages right below gonio, and gonio itself."""
    below = {info.name for info in pkgutil.iter_modules(gonio.__path__)} | set(ADDED)
    shown = {name for name in below - HIDDEN if not name.startswith("_")}
    ordered = [name for name in ORDER if name in shown] + sorted(shown - set(ORDER))
    return ["gonio", *(f"gonio.{name}" for name in ordered)]


def python_page(name: str, seen: dict[int, str]) -> str:
    """One room in reStructuredText: its classes and functions, those of its modules below.

    Parameters
    ----------
    name : str
        Import name.
    seen : dict
        Import names of the objects that stand on a page, by id: none stands twice. Those of this
        page are added.
    """
    parts = [f"{name}\n{'=' * len(name)}"]
    for module in _modules(name):
        members = list(_members(module))
        if module.__name__ != name:
            if not members:
                continue
            parts.append(f"{module.__name__}\n{'-' * len(module.__name__)}")
        parts.append(f".. automodule:: {module.__name__}\n   :no-members:")
        for kind, member in members:
            full = f"{module.__name__}.{member}"
            known = seen.setdefault(id(getattr(module, member)), full)
            if known == full:
                parts.append(f".. auto{kind}:: {full}")
            else:
                parts.append(f"``{member}``: see `{known}`.")
    return "\n\n".join(parts) + "\n"


def _modules(name: str) -> Iterator[ModuleType]:
    """The room, and the public modules of one that does not say itself what it offers."""
    module = importlib.import_module(name)
    yield module
    if hasattr(module, "__all__"):
        below = BESIDE.get(name, [])
    else:
        below = [info.name for info in pkgutil.iter_modules(getattr(module, "__path__", []))]
    yield from (importlib.import_module(f"{name}.{x}") for x in below if not x.startswith("_"))


def _members(module: ModuleType) -> Iterator[tuple[str, str]]:
    """Kind and name of the documented classes and functions that a module offers."""
    for name in getattr(module, "__all__", list(vars(module))):
        if module.__name__ == "gonio" and name in TYPES:
            continue  # their pages are those of their modules
        member = getattr(module, name)
        own = getattr(member, "__module__", None) == module.__name__ and not name.startswith("_")
        if callable(member) and inspect.getdoc(member) and (own or hasattr(module, "__all__")):
            yield _kind(member), name


def _kind(member: object) -> str:
    if not inspect.isclass(member):
        return "function"
    return "exception" if issubclass(member, BaseException) else "class"


def command_table() -> str:
    """Every command with what does the same in Python: one row a command that is no group."""
    rows = ["| command | Python | what it does |", "|---|---|---|"]
    for words, command in commands().items():
        if isinstance(command, click.Group):
            continue
        name = python_name(words)
        page = "gonio" if name in VERBS else f"gonio.{name}"
        link = f"[`gonio {words}`](../commands/{words.replace(' ', '_')}.md)"
        told = escape(command.get_short_help_str(limit=200))
        rows.append(f"| {link} | [`gonio.{name}`]({page}.rst) | {told} |")
    return "\n".join(rows)


def python_index(names: list[str]) -> str:
    lines = []
    for name in names:
        told = (inspect.getdoc(importlib.import_module(name)) or "").split("\n\n")[0]
        lines.append(f"- [`{name}`]({name}.rst): {text(re.sub(rf'^{name}: ', '', told))}")
    parts = [
        "# Python",
        "Angles in Python are radians, lengths millimetres; another unit stands in the name "
        "(`_deg`, `_px`). Errors that a user can mend are `gonio.errors.GonioError` and carry the "
        "offending value.",
        "## Commands and their names in Python",
        "A command reads options, calls the function of the same name, and prints or saves what it "
        "returns. The function prints nothing. Where Python cannot have the command's name the "
        "table gives another; a list of things is a module. Everything loads at first use: after "
        "`import gonio` alone, `gonio.fit` and `gonio.models` are there.",
        command_table(),
        "## Modules",
        "\n".join(lines),
        toctree(iter(names)),
    ]
    return "\n\n".join(parts) + "\n"
