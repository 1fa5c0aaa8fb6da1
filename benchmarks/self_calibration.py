"""The slope errors of the dome found with the material: simulated rigs, a row for each session.

Run from the root of the checkout, in its environment:

    python -m benchmarks.self_calibration materials -o docs/calibration/self-calibration.csv
    python -m benchmarks.self_calibration transfer -o docs/calibration/dome-transfer.csv
    python -m benchmarks.self_calibration wrong -o docs/calibration/self-calibration-wrong.csv

Every rig is `modern12` with 104 x 104 pixels, with a dome, a camera, a lamp and a standard of its
own. `materials` fits Ward's materials with `--self-calibrate`. `transfer` makes a map of two metals
and reduces sessions of other materials on the same rig with it. `wrong` fits a wrong model. The
tables give chi2/dof, the class of the verdict, and for every parameter its error in stated
uncertainties (z) and in per cent.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import gonio
from benchmarks.tables import write_rows
from gonio import materials
from gonio.fitting.result import FitResult
from gonio.instrument import preset
from gonio.samples import BRDFSamples
from gonio.session import Session

PIXELS = 104
FIRST_RIG = 5000  # seeds of rigs that no test uses
METALS = ("rolled_aluminum", "rolled_brass")
MATERIALS = (
    "rolled_aluminum", "rolled_brass", "lightly_brushed_aluminum", "varnished_plywood",
    "white_ceramic_tile", "glossy_grey_paper", "latex_gloss_brushed_metal",
    "latex_semigloss_rolled_metal",
)  # fmt: skip
WRONG = ("ward_duer", "ward_gmd", "ggx", "phong", "ward_isotropic")
NAMES = ("rho_d", "rho_s", "alpha_x", "alpha_y")


def session(folder: str, name: str, rig: int, number: int) -> Session:
    """Raw frames of a material on a rig."""
    return gonio.simulate(
        name, output=Path(folder) / f"{name}-{number}.gonio", rig_seed=FIRST_RIG + rig,
        seed=100_000 + 100 * rig + number, threads=1, truth_images=False,
        instrument=preset("modern12").with_pixels(PIXELS),
    )  # fmt: skip


def samples(folder: str, name: str, rig: int, number: int, **words: Any) -> BRDFSamples:
    """Samples of a material on a rig."""
    return gonio.reduce(session(folder, name, rig, number), threads=1, **words)


def row(rig: int, name: str, result: FitResult) -> dict[str, Any]:
    """What a fit says beside the truth."""
    true: Mapping[str, float] = materials.get(name).parameters
    verdict = result.verdict
    cells: dict[str, Any] = {
        "rig": rig, "material": name, "model": result.model,
        "chi2/dof": f"{result.chi2 / result.dof:.4f}",
        "verdict": "" if verdict is None else verdict.kind,
    }  # fmt: skip
    for key in NAMES:
        estimate = result.parameters.get(key)
        known = estimate is not None and estimate.stderr is not None
        error = estimate.value - true[key] if known else None
        cells[f"z {key}"] = f"{error / estimate.stderr:.3f}" if known else ""
        cells[f"error {key} %"] = f"{100 * error / true[key]:.4f}" if known else ""
    return cells


def materials_of(rig: int, names: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of one rig, each session calibrated by itself."""
    rows = []
    for number, name in enumerate(names):
        with tempfile.TemporaryDirectory() as folder:
            measured = samples(folder, name, rig, number)
        fitted = gonio.fit(measured, "ward", self_calibrate=True, threads=1)
        rows.append(row(rig, name, fitted))
    return rows


def transfer_of(rig: int, names: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of one rig, all but two metals reduced with the map that these made."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        metals = [samples(folder, name, rig, k) for k, name in enumerate(METALS)]
        found = gonio.calibrate_dome(metals, "ward", threads=1)
        for number, name in enumerate(names, len(METALS)):
            if name not in METALS:
                measured = samples(folder, name, rig, number, dome=found.map)
                rows.append(row(rig, name, gonio.fit(measured, "ward", threads=1)))
    return rows


def wrong_of(rig: int, names: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of one rig, the first material fitted with every wrong model."""
    with tempfile.TemporaryDirectory() as folder:
        measured = samples(folder, names[0], rig, 0)
    return [
        row(rig, names[0], gonio.fit(measured, model, self_calibrate=True, threads=1))
        for model in WRONG
    ]


CAMPAIGNS = {"materials": materials_of, "transfer": transfer_of, "wrong": wrong_of}


def rows_of(
    campaign: str, rigs: int, names: Sequence[str], pool: ProcessPoolExecutor
) -> Iterator[dict[str, Any]]:
    """All rows in the order of the rigs."""
    for rows in pool.map(partial(CAMPAIGNS[campaign], names=names), range(rigs)):
        yield from rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a campaign and write its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", choices=CAMPAIGNS)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--materials", type=int, default=len(MATERIALS))
    parser.add_argument("--workers", type=int)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args(arguments)
    rows = []
    with ProcessPoolExecutor(options.workers) as pool:
        names = MATERIALS[: options.materials]
        for each in rows_of(options.campaign, options.rigs, names, pool):
            print(*each.values(), sep="  ", file=sys.stderr, flush=True)
            rows.append(each)
    write_rows(options.output, tuple(rows[0]), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
