"""The verb `gonio.fit` as a user calls it, and what the time of a fit is spent on.

`python -m benchmarks.whole_fits --against PYTHON` fits the same samples in turn with the gonio of
another interpreter, such as that of an older checkout, and prints the ratios of processor time.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from statistics import median

import gonio
from benchmarks import fit_times
from benchmarks.fit_times import KINDS, TRUTH, measured
from benchmarks.timing import Row, best, best_in_turn
from gonio.fitting.diagnostics.diagnose import diagnose
from gonio.fitting.diagnostics.support import supports
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.residual_tests.verdict import misfit_beyond_shared
from gonio.fitting.residual_tests.whitened import Base
from gonio.fitting.screening import screened
from gonio.fitting.uncertainty.at_minimum import honest_uncertainties
from gonio.fitting.uncertainty.intervals import estimated
from gonio.models import get
from gonio.samples import BRDFSamples

ROUNDS = {2_000: 15, 20_000: 7, 200_000: 5}


def run() -> list[Row]:
    """Calls of the verb a second on one thread, against the search for the minimum alone."""
    rows = []
    for n, rounds in ROUNDS.items():
        samples = measured(n, "ward", n, known=True)
        works = {
            "whole": partial(gonio.fit, samples, model="ward", threads=1),
            "minimum": partial(find_minimum, samples, get("ward"), threads=1),
        }
        times = best_in_turn(works, rounds)
        whole = times["whole"]
        note = f"{1e3 * whole:.3g} ms: {_shares(samples, whole)}"
        name = f"gonio.fit of {n} samples, ward"
        rows.append(Row(name, 1 / whole, "its minimum alone", times["minimum"] / whole, note))
    return rows


def _shares(samples: BRDFSamples, whole: float) -> str:
    """Shares of the stages in the time of a fit, in words."""
    minimum = find_minimum(samples, get("ward"), threads=1)
    test = misfit_beyond_shared(minimum)
    errors, _ = honest_uncertainties(minimum, test)
    estimates, _ = estimated(minimum, errors, test)

    def intervals() -> None:
        honest_uncertainties(minimum, test)
        estimated(minimum, errors, test)

    stages = {
        "plausibility": partial(screened, samples),
        "minimum": partial(find_minimum, samples, get("ward"), threads=1),
        "residuals and verdict": lambda: diagnose(minimum, Base.of(minimum)),
        "intervals": intervals,
        "support": partial(supports, minimum, estimates),
    }
    return ", ".join(f"{name} {best(stage, 3) / whole:.0%}" for name, stage in stages.items())


# ---------------------------------------------------------------- against another installation


def compare(python: str) -> None:
    """Print the ratios of processor time to those of another interpreter's gonio."""
    threads = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(threads, "1")}
    # By its path: the folder of this checkout must not hide what the other one has installed.
    program = str(Path(fit_times.__file__).resolve())
    pair = [
        subprocess.Popen(
            [which, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=environment,
        )
        for which in (sys.executable, python)
    ]  # fmt: skip

    def asked(process: subprocess.Popen[str], line: str) -> float:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(line)
        process.stdin.flush()
        return float(process.stdout.readline())

    print(f"{'kind':8} {'model':15} {'samples':>7} {'ms':>8} {'other':>8} {'ratio':>6}")
    for kind in KINDS:
        for model in TRUTH:
            for n, rounds in ROUNDS.items():
                # The first call loads and compiles; it is not counted.
                times = [
                    [asked(process, f"{kind} {model} {n} {seed}\n") for process in pair]
                    for seed in range(rounds + 1)
                ][1:]
                ours, other = (median(own) for own in zip(*times, strict=True))
                print(f"{kind:8} {model:15} {n:7} {ours:8.1f} {other:8.1f} {ours / other:6.2f}")
    for process in pair:
        assert process.stdin is not None
        process.stdin.close()
        process.wait()


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.whole_fits")
    parser.add_argument("--against", metavar="PYTHON", help="interpreter with the other gonio")
    arguments = parser.parse_args()
    if arguments.against:
        compare(arguments.against)
    else:
        for row in run():
            print(f"{row.name}: {row.note}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
