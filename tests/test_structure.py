"""The house rules: who may import whom, what the wheel holds, what starts quickly."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gonio.verbs import VERBS

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SETUPTOOLS = PYPROJECT["tool"]["setuptools"]
FOLDERS = {name: ROOT / path for name, path in SETUPTOOLS["package-dir"].items()}
ROOT_FOLDERS = sorted(set(FOLDERS) - {"gonio"})
BARE_NAMES = {name.removeprefix("gonio.") for name in ROOT_FOLDERS}

# ---------------------------------------------------------------- direction of imports

FOUNDATION = {"_version", "discovery", "errors", "files", "geometry", "progress", "wording"}
RECORDS = {"metadata", "certificate"}
SURFACE = FOUNDATION | {"kernels", "models", "samples", "shared_term", "data"}
ALL = {"*"}

# Each room of the house and what it may import from gonio, besides itself.
ALLOWED = {
    "": ALL,  # gonio/__init__.py names the verbs and rooms; nothing imports it
    "_version": set(),
    "progress": set(),
    "discovery": set(),
    "wording": set(),
    "errors": set(),
    "cache": set(),
    "files": {"errors"},
    "geometry": {"errors", "files"},
    "tangent_field": {"geometry"},
    "dome_map": {"errors", "files", "geometry", "tangent_field"},
    "kernels": FOUNDATION | {"cache"},
    "models": FOUNDATION | {"kernels", "cache"},
    "terms_of_0_1": set(),
    "shared_term": {"geometry", "terms_of_0_1"},
    "samples": FOUNDATION | {"shared_term"},
    "certificate": set(),
    "metadata": {"errors", "wording", "certificate"},
    "board": FOUNDATION,
    "session": FOUNDATION | {"metadata"},
    "plan_file": FOUNDATION | {"metadata"},
    "data": {"errors", "files"},
    "checks": {"errors", "wording", "discovery", "geometry", "samples", "models"},
    "materials": SURFACE,
    "instrument": SURFACE | RECORDS | {"session", "materials", "board"},
    "simulation": SURFACE | {"session", "metadata", "materials", "instrument", "plan_file"},
    "rig": SURFACE | RECORDS | {"session", "checks", "calibration"},
    # The reducer never sees the truth, the fitter never sees the inside of the instrument.
    "calibration": FOUNDATION
    | RECORDS
    | {"session", "samples", "shared_term", "board", "kernels.threads", "dome_map"},
    "fitting": FOUNDATION
    | {"samples", "shared_term", "models", "kernels", "checks", "dome_map", "tangent_field"},
    "planning": SURFACE
    | {"session", "metadata", "instrument", "simulation", "calibration", "fitting", "plan_file"},
    # Samples from anywhere, and true parameters: both ask the session, which no fit sees.
    "reading": FOUNDATION | {"samples", "session", "calibration", "formats", "checks"},
    "recovery": SURFACE | {"session", "fitting"},
    "formats": FOUNDATION | {"samples", "shared_term"},
    "rendering": SURFACE,
    "plotting": ALL,
    "reporting": ALL,
    "verbs": ALL,
    "cli": ALL,
    "__main__": ALL,
}


def modules() -> dict[str, Path]:
    """Every module of the package by its import name."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            found[".".join([package, *parts])] = path
    return found


MODULES = modules()


def room(module: str) -> str:
    """First name below gonio: the room that a module stands in."""
    return module.split(".")[1] if "." in module else ""


def resolve(base: str, name: str, known: set[str]) -> str:
    """Module that `from base import name` loads: a submodule, a verb's module or `base`."""
    if base == "gonio" and name in VERBS:
        return VERBS[name]
    return f"{base}.{name}" if f"{base}.{name}" in known else base


def imported(
    module: str, is_package: bool, source: str, known: set[str]
) -> Iterator[tuple[int, str]]:
    """Line and module of every import in a source, wherever in the file it stands."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import():
                yield from ((node.lineno, a.name) for a in node.names)
            case ast.ImportFrom():
                base = node.module or ""
                if node.level:
                    up = module.split(".")
                    up = up[: len(up) - node.level + is_package]
                    base = ".".join([*up, base] if base else up)
                yield from ((node.lineno, resolve(base, a.name, known)) for a in node.names)
            case ast.Attribute(value=ast.Name(id="gonio")):
                yield node.lineno, resolve("gonio", node.attr, known)
            case ast.Call(
                func=ast.Name(id="import_module" | "__import__")
                | ast.Attribute(attr="import_module"),
                args=[ast.Constant(value=str(name)), *_],
            ):
                yield node.lineno, name


def allowed(module: str, target: str) -> bool:
    """Whether `module` may import `target`."""
    if target.split(".")[0] in BARE_NAMES:
        return False
    if target == "gonio":
        return False  # the root names all verbs: whoever imports it stands in a circle
    if not target.startswith("gonio."):
        return True
    if room(target) == "cli":
        return room(module) in {"cli", "__main__"}
    inside = target.removeprefix("gonio.")
    rules = ALLOWED[room(module)]
    return (
        rules is ALL
        or room(target) == room(module)
        or any(inside == rule or inside.startswith(f"{rule}.") for rule in rules)
    )


def forbidden(
    module: str, source: str, *, is_package: bool = False, known: set[str] | None = None
) -> list[str]:
    """One line for each import in `source` that the table does not allow."""
    found = imported(module, is_package, source, known or set(MODULES))
    return [
        f"line {line}: {module} must not import {target}"
        for line, target in found
        if not allowed(module, target)
    ]


def test_every_room_stands_in_the_table() -> None:
    strangers = {room(module) for module in MODULES} - set(ALLOWED)
    assert not strangers, f"say in ALLOWED what these may import: {sorted(strangers)}"


@pytest.mark.parametrize("module", MODULES)
def test_imports_keep_their_direction(module: str) -> None:
    path = MODULES[module]
    if room(module) not in ALLOWED:
        pytest.fail(f"say in ALLOWED what gonio.{room(module)} may import")
    found = forbidden(
        module, path.read_text(encoding="utf-8"), is_package=path.name == "__init__.py"
    )
    assert not found, "\n".join(f"{path.relative_to(ROOT)}, {line}" for line in found)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("gonio.calibration.reflector", "import gonio.models"),
        ("gonio.calibration.reflector", "import gonio.models.ward as w"),
        ("gonio.calibration.reflector", "from gonio import models"),
        ("gonio.calibration.reflector", "from gonio import simulate"),
        ("gonio.calibration.reflector", "from gonio.kernels import map_blocks"),
        ("gonio.calibration.reflector", "import gonio"),
        ("gonio.calibration.reflector", "from gonio import __version__"),
        ("gonio.calibration.reflector", "import gonio.errors\n\ngonio.models.get('ward')"),
        (
            "gonio.calibration.reflector",
            "def f():\n    from gonio.instrument.dome import Dome",
        ),
        (
            "gonio.calibration.reflector",
            "if TYPE_CHECKING:\n    from gonio.materials import Material",
        ),
        ("gonio.calibration.reflector", "from ..simulation import simulate"),
        ("gonio.calibration.reflector", "importlib.import_module('gonio.simulation')"),
        ("gonio.fitting.result", "from gonio.session import Session"),
        ("gonio.fitting.result", "from ..calibration import lens"),
        ("gonio.fitting.result", "import calibration"),
        ("gonio.models.ward", "from gonio.samples import BRDFSamples"),
        ("gonio.geometry", "from . import kernels"),
        ("gonio.plotting.polar", "from gonio.cli import main"),
    ],
)
def test_a_forbidden_import_is_seen(module: str, source: str) -> None:
    known = {"gonio.models", "gonio.kernels", "gonio.cli", "gonio.calibration.reflector"}
    found = forbidden(module, source, known=known)
    assert len(found) == 1
    assert re.fullmatch(rf"line \d: {module} must not import [\w.]+", found[0])


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("gonio.calibration.reflector", "import numpy as np\nfrom pathlib import Path"),
        ("gonio.calibration.reflector", "from gonio._version import __version__"),
        ("gonio.calibration.reflector", "from gonio.kernels.threads import map_blocks"),
        (
            "gonio.calibration.reflector",
            "from . import reflector\nfrom .exposure import merge",
        ),
        (
            "gonio.fitting.result",
            "from gonio.models import Model\nfrom ..samples import Cells",
        ),
        ("gonio.cli.fit", "from gonio.cli import main\nimport gonio.fitting.posterior.sample"),
    ],
)
def test_an_allowed_import_passes(module: str, source: str) -> None:
    assert forbidden(module, source, known=set()) == []


@pytest.mark.parametrize("folder", ["calibration", "fitting"])
def test_reducer_and_fitter_do_not_know_the_truth(folder: str) -> None:
    for path in sorted((ROOT / folder).rglob("*.py")):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            # Whoever compares with known parameters does so outside these two folders.
            assert "truth" not in line.lower(), f"{path.relative_to(ROOT)}, line {number}: {line}"


# ---------------------------------------------------------------- order inside the two large rooms

# The floors of a room, ground floor first: a sub-room imports those of lower floors, and itself.
FLOORS: dict[str, list[set[str]]] = {
    "calibration": [
        {"reflector", "image_cells", "budget_page"},
        {"budget", "frames", "lens"},
        {"dome"},
        {"effects", "faults"},
        {"reduction"},
    ],
    "fitting": [
        {"provenance", "problem"},
        {"result"},
        {"minimum", "part_choice", "screening"},
        {"residual_tests", "dome_field"},
        {"uncertainty"},
        {"posterior", "diagnostics", "comparison", "warnings"},
        {"fit", "texels"},
    ],
}


def sub_room(module: str) -> str:
    """Second name below gonio, empty for the room itself."""
    return (module.split(".") + [""] * 3)[2]


def above(module: str, source: str, known: set[str], *, is_package: bool = False) -> list[str]:
    """One line for each import of a sub-room that stands on the same floor or above."""
    house = FLOORS[room(module)]
    floor = {name: k for k, names in enumerate(house) for name in names}
    own = sub_room(module)
    lines = []
    for line, target in imported(module, is_package, source, known):
        other = sub_room(target)
        if room(target) != room(module) or other in ("", own):
            continue
        if floor[other] >= floor[own]:
            lines.append(f"line {line}: {own} must not import {other}, which is not below it")
    return lines


@pytest.mark.parametrize("name", FLOORS)
def test_every_sub_room_has_a_floor_and_a_room_fits_on_a_sheet(name: str) -> None:
    on_disk = {sub_room(m) for m in MODULES if room(m) == name} - {""}
    floors = FLOORS[name]
    assert on_disk == set().union(*floors), "say in FLOORS where these stand"
    assert len(on_disk) <= {"calibration": 10, "fitting": 16}[name]
    assert len(floors) <= 7


@pytest.mark.parametrize("module", [m for m in MODULES if room(m) in FLOORS and sub_room(m)])
def test_sub_rooms_keep_their_order(module: str) -> None:
    path = MODULES[module]
    source = path.read_text(encoding="utf-8")
    found = above(module, source, set(MODULES), is_package=path.name == "__init__.py")
    assert not found, "\n".join(f"{path.relative_to(ROOT)}, {line}" for line in found)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("gonio.fitting.problem.joint", "from gonio.fitting.minimum.find import find_minimum"),
        ("gonio.fitting.minimum.find", "def f():\n    from gonio.fitting.uncertainty import x"),
        ("gonio.fitting.posterior.sample", "from ..diagnostics import identifiability"),
        ("gonio.calibration.dome.spots", "import gonio.calibration.reduction.cells"),
    ],
)
def test_an_import_from_above_is_seen(module: str, source: str) -> None:
    assert len(above(module, source, set(MODULES))) == 1


# ---------------------------------------------------------------- circles


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other, directly or by way of others (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in sorted(edges[module]):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            group = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(group) > 1 or module in edges[module]:
                found.append(sorted(group))

    for module in edges:
        if module not in index:
            visit(module)
    return found


def edges_of(modules_: dict[str, tuple[bool, str]]) -> dict[str, set[str]]:
    """Who imports whom, imports inside functions and under TYPE_CHECKING included."""
    known = set(modules_)
    edges: dict[str, set[str]] = {}
    for module, (is_package, source) in modules_.items():
        edges[module] = set()
        for _, target in imported(module, is_package, source, known):
            nearest = target
            while nearest and nearest not in known:
                nearest = nearest.rpartition(".")[0]
            if nearest:
                edges[module].add(nearest)
    return edges


def test_no_modules_import_each_other() -> None:
    sources = {
        module: (path.name == "__init__.py", path.read_text(encoding="utf-8"))
        for module, path in MODULES.items()
    }
    found = circles(edges_of(sources))
    assert not found, "\n".join(f"a circle of imports: {', '.join(group)}" for group in found)


def test_a_circle_is_seen_wherever_its_imports_stand() -> None:
    sources = {
        "gonio.a": (False, "from gonio import b"),
        "gonio.b": (False, "def f():\n    from gonio.room.c import g"),
        "gonio.room.c": (False, "if TYPE_CHECKING:\n    from gonio.a import A"),
        "gonio.room": (True, "from gonio.room.c import g"),
        "gonio.d": (False, "from gonio import a"),
    }
    assert circles(edges_of(sources)) == [["gonio.a", "gonio.b", "gonio.room.c"]]


# ---------------------------------------------------------------- one file, one module


@pytest.mark.parametrize("name", ROOT_FOLDERS)
def test_a_folder_refuses_another_name(name: str) -> None:
    bare = name.removeprefix("gonio.")
    spec = importlib.util.spec_from_file_location(bare, FOLDERS[name] / "__init__.py")
    assert spec is not None
    assert spec.loader is not None
    with pytest.raises(ImportError, match=rf"is the package {name} and was imported as '{bare}'"):
        spec.loader.exec_module(importlib.util.module_from_spec(spec))


def test_no_submodule_has_the_name_of_a_verb() -> None:
    # Importing it would put the module in the place of the function (docs/adr/0002).
    assert not {f"gonio.{verb}" for verb in VERBS} & set(MODULES)


# ---------------------------------------------------------------- what starts quickly

HEAVY = ["cv2", "emcee", "nlopt", "matplotlib", "numba", "scipy", "arviz", "zarr", "xarray"]
HEAVY_FOR_HELP = ["numba", "emcee", "cv2", "matplotlib"]


def loaded_after(code: str, names: list[str]) -> list[str]:
    """Which of `names` are loaded after `code` in a fresh interpreter."""
    report = f"import json, sys\nprint(json.dumps([n for n in {names} if n in sys.modules]))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"],
        cwd=Path(sys.executable).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout.splitlines()[-1]))


def test_import_gonio_is_light() -> None:
    assert loaded_after("import gonio", HEAVY) == []


def test_help_does_not_load_the_machinery() -> None:
    code = """
import sys
from gonio.cli import main
sys.argv = ["gonio", "--help"]
try:
    main()
except SystemExit as stop:
    assert not stop.code, stop.code
"""
    assert loaded_after(code, HEAVY_FOR_HELP) == []


# ---------------------------------------------------------------- the wheel


def tree() -> Iterator[Path]:
    """Files of the project, relative to its root: what a clone holds, and nothing that is made."""
    made = {"build", "dist", "demo"}
    for folder, below, files in os.walk(ROOT):
        here = Path(folder)
        below[:] = [
            name
            for name in below
            if not (name in made and here == ROOT)
            and name != "__pycache__"
            and not name.endswith(".egg-info")
            and (not name.startswith(".") or name in {".ci", ".github"})
            and not (here / name / "pyvenv.cfg").exists()
        ]
        # A work tree of git has a file .git, which says where the repository is.
        kept = [name for name in files if not name.startswith(".coverage") and name != ".git"]
        yield from ((here / name).relative_to(ROOT) for name in kept)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel that is built from a clean copy of the tree."""
    copy, out = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("wheel")
    for path in tree():
        (copy / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, copy / path)
    done = subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out)],
        cwd=copy,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def wheel_names(wheel: Path) -> set[str]:
    """Names of the files in the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_the_page_on_an_index_has_no_link_that_leads_nowhere(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [each for each in archive.namelist() if each.endswith(".dist-info/METADATA")]
        metadata = archive.read(name).decode("utf-8")
    head, page = metadata.split("\n\n", 1)
    assert "\nDescription-Content-Type: text/markdown" in head
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    links = re.compile(r"!?\[[^\]]*\]\(([^)]*)\)")
    assert "docs/images/demo.png" in links.findall(readme)
    assert [link for link in links.findall(page) if not link.startswith("https://")] == []
    # The words of the links and everything else is there.
    words = links.sub(lambda m: "" if m[0].startswith("!") else m[0][1 : m[0].index("]")], readme)
    assert page.split() == words.split()


def test_wheel_holds_only_gonio(wheel_names: set[str]) -> None:
    dist_info = f"gonio-{PYPROJECT['project']['version']}.dist-info"
    assert {name.split("/")[0] for name in wheel_names} == {"gonio", dist_info}


def test_wheel_holds_every_file_of_the_package(wheel_names: set[str]) -> None:
    expected = set()
    for package, folder in FOLDERS.items():
        inside = [path for path in tree() if path.is_relative_to(folder.relative_to(ROOT))]
        for path in inside:
            below = path.relative_to(folder.relative_to(ROOT)).as_posix()
            expected.add(f"{package.replace('.', '/')}/{below}")
    assert "gonio/py.typed" in expected
    assert {name for name in wheel_names if name.startswith("gonio/")} == expected


def test_every_package_is_listed() -> None:
    on_disk = {name for name, path in MODULES.items() if path.name == "__init__.py"}
    assert sorted(SETUPTOOLS["packages"]) == sorted(on_disk)


def test_one_version() -> None:
    import gonio

    assert gonio.__version__ == PYPROJECT["project"]["version"]


# ---------------------------------------------------------------- the text of the project

PACKAGE_SOURCE = re.compile(
    r"p[y]pi\.org|pythonh[o]sted|deb\.d[e]bian|registry\.n[p]mjs"
    r"|--(?:extra-)?index-url|--[f]ind-links|--[t]rusted-host"
)
# An absolute path that begins where people and machines keep their own files.
PLACE_ON_A_MACHINE = re.compile(
    r"(?<![\w.:~/}*-])/(?:home|root|Users|work|workspace|opt|mnt|srv|media|tmp)/\w"
)


@pytest.mark.parametrize("pattern", [PACKAGE_SOURCE, PLACE_ON_A_MACHINE], ids=["source", "place"])
def test_no_file_names_a_package_source_or_a_place_on_one_machine(pattern: re.Pattern[str]) -> None:
    found = []
    for path in tree():
        text = (ROOT / path).read_text(encoding="utf-8", errors="ignore")
        for number, line in enumerate(text.splitlines(), 1):
            if match := pattern.search(line):
                found.append(f"{path}, line {number}: {match[0]}")
    assert not found, "\n".join(found)


def test_constraints_pin_every_package_with_hashes() -> None:
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    assert "://" not in text
    pins = re.split(r"\n(?=[a-z])", re.sub(r"(?m)^\s*#.*\n", "", text))
    assert len(pins) > 20
    for pin in pins:
        assert re.match(r"[a-z0-9][a-z0-9-]*==[\w.]+ \\\n    --hash=sha256:[0-9a-f]{64}\b", pin)
    pinned = {pin.split("==")[0] for pin in pins}
    project = PYPROJECT["project"]
    extras = project["optional-dependencies"]
    wanted = project["dependencies"] + extras["test"] + extras["docs"]
    missing = {re.split(r"[<>=!~\[ ;]", w)[0].lower().replace("_", "-") for w in wanted} - pinned
    assert not missing, f"run 'make constraints': {sorted(missing)} are not pinned"


# ---------------------------------------------------------------- the example for contributors

CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def block_of(language: str, which: int = 0) -> str:
    """A block of CONTRIBUTING.md in this language: the first, or that after so many."""
    found = re.findall(rf"^```{language}\n(.*?)^```", CONTRIBUTING, re.DOTALL | re.MULTILINE)
    return str(found[which])


@pytest.fixture(scope="module")
def one_more(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an installation to whose models the example's file was added, and nothing else."""
    site = tmp_path_factory.mktemp("site")
    for name, folder in sorted(FOLDERS.items()):
        shutil.copytree(
            folder,
            site / name.replace(".", "/"),
            ignore=shutil.ignore_patterns("*.pyc*", "*.tmp.*"),  # numba's code goes along
            dirs_exist_ok=True,
        )
    (site / "gonio/models/lommel_seeliger.py").write_text(block_of("python"), encoding="utf-8")
    return site


def run_with(site: Path, words: list[str], folder: Path) -> str:
    """What a program prints that imports gonio from `site`."""
    done = subprocess.run(
        words,
        cwd=folder,
        env={
            **os.environ,
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
            "PYTHONPATH": str(site),
            "MPLBACKEND": "Agg",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout


def test_the_model_in_contributing_has_the_values_of_its_formula(one_more: Path) -> None:
    code = """
import numpy as np
from gonio import models
model = models.get("lommel_seeliger")
print(model.kernel.__code__.co_filename)
w_i, w_r, p = np.array([0.6, 0, 0.8]), np.array([0, -0.8, 0.6]), np.array([0.5])
print(*model.plain(w_i, w_r, p), model.evaluate(w_i, w_r, p))
"""
    found, numbers = run_with(one_more, [sys.executable, "-c", code], one_more).splitlines()
    assert Path(found) == one_more / "gonio/models/lommel_seeliger.py"
    # f = w / (4 pi (cos theta_i + cos theta_r)), linear in w
    f = 0.5 / (4 * np.pi * 1.4)
    assert [float(n) for n in numbers.split()] == pytest.approx([f, f / 0.5, f], rel=1e-14)


def test_one_file_is_a_model_for_every_command(one_more: Path, tmp_path: Path) -> None:
    _, *commands = re.split(r"^\$ ", block_of("console", 1), flags=re.MULTILINE)
    printed = {
        command.split()[1]: run_with(one_more, ["bash", "-euc", command], tmp_path)
        for command in commands
    }
    assert list(printed) == ["models", ">", "evaluate", "fit", "check"]
    assert "f = w / (4 pi (cos theta_i + cos theta_r))" in printed["models"]
    fit = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert fit["status"] == "converged"
    assert fit["parameters"]["w"]["value"] == pytest.approx(0.2, rel=1e-9)
    assert "The model keeps what it claims." in printed["check"]


def test_one_file_is_a_page_of_the_manual(one_more: Path) -> None:
    code = f"""
import sys
sys.path.insert(0, {str(ROOT / "docs" / "_ext")!r})
from pathlib import Path
import model_pages
print(model_pages.page("lommel_seeliger"))
print(model_pages.index())
model_pages.draw("lommel_seeliger", Path())
"""
    page = run_with(one_more, [sys.executable, "-c", code], one_more)
    assert "\n```text\nf = w / (4 pi (cos theta_i + cos theta_r))\n```\n" in page
    assert "| `w` | w | single-scattering albedo | 1 | 0.3 | 0 to 1 |" in page.replace("\\-", "-")
    assert "$ gonio evaluate lommel_seeliger" in page
    assert "[`lommel_seeliger`](lommel_seeliger.md)" in page
    assert (one_more / "lommel_seeliger.png").read_bytes().startswith(b"\x89PNG")


def test_one_file_brings_its_contract_tests(one_more: Path) -> None:
    words = ["-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT), "-q"]
    words += ["-p", "no:cacheprovider", "-k", "lommel_seeliger"]
    tests = str(ROOT / "tests" / "test_models_contract.py")
    summary = run_with(one_more, [sys.executable, *words, tests], one_more).splitlines()[-1]
    passed = re.match(r"(\d+) passed", summary)
    assert passed is not None, summary
    # As many as the models that were there before have, less what is not claimed.
    assert int(passed[1]) >= 15


# ---------------------------------------------------------------- each test file runs alone


def test_no_test_file_leans_on_another() -> None:
    """What two test files need stands in a helper beside them, found wherever pytest starts."""
    tests = sorted((ROOT / "tests").glob("test_*.py"))
    assert len(tests) > 50
    found = []
    for path in tests:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            found += [
                f"{path.name}, line {node.lineno}: imports {name}; put what both need into a "
                "helper module of tests/"
                for name in names
                if name.split(".")[0] == "tests" or name.startswith("test_")
            ]
    assert not found, "\n".join(found)


# ---------------------------------------------------------------- the same file outside the package


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a package that announces the example's model is installed."""
    site = tmp_path_factory.mktemp("outside")
    (site / "lab_paints.py").write_text(block_of("python"), encoding="utf-8")
    info = site / "lab_paints-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab_paints\nVersion: 1.0\n")
    announced = tomllib.loads(block_of("toml"))["project"]["entry-points"]["gonio.models"]
    lines = [f"{name} = {value}\n" for name, value in announced.items()]
    (info / "entry_points.txt").write_text("[gonio.models]\n" + "".join(lines))
    return site


def test_a_file_outside_is_a_model_for_every_command(tmp_path: Path) -> None:
    (tmp_path / "lommel_seeliger.py").write_text(block_of("python"), encoding="utf-8")
    _, *commands = re.split(r"^\$ ", block_of("console"), flags=re.MULTILINE)
    printed = {
        command.split()[1]: run_with(tmp_path, ["bash", "-euc", command], tmp_path)
        for command in commands
    }
    assert list(printed) == [">", "models", "evaluate", "fit", "plot", "report", "check"]
    assert "from: lommel_seeliger.py" in printed["models"]
    assert "f = w / (4 pi (cos theta_i + cos theta_r))" in printed["models"]
    fit = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert fit["status"] == "converged"
    assert fit["parameters"]["w"]["value"] == pytest.approx(0.2, rel=1e-9)
    digest = hashlib.sha256((tmp_path / "lommel_seeliger.py").read_bytes()).hexdigest()
    assert fit["model_source"] == {"file": "lommel_seeliger.py", "sha256": digest}
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert "lommel_seeliger" in (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "The model keeps what it claims." in printed["check"]


def test_the_function_of_arrays_in_contributing_is_the_same_model(tmp_path: Path) -> None:
    names: dict[str, object] = {}
    exec(block_of("python", 1), names)
    from gonio.geometry import Directions
    from gonio.models import Model

    model = names["MODEL"]
    assert isinstance(model, Model)
    # f = w / (4 pi (cos theta_i + cos theta_r)) with both at 60 deg
    f = float(model(Directions(np.pi / 3, 0.0, np.pi / 3, 1.0), w=0.5))
    assert f == pytest.approx(0.5 / (4 * np.pi), rel=1e-12)


def test_a_package_that_announces_a_model_is_seen_and_keeps_the_contract(outside: Path) -> None:
    listed = run_with(outside, ["gonio", "models", "--json"], outside)
    (found,) = [each for each in json.loads(listed) if each["name"] == "lommel_seeliger"]
    assert found["origin"] == "lab_paints 1.0"
    words = ["-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT), "-q"]
    words += ["-p", "no:cacheprovider", "-k", "lommel_seeliger"]
    tests = str(ROOT / "tests" / "test_models_contract.py")
    summary = run_with(outside, [sys.executable, *words, tests], outside).splitlines()[-1]
    passed = re.match(r"(\d+) passed", summary)
    assert passed is not None, summary
    assert int(passed[1]) >= 15
