"""Simulation-based calibration: stated uncertainties against true errors.

Run from the root of the checkout, in its environment:

    python -m benchmarks.sbc --raw build/sbc.csv -o docs/calibration/sbc.csv

Parameters are drawn from the prior, a data set is made with them and fitted. If the posteriors are
right, the rank of the truth among independent draws of its posterior is uniform (Talts et al.
2018, arXiv:1804.06788), and the intervals cover the truth at their nominal rates. `--raw` writes
one line a set and parameter; the sets in an existing file are not run again.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import sys
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy import stats

import gonio
from benchmarks.sbc_sets import CASES, Lie, drawn
from benchmarks.tables import write_rows
from gonio.fitting.result import FitResult
from gonio.geometry import FloatArray

DRAWS = 99  # a rank is one of 100
BINS = 20
SMALLEST_P = 0.001
LEVELS = {"68": 0.6826895, "95": 0.95}
INTERVALS = ("posterior", "least_squares")
RAW = (
    "case", "lie", "set", "parameter", "truth", "value", "stderr", "rank",
    *(f"{kind}_{level}" for kind in INTERVALS for level in LEVELS),
    "status", "posterior_converged", "chi2_per_dof", "noise", "n_samples",
)  # fmt: skip
SUMMARY = (
    "case", "lie", "parameter", "sets", "rank_p",
    *(f"{kind}_{level}{end}" for kind in INTERVALS for level in LEVELS for end in ("", "_p")),
    "without_interval", "not_converged", "ranks",
)  # fmt: skip


def one_set(case: str, lie: Lie, number: int, seed: int) -> list[dict[str, Any]]:
    """Draw one data set, fit it with and without a posterior; a row a parameter."""
    rng = np.random.default_rng([seed, zlib.crc32(case.encode()), zlib.crc32(lie.encode()), number])
    data = drawn(CASES[case], rng, lie)
    model = CASES[case].fitted
    fitter = int(rng.integers(0, 2**31))
    least_squares = gonio.fit(data.samples, model=model, threads=1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "draws.nc"
        sampled = gonio.fit(
            data.samples, model=model, posterior=True, draws=path, sampler="auto", seed=fitter,
            threads=1,
        )  # fmt: skip
        draws = thinned(path, model.names)
    assert sampled.posterior is not None
    rows = []
    for j, q in enumerate(model.parameters):
        truth = q.to_file(float(data.truth[j]))
        estimate = least_squares.parameters[q.name].in_file_units()
        rows.append(
            {
                "case": case,
                "lie": lie,
                "set": number,
                "parameter": q.name,
                "truth": f"{truth:.8g}",
                "value": f"{estimate.value:.8g}",
                "stderr": "" if estimate.stderr is None else f"{estimate.stderr:.5g}",
                "rank": rank(truth, draws[:, j], rng),
                **coverage("posterior", sampled, q.name, truth),
                **coverage("least_squares", least_squares, q.name, truth),
                "status": least_squares.status,
                "posterior_converged": int(sampled.posterior.converged),
                "chi2_per_dof": f"{least_squares.chi2 / least_squares.dof:.4g}",
                "noise": f"{data.noise:.4g}",
                "n_samples": least_squares.n_samples,
            }
        )
    return rows


def thinned(path: Path, names: Sequence[str]) -> FloatArray:
    """`DRAWS` draws (draws, parameters), evenly over a chain that is many times as long."""
    import h5py

    with h5py.File(path) as file:  # many times as quick as xarray
        chain = np.stack([file["posterior"][name][:].T.ravel() for name in names], axis=1)
    return chain[np.linspace(0, len(chain) - 1, DRAWS).round().astype(int)]


def rank(truth: float, draws: FloatArray, rng: np.random.Generator) -> int:
    """How many draws lie below the truth; for equal values, at a bound, a coin decides."""
    ties = int(np.count_nonzero(draws == truth))
    return int(np.count_nonzero(draws < truth)) + int(rng.integers(0, ties + 1))


def coverage(kind: str, result: FitResult, name: str, truth: float) -> dict[str, Any]:
    """Whether each interval covers the truth: 1, 0, or empty where none is stated."""
    estimate = result.parameters[name].in_file_units()
    intervals = {"68": estimate.interval_68, "95": estimate.interval_95}
    return {
        f"{kind}_{level}": "" if pair is None else int(pair[0] <= truth <= pair[1])
        for level, pair in intervals.items()
    }


def campaign(
    cases: Sequence[str], lie: Lie, numbers: Iterable[int], seed: int, workers: int = 1
) -> Iterator[list[dict[str, Any]]]:
    """Rows of every set, in their order; the rows do not depend on the number of workers."""
    tasks = [(case, lie, number, seed) for case, number in itertools.product(cases, numbers)]
    if workers == 1:
        yield from itertools.starmap(one_set, tasks)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(one_set, *zip(*tasks, strict=True)) if tasks else ()


# ---------------------------------------------------------------- summary


def summarised(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """One line a case and parameter: uniformity of the ranks, and coverage of the intervals."""
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        key = tuple(str(row[name]) for name in ("case", "lie", "parameter"))
        groups.setdefault(key, []).append(row)
    return [
        dict(zip(("case", "lie", "parameter"), key, strict=True)) | _summary(group)
        for key, group in groups.items()
    ]


def _summary(group: list[dict[str, Any]]) -> dict[str, Any]:
    ranks = np.array([int(row["rank"]) for row in group])
    counts = np.bincount(ranks * BINS // (DRAWS + 1), minlength=BINS)
    line: dict[str, Any] = {
        "sets": len(group),
        "rank_p": f"{stats.chisquare(counts).pvalue:.3g}",
        "without_interval": sum(row["least_squares_95"] == "" for row in group),
        "not_converged": sum(
            row["status"] != "converged" or not int(row["posterior_converged"]) for row in group
        ),
        "ranks": " ".join(map(str, counts)),
    }
    for kind, (level, share) in itertools.product(INTERVALS, LEVELS.items()):
        covered = [int(row[f"{kind}_{level}"]) for row in group if row[f"{kind}_{level}"] != ""]
        line[f"{kind}_{level}"] = f"{100 * sum(covered) / len(covered):.1f}" if covered else ""
        p = stats.binomtest(sum(covered), len(covered), share).pvalue if covered else 1.0
        line[f"{kind}_{level}_p"] = f"{p:.3g}"
    return line


def failures(line: dict[str, Any]) -> list[str]:
    """Names of the tests that a line of the summary does not pass."""
    return [name for name in line if name.endswith("_p") and float(line[name]) <= SMALLEST_P]


# ---------------------------------------------------------------- files and command line


def read(path: Path) -> list[dict[str, Any]]:
    """Rows of complete sets in a file of an earlier run; none where there is no file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        # A run that was killed may have left a part of a line.
        return [row for row in csv.DictReader(file) if row["n_samples"]]


def appended(path: Path, sets: Iterable[list[dict[str, Any]]]) -> None:
    """Add the rows of each set to the file as they come."""
    path.parent.mkdir(parents=True, exist_ok=True)
    complete = read(path)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, RAW)
        writer.writeheader()
        writer.writerows(complete)
        for rows in sets:
            writer.writerows(rows)
            file.flush()


def write_summary(path: Path, lines: list[dict[str, Any]]) -> None:
    """The table of `summarised` as CSV; lines of other cases in the file stay."""
    keys = {(line["case"], line["lie"], line["parameter"]) for line in lines}
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            old = list(csv.DictReader(file))
        lines = [r for r in old if (r["case"], r["lie"], r["parameter"]) not in keys] + lines
    write_rows(path, SUMMARY, lines, ends="\r\n")


def main() -> int:
    """Command line; the exit code is 1 where a test fails."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sbc", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--case", action="append", choices=CASES, metavar="CASE",
                        help=f"one of {', '.join(CASES)}; may be given more than once")  # fmt: skip
    parser.add_argument("--lie", choices=get_args(Lie), default="none",
                        help="what the samples state wrongly, to see the tests fail")  # fmt: skip
    parser.add_argument("-n", "--sets", type=int, default=1000, help="of each case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--raw", type=Path, required=True, metavar="FILE.csv",
                        help="a line a set and parameter; an earlier run is continued")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.csv", help="the summary")
    arguments = parser.parse_args()
    lines = []
    for case in arguments.case or CASES:
        numbers = set(range(arguments.sets))
        have = {
            int(r["set"])
            for r in read(arguments.raw)
            if (r["case"], r["lie"]) == (case, arguments.lie)
        }
        missing = sorted(numbers - have)
        print(f"{case}: {len(missing)} of {len(numbers)} sets to run", file=sys.stderr)
        appended(
            arguments.raw,
            campaign([case], arguments.lie, missing, arguments.seed, arguments.workers),
        )
        rows = [r for r in read(arguments.raw) if (r["case"], r["lie"]) == (case, arguments.lie)]
        lines += summarised(r for r in rows if int(r["set"]) in numbers)
    for line in lines:
        bad = ", ".join(failures(line))
        shares = "  ".join(f"{line[f'{k}_{v}']:>5}" for k in INTERVALS for v in LEVELS)
        print(
            f"{line['case']:<28} {line['parameter']:<12} {line['sets']:>5} sets  "
            f"rank p {line['rank_p']:>8}  {shares}  {'FAILS: ' + bad if bad else ''}"
        )
    if arguments.output:
        write_summary(arguments.output, lines)
    return int(any(map(failures, lines)))


if __name__ == "__main__":
    sys.exit(main())
