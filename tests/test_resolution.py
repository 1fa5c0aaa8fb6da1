"""What an instrument resolves: blur and coverage against other computations, and the command."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import curve_fit

from gonio import models
from gonio.cli import fit
from gonio.cli import instruments as command
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import unit_vectors
from gonio.instrument import imaging, preset
from gonio.instrument.plans import default_plan
from gonio.instrument.resolution import (
    EXCESS,
    WHOLE,
    effective_alpha,
    median,
    pointing_sd,
    principal,
    report,
    resolve,
    smallest_alpha,
)
from gonio.simulation import simulate

QUICK = {"rays": 16, "step_deg": 1.5}


def changed(part, **fields):
    return part.model_copy(update=fields)


def rig(name="ideal12", **parts):
    """A preset with some settings of its parts changed: lens={"pupil_mm": 2.0}."""
    chosen = preset(name)
    return changed(chosen, **{key: changed(getattr(chosen, key), **v) for key, v in parts.items()})


# ---------------------------------------------------------------- blur of the pupil

# RMS angle to the mean direction, median and maximum in deg over theta_r <= 75 deg at R = 150 mm,
# by D/R; from a ray tracer of its own. None: the spot is larger than all that the pupil sees.
TRACED = {
    ("sphere", 2.0, "R/2", None): {0.02: (0.010, 0.021), 0.05: (0.024, 0.052),
                                   0.10: (0.048, 0.105), 0.15: (0.072, 0.157)},
    ("sphere", 8.0, "R/2", None): {0.02: (0.039, 0.084), 0.05: (0.097, 0.209),
                                   0.10: (0.193, 0.420), 0.15: (0.288, 0.629)},
    ("sphere", 2.0, "R", None): {0.02: (0.270, 0.280), 0.05: (0.270, 0.296),
                                 0.10: (0.271, 0.321), 0.15: (0.271, 0.346)},
    ("sphere", 8.0, "R", 5.0): {0.02: (0.56, 0.68), 0.10: (0.56, 0.67)},
    ("sphere", 8.0, "R/2", 5.0): {0.02: (0.021, 0.041), 0.10: (0.102, 0.232)},
}  # fmt: skip
CASES = [(*case, ratio, *figures) for case, row in TRACED.items() for ratio, figures in row.items()]


@pytest.mark.parametrize(("shape", "pupil", "focus", "spot", "ratio", "middle", "most"), CASES)
def test_pupil_blur_is_that_of_another_ray_tracer(shape, pupil, focus, spot, ratio, middle, most):
    instrument = rig(
        dome={"shape": shape, "R": 150.0, "D": 150 * ratio},
        lens={"pupil_mm": pupil, "focus": focus},
        lamp={"lit_diameter_mm": spot or 250.0},
        holder={"sample_diameter_mm": 300.0},
    )
    # Half of a pupil needs more rays than a whole one, whose second moments are exact.
    found = resolve(instrument, rays=128 if spot else 16, step_deg=3.0 if spot else 1.5)
    inside = (found.share > 0) & (found.theta_r <= np.radians(75))
    rms = np.degrees(np.sqrt(np.trace(found.pupil[inside], axis1=1, axis2=2)))
    # That tracer's medians count equal areas of the camera's hemisphere.
    theta_c = np.linspace(0, np.pi / 2, len(found.share))
    weight = np.broadcast_to(np.sin(theta_c)[:, None], inside.shape)[inside]
    assert median(rms, weight) == pytest.approx(middle, rel=0.04, abs=0.0006)
    assert rms.max() == pytest.approx(most, rel=0.05, abs=0.0006)


def test_blur_is_linear_in_the_pupil_and_absent_without_one():
    one, two, none = (
        resolve(rig(lens={"pupil_mm": mm}, lamp={"lit_diameter_mm": 200.0}), **QUICK)
        for mm in (1.0, 2.0, 0.0)
    )
    seen = (two.share == 1) & two.usable
    once, twice = principal(one.pupil)[seen], principal(two.pupil)[seen]
    np.testing.assert_allclose(twice, 2 * once, rtol=0.01, atol=2e-6)
    assert np.max(principal(none.pupil)[seen]) < 1e-12


# ---------------------------------------------------------------- pixel, point spread, source


def test_pixel_blur_is_the_jacobian_of_the_mapping():
    # The central direction over half a pixel to each side, from chief rays traced one by one.
    instrument = rig(lens={"pupil_mm": 0.0})
    found = resolve(instrument, rays=16, step_deg=1.0)
    lens, dome, pitch = instrument.lens, instrument.dome, 3.45e-3 * 4
    for k in (20, 50, 80):
        r = float(lens.radius(np.radians(k)))
        steps = np.array([[r - pitch / 2, 0], [r + pitch / 2, 0], [r, -pitch / 2], [r, pitch / 2]])
        theta = lens.polar_angle(np.hypot(*steps.T))
        w = unit_vectors(*dome.reflected_angles(theta, np.arctan2(steps[:, 1], steps[:, 0])))
        along, across = w[1] - w[0], w[3] - w[2]
        tensor = (np.outer(along, along) + np.outer(across, across)) / 12
        expected = np.sqrt(np.linalg.eigvalsh(tensor)[:0:-1])
        np.testing.assert_allclose(principal(found.pixel[k, 0]), expected, rtol=2e-3)


def test_parts_add_as_variances():
    found = resolve(rig("modern12", lens={"psf_px": 3.0}), **QUICK)
    seen = found.usable & (found.share == 1)
    np.testing.assert_allclose(found.optics[seen], (found.pixel + found.pupil)[seen], atol=1e-8)
    total = found.pixel + found.pupil + found.psf + np.radians(0.25) ** 2 * np.eye(2)
    np.testing.assert_allclose(found.blur[seen], total[seen], atol=1e-8)
    np.testing.assert_array_equal(found.residual[seen], (found.pupil + found.psf)[seen])


def test_point_spread_is_that_of_an_image():
    # A square pixel and a Gaussian of sd 12^-1/2 of it have the same variance.
    found = resolve(rig(lens={"psf_px": 4 / np.sqrt(12)}), **QUICK)
    seen = found.share > 0
    np.testing.assert_allclose(found.psf[seen], found.pixel[seen], rtol=1e-12)


def test_slope_errors_move_directions_and_hardly_widen_a_pixel():
    instrument = rig("modern12")
    moved, widened = [], []
    at = np.linspace(0.05, 2.3, 300)
    angle = np.arange(300) * 2.4
    places = (at * [np.cos(angle), np.sin(angle)]).T
    in_pixel, in_pupil, _ = imaging.ray_pattern(16)
    points = places[:, None, :] + in_pixel * 13.8e-3
    level = changed(
        instrument, dome=changed(instrument.dome, slope_error_deg=0, rim_slope_error_deg=0)
    )
    _, straight, _ = imaging.trace_points(level, points, in_pupil, 0)
    for seed in range(12):
        _, bent, _ = imaging.trace_points(instrument, points, in_pupil, seed)
        shift = (bent - straight).mean(axis=1)
        moved.append(np.mean(np.sum(shift**2, axis=1)) / 2)
        rms = [np.sqrt(np.sum(np.var(w, axis=1), axis=1)) for w in (bent, straight)]
        widened.append(np.abs(rms[0] / rms[1] - 1).max())
    # At theta_c <= 75 deg the slope is nearly that of the zenith, plus 0.2 (theta/90)^6.
    theta = np.arccos(straight.mean(axis=1)[:, 2])
    expected = np.mean([pointing_sd(instrument, t) ** 2 for t in theta])
    assert np.sqrt(np.mean(moved)) == pytest.approx(np.sqrt(expected), rel=0.15)
    assert max(widened) < 0.05


# ---------------------------------------------------------------- alpha


@pytest.mark.parametrize("theta_i_deg", [0.0, 60.0])
def test_a_lobe_under_a_source_cone_is_fitted_with_the_effective_alpha(theta_i_deg):
    alpha, half_angle_deg = 0.04, 1.0
    theta_i = np.radians(theta_i_deg)
    ward = models.get("ward")
    truth = {"rho_d": 0.1, "rho_s": 0.3, "alpha_x": alpha, "alpha_y": alpha}
    p = np.array([truth[q.name] for q in ward.parameters])
    lean = np.radians(np.arange(-8, 8.1, 1.0))
    t, f = theta_i + np.repeat(lean, len(lean)), np.tile(lean, len(lean))
    # Directions about the specular one, at (theta_i, 180 deg).
    w_r = np.stack([-np.sin(t) * np.cos(f), np.sin(f), np.cos(t) * np.cos(f)], -1)
    w_r = np.ascontiguousarray(w_r[w_r[:, 2] > 0])
    lamp = changed(preset("modern12").lamp, half_angle_deg=half_angle_deg)
    cone = lamp.directions(theta_i, imaging.ray_pattern(256)[2])
    blurred = np.mean([ward.evaluate(np.broadcast_to(w, w_r.shape), w_r, p) for w in cone], axis=0)
    middle = np.broadcast_to(unit_vectors(theta_i, 0.0), w_r.shape)
    fitted, _ = curve_fit(lambda _, *q: ward.evaluate(middle, w_r, np.array(q)), 0, blurred, p0=p)
    found = dict(zip([q.name for q in ward.parameters], fitted, strict=True))
    sd = np.radians(half_angle_deg) / 2
    rule = effective_alpha(alpha, sd), effective_alpha(alpha, sd, np.cos(theta_i))
    for name, expected in zip(("alpha_x", "alpha_y"), rule, strict=True):
        assert found[name] / alpha - 1 == pytest.approx(expected / alpha - 1, rel=0.12)


def test_the_smallest_alpha_is_widened_by_the_stated_share():
    for sd, cosine in ((0.005, 1.0), (0.02, 0.5)):
        alpha = smallest_alpha(sd, cosine)
        assert effective_alpha(alpha, sd, cosine) == pytest.approx((1 + EXCESS) * alpha, rel=1e-12)


def test_a_source_alone_gives_its_alpha_in_and_across_the_plane():
    # Pixels of a tenth of the cone: in the plane a/2 alone, across it 1/cos(60 deg) of that.
    instrument = rig(lamp={"half_angle_deg": 1.0}, lens={"pupil_mm": 0.0}, sensor={"binning": 1})
    at_0, at_60 = report(resolve(instrument, **QUICK))["alpha"]
    alpha = np.radians(0.5) / np.sqrt(2 * (1.05**2 - 1))
    assert at_0["in_plane"]["alpha"] == pytest.approx(alpha, rel=0.01)
    assert at_0["across"]["alpha"] == pytest.approx(alpha, rel=0.01)
    assert at_60["in_plane"]["alpha"] == pytest.approx(alpha, rel=0.01)
    assert at_60["across"]["alpha"] == pytest.approx(2 * alpha, rel=0.01)
    assert at_60["across"]["excess_reduced"] == 0


# ---------------------------------------------------------------- coverage


def test_the_pupil_needs_lit_sample_up_to_the_grazing_limit():
    # In the ellipsoid every chief ray lands on the target, and the pupil's image is stretched by
    # 1/cos(theta_r): whole up to acos(pupil / lit diameter), as the pupil is 1:1 on the sample.
    instrument = rig(lens={"pupil_mm": 2.0}, lamp={"lit_diameter_mm": 8.0}, sensor={"binning": 1})
    found = resolve(instrument, rays=64, step_deg=1.0)
    limit = np.degrees(found.reach(WHOLE))
    at_the_sides = limit[[0, 17, 18, 35]]  # where |PT| = |PC|, the image is 1:1
    np.testing.assert_allclose(at_the_sides, np.degrees(np.arccos(2 / 8)), atol=2.5)
    assert np.degrees(found.reach(1e-9).min()) > limit.max()


def test_a_perfect_field_covers_the_hemisphere():
    found = resolve(rig(lens={"pupil_mm": 0.0}), rays=16, step_deg=0.5)
    assert found.solid_angle.sum() == pytest.approx(2 * np.pi, rel=0.005)
    cap = found.solid_angle[found.usable].sum()
    assert cap == pytest.approx(2 * np.pi * (1 - np.cos(np.radians(80))), rel=0.01)


@pytest.mark.parametrize(("field_deg", "reach_deg"), [(170.0, 86.0), (160.0, 82.0)])
def test_a_narrow_lens_ends_the_field_at_every_azimuth(field_deg, reach_deg):
    seen = report(resolve(rig(lens={"field_deg": field_deg}), **QUICK))["theta_r"]
    assert seen["any"]["max_deg"] == pytest.approx(reach_deg, abs=0.3)
    assert seen["any"]["min_deg"] < field_deg / 2
    assert np.argmax(seen["any"]["by_azimuth_deg"]) // 18 == 1  # less on the +y side


def test_a_short_frame_cuts_the_field_where_it_ends():
    whole, cut = (
        report(resolve(rig(sensor={"rows": rows}), **QUICK))["theta_r"]["any"]
        for rows in (1664, 1000)
    )
    reach = np.array(cut["by_azimuth_deg"])
    assert reach[[0, 17, 18, 35]].min() > 85
    assert reach[[8, 9, 26, 27]].max() < 62
    assert cut["share_of_hemisphere"] < 0.8 * whole["share_of_hemisphere"]


def test_what_is_not_seen_is_unknown():
    found = resolve(changed(rig(lens={"field_deg": 80.0}), theta_i_max_deg=50.0), **QUICK)
    document = report(found)
    assert document["alpha"][0]["in_plane"]["alpha"] > 0
    assert document["alpha"][1] == {"theta_i_deg": 60.0, "in_plane": None, "across": None}
    assert found.at(found.blur, np.radians(75), 0.0) is None
    assert document["theta_i"]["specular_seen_max_deg"] < 45
    nothing = resolve(rig(sensor={"centre_offset_px": (9000.0, 0.0)}), **QUICK)
    document = report(nothing)
    assert document["blur_deg"]["total"] == {
        "median_major": None,
        "median_minor": None,
        "max": None,
    }
    assert document["theta_i"]["specular_seen_max_deg"] is None
    assert document["theta_r"]["any"]["max_deg"] == 0


def test_threads_change_nothing():
    one, two = (resolve(rig("lbl1992"), **QUICK, threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.blur, two.blur)


# ---------------------------------------------------------------- command and picture


def run(*words):
    return CliRunner().invoke(command.command, [str(word) for word in words])


def test_command_prints_json_and_draws(tmp_path):
    target = tmp_path / "map.png"
    done = run("lbl1992", "--resolution", "--json", "--map", target)
    assert done.exit_code == 0
    document = json.loads(done.stdout)
    assert document["schema"] == "gonio.resolution/1"
    assert document["instrument"] == "lbl1992"
    assert document["theta_i"]["arm_max_deg"] == 70
    assert document["theta_r"]["usable"]["max_deg"] == pytest.approx(70)
    assert len(document["theta_r"]["any"]["by_azimuth_deg"]) == 36
    assert target.read_bytes().startswith(b"\x89PNG")


def test_command_prints_a_table():
    done = run("ideal12", "--resolution")
    assert done.exit_code == 0
    words = " ".join(done.stdout.split())
    assert "smallest alpha that it resolves, where the blur widens a lobe by 5 %" in words
    assert "source cone │ 0.000 │ 0.000 │ 0.000" in words
    assert "Slope errors of the dome move directions and do not blur them" in words


def test_picture_of_an_instrument_that_sees_nothing():
    from gonio.plotting import resolution_map

    figure = resolution_map(resolve(rig(sensor={"centre_offset_px": (9000.0, 0.0)}), **QUICK))
    assert [ax.get_title() for ax in figure.axes[:2]] == [
        "Blur; ellipses show its shape, enlarged",
        "Coverage, lamp at normal incidence",
    ]


@pytest.mark.parametrize(
    ("words", "error", "text"),
    [
        (("--resolution",), ConfigurationError, "--resolution traces one instrument"),
        (("ideal12", "--map", "x.png"), ConfigurationError, "with --map OUT.png if you like"),
        (("ideal12", "--resolution", "--toml"), ConfigurationError, "without --toml, give one of"),
        (("ideal12", "--resolution", "--map", "x.gif"), ConfigurationError, "x.gif: pictures are"),
        (("ideal12", "--resolution", "--map", "no/x.png"), DataError, "the folder no does not"),
    ],
)
def test_mistakes_are_reported(words, error, text):
    with pytest.raises(error, match=text):
        raise run(*words).exception


# ---------------------------------------------------------------- true values of channels


@pytest.fixture(scope="module")
def colours(tmp_path_factory):
    """A session of two channels whose surfaces differ, on an instrument of 26 x 26 pixels."""
    folder = tmp_path_factory.mktemp("colours")
    filters = tuple(
        changed(preset("ideal12").channels[0], name=name, wavelength_nm=nm)
        for name, nm in (("red", 620.0), ("blue", 450.0))
    )
    small = {"rows": 26, "columns": 26, "pitch_um": (220.8, 220.8), "binning": 1}
    instrument = changed(rig(sensor=small), channels=filters)
    plan = default_plan(instrument, anisotropic=False)
    plan = changed(plan, theta_i_deg=(0.0, 30.0))
    simulate(
        model="lambert", parameters={"rho": [0.2, 0.6]}, instrument=instrument, plan=plan,
        output=folder / "session", seed=1,
    )  # fmt: skip
    return folder / "session"


def table(path, **column):
    lines = ["theta_i,phi_i,theta_r,phi_r,brdf" + "".join(f",{name}" for name in column)]
    for k in range(40):
        lines.append(
            f"30,0,{k + 10},{10 * k},{0.6 / np.pi}" + "".join(f",{v}" for v in column.values())
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def fitted(*words):
    return CliRunner().invoke(fit.command, [str(word) for word in (*words, "--model", "lambert")])


class TestTruthOfChannels:
    @pytest.mark.parametrize(("channel", "rho"), [("red", 0.2), ("blue", 0.6)])
    def test_is_that_of_the_channel_that_is_fitted(self, colours, channel, rho):
        done = fitted(colours, "--truth", colours, "--select", f"channel={channel}", "--json")
        document = json.loads(done.stdout)
        assert document["source"]["truth"] == {"rho": rho}
        assert document["parameters"]["rho"]["value"] == pytest.approx(rho, rel=0.03)

    @pytest.mark.parametrize("column", [{"channel": "blue"}, {"wavelength_nm": 450}])
    def test_is_found_for_samples_of_a_file(self, colours, tmp_path, column):
        done = fitted(table(tmp_path / "s.csv", **column), "--truth", colours, "--json")
        assert json.loads(done.stdout)["source"]["truth"] == {"rho": 0.6}

    @pytest.mark.parametrize(
        ("column", "text"),
        [
            ({}, "differ between the channels red, blue, and the samples are of no stated channel"),
            ({"channel": "green"}, "the samples are of channel green; give samples of one of"),
            ({"wavelength_nm": 500}, "the samples are of 500 nm; give samples of one of these"),
        ],
    )
    def test_is_refused_where_it_is_ambiguous(self, colours, tmp_path, column, text):
        done = fitted(table(tmp_path / "s.csv", **column), "--truth", colours)
        with pytest.raises(ConfigurationError, match=text):
            raise done.exception
