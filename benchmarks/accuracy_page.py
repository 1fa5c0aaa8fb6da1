"""Write docs/accuracy.md from the tables that benchmarks/recovery.py made.

Run from the root of the checkout: python benchmarks/accuracy_page.py
"""

from __future__ import annotations

import csv
from pathlib import Path

from gonio.materials import get, names

DOCS = Path("docs")
TABLES = ("ideal12", "modern12", "lbl1992_exact", "lbl1992")

HEAD = """# Accuracy

How accurately does gonio recover parameters from raw frames? Every material of the papers was
simulated with photon and read noise, reduced, and fitted with its own model, without starting
values. The tables are made by

```sh
python benchmarks/recovery.py ideal12 -o docs/recovery/ideal12.csv
python benchmarks/recovery.py modern12 -o docs/recovery/modern12.csv
python benchmarks/recovery.py lbl1992 --mapping exact -o docs/recovery/lbl1992_exact.csv
python benchmarks/recovery.py lbl1992 -o docs/recovery/lbl1992.csv
python benchmarks/accuracy_page.py
```

The error is (recovered - true) in per cent of the true value. z is the same difference in stated
standard uncertainties, shared errors included (standard, lamp, mapping, dome slope, rest of
multi-bounce). Nobody who measures can know how far the white standard is from its certificate.
The last column therefore gives the error of rho and amplitudes without this part.
"""

NOTES = {
    "ideal12": (
        "The camera and the noise of `modern12`, without systematic effects. Two errors "
        "remain. Eq. (3) is good to (D/R)^3 on an ellipsoid; this is stated as an uncertainty "
        "and not corrected. The quotient of two noisy frames has a bias of 1e-5 of rho_d, "
        "which is not stated."
    ),
    "modern12": (
        "All effects, reduced by eq. (3). The standard differs from its certificate by half a "
        "per cent (one standard deviation), drawn anew for each material. Multiple reflection "
        "is corrected with a g known to 30 %. The remaining errors are the drift of the lamp, "
        "0.3 % between images, and the slope errors of the dome, which stretch the lobe. "
        "ks_over_kb of foam has the largest error: its lobe is a tenth of the signal."
    ),
    "lbl1992_exact": (
        "Ward's instrument as far as his paper describes it: a true sphere with D/R = 0.1, "
        "pixels of 2.25 deg, 8 bits, a lamp of 1 deg half-angle that drifts by 1 %, slope "
        "errors of 1 deg at the rim, a standard known to 2 %. Reduced by the law of "
        "reflection (`--mapping exact`)."
    ),
    "lbl1992": (
        "The same frames, reduced by eq. (3) as in the paper. On a sphere this shifts "
        "directions by up to 0.57 deg and stretches the lobe. The difference from the "
        "previous table is the cost of the approximation."
    ),
}


def summary(rows: list[dict[str, str]]) -> str:
    """One sentence on a table: the worst error and the coverage."""
    worst = max(rows, key=lambda row: abs(float(row["error_percent"])))
    errors = [abs(float(row["error_in_stderr"])) for row in rows if row["error_in_stderr"]]
    inside = sum(z <= 3 for z in errors)
    largest = max(rows, key=lambda row: abs(float(row["error_but_standard_percent"])))
    return (
        f"Worst: {worst['parameter']} of {worst['material']}, {worst['error_percent']} %; without "
        f"the standard's own error {largest['parameter']} of {largest['material']}, "
        f"{largest['error_but_standard_percent']} %. "
        f"{inside} of {len(errors)} parameters lie within 3 of their standard uncertainties."
    )


def table(rows: list[dict[str, str]]) -> str:
    """Markdown table, a row a parameter."""
    lines = [
        "| material | parameter | true | recovered | std. uncertainty | error, % | z "
        "| without standard, % |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        unit = f" [{row['unit']}]" if row["unit"] else ""
        lines.append(
            f"| {row['material']} | {row['parameter']}{unit} | {row['truth']} | "
            f"{float(row['recovered']):.6g} | {row['stderr'] or row['at_bound'] + ' bound'} | "
            f"{float(row['error_percent']):+.3f} | {row['error_in_stderr']} | "
            f"{float(row['error_but_standard_percent']):+.3f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Write the page."""
    parts = [HEAD]
    for name in TABLES:
        with (DOCS / "recovery" / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        ward = [row for row in rows if get(row["material"]).model == "ward"]
        others = [row for row in rows if row not in ward]
        assert {row["material"] for row in rows} == set(names())
        parts += [
            f"## {name}\n\n{NOTES[name]}\n",
            f"Ward's 28 materials. {summary(ward)}\n",
            table(ward) + "\n",
            f"Oren and Nayar's five materials. {summary(others)}\n",
            table(others) + "\n",
        ]
    (DOCS / "accuracy.md").write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
