"""Write docs/uncertainty.md from the tables of benchmarks.in_plane and benchmarks.halves.

Run from the root of the checkout: python -m benchmarks.uncertainty_page
"""

from __future__ import annotations

import csv
from pathlib import Path

from benchmarks.page import markdown
from gonio.files import write_text

FOLDER = Path("docs/uncertainty")

HEAD = """# Intervals where data or model are poor

Two questions to the [uncertainties of a fit](fitting.md): do they hold where the data do not
determine every parameter, and do they hold on real surfaces, which no model fits? The tables are
made by

```sh
python -m benchmarks.in_plane -o docs/uncertainty/in_plane.csv
python -m benchmarks.halves --data FOLDER -o docs/uncertainty/halves.csv
python -m benchmarks.uncertainty_page
```
"""

IN_PLANE = """## One plane of incidence

Every elliptical model at four incidences and 36 viewing angles in their plane, with noise of 1 %
of the mean value that is stated. The width of the lobe across the plane and its amplitude exchange:
these two are not determined. `covered` is how often the 95 % interval of a parameter that is
determined contains the true value, in per cent; `range` is the 99 % range of that for correct
intervals.
"""

HALVES = """## Two halves of one real measurement

Paints of the Cornell collection and sintered PTFE of NIST, fitted with `ward_isotropic` and
`ward_duer`. Each set is split into halves by incidence (all ways) and at random (40 ways); the
difference of a parameter between the halves is compared with its stated uncertainty. `held` is the
share of differences within the 95 % interval, in per cent. `need` is the 95 % quantile of the
difference over the half width of that interval: 1 if intervals are as wide as they must be, below
0.5 if they are more than twice as wide, above 1 if they are too narrow. Only parameters that both
halves determine and establish are compared; `left out` counts the others.
"""


def in_plane() -> str:
    """The table of one plane."""
    rows = []
    for row in _read("in_plane.csv"):
        n = int(row["determined"])
        limits = (
            f"{100 * int(row['least']) / n:.1f} to {100 * int(row['most']) / n:.1f}" if n else ""
        )
        rows.append(
            (row["surface"], row["parameter"], row["runs"], row["determined"],
             row["covered_percent"], limits)
        )  # fmt: skip
    return markdown(
        ("surface", "parameter", "runs", "determined", "covered", "range"), "llrrrr", rows
    )


def halves() -> str:
    """The table of halves."""
    rows = [
        (row["set"], row["model"], row["halves"], row["compared"], row["left_out"],
         row["held_percent"], row["need"])
        for row in _read("halves.csv")
    ]  # fmt: skip
    head = ("set", "model", "halves", "compared", "left out", "held", "need")
    return markdown(head, "lllrrrr", rows)


def _read(name: str) -> list[dict[str, str]]:
    with (FOLDER / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def main() -> None:
    """Write the page."""
    text = "\n".join([HEAD, IN_PLANE, in_plane(), "", HALVES, halves()])
    write_text(Path("docs/uncertainty.md"), text + "\n")


if __name__ == "__main__":
    main()
