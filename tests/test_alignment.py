"""Alignment from the spots of a mirror: what is found, how surely, and what cannot be known."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import gonio
from gonio.calibration.dome import geometry_file
from gonio.calibration.dome.alignment import Alignment, fit
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.dome.spot_residuals import Length
from gonio.calibration.dome.spots import Spot, find_spots, locate, mirrored
from gonio.calibration.frames.exposure import Rate
from gonio.cli.calibrate_alignment import command
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import unit_vectors
from gonio.instrument import Instrument, preset
from gonio.instrument.plans import mirror_plan
from gonio.metadata import Camera, Geometry, LensCalibration, Limits, Plan, Uncertain
from gonio.session import Session

R, D = 150.0, 15.0
NOISE = 0.003  # px, what frames of 0.44 deg a pixel give
SHAPES = ["sphere", "ellipsoid"]
CAMERA = Camera(
    rows=416, columns=416, pitch_mm=(0.0138, 0.0138), gain_dn_per_e=1, black_dn=0,
    saturation_dn=4095, full_well_e=1e4, noise_dn=1, dark_e_per_s=0,
)  # fmt: skip
LENS = LensCalibration(
    projection="kannala_brandt", focal_length_mm=1.8, k=(-0.012, 0.004, -0.0015, 0.0002)
)
TRUE = {
    "R": R, "D": D + 0.3, "pupil_x": 0.3, "pupil_y": 0.0, "pupil_z": 0.5, "camera_azimuth": 0.8,
    "centre_x": 208.1, "centre_y": 206.9,
}  # fmt: skip

# Lamp angle and azimuth of the wedge, degrees.
TWELVE = [(t, p) for t in (-50.0, -20.0, 20.0, 50.0) for p in (0.0, 120.0, 240.0)]
LEVEL = [(t, 0.0) for t in (-75, -60, -50, -40, -25, -10, 10, 25, 40, 50, 60, 75)]
ONE_SIDE = [(t, 0.0) for t in range(5, 75, 6)]


def nominal(shape="ellipsoid", **geometry) -> PixelMap:
    dome = Geometry(**{"shape": shape, "R": R, "D": D, "usable_theta_r_deg": 80} | geometry)
    return PixelMap(CAMERA, LENS, dome, "exact")


def set_to(seen: PixelMap, figures) -> PixelMap:
    for name, value in figures.items():
        seen = seen.changed(name, value - seen.quantity(name))
    return seen


def made(true, frames=TWELVE, wedge_deg=15.0, *, noise=NOISE, seed=1, wedge_azimuth_deg=0.0):
    """Spots that a mirror would show, with noise on their places."""
    rng = np.random.default_rng(seed)
    spots = []
    for theta, psi in np.radians(frames):
        wedge = np.radians(wedge_deg)
        w = mirrored(theta, psi + np.radians(wedge_azimuth_deg), wedge)
        at = np.array(true.pixels(w)) + noise * rng.standard_normal(2)
        name = f"{np.degrees(theta):g}/{np.degrees(psi):g}"
        spots.append(Spot(name, theta, psi, wedge, at, max(noise, 1e-4) ** 2 * np.eye(2)))
    return spots


def truth(shape, **changed):
    figures = TRUE | ({"pupil_y": -0.2} if shape == "ellipsoid" else {}) | changed
    return figures, set_to(nominal(shape), figures)


class TestMirror:
    def test_the_law_of_reflection(self):
        rng = np.random.default_rng(1)
        theta, psi, wedge = rng.uniform((-1.2, 0, 0), (1.2, 6, 0.4), (50, 3)).T
        w = mirrored(theta, psi, wedge)
        w_i, n = unit_vectors(theta, 0.0), unit_vectors(wedge, psi)
        half = w + w_i
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        np.testing.assert_allclose(half, n, atol=1e-12)
        np.testing.assert_allclose(np.sum(w * n, axis=1), np.sum(w_i * n, axis=1), atol=1e-12)


class TestFit:
    @pytest.mark.parametrize("shape", SHAPES)
    def test_without_noise_every_figure_comes_back(self, shape):
        figures, true = truth(shape)
        spots = made(true, noise=0.0, wedge_azimuth_deg=1.5)
        found = fit(spots, nominal(shape), R=Length(R, 0.1))
        assert found.rms_px < 1e-6
        for name, value in figures.items():
            assert found.values[name] == pytest.approx(value, abs=1e-4), name
        assert found.values["wedge"] == pytest.approx(15.0, abs=1e-5)
        assert found.values["wedge_azimuth"] == pytest.approx(1.5, abs=1e-4)

    @pytest.mark.parametrize("shape", SHAPES)
    def test_twelve_frames_are_as_good_as_is_asked(self, shape):
        figures, true = truth(shape)
        found = fit(made(true), nominal(shape), R=Length(R, 0.01))
        assert found.sd["pupil_z"] < 0.05 / 10
        assert found.values["pupil_z"] == pytest.approx(figures["pupil_z"], abs=0.05)
        for name in ("R", "D"):
            assert found.sd[name] < 1e-3 * figures[name]
            assert found.values[name] == pytest.approx(figures[name], abs=4 * found.sd[name])
        # What a reduction uses: the directions.
        at = np.random.default_rng(2).uniform(120, 300, (2, 200))
        apart = found.pixel_map.directions(*at) - true.directions(*at)
        assert np.degrees(np.linalg.norm(apart, axis=1)).max() < 0.01

    @pytest.mark.parametrize("shape", SHAPES)
    def test_errors_are_as_large_as_stated(self, shape):
        figures, true = truth(shape)
        distances = []
        for seed in range(12):
            found = fit(made(true, seed=seed), nominal(shape), R=Length(R, 1e-3))
            names = [n for n in found.uncertain.names if n != "R"]
            keep = [found.uncertain.names.index(n) for n in names]
            c = np.array(found.uncertain.covariance)[np.ix_(keep, keep)]
            off = np.array([found.values[n] - figures[n] for n in names])
            distances.append(off @ np.linalg.solve(c, off) / len(names))
        # Mean of 12 chi-squares of 6 or 7 degrees of freedom; where chance makes residuals large
        # the uncertainties are widened, never narrowed, which costs some 10 to 20 %.
        assert 0.5 < np.mean(distances) < 1.3

    def test_slope_errors_of_the_dome_widen_the_uncertainties(self):
        figures, true = truth("ellipsoid")
        limits = Limits(slope_error_deg=0.03, slope_correlation_deg=10.0)
        spots = made(true)
        rng = np.random.default_rng(7)
        distances = []
        for _ in range(10):
            # Directions turn by 2 e, in this draw alike for spots that are close.
            w = np.array([mirrored(s.theta_i, s.psi, s.wedge) for s in spots])
            apart = np.linalg.norm(w[:, None] - w, axis=-1) / np.radians(10.0)
            root = np.linalg.cholesky(np.exp(-(apart**2) / 2) + 1e-12 * np.eye(len(w)))
            e = 2 * np.radians(0.03) * root @ rng.standard_normal((len(w), 2))
            t_x = np.array([1.0, 0, 0]) - w[:, :1] * w
            t_x /= np.linalg.norm(t_x, axis=1, keepdims=True)
            seen = w + e[:, :1] * t_x + e[:, 1:] * np.cross(w, t_x)
            seen /= np.linalg.norm(seen, axis=1, keepdims=True)
            places = np.stack(true.pixels(seen), axis=1)
            moved = [replace(s, at=at) for s, at in zip(spots, places, strict=True)]
            found = fit(moved, nominal(), limits=limits, R=Length(R, 0.1))
            assert found.chi2 / found.dof < 3
            names = [n for n in found.uncertain.names if n != "R"]
            keep = [found.uncertain.names.index(n) for n in names]
            c = np.array(found.uncertain.covariance)[np.ix_(keep, keep)]
            off = np.array([found.values[n] - figures[n] for n in names])
            distances.append(off @ np.linalg.solve(c, off) / len(names))
        assert 0.5 < np.mean(distances) < 1.3

    def test_the_lens_calibrations_covariance_is_carried_along(self, tmp_path):
        _, true = truth("ellipsoid")
        start = nominal()
        doubtful = Uncertain(names=("focal_length", "k1"), covariance=((1e-4, 0.0), (0.0, 1e-4)))
        lens = start.lens.model_copy(update={"uncertain": doubtful})
        sure = fit(made(true), start, R=Length(R, 0.01))
        unsure = fit(made(true), replace(start, lens=lens), R=Length(R, 0.01))
        for name in ("D", "pupil_z", "centre_y"):
            assert unsure.sd[name] > sure.sd[name]
        # The spots know the lens better than that: it is fitted with them.
        assert unsure.sd["focal_length"] < 0.003
        assert unsure.values["focal_length"] != start.quantity("focal_length")
        geometry_file.write(tmp_path / "g.toml", unsure, instrument="ideal12", lost={})
        content = geometry_file.read(tmp_path / "g.toml").content
        assert content.lens.focal_length_mm == unsure.values["focal_length"]
        assert content.lens.k[0] == unsure.values["k1"]
        assert {"focal_length", "k1"} < set(content.uncertain.names)

    def test_an_outlier_is_dropped_and_named(self):
        _, true = truth("ellipsoid")
        spots = made(true)
        spots[4] = replace(spots[4], at=spots[4].at + np.array([0.4, 0.0]))
        found = fit(spots, nominal(), R=Length(R, 0.01))
        assert list(found.dropped) == [spots[4].name]
        assert found.dropped[spots[4].name].endswith(" standard deviations off")
        assert len(found.names) == 11
        assert found.scale < 1.5

    def test_residuals_larger_than_stated_widen_the_uncertainties(self):
        _, true = truth("ellipsoid")
        small = [replace(s, covariance=s.covariance / 9) for s in made(true)]
        a, b = (fit(s, nominal(), R=Length(R, 0.01)) for s in (made(true), small))
        assert b.scale > 1.5
        expected = a.sd["pupil_z"] / a.scale / 3 * b.scale
        assert b.sd["pupil_z"] == pytest.approx(expected, rel=0.01)
        # A length that was measured otherwise keeps its own uncertainty.
        assert b.sd["R"] == pytest.approx(0.01, rel=1e-3)


class TestWhatCanBeKnown:
    def fitted(self, shape, frames, wedge_deg, **lengths) -> Alignment:
        return fit(made(truth(shape)[1], frames, wedge_deg), nominal(shape), **lengths)

    def test_without_a_length_only_ratios(self):
        found = self.fitted("ellipsoid", TWELVE, 15.0)
        assert found.sd["R"] is None
        assert found.values["R"] == R
        assert "D" in found.held_for["R"]
        assert "R" not in found.uncertain.names
        # The others are in proportion to it, and so is their uncertainty.
        longer = self.fitted("ellipsoid", TWELVE, 15.0, R=Length(1.1 * R, 1e-4))
        for name in ("D", "pupil_y", "pupil_z"):
            assert longer.values[name] == pytest.approx(1.1 * found.values[name], rel=1e-5)
            assert longer.sd[name] == pytest.approx(1.1 * found.sd[name], rel=1e-3)
        assert longer.values["centre_y"] == pytest.approx(found.values["centre_y"], abs=1e-5)

    def test_a_known_r_scales_into_d(self):
        found = self.fitted("sphere", TWELVE, 15.0, R=Length(R, 1.5))
        # 1 % of R is 1 % of D.
        assert found.sd["D"] == pytest.approx(0.01 * found.values["D"], rel=0.01)

    def test_a_known_separation_gives_r(self):
        apart = 2 * TRUE["D"] + 0.2
        found = self.fitted("ellipsoid", TWELVE, 15.0, separation=Length(apart, 0.003))
        assert found.sd["R"] is not None
        assert found.values["R"] == pytest.approx(R, abs=4 * found.sd["R"])
        assert found.sd["R"] < 1.5e-3 * R

    @pytest.mark.parametrize(("frames", "wedge_deg"), [(LEVEL, 0.0), (TWELVE, 15.0)])
    def test_on_a_sphere_d_stands_for_the_cameras_distance(self, frames, wedge_deg):
        found = self.fitted("sphere", frames, wedge_deg, R=Length(R, 0.01))
        assert found.held_for == {"pupil_y": ("D",)}
        assert found.sd["pupil_y"] is None
        assert found.values["pupil_y"] == 0.0
        assert found.sd["D"] < 1e-3 * D

    def test_a_separation_tells_them_apart_on_a_sphere_too(self):
        figures, true = truth("sphere", pupil_y=-0.4)
        apart = np.hypot(2 * figures["D"] + 0.4, figures["pupil_x"])
        found = fit(
            made(true), nominal("sphere"), R=Length(R, 0.01), separation=Length(apart, 0.01)
        )
        assert found.held_for == {}
        assert found.values["pupil_y"] == pytest.approx(-0.4, abs=4 * found.sd["pupil_y"])
        assert found.sd["pupil_y"] < 0.05

    def test_a_level_mirror_leaves_the_foci_of_an_ellipsoid_open(self):
        level = self.fitted("ellipsoid", LEVEL, 0.0, R=Length(R, 0.01))
        assert level.held_for == {"pupil_y": ("D",)}
        wedge = self.fitted("ellipsoid", TWELVE, 15.0, R=Length(R, 0.01))
        assert wedge.held_for == {}
        assert wedge.sd["pupil_y"] < 0.05
        # A steeper wedge tells them apart better.
        flatter = self.fitted("ellipsoid", TWELVE, 5.0, R=Length(R, 0.01))
        assert flatter.sd["pupil_y"] > 2 * wedge.sd["pupil_y"]

    def test_the_lamp_on_one_side_is_a_much_poorer_witness(self):
        one = self.fitted("sphere", ONE_SIDE, 0.0, R=Length(R, 0.01))
        both = self.fitted("sphere", LEVEL, 0.0, R=Length(R, 0.01))
        assert len(one.names) == len(both.names) == 12
        for name in ("D", "pupil_x", "pupil_z", "camera_azimuth"):
            assert one.sd[name] > 2.5 * both.sd[name]

    def test_a_wedges_azimuth_is_free_of_the_cameras(self):
        found = self.fitted("sphere", TWELVE, 15.0, R=Length(R, 0.01))
        assert found.sd["wedge_azimuth"] < 0.01
        assert found.sd["camera_azimuth"] < 0.01
        assert "wedge_azimuth" not in self.fitted("sphere", LEVEL, 0.0).values


class TestRefusals:
    def test_mirrored_pictures_are_reported(self):
        _, true = truth("ellipsoid")
        for axis, sides in ((0, "left and right"), (1, "top and bottom")):
            sign = np.where(np.arange(2) == axis, -1, 1)
            flipped = [replace(s, at=207.5 + sign * (s.at - 207.5)) for s in made(true)]
            message = f"the spots fit only when {sides} of the frames are exchanged: columns must"
            with pytest.raises(DataError, match=message):
                fit(flipped, nominal(), R=Length(R, 0.01))

    def test_too_few_spots(self):
        _, true = truth("ellipsoid")
        message = r"4 spots cannot determine 10 quantities; take frames of a mirror until at"
        with pytest.raises(DataError, match=message):
            fit(made(true, TWELVE[:4]), nominal(), R=Length(R, 0.01), separation=Length(30, 0.1))

    def test_wedges_of_two_kinds(self):
        _, true = truth("ellipsoid")
        spots = made(true, wedge_deg=10.0) + made(true, wedge_deg=15.0)
        with pytest.raises(
            ConfigurationError, match=r"hold wedges of 10 and 15 deg; give those of"
        ):
            fit(spots, nominal())
        # One wedge and a level mirror go together.
        fit(made(true, LEVEL, 0.0) + made(true), nominal(), R=Length(R, 0.01))

    def test_nonsense_runs_away(self):
        _, true = truth("ellipsoid")
        rng = np.random.default_rng(3)
        spots = [replace(s, at=s.at + 10 * rng.standard_normal(2)) for s in made(true)]
        with pytest.raises(DataError, match=r"the fit (runs away in .*|fails), with residuals of"):
            fit(spots, nominal(), R=Length(R, 0.01))

    @pytest.mark.parametrize(("value", "u"), [(0.0, 0.1), (150.0, 0.0), (150.0, -1.0)])
    def test_a_length_without_an_uncertainty(self, value, u):
        with pytest.raises(ConfigurationError, match=r"both must be positive"):
            Length(value, u)

    def test_a_spot_outside_the_image_circle(self):
        _, true = truth("ellipsoid")
        spots = made(true)
        spots[0] = replace(spots[0], at=np.array([2.0, 2.0]))
        with pytest.raises(DataError, match=r"a spot lies outside the image circle of the lens"):
            fit(spots, nominal())


def rate(value, saturated=()) -> Rate:
    """An image of 1 s with a read noise of 3 e-."""
    clipped = np.zeros(value.shape, bool)
    for place in saturated:
        clipped[place] = True
    time = np.where(clipped, 0.0, 1.0)
    return Rate(np.where(clipped, 0, value), time, np.full(value.shape, 9.0), clipped)


def disc(centre, radius=2.3, level=5000.0, shape=(40, 50)):
    """A uniform disc seen by pixels, as 25 x 25 points in each."""
    fine = (np.arange(25) + 0.5) / 25 - 0.5
    x = (np.arange(shape[1])[:, None] + fine).ravel() - centre[0]
    y = (np.arange(shape[0])[:, None] + fine).ravel() - centre[1]
    inside = (x**2 + y[:, None] ** 2 < radius**2).reshape(shape[0], 25, shape[1], 25)
    return level * inside.mean(axis=(1, 3))


class TestLocate:
    INSIDE = np.ones((40, 50), bool)
    DARK = np.full((40, 50), 20.0)

    def seen(self, image, **options):
        return locate(rate(image + self.DARK, **options), rate(self.DARK), self.INSIDE)

    def test_the_centroid_scatters_as_stated(self):
        rng = np.random.default_rng(4)
        true = np.array([21.3, 17.8])
        clean = disc(true) + self.DARK
        off, stated = [], []
        for _ in range(300):
            image = rng.poisson(clean) + rng.normal(0, 3, clean.shape)
            dark = rng.poisson(self.DARK) + rng.normal(0, 3, clean.shape)
            at, covariance = locate(rate(image), rate(dark), self.INSIDE)
            off.append(at - true)
            stated.append(np.diag(covariance))
        bias, scatter = np.mean(off, axis=0), np.var(off, axis=0)
        # Pixels see the disc's sharp edge coarsely: some thousandths of a pixel.
        assert np.abs(bias).max() < 0.01
        np.testing.assert_allclose(scatter, np.mean(stated, axis=0), rtol=4 * np.sqrt(2 / 300))

    def test_what_is_no_spot_is_named(self):
        assert self.seen(0 * self.DARK) == "no spot"
        spot = disc((21.0, 17.0))
        assert self.seen(spot, saturated=[(17, 21), (18, 21)]) == "saturated in 2 pixels"
        assert self.seen(spot + disc((35.0, 30.0), level=2000)) == "2 spots"
        assert self.seen(disc((2.0, 17.0))) == "at the edge of the image"
        inside = self.INSIDE.copy()
        inside[:, 23:] = False
        assert locate(rate(spot), rate(0 * spot), inside) == "at the edge of the image"
        stuck = locate(rate(spot), rate(0 * spot, saturated=[(17, 21)]), self.INSIDE)
        assert stuck == "on a pixel that is saturated without the mirror"

    def test_a_faint_ghost_does_not_disturb(self):
        at, _ = self.seen(disc((21.0, 17.0)) + disc((35.0, 30.0), level=400))
        np.testing.assert_allclose(at, (21, 17), atol=0.01)


# ---------------------------------------------------------------- with frames


def rig(**lens) -> Instrument:
    """ideal12 with a lamp that has a size, and fewer rays."""
    ideal = preset("ideal12")
    coarse = {"rows": 832, "columns": 832, "pitch_um": (6.9, 6.9), "binning": 2}
    parts = {
        "lamp": ideal.lamp.model_copy(update={"half_angle_deg": 0.5}),
        "sensor": ideal.sensor.model_copy(update=coarse),
        "lens": ideal.lens.model_copy(update=lens),
        "rays_per_pixel": 8,
    }
    return ideal.model_copy(update=parts)


ASKEW = {"pupil_offset_mm": (0.3, -0.2, 0.5), "azimuth_deg": 0.4}


@pytest.fixture(scope="module")
def askew(tmp_path_factory) -> Session:
    """Twelve frames of a mirror before a camera that stands askew; the session does not know."""
    instrument = rig(**ASKEW)
    plan = mirror_plan(instrument, wedge_deg=15.0).model_copy(
        update={"theta_i_deg": (-50.0, -20.0, 20.0, 50.0), "rotations_deg": (0.0, 120.0, 240.0)}
    )
    path = tmp_path_factory.mktemp("mirror") / "session"
    return gonio.simulate(output=path, instrument=instrument, plan=plan, seed=3)


def run(*words) -> None:
    command.main([str(word) for word in words], standalone_mode=False)


class TestFrames:
    def test_spots_are_found_to_thousandths_of_a_pixel(self, askew):
        seen = PixelMap.of(askew.metadata, "exact")
        spots, lost = find_spots(askew, seen)
        assert lost == {}
        assert len(spots) == 12
        true = set_to(
            seen, {"pupil_x": 0.3, "pupil_y": -0.2, "pupil_z": 0.5, "camera_azimuth": 0.4}
        )
        for spot in spots:
            off = spot.at - np.array(true.pixels(mirrored(spot.theta_i, spot.psi, spot.wedge)))
            # Noise of 0.002, and the frames are made of some thousand rays a pixel.
            assert np.abs(off).max() < 0.012, spot.name
            assert 0.001 < np.sqrt(np.diag(spot.covariance)).max() < 0.004

    def test_the_alignment_is_found(self, askew):
        seen = PixelMap.of(askew.metadata, "exact")
        spots, _ = find_spots(askew, seen)
        found = fit(spots, seen, limits=askew.metadata.limits, R=Length(R, 0.03))
        expected = {"R": R, "D": D, "pupil_x": 0.3, "pupil_y": -0.2, "pupil_z": 0.5,
                    "camera_azimuth": 0.4, "centre_x": 207.5, "centre_y": 207.5}  # fmt: skip
        for name, value in expected.items():
            assert found.values[name] == pytest.approx(value, abs=4 * found.sd[name]), name
        assert found.sd["D"] < 1.5e-3 * D
        assert found.values["D"] == pytest.approx(D, rel=2e-3)
        assert found.values["pupil_z"] == pytest.approx(0.5, abs=0.05)
        assert found.sd["pupil_z"] < 0.01
        assert found.rms_px < 0.01

    def test_the_file_puts_a_reduction_right(self, askew, tmp_path, capsys):
        target = tmp_path / "geometry.toml"
        run(askew.path, "-o", target, "--R-mm", "150", "--u-R-mm", "0.05")
        out = capsys.readouterr().out
        assert "12 spots, residuals of 0.00" in out
        assert "not determined" not in out
        instrument = rig(**ASKEW)
        plan = Plan(theta_i_deg=(0.0, 30.0, 60.0), rotations_deg=(30.0,), exposures_s=(1e-3, 8e-3))
        true = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.05, "alpha_y": 0.15}
        session = gonio.simulate(
            model="ward", parameters=true, output=tmp_path / "s", instrument=instrument, plan=plan
        )
        error, stderr = {}, {}
        for how, path in (("as stated", None), ("aligned", target)):
            samples = gonio.reduce(session, mapping="exact", geometry=path)
            result = gonio.fit(samples, model="ward").parameters
            stderr[how] = {n: result[n].stderr / true[n] for n in true}
            error[how] = {n: abs(result[n].value / true[n] - 1) for n in true}
        # A degree of misalignment spoils the fit: it is off by what a rig that is aligned would
        # not be. Aligned, it is within its uncertainty. (That of the fit as stated allows for the
        # misfit and is larger.)
        assert max(error["as stated"][n] / stderr["aligned"][n] for n in true) > 5
        assert max(error["aligned"][n] / stderr["aligned"][n] for n in true) < 4
        assert max(stderr["as stated"].values()) > 2 * max(stderr["aligned"].values())
        assert max(stderr["aligned"].values()) < 0.01
        modes = [t.name for t in samples.shared if t.name.startswith("geometry, mode")]
        assert 3 <= len(modes) <= 8
        assert "unknown, not included: lens calibration (lens.uncertain)" in samples.history
        assert "pupil displaced by (0.3" in samples.history[2]

    def test_the_document_says_what_is_not_known(self, askew, tmp_path, capsys):
        target = tmp_path / "geometry.toml"
        run(askew.path, "-o", target, "--json")
        document = json.loads(capsys.readouterr().out)
        assert document["schema"] == "gonio.calibrate.alignment/1"
        assert document["figures"]["R"] == {"value": 150.0, "stderr": None, "unit": "mm"}
        assert document["figures"]["centre_x"]["unit"] == "px"
        assert list(document["not_determined"]) == ["R"]
        assert document["spots"] == 12
        assert document["not_used"] == {}
        content = tomllib.loads(target.read_text())
        assert content["schema"] == "gonio.geometry/1"
        assert list(content["not_determined"]) == ["R"]
        assert "R" not in content["uncertain"]["names"]
        assert geometry_file.read(target).held == ("R",)
        run(askew.path, "-o", target)
        out = capsys.readouterr().out
        assert "not determined: no length is known; the others are in proportion to it" in out
        assert "The lens is taken as exact: the uncertainty of its calibration is unknown." in out
        assert document["lens_uncertainty_known"] is False

    def test_saturated_and_missing_spots_are_named(self, askew, tmp_path, capsys, monkeypatch):
        straight = Session.bracket

        def spoilt(self, role, take, incidence, **of):
            frames = straight(self, role, take, incidence, **of)
            if role != "sample" or take:
                return frames
            if incidence == 0:
                return np.where(frames > 4000, np.uint16(65535), frames)
            if incidence == 1:
                return np.minimum(frames, np.uint16(self.metadata.camera.black_dn))
            return frames

        monkeypatch.setattr(Session, "bracket", spoilt)
        run(askew.path, "-o", tmp_path / "g.toml", "--R-mm", "150", "--u-R-mm", "0.05")
        out = capsys.readouterr().out
        assert "not used: theta_i = -50 deg, rotation 0 deg: saturated in " in out
        assert "not used: theta_i = -20 deg, rotation 0 deg: no spot." in out
        assert "10 spots" in out
        content = tomllib.loads((tmp_path / "g.toml").read_text())
        assert content["fit"]["not_used"]["theta_i = -20 deg, rotation 0 deg"] == "no spot"

    def test_a_wide_lamp_does_not_pull_the_spots(self, tmp_path):
        """A cone of 2 deg, whose centroid is not the image of its middle."""
        wide = rig()
        wide = wide.model_copy(
            update={"lamp": wide.lamp.model_copy(update={"half_angle_deg": 2.0})}
        )
        plan = mirror_plan(wide).model_copy(update={"theta_i_deg": (-65.0, 55.0)})
        session = gonio.simulate(output=tmp_path / "s", instrument=wide, plan=plan)
        seen = PixelMap.of(session.metadata, "exact")
        spots, _ = find_spots(session, seen)
        for spot in spots:
            at = np.array(seen.pixels(mirrored(spot.theta_i, 0.0, 0.0)))
            # The lens loses a quarter per radian towards the rim, which is not known here.
            assert np.abs(spot.at - at).max() < 0.02


class TestCommand:
    def test_a_length_needs_its_uncertainty(self, askew, tmp_path):
        target = tmp_path / "g.toml"
        with pytest.raises(ConfigurationError, match=r"--R-mm needs --u-R-mm: a known length is"):
            run(askew.path, "-o", target, "--R-mm", "150")
        with pytest.raises(ConfigurationError, match=r"--u-separation-mm needs --separation-mm"):
            run(askew.path, "-o", target, "--u-separation-mm", "0.1")

    def test_the_file_is_toml(self, askew, tmp_path):
        with pytest.raises(ConfigurationError, match=r"a geometry is written as TOML; give a name"):
            run(askew.path, "-o", tmp_path / "g.json")

    def test_a_session_of_a_sample_is_refused(self, tmp_path):
        plan = Plan(theta_i_deg=(0.0,), rotations_deg=(0.0,), exposures_s=(1e-3,))
        session = gonio.simulate(
            model="lambert",
            output=tmp_path / "s",
            instrument=rig().model_copy(update={"rays_per_pixel": 1}),
            plan=plan,
        )
        with pytest.raises(ConfigurationError, match=r"shows lambert, not a mirror; an alignment"):
            run(session.path, "-o", tmp_path / "g.toml")

    def test_sessions_of_two_instruments_are_refused(self, askew, tmp_path):
        other = askew.metadata.model_copy(update={"instrument": "other"})
        session = Session.create(tmp_path / "s", other)
        with pytest.raises(ConfigurationError, match=r"of another instrument, camera or lens than"):
            run(askew.path, session.path, "-o", tmp_path / "g.toml")

    def test_two_sessions_of_one_instrument_go_together(self, askew, tmp_path, capsys):
        plan = mirror_plan(rig(**ASKEW)).model_copy(update={"theta_i_deg": (-40.0, 30.0)})
        level = gonio.simulate(output=tmp_path / "level", instrument=rig(**ASKEW), plan=plan)
        run(askew.path, level.path, "-o", tmp_path / "g.toml")
        assert "14 spots" in capsys.readouterr().out


class TestFile:
    @pytest.fixture
    def path(self, tmp_path):
        found = fit(made(truth("ellipsoid")[1]), nominal(), R=Length(R, 0.01))
        path = tmp_path / "geometry.toml"
        geometry_file.write(path, found, instrument="ideal12", lost={'"odd" name': "no spot"})
        return path

    def test_it_holds_what_was_fitted(self, path):
        found = fit(made(truth("ellipsoid")[1]), nominal(), R=Length(R, 0.01))
        back = geometry_file.read(path)
        assert back.uncertain == found.uncertain
        assert back.held == ()
        dome = back.content.geometry
        assert found.values["R"] == dome.R
        assert found.values["D"] == dome.D
        assert back.content.lens is None
        assert back.content.fit["not_used"] == {'"odd" name': "no spot"}

    def test_it_is_put_into_a_sessions_metadata(self, path, askew):
        metadata = askew.metadata
        doubtful = Uncertain(names=("k1", "centre_x"), covariance=((1e-6, 1e-6), (1e-6, 0.04)))
        lens = metadata.lens.model_copy(update={"uncertain": doubtful})
        metadata = metadata.model_copy(update={"lens": lens})
        back = geometry_file.read(path)
        applied = back.applied(metadata)
        assert applied.geometry.pupil_mm[2] == pytest.approx(0.5, abs=0.01)
        assert applied.geometry.usable_theta_r_deg == metadata.geometry.usable_theta_r_deg
        assert applied.lens.centre_px == back.content.frame.centre_px
        assert applied.lens.k == metadata.lens.k
        # The centre is in the joint covariance now.
        assert applied.lens.uncertain == Uncertain(names=("k1",), covariance=((1e-6,),))
        assert applied.geometry.uncertain is None

    @pytest.mark.parametrize(
        ("old", "new", "error", "message"),
        [
            ('"ideal12"', '"other"', ConfigurationError, r"the geometry of other, and the session"),
            (
                "rows = 416",
                "rows = 832",
                ConfigurationError,
                r"of 416 x 832 pixels and the session",
            ),
            ('"ellipsoid"', '"sphere"', ConfigurationError, r"belongs to a dome that is a sphere,"),
            ("geometry/1", "geometry/9", DataError, r"schema 'gonio.geometry/9' is not 'gonio"),
            ("[frame]", "[[frame", DataError, r"not valid TOML"),
            ('"R"', '"Q"', DataError, r"uncertain names Q\."),
            ("rows = 416", "row = 416", DataError, r"frame.rows: Field required"),
        ],
    )
    def test_what_does_not_belong_is_refused(self, path, askew, old, new, error, message):
        path.write_text(path.read_text().replace(old, new))
        with pytest.raises(error, match=message):
            geometry_file.read(path).applied(askew.metadata)

    def test_a_missing_file_is_named(self, tmp_path):
        with pytest.raises(DataError, match=r"geometry.toml: cannot be read as text"):
            geometry_file.read(tmp_path / "geometry.toml")
