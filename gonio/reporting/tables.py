r"""Tables of results: CSV with all digits, LaTeX with the significant ones."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.fitting.result import Estimate, FitResult

if TYPE_CHECKING:
    from gonio.fitting.comparison.records import Comparison

_ESCAPED = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "_": r"\_", "&": r"\&", "%": r"\%",
    "#": r"\#", "$": r"\$", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "°": r"$^\circ$", "±": r"$\pm$", "²": "$^2$", "χ": r"$\chi$", "−": "$-$",
}  # fmt: skip
Cell = str | float | int | None


@dataclass(frozen=True)
class Table:
    """Columns with a name for programs and a heading for readers.

    Parameters
    ----------
    names : sequence of str
        Of the columns of a CSV, the unit at the end.
    heads : sequence of str
        Of the columns of a LaTeX table, plain text.
    rows : sequence of sequence
        Numbers or texts; None is unknown.
    shown : sequence of sequence of str
        The same cells as text for readers, with the significant digits.
    """

    names: Sequence[str]
    heads: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    shown: Sequence[Sequence[str]]

    def csv(self) -> str:
        """The table as CSV: a line of names, then numbers with 17 digits, unknown ones empty."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.names)
        for row in self.rows:
            writer.writerow([_exact(cell) for cell in row])
        return text.getvalue()

    def latex(self) -> str:
        """The table as a tabular of plain LaTeX, the first column to the left."""
        lines = [r"\begin{tabular}{l" + "r" * (len(self.heads) - 1) + "}", r"\hline"]
        lines += [" & ".join(map(latex_text, self.heads)) + r" \\", r"\hline"]
        lines += [" & ".join(map(latex_text, row)) + r" \\" for row in self.shown]
        return "\n".join([*lines, r"\hline", r"\end{tabular}"]) + "\n"


def latex_text(text: str) -> str:
    r"""Text that LaTeX prints as it stands; a number with a sign or an exponent in its notation.

    Examples
    --------
    >>> print(latex_text("alpha_x"), latex_text("-1.2e-07"), latex_text("5 %"))
    alpha\_x $-1.2 \times 10^{-7}$ 5 \%
    """
    try:
        float(text)
    except ValueError:
        return "".join(_ESCAPED.get(letter, letter) for letter in text)
    mantissa, sign, exponent = text.partition("e")
    if sign:
        return rf"${mantissa} \times 10^{{{int(exponent)}}}$"
    return f"${text}$" if text[0] in "+-" else text


def _exact(cell: Cell) -> str:
    if cell is None:
        return ""
    return f"{cell:.17g}" if isinstance(cell, float) else str(cell)


def rounded(value: float, u: float | None) -> str:
    """A value with the digits of two digits of its uncertainty; six digits without one.

    Examples
    --------
    >>> rounded(0.100704, 0.00056), rounded(0.1, None), rounded(1234.5, 32.0)
    ('0.10070', '0.1', '1234')
    """
    if not u or not np.isfinite(u):
        return f"{value:.6g}"
    digits = max(0, 1 - int(np.floor(np.log10(float(f"{u:.1e}")))))
    return f"{value:.{digits}f}" if digits <= 12 else f"{value:.6g}"


def fit_table(fit: FitResult, coverage: float | None = None) -> Table:
    """Value, standard uncertainty and 95 % interval of every parameter, degrees for angles.

    Parameters
    ----------
    fit : FitResult
    coverage : float, optional
        Coverage factor k; adds the expanded uncertainty U = k u.
    """
    names = ["parameter", "unit", "value", "stderr", "low_95", "high_95"]
    heads = ["parameter", "unit", "value", "u", "95 % interval"]
    if coverage is not None:
        names.append("expanded")
        heads.append(f"U (k = {coverage:.4g})")
    rows: list[list[Cell]] = []
    shown: list[list[str]] = []
    for name, fitted in fit.parameters.items():
        e = fitted.in_file_units()
        low, high = e.interval_95 or (None, None)
        expanded = [] if coverage is None else [e.stderr and coverage * e.stderr]
        rows.append([name, e.unit, e.value, e.stderr, low, high, *expanded])
        shown.append(
            [name, e.unit, rounded(e.value, e.stderr), _size(e.stderr, e.stderr), _interval(e),
             *(_size(u, e.stderr) for u in expanded)]
        )  # fmt: skip
    return Table(names, heads, rows, shown)


def _size(u: float | None, unit: float | None) -> str:
    return "unknown" if u is None else rounded(u, unit)


def _interval(e: Estimate) -> str:
    if e.interval_95 is None:
        return "unknown"
    return " .. ".join(rounded(end, e.stderr) for end in e.interval_95)


def budget_table(report: dict[str, Any]) -> Table:
    """The table of `gonio budget`; relative uncertainties, in LaTeX in per cent.

    Parameters
    ----------
    report : dict
        What `Budget.describe` gives.
    """
    one = bool(report["at"])
    keys = ("median",) if one else ("median", "p5", "p95")
    columns = ["relative_u"] if one else ["relative_u_median", "relative_u_p5", "relative_u_p95"]
    names = ["source", "type", "shared_by", "acts", *columns, "share_of_variance"]
    heads = ["source", "type", "shared by", "acts"]
    heads += ["u/f, %"] if one else ["median, %", "5 %, %", "95 %, %"]
    heads += ["share, %"]
    rows: list[list[Cell]] = []
    for row in report["sources"]:
        values = [row["relative"] and row["relative"][key] for key in keys]
        labels = [row["name"], row["kind"], row["shared_by"], row["acts"]]
        rows.append([*labels, *values, row["share_of_variance"]])
    k = report["coverage_factor"]
    for name, key in (("combined", "combined"), (f"expanded, k = {k:g}", "expanded")):
        values = [report[key] and report[key][column] for column in keys]
        rows.append([name, "", "", "", *values, None])
    shown = [[*map(str, row[:4]), *map(_percent, row[4:])] for row in rows]
    for row in shown[-2:]:
        row[-1] = ""
    return Table(names, heads, rows, shown)


def _percent(x: Cell) -> str:
    return "unknown" if x is None else f"{100 * float(x):.3g}"


def comparison_table(comparison: Comparison) -> Table:
    """The table of `gonio compare`, the best model first."""
    names = ["model", "verdict", "status", "n_parameters", "chi2", "dof"]
    names += [f"{score}_{part}" for score in ("held_out", "loo")
              for part in ("difference", "stderr")]  # fmt: skip
    names += ["log_evidence", "log_evidence_stderr"]
    heads = ["model", "verdict", "P", "chi2/dof", "held-out", "±", "LOO", "±", "log Z"]
    rows: list[list[Cell]] = []
    shown: list[list[str]] = []
    for entry in comparison.entries:
        scores: list[Cell] = []
        texts: list[str] = []
        for score in (entry.held_out, entry.loo):
            pair = (None, None) if score is None else (score.difference, score.difference_stderr)
            scores += pair
            texts += ["unknown", ""] if score is None else [
                rounded(score.difference, score.difference_stderr),
                rounded(score.difference_stderr, score.difference_stderr),
            ]  # fmt: skip
        z, u = entry.log_evidence, entry.log_evidence_stderr
        verdict = "unknown" if entry.verdict is None else entry.verdict.kind
        rows.append([entry.model, verdict, entry.status, entry.n_parameters, entry.chi2, entry.dof,
                     *scores, z, u])  # fmt: skip
        words = verdict.replace("_", " ")
        shown.append([entry.model, words, str(entry.n_parameters), f"{entry.chi2 / entry.dof:.3g}",
                      *texts, "unknown" if z is None else rounded(z, u)])  # fmt: skip
    return Table(names, heads, rows, shown)
