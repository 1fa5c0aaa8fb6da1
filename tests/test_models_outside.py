"""Models from outside the package: functions of arrays, kernels in no file, files, packages."""

import json
import linecache
import logging
import math
import os
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gonio import models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.fit import fit
from gonio.fitting.result import FitResult
from gonio.geometry import Directions
from gonio.kernels import build, sources
from gonio.models import Claims, Model, Parameter, external
from gonio.samples import BRDFSamples, Cells

KERNEL = """
import math

POWER = 2


def kernel(xi, yi, zi, xr, yr, zr, rho, s, alpha):
    hx, hy, hz = xi + xr, yi + yr, zi + zr
    tan2 = (hx**POWER + hy**POWER) / hz**POWER
    a2 = alpha * alpha
    e = math.exp(-tan2 / a2) / (4 * math.pi * a2)
    slope = s * e * (2 * tan2 / (a2 * alpha) - 2 / alpha)
    return rho / math.pi + s * e, 1 / math.pi, e, slope
"""
FILE = '''
"""A lobe of facets, f = rho/pi + s exp(-tan^2 delta / alpha^2) / (4 pi alpha^2)."""
import numpy as np
from gonio.models import Model


def lobe(directions, rho, s, alpha):
    tan2 = np.tan(directions.delta()) ** 2
    return rho / np.pi + s * np.exp(-tan2 / alpha**2) / (4 * np.pi * alpha**2)


MODEL = Model.from_function(
    lobe,
    {"rho": (0.2, 0, 1), "s": (0.1, 0, 1), "alpha": (0.2, 0.02, 1)},
    name="facet_lobe",
    title="Lobe of facets",
)
'''
RANGES = {"rho": (0.2, 0.0, 1.0), "s": (0.1, 0.0, 1.0), "alpha": (0.2, 0.02, 1.0)}
P = np.array([0.3, 0.2, 0.25])
NAMED = {"rho": 0.3, "s": 0.2, "alpha": 0.25}


def lobe(directions, rho, s, alpha):
    w_i, w_r = directions.vectors()
    h = w_i + w_r
    tan2 = (h[:, 0] ** 2 + h[:, 1] ** 2) / h[:, 2] ** 2
    return rho / np.pi + s * np.exp(-tan2 / alpha**2) / (4 * np.pi * alpha**2)


def lobe_by_size(directions, rho, s, alpha):
    """The same, by a step that throws the imaginary part away."""
    return lobe(directions, np.abs(rho), s, alpha)


def where(n: int, seed: int = 1, theta_max: float = 1.2) -> Directions:
    rng = np.random.default_rng(seed)
    theta, phi = rng.uniform(0, theta_max, (2, n)), rng.uniform(0, 6, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def model_of(function=lobe, **about) -> Model:
    return Model.from_function(function, RANGES, **about)


def derivatives(directions: Directions) -> np.ndarray:
    """df by rho, s and alpha, worked out by hand."""
    tan2 = np.tan(directions.delta()) ** 2
    e = np.exp(-tan2 / P[2] ** 2) / (4 * np.pi * P[2] ** 2)
    slope = P[1] * e * (2 * tan2 / P[2] ** 3 - 2 / P[2])
    return np.stack([np.full(len(e), 1 / np.pi), e, slope], axis=1)


class TestFunction:
    def test_values_are_those_of_the_function_and_0_below_the_horizon(self):
        directions = where(200, theta_max=2.0)
        f = model_of()(directions, **NAMED)
        below = np.maximum(directions.theta_i, directions.theta_r) >= np.pi / 2
        assert below.any()
        assert np.all(f[below] == 0)
        lit = Directions(
            *(getattr(directions, a)[~below] for a in ("theta_i", "phi_i", "theta_r", "phi_r"))
        )
        np.testing.assert_allclose(f[~below], lobe(lit, **NAMED), rtol=1e-12)

    @pytest.mark.parametrize(
        ("function", "how", "accuracy"),
        [(lobe, "by a complex step", 1e-13), (lobe_by_size, "by differences", 1e-8)],
    )
    def test_derivatives_are_found_by_the_better_way_that_works(self, function, how, accuracy):
        model, directions = model_of(function), where(100)
        _, jac = model.gradient(*directions.vectors(), P)
        expected = derivatives(directions)
        error = np.abs(jac - expected).max(axis=0) / np.abs(expected).max(axis=0)
        assert np.all(error < accuracy)
        assert how in model.note

    def test_differences_stay_inside_the_bounds(self):
        def root(directions, rho):
            assert 0 <= rho <= 1
            return np.abs(rho**2) * np.ones(directions.shape)

        model = Model.from_function(root, {"rho": (1.0, 0.0, 1.0)})
        for rho in (0.0, 0.5, 1.0):
            _, jac = model.gradient(*where(5).vectors(), np.array([rho]))
            np.testing.assert_allclose(jac, 2 * rho, atol=1e-8)

    def test_parameters_are_records_ranges_or_names(self):
        def paint(directions, rho, gloss=0.25):
            return (rho + gloss) / np.pi

        record = Parameter("rho", "ρ", "reflectance", 0.4, 0.0, 0.9, linear=True)
        assert Model.from_function(paint, [record, "gloss"]).parameters[0] is record
        assert Model.from_function(paint, "rho, gloss").names == ("rho", "gloss")
        by_signature = Model.from_function(paint).parameters
        assert [(q.name, q.default, q.lower, q.upper) for q in by_signature] == [
            ("rho", 0.5, 0.0, 1.0),
            ("gloss", 0.25, 0.0, 1.0),
        ]
        assert Model.from_function(paint).name == "paint"

    @pytest.mark.parametrize(
        ("function", "parameters", "sentence"),
        [
            (lambda d, a: np.ones((len(d.theta_i), 2)) * a, ["a"], r"shape \(24, 2\) for 24 pairs"),
            (lambda d, a: a / np.zeros(24), ["a"], "24 values of 24 that are no finite numbers"),
            (lambda d, a: a * np.exp(1j * d.theta_i), ["a"], "returns complex128 for real"),
            (lobe, {"rho": (2, 0, 1)}, r"\(2, 0, 1\) is not in order; lower <= default"),
            (lobe, {"rho": 0.5}, r"parameter rho: 0.5 is not \(default, lower, upper\)"),
            (lambda d: 0.1, None, r"takes no parameters by name; give parameters="),
            (lambda d, n=3: n, None, "parameter n has the default 3, and a name alone means"),
        ],
    )
    @pytest.mark.filterwarnings("ignore:divide by zero")
    def test_what_cannot_be_a_model_is_refused(self, function, parameters, sentence):
        with pytest.raises(ConfigurationError, match=sentence):
            Model.from_function(function, parameters, name="mine")

    def test_cells_are_summed_as_compiled_loops_sum_them(self):
        ward = models.get("ward_isotropic")

        def as_array(directions, rho_d, rho_s, alpha):
            return ward(directions, rho_d=rho_d, rho_s=rho_s, alpha=alpha)

        own = Model.from_function(as_array, ward.parameters)
        rng = np.random.default_rng(2)
        w_i, w_r = where(4).vectors()[0], where(12, 3, theta_max=1.9).vectors()[1]
        weight, offsets = rng.uniform(0.1, 1, 12), np.array([0, 1, 5, 9, 12])
        p, value, inverse = np.array([0.2, 0.1, 0.15]), rng.uniform(0, 1, 4), np.full(4, 9.0)
        rows = np.arange(4)
        for name, shape, tail in (
            ("cell_values", (4,), ()),
            ("cell_gradient", (4,), ((4, 3),)),
        ):
            got, expected = ([np.empty(shape), *(np.empty(s) for s in tail)] for _ in range(2))
            for model, out in ((own, got), (ward, expected)):
                getattr(model.loops, name)(w_i, w_r, weight, offsets, 0, p, *out)
            for a, b in zip(got, expected, strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9)
        sums = [np.empty((1, 4, 4)) for _ in range(2)]
        for model, out in zip((own, ward), sums, strict=True):
            model.loops.cell_normal_equations(
                w_i, w_r, weight, offsets, value, inverse, p, rows, 0, 4, out
            )
        np.testing.assert_allclose(*sums, rtol=1e-7, atol=1e-8)

    def test_a_fit_recovers_the_parameters_and_says_what_the_model_is(self):
        directions = where(300)
        noise = 0.002 * np.random.default_rng(4).standard_normal(300)
        samples = BRDFSamples(
            directions, lobe(directions, **NAMED) + noise, u_independent=np.full(300, 0.002)
        )
        found = fit(samples, model=model_of())
        assert found.status == "converged"
        for name, value in NAMED.items():
            estimate = found.parameters[name]
            assert abs(estimate.value - value) < 4 * estimate.stderr
        assert "lobe is a function of arrays: its derivatives are found by a complex step" in str(
            found.warnings
        )
        again = FitResult(**{**vars(found)})
        assert models.of_fit(again).kernel.function is lobe

    def test_cells_and_other_losses_are_fitted_too(self):
        directions = where(80)
        w_r = np.repeat(directions.vectors()[1], 2, axis=0)
        cells = Cells(w_r, np.full(160, 0.5), np.arange(81) * 2)
        value = lobe(directions, **NAMED)
        samples = BRDFSamples(directions, value, u_independent=0.01 * value, cells=cells)
        for loss in ("chi2", "log"):
            found = fit(samples, model=model_of(), loss=loss)
            assert found.values() == pytest.approx(NAMED, rel=1e-4)

    def test_it_may_be_a_term_of_a_sum(self):
        models.get(model_of(name="lobe_in_a_sum"))
        both = models.get("lambert+lobe_in_a_sum")
        w_i, w_r = where(20).vectors()
        f, jac = both.gradient(w_i, w_r, np.array([0.1, *P]))
        np.testing.assert_allclose(f, 0.1 / np.pi + model_of().evaluate(w_i, w_r, P), rtol=1e-14)
        np.testing.assert_allclose(jac[:, 1:], model_of().gradient(w_i, w_r, P)[1], rtol=1e-14)

    def test_single_precision_is_the_double_one_rounded(self):
        w_i, w_r = (w.astype(np.float32) for w in where(20).vectors())
        f = model_of().evaluate(w_i, w_r, P)
        assert f.dtype == np.float32
        expected = model_of().evaluate(w_i.astype(float), w_r.astype(float), P)
        np.testing.assert_array_equal(f, expected.astype(np.float32))


def kernel_model(kernel) -> Model:
    parameters = tuple(Parameter(n, n, n, *RANGES[n]) for n in RANGES)
    return Model("facets", "Facets", "", parameters, kernel, claims=Claims(reciprocal=True))


def by_exec(name: str = "<string>") -> Model:
    names: dict[str, object] = {"__name__": "__main__"}
    exec(compile(KERNEL, name, "exec"), names)
    return kernel_model(names["kernel"])


class TestKernelInNoFile:
    def test_a_cell_of_a_notebook_has_a_source(self):
        # IPython puts its cells into linecache under a name that is no file.
        cell = "<ipython-input-7-0123456789ab>"
        linecache.cache[cell] = (len(KERNEL), None, KERNEL.splitlines(keepends=True), cell)
        try:
            model = by_exec(cell)
            assert sources.definition(model.kernel) is not None
            self.holds(model)
        finally:
            del linecache.cache[cell]

    def test_code_that_was_passed_as_text_is_known_by_its_bytecode(self):
        model = by_exec()
        assert sources.definition(model.kernel) is None
        self.holds(model)
        same, other = by_exec(), by_exec()
        other.kernel.__globals__["POWER"] = 3
        read = [sources.ingredients(sources.reached(m.kernel)) for m in (model, same, other)]
        assert read[0] == read[1] != read[2]
        assert all(complete for _, complete in read)

    @staticmethod
    def holds(model: Model) -> None:
        w_i, w_r = where(50).vectors()
        f, jac = model.gradient(w_i, w_r, P)
        np.testing.assert_allclose(f, lobe(where(50), **NAMED), rtol=1e-12)
        np.testing.assert_allclose(jac, derivatives(where(50)), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(model.plain(w_i[0], w_r[0], P)[0], f[0], rtol=1e-14)
        # No source can be read twice, once for each precision: the loops are then those of double.
        single = model.evaluate(w_i.astype(np.float32), w_r.astype(np.float32), P)
        np.testing.assert_allclose(single, f, rtol=1e-4)

    @pytest.mark.parametrize("how", ["-c", "-", "-i"])
    def test_a_program_that_is_no_file_evaluates_its_model(self, how, tmp_path):
        code = KERNEL.lstrip() + textwrap.dedent("""

            import numpy as np
            from gonio.models import Model, Parameter
            names = ("rho", "s", "alpha")
            parameters = tuple(Parameter(n, n, n, 0.2, 0.01, 1.0) for n in names)
            model = Model("facets", "", "", parameters, kernel)
            up = np.array([[0.0, 0.0, 1.0]])
            print(float(model.evaluate(up, up, np.array([0.3, 0.2, 0.25]))[0]))
            """)
        # At a prompt an empty line ends a function.
        typed = code.replace("    return", "    return").replace("\n\n\n", "\n\n")
        done = subprocess.run(
            [sys.executable, *(["-c", code] if how == "-c" else [how])],
            input="" if how == "-c" else typed,
            env={**os.environ, "GONIO_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        expected = 0.3 / math.pi + 0.2 / (4 * math.pi * 0.25**2)
        assert float(done.stdout.split()[-1]) == pytest.approx(expected, rel=1e-14)

    def test_what_a_hash_cannot_tell_is_not_kept(self):
        thing = object()

        def kernel(xi, yi, zi, xr, yr, zr, rho):
            return rho, thing

        read, complete = sources.ingredients(sources.reached(kernel))
        assert read
        assert complete is True  # this one lives in a file, which is read whole
        names: dict[str, object] = {"thing": thing, "__name__": "__main__"}
        exec("def kernel(xi, yi, zi, xr, yr, zr, rho):\n    return rho, thing", names)
        assert sources.ingredients(sources.reached(names["kernel"]))[1] is False

    def test_a_kernel_must_be_a_function(self):
        with pytest.raises(ConfigurationError, match="is no plain Python function; write it with"):
            build.loops_for(math.sin, 1)

    @pytest.mark.parametrize(
        ("body", "said"),
        [
            ("return rho, Model()", r"Untyped global name 'Model': Cannot determine .* \(line 6\)"),
            ("return (rho,)", "tuple index out of range"),
        ],
    )
    def test_what_numba_cannot_compile_is_said_in_a_sentence(self, tmp_path, body, said):
        path = tmp_path / "paint.py"
        path.write_text(
            "from gonio.models import Model, Parameter\n"
            "PARAMETERS = (Parameter('rho', 'r', 'r', 0.5, 0.0, 1.0),)\n"
            "\n"
            "\n"
            "def paint(xi, yi, zi, xr, yr, zr, rho):\n"
            f"    {body}\n"
            "\n"
            "\n"
            "MODEL = Model('paint', '', '', PARAMETERS, paint)\n",
            encoding="utf-8",
        )
        with pytest.raises(
            ConfigurationError,
            match=rf"numba cannot compile the kernel paint\(\) of paint.py: {said}. Write it in "
            r"plain arithmetic and math of floats that returns the tuple \(f, df/dp_1, ..., "
            r"df/dp_n\), or make the model by Model.from_function",
        ):
            models.load(str(path)).gradient(*where(3).vectors(), np.array([0.5]))


@pytest.fixture
def file(tmp_path) -> Path:
    path = tmp_path / "facet.py"
    path.write_text(FILE, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def forgotten():
    """Nothing of one test is known by name in the next."""
    models._used.clear()
    yield
    models._used.clear()


class TestFile:
    def test_a_file_is_a_model(self, file):
        model = models.load(str(file))
        assert model.name == "facet_lobe"
        assert models.get("facet_lobe") is model
        assert models.resolve(str(file)) is model
        assert models.resolve(f"{file}:MODEL").name == "facet_lobe"
        assert models.origin("facet_lobe") == "facet.py"
        assert models.resolve(f"lambert+{file}").name == "lambert+facet_lobe"

    @pytest.mark.parametrize(
        ("text", "name", "sentence"),
        [
            (None, "MODEL", r"facet.py: no such file; give a file of Python that defines a model"),
            ("x = 1", "MODEL", r"facet.py: the file does not define MODEL, a gonio.models.Model"),
            (FILE, "LOBE", r"does not define LOBE; it defines MODEL: give FILE.py:NAME"),
            (
                "x = (1",
                "MODEL",
                r"facet.py: line 1 is no Python \('\(' was never closed\)",
            ),
            ("1 / 0", "MODEL", r"facet.py: the file stops with ZeroDivisionError: division by"),
            ("MODEL = 3", "MODEL", r"facet.py: MODEL is int and no Model; make one by"),
            (
                FILE.replace("facet_lobe", "ward"),
                "MODEL",
                "facet.py:MODEL: its model is named 'ward', which is a model of gonio; give it",
            ),
        ],
    )
    def test_what_is_wrong_is_said_in_a_sentence(self, tmp_path, text, name, sentence):
        path = tmp_path / "facet.py"
        if text is not None:
            path.write_text(text, encoding="utf-8")
        with pytest.raises((ConfigurationError, DataError), match=sentence):
            models.load(f"{path}:{name}")

    def test_a_name_in_a_fit_runs_no_code(self, file, tmp_path):
        path = tmp_path / "fit.json"
        self.fitted(file).save(path)
        models._used.clear()
        file.write_text("raise SystemExit('run')", encoding="utf-8")
        with pytest.raises(
            ConfigurationError,
            match=r"made with the model 'facet_lobe' of facet.py \(sha256 \w{12}\), which is not "
            "part of gonio, and no code is run because a file names it; give it with --model",
        ):
            models.of_fit(FitResult.load(path))
        document = json.loads(path.read_text(encoding="utf-8"))
        document["model"] = str(file)
        path.write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(ConfigurationError, match="not part of gonio"):
            models.of_fit(FitResult.load(path))

    def test_another_file_of_the_same_name_is_refused(self, file, tmp_path):
        found = self.fitted(file)
        assert models.of_fit(found).name == "facet_lobe"
        file.write_text(FILE.replace("4 * np.pi", "5 * np.pi"), encoding="utf-8")
        models.load(str(file))
        with pytest.raises(
            ConfigurationError,
            match=r"'facet_lobe' of facet.py \(sha256 (\w{12})\), and this one is of facet.py "
            r"\(sha256 (?!\1)\w{12}\): it is another model; give the file",
        ):
            models.of_fit(found)

    def test_gonios_own_models_have_no_source_in_a_fit(self):
        value = 0.1 + 0 * where(20).theta_i
        found = fit(BRDFSamples(where(20), value), model="lambert")
        assert found.model_source is None
        assert models.source_of(models.get("lambert+ward")) is None

    @staticmethod
    def fitted(file: Path) -> FitResult:
        model = models.load(str(file))
        samples = BRDFSamples(where(30), model(where(30), **NAMED))
        return fit(samples, model=model)


class FakeEntry:
    dist = None

    def __init__(self, name: str, value: object) -> None:
        self.name, self.value, self._value = name, f"lab.models:{name}", value

    def __lt__(self, other: "FakeEntry") -> bool:
        return self.name < other.name

    def load(self) -> object:
        if isinstance(self._value, Exception):
            raise self._value
        return self._value


class TestPackages:
    @pytest.fixture
    def entries(self, monkeypatch):
        entries = [
            FakeEntry("facets_installed", model_of(name="facets_installed")),
            FakeEntry("broken", ImportError("no module named lab")),
            FakeEntry("misnamed", model_of(name="otherwise")),
            FakeEntry("number", 3),
            FakeEntry("ward", model_of(name="ward")),
        ]
        monkeypatch.setattr(external, "entry_points", lambda group: entries)
        caches = (external.announced, external.installed, models._installed)
        for cached in caches:
            cached.cache_clear()
        yield
        monkeypatch.undo()
        for cached in caches:
            cached.cache_clear()

    @pytest.mark.usefixtures("entries")
    def test_what_packages_announce_is_there_and_what_fails_is_reported_once(self, caplog):
        with caplog.at_level(logging.WARNING):
            assert "facets_installed" in models.names()
            assert models.get("facets_installed").kernel.function is lobe
            assert "lambert" in models.names()
        for sentence in (
            "the model 'broken' of the package ? cannot be used (ImportError: no module named lab)",
            "lab.models:misnamed is announced as the model 'misnamed' and named 'otherwise'",
            "announced as the model 'number', is int and no Model",
            "the package ? announces a model named 'ward', which is a model of gonio; it is left",
        ):
            assert caplog.text.count(sentence) == 1
        assert "broken" not in models.names()
        assert models.source_of(models.get("ward")) is None


def test_a_changed_copy_of_a_model_does_not_hide_gonios_own():
    ward = models.get("ward")
    other = replace(ward, parameters=(replace(ward.parameters[0], upper=0.5), *ward.parameters[1:]))
    assert models.get(other) is other
    assert models.get("ward") is ward
