"""The models' manual pages, made from their files when the site is built.

A page says what the model's file says: formula, symbols and prose of its docstring, the table of
its parameters, its claims, how it is drawn from, the rows of the errata that concern it; and it
shows its lobe and two examples that have just run. Nobody writes a page; a new model has one.

The docstrings are plain text. Paragraphs of formulas and of symbols are told from sentences by
their first lines and by the full stop at their end, and everything that Markdown would read as a
mark is escaped.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import math
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gonio import models
from gonio.models import Model, Parameter

MARKS = re.compile(r"([\\`*_{}\[\]<>|~$&^#!%+=-])")  # what Markdown may read as a mark
FORMULA = re.compile(r"\w+(\([^)]*\))?\s*= ")  # f = ..., S(sigma) = ...
ENTRY = re.compile(r"(?P<symbols>\w+(?:, \w+)*|\w+(?:\([^)]*\))?\s*= [^:]*): (?P<meaning>.*)")
INLINE = re.compile(r"`(?P<code>[^`]+)`|\bdocs/(?P<page>[\w/-]+)(?P<suffix>\.md)?")
PAGES = "../../"  # from a model's page to the folder docs
ANGLES = (  # theta_i, phi_i, theta_r, phi_r of the example, degrees
    (30, 0, 0, 0),
    (30, 0, 30, 180),
    (60, 0, 60, 180),
)


def write(folder: Path, errata: str) -> list[str]:
    """Write the index, and page and picture of every model; returns the models' names.

    Parameters
    ----------
    folder : Path
        Where to; it exists.
    errata : str
        Text of docs/errata.md.
    """
    for name in models.names():
        (folder / f"{name}.md").write_text(page(name, errata), encoding="utf-8")
        draw(name, folder)
    (folder / "index.md").write_text(index(), encoding="utf-8")
    return models.names()


def page(name: str, errata: str = "") -> str:
    """One model's page in Markdown."""
    model = models.get(name)
    documented = model.describe()
    summary, *rest = paragraphs(documented["documentation"])
    chosen = shown(model)
    parts = [
        f"# `{name}`",
        f"**{escape(model.title)}.** {text(summary)}",
        f"Reference: {escape(model.reference)}.",
        *(block(paragraph) for paragraph in rest),
        "## Range of validity",
        text(model.validity),
        "## Parameters",
        parameter_table(documented["parameters"]),
        "Angles are degrees on the command line and in files, radians in Python.",
        "## The lobe",
        f"![Polar diagram of {name} in the plane of incidence]({picture(model)})",
        f"f at {values_text(model, chosen)}. The light comes along the arrows; the distance from "
        "the centre is f in sr⁻¹, cosine not included, so that a Lambertian surface is a half "
        "circle. `gonio.plotting.model_lobes` draws it for other parameters.",
        "## Examples",
        "On the command line:",
        command_example(model, chosen),
        "In Python:",
        python_example(model, chosen),
        "## Claims",
        f"What the file claims, the tests demand, and `gonio check {name}` looks at with any "
        "parameters:",
        claims_list(model),
        *sampling(model),
        *errata_section(model, errata),
    ]
    return "\n\n".join(parts) + "\n"


def index() -> str:
    """The list of all models, with what each claims."""
    found = [models.get(name) for name in models.names()]
    heading = ["model", "reciprocal", "f ≥ 0", "isotropic", "albedo at most", "Lambertian limit"]
    rows = [
        [
            f"[`{model.name}`]({model.name}.md)",
            *("yes" if kept else "—" for kept in _promises(model)),
            albedo_text(model) or "—",
            limit_text(model) or "—",
        ]
        for model in found
    ]
    lines = [
        f"- [`{model.name}`]({model.name}.md): {escape(model.title)}; {escape(model.reference)}."
        for model in found
    ]
    parts = [
        "# Models",
        "One file of `gonio/models` is one model, and each page here is made from that file. "
        "Names joined by + are models too: `ward+lambert` is the sum of the two. Values are "
        "BRDF in sr⁻¹, cosine not included ([conventions](../../conventions.md)).",
        "\n".join(lines),
        "## What each claims",
        "A claim holds for all directions above the horizon and all parameters that are allowed, "
        "and is tested. — says that the model does not claim it.",
        table(heading, rows),
        toctree(model.name for model in found),
    ]
    return "\n\n".join(parts) + "\n"


# ---------------------------------------------------------------- from plain text to Markdown


def escape(plain: str) -> str:
    """Plain text that Markdown shows as it is.

    Examples
    --------
    >>> print(escape("2. f*g <F> [1]"))
    2\\. f\\*g \\<F\\> \\[1\\]
    """
    marked = MARKS.sub(r"\\\1", plain)
    return re.sub(r"^(\d+)([.)])", r"\1\\\2", marked)  # the beginning of a numbered list


def text(plain: str) -> str:
    """A paragraph: names in backquotes and pages of the documentation become links."""
    joined, made, end = " ".join(plain.split()), [], 0
    for match in INLINE.finditer(joined):
        made += [escape(joined[end : match.start()]), _linked(match)]
        end = match.end()
    return "".join([*made, escape(joined[end:])])


def _linked(match: re.Match[str]) -> str:
    code = match["code"]
    if code is None:
        return f"[{match['page']}]({PAGES}{match['page']}.md)" if match["suffix"] else match[0]
    return f"[`{code}`]({code}.md)" if code in models.names() else f"`{code}`"


def paragraphs(plain: str) -> list[str]:
    """Pieces between empty lines; the sections of numpydoc are left out."""
    before = re.split(r"\n\n[A-Z]\w+\n-{3,}", plain.strip())[0]
    return re.split(r"\n\s*\n", before)


def block(paragraph: str) -> str:
    """Markdown of one paragraph: sentences, formulas, or symbols with their meaning."""
    lines = paragraph.splitlines()
    if all(line.startswith(" ") for line in lines):
        return literal(inspect.cleandoc(paragraph))
    starts = FORMULA.match(lines[0]) or ENTRY.match(lines[0])
    if not starts or paragraph.rstrip().endswith((".", ":")):
        return text(paragraph)
    made = []
    for piece in _entries(lines):
        match = ENTRY.fullmatch(" ".join(piece.split()))
        if match:
            made.append(f"- {literal_inline(match['symbols'])}: {text(match['meaning'])}")
        else:
            made.append(literal(piece))
    return re.sub(r"\n\n(?=- )", "\n", "\n\n".join(made)).replace("```\n-", "```\n\n-")


def _entries(lines: list[str]) -> list[str]:
    """Lines put together: formulas that follow each other, and each symbol with its meaning."""
    pieces: list[list[str]] = []
    for line in lines:
        opens = ENTRY.match(line) or FORMULA.match(line)
        in_formulas = bool(pieces) and not ENTRY.match(pieces[-1][0])
        if not pieces or (opens and not (in_formulas and not ENTRY.match(line))):
            pieces.append([line])
        else:
            pieces[-1].append(line)
    return ["\n".join(piece) for piece in pieces]


def literal(plain: str, language: str = "text") -> str:
    """A block that is shown as it stands."""
    return f"```{language}\n{plain.rstrip()}\n```"


def literal_inline(plain: str) -> str:
    return f"`{plain.strip()}`"


def table(heading: list[str], rows: list[list[str]]) -> str:
    """A table; the cells are Markdown without line ends and without bare |."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def toctree(names: Iterator[str]) -> str:
    entries = "\n".join(f"{name} <{name}>" for name in names)
    return f"```{{toctree}}\n:hidden:\n\n{entries}\n```"


def symbol(plain: str) -> str:
    """A symbol such as α_x with its index lowered."""
    return re.sub(r"_(\w+)", r"{sub}`\1`", plain)


# ---------------------------------------------------------------- from the record


def parameter_table(parameters: list[dict[str, Any]]) -> str:
    heading = ["name", "symbol", "meaning", "unit", "default", "allowed"]
    rows = [
        [
            f"`{p['name']}`",
            symbol(p["symbol"]),
            escape(p["meaning"]),
            p["unit"] or "1",
            f"{p['default']:g}",
            f"{p['lower']:g} to {p['upper']:g}",
        ]
        for p in parameters
    ]
    return table(heading, rows)


def _promises(model: Model) -> tuple[bool, bool, bool]:
    claims = model.claims
    return claims.reciprocal, claims.non_negative, claims.isotropic


def claims_list(model: Model) -> str:
    reciprocal, non_negative, isotropic = _promises(model)
    limit, bound, seams = limit_text(model), albedo_text(model), len(model.claims.seams)
    lines = [
        "reciprocal: f(i, r) = f(r, i)" if reciprocal else "not reciprocal",
        "never negative" if non_negative else "f may fall below 0",
        "isotropic: f depends on the difference of the azimuths only"
        if isotropic
        else "anisotropic: f depends on how the sample is turned",
        f"the directional albedo is at most {bound}"
        if bound
        else "no bound of the albedo is claimed",
        f"exactly Lambertian at {limit}" if limit else "no Lambertian limit",
        f"continuous across the {seams} seams of the formula that the file names"
        if seams
        else "the formula has no seams",
    ]
    return "\n".join(f"- {line}" for line in lines)


def albedo_text(model: Model) -> str | None:
    """Largest directional albedo that the model claims."""
    names = model.claims.albedo_at_most
    if names is None:
        return None
    return " + ".join(symbol(model.parameter(name).symbol) for name in names) or "1"


def limit_text(model: Model) -> str | None:
    """Where the model is Lambertian."""
    limit = model.claims.lambert_limit
    if limit is None:
        return None
    return values_text(model, limit) or "all parameters"


def sampling(model: Model) -> Iterator[str]:
    """What `Model.sample` draws from."""
    yield "## Sampling"
    yield (
        "`Model.sample` draws directions of reflection from "
        + ("this lobe:" if len(model.lobes) == 1 else "these lobes, chosen by their shares:")
    )
    for lobe in model.lobes:
        documentation = inspect.getdoc(type(lobe)) or ""
        summary, *rest = paragraphs(documentation)
        details = [
            f"{name} = `{value}`" if value is not None else f"no {name}: {_meaning(name, lobe)}"
            for name, value in vars(lobe).items()
            if name != "share"
        ]
        if len(model.lobes) > 1:
            details.append(f"share: {_share_text(lobe.share)}")
        named = f" ({'; '.join(details)})" if details else ""
        yield f"- **{type(lobe).__name__}**{named}. {text(summary)}"
        yield from (_indented(block(paragraph)) for paragraph in rest)


def _meaning(field: str, lobe: Any) -> str:
    """What the docstring of a lobe says of one of its fields."""
    found = re.search(rf"^{field} : .*\n((?:    .*\n?)+)", inspect.getdoc(lobe) or "", re.MULTILINE)
    return text(_small(found[1])).rstrip(".") if found else "not given"


def _share_text(share: Any) -> str:
    """A parameter's name, or the sentence that the function says of itself."""
    if share is None:
        return "1"
    if isinstance(share, str):
        return f"`{share}`"
    first = paragraphs(inspect.getdoc(share) or share.__name__)[0]
    return text(_small(first)).rstrip(".")


def _small(sentence: str) -> str:
    """A sentence that goes on after a colon."""
    stripped = sentence.strip()
    return stripped[:1].lower() + stripped[1:]


def _indented(markdown: str) -> str:
    return "\n".join(f"  {line}" for line in markdown.splitlines())


# ---------------------------------------------------------------- examples and picture


def shown(model: Model) -> dict[str, float]:
    """Parameters of examples and picture: the defaults, unless these hide what is the model's own.

    Where x and y are alike by default the one of y is moved, and so is a parameter that makes the
    model Lambertian: halfway up the range that a fit searches.
    """
    values = {p.name: p.default for p in model.parameters}
    before: list[Parameter] = []
    for p in model.parameters:
        twin = any(
            p.name[:-1] == q.name[:-1] and len(p.name) > 1 and p.default == q.default
            for q in before
        )
        limit = (model.claims.lambert_limit or {}).get(p.name)
        if (twin and not model.claims.isotropic) or limit == p.default:
            values[p.name] = _halfway_up(p)
        before.append(p)
    return values


def _halfway_up(p: Parameter) -> float:
    top = p.start[1] if p.start else p.upper
    if p.scale == "log":
        middle = math.sqrt(p.default * top)
    else:
        middle = (p.default + top) / 2
    return float(f"{middle:.2g}")


def values_text(model: Model, chosen: Mapping[str, float]) -> str:
    """Symbols and values, angles in degrees."""
    parts = [
        f"{symbol(p.symbol)} = {p.to_file(chosen[p.name]):g}{'°' if p.unit == 'rad' else ''}"
        for p in model.parameters
        if p.name in chosen
    ]
    return ", ".join(parts)


def command_example(model: Model, chosen: dict[str, float]) -> str:
    """`gonio evaluate` and what it prints."""
    from gonio.cli import main

    words = ["evaluate", model.name]
    for p in model.parameters:
        words += ["-p", f"{p.name}={p.to_file(chosen[p.name]):g}"]
    words += ["--angles", "directions.csv"]
    lines = ["theta_i,phi_i,theta_r,phi_r", *(",".join(map(str, four)) for four in ANGLES)]
    printed = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("directions.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        with contextlib.redirect_stdout(printed):
            try:
                main(words)
            except SystemExit as left:
                if left.code:
                    raise RuntimeError(f"gonio {' '.join(words)}: exit code {left.code}") from None
    shown_words = " ".join(words).replace(" -p ", " \\\n    -p ", 1).replace(" --a", " \\\n    --a")
    given = "\n".join(["$ cat directions.csv", *lines, f"$ gonio {shown_words}"])
    return literal(f"{given}\n{printed.getvalue()}", "console")


def python_example(model: Model, chosen: dict[str, float]) -> str:
    """The same values from Python, and what they are."""
    arguments = ", ".join(
        f"{p.name}=np.radians({p.to_file(chosen[p.name]):g})"
        if p.unit == "rad"
        else f"{p.name}={chosen[p.name]:g}"
        for p in model.parameters
    )
    columns = "\n".join(
        f"{name} = np.radians({[four[k] for four in ANGLES]})"
        for k, name in enumerate(("theta_i", "phi_i", "theta_r", "phi_r"))
    )
    code = (
        "import numpy as np\n\n"
        "from gonio import models\n"
        "from gonio.geometry import Directions\n\n"
        f"{columns}\n"
        f'model = models.get("{model.name}")\n'
        "f = model(\n"
        "    Directions(theta_i, phi_i, theta_r, phi_r),\n"
        f"    {arguments},\n"
        ")\n"
        "print(f.round(6))\n"
    )
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, f"example of {model.name}", "exec"), {})
    return f"{literal(code, 'python')}\n\n{literal(printed.getvalue())}"


def picture(model: Model) -> str:
    """Name of the picture's file; that of two planes is twice as wide."""
    return f"{model.name}.png" if model.claims.isotropic else f"{model.name}_planes.png"


def draw(name: str, folder: Path) -> None:
    """Write the lobe of a model as a picture into a folder."""
    import matplotlib.pyplot as plt

    from gonio.plotting import model_lobes, save

    model = models.get(name)
    (ax, *_) = model_lobes(model, shown(model))
    figure = ax.get_figure(root=True)
    assert figure is not None
    save(figure, folder / picture(model))
    plt.close(figure)


# ---------------------------------------------------------------- errata


def errata_section(model: Model, errata: str) -> Iterator[str]:
    """The rows of the errata that concern a model, under the headings of their papers."""
    found = list(errata_rows(model, errata))
    if not found:
        return
    yield "## Errata"
    yield f"From the [errata of the papers]({PAGES}errata.md):"
    for heading in dict.fromkeys(heading for heading, _ in found):
        rows = [row for under, row in found if under == heading]
        yield f"*{heading}*"
        yield table(["where", "printed", "right"], [row[:3] for row in rows])


def errata_rows(model: Model, errata: str) -> Iterator[tuple[str, list[str]]]:
    """Heading and cells of each row that concerns a model.

    It names the model in backquotes, or stands under a paper that the record cites and begins with
    an equation or a section that is cited, the model's own name, or a symbol of its formula.
    """
    reference = _plain(model.reference)
    for section in re.split(r"^## ", errata, flags=re.MULTILINE)[1:]:
        heading, _, body = section.partition("\n")
        paper = _plain(heading.split(",")[0])
        cited = [part for part in reference.split(";") if paper in part]
        for line in body.splitlines():
            if not line.startswith("|") or re.match(r"\|( where |-)", line):
                continue
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            where = _plain(cells[0])
            if (
                f"`{model.name}`" in line
                or (re.search(r"\d{4}", where) and where in reference)
                or any(_places(part) & _places(where) for part in cited)
                or (cited and _begins(where, model))
            ):
                yield heading, cells


def _plain(words: str) -> str:
    return words.replace(" and ", " & ").replace("–", "-")


def _places(words: str) -> set[str]:
    """Equations and sections, such as (5a) and section 4.2."""
    return set(re.findall(r"\(\d+[a-z]?\)|section \d[\d.]*", words))


def _begins(where: str, model: Model) -> bool:
    first = where.split(",")[0].split(" ")[0]
    names = model.title.split(",")[0].split(" ")
    if len(first) > 1 or not first.isalpha():
        return first in names
    formula = str(model.describe()["documentation"])
    return re.search(rf"^{first}\b\s*[=:]", formula, re.MULTILINE) is not None
