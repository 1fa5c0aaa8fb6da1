"""The published uncertainty of a sample against draws of everything that it stands for.

GUM supplement 1: counts are drawn many times, each draw is reduced, and the scatter is compared
with what one reduction states; what samples share, one cause at a time.
"""

import numpy as np
import pytest
from virtual import Drawn, Remembered, images, small

import gonio
from gonio import models
from gonio.calibration.frames.exposure import Rate
from gonio.calibration.frames.standard import brdf, reference, standard_brdf
from gonio.fitting.problem.single import SingleProblem
from gonio.geometry import angles
from gonio.metadata import Plan
from gonio.samples import BRDFSamples

N = 52
SEEDS = 40
# f pi of four samples. The pixels of the last lie on both sides of the guard by which a frame is
# left out for being too bright, 0.9 of 42 800 electrons: the white surface gives 8e5 e-/s on the
# axis and half of that at the rim, here for 4 ms.
SAMPLES = {"dim": 0.004, "as the standard": 0.9, "bright": 4.0, "near saturation": 15.0}
PLAN = Plan(
    theta_i_deg=(30.0,),
    rotations_deg=tuple(float(k) for k in range(len(SAMPLES))),
    exposures_s=(0.25e-3, 4e-3, 64e-3),
)


class Greys(Remembered):
    """Expected images of four even samples, which stand for four rotations of one."""

    def __init__(self) -> None:
        super().__init__(images(small(n=N), PLAN, rho=1.0))
        background = self._light["background", 0, 0]
        white = self._light["sample", 0, 0] - background
        for take, f in enumerate(SAMPLES.values()):
            self._light["sample", take, 0] = background + f * white


@pytest.fixture(scope="module")
def draws() -> list[BRDFSamples]:
    scene = Greys()
    # A sample as bright as fifteen white ones is brighter than anything real.
    return [gonio.reduce(Drawn(scene, seed), threads=1) for seed in range(SEEDS)]


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("place", ["middle", "rim"])
def test_the_independent_uncertainty_is_the_scatter_of_many_draws(draws, name, place):
    z = []
    for samples in draws:
        rim = samples.directions.theta_r > np.radians(65)
        use = (samples.image == list(SAMPLES).index(name)) & (rim if place == "rim" else ~rim)
        z.append(((samples.value - SAMPLES[name] / np.pi) / samples.u_independent)[use])
    z = np.concatenate(z)
    assert len(z) > 700
    # 5 % of the uncertainty is 10 % of its square; chance adds sqrt(2/n) of it.
    assert np.mean(z**2) == pytest.approx(1, abs=0.05 + 3 * np.sqrt(2 / len(z)))
    assert abs(np.mean(z)) < 4 / np.sqrt(len(z))


def test_some_frames_near_saturation_were_used_and_some_were_not(draws):
    # What the case is for: otherwise it would be another bright one.
    session = Drawn(Greys(), 0)
    used = session.bracket("sample", 3, 0)[1] - 256 < 0.9 * (4 * 4095 - 256)
    assert 0.2 < used[N // 4 : -N // 4, N // 4 : -N // 4].mean() < 0.95


def test_the_part_of_standard_and_background_is_what_they_scatter():
    """Draws of standard and background alone, with the sample's frames held."""
    scene = Greys()
    held = Drawn(scene, 1000)
    spread = []
    for seed in range(40):
        session = Drawn(scene, seed)
        for take in range(len(SAMPLES)):
            session.brackets["sample", take, 0] = held.brackets["sample", take, 0]
        samples = gonio.reduce(session, threads=1)
        spread.append((samples.value, samples.u_reference, samples.image))
    same = [s for s in spread if len(s[0]) == len(spread[0][0])]
    assert len(same) > 32  # noise splits a cell now and then
    values = np.stack([s[0] for s in same])
    ratio = values.var(axis=0, ddof=1) / np.mean([s[1] ** 2 for s in same], axis=0)
    for image in range(len(SAMPLES)):
        mean = np.mean(ratio[same[0][2] == image])
        # Variances of 40 draws in each of some 85 cells.
        assert mean == pytest.approx(1, abs=0.05 + 3 * np.sqrt(2 / 40 / 85))


# ---------------------------------------------------------------- what samples share


class Exact:
    """f by eq. (2) on expected images, for any output of the lamp in each of them."""

    def __init__(self, instrument, rho: float, **scene) -> None:
        once = Plan(theta_i_deg=(20.0,), rotations_deg=(0.0,), exposures_s=(0.01,))
        self.scene = images(instrument, once, rho=rho, **scene)
        session = Drawn(self.scene)
        self.samples = gonio.reduce(session, retro=True)
        shape = instrument.sensor.shape
        theta_r = np.full(shape, np.nan)
        theta_r.ravel()[self.scene.rays.pixel] = angles(self.scene.mean_directions)[0]
        self.theta_r = theta_r
        self.f_std = standard_brdf(session.metadata.standard, 0.0, theta_r, 0.0)

    def f(self, **lamp: float) -> tuple[float, float]:
        """Mean f outside the entry patch and inside it."""
        made = {}
        for role in ("background", "standard", "sample"):
            rate = self.scene.rates(role, 0, 0, [lamp.get(role, 1.0)])[0]
            no = np.zeros(rate.shape, bool)
            made[role] = Rate(rate, np.full(rate.shape, 1e6), np.zeros(rate.shape), no)
        ref = reference(made["background"], made["standard"], self.f_std, dark_e_per_s=0.0)
        f = brdf(made["sample"], ref)
        usable = ref.usable & (self.theta_r < np.radians(80))
        return float(f[usable].mean()), float(f[ref.entry].mean())

    def stated(self, name: str) -> tuple[float, float]:
        """Mean change by one standard deviation of a term, outside and inside the patch."""
        (term,) = (term for term in self.samples.shared if term.name == name)
        change, omega = np.abs(term.change(self.samples.value)), self.samples.solid_angle
        entry = self.samples.flags >= 2
        return tuple(float(np.sum((change * omega)[k]) / np.sum(omega[k])) for k in (~entry, entry))


@pytest.mark.parametrize("role", ["sample", "standard", "background"])
@pytest.mark.parametrize("rho", [0.02, 0.5])
def test_the_lamp_s_drift_in_each_image_is_what_its_term_says(role, rho):
    drift = 0.01
    exact = Exact(small(n=N, lamp={"drift": drift}), rho)
    outputs = 1 + drift * np.random.default_rng(2).standard_normal(100)
    usual, patch = np.std([exact.f(**{role: output}) for output in outputs], axis=0) / np.std(
        (outputs - 1) / drift
    )
    stated = exact.stated(f"lamp, {role}")
    # Samples carry the noise of their own; cells that are cut off at the rim weigh less.
    assert usual == pytest.approx(stated[0], rel=0.05)
    assert patch == pytest.approx(stated[1], rel=0.05)


def test_the_standard_s_reflectance_is_what_its_term_says():
    u = 0.02
    rig = small(n=N, standard={"uncertainty": u})
    low, high = (Exact(rig, 0.5, standard_scale=scale).f()[0] for scale in (1 + u, 1 - u))
    exact = Exact(rig, 0.5)
    (term,) = (term for term in exact.samples.shared if term.name == "standard")
    change = term.change(exact.samples.value) / exact.samples.value
    np.testing.assert_allclose(change, (high - low) / 2 / exact.f()[0], rtol=1e-3)


def test_room_light_on_the_sample_is_what_its_term_says():
    a = 0.02
    lobe = {"rho_d": 0.1, "rho_s": 0.3, "alpha_x": 0.2, "alpha_y": 0.2}
    once = Plan(theta_i_deg=(30.0,), rotations_deg=(0.0,), exposures_s=(0.25e-3, 4e-3, 16e-3))
    lit = small(surroundings={"ambient_reflected": a})
    samples = gonio.reduce(Drawn(images(lit, once, "ward", **lobe)))
    ward = models.get("ward")
    (term,) = (term for term in samples.shared if term.name == "room light")
    change = term.change(samples.value)
    off = samples.value - SingleProblem.from_samples(samples, ward).values(ward.vector(lobe))
    noise = samples.u_independent
    # In the lobe, which room light from everywhere fills up less than the standard:
    peak = (change < 0) & (np.abs(change) > noise)
    assert peak.sum() > 50
    weight = (change / noise**2)[peak]
    slope = np.sum(weight * off[peak]) / np.sum(weight * change[peak])
    assert slope == pytest.approx(1, abs=0.15)
    # Elsewhere the mean over the hemisphere stands for what the sample shows in even light; at the
    # rim it shows less of a lobe, and the term is an upper limit.
    rest = change > 5 * noise
    assert rest.sum() > 20
    assert np.all(np.abs(off[rest]) < change[rest] + 4 * noise[rest])
