"""Verdicts on simulated samples: the level on true models, and wrong models that are found.

Run from the root of the checkout, in its environment:

    python -m benchmarks.verdicts level --sets 1000 -o docs/calibration/verdict-level.csv
    python -m benchmarks.verdicts nearest --sets 50 -o docs/calibration/verdict-nearest.csv
    python -m benchmarks.verdicts sessions --sets 50 -o docs/calibration/verdict-sessions.csv

`level` draws noise for a true model and counts sets with p below 0.01 and 0.001, with the 99 %
ranges of their binomial laws. `nearest` fits true and wrong models to files with 1 % noise.
Wrong models whose power by noncentral chi-squared is not above 0.999 are listed as such: there
the data cannot tell, whatever a program says. `sessions` does the same from raw frames of the
instrument ideal12 at its full resolution.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import gonio
from benchmarks.tables import write_rows
from gonio import models
from gonio.geometry import Directions, FloatArray
from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.samples import BRDFSamples

CLASSES = ("fits", "fits_within_shared", "does_not_fit", "undecided")
NOISE = 0.01  # of f
POWER = 0.999
LEVEL = 0.01
TRUTHS: Mapping[str, Mapping[str, float]] = {
    "lambert": {"rho": 0.5},
    "oren_nayar": {"rho": 0.7, "sigma": 0.4},
    "ward_isotropic": {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.2},
    "ward": {"rho_d": 0.2, "rho_s": 0.08, "alpha_x": 0.12, "alpha_y": 0.25},
    "ward_duer": {"rho_d": 0.2, "rho_s": 0.08, "alpha_x": 0.12, "alpha_y": 0.25},
    "phong": {"rho_d": 0.3, "rho_s": 0.1, "n": 40.0},
}
NEAREST: Mapping[str, Sequence[str]] = {
    "lambert": (),
    "oren_nayar": ("lambert", "minnaert"),
    "ward_isotropic": ("ward_duer", "phong"),
    "ward": ("ward_duer", "ward_gmd", "ward_approx", "ward_isotropic"),
    "ward_duer": ("ward", "ward_gmd"),
    "phong": ("ward_isotropic", "blinn"),
}
FROM_FRAMES = ("oren_nayar", "ward", "phong")
NOISES = ("stated", "unknown, in proportion to f", "unknown, constant")


def directions() -> Directions:
    """Six incidences over the hemisphere, 540 samples."""
    theta_i, theta_r, phi_r = np.meshgrid(
        np.radians([5, 20, 35, 50, 60, 70]), np.radians(np.arange(0, 75, 5)),
        np.radians([0, 40, 90, 140, 165, 180]), indexing="ij",
    )  # fmt: skip
    return Directions(theta_i.ravel(), 0.3, theta_r.ravel(), phi_r.ravel() + 0.3)


def surface(model: str) -> FloatArray:
    """The true BRDF at the directions."""
    where = directions()
    f = models.get(model)(where, **TRUTHS[model])
    return np.asarray(f * np.ones(len(where.theta_r)))


def one_file(model: str, noise: str, number: int) -> BRDFSamples:
    """Samples of a true model with one draw of the noise."""
    f = surface(model)
    sd = np.full(len(f), NOISE * f.mean()) if noise.endswith("constant") else NOISE * f
    rng = np.random.default_rng([number, len(model), len(noise)])
    value = f + sd * rng.standard_normal(len(f))
    return BRDFSamples(directions(), value, sd if noise == "stated" else None)


def structure(model: str, noise: str, number: int) -> float:
    """p of structure in the residuals of the true model."""
    result = gonio.fit(one_file(model, noise, number), model, threads=1)
    return float(result.diagnostics["residuals"]["p_structure"])


def kind(true: str, fitted: str, number: int) -> str:
    """Class of the verdict on one file."""
    verdict = gonio.fit(one_file(true, "stated", number), fitted, threads=1).verdict
    assert verdict is not None
    return verdict.kind


def power(true: str, wrong: str) -> float:
    """Power of chi-squared at 1 % against the best parameters of the wrong model."""
    f = surface(true)
    samples = BRDFSamples(directions(), f, NOISE * f)
    result = gonio.fit(samples, wrong, threads=1)
    limit = stats.chi2.isf(LEVEL, result.dof)
    return float(stats.ncx2.sf(limit, result.dof, max(result.chi2, 1e-12)))


def levels(n: int, pool: ProcessPoolExecutor) -> Iterator[dict[str, Any]]:
    """A row for each model and kind of noise."""
    for model in TRUTHS:
        for noise in NOISES:
            p = np.array(list(pool.map(partial(structure, model, noise), range(n), chunksize=10)))
            row: dict[str, Any] = {"model": model, "noise": noise, "sets": n}
            for level in (0.05, 0.01, 0.001):
                low, high = stats.binom.interval(0.99, n, level)
                row[f"below {level:g}"] = int(np.sum(p < level))
                row[f"range {level:g}"] = f"{low:.0f} to {high:.0f}"
            yield row


def nearest(n: int, pool: ProcessPoolExecutor) -> Iterator[dict[str, Any]]:
    """A row for each true model with itself and with the wrong models."""
    for true, others in NEAREST.items():
        for fitted in (true, *others):
            counts = Counter(pool.map(partial(kind, true, fitted), range(n), chunksize=5))
            yield _row(true, fitted, "files", counts)


def kinds_of_session(true: str, number: int) -> list[str]:
    """Classes of the verdicts on one simulated session, the true model's first."""
    instrument = preset("ideal12")
    rotations = (0,) if models.get(true).claims.isotropic else (0, 60)
    plan = Plan(
        theta_i_deg=(10, 35, 60), rotations_deg=rotations,
        exposures_s=instrument.sensor.exposures_s[::2],
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        session = gonio.simulate(
            model=true, parameters=TRUTHS[true], output=Path(folder) / "s.gonio",
            instrument=instrument, plan=plan, seed=number, threads=1, truth_images=False,
        )  # fmt: skip
        samples = gonio.reduce(session, threads=1)
    found = []
    for fitted in (true, *NEAREST[true]):
        verdict = gonio.fit(samples, fitted, threads=1).verdict
        assert verdict is not None
        found.append(verdict.kind)
    return found


def from_frames(n: int, pool: ProcessPoolExecutor) -> Iterator[dict[str, Any]]:
    """A row for each true model with itself and with the wrong models, from raw frames."""
    for true in FROM_FRAMES:
        found = list(pool.map(partial(kinds_of_session, true), range(n)))
        for j, fitted in enumerate((true, *NEAREST[true])):
            yield _row(true, fitted, "sessions", Counter(kinds[j] for kinds in found))


def _row(true: str, fitted: str, of_what: str, counts: Counter[str]) -> dict[str, Any]:
    """Counts of the classes beside the right one, which the power decides."""
    strong = fitted == true or power(true, fitted) > POWER
    right = "fits" if fitted == true else "does_not_fit" if strong else "cannot be told"
    return {
        "true": true, "fitted": fitted, of_what: counts.total(), "right": right,
        **{name: counts[name] for name in CLASSES},
    }  # fmt: skip


CAMPAIGNS = {"level": levels, "nearest": nearest, "sessions": from_frames}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a campaign and write its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", choices=CAMPAIGNS)
    parser.add_argument("--sets", type=int, default=1000)
    parser.add_argument("--workers", type=int)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args(arguments)
    rows = []
    with ProcessPoolExecutor(options.workers) as pool:
        for row in CAMPAIGNS[options.campaign](options.sets, pool):
            print(*row.values(), sep="  ", file=sys.stderr)
            rows.append(row)
    write_rows(options.output, tuple(rows[0]), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
