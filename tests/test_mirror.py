"""A mirror in place of the sample: the lamp's image lies where the law of reflection puts it."""

from types import MappingProxyType

import numpy as np
import pytest

import gonio
from gonio.calibration.reflector import solid_angle_ratio
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import unit_vectors
from gonio.instrument import Instrument, imaging, mirror, preset
from gonio.instrument.plans import mirror_plan
from gonio.metadata import Plan
from gonio.session import Session, read_truth

SEED = 5


def small(name="ideal12", n=208, **parts) -> Instrument:
    """A preset with n x n pixels over the same image circle, parts changed as given."""
    rig = preset(name)
    pitch = rig.sensor.columns * rig.sensor.pitch_um[0] / n
    sensor = {"rows": n, "columns": n, "pitch_um": (pitch, pitch), "binning": 1}
    parts["sensor"] = sensor | parts.get("sensor", {})
    changed = {part: getattr(rig, part).model_dump() | new for part, new in parts.items()}
    return Instrument.model_validate(rig.model_dump() | changed)


def spot(rig, theta_i_deg, wedge_deg=0.0, psi_deg=0.0):
    """Noise-free image of the lamp (rows, columns), and the rays."""
    rays = imaging.trace_rays(rig, SEED)
    rate = np.zeros(rig.sensor.shape)
    rate.ravel()[rays.pixel] = mirror.spot_rate(
        rig, rays, np.radians(theta_i_deg), wedge=np.radians(wedge_deg), psi=np.radians(psi_deg),
        seed=SEED,
    )  # fmt: skip
    return rate, rays


def centroid(image):
    rows, columns = np.indices(image.shape)
    return np.array([np.sum(columns * image), np.sum(rows * image)]) / image.sum()


def reflected(theta_i_deg, wedge_deg=0.0, psi_deg=0.0):
    """Direction into which a plane mirror sends the light of the lamp."""
    w, n = unit_vectors(np.radians([theta_i_deg, wedge_deg]), np.radians([0.0, psi_deg]))
    return 2 * (w @ n) * n - w


class TestSpot:
    RIG = small(lamp={"half_angle_deg": 1.0})

    @pytest.mark.parametrize("theta_i_deg", [-50.0, 0.0, 20.0, 65.0])
    def test_its_centroid_is_that_of_a_million_chief_rays(self, theta_i_deg):
        image, _ = spot(self.RIG, theta_i_deg)
        rows, columns = np.nonzero(image)
        # 40 x 40 chief rays in every pixel around, followed without pupil and pattern.
        x, y = self.RIG.sensor.positions_mm()
        step = (np.arange(40) - 19.5) / 40 * (x[1] - x[0])
        box = np.s_[rows.min() - 2 : rows.max() + 3, columns.min() - 2 : columns.max() + 3]
        fine_y = (y[box[0], None] + step).ravel()[:, None]
        fine_x = (x[box[1], None] + step).ravel()[None, :]
        lens, dome = self.RIG.lens, self.RIG.dome
        theta_c = lens.polar_angle(np.hypot(fine_x, fine_y))
        seen = unit_vectors(*dome.reflected_angles(theta_c, np.arctan2(fine_y, fine_x)))
        inside = seen @ reflected(theta_i_deg) >= np.cos(np.radians(1.0))
        ny, nx = len(y[box[0]]), len(x[box[1]])
        share = inside.reshape(ny, 40, nx, 40).mean(axis=(1, 3))
        rays = imaging.trace_rays(self.RIG, SEED)
        throughput = np.zeros(image.shape)
        throughput.ravel()[rays.pixel] = rays.throughput
        expected = np.zeros(image.shape)
        expected[box] = share * throughput[box]
        assert np.linalg.norm(centroid(image) - centroid(expected)) < 0.02
        # And the whole picture: 2048 rays a pixel leave some 1 % of a pixel's light.
        np.testing.assert_allclose(image / image.max(), expected / expected.max(), atol=0.03)

    @pytest.mark.parametrize("name", ["modern12", "lbl1992"])
    @pytest.mark.parametrize(
        ("theta_i_deg", "wedge_deg", "psi_deg"),
        [(0.0, 0.0, 0.0), (45.0, 0.0, 0.0), (-30.0, 8.0, 90.0), (45.0, 12.0, 200.0)],
    )
    def test_the_pixels_that_see_it_look_where_it_is(self, name, theta_i_deg, wedge_deg, psi_deg):
        # Slope errors of the dome are in what the pixels look at, and in the spot.
        rig = small(name, lamp={"half_angle_deg": 1.5})
        image, rays = spot(rig, theta_i_deg, wedge_deg, psi_deg)
        weight = image.ravel()[rays.pixel] / rays.throughput
        w = weight @ rays.w_r.mean(axis=1)
        w /= np.linalg.norm(w)
        away = np.degrees(np.arccos(w @ reflected(theta_i_deg, wedge_deg, psi_deg)))
        # Pixels of 0.9 deg that are not even in solid angle.
        assert away < 0.1

    def test_shows_the_radiance_of_the_source(self):
        image, rays = spot(self.RIG, 30.0)
        white = np.zeros(image.shape)
        white.ravel()[rays.pixel] = imaging.white_rate(self.RIG, rays)
        full = 0.9 / np.sin(np.radians(1.0)) ** 2
        assert (image[white > 0] / white[white > 0]).max() == pytest.approx(full, rel=1e-12)
        assert image.max() <= mirror.brightest_rate(self.RIG, rays)

    def test_covers_the_solid_angle_of_the_source(self):
        image, rays = spot(self.RIG, 30.0)
        share = image.ravel()[rays.pixel] / imaging.white_rate(self.RIG, rays)
        share *= np.sin(np.radians(1.0)) ** 2 / 0.9
        x, y = (g.ravel()[rays.pixel] for g in np.meshgrid(*self.RIG.sensor.positions_mm()))
        theta_c, phi_c = self.RIG.lens.polar_angle(np.hypot(x, y)), np.arctan2(y, x)
        pitch = self.RIG.sensor.positions_mm()[0][1] - self.RIG.sensor.positions_mm()[0][0]
        at_camera = self.RIG.lens.solid_angle(theta_c) * (pitch / 1.8) ** 2
        seen = np.sum(share * at_camera * solid_angle_ratio(theta_c, phi_c, R=150.0, D=15.0))
        # Eq. (3)'s Jacobian is good to (D/R)^2.
        assert seen == pytest.approx(2 * np.pi * (1 - np.cos(np.radians(1.0))), rel=0.02)

    def test_is_as_bright_at_any_angle_and_on_either_side(self):
        # A mirror keeps radiance; the dome is the same left and right.
        a, b = (spot(self.RIG, angle)[0] for angle in (-40.0, 40.0))
        assert a.sum() == pytest.approx(b.sum(), rel=0.01)
        left, right = centroid(a), centroid(b)
        assert left[0] == pytest.approx(207 - right[0], abs=0.02)
        assert left[1] == pytest.approx(right[1], abs=0.02)

    def test_a_turn_does_nothing_to_a_level_mirror(self):
        a, b = (spot(self.RIG, 30.0, 0.0, psi)[0] for psi in (0.0, 120.0))
        # Rays on the source's edge may fall to either side.
        np.testing.assert_allclose(a, b, atol=2e-3 * a.max())

    def test_a_small_mirror_shows_less(self):
        rig = small(
            dome={"shape": "sphere", "D": 22.5}, lamp={"half_angle_deg": 1.0},
            holder={"sample_diameter_mm": 0.5},
        )  # fmt: skip
        assert spot(rig, 45.0)[0].sum() < 0.5 * spot(self.RIG, 45.0)[0].sum()

    def test_a_tilted_holder_tilts_the_mirror(self):
        rig = small(
            lamp={"half_angle_deg": 1.0}, holder={"tilt_deg": 4.0, "tilt_azimuth_deg": 90.0}
        )
        a, b = spot(rig, 20.0)[0], spot(self.RIG, 20.0, 4.0, 90.0)[0]
        np.testing.assert_allclose(a, b, atol=2e-3 * a.max())

    def test_a_point_source_has_no_picture(self):
        with pytest.raises(ConfigurationError, match=r"lamp of ideal12 is a point .* half-angle"):
            spot(small(), 0.0)


def as_stated():
    """A rig whose lamp's cone is as stated: a wider one would make the spots weaker."""
    return small("modern12", n=104, lamp={"half_angle_deg": 1.5, "half_angle_uncertainty": 0.0})


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    rig = as_stated()
    plan = mirror_plan(rig, wedge_deg=10.0)
    fewer = {"theta_i_deg": (-75.0, -30.0, 0.0, 45.0), "rotations_deg": (0.0, 90.0, 225.0)}
    path = tmp_path_factory.mktemp("mirror") / "mirror.gonio"
    return gonio.simulate(output=path, instrument=rig, plan=plan.model_copy(update=fewer), seed=3)


class TestSession:
    def test_holds_mirror_and_background_alone(self, recorded):
        plan = recorded.metadata.plan
        assert recorded.complete
        assert recorded.metadata.sample == "mirror"
        assert plan.mode == "mirror"
        assert plan.wedge_deg == 10
        assert plan.roles == ("background", "sample")
        assert plan.n_frames == 2 * 4 * (1 + 3)
        with pytest.raises(DataError, match="frame standard/0/0/0 is missing"):
            recorded.frame("standard", 0, 0, 0)
        assert not (recorded.path / "frames.zarr" / "standard").exists()
        assert read_truth(recorded.path)["model"] == "mirror"

    def test_no_spot_saturates_and_all_are_bright(self, recorded):
        top = recorded.metadata.camera.saturation_dn
        peaks = [
            recorded.frame("sample", take, incidence, 1).max()
            for take in range(3)
            for incidence in range(4)
        ]
        assert max(peaks) < 0.75 * top
        seen = np.array(peaks) > 0.3 * top
        # From -75 deg a wedge of 10 deg away from the lamp sends it below the horizon.
        assert seen.tolist() == [False] + 11 * [True]

    def test_the_background_has_no_spot(self, recorded):
        camera = recorded.metadata.camera
        for incidence in range(4):
            frame = recorded.frame("background", 0, incidence, 1).astype(float)
            assert frame.max() < camera.black_dn + 8 * camera.noise_dn + 8

    def test_the_default_covers_the_dome(self):
        rig = small(lamp={"half_angle_deg": 0.5})
        plan = mirror_plan(rig, wedge_deg=10.0)
        assert plan.theta_i_deg == tuple(range(-75, 90, 15))
        assert plan.rotations_deg == tuple(range(0, 360, 45))
        plan = mirror_plan(rig)
        assert plan.rotations_deg == (0.0,)
        assert plan.exposures_s[1] == pytest.approx(4 * plan.exposures_s[0])

    def test_continues_after_an_interruption(self, recorded, tmp_path):
        rig = as_stated()

        def stop(done, total):
            if done >= 13:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            self.again(rig, recorded, tmp_path, progress=stop)
        assert not Session.open(tmp_path / "s").complete
        again = self.again(rig, recorded, tmp_path)
        for take in range(3):
            np.testing.assert_array_equal(
                again.bracket("sample", take, 2), recorded.bracket("sample", take, 2)
            )

    @staticmethod
    def again(rig, recorded, tmp_path, **more):
        plan = recorded.metadata.plan
        return gonio.simulate(output=tmp_path / "s", instrument=rig, plan=plan, seed=3, **more)

    def test_takes_no_material(self, tmp_path):
        rig = small(n=16, lamp={"half_angle_deg": 0.5})
        plan = mirror_plan(rig)
        with pytest.raises(
            ConfigurationError, match="plan is one for a mirror; give neither a mat"
        ):
            gonio.simulate("foam", output=tmp_path / "s", instrument=rig, plan=plan)


class TestPlan:
    GIVEN = MappingProxyType({"rotations_deg": (0.0,), "exposures_s": (0.01,)})

    @pytest.mark.parametrize(
        ("changed", "message"),
        [
            ({"theta_i_deg": (-5.0,)}, "theta_i = -5 deg must lie in 0 to 90 deg"),
            ({"theta_i_deg": (-95.0,), "mode": "mirror"}, "-95 deg must lie in -90 to 90 deg"),
            ({"theta_i_deg": (0.0,), "standard_theta_i_deg": 95.0}, "theta_i = 95 deg must lie"),
            ({"theta_i_deg": (0.0,), "mode": "transmission"}, "transmission needs standard_theta"),
            ({"theta_i_deg": (0.0,), "mode": "mirror", "standard_theta_i_deg": 0.0},
             "a session of a mirror has no standard"),
            ({"theta_i_deg": (0.0,), "wedge_deg": 3.0}, "wedge_deg belongs to a session of a mir"),
        ],
    )  # fmt: skip
    def test_refusals(self, changed, message):
        with pytest.raises(ValueError, match=message):
            Plan(**self.GIVEN | changed)

    def test_a_lamp_on_the_other_side_is_for_a_mirror(self):
        assert Plan(**self.GIVEN, theta_i_deg=(-60.0, 60.0), mode="mirror").takes("standard") == 0
