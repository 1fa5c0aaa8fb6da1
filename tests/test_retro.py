"""Retro-reflection: what is seen through the patch of the dome where the lamp's beam enters."""

import numpy as np
import pytest
from virtual import Drawn, Remembered, images, small

import gonio
from gonio import models
from gonio.fitting.problem.single import SingleProblem
from gonio.metadata import Plan
from gonio.samples import FLAG_ENTRY, BRDFSamples

PLAN = Plan(
    theta_i_deg=(10.0, 20.0, 30.0, 40.0, 50.0),
    rotations_deg=(0.0,),
    exposures_s=(0.25e-3, 4e-3, 16e-3),
    repeats=2,
)
DUSTY = {"rho": 0.3, "sigma": 0.5}  # brightest towards the lamp


@pytest.fixture(scope="module")
def scene() -> Remembered:
    return Remembered(images(small(), PLAN, "oren_nayar", **DUSTY))


def entries(samples: BRDFSamples) -> BRDFSamples:
    return samples.select((samples.flags & FLAG_ENTRY) > 0, "entry patch")


def away(samples: BRDFSamples) -> np.ndarray:
    """Angle between viewer and lamp, radians."""
    w_i, w_r = samples.directions.vectors()
    return np.arccos(np.clip(np.sum(w_i * w_r, axis=1), -1, 1))


def model_values(samples: BRDFSamples) -> np.ndarray:
    chosen = models.get("oren_nayar")
    return SingleProblem.from_samples(samples, chosen).values(chosen.vector(DUSTY))


def test_the_other_samples_do_not_depend_on_it(scene):
    session = Drawn(scene)
    without, with_retro = gonio.reduce(session), gonio.reduce(session, retro=True)
    assert not np.any(without.flags & FLAG_ENTRY)
    rest = with_retro.select((with_retro.flags & FLAG_ENTRY) == 0, "elsewhere")
    for name in ("value", "u_independent", "u_reference", "noise_slope", "solid_angle", "image"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(without, name))
    np.testing.assert_array_equal(rest.cells.w_r, without.cells.w_r)
    (line,) = (line for line in with_retro.history if line.startswith("retro: "))
    n = int(line.split()[1])
    assert line == f"retro: {n} of them in the lamp's entry patch, flagged"
    masked = [s.history[3].split("dark standard ")[1].split()[0] for s in (without, with_retro)]
    assert int(masked[0]) - int(masked[1]) == n


def test_they_look_at_the_lamp(scene):
    retro = entries(gonio.reduce(Drawn(scene), retro=True))
    # A beam of 16 mm opens 3.05 deg of the dome, and pixels are 1.7 deg wide.
    assert np.degrees(away(retro).max()) < 3.05 + 1.7 / np.sqrt(2)
    assert set(retro.image) == set(range(len(PLAN.theta_i_deg)))


def test_without_drift_they_agree_within_their_noise(scene):
    z = []
    for seed in range(20):
        retro = entries(gonio.reduce(Drawn(scene, seed), retro=True))
        z.append((retro.value - model_values(retro)) / retro.u_independent)
    z = np.concatenate(z)
    # Cells of an image share their standard and background only through noise of their own.
    assert np.mean(z**2) == pytest.approx(1, abs=4 * np.sqrt(2 / len(z)))
    assert abs(np.mean(z)) < 4 / np.sqrt(len(z))


def test_stray_light_costs_noise(scene):
    samples = gonio.reduce(Drawn(scene), retro=True)
    near = samples.directions.theta_r < np.radians(70)
    # Of one pixel, from that of its cell; solid angles of pixels differ by 20 %.
    noise = (samples.u_independent / samples.value) ** 2 * samples.solid_angle
    entry = (samples.flags & FLAG_ENTRY) > 0
    assert np.median(noise[entry & near]) > 1.5 * np.median(noise[~entry & near])


def test_drift_of_the_lamp_leaves_stray_light_that_the_terms_cover(scene):
    drift = 0.01
    rig = small(lamp={"drift": drift})
    wandering = Remembered(images(rig, PLAN, "oren_nayar", **DUSTY))
    stated, without_stray = [], []
    for seed in range(20):
        output = 1 + drift * np.random.default_rng(seed).standard_normal(PLAN.n_images)
        session = Drawn(wandering, seed, output.__getitem__)
        retro = entries(gonio.reduce(session, retro=True))
        value = model_values(retro)
        off = retro.value - value
        shared = {t.name: t.change(value) for t in retro.shared if not t.moves_directions}
        assert set(shared) == {"lamp, sample", "lamp, standard", "lamp, background"}
        total = retro.u_independent**2 + sum(change**2 for change in shared.values())
        stated.append(off**2 / total)
        without_stray.append(off**2 / (retro.u_independent**2 + 1.5 * (drift * value) ** 2))
    # 100 images, each with errors of its own in common.
    n = 20 * len(PLAN.theta_i_deg)
    assert np.mean(np.concatenate(stated)) == pytest.approx(1, abs=4 * np.sqrt(2 / n))
    assert np.mean(np.concatenate(without_stray)) > 2
