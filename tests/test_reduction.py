"""Raw frames to samples: a recovery without bias, honest uncertainties, frames of reference."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.calibration.effects import dome_slope
from gonio.calibration.reflector import camera_angles, solid_angle_ratio
from gonio.errors import DataError
from gonio.geometry import rotated, unit_vectors
from gonio.instrument import Instrument, preset
from gonio.metadata import Limits, Plan
from gonio.samples import BRDFSamples
from gonio.session import Session

EXPOSURES = (0.25e-3, 1e-3, 4e-3, 16e-3, 64e-3, 256e-3)
RHO = 0.6


def small(**parts) -> Instrument:
    """ideal12 with 104 x 104 pixels and a few changed figures of its parts."""
    return preset("ideal12").with_pixels(104).altered(**parts)


def plan(theta_i_deg=(0.0, 30.0, 60.0), rotations_deg=(0.0,), exposures_s=EXPOSURES, repeats=1):
    return Plan(
        theta_i_deg=theta_i_deg,
        rotations_deg=rotations_deg,
        exposures_s=exposures_s,
        repeats=repeats,
    )


def record(path: Path, rig=None, *, model="lambert", parameters=None, seed=1, **planned) -> Session:
    return gonio.simulate(
        model=model,
        parameters=parameters or {"rho": RHO},
        output=path,
        instrument=rig or small(),
        plan=plan(**planned),
        seed=seed,
    )


@pytest.fixture(scope="module")
def lambertian(tmp_path_factory) -> Session:
    return record(tmp_path_factory.mktemp("lambert") / "session")


@pytest.fixture(scope="module")
def reduced(lambertian) -> BRDFSamples:
    return gonio.reduce(lambertian)


def test_a_lambertian_sample_comes_back(reduced):
    z = (reduced.value - RHO / np.pi) / reduced.u_independent
    # About 85 cells an image: chi^2/n scatters by sqrt(2/250) = 0.09, two of which are 0.2.
    assert 0.8 < np.mean(z**2) < 1.2
    weight = 1 / reduced.u_independent**2
    mean = np.sum(weight * reduced.value) / np.sum(weight)
    assert abs(mean - RHO / np.pi) < 3 / np.sqrt(np.sum(weight))
    assert reduced.n_negative == 0


def test_samples_hold_what_their_fields_promise(reduced):
    n = len(reduced)
    assert 3 * 80 <= n <= 3 * 95
    d = reduced.directions
    np.testing.assert_allclose(np.unique(np.degrees(d.theta_i)), [0, 30, 60])
    assert np.all(d.phi_i == 0)
    assert np.degrees(d.theta_r.max()) <= 80
    np.testing.assert_array_equal(np.unique(reduced.image), [0, 1, 2])
    assert np.all(reduced.u_reference < reduced.u_independent)
    assert reduced.reference_sharing == 1
    # The centroid of the members is the direction of the sample.
    cells = reduced.cells
    mean = np.add.reduceat(cells.weight[:, None] * cells.w_r, cells.offsets[:-1])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    # Pixel centres against pixel areas: a fraction of a pixel of 1.8 deg squared.
    assert np.max(np.linalg.norm(mean - unit_vectors(d.theta_r, d.phi_r), axis=1)) < 0.03**2
    origin = dict(reduced.metadata)
    assert origin.pop("session").endswith("session")
    unknown = ["geometry of the dome (geometry.uncertain)", "lens calibration (lens.uncertain)"]
    assert (origin.pop("findings"), origin.pop("unknown")) == ([], unknown)
    rig = origin.pop("rig")
    assert rig["identity"].startswith("ideal12 no. ")
    assert (rig["R_mm"], rig["D_mm"], rig["shape"]) == (150.0, 15.0, "ellipsoid")
    assert len(origin.pop("session_sha256")) == 64
    assert origin == {"instrument": "ideal12", "sample": "lambert"}


def test_the_number_of_threads_does_not_matter(lambertian, reduced):
    for threads in (1, 2):
        again = gonio.reduce(lambertian.path, threads=threads)
        np.testing.assert_array_equal(again.value, reduced.value)
        np.testing.assert_array_equal(again.u_independent, reduced.u_independent)
        np.testing.assert_array_equal(again.cells.w_r, reduced.cells.w_r)
        np.testing.assert_array_equal(again.directions.theta_r, reduced.directions.theta_r)
        assert again.history == reduced.history


def test_progress_counts_images(lambertian):
    seen = []
    gonio.reduce(lambertian, progress=lambda done, n: seen.append((done, n)))
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_the_history_says_what_was_done(reduced):
    first, standard, mapping, masked, cells, *notes = reduced.history
    assert first == "ideal12: lambert, 3 images of 6 exposures merged"
    assert standard == "eq. (2) with a standard of pi f(0 deg) = 0.99"
    assert mapping == "eq. (3) with R = 150 mm, D = 15 mm (ellipsoid)"
    assert masked.startswith("masked: theta_r > 80 deg; saturated 0 pixels; ")
    assert cells.endswith(f" pixels in {len(reduced)} equal-area cells")
    assert "unknown, not included: geometry of the dome (geometry.uncertain)" in notes
    assert "unknown, not included: lens calibration (lens.uncertain)" in notes


def test_an_unfinished_session_is_refused(tmp_path, lambertian):
    session = Session.create(tmp_path / "begun", lambertian.metadata)
    session.write("background", 0, 0, 0, lambertian.frame("background", 0, 0, 0))
    message = "1 of 54 frames are there; run the same 'gonio simulate' or 'gonio import' comm"
    with pytest.raises(DataError, match=message):
        gonio.reduce(tmp_path / "begun")


def test_a_damaged_frame_is_refused(tmp_path, lambertian):
    session = Session.create(tmp_path / "copy", lambertian.metadata)
    for role, take, incidence in lambertian.metadata.plan.images():
        for k in range(len(EXPOSURES)):
            session.write(role, take, incidence, k, lambertian.frame(role, take, incidence, k))
    session._array("sample")[0, 1, 2, 50, 50] = 9
    with pytest.raises(DataError, match=r"frame sample/0/1/2 fails its crc32 check"):
        gonio.reduce(tmp_path / "copy")


@pytest.mark.parametrize(
    ("rig", "exposures"),
    [
        # 2 s fill the well of every pixel, even of those of the background.
        (small(surroundings={"stray": 0.5}), (2.0, 4.0)),
        (small(lamp={"white_rate_e_per_s": 1e-3}), EXPOSURES),
    ],
    ids=["saturated", "dark"],
)
def test_a_session_without_a_usable_pixel_is_refused(tmp_path, rig, exposures):
    session = record(tmp_path / "s", rig, theta_i_deg=(0.0,), exposures_s=exposures)
    message = r"no pixel of the session is usable: every one is saturated, too dark or masked\."
    with pytest.raises(DataError, match=message):
        gonio.reduce(session, force=True)


def test_a_rim_inside_the_first_pixel_is_refused(tmp_path):
    rig = small().model_copy(update={"usable_theta_r_deg": 0.01})
    session = record(tmp_path / "s", rig, theta_i_deg=(0.0,), exposures_s=(1e-3,))
    with pytest.raises(DataError, match=r"no pixel lies inside theta_r <= 0\.01 deg; check the"):
        gonio.reduce(session)


def test_only_the_mapping_is_shared_on_an_ideal_instrument(reduced):
    (term,) = reduced.shared
    assert term.name == "mapping"
    assert term.shift.shape == (len(reduced), 3)
    # Tangent to the sphere, and no longer than the leading order (D/R)^3 allows.
    w_r = unit_vectors(reduced.directions.theta_r, reduced.directions.phi_r)
    assert np.max(np.abs(np.sum(term.shift * w_r, axis=1))) < 1e-15
    assert 0 < np.max(np.linalg.norm(term.shift, axis=1)) < 0.1**3


def test_shared_terms_follow_the_metadata(tmp_path):
    rig = small(lamp={"drift": 0.003}, standard={"uncertainty": 0.005})
    turned = {"theta_i_deg": (0.0, 45.0), "rotations_deg": (0.0, 90.0), "repeats": 4}
    samples = gonio.reduce(record(tmp_path / "s", rig, exposures_s=(4e-3, 16e-3), **turned))
    terms = {term.name: term for term in samples.shared}
    lamp = {"lamp, sample", "lamp, standard", "lamp, background"}
    assert set(terms) == {"mapping", "standard", *lamp}
    assert terms["standard"].relative == 0.005
    assert terms["standard"].group is None
    assert terms["lamp, sample"].relative == 0.003
    np.testing.assert_array_equal(terms["lamp, sample"].group, samples.image)
    # Four takes average the lamp, and one standard serves both rotations of an incidence.
    assert terms["lamp, standard"].relative == pytest.approx(0.003 / 2)
    np.testing.assert_array_equal(terms["lamp, standard"].group, samples.image // 2)
    np.testing.assert_allclose(
        np.degrees(samples.directions.theta_i), np.where(samples.image // 2 == 0, 0, 45)
    )
    assert samples.reference_sharing == 2


def test_the_stated_uncertainty_is_the_scatter_over_seeds(tmp_path):
    runs = [
        gonio.reduce(
            record(tmp_path / str(seed), seed=seed, theta_i_deg=(20.0,), exposures_s=(1e-3, 4e-3))
        )
        for seed in range(10)
    ]
    values = np.array([run.value for run in runs])  # a flat image: the same cells every time
    theta = np.array([run.directions.theta_r for run in runs])
    # The weights hold PRNU and noise of a per cent; a cell's pixels lie within 0.2 rad.
    assert np.ptp(theta, axis=0).max() < 0.01 * 0.2
    stated = np.mean([run.u_independent**2 for run in runs], axis=0)
    ratio = values.var(axis=0, ddof=1) / stated
    # Each cell's variance has 9 degrees of freedom.
    error = np.sqrt(2 / 9 / ratio.size)
    assert abs(ratio.mean() - 1) < 3 * error
    # The part of the reference frames, alone: with the sample's part it makes up the whole.
    own = np.mean([run.u_independent**2 - run.u_reference**2 for run in runs], axis=0)
    assert np.all(own > 0)


def test_rotations_share_the_noise_of_the_reference(tmp_path):
    """Two rotations of a flat sample agree better than their whole uncertainty says."""
    session = record(
        tmp_path / "s", theta_i_deg=(20.0,), rotations_deg=(0.0, 90.0), exposures_s=(1e-3, 4e-3)
    )
    samples = gonio.reduce(session)
    first, second = (samples.select(samples.image == k, "") for k in (0, 1))
    assert len(first) == len(second)
    own = np.sqrt(first.u_independent**2 - first.u_reference**2)
    # Cells are cut in the frame of the laboratory, so they pair up.
    z2 = (first.value - second.value) ** 2 / (2 * own**2)
    assert abs(np.mean(z2) - 1) < 3 * np.sqrt(2 / len(z2))


BRUSHED = {"rho_d": 0.05, "rho_s": 0.3, "alpha_x": 0.06, "alpha_y": 0.24}


def over_members(samples: BRDFSamples, psi: float, parameters) -> np.ndarray:
    """Ward's model integrated over each cell for a lamp at phi_i = -psi."""
    ward = models.get("ward")
    cells = samples.cells
    theta_i = float(samples.directions.theta_i[0])
    w_i = np.broadcast_to(unit_vectors(theta_i, -psi), cells.w_r.shape)
    f = ward.evaluate(np.ascontiguousarray(w_i), cells.w_r, ward.vector(parameters))
    return np.add.reduceat(cells.weight * f, cells.offsets[:-1])


def test_a_turned_sample_comes_back_in_its_own_frame(tmp_path):
    psi = np.radians(30)
    session = record(
        tmp_path / "s",
        small(),
        model="ward",
        parameters=BRUSHED,
        theta_i_deg=(40.0,),
        rotations_deg=(30.0,),
    )
    samples = gonio.reduce(session)
    assert np.all(samples.directions.phi_i == -psi)
    peak = np.argmax(samples.value)
    # Specular at phi_i + 180 deg = 150 deg. The lobe of Ward's model leans, and a cell is 2 deg
    # wide; 14 deg tell it from -150 (turned the wrong way) and 180 (not turned).
    assert np.degrees(samples.directions.phi_r[peak]) == pytest.approx(150, abs=14)
    right = over_members(samples, psi, BRUSHED)
    wrong_way = over_members(samples, -psi, BRUSHED)
    swapped = over_members(
        samples, psi, BRUSHED | {"alpha_x": BRUSHED["alpha_y"], "alpha_y": BRUSHED["alpha_x"]}
    )
    # Eq. (3) misplaces directions by up to 0.024 deg, where the lobe falls by 0.43/alpha = 7 of its
    # peak a radian (half the angle counts): 0.3 % of the peak. The rest is noise.
    allowed = 5 * samples.u_independent + 0.003 * right.max()
    assert np.all(np.abs(samples.value - right) < allowed)
    assert np.max(allowed) < 0.1 * right.max()
    assert np.max(np.abs(samples.value - wrong_way)) > 0.3 * right.max()
    assert np.max(np.abs(samples.value - swapped)) > 0.3 * right.max()


def test_solid_angles_make_up_the_usable_cap(tmp_path):
    rig = small(surroundings={"stray": 0.0, "entry_patch": 0.0})
    session = record(tmp_path / "s", rig, theta_i_deg=(0.0,), exposures_s=(4e-3, 16e-3))
    samples = gonio.reduce(session)
    cap = 2 * np.pi * (1 - np.cos(np.radians(80)))
    # The rim is drawn in pixels: about 2 pi 46 of them, each cut at random, which moves the area
    # by sqrt(290/12) pixels of at most 1.4 (1.8 deg)^2 sin(80 deg)/(80 deg).
    pixel = 1.4 * 0.0307**2 * np.sin(np.radians(80)) / np.radians(80)
    assert samples.solid_angle.sum() == pytest.approx(cap, abs=3 * np.sqrt(290 / 12) * pixel)
    assert "entry patch or dark standard 0 pixels" in samples.history[3]
    assert not np.any(samples.flags)


def test_masked_pixels_are_missing_from_the_solid_angles(tmp_path):
    open_cap = small(surroundings={"stray": 0.0, "entry_patch": 0.0})
    planned = {"theta_i_deg": (40.0,), "exposures_s": (4e-3, 16e-3)}
    whole = gonio.reduce(record(tmp_path / "a", open_cap, **planned))
    masked = gonio.reduce(record(tmp_path / "b", small(), **planned))
    line = masked.history[3]
    n = int(line.split("dark standard ")[1].split()[0])
    assert n > 10
    # Solid angle of the pixels around the place where the beam enters, at (40 deg, 0).
    rig = small()
    theta_c, phi_c = camera_angles(np.radians(40), 0.0, R=150.0, D=15.0)
    on_axis = (2 * 27.6e-3 / rig.lens.focal_length_mm) ** 2
    pixel = rig.lens.solid_angle(theta_c) * on_axis
    pixel = float(pixel * solid_angle_ratio(theta_c, phi_c, R=150.0, D=15.0))
    missing = whole.solid_angle.sum() - masked.solid_angle.sum()
    # sin(theta)/theta changes by 2 % over the 5 deg of the patch, antisymmetrically.
    assert missing == pytest.approx(n * pixel, rel=0.02)
    # The cells that lost pixels say so, and only they.
    partial = masked.flags == 1
    assert partial.any()
    near = unit_vectors(masked.directions.theta_r, masked.directions.phi_r) @ unit_vectors(
        np.radians(40), 0.0
    )
    assert np.all(near[partial] > np.cos(np.radians(25)))


def test_slope_errors_move_and_stretch_a_lobe_but_not_beyond_their_size(tmp_path):
    dome = {"slope_error_deg": 0.05, "rim_slope_error_deg": 0.0, "slope_correlation_deg": 10.0}
    session = record(tmp_path / "s", small(dome=dome), rotations_deg=(0.0, 90.0))
    samples = gonio.reduce(session)
    terms = {t.name: t for t in samples.shared if t.name.startswith("dome slope")}
    stretches = [
        f"dome slope, {n}" for n in ("in plane", "across", "shear in plane", "shear across")
    ]
    assert set(terms) == {"dome slope, shift", *stretches}
    # None of them is the dome's own field: a fit must not learn them.
    assert all(term.typical for term in terms.values())
    w_i, w_r = samples.directions.vectors()
    mirror = w_i * [-1, -1, 1]
    apart = np.linalg.norm(w_r - mirror, axis=1)
    largest = 2 * np.radians(0.05)  # a mirror doubles its slope
    for term in terms.values():
        size = np.linalg.norm(term.shift, axis=1)
        assert size.max() <= largest * (1 + 1e-9)
        # A change of direction is across it.
        assert np.max(np.abs(np.sum(term.shift * w_r, axis=1))) < 1e-12
        # Incidences 30 deg apart see other parts of the dome, rotations the same.
        assert len(np.unique(term.group)) == 3
    # A stretch leaves the lobe's centre where it is and grows to the full size L away.
    for name in stretches:
        size = np.linalg.norm(terms[name].shift, axis=1)
        assert np.all(size <= largest * apart / np.radians(10.0) * (1 + 1e-9))


@pytest.mark.parametrize("psi_deg", [0, 45, 70])
def test_slope_errors_stretch_a_lobe_alike_in_every_direction(psi_deg):
    # Directions on a circle of 3 deg about the mirror direction, the sample turned by psi.
    theta_i, psi, apart = np.radians([30.0, psi_deg, 3.0])
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = unit_vectors(np.full(24, apart), around)
    lean = np.array([[np.cos(theta_i), 0, np.sin(theta_i)], [0, 1, 0],
                     [-np.sin(theta_i), 0, np.cos(theta_i)]])  # fmt: skip
    w_r = rotated(ring @ lean, psi)
    mirror = rotated(np.array([0.0, 0.0, 1.0]) @ lean, psi)
    part = SimpleNamespace(theta_i=theta_i, psi=psi, centroid=w_r)
    stated = SimpleNamespace(
        limits=Limits(slope_error_deg=0.05, slope_correlation_deg=10.0),
        plan=SimpleNamespace(theta_i_deg=(30.0,)),
    )
    measured = SimpleNamespace(
        metadata=stated, images=[part], incidence=np.zeros(24, np.int64), dome=None
    )
    terms = list(dome_slope.terms(measured))
    outwards = (w_r - mirror) / np.linalg.norm(w_r - mirror, axis=1, keepdims=True)
    along = [np.sum(t.shift * outwards, axis=1) for t in terms if t.name != "dome slope, shift"]
    spread = np.sqrt(np.sum(np.square(along), axis=0))
    np.testing.assert_allclose(spread, 2 * np.radians(0.05) * 3 / 10, rtol=0.01)


def test_the_shape_of_an_uncertified_standard_is_an_uncertainty(tmp_path):
    rig = small(standard={"rolloff": 0.1, "rolloff_certified": False, "rolloff_uncertainty": 0.1})
    samples = gonio.reduce(record(tmp_path / "s", rig))
    (term,) = (t for t in samples.shared if t.name == "standard, shape")
    change = term.relative * term.profile
    # f comes out high by the standard's loss, 1 / (1 - 0.1 (theta_r / 75 deg)^4), to first order.
    excess = samples.value / (RHO / np.pi) - 1
    noise = samples.u_independent / samples.value
    expected = 1 / (1 - 0.1 * (samples.directions.theta_r / np.radians(75)) ** 4) - 1
    assert np.all(np.abs(excess - expected) < 5 * noise)
    assert np.all(np.abs(excess - change) < 5 * noise + 1.3 * change**2)
