"""Whether two halves of one real data set agree within their stated uncertainties.

Run from the root of the checkout, in its environment, with the folder of real measurements:

    python -m benchmarks.halves --data FOLDER -o docs/uncertainty/halves.csv

No model fits these surfaces within the noise, and nobody knows their true parameters. But a second
measurement of the same kind must give the same parameters within the stated uncertainties, and two
halves of one measurement are two such measurements. Every set is split into all distinct halves by
incidence and into random halves; both are fitted, and the difference D of each parameter is
compared with u^2 = u1^2 + u2^2 by Student's t with nu = u^4 / (u1^4 / nu1 + u2^4 / nu2).

The table counts the parameters that both fits call determined and established:

- `held_percent`: share of |D| <= t u; 95 if uncertainties are right;
- `need`: the 95 % quantile of |D| / (t u); 1 if intervals are as wide as they must be, below 0.5
  if they are more than twice as wide, above 1 if they are too narrow.

Sets: two paints of the Cornell collection (garnet at 600 to 700 nm, krylon at 440 to 480 nm) up to
65 degrees of incidence and 70 degrees of viewing, and a plaque of sintered PTFE of NIST at four
wavelengths. The folder holds `cornell/garnet_red.brdf`, `cornell/krylon_blue.brdf` and
`nist_ptfe/PTFE.data.csv`. 40 random halves take half an hour on one core.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import gonio
from benchmarks.tables import write_rows
from gonio import formats
from gonio.fitting.result import Estimate, FitResult
from gonio.samples import BRDFSamples

MODELS = ("ward_isotropic", "ward_duer")
PAINTS = {
    "garnet": ("cornell/garnet_red.brdf", (600.0, 650.0, 700.0)),
    "krylon": ("cornell/krylon_blue.brdf", (440.0, 450.0, 460.0, 480.0)),
}
PTFE = "nist_ptfe/PTFE.data.csv"
MOST_DEG = (65.0, 70.0)  # of theta_i and theta_r on the paints
RANDOM = 40
FIELDS = ("set", "model", "halves", "compared", "left_out", "held_percent", "need")


class Difference(NamedTuple):
    """A parameter of two halves."""

    dataset: str
    model: str
    kind: str
    parameter: str
    ratio: float | None  # |D| / (t u); None where a half does not establish it


def sets(folder: Path) -> dict[str, BRDFSamples]:
    """The data sets by name."""
    found = {}
    for name, (file, wavelengths) in PAINTS.items():
        samples = formats.read(folder / file)
        d = samples.directions
        near = (np.degrees(d.theta_i) < MOST_DEG[0]) & (np.degrees(d.theta_r) < MOST_DEG[1])
        for w in wavelengths:
            found[f"{name} {w:.0f} nm"] = _select(samples, near, w)
    samples = formats.read(folder / PTFE)
    assert samples.wavelength_nm is not None
    for w in np.unique(samples.wavelength_nm):
        found[f"PTFE {w:.0f} nm"] = _select(samples, np.ones(len(samples), np.bool_), float(w))
    return found


def _select(samples: BRDFSamples, where: NDArray[np.bool_], wavelength: float) -> BRDFSamples:
    assert samples.wavelength_nm is not None
    one = where & (np.abs(samples.wavelength_nm - wavelength) < 0.5)
    return samples.select(np.flatnonzero(one), f"{wavelength:.0f} nm")


def halves(samples: BRDFSamples, n_random: int) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Every distinct choice of half of the incidences, then random halves of the samples."""
    theta_i = np.round(np.degrees(samples.directions.theta_i))
    levels = np.unique(theta_i)
    for chosen in itertools.combinations(range(1, len(levels)), len(levels) // 2 - 1):
        yield "incidence", np.isin(theta_i, levels[[0, *chosen]])
    rng = np.random.default_rng(0)
    for _ in range(n_random):
        first = np.zeros(len(samples), np.bool_)
        first[rng.permutation(len(samples))[: len(samples) // 2]] = True
        yield "random", first


def compared(
    dataset: str, model: str, kind: str, samples: BRDFSamples, first: NDArray[np.bool_]
) -> list[Difference]:
    """The parameters of two halves against each other."""
    fits = [
        gonio.fit(samples.select(np.flatnonzero(half), "half"), model=model, threads=1)
        for half in (first, ~first)
    ]
    return [
        Difference(dataset, model, kind, name, _ratio(*(fit.parameters[name] for fit in fits)))
        for name in fits[0].parameters
        if not any(_at_bound(fit, name) for fit in fits)
    ]


def _at_bound(fit: FitResult, name: str) -> bool:
    return fit.parameters[name].at_bound is not None


def _ratio(a: Estimate, b: Estimate) -> float | None:
    if a.stderr is None or b.stderr is None or False in (a.established, b.established):
        return None
    u2 = a.stderr**2 + b.stderr**2
    part = sum(e.stderr**4 / max(e.dof, 1.0) for e in (a, b) if e.dof is not None and e.stderr)
    dof = max(u2**2 / part, 1.0) if part > 0 else np.inf
    return float(abs(a.value - b.value) / (stats.t.ppf(0.975, dof) * np.sqrt(u2)))


def table(found: list[Difference]) -> list[dict[str, object]]:
    """A row for each set, model and kind of halves, and for all together."""
    keys = list(dict.fromkeys((d.dataset, d.model, d.kind) for d in found))
    groups = [(k, [d for d in found if (d.dataset, d.model, d.kind) == k]) for k in keys]
    for dataset in dict.fromkeys(d.dataset for d in found):
        groups.append(((dataset, "both", "all"), [d for d in found if d.dataset == dataset]))
    for kind in ("incidence", "random"):
        groups.append((("all", "both", kind), [d for d in found if d.kind == kind]))
    groups.append((("all", "both", "all"), found))
    rows: list[dict[str, object]] = []
    for (dataset, model, kind), own in groups:
        ratios = np.array([d.ratio for d in own if d.ratio is not None])
        rows.append(
            {
                "set": dataset,
                "model": model,
                "halves": kind,
                "compared": len(ratios),
                "left_out": len(own) - len(ratios),
                "held_percent": f"{100 * np.mean(ratios <= 1):.1f}" if len(ratios) else "",
                "need": f"{np.quantile(ratios, 0.95):.2f}" if len(ratios) else "",
            }
        )
    return rows


def main() -> int:
    """Run the campaign and write its table; it grows set by set."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    named = os.environ.get("GONIO_TEST_DATA")
    parser.add_argument("--data", type=Path, default=named, required=named is None, help="folder")
    parser.add_argument("--random", type=int, default=RANDOM, help="random halves of each set")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    found: list[Difference] = []
    with ProcessPoolExecutor(options.processes) as pool:
        for name, samples in sets(options.data).items():
            jobs = [
                pool.submit(compared, name, model, kind, samples, first)
                for model in MODELS
                for kind, first in halves(samples, options.random)
            ]
            found += [difference for job in jobs for difference in job.result()]
            write_rows(options.output, FIELDS, table(found))
            print(name, file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
