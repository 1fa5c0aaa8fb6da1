"""Tables for other programs, and what the person who signs a report states."""

import csv
import io
import json
import re

import numpy as np
import pytest

from gonio import cli
from gonio.errors import ConfigurationError
from gonio.fitting.fit import fit
from gonio.fitting.result import FitResult
from gonio.geometry import Directions
from gonio.models import get
from gonio.reporting import Inputs, page, statement
from gonio.reporting.tables import fit_table, latex_text, rounded
from gonio.samples import BRDFSamples


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Samples of a rough surface as CSV, and the fit to them."""
    place = tmp_path_factory.mktemp("tables")
    grid = np.meshgrid(np.radians([20, 40, 60]), np.radians(np.arange(-70, 71, 10)))
    theta_i, theta_r = (angle.ravel() for angle in grid)
    phi_r = np.where(theta_r < 0, 0.0, np.pi)
    directions = Directions(theta_i, np.zeros_like(theta_i), np.abs(theta_r), phi_r)
    value = get("oren_nayar")(directions, rho=0.6, sigma=0.5)
    noise = np.random.default_rng(1).normal(size=value.shape)
    samples = BRDFSamples(directions, value * (1 + 0.01 * noise), u_independent=0.01 * value)
    fit(samples, model="oren_nayar").save(place / "rough.json")
    lines = ["theta_i,phi_i,theta_r,phi_r,brdf,u_brdf"]
    columns = (*map(np.degrees, (theta_i, 0 * theta_i, np.abs(theta_r), phi_r)), samples.value,
               0.01 * value)  # fmt: skip
    lines += [",".join(f"{x:.17g}" for x in row) for row in zip(*columns, strict=True)]
    (place / "rough.csv").write_text("\n".join(lines) + "\n")
    return place


@pytest.fixture
def run(capsys):
    def words(*given):
        with pytest.raises(SystemExit) as left:
            cli.main([*map(str, given)])
        return left.value.code, *capsys.readouterr()

    return words


def read(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


# ---------------------------------------------------------------- tables


def test_the_csv_of_a_fit_holds_every_digit_of_its_file(run, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = run("report", folder / "rough.json", "--csv", "--coverage", "k=2")
    assert code == 0
    document = json.loads((folder / "rough.json").read_text())["parameters"]
    for row in read(out):
        known = document[row["parameter"]]
        assert float(row["value"]) == pytest.approx(known["value"], rel=1e-14)
        assert float(row["stderr"]) == pytest.approx(known["stderr"], rel=1e-14)
        assert float(row["expanded"]) == pytest.approx(2 * known["stderr"], rel=1e-14)
        assert row["unit"] == known["unit"]
    assert {row["parameter"] for row in read(out)} == {"rho", "sigma"}
    assert not list(tmp_path.iterdir())  # no page was asked for


def test_the_latex_of_a_fit_rounds_to_its_uncertainty(run, folder):
    code, out, _ = run("report", folder / "rough.json", "--latex")
    assert code == 0
    assert out.startswith("\\begin{tabular}{lrrrr}\n\\hline\nparameter & unit & value & u & 95 \\%")
    assert out.endswith("\\hline\n\\end{tabular}\n")
    table = fit_table(FitResult.load(folder / "rough.json"))
    sigma = next(row for row in table.shown if row[0] == "sigma")
    assert len(re.sub(r"^[0.]*", "", sigma[3]).replace(".", "")) == 2  # two digits of u
    assert len(sigma[2].partition(".")[2]) == len(sigma[3].partition(".")[2])
    assert f"sigma & deg & {sigma[2]} & {sigma[3]} & " in out


def test_an_unknown_uncertainty_is_unknown_and_not_zero(folder):
    from dataclasses import replace

    known = FitResult.load(folder / "rough.json")
    bare = {n: replace(e, stderr=None, interval_68=None, interval_95=None)
            for n, e in known.parameters.items()}  # fmt: skip
    table = fit_table(replace(known, parameters=bare), coverage=2.0)
    assert [row["stderr"] for row in read(table.csv())] == ["", ""]
    assert [row["expanded"] for row in read(table.csv())] == ["", ""]
    assert all(row[3:] == ["unknown"] * 3 for row in table.shown)


def test_names_are_escaped_for_latex():
    assert latex_text("alpha_x & 5 %") == r"alpha\_x \& 5 \%"
    assert latex_text("a\\b{c}^~#$") == (
        r"a\textbackslash{}b\{c\}\textasciicircum{}\textasciitilde{}\#\$"
    )
    assert latex_text("-3.2") == "$-3.2$"
    assert latex_text("4.1e-05") == r"$4.1 \times 10^{-5}$"


def test_an_uncertainty_that_rounds_up_takes_a_digit_away():
    assert rounded(1.23456, 0.0996) == "1.23"  # u is 0.10
    assert rounded(1.23456, 0.0994) == "1.235"  # u is 0.099


def test_the_budget_as_csv_and_latex(run, folder):
    code, out, _ = run("budget", folder / "rough.csv", "--csv")
    rows = read(out)
    assert code == 0
    assert [row["source"] for row in rows] == ["independent", "combined", "expanded, k = 2"]
    assert float(rows[0]["relative_u_median"]) == pytest.approx(0.01, rel=0.05)
    assert float(rows[0]["share_of_variance"]) == pytest.approx(1.0)
    code, out, _ = run("budget", folder / "rough.csv", "--latex")
    assert (code, "median, \\% & 5 \\%, \\% & 95 \\%, \\% & share, \\% \\\\" in out) == (0, True)


def test_the_comparison_as_csv_and_latex(run, folder):
    words = ("compare", folder / "rough.csv", "--models", "lambert,oren_nayar")
    # 1 where a model does not meet its own checks, which lambert need not here.
    code, out, _ = run(*words, "--csv")
    rows = read(out)
    assert code in (0, 1)
    assert [row["model"] for row in rows] == ["oren_nayar", "lambert"]  # the best first
    assert float(rows[0]["loo_difference"]) == 0
    assert float(rows[1]["loo_difference"]) < 0
    code, out, _ = run(*words, "--latex")
    assert "oren\\_nayar & fits & 2 & " in out
    assert out.endswith("\\end{tabular}\n")


@pytest.mark.parametrize(
    "words",
    [
        ("report", "rough.json", "--csv", "--latex"),
        ("budget", "rough.csv", "--json", "--csv"),
        ("compare", "rough.csv", "--models", "lambert,oren_nayar", "--json", "--latex"),
    ],
)
def test_two_documents_on_one_stdout_are_refused(run, folder, monkeypatch, words):
    monkeypatch.chdir(folder)
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert "--json, --csv and --latex exclude each other; give one of them." in err


# ---------------------------------------------------------------- what a report states


def test_what_is_stated_stands_in_the_page(folder):
    known = Inputs(FitResult.load(folder / "rough.json"), "rough.json")
    days, serials = ["2026-03-30", "2026-03-31"], ["lamp=L-17", "white tile=9=a"]
    stated = statement("A. Müller <b>", days, "2026-04-02", serials, "k=2", 40)
    text = page(known, stated)
    for line in ("A. Müller &lt;b&gt;", "2026-03-30, 2026-03-31", "<dd>2026-04-02</dd>",
                 "<dt>Serial number, lamp</dt><dd>L-17</dd>",
                 "<dt>Serial number, white tile</dt><dd>9=a</dd>", "U (k = 2)",
                 "factor k = 2; the uncertainties have 40 effective degrees of freedom",
                 "expanded, k = 2"):  # fmt: skip
        assert line in text, line
    assert "A. Müller <b>" not in text
    u = known.fit.parameters["rho"].stderr
    assert rounded(2 * u, u) in text


def test_nothing_is_said_that_was_not_stated(folder):
    known = Inputs(FitResult.load(folder / "rough.json"), "rough.json")
    text = page(known).partition("<script")[0]
    for word in ("Operator", "Measured on", "Issued on", "Serial number", "U (k", "expanded"):
        assert word not in text


def test_a_probability_gives_its_factor():
    # GUM, table G.2: t for 95 % and 10 degrees of freedom is 2.23, 1.96 for infinitely many.
    assert statement(coverage="95%", dof=10).coverage == pytest.approx(2.228, abs=1e-3)
    assert statement(coverage="95 %").coverage == pytest.approx(1.960, abs=1e-3)
    assert statement(coverage="2").coverage == statement(coverage="k = 2").coverage == 2
    assert "95 % under Student's distribution with 10 effective degrees of freedom" in (
        statement(coverage="95%", dof=10).coverage_sentence()
    )


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"coverage": "two"}, r"the coverage 'two' is neither a factor such as k=2 \(above 0, up"),
        ({"coverage": "0"}, "the coverage '0' is neither a factor"),
        ({"coverage": "95"}, "the coverage '95' is neither .* nor a probability such as 95%"),
        ({"coverage": "k=95%"}, "the coverage 'k=95%' is neither"),
        ({"coverage": "100%"}, "50% to below 100%"),
        ({"dof": 0.5}, "0.5 effective degrees of freedom: the number must be at least 1"),
        ({"dates": ["31.3.2026"]}, "'31.3.2026' is not a day; write it as YYYY-MM-DD"),
        ({"issued": "today"}, "'today' is not a day"),
        ({"serials": ["lamp"]}, "'lamp' is not NAME=NUMBER; write for instance lamp=AB-1234"),
    ],
)
def test_statements_that_cannot_be_read_are_refused(given, match):
    with pytest.raises(ConfigurationError, match=match):
        statement(**given)


def test_the_command_refuses_before_it_reads(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fit.json").write_text("not a fit")
    code, _, err = run("report", "fit.json", "--date", "yesterday")
    assert (code, "'yesterday' is not a day" in err) == (2, True)
