"""Coverage of the intervals where samples share errors, by three ways to treat these.

Run from the root of the checkout, in its environment:

    python -m benchmarks.nuisance -o docs/nuisance/coverage.csv
    python -m benchmarks.nuisance --frames -o docs/nuisance/frames.csv

Every run draws the error of a standard that is known to 2 %, of a lamp that drifts by 1 % and of an
azimuth known to 0.5 deg, makes data of a brushed surface with them and fits these

- `independent`: without shared errors;
- `propagated`: the shared errors are added to the uncertainties, as `gonio fit` does;
- `profiled`: they are nuisance parameters with priors, as in `gonio fit --nuisance all`.

The table counts how often the 95 % interval of each parameter covers the true value, with the 95 %
range of that count for correct intervals, and gives the width of the interval. The rows of a
profiled error count its draws by their estimate and standard uncertainty.

Samples are Ward's model at five incidences and three rotations, four fifths of them about the lobe,
with noise of 1 % that is known; the lamp's draw is one for each incidence. With --frames they come
from raw frames of modern12 by `gonio reduce`, with everything else that modern12 does to light; the
lamp's draw is then one for each image. 200 runs on samples take two minutes, 24 on frames five.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats

import gonio
from benchmarks.tables import write_rows
from gonio.fitting.result import FitResult
from gonio.geometry import Directions, FloatArray, angles, rotated, unit_vectors
from gonio.instrument import preset
from gonio.instrument.plans import default_plan
from gonio.metadata import Plan
from gonio.models import get as get_model
from gonio.samples import BRDFSamples, SharedTerm

U_STANDARD, U_LAMP, U_AZIMUTH_DEG = 0.02, 0.01, 0.5
INCIDENCES_DEG = (10.0, 25.0, 40.0, 50.0, 60.0)
ROTATIONS_DEG = (0.0, 45.0, 90.0)
NOISE = 0.01
SURFACE = {"rho_d": 0.1, "rho_s": 0.05, "alpha_x": 0.04, "alpha_y": 0.11}
N_SAMPLES = 3000
WAYS = ("independent", "propagated", "profiled")
FIELDS = (
    "way", "quantity", "runs", "held", "least", "most", "held_percent", "width_percent",
)  # fmt: skip


class IntervalCheck(NamedTuple):
    """One interval of one run: whether it covers the truth, and its width over the truth."""

    way: str
    quantity: str
    covers: bool
    width: float


def samples(seed: int, n: int = N_SAMPLES) -> tuple[BRDFSamples, dict[str, FloatArray]]:
    """Samples of a brushed surface with shared errors, and the draws of these by name."""
    rng = np.random.default_rng(seed)
    w_i, w_r, incidence = _directions(rng, n)
    draws = {
        "standard": rng.standard_normal(1),
        "lamp": rng.standard_normal(len(INCIDENCES_DEG)),
        "azimuth": rng.standard_normal(1),
    }
    turn = np.radians(U_AZIMUTH_DEG)
    model = get_model("ward")
    where = Directions(*angles(w_i), *angles(w_r))
    off = float(turn * draws["azimuth"][0])
    stated = replace(where, phi_i=where.phi_i - off, phi_r=where.phi_r - off)
    factor = (1 + U_STANDARD * draws["standard"]) * (1 + U_LAMP * draws["lamp"][incidence])
    # The noise is known, not taken from the noisy values: those would pull the fit down.
    u = NOISE * model(where, **SURFACE)
    value = model(stated, **SURFACE) * factor + u * rng.standard_normal(len(u))
    shared = (
        SharedTerm("standard", "reflectance of the standard", U_STANDARD),
        SharedTerm("lamp", "output at each incidence", U_LAMP, group=incidence),
        SharedTerm("azimuth", "zero of the rotation", turn=float(turn)),
    )
    return BRDFSamples(where, value, u_independent=u, shared=shared), draws


def _directions(rng: np.random.Generator, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions in the frame of the sample and the number of the incidence of each."""
    each = n // (len(INCIDENCES_DEG) * len(ROTATIONS_DEG))
    widths = [SURFACE["alpha_x"], SURFACE["alpha_y"]]
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for k, theta in enumerate(np.radians(INCIDENCES_DEG)):
        for psi in np.radians(ROTATIONS_DEG):
            light = rotated(unit_vectors(theta, 0.0), psi)
            wide = rng.random((4 * each, 1)) < 0.2
            slope = np.where(wide, 0.5, widths) * rng.standard_normal((4 * each, 2))
            h = np.concatenate([slope, np.ones((4 * each, 1))], axis=1)
            h /= np.linalg.norm(h, axis=1, keepdims=True)
            out = 2 * (h @ light)[:, None] * h - light
            out = out[out[:, 2] > 0.17][:each]  # up to 80 deg
            parts.append((np.tile(light, (len(out), 1)), out, np.full(len(out), k)))
    w_i, w_r, incidence = (np.concatenate(part) for part in zip(*parts, strict=True))
    return w_i, w_r, incidence


def of_frames(seed: int) -> BRDFSamples:
    """The same errors on the way from raw frames of modern12."""
    instrument = preset("modern12")
    parts = {
        "standard": {"uncertainty": U_STANDARD},
        "lamp": {"drift": U_LAMP},
        "holder": {"u_azimuth_deg": U_AZIMUTH_DEG},
    }
    changed = {
        part: getattr(instrument, part).model_copy(update=new) for part, new in parts.items()
    }
    instrument = instrument.model_copy(update=changed)
    default = default_plan(instrument, anisotropic=True).model_dump()
    plan = Plan.model_validate(default | {"theta_i_deg": INCIDENCES_DEG[::2]})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session"
        gonio.simulate(
            model="ward", parameters=SURFACE, output=path, instrument=instrument, plan=plan,
            seed=seed, threads=1, truth_images=False,
        )  # fmt: skip
        reduced = gonio.reduce(path, threads=1)
        shutil.rmtree(path)
    return reduced


def run(seed: int, *, frames: bool) -> list[IntervalCheck]:
    """Fit one data set in every way."""
    data, draws = (of_frames(seed), {}) if frames else samples(seed)
    checks = []
    for way in WAYS:
        used = replace(data, shared=()) if way == "independent" else data
        result = gonio.fit(
            used, model="ward", threads=1, nuisance="all" if way == "profiled" else "none"
        )
        checks += _parameters(way, result)
        checks += _draws(way, result, draws)
    return checks


def _parameters(way: str, result: FitResult) -> Iterator[IntervalCheck]:
    for q in get_model("ward").parameters:
        true = q.to_file(SURFACE[q.name])
        interval = result.parameters[q.name].in_file_units().interval_95
        assert interval is not None, f"{q.name} is not determined"
        low, high = interval
        yield IntervalCheck(way, q.name, low <= true <= high, 100 * (high - low) / true)


def _draws(way: str, result: FitResult, draws: dict[str, FloatArray]) -> Iterator[IntervalCheck]:
    reach = float(stats.norm.ppf(0.975))
    for name, true in draws.items():
        for e, z in zip((e for e in result.nuisance if e.name == name), true, strict=False):
            yield IntervalCheck(
                way, f"draw of {name}", abs(e.estimate - z) <= reach * e.stderr, np.nan
            )


def table(checks: list[IntervalCheck]) -> list[dict[str, object]]:
    """Counts and median widths by way and quantity, in the order in which they appear."""
    rows: list[dict[str, object]] = []
    for way, quantity in dict.fromkeys((one.way, one.quantity) for one in checks):
        group = [one for one in checks if (one.way, one.quantity) == (way, quantity)]
        n_covered, n = sum(one.covers for one in group), len(group)
        least, most = stats.binom.interval(0.95, n, 0.95)
        width = float(np.median([one.width for one in group]))
        rows.append(
            {
                "way": way,
                "quantity": quantity,
                "runs": n,
                "held": n_covered,
                "least": int(least),
                "most": int(most),
                "held_percent": f"{100 * n_covered / n:.1f}",
                "width_percent": "" if np.isnan(width) else f"{width:.3g}",
            }
        )
    return rows


def main() -> int:
    """Run the campaign and write its table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", action="store_true", help="from raw frames")
    parser.add_argument("--runs", type=int, help="200, or 24 from raw frames")
    parser.add_argument("--seed", type=int, default=1000, help="of the first run")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    runs = options.runs or (24 if options.frames else 200)
    seeds = range(options.seed, options.seed + runs)
    checks: list[IntervalCheck] = []
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = [pool.submit(run, seed, frames=options.frames) for seed in seeds]
        for k, job in enumerate(jobs, start=1):
            checks += job.result()
            write_rows(options.output, FIELDS, table(checks))
            print(f"\r{k} of {runs}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
