"""Random materials, fitted without starting values: errors, failures and their reasons.

Run from the root of the checkout, in its environment:

    python -m benchmarks.random_materials -o docs/calibration

Lobes are 0.02 to 0.4 wide and their amplitudes begin at 0.005, both drawn evenly by the logarithm;
the noise is 1 to 5 % of f. Two tables are written: error over stated error for each parameter, and
every parameter that failed.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import zlib
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import gonio
from benchmarks.sbc_sets import DEG, some_directions
from benchmarks.tables import write_rows
from gonio import models
from gonio.fitting.result import Estimate, FitResult
from gonio.samples import BRDFSamples

FAR = 5.0  # stated standard uncertainties
NOISE = (0.01, 0.05)  # of f
FLOOR = 1e-3  # smallest noise, of the mean of f
ALPHA, RHO_S = (0.02, 0.4), (0.005, 0.5)
# Ranges from which parameters are drawn evenly, or by the logarithm.
DRAWN: dict[str, dict[str, tuple[float, float, bool]]] = {
    "ward": {
        "rho_d": (0.02, 0.9, False), "rho_s": (*RHO_S, True),
        "alpha_x": (*ALPHA, True), "alpha_y": (*ALPHA, True),
    },
    "ward_isotropic": {
        "rho_d": (0.02, 0.9, False), "rho_s": (*RHO_S, True), "alpha": (*ALPHA, True),
    },
    "oren_nayar": {"rho": (0.05, 0.95, False), "sigma": (2 * DEG, 45 * DEG, False)},
    "oren_nayar_torrance_sparrow": {
        "sigma": (2 * DEG, 45 * DEG, False), "rho": (0.05, 0.95, False),
        "ks_over_kb": (*RHO_S, True),
    },
}  # fmt: skip
SUMMARY = (
    "model", "parameter", "materials", "median_z", "p95_z", "largest_z",
    "not_converged", "undetermined", "beyond_5",
)  # fmt: skip
FAILURES = (
    "model", "material", "parameter", "truth", "value", "stderr", "z", "reason", "noise",
    "warnings",
)  # fmt: skip


def one(model: str, number: int, seed: int) -> list[dict[str, Any]]:
    """Draw one material, fit it; a row a parameter."""
    rng = np.random.default_rng([seed, zlib.crc32(model.encode()), number])
    chosen = models.get(model)
    p = {}
    for name, (low, high, log) in DRAWN[model].items():
        p[name] = float(
            np.exp(rng.uniform(*np.log([low, high]))) if log else rng.uniform(low, high)
        )
    directions = some_directions(rng)
    f = chosen(directions, **p)
    noise = float(rng.uniform(*NOISE))
    u = np.hypot(noise * f, FLOOR * f.mean())
    samples = BRDFSamples(directions, f + u * rng.standard_normal(len(f)), u)
    result = gonio.fit(samples, model=chosen, threads=1)
    rows = []
    for q in chosen.parameters:
        truth, estimate = q.to_file(p[q.name]), result.parameters[q.name].in_file_units()
        z = None if estimate.stderr is None else (estimate.value - truth) / estimate.stderr
        rows.append(
            {
                "model": model,
                "material": number,
                "parameter": q.name,
                "truth": f"{truth:.5g}",
                "value": f"{estimate.value:.5g}",
                "stderr": "" if estimate.stderr is None else f"{estimate.stderr:.3g}",
                "z": "" if z is None else f"{z:.2f}",
                "reason": reason(result, estimate, z),
                "noise": f"{noise:.3g}",
                "warnings": " ".join(result.warnings),
            }
        )
    return rows


def reason(result: FitResult, estimate: Estimate, z: float | None) -> str:
    """Why a parameter counts as failed; empty where it does not."""
    if result.status != "converged":
        return "not converged"
    if estimate.at_bound is not None:
        return f"undetermined: at its {estimate.at_bound} bound"
    if z is None:
        return "undetermined"
    return f"beyond {FAR:g} stated uncertainties" if abs(z) > FAR else ""


def campaign(
    names: Iterable[str], materials: int, seed: int, workers: int
) -> Iterator[list[dict[str, Any]]]:
    """Rows of every material, in their order."""
    tasks = [(name, number, seed) for name, number in itertools.product(names, range(materials))]
    if workers == 1:
        yield from itertools.starmap(one, tasks)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(one, *zip(*tasks, strict=True), chunksize=8)


def summarised(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Quantiles of |error| over stated error, and failures, for each parameter."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["model"], row["parameter"]), []).append(row)
    lines = []
    for (model, parameter), group in groups.items():
        z = np.abs([float(row["z"]) for row in group if row["z"]])
        reasons = [row["reason"] for row in group]
        lines.append(
            {
                "model": model,
                "parameter": parameter,
                "materials": len(group),
                "median_z": f"{np.median(z):.2f}",
                "p95_z": f"{np.quantile(z, 0.95):.2f}",
                "largest_z": f"{np.max(z):.2f}",
                "not_converged": reasons.count("not converged"),
                "undetermined": sum(each.startswith("undetermined") for each in reasons),
                "beyond_5": sum(each.startswith("beyond") for each in reasons),
            }
        )
    return lines


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.random_materials", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--model", action="append", choices=DRAWN, metavar="MODEL")
    parser.add_argument("-n", "--materials", type=int, default=200, help="of each model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    names = arguments.model or list(DRAWN)
    for drawn in campaign(names, arguments.materials, arguments.seed, arguments.workers):
        rows += drawn
        failed = [f"{row['parameter']} {row['reason']}" for row in drawn if row["reason"]]
        if failed:
            print(f"{drawn[0]['model']} {drawn[0]['material']}: {', '.join(failed)}")
    for line in summarised(rows):
        print("  ".join(str(line[name]) for name in SUMMARY))
    write_rows(arguments.output / "random_materials.csv", SUMMARY, summarised(rows), ends="\r\n")
    write_rows(
        arguments.output / "random_failures.csv",
        FAILURES,
        [r for r in rows if r["reason"]],
        ends="\r\n",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
