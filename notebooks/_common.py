"""Tools of the notebooks: quick or full mode, the folder for results, rows, figures, tables.

    nb = Notebook("ward_figures", paper="Ward 1992")
    nb.record("Fig. 6: ...", printed=0.21, ours=0.2098, agrees=abs(0.2098 - 0.21) < 0.01)
    nb.figure(fig, "fig6", "What the figure shows.")
    nb.done()

`GONIO_QUICK=1` asks for the quick mode, which computes the same rows with less; without it the mode
is full. `GONIO_PAPERS` names the folder for results, `notebooks/.results` where it is not set. Each
notebook has a folder of its own there: rows.csv, the figures as PNG and the tables as Markdown.
"""

from __future__ import annotations

import csv
import io
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from matplotlib.figure import Figure

from gonio.files import atomic_path, write_text
from gonio.plotting import style

ROOT = Path(__file__).resolve().parents[1]
FIELDS = ("paper", "item", "printed", "ours", "agrees", "why", "notebook")
# Names of the papers in the table, in its order.
PAPERS = ("Ward 1992", "Oren and Nayar 1994", "Losasso", "Blog on PBRT's Oren-Nayar")
YES, NO, UNEXPECTED, NOT_COMPUTED = "yes", "no", "UNEXPECTED", "not computed"
LARGEST_FIGURE = 60_000  # bytes; the figures are kept with the sources
DPI = 110
COLOURS = 128  # of a figure's palette, which makes the file a third as large
T = TypeVar("T")


def quick() -> bool:
    """Whether the environment asks for the quick mode."""
    return os.environ.get("GONIO_QUICK", "") not in ("", "0")


def results() -> Path:
    """Folder below which every notebook has its own."""
    named = os.environ.get("GONIO_PAPERS")
    mode = "quick" if quick() else "full"
    return Path(named) if named else ROOT / "notebooks" / ".results" / mode


class Notebook:
    """One notebook's mode and results.

    Parameters
    ----------
    name : str
        Name of the file without .py.
    paper : str
        Paper that its rows are about, one of PAPERS.

    Attributes
    ----------
    quick : bool
    folder : Path
        Where the results go; emptied of rows, figures and tables of an earlier run.
    """

    def __init__(self, name: str, paper: str) -> None:
        self.name, self.paper, self.quick = name, paper, quick()
        self.folder = results() / name
        self.folder.mkdir(parents=True, exist_ok=True)
        for old in self.folder.iterdir():
            if old.suffix in {".csv", ".png", ".md"}:
                old.unlink()
        self.rows: list[dict[str, str]] = []

    def choose(self, quick: T, full: T) -> T:
        """One of two values, by the mode."""
        return quick if self.quick else full

    def record(
        self,
        item: str,
        printed: object,
        ours: object,
        agrees: object,
        note: str = "",
        *,
        differs: str = "",
        paper: str | None = None,
    ) -> bool:
        """Add a row to the table of agreement; returns whether it came out as expected.

        Parameters
        ----------
        item : str
            Figure, table, equation or sentence of the paper, and what is compared.
        printed, ours : object
            The printed and the computed value; numbers are shown with four digits.
        agrees : bool
            Result of the comparison. The caller computes it, with a tolerance that it explains.
        note : str
            How it was compared.
        differs : str
            Reason why the two should not agree: the print is wrong, or the instrument cannot
            measure it. A row with a reason is unexpected if it agrees.
        paper : str, optional
            Paper of the row, where it is not that of the notebook.
        """
        as_expected = bool(agrees) != bool(differs)
        verdict = (YES if agrees else NO) if as_expected else UNEXPECTED
        why = "; ".join(part for part in (differs, note) if part)
        self._add(paper, item, shown(printed), shown(ours), verdict, why)
        return as_expected

    def absent(
        self, item: str, why: str, *, printed: object = "", paper: str | None = None
    ) -> None:
        """Add a row without computation, for a photograph or unpublished data."""
        self._add(paper, item, shown(printed), "", NOT_COMPUTED, why)

    def _add(
        self, paper: str | None, item: str, printed: str, ours: str, verdict: str, why: str
    ) -> None:
        row = (paper or self.paper, item, printed, ours, verdict, why, self.name)
        self.rows.append(dict(zip(FIELDS, row, strict=True)))
        write_rows(self.folder / "rows.csv", self.rows)
        print(f"[{verdict}] {item}: printed {printed or '-'}, ours {ours or '-'}. {why}".rstrip())

    def figure(self, figure: Figure, name: str, caption: str) -> None:
        """Write a figure as PNG of at most 60 kB; the page of the notebook shows it here.

        Parameters
        ----------
        figure : Figure
        name : str
            Name of the file without .png, unlike that of any other figure or table.
        caption : str
            Description for all readers, also those who cannot see the figure. The page takes name
            and caption from the source, so that both are literals.
        """
        path = self.folder / f"{name}.png"
        with style(), atomic_path(path) as temporary:
            temporary.write_bytes(png(figure))
        if path.stat().st_size > LARGEST_FIGURE:
            raise ValueError(
                f"{path.name} has {path.stat().st_size} bytes, more than {LARGEST_FIGURE}; "
                "draw less, or in a smaller size."
            )
        print(f"{path.name}: {caption}")
        if "ipykernel" not in sys.modules:  # there the cell shows it
            import matplotlib.pyplot as plt

            plt.close(figure)

    def table(self, name: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Write a table as Markdown and print it; the page of the notebook shows it here."""
        text = markdown(head, [[shown(cell) for cell in row] for row in rows])
        write_text(self.folder / f"{name}.md", text + "\n")
        print(text)

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """A folder for raw frames, which is removed when the block ends."""
        with tempfile.TemporaryDirectory(prefix=f"{self.name}_") as folder:
            yield Path(folder)

    def done(self) -> None:
        """Print the number of rows; call it in the last cell."""
        odd = [row["item"] for row in self.rows if row["agrees"] == UNEXPECTED]
        print(f"{self.name}: {len(self.rows)} rows, {len(odd)} not as expected.", *odd, sep="\n  ")


def shown(value: object) -> str:
    """A cell of a table: numbers with four digits, everything else as it is.

    Examples
    --------
    >>> shown(0.123456), shown(12), shown("a"), shown(None)
    ('0.1235', '12', 'a', '')
    """
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    return " ".join(str(value).split())


def png(figure: Figure) -> bytes:
    """The figure as a PNG with a palette."""
    from PIL import Image

    raw = io.BytesIO()
    figure.savefig(raw, format="png", dpi=DPI, metadata={})
    picture = Image.open(raw).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    small = io.BytesIO()
    picture.save(small, format="png", optimize=True)
    return small.getvalue()


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown; a bar inside a cell is escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(re.sub(r"(?<!\\)\|", r"\\|", cell) for cell in line) + " |"
        for line in lines
    )


def read_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a file of `write_rows`; none where there is no file."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_rows(path: Path, rows: Sequence[dict[str, str]]) -> None:
    """Write rows whole or not at all."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
