"""Simulated sessions: one seed is one session, whatever happens on the way."""

import json
import math
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.errors import ConfigurationError
from gonio.geometry import Directions, angles
from gonio.instrument import Instrument, imaging, preset
from gonio.instrument.plans import default_plan
from gonio.instrument.realisation import Realisation
from gonio.metadata import Plan
from gonio.session import Session, open_truth_images, read_truth

PLAN = Plan(
    theta_i_deg=(0.0, 40.0),
    rotations_deg=(0.0, 90.0),
    exposures_s=(1e-3, 8e-3, 64e-3),
    repeats=1,
)


def small(name="modern12", n=40, **parts) -> Instrument:
    """A preset with n x n pixels over the same image circle, parts changed as given."""
    rig = preset(name)
    pitch = rig.sensor.columns * rig.sensor.pitch_um[0] / n
    sensor = {"rows": n, "columns": n, "pitch_um": (pitch, pitch), "binning": 1}
    parts = {"sensor": sensor, **parts}
    changed = {part: getattr(rig, part).model_copy(update=update) for part, update in parts.items()}
    return rig.model_copy(update=changed)


def run(path, *, material="rolled_aluminum", instrument=None, plan=PLAN, seed=1, **more):
    return gonio.simulate(
        material, output=path, instrument=instrument or small(), plan=plan, seed=seed, **more
    )


def content(path):
    """Manifest and frames of a session, byte by byte."""
    files = [path / "manifest.jsonl", path / "session.json"]
    for folder in ("frames.zarr", "truth"):
        files += [file for file in (path / folder).rglob("*") if file.is_file()]
    return {str(file.relative_to(path)): file.read_bytes() for file in files}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    path = tmp_path_factory.mktemp("simulation") / "reference"
    run(path, threads=1)
    return path


class TestReproducibility:
    @pytest.mark.parametrize("threads", [2, 3])
    def test_one_seed_one_session_at_any_number_of_threads(self, reference, tmp_path, threads):
        run(tmp_path / "again", threads=threads)
        assert content(tmp_path / "again") == content(reference)

    def test_another_seed_another_session(self, reference, tmp_path):
        run(tmp_path / "other", seed=2)
        one, other = (Session.open(path) for path in (reference, tmp_path / "other"))
        for role in ("background", "standard", "sample"):
            a, b = (s.frame(role, 0, 1, 2).astype(float) for s in (one, other))
            assert np.mean(a != b) > 0.2
        assert read_truth(reference)["lamp"] != read_truth(tmp_path / "other")["lamp"]

    def test_a_finished_session_is_left_alone(self, reference):
        before = {f: f.stat().st_mtime_ns for f in (reference / "frames.zarr").rglob("0")}
        again = run(reference)
        assert again.complete
        assert {f: f.stat().st_mtime_ns for f in (reference / "frames.zarr").rglob("0")} == before

    def test_frames_differ_from_image_to_image(self, tmp_path):
        plan = PLAN.model_copy(update={"repeats": 2})
        session = run(tmp_path / "s", plan=plan)
        a, b = (session.frame("background", k, 0, 2).astype(float) for k in range(2))
        assert not np.array_equal(a, b)


class TestInterruption:
    @staticmethod
    def chunks(path):
        return {f: f.stat().st_mtime_ns for f in (path / "frames.zarr").rglob("*") if f.is_file()}

    def check_resumed(self, path, reference):
        """Continue, and find the kept frames untouched and the whole as if never interrupted."""
        part = Session.open(path)
        assert 0 < part.n_done < PLAN.n_frames
        kept = {
            path / f"frames.zarr/{role}/c/{take}/{incidence}/{k}/0/0"
            for role, take, incidence in PLAN.images()
            for k in range(3)
            if part.has(role, take, incidence, k)
        }
        assert len(kept) == part.n_done
        before = self.chunks(path)
        assert run(path).complete
        after = self.chunks(path)
        assert all(after[file] == before[file] for file in kept)
        assert content(path) == content(reference)

    def test_an_exception_in_the_middle(self, reference, tmp_path):
        def stop(done, total):
            assert total == PLAN.n_frames
            if done >= 7:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run(tmp_path / "s", progress=stop)
        self.check_resumed(tmp_path / "s", reference)

    def test_a_file_that_a_kill_left_half_written_is_removed(self, reference, tmp_path):
        def stop(done, total):
            if done >= 7:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run(tmp_path / "s", progress=stop)
        folder = next((tmp_path / "s/frames.zarr").rglob("c"))
        (folder / "0.450f3da071e1486e8dc0458ba755bf1a.partial").touch()
        assert run(tmp_path / "s").complete
        assert content(tmp_path / "s") == content(reference)

    def test_kill_9_in_the_middle(self, reference, tmp_path):
        recipe = {"rig": small().model_dump(mode="json"), "plan": PLAN.model_dump(mode="json")}
        (tmp_path / "recipe.json").write_text(json.dumps(recipe))
        program = """
            import json, sys, time
            import gonio
            from gonio.instrument import Instrument
            from gonio.metadata import Plan

            recipe = json.load(open(sys.argv[1]))

            def report(done, total):
                print(done, flush=True)
                time.sleep(0.02)

            gonio.simulate(
                "rolled_aluminum", output=sys.argv[2], seed=1, progress=report,
                instrument=Instrument.model_validate(recipe["rig"]),
                plan=Plan.model_validate(recipe["plan"]),
            )
        """
        with subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(program), str(tmp_path / "recipe.json"),
             str(tmp_path / "s")],
            stdout=subprocess.PIPE, text=True,
        ) as child:  # fmt: skip
            assert child.stdout.readline().strip().isdigit()
            child.kill()
        assert child.returncode == -signal.SIGKILL
        self.check_resumed(tmp_path / "s", reference)

    def test_progress_counts_to_the_end(self, tmp_path):
        seen = []
        run(tmp_path / "s", progress=lambda done, total: seen.append((done, total)))
        assert seen == sorted(seen)
        assert seen[-1] == (PLAN.n_frames, PLAN.n_frames)
        assert len(seen) == PLAN.n_frames


class TestTruth:
    def test_stands_apart_from_what_the_operator_knows(self, reference):
        text = (reference / "session.json").read_text()
        for secret in ("truth", "rho_", "alpha", "seed", "standard_scale", "prnu", "drawn"):
            assert secret not in text
        truth = read_truth(reference)
        assert truth["model"] == "ward"
        assert truth["parameters"] == {
            "rho_d": 0.1, "rho_s": 0.21, "alpha_x": 0.04, "alpha_y": 0.09,
        }  # fmt: skip
        assert truth["seed"] == 1
        assert len(truth["lamp"]) == len(list(PLAN.images()))

    def test_the_certificate_states_what_its_maker_knows(self, tmp_path):
        session = run(tmp_path / "s", instrument=small("lbl1992"))
        certificate = session.metadata.standard
        assert (certificate.reflectance, certificate.uncertainty) == (0.95, 0.02)
        assert certificate.rolloff == 0  # the instrument of 1992 takes it as Lambertian

    def test_figures_of_the_camera_are_those_of_the_binned_pixel(self, tmp_path):
        rig = preset("ideal12")
        sensor = rig.sensor.model_copy(update={"rows": 80, "columns": 80, "pitch_um": (72.0, 72.0)})
        plan = PLAN.model_copy(update={"exposures_s": (1e-5,), "theta_i_deg": (0.0,)})
        session = run(tmp_path / "s", instrument=rig.model_copy(update={"sensor": sensor}),
                      plan=plan)  # fmt: skip
        camera = session.metadata.camera
        assert (camera.rows, camera.columns) == (20, 20)
        assert camera.black_dn == 16 * 64
        assert camera.saturation_dn == 16 * 4095
        assert camera.full_well_e == 16 * 10_700
        assert camera.pitch_mm == pytest.approx((0.288, 0.288))
        # Pixels off the image circle are dark: 16 times the black level.
        corner = float(session.frame("sample", 0, 0, 0)[0, 0])
        assert abs(corner - 1024) < 6 * math.sqrt(16) * (0.38 * 2.3 + 0.3)


class TestPhysics:
    PLAN = Plan(theta_i_deg=(0.0,), rotations_deg=(0.0,), exposures_s=(8e-3,), repeats=6)

    @staticmethod
    def light(session, role, take):
        """Mean count above black of the pixels around the middle."""
        frame = session.frame(role, take, 0, 0)[10:30, 10:30].astype(float)
        return frame.mean() - session.metadata.camera.black_dn

    def test_the_lamp_drifts_from_image_to_image_as_the_truth_says(self, tmp_path):
        rig = small("ideal12", lamp=preset("ideal12").lamp.model_dump() | {"drift": 0.1})
        session = run(tmp_path / "s", instrument=rig, plan=self.PLAN, material="foam")
        lamp = np.array(read_truth(session.path)["lamp"])
        assert np.std(lamp) > 0.02
        standard = np.array([self.light(session, "standard", k) for k in range(6)])
        # 400 pixels of some 1600 electrons each: shot noise 0.13 % of the mean.
        np.testing.assert_allclose(standard / standard[0], lamp[6:12] / lamp[6], rtol=4 * 0.0018)

    def test_the_background_holds_stray_light_and_drifts_with_the_lamp(self, tmp_path):
        parts = {
            "lamp": preset("ideal12").lamp.model_dump() | {"drift": 0.2},
            "surroundings": {"stray": 0.5, "entry_patch": 0.0, "multibounce": 0.0},
        }
        session = run(tmp_path / "s", instrument=small("ideal12", **parts), plan=self.PLAN)
        lamp = np.array(read_truth(session.path)["lamp"])
        background = np.array([self.light(session, "background", k) for k in range(6)])
        np.testing.assert_allclose(background / background[0], lamp[:6] / lamp[0], rtol=4 * 0.003)
        # Half the light of a perfect white, against a standard of 0.99 on top of it.
        ratio = (self.light(session, "standard", 0) / lamp[6]) / (background[0] / lamp[0])
        assert ratio == pytest.approx((0.5 + 0.99) / 0.5, rel=4 * 0.003)

    def test_the_standard_is_off_its_certificate_by_the_drawn_error(self, tmp_path):
        standard = preset("ideal12").standard.model_dump()
        sessions = [
            run(
                tmp_path / f"{uncertainty}",
                instrument=small("ideal12", standard=standard | {"uncertainty": uncertainty}),
                plan=self.PLAN,
                seed=5,
            )
            for uncertainty in (0.0, 0.2)
        ]
        scale = read_truth(sessions[1].path)["standard_scale"]
        assert read_truth(sessions[0].path)["standard_scale"] == 1
        assert 0.01 < abs(scale - 1) < 1
        light = [np.mean([self.light(s, "standard", k) for k in range(6)]) for s in sessions]
        dark = np.mean([self.light(sessions[0], "background", k) for k in range(6)])
        ratio = (light[1] - dark) / (light[0] - dark)
        assert ratio == pytest.approx(scale, rel=4 * 0.001)
        assert sessions[1].metadata.standard.reflectance == 0.99


class TestChannels:
    FILTERS = ({"name": "red", "relative_rate": 0.5}, {"name": "blue", "wavelength_nm": 450.0})

    def rig(self):
        rig = small("ideal12", n=40)
        return Instrument.model_validate(rig.model_dump() | {"channels": self.FILTERS})

    def run(self, path, rho=(0.2, 0.6), **more):
        return gonio.simulate(
            model="lambert", parameters={"rho": rho}, output=path, instrument=self.rig(),
            plan=PLAN, seed=4, **more,
        )  # fmt: skip

    def test_each_has_its_frames(self, tmp_path):
        session = self.run(tmp_path / "s", threads=1)
        plan = session.metadata.plan
        assert [c.name for c in plan.channels] == ["red", "blue"]
        assert plan.channels[1].wavelength_nm == 450
        assert session.n_done == plan.n_frames == 2 * PLAN.n_frames
        red, blue = (
            session.frame("sample", 0, 0, 1, channel=c)[12:28, 12:28].astype(float).mean() - 64
            for c in range(2)
        )
        dark = session.frame("background", 0, 0, 1)[12:28, 12:28].astype(float).mean() - 64
        # 256 pixels of some 300 electrons; the stray light of a channel follows its filter.
        assert (red - dark) / (blue - 2 * dark) == pytest.approx(0.5 * 0.2 / 0.6, rel=0.05)
        truth = read_truth(session.path)
        assert truth["parameters"] == {"rho": [0.2, 0.6]}
        assert len(truth["lamp"]) == 2 * plan.n_images
        again = self.run(tmp_path / "t", threads=3)
        assert content(again.path) == content(session.path)

    def test_noise_differs_from_channel_to_channel(self, tmp_path):
        session = self.run(tmp_path / "s", rho=0.4)
        a, b = (session.frame("background", 0, 0, 0, channel=c).astype(float) for c in range(2))
        dark = np.s_[:5, :5]  # off the image circle
        assert np.any(a[dark] != b[dark])
        assert read_truth(session.path)["parameters"] == {"rho": 0.4}

    def test_an_interrupted_session_is_continued(self, tmp_path):
        def stop(done, total):
            if done >= 9:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            self.run(tmp_path / "s", progress=stop)
        assert not Session.open(tmp_path / "s").complete
        self.run(tmp_path / "s")
        assert content(tmp_path / "s") == content(self.run(tmp_path / "t").path)

    def test_too_many_values(self, tmp_path):
        with pytest.raises(
            ConfigurationError, match="rho has 3 values and ideal12 has 2 channels; give one value"
        ):
            self.run(tmp_path / "s", rho=(0.1, 0.2, 0.3))
        with pytest.raises(ConfigurationError, match="has 2 values and modern12 has 1 channel; gi"):
            gonio.simulate(
                model="lambert", parameters={"rho": (0.1, 0.2)}, output=tmp_path / "s",
                instrument=small(), plan=PLAN,
            )  # fmt: skip


class TestStandardOnce:
    @pytest.mark.parametrize("mode", ["reflection", "transmission"])
    def test_is_recorded_as_planned(self, tmp_path, mode):
        plan = PLAN.model_copy(update={"mode": mode, "standard_theta_i_deg": 20.0})
        rig = small(dome=preset("modern12").dome.model_dump() | {"transmittance_variation": 0.01})
        session = run(tmp_path / "s", plan=plan, instrument=rig)
        assert session.complete
        assert session.n_done == 3 * (3 + 1 + 4)
        places = 2 if mode == "reflection" else 1
        assert session.metadata.plan.u_irradiance == pytest.approx(0.01 * math.sqrt(places))
        assert session.metadata.limits.transmittance == 0.45
        entry = {e["theta_i_deg"]: e["relative"] for e in read_truth(session.path)[
            "entry_transmittance"]}  # fmt: skip
        assert set(entry) == {0, 20, 40}
        assert 0 < abs(entry[20] - 1) < 0.05

    def test_the_lamp_below_is_brighter_by_the_dome(self, tmp_path):
        rig = small("ideal12", surroundings={"stray": 0.0, "entry_patch": 0.0})
        means = []
        for mode in ("reflection", "transmission"):
            plan = PLAN.model_copy(update={"mode": mode, "standard_theta_i_deg": 40.0})
            session = gonio.simulate(
                model="lambert", parameters={"rho": 0.3}, output=tmp_path / mode, instrument=rig,
                plan=plan,
            )  # fmt: skip
            frame = session.frame("sample", 0, 0, 1).astype(float)
            means.append(frame[10:30, 10:30].mean() - 64)
        # 400 pixels of some 900 and 2000 electrons.
        assert means[0] / means[1] == pytest.approx(0.45, rel=4 * 0.002)


class TestTruthImages:
    @pytest.fixture(scope="class")
    @classmethod
    def session(cls, tmp_path_factory):
        base = preset("modern12")
        rig = small(
            n=52,
            sensor={"rows": 208, "columns": 208, "pitch_um": (27.6, 27.6), "dead_fraction": 0.01,
                    "hot_fraction": 0.005, "hot_e_per_s": 100.0},
            lens=base.lens.model_dump() | {"pupil_walk_mm": 1.0},
            dome=base.dome.model_dump() | {"reflectance_variation": 0.02},
        )  # fmt: skip
        rig = rig.model_copy(update={"rays_per_pixel": 8})
        path = tmp_path_factory.mktemp("truth") / "s"
        return run(path, instrument=Instrument.model_validate(rig.model_dump()), truth_images=True)

    def test_hold_what_their_page_promises(self, session):
        images = open_truth_images(session.path)
        sizes = {name: dict(zip(a.metadata.dimension_names, a.shape, strict=True))
                 for name, a in images.arrays()}  # fmt: skip
        frame = {"row": 52, "column": 52}
        assert sizes == {
            "brdf": {"channel": 1, "take": 2, "incidence": 2, **frame},
            "weight": {"incidence": 2, **frame},
            "dead_pixels": frame,
            "hot_pixels": frame,
            "slope_error": {**frame, "axis": 2},
            "dome_reflectance": frame,
        }

    def test_f_is_that_of_the_direction_which_the_pixel_sees(self, session):
        rig = Instrument.model_validate(read_truth(session.path)["instrument"])
        draws = Realisation.from_seed(1, rig, session.metadata.plan)
        rays = imaging.trace_rays(rig, draws.dome_seed)
        w_r = rays.w_r.mean(axis=1)
        w_r /= np.linalg.norm(w_r, axis=1, keepdims=True)
        metal = {"rho_d": 0.1, "rho_s": 0.21, "alpha_x": 0.04, "alpha_y": 0.09}
        theta_r, phi_r = angles(w_r)
        brdf = open_truth_images(session.path)["brdf"]
        assert brdf.dtype == np.float32
        for take, psi in enumerate(np.radians([0, 90])):
            for incidence, theta_i in enumerate(np.radians([0, 40])):
                f = models.get("ward")(Directions(theta_i, -psi, theta_r, phi_r - psi), **metal)
                image = brdf[0, take, incidence].ravel()
                # 14 significant bits, and 24 of the directions before them.
                np.testing.assert_allclose(image[rays.pixel], f, rtol=2.0**-14)
                assert np.isnan(image).sum() == image.size - len(rays.pixel)

    def test_maps_are_those_of_the_instrument(self, session):
        rig = Instrument.model_validate(read_truth(session.path)["instrument"])
        draws = Realisation.from_seed(1, rig, session.metadata.plan)
        images = open_truth_images(session.path)
        dead, hot = rig.sensor.bad_pixels(draws.pattern_seed)
        np.testing.assert_array_equal(images["dead_pixels"][:], dead)
        np.testing.assert_array_equal(images["hot_pixels"][:], hot)
        rays = imaging.trace_rays(rig, draws.dome_seed)
        weight = images["weight"][1].ravel()[rays.pixel]
        lit = imaging.lit_weights(rig, rays, np.radians(40)).sum(axis=1)
        np.testing.assert_allclose(weight, lit, atol=1e-6)
        assert 0 < np.nanstd(images["dome_reflectance"][:]) < 0.05
        slope = np.degrees(images["slope_error"][:])
        assert 0.02 < np.nanstd(slope) < 0.2  # 0.03 deg in the middle, 0.23 at the rim

    def test_a_session_continued_has_the_same(self, session, tmp_path):
        def stop(done, total):
            if done >= 15:
                raise KeyboardInterrupt

        rig = Instrument.model_validate(read_truth(session.path)["instrument"])
        for more in ({"progress": stop}, {"threads": 2}):
            try:
                run(tmp_path / "s", instrument=rig, truth_images=True, **more)
            except KeyboardInterrupt:
                assert not Session.open(tmp_path / "s").complete
        assert content(tmp_path / "s") == content(session.path)

    def test_are_there_where_they_take_little_space(self, tmp_path):
        # Two exposures and three rotations: of 24 frames f would take twelve halves.
        assert open_truth_images(run(tmp_path / "few", instrument=small(n=8)).path) is None
        plan = PLAN.model_copy(update={"repeats": 6, "rotations_deg": (0.0,)})
        rig = small("ideal12", n=104)
        path = run(tmp_path / "many", instrument=rig, plan=plan).path
        size = {
            folder: sum(f.stat().st_size for f in (path / folder).rglob("*") if f.is_file())
            for folder in ("frames.zarr", "truth")
        }
        assert 0 < size["truth"] < 0.2 * size["frames.zarr"]
        without = run(tmp_path / "none", instrument=rig, plan=plan, truth_images=False).path
        assert open_truth_images(without) is None
        frames, same = ({k: v for k, v in content(p).items() if not k.startswith("truth")}
                        for p in (path, without))  # fmt: skip
        assert frames == same


class TestPlan:
    def test_default_has_21_incidences_and_turns_anisotropic_samples(self):
        rig = preset("modern12")
        plan = default_plan(rig, anisotropic=True)
        assert plan.theta_i_deg[0] == 0
        assert plan.theta_i_deg[-1] == rig.theta_i_max_deg == 75
        assert len(plan.theta_i_deg) == 21
        assert plan.rotations_deg == (0.0, 45.0, 90.0)
        assert plan.exposures_s == rig.sensor.exposures_s
        assert plan.n_frames == 21 * 6 * (1 + 1 + 3) == 630
        still = default_plan(rig, anisotropic=False)
        assert still.rotations_deg == (0.0,)
        assert still.n_frames == 378

    @pytest.mark.parametrize(
        ("material", "isotropic"),
        [("rolled_aluminum", False), ("plastic_laminate", True), ("wall_plaster", True)],
    )
    def test_the_default_follows_the_material(self, tmp_path, material, isotropic):
        rig = small("ideal12", n=8)
        sensor = rig.sensor.model_copy(update={"exposures_s": (1e-3,)})
        session = gonio.simulate(
            material, output=tmp_path / "s", instrument=rig.model_copy(update={"sensor": sensor})
        )
        assert len(session.metadata.plan.rotations_deg) == (1 if isotropic else 3)
        assert session.complete


class TestRefusals:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({}, "give either a material or a model with its parameters"),
            ({"material": "foam", "model": "ward"}, "give either a material or a model"),
            ({"material": "foam", "parameters": {"rho_d": 1.0}},
             "material 'foam' has its own parameters; give a model to choose them"),
            ({"material": "rolled_bras"},
             r"unknown material 'rolled_bras': did you mean 'rolled_brass'\?"),
            ({"model": "wrd"}, r"unknown model 'wrd': did you mean 'ward'\?"),
            ({"model": "ward", "parameters": {"alfa_x": 0.1}},
             r"unknown parameter 'alfa_x' of ward: did you mean 'alpha_x'\?"),
            ({"model": "lambert", "parameters": {"rho": 1.5}},
             "rho = 1.5 is out of range; allowed is 0 to 1"),
            ({"material": "foam", "instrument": "modern21"}, "unknown instrument 'modern21': did"),
            ({"material": "foam", "seed": -1}, r"seed = -1 is out of range; allowed is 0 to 2\^63"),
            ({"material": "foam", "seed": 2**63}, "is out of range; allowed is 0 to"),
        ],
    )  # fmt: skip
    def test_before_anything_is_written(self, tmp_path, arguments, message):
        with pytest.raises(ConfigurationError, match=message):
            gonio.simulate(**arguments, output=tmp_path / "s")
        assert not (tmp_path / "s").exists()

    def test_another_session_in_the_same_folder(self, reference):
        before = content(reference)
        with pytest.raises(ConfigurationError, match="made with other settings or another seed"):
            run(reference, seed=2)
        with pytest.raises(ConfigurationError, match=r"rolled_aluminum on modern12 .* foam on mod"):
            run(reference, material="foam")
        assert content(reference) == before

    def test_a_model_by_its_name(self, tmp_path):
        session = gonio.simulate(
            model="lambert", parameters={"rho": 0.3}, output=tmp_path / "s",
            instrument=small("ideal12", n=8), plan=PLAN,
        )  # fmt: skip
        assert session.metadata.sample == "lambert"
        assert read_truth(session.path)["parameters"] == {"rho": 0.3}
