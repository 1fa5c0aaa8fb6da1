"""Bad input: a clear sentence, the right status, no traceback, and never a confident number."""

from __future__ import annotations

import numpy as np
import pytest

import gonio
from gonio import cli, models
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

N = 40
NOISE = 1 + 0.01 * np.random.default_rng(0).standard_normal(N)
GREY = 0.1 * NOISE
U = np.full(N, 1e-3)


def scattered(n=N, theta_max=70, seed=1):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, theta_max, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def samples(value=GREY, where=None, **columns):
    return BRDFSamples(where or scattered(len(value)), np.asarray(value, float), **columns)


def honest(result, name):
    """Every number is finite and inside the bounds; no uncertainty is zero."""
    result.to_json()
    for q in models.get(name).parameters:
        estimate = result.parameters[q.name]
        assert q.lower <= estimate.value <= q.upper
        assert estimate.stderr is None or 0 < estimate.stderr < np.inf
        if estimate.stderr is not None:
            # A number below the rounding of the value is no uncertainty.
            assert estimate.stderr > 1e-14 * abs(estimate.value)


# ---------------------------------------------------------------- in every model


def everywhere():
    outlier = GREY.copy()
    outlier[7] = 1e4
    plane = np.linspace(-1.2, 1.2, N)
    one = Directions(np.full(N, 0.5), 0.0, np.abs(plane), np.where(plane < 0, 0, np.pi))
    grazing = Directions(np.full(N, np.pi / 2), 0.0, scattered().theta_r, scattered().phi_r)
    yield "constant", samples(np.full(N, 0.1))
    yield "zero", samples(np.zeros(N))
    yield "negative", samples(-GREY, u_independent=U)
    yield "one outlier", samples(outlier, u_independent=U)
    yield "one plane", samples(where=one, u_independent=U)
    yield "light at 90 deg", samples(where=grazing, u_independent=U)
    yield "u a billion times too small", samples(u_independent=U * 1e-9)
    yield "u a billion times too large", samples(u_independent=U * 1e9)


def pairs():
    """Every case on three models, and one plane on every model that is quick to fit."""
    for what, data in everywhere():
        for name in models.names():
            wide = sum(not q.linear for q in models.get(name).parameters) > 2
            quick = not wide and name != "oren_nayar_numeric"
            if name in ("lambert", "ward", "oren_nayar") or (what == "one plane" and quick):
                yield pytest.param(what, data, name, id=f"{what}-{name}")


@pytest.mark.parametrize(("what", "data", "name"), list(pairs()))
def test_no_model_gives_a_confident_number(what, data, name):
    result = gonio.fit(data, model=name, threads=1)
    honest(result, name)
    if what == "constant" and name == "lambert":
        assert result.parameters["rho"].stderr is None
    if what == "u a billion times too large":
        assert all(e.stderr is None for e in result.parameters.values() if not e.unit)
        assert result.verdict.kind == "undecided"
        assert any(
            "as large as the stated noise (p < 1e-6): u_brdf is too large" in text
            for text in result.warnings
        )
    if what == "light at 90 deg":
        # Nothing is reflected towards a light in the plane of the sample: nothing is learnt.
        assert all(e.stderr is None for e in result.parameters.values())


# ---------------------------------------------------------------- sentences, in Python


def test_constant_data_without_u_say_nothing_of_the_noise():
    result = gonio.fit(samples(np.full(N, 0.1)), model="lambert")
    rho = result.parameters["rho"]
    assert rho.value == pytest.approx(0.1 * np.pi)
    assert (rho.stderr, rho.interval_68, rho.interval_95) == (None, None, None)
    assert result.covariance is None
    assert (
        "the model leaves no residuals beyond rounding and the samples state no uncertainty: "
        "the parameters have no uncertainties; give u_brdf." in result.warnings
    )


def test_copies_count_once():
    once = samples(u_independent=U)
    twice = once.select(np.tile(np.arange(N), 2), "twice")
    a, b = (gonio.fit(s, model="lambert") for s in (once, twice))
    assert b.parameters["rho"].stderr == a.parameters["rho"].stderr
    assert b.n_samples == N
    assert (
        "40 of 80 samples are exact copies of others (same directions and value); they add "
        "no information and were counted once." in b.warnings
    )
    assert not any("copies" in text for text in a.warnings)


def test_repeated_directions_with_their_own_noise_are_no_copies():
    where = Directions(*(np.full(N, a) for a in (0.5, 0.0, 0.5, np.pi)))
    result = gonio.fit(samples(where=where, u_independent=U), model="lambert")
    assert result.n_samples == N
    assert result.parameters["rho"].stderr == pytest.approx(np.pi * 1e-3 / np.sqrt(N), rel=0.2)


@pytest.mark.parametrize(
    ("scale", "what"), [(1e200, "a BRDF value is"), (1e-300, "a BRDF value is")]
)
def test_values_that_cannot_be_squared_are_refused(scale, what):
    with pytest.raises(DataError, match=f"^{what} .* Check the unit and the scale of the data"):
        gonio.fit(samples(GREY * scale), model="lambert")


def test_an_uncertainty_that_cannot_be_squared_is_refused():
    u = U.copy()
    u[3] = 1e-200
    with pytest.raises(DataError, match=r"^the smallest u_brdf is 1e-200 sr\^-1; a fit can"):
        gonio.fit(samples(u_independent=u), model="lambert")


def test_all_weights_zero_is_refused_as_an_uncertainty():
    with pytest.raises(DataError, match=r"^the uncertainty .* must be positive"):
        samples(u_independent=np.zeros(N))


def test_a_grazing_view_has_no_weight_and_says_so():
    # cos theta_r = 0 everywhere: the weights "cos" leave nothing.
    where = Directions(scattered().theta_i, 0.0, np.full(N, np.pi / 2), scattered().phi_r)
    result = gonio.fit(samples(where=where), model="lambert", weights="cos")
    assert result.parameters["rho"].stderr is None


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_no_numbers_are_refused(bad):
    value = GREY.copy()
    value[5] = bad
    with pytest.raises(DataError, match=r"^a BRDF value is not finite; remove the sample\.$"):
        samples(value)


def test_directions_below_the_horizon_are_refused():
    where = Directions(np.full(N, 2.0), 0.0, scattered().theta_r, scattered().phi_r)
    with pytest.raises(DataError, match=r"^theta_i = 114\.592 deg is beyond the horizon; "):
        samples(where=where)


def test_fewer_samples_than_parameters_are_refused():
    with pytest.raises(DataError, match=r"^3 samples cannot determine the 4 parameters of ward; "):
        gonio.fit(samples(GREY[:3]), model="ward")
    # Copies do not make them more.
    few = samples(GREY[:3]).select(np.arange(30) % 3, "ten times")
    with pytest.raises(DataError, match=r"^3 samples cannot determine the 4 parameters of ward; "):
        gonio.fit(few, model="ward")


def test_sd_weights_without_uncertainties_are_refused():
    with pytest.raises(ConfigurationError, match=r"^weights 'sd' need uncertainties"):
        gonio.fit(samples(), model="lambert", weights="sd")


# ---------------------------------------------------------------- the same at the terminal


HEADER = "theta_i,phi_i,theta_r,phi_r,brdf"


@pytest.fixture
def fit_of(tmp_path, capsys):
    """Fit lines of a CSV file: (exit code, stdout, stderr)."""

    def run(lines, *words, model="lambert"):
        path = tmp_path / "data.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        with pytest.raises(SystemExit) as left:
            cli.main(["fit", str(path), "--model", model, *words])
        return left.value.code, *capsys.readouterr()

    return run


def rows(value="0.1", n=9, theta_i="30", u=None):
    tail = "" if u is None else f",{u}"
    return [f"{theta_i},0,{5 * k},{40 * k},{value}{tail}" for k in range(n)]


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ([HEADER], "no rows follow the header"),
        ([HEADER, *rows("nan")], "nan"),
        ([HEADER, *rows("inf")], "inf"),
        ([HEADER, *rows(theta_i="95")], "horizon"),
        ([HEADER, *rows(n=1)], "1 sample cannot determine the 1 parameter of lambert"),
        ([HEADER + ",u_brdf", *rows(u="0")], "column u_brdf: 0 is not positive"),
        ([HEADER + ",u_brdf", *rows(u="1e-200")], "the smallest u_brdf is 1e-200"),
        ([HEADER, *rows("1e200")], "a BRDF value is 1e+200"),
    ],
)
def test_the_terminal_shows_one_sentence_and_no_traceback(fit_of, lines, text):
    code, out, err = fit_of(lines)
    assert code not in (0, 1)
    assert out == ""
    assert text in err.replace("\n", " ")
    assert "Traceback" not in err


def test_copies_and_missing_noise_are_reported_at_the_terminal(fit_of):
    code, out, _ = fit_of([HEADER, *rows(), *rows()])
    assert code == 0
    assert "warning: 9 of 18 samples are exact copies of others" in out
    assert "warning: the model leaves no residuals beyond rounding" in out
    assert "none" in out


def test_one_plane_names_the_measurement_that_mends_it(fit_of):
    plane = np.linspace(-70, 70, 60)
    truth = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.15, "alpha_y": 0.25}
    where = Directions(
        np.radians(np.full(60, 30.0)), 0.0, np.radians(np.abs(plane)),
        np.where(plane < 0, 0, np.pi),
    )  # fmt: skip
    f = models.get("ward")(where, **truth)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(60)
    lines = [
        f"30,0,{abs(t):.6f},{0 if t < 0 else 180},{v:.9f},0.001"
        for t, v in zip(plane, f + noise, strict=True)
    ]
    code, out, _ = fit_of([HEADER + ",u_brdf", *lines], model="ward")
    assert code == 0
    assert "rho_s and alpha_y can be exchanged: " in out
    assert "only one plane was measured, phi = 0 deg" in out
    assert "mirror direction at theta_i = " in out.split("Measure ")[1]
