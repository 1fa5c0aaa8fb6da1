"""A run of the benchmarks as text for the terminal and as docs/benchmarks.md."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from gonio.files import write_text

PACKAGES = ("gonio", "numpy", "scipy", "numba", "mitsuba", "pyradiance", "pySCATMECH")
HEADINGS = ("what", "ours, 1/s", "ratio", "against", "note")

HEAD = """# Benchmarks

This page shows the speed of gonio's compiled loops (pairs of directions, or pixels, per second)
and compares it with plain numpy and with other programs on the same work. Times depend on the
machine and its load. The meaningful number is therefore the **ratio** of gonio's speed to that of
the other program, with both measured in turn in one run. Above 1 gonio is faster.

- All comparisons use one thread. The fastest of several runs counts, after one warm-up run.
- Reflectance: 10^6 pairs of random directions, six arrays in and one out, in main memory, in
  float64 unless the line says float32. `memory` is a loop that only adds the six arrays: a ratio
  of 0.8 means 80 % of what this processor can read and write.
- `cores given` is the number of busy loops that ran at full speed, of one started per core,
  before or after the section, whichever is less. If it is far below the number of cores, the
  machine was busy: repeat the section.
- Each other program is called in its fastest way; the note says what it computes besides.
  `tests/test_peers.py` tests that the numbers agree.
- A program that is not installed is skipped; `pip install 'gonio[bench]'` installs them. The
  vectorised variants of Mitsuba also need libLLVM 16 or newer; `DRJIT_LIBLLVM_PATH` gives its
  path.

[Accuracy](accuracy.md) shows how well parameters are recovered. `python -m
benchmarks.oren_nayar_numeric` prints the errors of the integral model and of its table.
"""

FIRST_CALL = """## First call

Compiling the loops of a model takes seconds, once for each model and machine. gonio keeps the
code in the cache folder (`GONIO_CACHE_DIR`, else `gonio` below `XDG_CACHE_HOME` or `~/.cache`).
Each line is a new process. With a full cache the remaining time is mostly that of loading numba.
"""


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return (names or [platform.processor() or platform.machine()])[0]


def versions() -> dict[str, str | None]:
    """Versions of Python and of the measured packages; None for one that is not installed."""
    installed: dict[str, str | None] = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            installed[name] = version(name)
        except PackageNotFoundError:
            installed[name] = None
    return installed


def rate(value: float | None) -> str:
    """A number a second with three digits: 441 M."""
    if value is None:
        return ""
    for scale, prefix in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= 0.9995 * scale:
            return f"{value / scale:#.3g}".rstrip(".") + prefix
    return f"{value:.3g}"


def share(value: float | None) -> str:
    """A ratio with three digits."""
    if value is None:
        return ""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """One line of a table."""
    return row["name"], rate(row["ours_per_s"]), share(row["ratio"]), row["ratio_to"], row["note"]


def about(report: dict[str, Any]) -> list[str]:
    """Machine, versions, and the time that a start takes."""
    machine, start = report["machine"], report["start_up_s"]
    installed = [f"{name} {version}" for name, version in report["versions"].items() if version]
    return [
        f"{machine['processor']}, {machine['cores']} cores.",
        ", ".join(installed) + ".",
        f"`gonio --help` takes {start['gonio --help']:.2f} s, of which Python alone "
        f"{start['python']:.2f} s.",
    ]


def cores_of(part: dict[str, Any], report: dict[str, Any]) -> str:
    """The cores that a section had."""
    return f"{part['cores_given']:.1f} of {report['machine']['cores']} cores given"


def terminal(report: dict[str, Any]) -> str:
    """The report for a person at a terminal: one table."""
    tables = [[cells(row) for row in part["rows"]] for part in report["sections"]]
    every = [HEADINGS, *(row for rows in tables for row in rows)]
    widths = [max(len(row[k]) for row in every) for k in range(len(HEADINGS))]

    def line(row: tuple[str, ...]) -> str:
        fields = [
            f"{text:>{width}}" if k in (1, 2) else f"{text:<{width}}"
            for k, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        return "  ".join(fields).rstrip()

    lines = [line(HEADINGS)]
    for part, rows in zip(report["sections"], tables, strict=True):
        lines += ["", f"{part['section']}: {cores_of(part, report)}", *(line(row) for row in rows)]
    calls = [f"first call of {name}: {time_s:.2f} s" for name, time_s in first_calls(report)]
    return "\n".join([*lines, "", *about(report), *calls])


def first_calls(report: dict[str, Any]) -> list[tuple[str, float]]:
    """Names and seconds of the first calls; none where the kernels were not asked for."""
    return list(report.get("first_call_s", {}).items())


def markdown(head: tuple[str, ...], align: str, rows: list[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    rule = "|".join("---:" if side == "r" else "---" for side in align)
    lines = [" | ".join(row) for row in (head, *rows)]
    return "\n".join([f"| {lines[0]} |", f"|{rule}|", *(f"| {line} |" for line in lines[1:])])


def write(path: Path, report: dict[str, Any]) -> None:
    """The page with the tables of one run and the command that made them."""
    text = [HEAD, f"Made by\n\n```sh\n{report['command']}\n```\n", "\n\n".join(about(report))]
    for part in report["sections"]:
        text += [f"\n## {part['section'].capitalize()}\n", cores_of(part, report) + "\n"]
        text += [markdown(HEADINGS, "lrrll", [cells(row) for row in part["rows"]])]
    if calls := [(name, f"{time_s:.2f}") for name, time_s in first_calls(report)]:
        text += ["", FIRST_CALL, markdown(("first call of", "s"), "lr", calls)]
    write_text(path, "\n".join(text) + "\n")
