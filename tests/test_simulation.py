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
from gonio import simulation
from gonio.errors import ConfigurationError
from gonio.instrument import Instrument, preset
from gonio.metadata import Plan
from gonio.session import Session, read_truth

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
    files = [path / "manifest.jsonl", path / "session.json", path / "truth" / "truth.json"]
    files += [file for file in (path / "frames.zarr").rglob("*") if file.is_file()]
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


class TestPlan:
    def test_default_has_21_incidences_and_turns_anisotropic_samples(self):
        rig = preset("modern12")
        plan = simulation.default_plan(rig, anisotropic=True)
        assert plan.theta_i_deg[0] == 0
        assert plan.theta_i_deg[-1] == rig.theta_i_max_deg == 75
        assert len(plan.theta_i_deg) == 21
        assert plan.rotations_deg == (0.0, 45.0, 90.0)
        assert plan.exposures_s == rig.sensor.exposures_s
        assert plan.n_frames == 21 * 6 * (1 + 1 + 3) == 630
        still = simulation.default_plan(rig, anisotropic=False)
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
             r"unknown parameter of ward 'alfa_x': did you mean 'alpha_x'\?"),
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
