"""Recover every material of the papers from raw frames and write the table.

Run from the root of the checkout, in its environment:

    python benchmarks/recovery.py ideal12 -o docs/recovery/ideal12.csv

Each material is simulated on the named instrument with photon and read noise, reduced and fitted
with its own model without any help; the table holds truth, recovered value, standard uncertainty,
relative error, and the error in standard uncertainties. For parameters in which f is linear it also
holds the error without the part by the white standard, whose true reflectance differs from its
certificate; no reduction can correct that. One material takes some ten seconds. `--mapping exact`
reduces by the law of reflection instead of eq. (3); `--materials a,b` selects materials.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import gonio
from benchmarks.tables import write_rows
from gonio.calibration.dome.pixel_map import MAPPINGS
from gonio.calibration.reflector import Mapping
from gonio.materials import get, names
from gonio.models import get as get_model
from gonio.session import read_truth

FIELDS = (
    "material", "parameter", "unit", "truth", "recovered", "stderr",
    "error_percent", "error_in_stderr", "error_but_standard_percent", "chi2_per_dof", "at_bound",
    "status",
)  # fmt: skip


def recover(
    material: str, instrument: str, seed: int, folder: Path, mapping: Mapping = "eq3"
) -> list[dict[str, object]]:
    """Simulate, reduce and fit one material; a row a parameter."""
    path = folder / material
    gonio.simulate(material, output=path, instrument=instrument, seed=seed)
    model = get_model(get(material).model)
    result = gonio.fit(gonio.reduce(path, mapping=mapping), model=model)
    known = read_truth(path)
    assert known is not None
    shutil.rmtree(path)
    rows = []
    for name, own in result.parameters.items():
        estimate = own.in_file_units()
        truth = model.parameter(name).to_file(get(material).parameters[name])
        error = estimate.value - truth
        # A standard that is brighter than certified makes all f too small.
        scale = known["standard_scale"] if model.parameter(name).linear else 1.0
        rows.append(
            {
                "material": material,
                "parameter": name,
                "unit": estimate.unit,
                "truth": f"{truth:.6g}",
                "recovered": f"{estimate.value:.7g}",
                "stderr": "" if estimate.stderr is None else f"{estimate.stderr:.3g}",
                "error_percent": f"{100 * error / truth:.4f}",
                "error_in_stderr": ""
                if estimate.stderr is None
                else f"{error / estimate.stderr:.2f}",
                "error_but_standard_percent": f"{100 * (estimate.value * scale / truth - 1):.4f}",
                "chi2_per_dof": f"{result.chi2 / result.dof:.4g}",
                "at_bound": estimate.at_bound or "",
                "status": result.status,
            }
        )
    return rows


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("instrument")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument(
        "--seed", type=int, default=1, help="of the first of all materials; they count up"
    )
    parser.add_argument("--materials", default=",".join(names()), help="comma-separated")
    parser.add_argument("--mapping", choices=MAPPINGS, default="eq3")
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for material in arguments.materials.split(","):
            get(material)  # an unknown name stops here, with a hint
            # A material has its seed whichever others are asked for.
            seed = arguments.seed + names().index(material)
            recovered = recover(
                material, arguments.instrument, seed, Path(folder), arguments.mapping
            )
            rows += recovered
            worst = max(abs(float(str(r["error_percent"]))) for r in recovered)
            print(f"{material}: worst {worst:.3f} %", file=sys.stderr)
    write_rows(arguments.output, FIELDS, rows, ends="\r\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
