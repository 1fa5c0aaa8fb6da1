"""One file is one source of error, or one question to a session: added and seen everywhere.

A folder with one more file stands beside the package's own, and the search looks into both.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from virtual import small

import gonio
from gonio import cli
from gonio.calibration import effects, faults
from gonio.calibration.effects.base import TermRecord
from gonio.calibration.faults.session import check_session
from gonio.instrument import Instrument
from gonio.metadata import Plan
from gonio.planning.result import DesignResult
from gonio.samples import BRDFSamples
from gonio.session import Session

EFFECT = '''"""Light that the lens scatters."""
from gonio.calibration.effects.base import Effect, StatedQuantity, TermRecord, Unknown

FLARE = TermRecord("flare", "light that the lens scatters", evaluation="A", averages=True)

EFFECT = Effect(
    key="lens_flare",
    order=200,
    title="flare of the lens",
    text="The lens scatters light over the frame.",
    records=(FLARE,),
    terms=lambda measured: [FLARE.shared(0.25)],
    unknown=(Unknown("flare at another f-stop", "lens.f_stop", lambda metadata, pixel_map: True),),
    quantities=(StatedQuantity("field of the lens that flares", "lens.field_deg", "°"),),
    notes=lambda metadata: ("flare: 25 % assumed",),
)
'''
QUESTION = '''"""Is the session long enough?"""
from gonio.calibration.faults.base import Finding, Question


def ask(evidence):
    text = f"{len(evidence.images)} images are few."
    yield Finding("few_images", "warning", text)


QUESTION = Question(
    key="long_enough",
    order=200,
    asks="Is the session long enough?",
    compares="the number of images with a wish",
    codes=("few_images",),
    ask=ask,
)
'''
PLAN = Plan(theta_i_deg=(10.0, 40.0), rotations_deg=(0.0,), exposures_s=(1e-3, 16e-3))


@pytest.fixture(scope="module")
def one_more(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """One more source of error and one more question, each a file and nothing else."""
    folder = tmp_path_factory.mktemp("more")
    added = {effects: ("lens_flare", EFFECT), faults: ("long_enough", QUESTION)}
    with pytest.MonkeyPatch.context() as patch:
        for package, (name, text) in added.items():
            own = folder / package.__name__
            own.mkdir()
            (own / f"{name}.py").write_text(text, encoding="utf-8")
            patch.setattr(package, "__path__", [*package.__path__, str(own)])
        effects.all_effects.cache_clear()
        faults.all_questions.cache_clear()
        yield
    for package, (name, _) in added.items():
        del sys.modules[f"{package.__name__}.{name}"]
        delattr(package, name)
    effects.all_effects.cache_clear()
    faults.all_questions.cache_clear()


@pytest.fixture(scope="module")
def folder(one_more: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session that was recorded and reduced."""
    folder = tmp_path_factory.mktemp("work")
    session = gonio.simulate(
        model="lambert", output=folder / "s.gonio", instrument=small(n=52), plan=PLAN, seed=1
    )
    gonio.reduce(session).save(folder / "s.nc")
    return folder


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """What a command prints that ends well."""

    def words(*given: object) -> str:
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main([str(word) for word in given])
        out, err = capsys.readouterr()
        assert not left.value.code, err
        return out

    return words


def test_an_effect_acts_on_samples_and_stands_in_their_history(folder: Path) -> None:
    samples = BRDFSamples.load(folder / "s.nc")
    flare = samples.shared[-1]
    assert (flare.name, flare.effect, flare.relative) == ("flare", "lens_flare", 0.25)
    assert samples.metadata["unknown"][-1] == "flare at another f-stop (lens.f_stop)"
    assert "flare: 25 % assumed" in samples.history
    assert "unknown, not included: flare at another f-stop (lens.f_stop)" in samples.history


def test_an_effect_has_a_row_in_the_budget(folder: Path, run: Callable[..., str]) -> None:
    report = json.loads(run("budget", folder / "s.nc", "--json"))
    row = next(row for row in report["sources"] if row["effect"] == "lens_flare")
    assert (row["name"], row["kind"], row["shared_by"]) == ("flare", "A", "all")
    assert row["relative"]["median"] == pytest.approx(0.25)
    text = run("budget", folder / "s.nc")
    assert re.search(r"^flare +A +all +factor +25 +25 +25", text, re.MULTILINE)
    assert "UNKNOWN, not counted: flare at another f-stop (lens.f_stop)." in text


def test_an_effect_has_its_rows_in_the_report(folder: Path, run: Callable[..., str]) -> None:
    run("fit", folder / "s.gonio", "--model", "lambert", "-o", folder / "fit.json")
    run("report", folder / "fit.json", "-o", folder / "report.html")
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "light that the lens scatters" in page
    assert "field of the lens that flares" in page
    assert "flare at another f-stop (lens.f_stop): " in page


def test_an_effect_and_a_question_have_their_rows_in_the_manual(
    one_more: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "docs" / "_ext"))
    import calibration_pages as pages

    row = "| flare of the lens | The lens scatters light over the frame. | `lens.field_deg` | "
    assert f"{row}`lens.f_stop` |" in pages.effects_table()
    row = "| flare | flare of the lens | A | yes | the rig | light that the lens scatters |"
    assert row in pages.terms_table()
    row = "| Is the session long enough? | the number of images with a wish | `few_images` |"
    assert row in pages.questions_table()


def test_a_question_is_asked_of_every_session(folder: Path) -> None:
    samples = BRDFSamples.load(folder / "s.nc")
    assert samples.metadata["findings"] == [
        {"code": "few_images", "severity": "warning", "text": "6 images are few."}
    ]
    assert samples.history[-1] == "warning: 6 images are few."
    found = check_session(Session.open(folder / "s.gonio"))
    assert [finding.code for finding in found] == ["few_images"]


def rig() -> Instrument:
    """An instrument of few pixels whose lamp drifts in a dome with slope errors."""
    return small("modern12", 52).model_copy(update={"rays_per_pixel": 8})


def by_source(result: DesignResult) -> dict[str, float]:
    """Standard uncertainty of rho by source."""
    return {name: float(u[0]) for name, u in result.expected.components.items()}


def test_planning_takes_an_effect_for_what_its_record_says(one_more: None) -> None:
    result = gonio.design("lambert", {"rho": 0.5}, instrument=rig(), budget=12)
    # 25 % of rho for one take: it averages, so that a plan takes standard and background often.
    assert result.plan.repeats > 1
    assert by_source(result)["flare"] > 0
    assert result.document()["parameters"][0]["largest_source"] == "flare"


def test_planning_does_not_know_terms_by_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    def planned() -> DesignResult:
        return gonio.design("lambert", {"rho": 0.5}, instrument=rig(), budget=12, verify=2)

    expected = planned()
    shared = TermRecord.shared

    def renamed(record: TermRecord, *size: float, name: str | None = None, **more: object):
        return shared(record, *size, name=f"new name of {name or record.name}", **more)

    monkeypatch.setattr(TermRecord, "shared", renamed)
    found = planned()
    names = [f"new name of {name}" for name in by_source(expected) if name != "independent"]
    assert list(by_source(found)) == ["independent", *names]
    assert list(by_source(found).values()) == list(by_source(expected).values())
    assert found.plan == expected.plan
    assert found.verification == expected.verification
