"""Sums of models by name: their terms and nothing else, compiled once, kept on disk, fitted."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gonio import fit, models
from gonio.cli import evaluate as evaluate_command
from gonio.cli import models as models_command
from gonio.errors import ConfigurationError
from gonio.geometry import Directions, unit_vectors
from gonio.models._sums import joined
from gonio.models.base import Model
from gonio.samples import BRDFSamples

SUMS = ["lambert+ward_duer", "ward+ward"]
LONG = "oren_nayar_qualitative+phong+ggx+lambert"


def pairs(n: int, theta_max: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    theta, phi = rng.uniform(0, theta_max, (2, n)), rng.uniform(0, 2 * np.pi, (2, n))
    return unit_vectors(theta[0], phi[0]), unit_vectors(theta[1], phi[1])


def somewhere(model: Model) -> np.ndarray:
    """A parameter vector inside the range, another value for each parameter."""
    share = np.linspace(0.1, 0.4, len(model.parameters))
    return np.array(
        [q.lower + t * (q.upper - q.lower) for q, t in zip(model.parameters, share, strict=True)]
    )


def terms_of(name: str) -> list[Model]:
    return [models.get(term) for term in name.split("+")]


def shares(name: str, p: np.ndarray) -> list[np.ndarray]:
    """The parameter vector of each term."""
    ends = np.cumsum([len(term.parameters) for term in terms_of(name)])
    return np.split(p, ends[:-1])


@pytest.mark.parametrize("name", SUMS)
def test_values_and_derivatives_are_those_of_the_terms(name: str) -> None:
    model = models.get(name)
    w_i, w_r = pairs(500)
    p = somewhere(model)
    f, gradient = model.gradient(w_i, w_r, p)
    each = [t.gradient(w_i, w_r, q) for t, q in zip(terms_of(name), shares(name, p), strict=True)]
    np.testing.assert_allclose(f, sum(value for value, _ in each), rtol=1e-15)
    expected = np.concatenate([slope for _, slope in each], axis=-1)
    np.testing.assert_allclose(gradient, expected, rtol=1e-15)
    np.testing.assert_array_equal(model.evaluate(w_i, w_r, p), f)


@pytest.mark.parametrize("name", SUMS)
def test_compiled_code_equals_its_plain_python_twin(name: str) -> None:
    model = models.get(name)
    w_i, w_r = pairs(100)
    p = somewhere(model)
    f, gradient = model.gradient(w_i, w_r, p)
    plain = np.array([model.plain(i, r, p) for i, r in zip(w_i, w_r, strict=True)])
    np.testing.assert_allclose(f, plain[:, 0], rtol=1e-13)
    np.testing.assert_allclose(gradient, plain[:, 1:], rtol=1e-12, atol=1e-15)


def test_any_number_of_terms_is_added() -> None:
    model = models.get(LONG)
    p = somewhere(model)
    for i, r in zip(*pairs(20), strict=True):
        each = [t.plain(i, r, q) for t, q in zip(terms_of(LONG), shares(LONG, p), strict=True)]
        f, *gradient = model.plain(i, r, p)
        assert f == pytest.approx(sum(values[0] for values in each), rel=1e-15)
        assert gradient == [slope for values in each for slope in values[1:]]


def test_a_sum_is_zero_below_the_horizon() -> None:
    below = Directions([1.6, 0.3, np.pi / 2], 0.0, [0.3, 1.6, 0.2], np.pi)
    assert models.get("ward+ward")(below).tolist() == [0, 0, 0]


def test_names_that_no_other_term_has_are_kept() -> None:
    model = models.get("lambert+ward_duer")
    assert model.names == ("rho", "rho_d", "rho_s", "alpha_x", "alpha_y")
    assert [q.symbol for q in model.parameters] == ["ρ", "ρ_d", "ρ_s", "α_x", "α_y"]
    assert model.parameter("rho").meaning == "diffuse reflectance (term 1, lambert)"


def test_names_that_several_terms_have_carry_the_number_of_their_term() -> None:
    names = models.get("ward+ward").names
    assert names[:4] == ("rho_d_1", "rho_s_1", "alpha_x_1", "alpha_y_1")
    assert names[4:] == ("rho_d_2", "rho_s_2", "alpha_x_2", "alpha_y_2")
    assert models.get("ward+ward").parameter("alpha_x_2").symbol == "α_x_2"
    names = tuple(q.name for own in joined(terms_of("lambert+ward+lambert")) for q in own)
    assert names == ("rho_1", "rho_d", "rho_s", "alpha_x", "alpha_y", "rho_3")


def test_the_names_of_every_pair_of_models_are_unique() -> None:
    single = [models.get(name) for name in models.names()]
    for terms in itertools.combinations_with_replacement(single, 2):
        names = [q.name for own in joined(terms) for q in own]
        assert len(set(names)) == len(names)


def test_a_declaration_keeps_its_range_unit_and_linearity() -> None:
    model = models.get("oren_nayar_qualitative+oren_nayar_qualitative")
    single = models.get("oren_nayar_qualitative")
    for q, first in zip(model.parameters, single.parameters * 2, strict=True):
        for field in ("default", "lower", "upper", "unit", "scale", "linear", "start"):
            assert getattr(q, field) == getattr(first, field)


def test_a_sum_is_one_model_however_it_is_spaced() -> None:
    model = models.get(" lambert +ward_duer")
    assert model is models.get("lambert+ward_duer")
    assert model.name == "lambert+ward_duer"
    assert model.title == "Lambert + Ward, elliptical Gaussian, normalised by Duer"
    assert model.reference.startswith("Lambert, Photometria (1760); Duer 2006")
    assert model.validity.endswith(".")


def test_a_sum_claims_what_all_its_terms_claim() -> None:
    claims = models.get("lambert+minnaert").claims
    assert claims.isotropic
    assert claims.lambert_limit is None
    claims = models.get(LONG).claims
    terms = [term.claims for term in terms_of(LONG)]
    assert claims.reciprocal == all(c.reciprocal for c in terms)
    assert claims.non_negative == all(c.non_negative for c in terms)
    assert not claims.isotropic
    assert set(claims.seams) == {seam for c in terms for seam in c.seams}
    assert claims.seams


def test_a_sum_claims_the_bounds_of_its_terms_where_each_has_one() -> None:
    assert models.get("lambert+ward_gmd").claims.albedo_at_most == ("rho", "rho_d", "rho_s")
    both = models.get("ward_gmd+ward_gmd").claims.albedo_at_most
    assert both == ("rho_d_1", "rho_s_1", "rho_d_2", "rho_s_2")
    # Ward's lobe has no bound; rough plastic may return all light by itself.
    assert models.get("lambert+ward").claims.albedo_at_most is None
    assert models.get("lambert+rough_plastic").claims.albedo_at_most is None


def test_a_sum_is_drawn_from_by_the_lobes_of_its_terms() -> None:
    model = models.get("phong+ggx")
    p = model.vector({"rho_d_1": 0.1, "rho_s": 0.2, "n": 200, "rho_d_2": 0, "alpha_x": 0.3})
    w_i, w_r = pairs(200)
    # Cosine and mirror lobe of the first term, cosine and facets of the second, each by the share
    # that it has in its own model.
    named = dict(zip(model.names, p.tolist(), strict=True))
    own = [lobe.density(named, w_i, w_r) for lobe in model.lobes]
    chance = [np.broadcast_to(lobe.chance(named, w_i[:, 2]), 200) for lobe in model.lobes]
    np.testing.assert_array_equal(chance[0], 0.1)
    np.testing.assert_array_equal(chance[1], 0.2)
    np.testing.assert_array_equal(chance[2], 0.0)
    for k, (name, given) in enumerate(
        (
            ("phong", {"rho_d": 0, "rho_s": 1, "n": 200}),
            ("ggx", {"rho_d": 0, "alpha_x": 0.3}),
        )
    ):
        term = models.get(name)
        alone = term.density(w_i, w_r, term.vector(given))
        np.testing.assert_allclose(own[2 * k + 1], alone, rtol=1e-12)
    mixed = sum(c * d for c, d in zip(chance, own, strict=True)) / sum(chance)
    np.testing.assert_allclose(model.density(w_i, w_r, p), mixed, rtol=1e-12)


def test_a_sum_with_a_costly_term_is_costly() -> None:
    assert models.get("oren_nayar_numeric+phong").costly
    assert not models.get("oren_nayar+phong").costly


def test_the_list_holds_the_single_models_only() -> None:
    models.get("ward+ward")
    assert not [name for name in models.names() if "+" in name]


def test_a_term_that_does_not_exist_is_answered_with_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match="unknown model 'ward_dur': did you mean 'ward_du"):
        models.get("lambert+ward_dur")


@pytest.mark.parametrize("name", ["lambert+", "+ward", "lambert++ward", "+", "lambert+ "])
def test_an_empty_term_is_refused(name: str) -> None:
    match = "has an empty term; write the names of two or more models with one '\\+' between them"
    with pytest.raises(ConfigurationError, match=match) as caught:
        models.get(name)
    assert caught.value.value == name


def test_a_parameter_without_its_number_is_answered_with_the_nearest() -> None:
    match = r"unknown parameter 'alpha_x' of ward\+ward: did you mean 'alpha_x_[12]'"
    with pytest.raises(ConfigurationError, match=match):
        models.get("ward+ward")(Directions(0, 0, 0, 0), alpha_x=0.1)


RUN = """
import numpy as np
from gonio import models
loops = models.get("lambert+minnaert").loops
out = np.empty(1)
up = np.array([[0.0, 0.0, 1.0]])
loops.evaluate(*up.T, *up.T, np.array([0.5, 0.25, 1.0]), out)
stats = loops.evaluate.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), out[0])
"""


def test_a_second_process_reads_the_code_of_the_first(tmp_path: Path) -> None:
    def once() -> list[str]:
        environment = {**os.environ, "GONIO_CACHE_DIR": str(tmp_path)}
        command = [sys.executable, "-c", RUN]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.split()

    first, second = once(), once()
    assert first[:2] == ["0", "1"]
    assert second[:2] == ["1", "0"]
    # Both terms are Lambertian along the normal, and for k = 1 everywhere.
    assert float(first[2]) == float(second[2]) == pytest.approx(0.75 / np.pi, rel=1e-15)


def test_a_fit_finds_a_narrow_and_a_broad_lobe() -> None:
    rng = np.random.default_rng(5)
    n = 400
    theta_i, phi_i = rng.uniform(0.1, 1.0, n), rng.uniform(0, 2 * np.pi, n)
    # Most directions lie about the mirror direction, where the lobes differ.
    theta_r = np.clip(theta_i + rng.normal(0, 0.25, n), 0.0, 1.3)
    directions = Directions(theta_i, phi_i, theta_r, phi_i + np.pi + rng.normal(0, 0.4, n))
    narrow = {"rho_s": 0.1, "alpha_x": 0.06, "alpha_y": 0.08}
    broad = {"rho_s": 0.3, "alpha_x": 0.3, "alpha_y": 0.22}
    truth = {f"{key}_{k}": v for k, lobe in ((1, narrow), (2, broad)) for key, v in lobe.items()}
    f = models.get("ward+ward")(directions, rho_d_1=0.06, rho_d_2=0.04, **truth)
    sd = 0.01 * f + 1e-4
    samples = BRDFSamples(directions, f + sd * rng.standard_normal(n), sd)
    result = fit(samples, model="ward+ward")
    found = result.parameters
    assert result.status == "converged"
    assert result.chi2 / result.dof == pytest.approx(1, abs=4 * np.sqrt(2 / n))
    # Lobes of the same model may be exchanged: the narrow one tells which is which.
    k = 1 if found["alpha_x_1"].value < found["alpha_x_2"].value else 2
    for lobe, number in ((narrow, k), (broad, 3 - k)):
        for name, true in lobe.items():
            estimate = found[f"{name}_{number}"]
            assert estimate.stderr is not None
            assert estimate.stderr < 0.05 * true
            assert abs(estimate.value - true) < 4 * estimate.stderr
    # Two diffuse terms have one shape: the fit knows their sum and says so.
    assert found["rho_d_1"].value + found["rho_d_2"].value == pytest.approx(0.1, abs=2e-3)
    assert found["rho_d_1"].stderr is None
    assert any("rho_d_1 is not determined" in warning for warning in result.warnings)


def run(module: ModuleType, *words: str) -> Result:
    return CliRunner().invoke(module.command, words, catch_exceptions=False)


def test_the_command_line_evaluates_a_sum(tmp_path: Path) -> None:
    angles = tmp_path / "angles.csv"
    angles.write_text("theta_i,phi_i,theta_r,phi_r\n30,0,40,180\n0,0,0,0\n", encoding="utf-8")
    values = ["rho=0.2", "rho_d=0", "rho_s=0.1", "alpha_x=0.1", "alpha_y=0.2"]
    options = [word for value in values for word in ("-p", value)]
    done = run(evaluate_command, "lambert+ward_duer", *options, "--angles", str(angles))
    assert done.exit_code == 0
    brdf = [float(line.rsplit(",", 1)[1]) for line in done.stdout.splitlines()[1:]]
    # Along the normal Ward's lobe is rho_s / (4 pi alpha_x alpha_y).
    assert brdf[1] == pytest.approx(0.2 / np.pi + 0.1 / (4 * np.pi * 0.02), rel=1e-14)
    lobe = models.get("ward_duer")(
        Directions(*np.radians([30, 0, 40, 180])), rho_d=0, rho_s=0.1, alpha_x=0.1, alpha_y=0.2
    )
    assert brdf[0] == pytest.approx(0.2 / np.pi + float(lobe), rel=1e-14)


def test_the_command_line_shows_a_sum() -> None:
    done = run(models_command, "lambert+ward_duer")
    assert done.exit_code == 0
    assert "f = lambert(rho) + ward_duer(rho_d, rho_s, alpha_x, alpha_y)" in done.stdout
    done = run(models_command, "ward+ward", "--json")
    assert json.loads(done.stdout)["parameters"][0]["name"] == "rho_d_1"


def test_degrees_are_shown_without_the_rounding_of_radians() -> None:
    for name in models.names():
        for shown in models.get(name).describe()["parameters"]:
            if shown["unit"] == "deg":
                for key in ("default", "lower", "upper"):
                    assert shown[key] == round(shown[key], 9)
