"""Pictures: every panel has its labels and units, the files are whole, refusals are clear."""

import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import gonio
from gonio import cli, models, plotting
from gonio.calibration.reflector import reflected_angles
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.result import Estimate, FitResult, PosteriorSummary, Verdict
from gonio.geometry import Directions
from gonio.instrument import Instrument, preset
from gonio.metadata import Plan
from gonio.plotting.frames import pixel_of
from gonio.plotting.lobe import in_plane
from gonio.plotting.style import COLOURS, DPI, parse_size
from gonio.plotting.summary import recovered
from gonio.samples import BRDFSamples
from gonio.session import Session

SHINY = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.15, "alpha_y": 0.2}


def small() -> Instrument:
    """ideal12 with 104 x 104 pixels."""
    return preset("ideal12").with_pixels(104)


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Session:
    return gonio.simulate(
        model="ward",
        parameters=SHINY,
        output=tmp_path_factory.mktemp("plot") / "shiny.gonio",
        instrument=small(),
        plan=Plan(
            theta_i_deg=(10.0, 30.0, 50.0),
            rotations_deg=(0.0, 90.0),
            exposures_s=(1e-3, 16e-3, 256e-3),
        ),
        seed=3,
    )


@pytest.fixture(scope="module")
def samples(session) -> BRDFSamples:
    return gonio.reduce(session)


def record_of(model: str, values: dict[str, float], n_samples: int, **more) -> FitResult:
    """A converged fit with these values, 1 % uncertain."""
    estimates = {
        name: Estimate(v, 0.01 * v, models.get(model).parameter(name).unit, None, None, None)
        for name, v in values.items()
    }
    given = {"source": {"sample": "shiny_thing", "instrument": "small12"}} | more
    return FitResult(
        model=model, status="converged", parameters=estimates, covariance=None, chi2=90.0,
        dof=100, noise_scale=1.0, n_samples=n_samples, n_negative=0, weights="sd", seed=1, **given,
    )  # fmt: skip


@pytest.fixture(scope="module")
def fit(samples) -> FitResult:
    return record_of("ward", SHINY, len(samples))


@pytest.fixture(scope="module")
def draws_file(tmp_path_factory) -> Path:
    """Draws of the Ward model, laid out as a fit writes them."""
    rng = np.random.default_rng(4)
    drawn = {
        name: (("chain", "draw"), rng.normal(v, 0.01 * v, (8, 200))) for name, v in SHINY.items()
    }
    path = tmp_path_factory.mktemp("draws") / "shiny.draws.nc"
    xr.Dataset(drawn, attrs={"model": "ward"}).to_netcdf(path, group="posterior", engine="h5netcdf")
    return path


@pytest.fixture
def run(capsys):
    """Run the command line in this process: (exit code, stderr)."""

    def words(*given):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main([str(word) for word in given])
        out, err = capsys.readouterr()
        assert out == ""
        return left.value.code, err

    return words


@pytest.fixture(autouse=True)
def no_figure_stays_open():
    import matplotlib.pyplot as plt

    yield
    plt.close("all")


def png_size(path: Path) -> tuple[int, int]:
    content = path.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    assert content.rstrip()[-8:-4] == b"IEND"
    return struct.unpack(">II", content[16:24])


# ---------------------------------------------------------------- frames


def test_frames_have_titles_units_and_a_colour_bar(session):
    axes = plotting.frames(session)
    assert all(isinstance(ax, Axes) for ax in axes)
    assert [ax.get_title().split("= ")[1] for ax in axes] == ["10°", "30°", "50°"]
    assert all(ax.get_xlabel() == "column (pixel)" for ax in axes)
    assert axes[0].get_ylabel() == "row (pixel)"
    labels = [ax.get_ylabel() for ax in axes[0].figure.axes]
    assert "signal (photo-electrons / s)" in labels


def test_frames_draw_on_given_axes(session):
    given = list(Figure().subplots(1, 2))
    assert plotting.frames(session, [2, 0], given, take=1) == given
    assert given[0].get_title().endswith("50°")
    with pytest.raises(ConfigurationError, match="2 axes were given for 1 frames"):
        plotting.frames(session, [0], given)
    with pytest.raises(ConfigurationError, match="incidence 3 is not of the session's plan"):
        plotting.frames(session, [3])


def test_the_specular_mark_sits_on_the_lobe(session):
    (ax,) = plotting.frames(session, [1])
    image = np.ma.filled(ax.images[0].get_array(), 0.0)
    (mark,) = (line for line in ax.lines if line.get_label() == "specular")
    x, y = float(mark.get_xdata()[0]), float(mark.get_ydata()[0])
    # The entry patch at the retro direction is bright too: look at the specular half only.
    forward = np.where(np.arange(image.shape[1]) < image.shape[1] / 2, image, 0)
    row, column = np.unravel_index(np.argmax(forward), forward.shape)
    # A pixel is 1.8 deg; the lobe, 17 deg wide, leans outwards by a few degrees.
    assert np.hypot(x - column, y - row) < 5


def test_overlay_inverts_lens_and_reflector(session):
    from gonio.calibration.lens import projection as lens

    metadata = session.metadata
    theta_r, phi_r = np.radians([0, 30, 60, 80]), np.radians([0, 40, 170, -100])
    columns, rows = pixel_of(metadata, theta_r, phi_r)
    at_camera = lens.camera_angles(
        metadata.lens, *lens.pixel_positions(metadata.camera, columns, rows)
    )
    R, D = metadata.geometry.R, metadata.geometry.D
    back, _ = reflected_angles(*at_camera, R=R, D=D)
    np.testing.assert_allclose(back, theta_r, atol=1e-6)


# ---------------------------------------------------------------- slices


def test_slices_have_units_points_and_lines(samples, fit):
    ax = plotting.slices(samples, fit)
    assert isinstance(ax, Axes)
    assert "(°)" in ax.get_xlabel()
    assert ax.get_ylabel() == "BRDF (sr$^{-1}$)"
    written = [text.get_text() for text in ax.texts]
    assert [text.split("= ")[-1] for text in written] == ["10°", "30°", "50°"]
    assert len({text.get_color() for text in ax.texts}) == 3
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert legend == ["measured, with standard uncertainty", "fitted: ward"]


def test_points_of_the_plane_lie_on_the_model(samples):
    ward = models.get("ward")
    for part in in_plane(samples):
        phi_r = np.where(part.theta_r > 0, part.phi_i + np.pi, part.phi_i)
        f = ward(Directions(part.theta_i, part.phi_i, np.abs(part.theta_r), phi_r), **SHINY)
        # Cells of a few degrees against the value at one point: loose, but a wrong side or a
        # wrong rotation is off by the lobe's whole height.
        assert np.median(np.abs(part.value / f - 1)) < 0.05
        assert part.phi_i == 0


def test_forward_is_positive(samples):
    part = in_plane(samples)[-1]
    assert np.degrees(part.theta_r[np.argmax(part.value)]) == pytest.approx(55, abs=10)


def test_no_more_slices_than_asked(samples):
    angles = [round(np.degrees(part.theta_i)) for part in in_plane(samples, 2)]
    assert angles == [10, 50]


def test_the_scale_is_logarithmic_only_where_it_must_be(samples):
    theta = np.radians(np.linspace(-70, 70, 29))
    phi_r = np.where(theta > 0, np.pi, 0.0)
    directions = Directions(0.5, 0.0, np.abs(theta), phi_r)
    flat = BRDFSamples(directions, np.full(29, 0.2))
    ax = plotting.slices(flat)
    assert ax.get_yscale() == "linear"
    assert ax.get_ylim()[0] == 0
    lobe = BRDFSamples(directions, 0.01 + np.exp(-(((theta - 0.5) / 0.1) ** 2)))
    assert plotting.slices(lobe).get_yscale() == "log"


def test_samples_without_a_plane_of_incidence_are_refused():
    aside = BRDFSamples(Directions(0.5, 0.0, np.full(9, 0.7), np.pi / 2), np.full(9, 0.2))
    with pytest.raises(DataError, match="no incidence with samples near its plane"):
        plotting.slices(aside)


# ---------------------------------------------------------------- posterior


def test_corner_is_a_triangle_with_symbols(draws_file):
    from gonio.plotting.summary import read_draws

    triangle = plotting.corner(read_draws(draws_file), SHINY)
    assert [len(row) for row in triangle] == [1, 2, 3, 4]
    assert all(isinstance(ax, Axes) for row in triangle for ax in row)
    assert triangle[3][0].get_xlabel() == r"$ρ_{\mathrm{d}}$"
    assert triangle[3][0].get_ylabel() == r"$α_{\mathrm{y}}$"
    # A true value is a thin line: across in every panel, up in the pairs only.
    assert len(triangle[1][1].lines) == 2  # median and truth
    low, high = triangle[0][0].get_xlim()
    assert low < SHINY["rho_d"] < high


def test_corner_states_the_unit_and_leaves_far_truth_out():
    rng = np.random.default_rng(5)
    drawn = {
        "rho": (("chain", "draw"), rng.normal(0.7, 0.01, (4, 300))),
        "sigma": (("chain", "draw"), rng.normal(40, 1, (4, 300))),
    }
    draws = xr.Dataset(drawn, attrs={"model": "oren_nayar"})
    triangle = plotting.corner(draws, {"sigma": np.radians(80)}, Figure(figsize=(4, 4)))
    assert triangle[1][1].get_xlabel() == "$σ$ (°)"
    assert triangle[1][1].get_xlim()[1] < 50
    with pytest.raises(DataError, match="do not name their model"):
        plotting.corner(xr.Dataset(drawn))
    with pytest.raises(DataError, match="hold no parameter of lambert"):
        plotting.corner(xr.Dataset(attrs={"model": "lambert"}))


# ---------------------------------------------------------------- summary


def texts(figure: Figure) -> str:
    from matplotlib.table import Cell
    from matplotlib.text import Text

    cells = [cell.get_text() for cell in figure.findobj(Cell)]
    return "\n".join(item.get_text() for item in [*figure.findobj(Text), *cells])


def test_summary_tells_what_was_measured(fit, samples, session, draws_file):
    verdict = Verdict("fits", 0.4, 0.0, (0.0, 0.004), 0.01, "no error of the model is seen")
    judged = replace(fit, verdict=verdict)
    figure = plotting.summary(judged, samples, session, draws_file, truth=SHINY)
    shown = texts(figure)
    assert "shiny thing on small12: Ward, elliptical Gaussian, exact" in shown
    assert "0.2000 ± 0.0020" in shown
    assert "verdict: fits" in shown
    assert "seed 1" in shown
    assert "difference / u" in shown
    assert "has not converged" not in shown
    assert len(figure.axes) == 3 + 1 + 1 + 10 + 1  # frames, bar, slices, corner, table


@pytest.mark.parametrize(
    ("with_fit", "with_samples", "with_session", "n_axes"),
    [(1, 1, 0, 2), (0, 1, 0, 1), (0, 1, 1, 5), (0, 0, 1, 4), (1, 0, 0, 1)],
)
def test_summary_leaves_out_what_is_not_there(
    fit, samples, session, with_fit, with_samples, with_session, n_axes
):
    figure = plotting.summary(
        fit if with_fit else None,
        samples if with_samples else None,
        session if with_session else None,
    )
    assert len(figure.axes) == n_axes


def test_summary_says_when_a_fit_has_not_converged(fit, samples):
    assert "the fit has not converged" in texts(
        plotting.summary(replace(fit, status="not_converged"), samples)
    )
    poor = PosteriorSummary(10.0, 1.3, 90.0, 0.1, converged=False)
    assert "the posterior has not converged" in texts(
        plotting.summary(replace(fit, posterior=poor), samples)
    )


def test_summary_of_nothing_is_refused():
    with pytest.raises(DataError, match="nothing to draw"):
        plotting.summary(None, None)


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [
        (39.96, 1.234, "40.0 ± 1.2"),
        (1234.0, 56.7, "1234 ± 57"),
        (0.3, None, "0.3 (not determined)"),
        (0.1, 0.00996, "0.1000 ± 0.0100"),
    ],
)
def test_two_digits_of_the_uncertainty_are_shown(value, stderr, text):
    assert recovered(Estimate(value, stderr, "", None, None, None)) == text


def test_a_bound_is_reported_with_the_unit():
    at_bound = Estimate(0.5, None, "deg", "lower", None, None)
    assert recovered(at_bound) == "0.5 ° (at its lower bound)"


def test_the_style_ends_with_its_block(fit, samples):
    before = dict(mpl.rcParams)
    with plotting.style():
        assert mpl.rcParams["font.size"] == 8
    plotting.summary(fit, samples)
    assert dict(mpl.rcParams) == before


# ---------------------------------------------------------------- files and the command


@pytest.mark.parametrize(
    ("suffix", "start"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")]
)
def test_the_same_picture_is_the_same_file(samples, tmp_path, suffix, start):
    files = []
    for name in "ab":
        figure = Figure(figsize=(3.0, 2.0), layout="constrained")
        plotting.slices(samples, axes=figure.subplots())
        plotting.save(figure, tmp_path / f"{name}.{suffix}")
        files.append((tmp_path / f"{name}.{suffix}").read_bytes())
    assert files[0].startswith(start)
    assert files[0] == files[1]
    assert len(list(tmp_path.iterdir())) == 2
    if suffix == "png":
        assert png_size(tmp_path / "a.png") == (3 * DPI, 2 * DPI)


@pytest.fixture
def fitted(fit, samples, draws_file, tmp_path) -> Path:
    """A fit, its samples and its draws side by side in a folder."""
    samples.save(tmp_path / "shiny.nc")
    shutil.copy(draws_file, tmp_path / "shiny.draws.nc")
    posterior = PosteriorSummary(900.0, 1.002, 2.0, 0.6, True, "shiny.draws.nc")
    source = {**fit.source, "input": "shiny.nc", "truth": SHINY}
    replace(fit, posterior=posterior, source=source).save(tmp_path / "shiny.json")
    return tmp_path / "shiny.json"


def test_plot_of_a_fit_finds_its_files_beside_it(run, fitted):
    code, err = run("plot", fitted)
    picture = fitted.with_suffix(".png")
    assert (code, err.splitlines()[-1]) == (0, f"written to {picture}")
    assert png_size(picture)[0] == 1600
    assert picture.stat().st_size > 50_000


def test_plot_of_samples_alone(run, fitted, tmp_path):
    code, _ = run("plot", fitted.with_suffix(".nc"), "-o", tmp_path / "only.svg")
    assert code == 0
    assert (tmp_path / "only.svg").read_bytes().rstrip().endswith(b"</svg>")


def test_plot_of_a_csv(run, tmp_path):
    rows = "".join(f"30,0,{theta},180,0.2\n" for theta in range(0, 80, 5))
    (tmp_path / "paint.csv").write_text(f"theta_i,phi_i,theta_r,phi_r,brdf\n{rows}")
    assert run("plot", tmp_path / "paint.csv")[0] == 0
    assert png_size(tmp_path / "paint.png")[0] == 1600


def test_plot_goes_on_without_draws(run, fitted):
    fitted.with_name("shiny.draws.nc").unlink()
    code, err = run("plot", fitted)
    assert code == 0
    expected = "Left out of the picture: The draws: shiny.draws.nc is neither in the current folder"
    assert expected in err


def edited(path: Path, **changes) -> Path:
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(document | changes), encoding="utf-8")
    return path


def test_refusals_are_one_clear_sentence(run, fitted, tmp_path):
    def refused(*words, code):
        found, err = run("plot", *words)
        assert found == code
        assert err.startswith("Error: ")
        assert err.count("\n") == 1
        return err

    assert "no such file" in refused(tmp_path / "none.json", code=3)
    assert "written as .png, .pdf, .svg" in refused(fitted, "-o", tmp_path / "a.jpg", code=2)
    assert "does not exist" in refused(fitted, "-o", tmp_path / "no" / "a.png", code=3)
    (tmp_path / "dir.png").mkdir()
    assert "is a folder" in refused(fitted, "-o", tmp_path / "dir.png", code=2)
    (tmp_path / "odd.json").write_text("{}")
    assert "not a readable fit" in refused(tmp_path / "odd.json", code=3)
    edited(fitted, n_samples=7)
    assert "the fit was made to 7; it has changed since" in refused(fitted, code=3)
    fitted.with_name("shiny.nc").unlink()
    text = refused(fitted, code=3)
    assert "shiny.nc is neither in the current folder nor beside the fit. Give the" in text
    edited(fitted, source={})
    assert "the fit does not say which samples it was made to" in refused(fitted, code=3)
    assert not list(tmp_path.glob("*.jpg")) + list(tmp_path.glob(".*"))


# ---------------------------------------------------------------- one kind of picture


@pytest.mark.parametrize("kind", ["slices", "hemisphere", "residuals", "lobe", "solid", "albedo"])
def test_each_kind_of_a_fit_is_drawn(run, fitted, tmp_path, kind):
    code, err = run("plot", fitted, "--kind", kind, "-o", tmp_path / "one.png")
    assert code == 0, err
    assert png_size(tmp_path / "one.png")[0] > 400


def test_a_session_has_frames_and_a_hemisphere(run, session, tmp_path):
    for kind in ("frames", "hemisphere"):
        code, err = run("plot", session.path, "--kind", kind, "-o", tmp_path / "one.png")
        assert code == 0, err


def test_models_and_materials_are_drawn_by_name(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("plot", "model:oren_nayar", "-p", "sigma=30") == (0, "written to oren_nayar.png\n")
    given = ("--kind", "hemisphere", "-o", "map.svg")
    assert run("plot", "material:rolled_brass", *given) == (0, "written to map.svg\n")
    assert {path.name for path in tmp_path.iterdir()} == {"oren_nayar.png", "map.svg"}


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["model:wrd"], "unknown model 'wrd': did you mean 'ward'"),
        (["material:brass"], "unknown material 'brass'"),
        (["model:ward", "--kind", "slices"], "--kind slices is drawn of samples, and model:ward"),
        (["model:ward", "--kind", "pie"], "unknown kind of picture 'pie'"),
        (["model:ward", "-p", "rho_d=7"], "rho_d = 7 is out of range"),
    ],
)
def test_what_has_no_such_picture_is_refused(run, tmp_path, monkeypatch, words, match):
    monkeypatch.chdir(tmp_path)
    code, err = run("plot", *words)
    assert code == 2
    assert match in err


def test_parameters_of_a_file_cannot_be_changed(run, fitted):
    code, err = run("plot", fitted, "-p", "rho_d=0.1")
    assert code == 2
    assert "-p goes with model:NAME or material:NAME" in err


# ---------------------------------------------------------------- the hemisphere


def colours(ax: Axes) -> np.ndarray:
    return np.concatenate([np.ravel(c.get_array()) for c in ax.collections])


def test_the_map_of_a_model_has_its_peak_at_the_mirror_direction():
    axes = plotting.hemisphere_map(
        "ward", {"alpha_x": 0.1, "alpha_y": 0.1}, theta_i=np.radians([40.0])
    )
    (mesh,) = axes[0].collections
    at = np.asarray(mesh.get_coordinates()).reshape(-1, 2)[int(np.argmax(mesh.get_array()))]
    # The equal-area map has the radius sqrt(2) sin(theta/2); the peak is a little beyond 40 deg.
    np.testing.assert_allclose(at, [-np.sqrt(2) * np.sin(np.radians(20)), 0], atol=0.02)
    assert mesh.norm.vmax == mesh.get_array().max()
    assert axes[0].get_title().endswith("= 40°")


def test_all_maps_have_one_scale_and_one_colour_bar():
    axes = plotting.hemisphere_map("oren_nayar", {"sigma": 0.5})
    assert len({(ax.collections[0].norm.vmin, ax.collections[0].norm.vmax) for ax in axes}) == 1
    assert len(axes[0].figure.axes) == len(axes) + 1
    assert axes[0].figure.axes[-1].get_ylabel() == "BRDF $f$ (sr$^{-1}$)"


def test_an_even_surface_is_shown_as_even():
    axes = plotting.hemisphere_map("lambert", {"rho": 0.5}, theta_i=[0.0])
    norm = axes[0].collections[0].norm
    assert norm.vmin < 0.5 / np.pi < norm.vmax


def test_the_map_of_samples_shows_every_sample_of_its_incidences(samples):
    axes = plotting.hemisphere_samples(samples)
    theta_i = np.degrees(np.broadcast_to(samples.directions.theta_i, len(samples)))
    phi_i = np.broadcast_to(samples.directions.phi_i, len(samples))
    for ax, angle in zip(axes, (10, 30, 50), strict=True):
        own = (np.abs(theta_i - angle) < 0.1) & (np.abs(phi_i) < 0.01) & (samples.value > 0)
        shown = [c for c in ax.collections if c.get_array() is not None]
        assert sum(len(c.get_array()) for c in shown) == own.sum()


def test_residuals_tell_their_sign_by_shape_and_their_unit(samples, fit):
    axes = plotting.residual_map(samples, fit)
    assert axes[0].figure.axes[-1].get_ylabel() == "measured − fitted (% of the fitted f)"
    for ax in axes:
        up, down = ax.collections
        assert np.all(up.get_array() >= 0)
        assert np.all(down.get_array() < 0)
        # A triangle that points up has its single vertex above.
        assert up.get_paths()[0].vertices[0][1] > 0 > down.get_paths()[0].vertices[0][1]


def test_residuals_are_per_cent_of_f(samples, fit):
    more = replace(samples, value=1.02 * samples.value)
    percent, raised = (
        np.concatenate([colours(ax) for ax in plotting.residual_map(each, fit)])
        for each in (samples, more)
    )
    # Two per cent more light are two per cent more everywhere. The order is that of the signs.
    assert raised.mean() - percent.mean() == pytest.approx(2.0, abs=0.1)
    assert abs(percent.mean()) < 0.5


def test_no_per_cent_where_the_model_gives_no_light(samples, fit):
    black = replace(fit, parameters={
        name: replace(estimate, value=0.0) if name.startswith("rho") else estimate
        for name, estimate in fit.parameters.items()
    })  # fmt: skip
    axes = plotting.residual_map(samples, black)
    assert not any(len(part.get_offsets()) for ax in axes for part in ax.collections)


def test_another_number_of_axes_is_refused(samples):
    with pytest.raises(ConfigurationError, match="1 axes were given for 3 maps; give one for each"):
        plotting.hemisphere_samples(samples, [Figure().subplots()])
    with pytest.raises(ConfigurationError, match=r"theta_i = 1\.6 rad is not above the horizon"):
        plotting.hemisphere_map("ward", theta_i=[1.6])
    with pytest.raises(DataError, match="f is nowhere above 0"):
        plotting.hemisphere_map("lambert", {"rho": 0.0})


# ---------------------------------------------------------------- albedo


def test_the_albedo_curve_is_the_albedo():
    from gonio.checks import directional_albedo

    ax = plotting.albedo_curve("ward", SHINY)
    planes = [line for line in ax.lines if len(line.get_xdata()) > 2]
    assert [line.get_label() for line in planes] == [
        r"$φ_{\mathrm{i}}$ = 0°", r"$φ_{\mathrm{i}}$ = 90°"
    ]  # fmt: skip
    theta, albedo = planes[1].get_data()
    k = int(np.argmin(np.abs(theta - 60)))
    expected = directional_albedo(models.get("ward"), SHINY, np.radians(60), np.pi / 2).value
    assert albedo[k] == pytest.approx(expected, rel=1e-3)


def test_the_albedo_curve_shows_what_is_claimed_and_what_is_possible():
    labels = [line.get_label() for line in plotting.albedo_curve("ward_gmd", SHINY).lines]
    assert "at most rho_d + rho_s" in labels
    # Oren and Nayar's approximation gives back more than it receives at small sigma.
    labels = [line.get_label() for line in plotting.albedo_curve("oren_nayar", {"rho": 1.0}).lines]
    assert "1: all light comes back" in labels
    assert plotting.albedo_curve("lambert", {"rho": 0.2}).get_ylim()[0] == 0


def luminance(rgb) -> float:
    return float(np.dot(np.asarray(rgb)[:3], [0.2126, 0.7152, 0.0722]))


def test_colours_of_lines_differ_in_grey():
    from matplotlib.colors import to_rgb

    grey = [luminance(to_rgb(colour)) for colour in COLOURS[:4]]
    assert min(abs(a - b) for k, a in enumerate(grey) for b in grey[:k]) > 0.03


def test_the_map_of_f_reads_in_grey():
    grey = [luminance(mpl.colormaps["viridis"](x)) for x in np.linspace(0, 1, 20)]
    assert np.all(np.diff(grey) > 0)


# ---------------------------------------------------------------- a lobe in space


def test_the_solid_is_longest_along_the_mirror_direction(monkeypatch):
    from mpl_toolkits.mplot3d.axes3d import Axes3D

    drawn = []
    monkeypatch.setattr(Axes3D, "plot_surface", lambda ax, *xyz, **how: drawn.append(xyz))
    ax = plotting.lobe_solid("ward", {"alpha_x": 0.1, "alpha_y": 0.1}, theta_i=np.radians(40.0))
    corners = np.stack(drawn[0], axis=-1).reshape(-1, 3)
    r = np.linalg.norm(corners, axis=1)
    mirror = [-np.sin(np.radians(40)), 0, np.cos(np.radians(40))]
    assert corners[r.argmax()] / r.max() @ mirror > np.cos(np.radians(3))
    assert r.max() <= 1
    assert "logarithmic" in ax.get_title()
    with pytest.raises(ConfigurationError, match=r"theta_i = 1\.6 rad is not above the horizon"):
        plotting.lobe_solid("ward", theta_i=1.6)


# ---------------------------------------------------------------- size and resolution


def extent(path: Path) -> tuple[int, int]:
    return struct.unpack(">II", path.read_bytes()[16:24])


def test_a_picture_has_the_size_and_the_dots_that_are_asked_for(samples, tmp_path):
    figure = plotting.slices(samples).get_figure(root=True)
    own = tuple(figure.get_size_inches())
    plotting.save(figure, tmp_path / "a.png", size=(5, 4), dpi=100)
    plotting.save(figure, tmp_path / "b.png", dpi=50)
    assert extent(tmp_path / "a.png") == (500, 400)
    assert extent(tmp_path / "b.png") == tuple(round(50 * edge) for edge in own)
    assert tuple(figure.get_size_inches()) == own
    plotting.save(figure, tmp_path / "a.svg", size=(5, 4))
    assert 'width="360pt" height="288pt"' in (tmp_path / "a.svg").read_text("utf-8")
    plotting.save(figure, tmp_path / "a.pdf", size=(5, 4))
    assert b"/MediaBox [ 0 0 360 288 ]" in (tmp_path / "a.pdf").read_bytes()


def test_a_picture_without_room_for_its_labels_is_refused(samples, tmp_path):
    figure = plotting.hemisphere_samples(samples)[0].get_figure(root=True)
    figure.suptitle("\n" * 400)
    with pytest.raises(ConfigurationError, match=r"labels leave no room .* at 2 x 60 inches; give"):
        plotting.save(figure, tmp_path / "a.png", size=(2, 60), dpi=30)
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(
    ("text", "inches"),
    [("6.4x4", (6.4, 4.0)), ("5X4in", (5, 4)), ("254 x 127 mm", (10, 5)), ("25.4x12.7cm", (10, 5))],
)
def test_sizes_are_inches_or_have_a_unit(text, inches):
    assert parse_size(text) == pytest.approx(inches)


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--size", "7x"], "--size '7x' is not WIDTHxHEIGHT; write it in inches as 6.4x4"),
        (["--size", "1.2.3x4"], "--size '1.2.3x4' is not WIDTHxHEIGHT"),
        (["--size", "160x100"], "the size 160 x 100 inches is out of range; each edge is 2 to 60"),
        (["--size", "10x10mm"], "the size 0.3937 x 0.3937 inches is out of range"),
        (["--dpi", "9"], "9 dots an inch are out of range; allowed are 30 to 2400"),
        (["--size", "20x20", "--dpi", "2400"], "are more than 30000 pixels along an edge"),
    ],
)
def test_sizes_that_no_picture_can_have_are_refused(run, fitted, tmp_path, words, match):
    code, err = run("plot", fitted, "-o", tmp_path / "a.png", *words)
    assert code == 2
    assert match in err
    assert not (tmp_path / "a.png").exists()


def test_a_page_is_not_squeezed(run, fitted, tmp_path):
    code, err = run("plot", fitted, "--size", "160x100mm", "-o", tmp_path / "a.png")
    assert (code, "the whole page needs at least 8.5 x " in err) == (2, True)
    words = ("--kind", "slices", "--size", "160x100mm", "--dpi", "100")
    assert run("plot", fitted, *words, "-o", tmp_path / "a.png")[0] == 0
    assert extent(tmp_path / "a.png") == (629, 393)
