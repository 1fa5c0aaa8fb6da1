"""Where a reduction puts its samples: chirality, holes, displaced pupils, stated errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.cli import main
from gonio.errors import ConfigurationError
from gonio.geometry import Directions
from gonio.instrument import Instrument, preset
from gonio.metadata import LampRecord, Metadata, Plan, Uncertain
from gonio.samples import BRDFSamples
from gonio.session import Session

EXPOSURES = (1e-3, 8e-3, 64e-3)
BRUSHED = {"rho_d": 0.05, "rho_s": 0.3, "alpha_x": 0.06, "alpha_y": 0.24}
ROUND = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.12, "alpha_y": 0.12}


def small(**parts) -> Instrument:
    """ideal12 with 104 x 104 pixels and a few changed figures of its parts."""
    return preset("ideal12").with_pixels(104).altered(**parts)


def record(path: Path, rig=None, parameters=None, *, theta_i_deg=(40.0,), psi_deg=0.0) -> Session:
    return gonio.simulate(
        model="ward",
        parameters=parameters or BRUSHED,
        output=path,
        instrument=rig or small(),
        plan=Plan(theta_i_deg=theta_i_deg, rotations_deg=(psi_deg,), exposures_s=EXPOSURES),
        seed=1,
    )


def over_members(samples: BRDFSamples, parameters) -> np.ndarray:
    """Ward's model integrated over each cell."""
    ward, cells = models.get("ward"), samples.cells
    w_i, _ = samples.directions.vectors()
    w_i = np.repeat(w_i, np.diff(cells.offsets), axis=0)
    f = ward.evaluate(np.ascontiguousarray(w_i), cells.w_r, ward.vector(parameters))
    return np.add.reduceat(cells.weight * f, cells.offsets[:-1])


def worst(samples: BRDFSamples, parameters) -> float:
    """Largest departure from the model beyond noise, over the lobe's peak."""
    expected = over_members(samples, parameters)
    beyond = np.abs(samples.value - expected) - 5 * samples.u_independent
    return float(beyond.max() / expected.max())


@pytest.fixture(scope="module")
def turned(tmp_path_factory) -> Session:
    """A surface with alpha_x != alpha_y, turned by 30 deg: nothing about it is symmetric."""
    return record(tmp_path_factory.mktemp("turned") / "session", psi_deg=30.0)


class TestChirality:
    def test_the_right_way_round_fits(self, turned):
        assert worst(gonio.reduce(turned), BRUSHED) < 0.01

    @pytest.mark.parametrize(
        "flip",
        [np.s_[..., ::-1, :], np.s_[..., ::-1], np.s_[..., ::-1, ::-1]],
        ids=["y", "x", "both"],
    )
    def test_flipped_frames_do_not(self, turned, flip, monkeypatch):
        straight = Session.bracket
        monkeypatch.setattr(
            Session, "bracket", lambda self, *at, **of: straight(self, *at, **of)[flip]
        )
        assert worst(gonio.reduce(turned), BRUSHED) > 0.3

    def test_mirroring_every_azimuth_turns_the_sample_the_wrong_way(self, turned):
        """phi -> 180 deg - phi of lamp and camera leaves eq. (3) and the peak where they are."""
        samples = gonio.reduce(turned)
        d = samples.directions
        mirrored = Directions(d.theta_i, np.pi - d.phi_i, d.theta_r, np.pi - d.phi_r)
        cells = samples.cells
        w_r = cells.w_r * [-1, 1, 1]
        wrong = replace(samples, directions=mirrored, cells=replace(cells, w_r=w_r))
        # In the frame of the sample that is a sample turned by -30 deg.
        assert worst(wrong, BRUSHED) < 0.01
        psi = np.radians(30.0)
        as_planned = Directions(d.theta_i, -psi * np.ones(len(samples)), d.theta_r, np.pi - d.phi_r)
        assert worst(replace(wrong, directions=as_planned), BRUSHED) > 0.3


def test_a_hole_in_a_frame_stays_a_hole(tmp_path, monkeypatch):
    session = record(tmp_path / "s", parameters=ROUND)
    whole = gonio.reduce(session)
    hole = np.zeros((104, 104), bool)
    hole[58:70, 40:52] = True
    straight = Session.bracket

    def with_hole(self, role, *at, **of):
        frames = straight(self, role, *at, **of)
        if role == "sample":
            frames = np.where(hole, np.uint16(self.metadata.camera.saturation_dn), frames)
        return frames

    monkeypatch.setattr(Session, "bracket", with_hole)
    holed = gonio.reduce(session)
    seen = PixelMap.of(session.metadata)
    rows, columns = np.nonzero(hole)
    missing = seen.solid_angles(columns, rows).sum()
    lost = whole.solid_angle.sum() - holed.solid_angle.sum()
    assert lost == pytest.approx(missing, rel=1e-12)
    # No sample stands in the hole, and those beside it say that they lost pixels.
    inner = seen.directions(*np.meshgrid(np.arange(43, 49), np.arange(61, 67))).reshape(-1, 3)
    _, w_r = holed.directions.vectors()
    assert (w_r @ inner.T).max() < np.cos(np.radians(3.0))
    assert 0 < np.count_nonzero(holed.flags & 1) < 40
    # Nothing is filled in: every value is still the mean of pixels that were seen.
    assert worst(holed, ROUND) < 0.01


ASKEW = {
    "pupil_offset_mm": (0.5, -0.4, 1.0),
    "pupil_walk_mm": 1.0,
    "azimuth_deg": 2.0,
    "alignment_known": True,
}


@pytest.fixture(scope="module", params=["sphere", "ellipsoid"])
def askew(request, tmp_path_factory) -> Session:
    rig = small(dome={"shape": request.param}, lens=ASKEW, lamp={"lit_diameter_mm": 40.0})
    sensor = rig.sensor.model_copy(update={"centre_offset_px": (3.0, -2.0)})
    rig = rig.model_copy(update={"sensor": sensor})
    return record(tmp_path_factory.mktemp("askew") / "session", rig, psi_deg=30.0)


class TestPupil:
    """A camera that stands askew by amounts that its session states."""

    def test_the_exact_mapping_uses_it(self, askew):
        samples = gonio.reduce(askew, mapping="exact")
        assert worst(samples, BRUSHED) < 0.003
        line = samples.history[2]
        assert line.startswith("exact law of reflection with R = 150 mm, D = 15 mm")
        assert "pupil displaced by (0.5, -0.4, 1) mm, pupil rising 1 mm to the rim" in line
        assert "camera turned by 2 deg, image centre at (" in line

    def test_eq_3_says_how_far_it_is_off(self, askew):
        ward = gonio.reduce(askew)
        assert worst(ward, BRUSHED) > 0.01
        (term,) = (t for t in ward.shared if t.name == "mapping")
        exact = gonio.reduce(askew, mapping="exact")
        assert not any(t.name == "mapping" for t in exact.shared)
        # Moved by the term, the samples are where they belong.
        moved = ward.cells.w_r + np.repeat(term.shift, np.diff(ward.cells.offsets), axis=0)
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        assert worst(replace(ward, cells=replace(ward.cells, w_r=moved)), BRUSHED) < 0.005


def with_metadata(session: Session, **changed) -> Session:
    """The session with other records in its metadata."""
    records = {name: getattr(session.metadata, name) for name in changed}
    update = {name: r.model_copy(update=changed[name]) for name, r in records.items()}
    metadata = session.metadata.model_copy(update=update)
    return Session(session.path, Metadata.model_validate(metadata.model_dump(by_alias=True)),
                   session._manifest)  # fmt: skip


GEOMETRY = Uncertain(
    names=("R", "pupil_z", "camera_azimuth"),
    covariance=((0.01, 0.0, 0.0), (0.0, 0.04, 0.0), (0.0, 0.0, 0.01)),
)


class TestStatedErrors:
    def test_calibrated_figures_move_directions_by_their_uncertainty(self, turned):
        session = with_metadata(turned, geometry={"uncertain": GEOMETRY})
        samples = gonio.reduce(session, mapping="exact")
        terms = [t for t in samples.shared if t.name.startswith("geometry, mode ")]
        assert [t.name for t in terms] == [f"geometry, mode {k}" for k in range(1, 4)]
        assert terms[0].meaning == "calibration of the geometry: mostly pupil_z"
        _, w_r = samples.directions.vectors()
        for term in terms:
            assert term.group is None
            assert np.abs(np.sum(term.shift * w_r, axis=1)).max() < 1e-15
        # An azimuth of 0.1 deg and a height of 0.2 mm, by hand: the azimuth turns by its sine,
        # the pupil's height turns directions by up to 2 h/R (here over 104 pixels' cells).
        total = np.sqrt(sum(np.sum(t.shift**2, axis=1) for t in terms))
        assert total.max() < np.hypot(np.radians(0.1) * 1.2, 2 * 0.2 / 150 * 1.05)
        assert total.max() > 0.9 * 2 * 0.2 / 150
        assert "unknown, not included: lens calibration (lens.uncertain)" in samples.history

    def test_the_errors_turn_with_the_sample(self, tmp_path, turned):
        """The same geometry seen from a sample turned by 30 deg: shifts turn with the frame."""
        straight = record(tmp_path / "s", psi_deg=0.0, parameters=ROUND)
        rotated = record(tmp_path / "t", psi_deg=30.0, parameters=ROUND)
        first, second = (
            gonio.reduce(with_metadata(s, geometry={"uncertain": GEOMETRY}))
            for s in (straight, rotated)
        )
        back = np.radians(30.0)
        turn = np.array(
            [[np.cos(back), np.sin(back), 0], [-np.sin(back), np.cos(back), 0], [0, 0, 1]]
        )
        for name in ("mapping", "geometry, mode 1"):
            a, b = (next(t for t in s.shared if t.name == name) for s in (first, second))
            turned_a = a.shift @ turn.T
            sign = np.sign(np.sum(turned_a * b.shift))  # a mode has no sign of its own
            # Equal noise-free images, so equal cells; their centroids differ by noise only.
            np.testing.assert_allclose(sign * turned_a, b.shift, atol=2e-5)

    @pytest.mark.parametrize(
        ("lamp", "blur_deg", "line"),
        [
            (
                {"half_angle_deg": None},
                None,
                "unknown, not included: the lamp's cone (lamp.half_angle_deg)",
            ),
            ({"half_angle_deg": 0.0}, None, None),
            (
                {"half_angle_deg": 1.0},
                0.5 * np.sqrt(1.1**2 - 1),
                "source cone of half-angle 1 deg is part of the members; its uncertainty: unknown, "
                "10% assumed",
            ),
            (
                {"half_angle_deg": 1.0, "u_half_angle_deg": 0.05},
                0.5 * np.sqrt(1.05**2 - 1),
                "source cone of half-angle 1 deg is part of the members; its uncertainty: 0.05 deg",
            ),
            (
                {"half_angle_deg": 0.0, "u_half_angle_deg": 0.2},
                0.1,
                "source cone of half-angle 0 deg is part of the members; its uncertainty: 0.2 deg",
            ),
        ],
        ids=["unknown", "point", "assumed", "stated", "nearly a point"],
    )
    def test_the_lamps_cone(self, turned, lamp, blur_deg, line):
        record = LampRecord(**lamp, drift=None)
        samples = gonio.reduce(with_metadata(turned, lamp=record.model_dump()))
        terms = [t for t in samples.shared if t.name == "source cone"]
        if blur_deg is None:
            assert terms == []
        else:
            assert np.degrees(terms[0].blur) == pytest.approx(blur_deg)
        cones = [entry for entry in samples.history if "cone" in entry]
        assert cones == ([] if line is None else [line])

    def test_the_cone_widens_the_members(self, turned):
        cells = [
            gonio.reduce(with_metadata(turned, lamp={"half_angle_deg": a})).cells
            for a in (0.0, 1.0)
        ]
        # One cell's second moments: the trace grows by 2 (a/2)^2.
        first = [slice(c.offsets[7], c.offsets[8]) for c in cells]
        spread = []
        for c, part in zip(cells, first, strict=True):
            mean = c.weight[part] @ c.w_r[part]
            away = c.w_r[part] - mean
            spread.append(c.weight[part] @ np.sum(away**2, axis=1))
        assert spread[1] - spread[0] == pytest.approx(2 * np.radians(0.5) ** 2, rel=0.01)


class TestCommand:
    def run(self, *words):
        with pytest.raises(SystemExit) as stop:
            main([str(word) for word in words])
        return stop.value.code

    def test_mapping_is_passed_on(self, turned, tmp_path, capsys):
        target = tmp_path / "samples.nc"
        assert self.run("reduce", turned.path, "-o", target, "--mapping", "exact") == 0
        assert "- exact law of reflection with R = 150 mm" in capsys.readouterr().out
        assert "exact law of reflection" in BRDFSamples.load(target).history[2]

    def test_another_mapping_is_refused(self, turned, tmp_path, capsys):
        assert self.run("reduce", turned.path, "-o", tmp_path / "s.nc", "--mapping", "best") == 2
        assert "'best' is not one of 'eq3', 'exact'" in capsys.readouterr().err

    def test_python_refuses_it_too(self, turned):
        with pytest.raises(ConfigurationError, match=r"mapping 'best' is unknown; allowed are eq3"):
            gonio.reduce(turned, mapping="best")


def test_a_session_of_a_mirror_has_no_brdf(turned):
    session = with_metadata(turned, plan={"mode": "mirror"})
    session.require_complete = lambda: None
    with pytest.raises(ConfigurationError, match=r"a session of a mirror has no BRDF; it is for"):
        gonio.reduce(session)


def test_the_direction_of_a_pixel_is_that_of_the_simulated_ray(turned):
    """The camera's first rays, traced by the simulator, and the exact mapping of their pixels."""
    from gonio.instrument.imaging import trace_rays

    rig = small(lens={"pupil_mm": 0.0}).model_copy(update={"rays_per_pixel": 1})
    rays = trace_rays(rig, seed=1)
    row, column = np.divmod(rays.pixel, 104)
    w_r = PixelMap.of(turned.metadata, "exact").directions(column, row)
    assert np.abs(w_r - rays.w_r[:, 0]).max() < 1e-9
    assert w_r[:, 2].min() < 0.01  # down to the horizon
