"""Plans by Fisher information: against dense covariances, against fits, against simulations."""

from __future__ import annotations

import itertools
import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from virtual import small

import gonio
from gonio import cli, models
from gonio.fitting.problem.constraints import Constraints
from gonio.geometry import Directions
from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.planning.criteria import c_optimality, d_optimality
from gonio.planning.exchange import choose
from gonio.planning.information import Candidates, Design
from gonio.planning.virtual_session import coarse
from gonio.samples import BRDFSamples, SharedTerm

WARD = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.2, "alpha_y": 0.35}
PLASTIC = {"rho_d": 0.2, "rho_s": 0.1, "alpha": 0.3}
MODEL, P = models.get("ward"), models.get("ward").vector(WARD)
PER_IMAGE = 60


def measured(*, lamp=0.01, standard=0.005, n_incidences=3, n_rotations=2, reference=0.6):
    """Samples of some images with errors of every kind; the numbers of images are shuffled."""
    n_images = n_incidences * n_rotations
    rng = np.random.default_rng(5)
    n = n_images * PER_IMAGE
    image = rng.permutation(np.repeat(np.arange(n_images), PER_IMAGE))
    theta_i = np.radians(np.linspace(5, 60, n_incidences))[image // n_rotations]
    phi_i = -np.radians(np.linspace(0, 90, n_rotations))[image % n_rotations]
    where = Directions(
        theta_i, phi_i, np.arccos(rng.uniform(0.2, 1, n)), rng.uniform(0, 2 * np.pi, n)
    )
    f = MODEL(where, **WARD)
    shared = (
        SharedTerm("standard", "s", standard),
        SharedTerm("lamp, sample", "l", lamp, image, offset=lamp * 0.01 * np.ones(n)),
        SharedTerm("lamp, standard", "l", lamp, image // n_rotations, averages=True),
    )
    u = 0.05 * f + 0.002
    return BRDFSamples(
        where,
        f,
        u_independent=u,
        u_reference=reference * u,
        reference_sharing=n_rotations,
        shared=shared if lamp or standard else (),
        image=image,
    )


def candidates(samples, n_incidences=3, n_rotations=2, **more):
    return Candidates(samples, MODEL, P, n_incidences=n_incidences, n_rotations=n_rotations, **more)


def dense(samples, design, n_rotations=2):
    """J, variances, and covariance of all errors of the samples in a design, from their meaning."""
    numbers = [i * n_rotations + r for i in design.incidences for r in design.rotations]
    own = samples.select(np.flatnonzero(np.isin(samples.image, numbers)), "a design")
    f = MODEL(own.directions, **WARD)
    jacobian = np.empty((len(own), len(P)))
    for j, name in enumerate(MODEL.names):
        step = 1e-5 * P[j]
        up, down = (MODEL(own.directions, **(WARD | {name: P[j] + s})) for s in (step, -step))
        jacobian[:, j] = (up - down) / (2 * step)
    sharing = len(design.rotations) / design.repeats
    variance = own.u_independent**2 + (sharing - 1) * own.u_reference**2
    covariance = np.diag(variance)
    for term in own.shared:
        u = term.relative * f + (0 if term.offset is None else term.offset)
        if term.averages:
            u = u / np.sqrt(design.repeats)
        group = np.zeros(len(own)) if term.group is None else term.group
        covariance += np.outer(u, u) * (group[:, None] == group)
    return jacobian, variance, covariance


DESIGNS = [Design((0, 1, 2), (0, 1)), Design((0, 2), (1,)), Design((1, 2), (0, 1), repeats=3)]


@pytest.mark.parametrize("design", DESIGNS)
def test_information_is_that_of_all_errors_together(design):
    samples = measured()
    jacobian, _, covariance = dense(samples, design)
    expected = jacobian.T @ np.linalg.solve(covariance, jacobian)
    found = candidates(samples).information(design)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_what_is_fixed_leaves_the_conditional_information():
    samples, design = measured(), Design((0, 2), (0, 1), 1)
    whole = candidates(samples).information(design)
    fixed = Constraints.of(MODEL, {"alpha_y": WARD["alpha_y"]})
    found = candidates(samples, constraints=fixed).information(design)
    np.testing.assert_allclose(found, whole[:3, :3], rtol=1e-9)
    # Tied parameters add what each of them would tell alone.
    tied = Constraints.of(MODEL, tied={"rho_s": "rho_d"})
    adds = np.array([[1.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    equal = MODEL.vector(WARD | {"rho_s": WARD["rho_d"]})
    samples = replace(samples, shared=())
    both = Candidates(samples, MODEL, equal, n_incidences=3, n_rotations=2)
    one = Candidates(samples, MODEL, equal, n_incidences=3, n_rotations=2, constraints=tied)
    np.testing.assert_allclose(
        one.information(design), adds @ both.information(design) @ adds.T, rtol=1e-9
    )


@pytest.mark.parametrize("design", DESIGNS)
def test_a_fit_weighs_by_independent_errors_and_carries_the_others_through(design):
    samples = measured()
    jacobian, variance, covariance = dense(samples, design)
    gain = np.linalg.solve((jacobian.T / variance) @ jacobian, jacobian.T / variance)
    made = candidates(samples)
    expected = made.expected(design)
    np.testing.assert_allclose(expected.u, np.sqrt(np.diag(gain @ covariance @ gain.T)), rtol=1e-6)
    parts = np.sqrt(sum(u**2 for u in expected.components.values()))
    np.testing.assert_allclose(parts, expected.u, rtol=1e-12)
    # No estimator is better than its bound.
    assert np.all(made.bound(design) <= expected.u * (1 + 1e-9))


def test_a_fit_states_what_was_expected():
    samples = measured()
    expected = candidates(samples).expected(Design((0, 1, 2), (0, 1)))
    rng = np.random.default_rng(3)
    # Noise of chi^2 just below its degrees of freedom: a fit then leaves the weights alone.
    noise = 0.9 * samples.u_independent * rng.standard_normal(len(samples))
    found = gonio.fit(replace(samples, value=samples.value + noise), model=MODEL, start=WARD)
    stated = [found.parameters[name].stderr for name in MODEL.names]
    # Weights are taken at the fitted values, 5 % noise away.
    np.testing.assert_allclose(stated, expected.u, rtol=0.05)


def test_without_shared_errors_information_adds_over_images():
    made = candidates(measured(lamp=0.0, standard=0.0))
    both = made.information(Design((0, 2), (0,)))
    apart = made.information(Design((0,), (0,))) + made.information(Design((2,), (0,)))
    np.testing.assert_allclose(both, apart, rtol=1e-9)


@pytest.mark.parametrize(
    ("reference", "chain"),
    [
        (0.6, [Design((1,), (0, 1)), Design((1, 2), (0, 1)), Design((1, 2), (0, 1), repeats=2)]),
        # Noise of the standard's frames is counted once a rotation; without it they add as well.
        (0.0, [Design((1,), (0,)), Design((1, 2), (0,)), Design((1, 2), (0, 1))]),
    ],
)
def test_more_images_never_lower_the_information(reference, chain):
    made = candidates(measured(reference=reference))
    found = [made.information(design) for design in chain]
    for fewer, more in itertools.pairwise(found):
        scale = 1 / np.sqrt(np.diag(more))
        assert np.linalg.eigvalsh((more - fewer) * np.outer(scale, scale)).min() > -1e-9
    bounds = np.array([made.bound(design) for design in chain])
    assert np.all(np.diff(bounds, axis=0) <= 1e-9 * bounds[1:])


def test_the_standard_cannot_be_averaged_away():
    samples = measured(lamp=0.0)
    made = candidates(samples)
    whole = made.everything
    # It scales rho_d and rho_s, and no roughness.
    bound = made.bound(whole)
    assert np.all(bound[:2] > 0.005 * P[:2])
    expected = made.expected(whole)
    np.testing.assert_allclose(expected.components["standard"][:2], 0.005 * P[:2], rtol=1e-6)
    np.testing.assert_allclose(expected.components["standard"][2:], 0, atol=1e-9)


def test_the_search_keeps_to_its_budget_and_stops_when_it_is_there():
    made = candidates(measured(n_incidences=6), n_incidences=6)
    criterion = d_optimality(np.ones(4, dtype=bool))
    for budget in (3, 8, 12):
        assert choose(made, criterion, budget=budget).n_images <= budget
    target = 1.05 * made.expected(made.everything).u

    def reached(expected):
        return bool(np.all(expected.u <= target))

    found = choose(made, c_optimality(target), reached=reached)
    assert reached(made.expected(found))
    assert found.n_images <= made.everything.n_images


def test_the_search_is_as_good_as_trying_every_plan():
    made = candidates(measured(n_incidences=4), n_incidences=4)
    criterion = d_optimality(np.ones(4, dtype=bool))
    found = choose(made, criterion, budget=8)
    every = [
        Design(i, r)
        for i in [(a,) for a in range(4)] + [(a, b) for a in range(4) for b in range(a + 1, 4)]
        for r in [(0,), (1,), (0, 1)]
    ]
    best = min(criterion(made.expected(design)) for design in every)
    # A merit is the sum of four logarithms: 5 % of each.
    assert criterion(made.expected(found)) < best + 4 * np.log(1.05)


def test_a_coarser_sensor_sums_the_same_pixels():
    rig = preset("modern12")
    binned = coarse(rig).sensor
    assert binned.shape == (208, 208)
    assert binned.binned_full_well_e == 4 * rig.sensor.binned_full_well_e
    assert binned.saturation_dn <= 65535
    assert coarse(small()).sensor == small().sensor


# ---------------------------------------------------------------- plans of instruments


def tiny(name="modern12", **parts):
    rig = small(name, 52, **parts)
    return rig.model_copy(update={"rays_per_pixel": 8})


def test_a_plan_for_alpha_y_does_more_with_a_frame_than_the_default():
    found = gonio.design(MODEL, WARD, instrument=tiny(), wanted={"alpha_y": 0.001})
    j = MODEL.names.index("alpha_y")
    ratio = (found.expected_of_default.u[j] / found.expected.u[j]) ** 2
    assert ratio * found.default_plan.n_frames / found.plan.n_frames > 2
    assert found.plan.n_frames < found.default_plan.n_frames
    assert found.most_helpful[j][2] > 1


def test_without_a_wish_the_plan_is_as_good_as_the_default_and_smaller():
    model = models.get("ward_isotropic")
    found = gonio.design(model, PLASTIC, instrument=tiny())
    # Exposures that were left out may cost 1 %.
    assert np.all(found.expected.u <= 1.02 * found.expected_of_default.u)
    assert found.plan.n_frames < found.default_plan.n_frames
    assert found.plan.rotations_deg == (0.0,)
    assert set(found.plan.exposures_s) <= set(found.default_plan.exposures_s)


@pytest.mark.parametrize(
    ("name", "lamp", "seeds"),
    [("ideal12", {}, 20), ("ideal12", {"drift": 0.01}, 20)],
    ids=["ideal", "drift"],
)
def test_simulations_scatter_as_expected(name, lamp, seeds):
    rig = tiny(name, lamp=lamp)
    check = gonio.design(
        "ward_isotropic", PLASTIC, instrument=rig, budget=12, verify=seeds
    ).verification
    ratios = np.array([row["ratio"] for row in check["parameters"]])
    # The scatter of 20 seeds is known to 1/sqrt(2 19) = 16 %.
    assert check["relative_sd_of_scatter"] == pytest.approx(0.16, abs=0.005)
    assert np.sqrt(np.mean(ratios**2)) == pytest.approx(1, abs=0.3)
    assert np.all(np.abs(ratios - 1) < 3 * 0.16)


# ---------------------------------------------------------------- the command


@pytest.fixture
def run(capsys):
    """Run the command line in this process: (exit code, stdout, stderr)."""

    def words(*given):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main(["design", *map(str, given)])
        return left.value.code, *capsys.readouterr()

    return words


@pytest.fixture
def rig_file(tmp_path):
    """An instrument of few pixels as a file."""
    from importlib import resources

    text = (resources.files("gonio.data") / "instruments" / "modern12.toml").read_text("utf-8")
    pitch = 1664 * 3.45 / 104
    for old, new in {
        "rows = 1664": "rows = 104",
        "columns = 1664": "columns = 104",
        "[3.45, 3.45]": f"[{pitch}, {pitch}]",
        "binning = 4": "binning = 2",
        "slope_error_deg = 0.03 ": "slope_error_deg = 0.0 ",
        "rim_slope_error_deg = 0.2 ": "rim_slope_error_deg = 0.0 ",
        "rays_per_pixel = 16": "rays_per_pixel = 8",
    }.items():
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def surface(model="ward", **parameters):
    pairs = [("-p", f"{name}={value}") for name, value in (parameters or WARD).items()]
    return ["--model", model, *itertools.chain(*pairs)]


def test_the_command_names_its_plan_its_limits_and_how_to_take_it(run, rig_file, tmp_path):
    output = tmp_path / "plan.toml"
    code, out, err = run(
        *surface("ward_isotropic", **PLASTIC), "--instrument", rig_file,
        "--want", "rho_s=0.002,alpha=0.01", "-o", output,
    )  # fmt: skip
    assert code == 1  # the plan does not reach what was wanted
    text = " ".join(out.split())
    assert "rho_s: 0.2 % was wanted and" in text
    assert "reflectance of the white standard alone is 0.5 %, more than that." in text
    assert "gonio simulate --model ward_isotropic -p rho_d=0.2 -p rho_s=0.1 -p alpha=0.3 " in text
    assert "looking at 21 x 1 images" in err
    plan = Plan.model_validate(tomllib.loads(output.read_text(encoding="utf-8"))["plan"])
    assert f"{plan.n_images} images, {plan.n_frames} frames; default plan: 63 images" in text


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (surface("oren_nayar", sigma=0, rho=0.8), "sigma"),
        (surface("ward", **(WARD | {"rho_s": 0.0})), "alpha_y"),
    ],
)
def test_what_no_plan_determines_is_named(run, rig_file, words, name):
    code, out, _ = run(*words, "--instrument", rig_file, "--budget", 6, "--json")
    document = json.loads(out)
    assert (code, document["schema"]) == (0, "gonio.design/1")
    assert any(
        line.startswith(f"{name}: no plan of modern12 determines it where it is")
        for line in document["remarks"]
    )
    (row,) = [row for row in document["parameters"] if row["name"] == name]
    assert row["u"] is None
    assert document["plan"]["images"] <= 6


def test_a_plan_for_a_fit_with_fixed_and_tied_parameters(run, rig_file):
    words = surface("ward", **(WARD | {"alpha_y": 0.2}))
    code, out, _ = run(
        *words, "--fix", "rho_d=0.2", "--tie", "alpha_y=alpha_x", "--instrument", rig_file,
        "--budget", 6, "--json",
    )  # fmt: skip
    assert code == 0
    rows = {row["name"]: row for row in json.loads(out)["parameters"]}
    assert rows["rho_d"]["fixed"] is True
    assert rows["rho_d"]["u"] is None
    assert rows["alpha_y"]["tied_to"] == "alpha_x"
    assert rows["alpha_y"]["u"] == rows["alpha_x"]["u"] > 0
    assert not {"fixed", "tied_to"} & set(rows["rho_s"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--fix", "alpha_y=0.1", "--want", "alpha_y=0.01"],
            "alpha_y is fixed and has no wanted uncertainty; leave one of the two out.",
        ),
        (["--want", "alpha_z=0.01"], "unknown parameter 'alpha_z' of ward: did you mean 'alpha_"),
        (["--want", "alpha_x=0"], "--want alpha_x=0: a relative standard uncertainty is a posi"),
        (["--want", "alpha_x=-1"], "--want alpha_x=-1: a relative standard uncertainty is a posi"),
        (["--want", "alpha_x=a"], "--want alpha_x=a: a relative standard uncertainty is a posi"),
        (
            ["--want", "alpha_x"],
            "--want 'alpha_x' is not NAME=SHARE; write for example --want",
        ),
        (["--want", "rho_d=0.1,rho_d=0.2"], "--want rho_d is given twice; give it once."),
        (["-p", "rho_s=0", "--want", "rho_s=0.1"], "rho_s is 0, of which no share can be wanted"),
        (["--budget", 2], "--budget 2: at least 3 images are needed, one each of sample, standard"),
        (["-o", "missing/plan.toml"], "the folder missing does not exist; make it first."),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(run, words, message):
    code, out, err = run("--model", "ward", *words)
    assert code in (2, 3)
    assert out == ""
    assert message in err
