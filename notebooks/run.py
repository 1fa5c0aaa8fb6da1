"""Run the notebooks and put their rows into one table.

Run from the root of the checkout, in its environment:

    python notebooks/run.py                 all, full mode, two processes: what `make papers` does
    python notebooks/run.py --quick         all, in a minute; leaves docs/ as it is
    python notebooks/run.py ward_figures    this one, full mode

A notebook that ended with the present sources is not run again; `--fresh` runs it anyway.
The full mode copies figures and tables to docs/papers/ and the rows to docs/papers/agreement.csv.
The exit code is 1 if a notebook failed or a row is not as expected.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from _common import PAPERS, ROOT, UNEXPECTED, read_rows, write_rows

HERE = Path(__file__).resolve().parent
PAGES = ROOT / "docs" / "papers"
SOURCES = ("gonio", "calibration", "fitting", "data")
# The longest first, so that the other process does the rest beside it.
LONG = ("ward_latex", "ward_table", "oren_nayar_materials")
SHOWN = 100  # characters of a line of the final table


@dataclass(frozen=True)
class Outcome:
    """Outcome of one notebook.

    Parameters
    ----------
    name : str
    seconds : float
    failed : bool
        It did not reach its end.
    skipped : bool
        It ended in an earlier run with the present sources.
    """

    name: str
    seconds: float
    failed: bool
    skipped: bool


def notebooks() -> list[str]:
    """Names of all notebooks, in the order of the table."""
    return sorted(p.stem for p in HERE.glob("[!_]*.py") if p.stem != "run")


def sources_digest(name: str) -> str:
    """Digest of all sources of a notebook's results: the package, this folder's helpers."""
    digest = hashlib.sha256()
    paths = [p for folder in SOURCES for p in (ROOT / folder).rglob("*.*") if is_source(p)]
    for path in [*sorted(paths), *sorted(HERE.glob("_*.py")), HERE / f"{name}.py"]:
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def is_source(path: Path) -> bool:
    return path.suffix in {".py", ".toml"} and "__pycache__" not in path.parts


def run_one(name: str, folder: Path, *, quick: bool, fresh: bool, jobs: int) -> Outcome:
    """Run one notebook in a new process, unless it is done; its output goes to log.txt."""
    results = folder / name
    results.mkdir(parents=True, exist_ok=True)
    mark, digest = results / "done.json", sources_digest(name)
    if not fresh and mark.is_file():
        earlier = json.loads(mark.read_text(encoding="utf-8"))
        if earlier["sources"] == digest:
            return Outcome(name, earlier["seconds"], failed=False, skipped=True)
    threads = max(1, (os.cpu_count() or 1) // jobs)
    environment = {
        **os.environ,
        "GONIO_QUICK": "1" if quick else "",
        "GONIO_PAPERS": str(folder),
        "MPLBACKEND": "Agg",
        # The processes share the cores.
        "GONIO_THREADS": os.environ.get("GONIO_THREADS", str(threads)),
        "PYTHONUNBUFFERED": "1",
    }
    start = time.monotonic()
    with (results / "log.txt").open("w", encoding="utf-8") as log:
        done = subprocess.run(
            [sys.executable, str(HERE / f"{name}.py")],
            cwd=HERE,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            check=False,
        )
    seconds = time.monotonic() - start
    if done.returncode == 0:
        mark.write_text(json.dumps({"sources": digest, "seconds": seconds}) + "\n", "utf-8")
    return Outcome(name, seconds, failed=done.returncode != 0, skipped=False)


def run_all(
    names: Sequence[str], folder: Path, *, quick: bool, fresh: bool, jobs: int
) -> Iterator[Outcome]:
    """Run notebooks in a few processes at once, in the order in which they end."""
    order = sorted(names, key=lambda name: name not in LONG)
    with ThreadPoolExecutor(jobs) as pool:
        running = [
            pool.submit(run_one, name, folder, quick=quick, fresh=fresh, jobs=jobs)
            for name in order
        ]
        for future in as_completed(running):
            yield future.result()


def report(outcome: Outcome, folder: Path, number: int, of: int) -> None:
    """One line of progress; where a notebook failed, the end of what it printed."""
    rows = read_rows(folder / outcome.name / "rows.csv")
    odd = sum(row["agrees"] == UNEXPECTED for row in rows)
    summary = f"{len(rows)} rows" + (f", {odd} NOT AS EXPECTED" if odd else "")
    state = "done before" if outcome.skipped else f"{outcome.seconds:.0f} s"
    if outcome.failed:
        summary = "FAILED"
    print(f"[{number:2d}/{of}] {outcome.name}: {state}, {summary}", file=sys.stderr, flush=True)
    if outcome.failed:
        log = (folder / outcome.name / "log.txt").read_text(encoding="utf-8")
        print("\n".join(log.splitlines()[-15:]), file=sys.stderr, flush=True)


def collect(names: Sequence[str], folder: Path, pages: Path) -> None:
    """Copy figures and tables to the pages; rows of other notebooks remain in the table."""
    table = [row for row in read_rows(pages / "agreement.csv") if row["notebook"] not in names]
    table = [row for row in table if row["notebook"] in notebooks()]
    for name in names:
        table += read_rows(folder / name / "rows.csv")
        target = pages / name
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir(parents=True)
        for path in sorted((folder / name).iterdir()):
            if path.suffix in {".png", ".md"}:
                shutil.copyfile(path, target / path.name)
    pages.mkdir(parents=True, exist_ok=True)
    write_rows(pages / "agreement.csv", in_order(table))


def in_order(rows: Sequence[dict[str, str]]) -> list[dict[str, str]]:
    """Rows by paper, then by notebook, the instrument last; within a notebook in recorded order."""

    def key(row: dict[str, str]) -> tuple[int, str, bool, str]:
        paper, name = row["paper"], row["notebook"]
        rank = PAPERS.index(paper) if paper in PAPERS else len(PAPERS)
        return rank, paper, name.startswith("instrument"), name

    return sorted(rows, key=key)


def print_table(rows: Sequence[dict[str, str]]) -> None:
    """The one table: item, printed value, ours, agrees or why not."""
    heads = ("item", "printed", "ours", "agrees or why not")
    lines = [heads]
    for row in in_order(rows):
        verdict = row["agrees"] + (f": {row['why']}" if row["why"] else "")
        lines.append((f"{row['paper']}, {row['item']}", row["printed"], row["ours"], verdict))
    limits = (60, 24, 24, SHOWN)
    widths = [min(limit, max(len(line[k]) for line in lines)) for k, limit in enumerate(limits)]
    for line in lines:
        print("  ".join(f"{cut(t, w):<{w}}" for t, w in zip(line, widths, strict=True)).rstrip())


def cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Run the notebooks; see notebooks/README.md.")
    parser.add_argument("names", nargs="*", help="notebooks, all where none is named")
    parser.add_argument("--quick", action="store_true", help="quick mode, docs/ stays as it is")
    parser.add_argument("--fresh", action="store_true", help="also those that are done")
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--output", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    names = options.names or notebooks()
    unknown = sorted(set(names) - set(notebooks()))
    if unknown:
        parser.error(f"no notebook {unknown[0]}; there are {', '.join(notebooks())}")
    mode = "quick" if options.quick else "full"
    folder = (options.output or HERE / ".results" / mode).resolve()
    failed = []
    outcomes = run_all(names, folder, quick=options.quick, fresh=options.fresh, jobs=options.jobs)
    for number, outcome in enumerate(outcomes, 1):
        report(outcome, folder, number, len(names))
        failed += [outcome.name] if outcome.failed else []
    rows = [row for name in names for row in read_rows(folder / name / "rows.csv")]
    if not options.quick:
        collect([name for name in names if name not in failed], folder, PAGES)
    print_table(rows)
    odd = [row["item"] for row in rows if row["agrees"] == UNEXPECTED]
    count = Counter(row["agrees"] for row in rows)
    counts = ", ".join(f"{n} {verdict}" for verdict, n in sorted(count.items()))
    print(f"{len(rows)} rows: {counts}. {len(failed)} notebooks failed.")
    return 1 if odd or failed else 0


if __name__ == "__main__":
    sys.exit(main())
