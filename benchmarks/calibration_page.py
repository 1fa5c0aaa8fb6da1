"""Write docs/calibration.md from the tables of benchmarks.sbc and benchmarks.random_materials.

Run from the root of the checkout: python -m benchmarks.calibration_page
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

from benchmarks.page import markdown
from benchmarks.sbc import SMALLEST_P, failures
from benchmarks.sbc_sets import CASES, LIES
from gonio.files import write_text

FOLDER = Path("docs/calibration")
Row = dict[str, str]

HEAD = """# Calibration of uncertainties

Are the stated uncertainties as large as the errors? This page answers by simulation-based
calibration (Talts et al. 2018, arXiv:1804.06788): draw parameters from the prior, make a data set
with them, fit it, and repeat. If all is correct, the rank of the true value among independent
draws of its posterior is uniform, and a 95 % interval contains the true value in 95 % of the
sets. The tables are made by

```sh
python -m benchmarks.sbc --raw build/sbc.csv -o docs/calibration/sbc.csv
python -m benchmarks.sbc --raw build/sbc.csv -o docs/calibration/sbc.csv --case ward --lie double
python -m benchmarks.sbc --raw build/sbc.csv -o docs/calibration/sbc.csv --case ward --lie scale
python -m benchmarks.sbc --raw build/sbc.csv -o docs/calibration/sbc.csv --case ward --lie half
python -m benchmarks.random_materials -o docs/calibration
python -m benchmarks.calibration_page
```

`-n` is the number of sets of a case. An interrupted run continues where it stopped. The column
`sets` states their number in the tables below.

- **From samples**: 300 to 1000 directions over 4 to 7 incidences, half of them around the mirror
  direction. The noise is 1 to 20 %, drawn for each set, of the value of a surface in the middle
  of the prior. It must not depend on the true values: otherwise the stated uncertainties would
  reveal them, and the ranks would not be uniform.
- **From frames** (`_frames`): three incidences on `ideal12` with 128 x 128 px and 3 to 100 % of
  its light, simulated, reduced (`mapping="exact"`) and fitted.
- `ward_shared`: all values of a set share an error of scale, drawn with a standard deviation of 2
  %. The samples state it.
- The prior is flat between the bounds of the fitted model. These are the bounds of the model,
  except for alpha, 0.02 to 0.4 (from frames 0.06 to 0.4), and rho of `oren_nayar_frames`, 0.1 to
  1.

`p` is the p-value of chi-squared over 20 bins of the ranks. The other columns say how often, in
per cent, the intervals of 68.3 and 95 % contain the true value: first those of the posterior,
then those of least squares (`posterior=False`), where one is stated. A test fails if p is below
0.001, for the ranks or for the binomial distribution of the count.
"""

TOLD_WRONGLY = """## If the stated noise is wrong

These sets of `ward` state wrong uncertainties. Noise stated twice as large, and a common error of
scale that is not stated, must fail the tests, and both do.

Noise stated half as large passes, or nearly so. If the residuals are larger than stated, the fit
multiplies the independent uncertainties by the Birge ratio sqrt(chi2/dof) and warns. This
corrects noise that is understated by one factor everywhere. It does not correct shared errors, as
the error of scale shows: residuals contain no information about it.
"""

RANDOM = """## Materials drawn at random

The table shows the median and the 95th percentile of the error over the stated uncertainty of
least squares. They are 0.67 and 1.96 if errors are normal and as large as stated. Lobes are 0.02
to 0.4 wide, with amplitudes from 0.005, uniform in the logarithm. The noise is 1 to 5 % of f.
Directions are as above.
"""


def table(rows: list[Row], first: str, key: Callable[[Row], str]) -> str:
    """Markdown table, a row a parameter."""
    head = (first, "parameter", "sets", "p", "68 %", "95 %", "l.s. 68 %", "l.s. 95 %", "fails")
    lines = [
        (
            key(row),
            row["parameter"],
            row["sets"],
            row["rank_p"],
            *(row[f"{kind}_{level}"] for kind in ("posterior", "least_squares")
              for level in ("68", "95")),
            ", ".join(name.removesuffix("_p") for name in failures(row)).replace("_", " "),
        )
        for row in rows
    ]  # fmt: skip
    return markdown(head, "llrrrrrrl", lines)


def verdict(rows: list[Row]) -> str:
    """One sentence on the sets with correct statements."""
    bad = [f"{row['case']} {row['parameter']}" for row in rows if failures(row)]
    none = sum(int(row["without_interval"]) for row in rows)
    doubtful = sum(int(row["not_converged"]) for row in rows)
    text = f"{len(rows) - len(bad)} of {len(rows)} parameters pass every test at p > {SMALLEST_P:g}"
    text += f"; these do not: {', '.join(bad)}." if bad else "."
    return (
        f"{text} In {none} of {sum(int(r['sets']) for r in rows)} cases least squares states no "
        f"interval, because the data do not determine the parameter; in {doubtful} the fit or its "
        "posterior says that it has not converged. Their ranks are counted all the same."
    )


def random_part(lines: list[Row], failed: list[Row]) -> list[str]:
    """The table of random materials and the list of what failed."""
    head = ("model", "parameter", "materials", "median", "95 %", "largest",
            "not converged", "undetermined", "beyond 5")  # fmt: skip
    rows = [tuple(row.values()) for row in lines]
    parts = [RANDOM, markdown(head, "llrrrrrrr", rows) + "\n"]
    if not failed:
        return [*parts, "Nothing failed.\n"]
    listed = [
        (f"{r['model']} {r['material']}", r["parameter"], r["truth"], r["value"], r["stderr"],
         r["z"], r["reason"]) for r in failed
    ]  # fmt: skip
    return [
        *parts,
        "Every failure; what the fit says of it stands in "
        "`docs/calibration/random_failures.csv`.\n",
        markdown(
            ("material", "parameter", "true", "found", "stderr", "z", "why"), "llrrrrl", listed
        )
        + "\n",
    ]


def read(name: str) -> list[Row]:
    """A table of the folder."""
    with (FOLDER / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def page() -> str:
    """The page."""
    rows = read("sbc.csv")
    order = list(CASES)
    honest = sorted((r for r in rows if r["lie"] == "none"), key=lambda r: order.index(r["case"]))
    lies = [row for row in rows if row["lie"] != "none"]
    parts = [
        HEAD,
        "## Posteriors and intervals\n",
        verdict(honest) + "\n",
        table(honest, "case", lambda row: row["case"]) + "\n",
        TOLD_WRONGLY,
        table(lies, "states", lambda row: LIES[row["lie"]]) + "\n",  # type: ignore[index]
        *random_part(read("random_materials.csv"), read("random_failures.csv")),
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    write_text(FOLDER.with_suffix(".md"), page())
