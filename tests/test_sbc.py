"""Intervals and posteriors are calibrated, and a noise that is told wrongly is found out.

A short form of `python -m benchmarks.sbc`, whose tables stand in docs/calibration.md: a hundred
sets, of Ward's isotropic model.
"""

import csv
import importlib
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
SETS = 100
CASE = "ward_isotropic"


@pytest.fixture(scope="module")
def sbc():
    """The campaign, which is not installed with the package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        yield importlib.import_module("benchmarks.sbc")


def lines(sbc, lie, sets=SETS):
    """The summary of some sets."""
    rows = [row for found in sbc.campaign([CASE], lie, range(sets), seed=3) for row in found]
    return sbc.summarised(rows)


def test_ranks_are_uniform_and_intervals_hold(sbc):
    for line in lines(sbc, "none"):
        assert line["sets"] == SETS
        assert sbc.failures(line) == [], line
        # 100 sets: 68 % is known to 4.7 %, 95 % to 2.2 %.
        assert abs(float(line["posterior_68"]) - 68.3) < 4 * 4.7
        assert float(line["least_squares_95"]) > 95 - 4 * 2.2


def test_noise_stated_twice_as_large_is_detected(sbc):
    for line in lines(sbc, "double", 40):
        assert {"rank_p", "posterior_68_p"} & set(sbc.failures(line)), line
        assert float(line["posterior_68"]) > 82  # as 95 % of normal errors would


def test_an_error_of_scale_that_is_not_stated_is_detected(sbc):
    found = {line["parameter"]: line for line in lines(sbc, "scale", 40)}
    # It moves all of f alike: the reflectance that is known best tells most.
    assert "posterior_95_p" in sbc.failures(found["rho_d"])
    assert float(found["rho_d"]["posterior_95"]) < 75


def test_a_rank_is_uniform_where_the_truth_is_one_of_the_draws(sbc):
    rng = np.random.default_rng(0)
    ranks = [sbc.rank(a[0], a[1:], rng) for a in rng.random((20_000, 1 + sbc.DRAWS))]
    assert min(ranks) == 0
    assert max(ranks) == sbc.DRAWS
    assert abs(np.mean(ranks) - sbc.DRAWS / 2) < 1  # 0.2 is one standard deviation
    # All draws on a bound, the truth too: any rank.
    tied = [sbc.rank(0.0, np.zeros(sbc.DRAWS), rng) for _ in range(2000)]
    assert np.std(tied) == pytest.approx(100 / np.sqrt(12), rel=0.05)


def test_an_interrupted_run_is_continued(sbc, tmp_path):
    path = tmp_path / "raw.csv"
    row = dict.fromkeys(sbc.RAW, "1") | {"case": CASE, "lie": "none"}
    sbc.appended(path, [[row | {"set": 0}], [row | {"set": 1}]])
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{CASE},none,2,al")  # killed within a line
    assert [r["set"] for r in sbc.read(path)] == ["0", "1"]
    sbc.appended(path, [[row | {"set": 2}]])
    assert [r["set"] for r in sbc.read(path)] == ["0", "1", "2"]


def test_the_page_is_by_this_program(sbc, monkeypatch):
    monkeypatch.chdir(ROOT)
    page = importlib.import_module("benchmarks.calibration_page")
    assert (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8") == page.page()


def test_the_tables_hold_what_the_page_says(sbc):
    """Every case that tells the truth passes, and those that must fail do."""
    with (ROOT / "docs/calibration/sbc.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    failed = {
        lie: [row["parameter"] for row in rows if row["lie"] == lie and sbc.failures(row)]
        for lie in ("none", "double", "scale")
    }
    assert failed["none"] == []
    assert failed["double"] == ["rho_d", "rho_s", "alpha_x", "alpha_y"]
    assert {"rho_d", "rho_s"} <= set(failed["scale"])
