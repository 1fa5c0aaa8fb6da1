"""All benchmarks in one run and one table: python -m benchmarks (or make bench).

Run from the root of the checkout, in its environment. Absolute speeds depend on the machine and its
load. The ratios compare two ways to do one piece of work, measured in turn; the table also gives
the number of cores that the machine provided.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import page
from benchmarks.timing import best, cores

# A section is a module with run() -> list[Row]; one line adds it.
SECTIONS = {
    "kernels": "benchmarks.kernels",
    "integral": "benchmarks.oren_nayar_numeric",
    "frames": "benchmarks.frames",
    "fits": "benchmarks.fits",
    "whole fits": "benchmarks.whole_fits",
    "posteriors": "benchmarks.posteriors",
    "texels": "benchmarks.texels",
    "peers": "benchmarks.peers",
}


def section(name: str) -> dict[str, Any]:
    """One section's rows, and the available cores before and after it."""
    before = cores()
    rows = importlib.import_module(SECTIONS[name]).run()
    return {
        "section": name,
        "cores_given": round(min(before, cores()), 2),
        "rows": [asdict(row) for row in rows],
    }


def start_up() -> dict[str, float]:
    """Seconds from the shell to the help of `gonio`, and of Python alone."""
    commands = {"gonio --help": ["-m", "gonio", "--help"], "python": ["-c", ""]}
    return {
        name: best(partial(subprocess.run, [sys.executable, *args], capture_output=True))
        for name, args in commands.items()
    }


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "--only", action="append", choices=SECTIONS, metavar="SECTION",
        help=f"one of {', '.join(SECTIONS)}; may be given more than once",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page, too")
    arguments = parser.parse_args()
    report: dict[str, Any] = {
        "command": " ".join(["python -m benchmarks", *sys.argv[1:]]),
        "machine": {"processor": page.processor(), "cores": os.cpu_count()},
        "versions": page.versions(),
        "sections": [],
    }
    for name in arguments.only or SECTIONS:
        print(f"{name} ...", file=sys.stderr)
        report["sections"].append(section(name))
    report["start_up_s"] = start_up()
    if arguments.only is None or "kernels" in arguments.only:
        report["first_call_s"] = importlib.import_module(SECTIONS["kernels"]).compile_times()
    print(json.dumps(report, indent=2) if arguments.json else page.terminal(report))
    if arguments.markdown:
        page.write(arguments.markdown, report)
    return 0


if __name__ == "__main__":
    sys.exit(main())
