"""Reports: complete, escaped, without a network, true to the fit; and clicked through once."""

import base64
import hashlib
import json
import re
import shlex
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from webdriver import chromium

import gonio
from gonio import cli
from gonio.fitting.result import FitResult, PosteriorSummary
from gonio.geometry import Directions
from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.models import get
from gonio.reporting import Inputs, budget, gather, lobe, page, posterior, residuals
from gonio.reporting.markup import UNKNOWN

TRUE = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.15, "alpha_y": 0.2}
SECTIONS = ["parameters", "lobe", "residual", "goodness", "diagnosis", "posterior", "uncertainty",
            "measurement", "reproduce"]  # fmt: skip
EVIL = "<script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>\"&"
VOID = {"meta", "img", "br", "input", "link"}


class Page(HTMLParser):
    """Elements and texts of a page; refuses elements that do not nest."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict]] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self.words: list[str] = []
        self.feed(content)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        inside = self.open[-1] if self.open else ""
        {"script": self.scripts, "style": self.styles}.get(inside, self.words).append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def of(self, tag: str) -> list[dict]:
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def charts(self) -> dict:
        at = [a.get("type") for a in self.of("script")].index("application/json")
        return {chart["id"]: chart["views"] for chart in json.loads(self.scripts[at])}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A session, its samples, the fit to them and draws beside it, as the commands write them."""
    place = tmp_path_factory.mktemp("report")
    session = gonio.simulate(
        model="ward",
        parameters=TRUE,
        output=place / "shiny.gonio",
        instrument=preset("ideal12").with_pixels(104),
        plan=Plan(
            theta_i_deg=(10.0, 30.0, 50.0), rotations_deg=(0.0, 90.0), exposures_s=(1e-3, 32e-3)
        ),
        seed=3,
    )
    samples = gonio.reduce(session)
    samples.save(place / "shiny.nc")
    samples = gonio.formats.read(place / "shiny.nc")
    fit = gonio.fit(samples, model="ward", seed=5, cuts=NO_CUTS)
    rng = np.random.default_rng(4)
    values = rng.multivariate_normal(list(fit.values().values()), fit.covariance, (8, 500))
    drawn = {name: (("chain", "draw"), values[..., k]) for k, name in enumerate(fit.parameters)}
    file = place / "shiny.draws.nc"
    xr.Dataset(drawn, attrs={"model": "ward"}).to_netcdf(file, group="posterior", engine="h5netcdf")
    source = {**fit.source, "input": str(place / "shiny.nc"), "truth": TRUE,
              "session": str(place / "shiny.gonio")}  # fmt: skip
    summary = PosteriorSummary(3210.0, 1.0012, 2.5, 0.6, True, "shiny.draws.nc")
    replace(fit, source=source, posterior=summary).save(place / "shiny.json")
    return place


NO_CUTS = {"select": {}, "max_theta_i_deg": None, "max_theta_r_deg": None}


@pytest.fixture(scope="module")
def inputs(folder) -> Inputs:
    return gather(folder / "shiny.json")


@pytest.fixture(scope="module")
def content(inputs) -> str:
    return page(inputs)


@pytest.fixture(scope="module")
def read(content) -> Page:
    return Page(content)


@pytest.fixture(scope="module")
def bare(folder, tmp_path_factory) -> Inputs:
    """The fit alone: all that it was made of is gone."""
    place = tmp_path_factory.mktemp("bare")
    fit = FitResult.load(folder / "shiny.json")
    source = {**fit.source, "input": "gone.nc", "session": "gone.gonio"}
    replace(fit, source=source).save(place / "shiny.json")
    return gather(place / "shiny.json")


# ---------------------------------------------------------------- what is in it


def test_everything_is_there(inputs, read):
    assert inputs.absent == ()
    idents = [a["id"] for _, a in read.elements if "id" in a]
    assert len(idents) == len(set(idents))
    assert [i for i in idents if i in SECTIONS] == SECTIONS
    charts = ["slices", "surface", "residual-maps", "residuals", "rings", "profiles", "corner",
              "trace", "budget"]  # fmt: skip
    assert sorted(read.charts) == sorted(charts)
    for ident in charts:
        assert f"{ident}-plot" in idents
    assert "ideal12" in read.text
    assert "The fit and its posterior have converged." in read.text


def test_parameters_stand_beside_intervals_and_truth(inputs, read):
    for name, estimate in inputs.fit.parameters.items():
        assert name in read.text
        low, high = re.findall(r"([\d.]+) to ([\d.]+)", read.text.split(name, 1)[1])[1]
        assert [float(low), float(high)] == pytest.approx(estimate.interval_95, abs=2e-3)
        assert f"{TRUE[name]:g}" in read.text
    assert "3210" in read.text
    assert "1.0012" in read.text
    assert inputs.fit.source["data_sha256"] in read.text
    for name, version in inputs.fit.versions.items():
        assert f"version of {name} {version}" in read.text


def test_unknown_is_not_determined_and_never_zero(bare):
    silent = {
        name: replace(e, stderr=None, interval_68=None, interval_95=None, components={})
        for name, e in bare.fit.parameters.items()
    }
    fit = replace(bare.fit, parameters=silent, weights="none", source={"unknown": ["the lens"]})
    read = Page(page(replace(bare, fit=fit)))
    rows = read.text.split("Fitted parameters")[1].split("Intervals:")[0]
    assert rows.count(UNKNOWN) == 3 * len(silent)
    assert f"χ² per degree of freedom {UNKNOWN}" in read.text
    assert f"the lens: {UNKNOWN}" in read.text
    assert f"SHA-256 of the file {UNKNOWN}" in read.text
    assert f"instrument {UNKNOWN}" in read.text
    assert f"Findings: {UNKNOWN}" in read.text
    assert "budget" not in read.charts


def test_warnings_come_before_everything_else(inputs):
    fit = replace(inputs.fit, warnings=("mind the gap",), status="not_converged")
    text = Page(page(replace(inputs, fit=fit))).text
    assert text.index("has NOT converged") < text.index("mind the gap") < text.index("Parameters")


def test_findings_and_history_are_reported(inputs):
    source = {**inputs.fit.source, "findings": [{"severity": "warning", "what": "dim frame"}]}
    text = Page(page(replace(inputs, fit=replace(inputs.fit, source=source)))).text
    assert "severity: warning; what: dim frame" in text
    for line in inputs.fit.diagnostics["history"]:
        assert " ".join(line.split()) in text


# ---------------------------------------------------------------- alone and safe


def test_nothing_is_asked_of_a_network(content, read):
    for tag, attributes in read.elements:
        assert tag not in {"link", "iframe", "object", "embed", "base"}
        assert not set(attributes) & {"src", "href", "srcset", "action", "data"}
    assert not re.search(r"@import|url\(", "".join(read.styles))
    policy = next(a for a in read.of("meta") if "http-equiv" in a)
    assert policy["http-equiv"] == "Content-Security-Policy"
    assert policy["content"].startswith("default-src 'none'; script-src 'sha256-")
    assert "http" not in policy["content"]
    # The policy lets exactly the page's own scripts run.
    own = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        for script, a in zip(read.scripts, read.of("script"), strict=True)
        if "type" not in a
    ]
    assert re.findall(r"'sha256-([^']+)'", policy["content"]) == own
    assert len(own) == 2


def test_the_size_is_that_of_plotly_and_a_little_data(content, read):
    at = [a.get("type") for a in read.of("script")].index("application/json")
    data = len(read.scripts[at].encode())
    assert len(content.encode()) - data < 6e6
    assert data < 2.5e6


def evil(inputs: Inputs) -> Inputs:
    """The same with text that wants to run in every place where text comes from outside."""
    fit = inputs.fit
    parameters = {
        name: replace(e, components={**e.components, EVIL: e.stderr or 1.0})
        for name, e in fit.parameters.items()
    }
    source = {**fit.source, "sample": EVIL, "instrument": EVIL, "unknown": [EVIL],
              "findings": [EVIL, {EVIL: EVIL}], "data_sha256": EVIL, "input": EVIL}  # fmt: skip
    fit = replace(
        fit, parameters=parameters, source=source, warnings=(EVIL,), versions={EVIL: EVIL},
        diagnostics={"history": [EVIL]}, cuts={"select": {EVIL: EVIL}},
    )  # fmt: skip
    return replace(inputs, fit=fit, name=EVIL, absent=(EVIL,))


def test_text_from_outside_stays_text(inputs, read):
    hostile = Page(page(evil(inputs)))
    assert [a for a in hostile.of("script") if "type" not in a] == [{}, {}]
    assert len(hostile.scripts) == len(read.scripts)
    assert [a["id"] for a in hostile.of("img")] == ["surface-still"]
    assert hostile.words.count(EVIL) >= 8
    # plotly reads tags in its texts.
    assert "<" not in "".join(trace["name"] for trace in hostile.charts["budget"][0]["data"])


def test_a_fit_without_its_data_makes_a_report(bare):
    assert len(bare.absent) == 3
    read = Page(page(bare))
    assert list(read.charts) == ["rings", "budget"]
    for name in ("gone.nc", "gone.gonio", "shiny.draws.nc"):
        assert f"{name} is neither in the current folder nor beside the fit." in read.text
    assert "the samples that the fit was made to are not there" in read.text
    assert "the posterior's draws are not there" in read.text
    assert "Fitted parameters" in read.text


def test_samples_that_have_changed_are_left_out(folder, tmp_path):
    for name in ("shiny.json", "shiny.draws.nc"):
        shutil.copy(folder / name, tmp_path)
    fit = FitResult.load(tmp_path / "shiny.json")
    replace(fit, source={**fit.source, "sha256": "0" * 64}).save(tmp_path / "shiny.json")
    found = gather(tmp_path / "shiny.json")
    assert found.samples is None
    assert found.absent == ("The samples: shiny.nc has changed since the fit was made to it.",)
    replace(fit, n_samples=fit.n_samples + 1).save(tmp_path / "shiny.json")
    assert "it has changed since." in gather(tmp_path / "shiny.json").absent[0]


def test_a_fit_to_a_session_is_reduced_again(folder, inputs, tmp_path):
    source = {k: v for k, v in inputs.fit.source.items() if k != "sha256"}
    source["input"] = str(folder / "shiny.gonio")
    replace(inputs.fit, source=source, posterior=None).save(tmp_path / "shiny.json")
    asked = []
    found = gather(tmp_path / "shiny.json", lambda s: asked.append(s.path) or inputs.samples)
    assert asked == [folder / "shiny.gonio"]
    assert len(found.samples) == len(inputs.samples)
    assert found.absent == ()


# ---------------------------------------------------------------- true to the data


def test_every_sample_belongs_to_the_image_of_its_incidence(inputs):
    found = lobe.images(inputs.samples)
    together = np.sort(np.concatenate([image.index for image in found]))
    assert np.array_equal(together, np.arange(len(inputs.samples)))
    assert len(found) == 6
    for image in found:
        d = inputs.samples.directions
        assert np.ptp(d.theta_i[image.index]) < 1e-9
        assert d.theta_i[image.index][0] == image.theta_i
        assert np.allclose(np.cos(d.phi_i[image.index] - image.phi_i), 1)


def test_slices_hold_the_model_at_the_specular_direction(inputs, read):
    inside, polar, across = read.charts["slices"]
    model = get("ward")
    v = inputs.fit.values()
    lines = [t for t in inside["data"] if t["mode"] == "lines"]
    sideways = [t for t in across["data"] if t["mode"] == "lines"]
    assert [t["name"] for t in lines] == ["θi = 10°, model", "θi = 30°, model", "θi = 50°, model"]
    for line, side, theta in zip(lines, sideways, np.radians([10, 30, 50]), strict=True):
        f = float(model(Directions(theta, 0.0, theta, np.pi), **v))
        assert np.interp(np.degrees(theta), line["x"], line["y"]) == pytest.approx(f, rel=2e-3)
        assert np.interp(0.0, side["x"], side["y"]) == pytest.approx(f, rel=2e-3)
    # The two planes cross there; the lobe of the wider roughness is the wider slice.
    assert [t["theta"] for t in polar["data"]] == [t["x"] for t in inside["data"]]
    assert all(min(t["y"]) > 0 for t in inside["data"] + across["data"])


def test_points_of_the_surface_are_cube_roots(inputs, read):
    for view in read.charts["surface"]:
        mesh, points = view["data"]
        xyz = np.array([points[axis] for axis in "xyz"])
        value = np.array(points["customdata"])
        assert (xyz**2).sum(axis=0) ** 1.5 == pytest.approx(np.maximum(value, 0), rel=5e-3)
        assert np.min(mesh["z"]) >= 0
        top = np.max(np.sqrt(sum(np.square(mesh[axis]) for axis in "xyz")))
        assert top**3 == pytest.approx(value.max(), rel=0.3)


def test_residual_maps_show_what_is_left(inputs, read):
    views = read.charts["residual-maps"]
    found = residuals.residuals(inputs.samples, inputs.fit)
    drawn = np.concatenate([view["data"][0]["marker"]["color"] for view in views])
    assert len(drawn) == len(inputs.samples)
    assert np.sort(drawn) == pytest.approx(np.sort(found.percent), abs=1e-2, rel=1e-2)
    model = get(inputs.fit.model)
    f = model(inputs.samples.directions, **inputs.fit.values())
    first = 100 * (inputs.samples.value / f - 1)
    assert np.median(np.abs(first - found.percent)) < 0.3  # but for the extent of the cells
    assert "in per cent of the fitted f; colours end at ±" in read.text
    bar = views[0]["data"][0]["marker"]["colorbar"]
    assert bar["title"]["text"] == "% of f"
    assert f"Drawn: {len(drawn)} of {len(drawn)} samples" in read.text
    # Scaled as the fit did, they have the variance that was left.
    scaled = found.z.var() * inputs.fit.noise_scale**2
    assert scaled == pytest.approx(inputs.fit.chi2 / inputs.fit.dof, rel=0.05)


def test_samples_without_light_have_no_per_cent(inputs):
    found = residuals.residuals(inputs.samples, inputs.fit)
    percent = found.percent.copy()
    percent[::4] = np.nan
    chart = residuals.maps(inputs.samples, replace(found, percent=percent))
    left = int(np.isfinite(percent).sum())
    assert sum(len(view.data[0]["x"]) for view in chart.views) == left
    assert f"there is no per cent: {len(percent) - left} samples." in chart.caption


def test_an_error_of_three_u_is_a_residual_of_three(inputs):
    fit = replace(inputs.fit, noise_scale=1.0)
    before = residuals.residuals(inputs.samples, fit).z
    problem_u = np.array(inputs.samples.u_independent)
    more = replace(inputs.samples, value=inputs.samples.value + 3 * problem_u, noise_slope=None,
                   u_reference=None)  # fmt: skip
    still = replace(inputs.samples, noise_slope=None, u_reference=None)
    moved = residuals.residuals(more, fit).z - residuals.residuals(still, fit).z
    assert moved == pytest.approx(3.0, abs=1e-9)
    assert before.shape == moved.shape


def test_many_samples_are_thinned_and_counted(inputs, monkeypatch):
    monkeypatch.setattr(residuals, "MOST_DRAWN", 60)
    found = residuals.residuals(inputs.samples, inputs.fit)
    chart = residuals.maps(inputs.samples, found)
    assert sum(len(view.data[0]["x"]) for view in chart.views) == 60
    assert f"Drawn: 60 of {len(inputs.samples)} samples." in chart.caption


def test_without_uncertainties_residuals_say_so(inputs):
    blind = replace(inputs.samples, u_independent=None, noise_slope=None, u_reference=None)
    found = residuals.residuals(blind, replace(inputs.fit, weights="none"))
    assert not found.in_uncertainties
    assert np.mean(found.z**2) == pytest.approx(1.0)
    assert found.unit == "their root mean square"


def test_contours_hold_their_share_of_the_draws(inputs):
    traces = [t for t in posterior.corner(inputs.fit, inputs.draws).views[0].data
              if t["type"] == "contour"]  # fmt: skip
    names = list(inputs.fit.parameters)
    pairs = [(names[c], names[r]) for r in range(len(names)) for c in range(r)]
    assert len(traces) == 2 * len(pairs)
    for k, trace in enumerate(traces):
        x, y = (inputs.draws[name].values.ravel() for name in pairs[k // 2])
        columns = np.abs(np.subtract.outer(x, trace["x"])).argmin(axis=1)
        rows = np.abs(np.subtract.outer(y, trace["y"])).argmin(axis=1)
        density = np.array(trace["z"])[rows, columns]
        share = np.mean(density > trace["contours"]["value"])
        assert share == pytest.approx((0.95, 0.68)[k % 2], abs=0.06)


def test_true_values_are_lines_of_the_corner_plot(inputs):
    view = posterior.corner(inputs.fit, inputs.draws).views[0]
    upright = {s["x0"] for s in view.layout["shapes"] if s["x0"] == s["x1"]}
    assert upright == set(TRUE.values())
    blind = replace(inputs.fit, source={})
    assert posterior.corner(blind, inputs.draws).views[0].layout["shapes"] == []


def test_shares_of_the_budget_are_of_the_variance(inputs):
    for name, parts in budget.shares(inputs.fit).items():
        assert sum(parts.values()) == pytest.approx(1)
        estimate = inputs.fit.parameters[name]
        assert sum(u**2 for u in estimate.components.values()) == pytest.approx(
            estimate.stderr**2, rel=0.05
        )
        a, b = list(parts)[:2]
        ratio = estimate.components[a] ** 2 / estimate.components[b] ** 2
        assert parts[a] / parts[b] == pytest.approx(ratio)
    bars = np.array([t["x"] for t in budget.bars(inputs.fit).views[0].data])
    assert bars.sum(axis=0) == pytest.approx(100, abs=0.5)


# ---------------------------------------------------------------- the command


@pytest.fixture
def run(capsys):
    """Run the command line in this process: (exit code, stderr)."""

    def words(*given):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main([str(word) for word in given])
        return left.value.code, capsys.readouterr().err

    return words


def test_the_command_writes_a_page(run, folder, tmp_path, content):
    code, said = run("report", folder / "shiny.json", "-o", tmp_path / "shiny.html")
    assert code == 0
    assert said == f"written to {tmp_path / 'shiny.html'}\n"
    assert (tmp_path / "shiny.html").read_text(encoding="utf-8") == content


def test_the_command_says_what_it_leaves_out(run, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(folder / "shiny.json", tmp_path)
    code, said = run("report", "shiny.json")
    assert code == 0
    assert "left out: The draws: shiny.draws.nc is neither in the current folder" in said
    assert (tmp_path / "shiny.html").is_file()


@pytest.mark.parametrize(
    ("source", "output", "code", "text"),
    [
        ("gone.json", "a.html", 3, "gone.json: no such file; give a fit that 'gonio fit -o' wrote"),
        ("shiny.json", "a.pdf", 2, "a.pdf: a report is written as HTML; give a name that ends in"),
        ("shiny.json", "no/a.html", 3, "the folder no does not exist; make it first"),
        ("shiny.nc", "a.html", 3, "shiny.nc: not a readable fit"),
    ],
)
def test_refusals_are_one_sentence(run, folder, tmp_path, monkeypatch, source, output, code, text):
    monkeypatch.chdir(tmp_path)
    for name in ("shiny.json", "shiny.nc"):
        shutil.copy(folder / name, tmp_path)
    found, said = run("report", source, "-o", output)
    assert found == code
    assert text in said
    assert not Path(output).exists()


def test_the_printed_command_makes_the_fit_again(run, inputs, read, tmp_path):
    block = next(words for words in read.words if words.startswith("gonio reduce"))
    reduce, again, report = (shlex.split(line) for line in block.splitlines())
    assert reduce[:2] == ["gonio", "reduce"]
    assert report == ["gonio", "report", "shiny.json", "-o", "shiny.html"]
    again.remove("--posterior")  # its draws of this test are made up
    code, _ = run(*again[1:-1], tmp_path / "again.json")
    assert code == 0
    fit = FitResult.load(tmp_path / "again.json")
    assert fit.values() == inputs.fit.values()
    assert fit.seed == inputs.fit.seed
    assert fit.source["data_sha256"] == inputs.fit.source["data_sha256"]


# ---------------------------------------------------------------- in a browser


def test_a_reader_clicks_through_the_report(inputs, tmp_path):
    file = tmp_path / "shiny.html"
    file.write_text(page(evil(inputs)), encoding="utf-8")
    with chromium(tmp_path) as browser:
        browser.devtools(
            "Emulation.setDeviceMetricsOverride", width=360, height=800, deviceScaleFactor=1,
            mobile=True,
        )  # fmt: skip
        browser.open(file)
        drawn = "[...document.querySelectorAll('.plot')].map(p => [p.id, !!p.querySelector('svg')])"
        assert browser.run(drawn)
        assert all(has for _, has in browser.run(drawn))
        # A telephone needs no scrolling sideways, nothing came from elsewhere, nothing strange ran.
        assert browser.run("document.documentElement.scrollWidth") <= 360
        names = browser.run("performance.getEntriesByType('resource').map(e => e.name)")
        assert [n for n in names if not n.startswith(("data:", "blob:"))] == []
        assert browser.run("typeof window.hacked") == "undefined"
        shown = "JSON.stringify(document.getElementById('residual-maps-plot').data[0].y)"
        first = browser.run(shown)
        browser.click("#residual-maps-menu option:nth-child(3)")
        browser.wait(f"{shown} !== {json.dumps(first)}")
        browser.click("#slices-menu option:nth-child(2)")
        browser.wait("document.getElementById('slices-plot').data[0].type === 'scatterpolar'")
        paper = "getComputedStyle(document.body).backgroundColor"
        light = browser.run(paper)
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        browser.devtools("Emulation.setEmulatedMedia", features=dark)
        browser.wait(f"{paper} !== {json.dumps(light)}")
        browser.wait("document.getElementById('budget-plot').layout.paper_bgcolor === '#14171a'")
        complaints = [line for line in browser.log() if "GL Driver" not in line]
        assert not [line for line in complaints if "Canvas2D" not in line], complaints


def test_the_report_prints_without_half_empty_pages(inputs, tmp_path):
    """Charts shrink on paper; seven sections of text and eleven charts take seven pages at most."""
    file = tmp_path / "shiny.html"
    file.write_text(page(inputs), encoding="utf-8")
    with chromium(tmp_path) as browser:
        browser.open(file)
        browser.wait("document.documentElement.dataset.ready === 'true'")
        printed = base64.b64decode(browser.call("/print", {}))
    assert printed.startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type /Page\b", printed)) <= 7
