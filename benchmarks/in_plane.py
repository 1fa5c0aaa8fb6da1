"""Coverage of the intervals where one plane of incidence was measured, for every elliptical model.

Run from the root of the checkout, in its environment:

    python -m benchmarks.in_plane -o docs/uncertainty/in_plane.csv

In one plane the width of a lobe across it is exchanged for its amplitude: neither is determined,
and all other parameters must have the uncertainty that this exchange leaves them. Every run makes
samples of an elliptical model at four incidences and 36 viewing angles in their plane, with normal
noise of 1 % of the mean value that is stated, and fits that model. The table counts how often a
parameter is determined, and how often its 95 % interval then covers the true value. A parameter
that is at a bound, or whose interval reaches one, is counted by its interval. 400 runs take two
minutes a model.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats

import gonio
from benchmarks.tables import write_rows
from gonio.geometry import Directions
from gonio.models import get as get_model
from gonio.samples import BRDFSamples

INCIDENCES_DEG = (10.0, 30.0, 45.0, 60.0)
VIEWS_DEG = np.linspace(-85.0, 85.0, 36)
NOISE = 0.01  # of the mean value
_WARD = {"rho_d": 0.25, "rho_s": 0.25, "alpha_x": 0.39, "alpha_y": 0.39}
SURFACES: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "ward": ("ward", _WARD),
    "ward_duer": ("ward_duer", _WARD),
    "ward_gmd": ("ward_gmd", _WARD),
    "ward_approx": ("ward_approx", _WARD),
    "ggx, dielectric": (
        "ggx",
        {"rho_d": 0.25, "k_s": 0.8, "alpha_x": 0.3, "alpha_y": 0.3, "eta": 1.5, "kappa": 0.0},
    ),
    "ggx, metal": (
        "ggx",
        {"rho_d": 0.1, "k_s": 0.8, "alpha_x": 0.3, "alpha_y": 0.3, "eta": 1.2, "kappa": 2.0},
    ),
    "ashikhmin_shirley": (
        "ashikhmin_shirley", {"rho_d": 0.25, "rho_s": 0.25, "n_u": 20.0, "n_v": 20.0},
    ),
}  # fmt: skip
FIELDS = (
    "surface", "parameter", "runs", "determined", "covered", "least", "most", "covered_percent",
)  # fmt: skip


class Check(NamedTuple):
    """One parameter of one run: whether it has an uncertainty, and whether its interval covers."""

    parameter: str
    determined: bool
    covers: bool


def samples(name: str, seed: int) -> BRDFSamples:
    """Samples in the plane of incidence with noise that is stated."""
    theta_i, view = (
        a.ravel() for a in np.meshgrid(np.radians(INCIDENCES_DEG), np.radians(VIEWS_DEG))
    )
    where = Directions(theta_i, 0.0, np.abs(view), np.where(view < 0, 0.0, np.pi))
    model, values = SURFACES[name]
    f = get_model(model)(where, **values)
    sd = np.full(len(f), NOISE * float(np.mean(f)))
    return BRDFSamples(where, np.random.default_rng(seed).normal(f, sd), u_independent=sd)


def run(name: str, seed: int) -> list[Check]:
    """Fit one data set."""
    model, values = SURFACES[name]
    result = gonio.fit(samples(name, seed), model=model, threads=1)
    checks = []
    for parameter, true in values.items():
        e = result.parameters[parameter]
        low, high = e.interval_95 or (-np.inf, np.inf)
        checks.append(Check(parameter, e.interval_95 is not None, low <= true <= high))
    return checks


def table(checks: Mapping[str, list[Check]]) -> list[dict[str, object]]:
    """Counts by surface and parameter."""
    rows: list[dict[str, object]] = []
    for name, found in checks.items():
        for parameter in SURFACES[name][1]:
            own = [c for c in found if c.parameter == parameter]
            stated = [c for c in own if c.determined]
            covered = sum(c.covers for c in stated)
            least, most = stats.binom.interval(0.99, len(stated), 0.95) if stated else (0, 0)
            rows.append(
                {
                    "surface": name,
                    "parameter": parameter,
                    "runs": len(own),
                    "determined": len(stated),
                    "covered": covered,
                    "least": int(least),
                    "most": int(most),
                    "covered_percent": f"{100 * covered / len(stated):.1f}" if stated else "",
                }
            )
    return rows


def main() -> int:
    """Run the campaign and write its table; it grows model by model."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1000, help="of the first run")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--surface", action="append", choices=SURFACES)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    checks: dict[str, list[Check]] = {}
    with ProcessPoolExecutor(options.processes) as pool:
        for name in options.surface or SURFACES:
            seeds = range(options.seed, options.seed + options.runs)
            jobs = [pool.submit(run, name, seed) for seed in seeds]
            checks[name] = [check for job in jobs for check in job.result()]
            write_rows(options.output, FIELDS, table(checks))
            print(name, file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
