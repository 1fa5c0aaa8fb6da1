"""Standard uncertainties of every loss against a pairs bootstrap: a table.

Run from the root of the checkout, in its environment:

    python -m benchmarks.losses -o docs/losses/bootstrap.csv

Samples are drawn with replacement and fitted again from the estimate on. The table gives the
relative standard uncertainty that a fit states, the standard deviation of the repeated fits, half
the width of their central 68 %, and the ratio of the first to the second. Real data are those of
the folder that `GONIO_TEST_DATA` names, else `shared/data` beside the checkout; without it the
simulated sets alone are run.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gonio import formats, models
from gonio.files import write_text
from gonio.fitting.minimum.find import find_minimum, reweighted_minimum
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.losses import CHI2, LOSSES
from gonio.fitting.uncertainty.at_minimum import uncertainties
from gonio.geometry import Directions, FloatArray
from gonio.samples import BRDFSamples

MODEL = "ward_isotropic"
DRAWS = 200
SEED = 20  # not that of the uncertainties themselves
THETA_I, THETA_R = 65, 70  # degrees: the reciprocal part of the tables of paints
REAL = {
    "garnet 650 nm": ("cornell/garnet_red.brdf", 650.0),
    "krylon 450 nm": ("cornell/krylon_blue.brdf", 450.0),
    "PTFE 532 nm": ("nist_ptfe/PTFE.data.csv", 532.0),
}
COLUMNS = ("data", "loss", "parameter", "value", "stated", "bootstrap", "68 %", "ratio")


def real(folder: Path) -> Iterator[tuple[str, BRDFSamples]]:
    """The measured sets, one wavelength of each."""
    for name, (path, wavelength) in REAL.items():
        samples = formats.read(folder / path)
        assert isinstance(samples, BRDFSamples)
        assert samples.wavelength_nm is not None
        d = samples.directions
        near = np.abs(samples.wavelength_nm - wavelength) < 0.5
        if path.startswith("cornell"):
            near &= np.degrees(d.theta_i) < THETA_I
            near &= np.degrees(d.theta_r) < THETA_R
        yield name, samples.select(np.flatnonzero(near), "benchmark")


def simulated() -> Iterator[tuple[str, BRDFSamples]]:
    """A lobe with 2 % noise, 5 % of whose samples are too large by a fifth to twice."""
    rng = np.random.default_rng(1)
    theta = np.radians(rng.uniform(0, 60, (2, 600)))
    phi = rng.uniform(0, 2 * np.pi, (2, 600))
    directions = Directions(theta[0], phi[0], theta[1], phi[1])
    f = models.get(MODEL)(directions, rho_d=0.2, rho_s=0.1, alpha=0.15)
    y = f * (1 + 0.02 * rng.standard_normal(600))
    yield "simulated, 2 % noise", BRDFSamples(directions, y)
    y = np.where(rng.random(600) < 0.05, y * rng.uniform(1.2, 2.0, 600), y)
    yield "the same, 5 % outliers", BRDFSamples(directions, y)


def bootstrap(minimum: Minimum, draws: int) -> FloatArray:
    """Parameters (draws, P) of fits to samples drawn with replacement."""
    problem, rng = minimum.problem, np.random.default_rng(SEED)
    points = []
    for _ in range(draws):
        drawn = problem.at(rng.integers(0, problem.n, problem.n))
        optimum = minimise(drawn, minimum.optimum.p, search=False)
        points.append(reweighted_minimum(drawn, optimum, search=False)[1].p)
    return np.array(points)


def rows(name: str, samples: BRDFSamples, draws: int) -> Iterator[tuple[str, ...]]:
    """Lines of the table for one set."""
    for loss in LOSSES:
        if loss == CHI2.name or (loss == "relative" and np.any(samples.value <= 0)):
            continue
        minimum = find_minimum(samples, models.get(MODEL), loss=loss)
        stated = np.sqrt(np.diag(uncertainties(minimum)[0].covariance))
        points = bootstrap(minimum, draws)
        scatter = np.std(points, axis=0, ddof=1)
        middle = np.diff(np.quantile(points, [0.1587, 0.8413], axis=0), axis=0)[0] / 2
        for j, q in enumerate(minimum.problem.parameters):
            value = minimum.optimum.p[j]
            numbers = (stated[j] / value, scatter[j] / value, middle[j] / value)
            yield (
                name, loss, q.name, f"{value:.4g}", *(f"{100 * x:.2g} %" for x in numbers),
                f"{stated[j] / scatter[j]:.2f}",
            )  # fmt: skip


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.losses", description=__doc__.split("\n")[0]
    )
    parser.add_argument("-o", "--output", type=Path, help="CSV file")
    parser.add_argument("--draws", type=int, default=DRAWS, help="repeated fits of each set")
    args = parser.parse_args()
    named = os.environ.get("GONIO_TEST_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    sets = [*simulated(), *(real(folder) if folder.is_dir() else ())]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for name, samples in sets:
        for row in rows(name, samples, args.draws):
            table.writerow(row)
            print(*(word.rjust(14) for word in row), flush=True)
    if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        write_text(args.output, text.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main())
