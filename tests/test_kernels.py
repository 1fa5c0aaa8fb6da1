"""Compiled loops: they equal plain sums, and their machine code is kept and renewed."""

import importlib
import math
import os
import re
import subprocess
import sys
import textwrap
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gonio import cache, models
from gonio.errors import ConfigurationError
from gonio.geometry import unit_vectors
from gonio.kernels import (
    build,
    default_threads,
    fastmath,
    map_blocks,
    scalar,
    single,
    sums,
)
from gonio.kernels.copies import suspects
from gonio.kernels.kept import kept_around
from gonio.kernels.loops import Loops, loops_around
from gonio.kernels.moments import MomentLoops, moments_around
from gonio.kernels.pairs import PairLoops, pairs_around
from gonio.kernels.split import split
from gonio.kernels.template import any_order, module_text, read
from gonio.kernels.texels import TexelLoops, texels_around
from gonio.models import base, pairs

MODEL = models.get("ward")
P = np.array([0.2, 0.1, 0.1, 0.25])


def directions(seed: int, n: int, theta_max: float = 1.5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return unit_vectors(rng.uniform(0, theta_max, n), rng.uniform(0, 6.28, n))


def f(w_i: np.ndarray, w_r: np.ndarray, p: np.ndarray = P) -> np.ndarray:
    return np.array([MODEL.plain(i, r, p) for i, r in zip(w_i, w_r, strict=True)])


def of_a_constant_surface() -> dict[str, object]:
    """What the loops take, for f = p[0]: plain functions that the interpreter runs."""

    def unpack(p):
        return (p[0],)

    def call(xi, yi, zi, xr, yr, zr, q):
        return (q[0], 1.0)

    def store(both, above, gradient, k):
        gradient[0, k] = both[1] if above else 0.0

    def keep(kept, rows, k):
        rows[0, k] = kept[0]

    kept = kept_around(
        geometry=lambda xi, yi, zi, xr, yr, zr: (zi,),
        keep=keep,
        shape=lambda rows, k, q: (q[0], 1.0),
        store=store,
    )
    return {
        "unpack": unpack,
        "call": call,
        **vars(pairs_around(unpack, call, store)),
        "n_kept": 1,
        **vars(kept),
        "add_products": sums.add_products,
        "mirror": sums.mirror,
        "sum_of_squares": sums.sum_of_squares,
    }


class TestLoops:
    def test_cells_equal_explicit_sums_with_members_below_the_horizon(self):
        w_i, w_r = directions(1, 4), directions(2, 12, theta_max=2.0)
        w_i[3] = [0.6, 0.0, -0.8]
        weight = np.random.default_rng(3).uniform(0.1, 1, 12)
        offsets = np.array([0, 1, 5, 9, 12])
        value, both, gradient = np.empty(4), np.empty(4), np.empty((4, 4))
        MODEL.loops.cell_values(w_i, w_r, weight, offsets, 0, P, value)
        MODEL.loops.cell_gradient(w_i, w_r, weight, offsets, 0, P, both, gradient)
        assert np.any(w_r[:, 2] < 0)
        for k in range(4):
            own = slice(offsets[k], offsets[k + 1])
            n = offsets[k + 1] - offsets[k]
            total = weight[own] @ f(np.repeat(w_i[k : k + 1], n, axis=0), w_r[own])
            np.testing.assert_allclose([value[k], both[k]], total[0], rtol=1e-13)
            np.testing.assert_allclose(gradient[k], total[1:], rtol=1e-13)
        assert value[3] == 0

    def test_a_block_of_cells_starts_at_its_first_sample(self):
        w_i, w_r, weight = directions(1, 4), directions(2, 12), np.full(12, 0.25)
        offsets = np.array([0, 1, 5, 9, 12])
        whole, part = np.empty(4), np.empty(2)
        MODEL.loops.cell_values(w_i, w_r, weight, offsets, 0, P, whole)
        MODEL.loops.cell_values(w_i, w_r, weight, offsets, 2, P, part)
        np.testing.assert_array_equal(part, whole[2:])

    def test_batch_chi2_equals_the_explicit_sum(self):
        w_i, w_r = directions(4, 30), directions(5, 30, theta_max=1.8)
        rng = np.random.default_rng(6)
        factor, value = rng.uniform(0.5, 1.5, (30, 5)), rng.uniform(0, 1, 30)
        inverse_variance = rng.uniform(1, 100, 30)
        batch = P * rng.uniform(0.8, 1.2, (5, 4))
        out = np.empty(5)
        MODEL.loops.batch_chi2(w_i, w_r, factor, P, value, inverse_variance, batch, out)
        # The cells' factors are linear in the parameters about a mode, here P.
        cell = [factor[:, 0] + factor[:, 1:] @ (p - P) for p in batch]
        expected = [
            np.sum((value - c * f(w_i, w_r, p)[:, 0]) ** 2 * inverse_variance)
            for c, p in zip(cell, batch, strict=True)
        ]
        np.testing.assert_allclose(out, expected, rtol=1e-13)

    def test_an_image_averages_the_rays_that_hit(self):
        w_i = directions(7, 5)
        w_r = directions(8, 15).reshape(3, 5, 3)
        ray_weight = np.random.default_rng(9).uniform(0, 1, (3, 5))
        ray_weight[1] = 0
        ray_weight[2, 0] = 0
        out = np.empty(3)
        MODEL.loops.image(w_i, w_r, ray_weight, P, out)
        expected = [ray_weight[k] @ f(w_i, w_r[k])[:, 0] for k in range(3)]
        np.testing.assert_allclose(out, expected, rtol=1e-13)
        assert out[1] == 0

    def test_the_loops_run_as_plain_python_too(self):
        loops = loops_around(**of_a_constant_surface())
        w_i, w_r, p = directions(10, 6), directions(11, 6, theta_max=2.0), np.array([0.3])
        out, gradient = np.empty(6), np.empty((1, 6))
        loops.evaluate(*w_i.T, *w_r.T, p, out)
        np.testing.assert_array_equal(out, np.where(w_r[:, 2] > 0, 0.3, 0))
        loops.evaluate_gradient(*w_i.T, *w_r.T, p, out, gradient)
        np.testing.assert_array_equal(gradient[0], np.where(w_r[:, 2] > 0, 1, 0))

    @pytest.mark.parametrize(
        ("templates", "record"),
        [
            ([pairs_around], PairLoops),
            ([pairs_around, loops_around], Loops),
            ([moments_around], MomentLoops),
            ([texels_around], TexelLoops),
        ],
    )
    def test_every_loop_of_a_template_reaches_its_callers(self, templates, record):
        functions = [name for template in templates for name in read(template).functions]
        public = {name for name in functions if not name.startswith("_")}
        # What a texel's loop alone calls is handed to nobody.
        assert public - {"grid_sums"} == {f.name for f in fields(record)} - {"KEPT"}

    @pytest.mark.parametrize("name", ["ward", "oren_nayar"])
    def test_the_loop_over_pairs_is_simd_code(self, name):
        from numba import njit

        # A call that is not inlined, or a branch, makes the loop several times slower, silently.
        again = njit(error_model="numpy")(models.get(name).loops.evaluate.py_func)
        one = np.ones(1)
        again(one, one, one, one, one, one, models.get(name).vector({}), one.copy())
        (code,) = again.inspect_llvm().values()
        assert re.search(r"call <\d+ x double> @llvm\.sqrt", code)


class TestSums:
    @pytest.mark.parametrize("n_rows", range(1, 10))
    def test_products_are_those_of_the_matrix_and_are_added(self, n_rows):
        from gonio.kernels.sums import add_products, products

        rng = np.random.default_rng(n_rows)
        columns, weight = rng.standard_normal((12, 100)), rng.uniform(0, 2, 100)
        rows = rng.permutation(12)[:n_rows]
        out = np.full((n_rows, n_rows), 3.0)
        add_products(columns, rows, weight, np.empty(100), out)
        expected = 3 + np.tril((columns[rows] * weight) @ columns[rows].T)
        np.testing.assert_allclose(np.tril(out), np.tril(expected), rtol=1e-12, atol=1e-12)
        if n_rows in products:
            out = np.full((n_rows, n_rows), 3.0)
            products[n_rows](columns, rows, weight, out)
            np.testing.assert_allclose(np.tril(out), np.tril(expected), rtol=1e-12, atol=1e-12)

    @pytest.mark.parametrize("name", ["ward", "oren_nayar", "eon", "lambert+ward_isotropic"])
    def test_moments_are_chi_squared_for_all_amplitudes(self, name):
        # With pairs below the horizon, where f is 0 and chi-squared is that of the values.
        model = models.get(name)
        p = np.array([q.default for q in model.parameters])
        linear = tuple(j for j, q in enumerate(model.parameters) if q.linear)
        w_i, w_r = directions(1, 300), directions(2, 300, theta_max=2.0)
        value, weight = np.random.default_rng(3).uniform(0, 1, (2, 300))
        n = len(linear)
        sums = np.empty((2, 1 + n + n * (n + 1) // 2))
        loops = build.moment_loops_for(model.kernel, len(p), linear)
        components = np.ascontiguousarray(np.concatenate([w_i.T, w_r.T]))
        loops.moments(components, value, weight, np.stack([0.9 * p, p]), sums)
        f, jac = model.gradient(w_i, w_r, p)
        columns = np.column_stack([value - f, jac[:, linear]])
        gram = (columns * weight[:, None]).T @ columns
        np.testing.assert_allclose(sums[1], gram[np.triu_indices(1 + n)], rtol=1e-11, atol=1e-13)


STEP, NAME = 0.5, "a text"


def _good(n_p):
    @any_order
    def total(x):
        return sum(x) * n_p * STEP

    return SimpleNamespace(total=total)


def _with_a_statement(n_p):
    half = n_p / 2

    def f(x):
        return x * half

    return SimpleNamespace(f=f)


def _without_a_return(n_p):
    def f(x):
        return x * n_p

    def g(x):
        return x


def _with_another_decorator(n_p):
    @staticmethod
    def f(x):
        return x * n_p

    return SimpleNamespace(f=f)


def _with_a_text(n_p):
    def f(x):
        return NAME * n_p

    return SimpleNamespace(f=f)


def _with_a_function(n_p):
    def f(x):
        return _good(x) * n_p

    return SimpleNamespace(f=f)


def _with_an_unknown_name(n_p):
    def f(x):
        return nowhere * n_p  # noqa: F821

    return SimpleNamespace(f=f)


class TestTemplate:
    def test_a_file_holds_the_functions_as_they_are_written(self):
        uncompiled = "def njit(**options):\n    return lambda function: function\n"
        text = module_text(uncompiled + "n_p = 3\n", _good)
        names: dict[str, object] = {}
        exec(text, names)
        assert text.endswith("def total(x):\n    return sum(x) * n_p * STEP\n")
        assert 'fastmath={"reassoc", "contract"}' in text
        assert names["total"]([1.0, 2.0]) == _good(3).total([1.0, 2.0]) == 4.5

    def test_what_a_template_takes_must_stand_above_it(self):
        with pytest.raises(
            ValueError, match=r"template .*\._good: nothing above defines n_p; rule 2 of gonio"
        ):
            module_text("from numba import njit\n", _good)

    @pytest.mark.parametrize(
        ("template", "sentence"),
        [
            (_with_a_statement, "'half = n_p / 2' is neither an inner function nor the last.* 1"),
            (_without_a_return, "it does not end in the return of a record by keywords; rule 1"),
            (_with_another_decorator, "f is decorated by staticmethod; rule 4"),
            (_with_a_text, "NAME is no parameter, no number and no module; rule 3"),
            (_with_a_function, "_good is no parameter, no number and no module; rule 3"),
            (_with_an_unknown_name, "nowhere is no parameter, no number and no module; rule 3"),
        ],
    )
    def test_a_broken_rule_is_named(self, template, sentence):
        with pytest.raises(ValueError, match=sentence):
            read(template)


class TestSplit:
    @pytest.mark.parametrize("name", models.names())
    def test_the_parts_are_the_kernel_to_the_last_bit(self, name):
        model = models.get(name)
        parts = split(model.kernel)
        p = [q.default for q in model.parameters]
        for i, r in zip(directions(1, 20), directions(2, 20), strict=True):
            kept = parts.geometry(*i, *r)
            assert len(kept) == parts.n
            assert parts.shape(*kept, *p) == model.kernel(*i, *r, *p)

    def test_square_roots_and_angles_of_directions_are_kept(self):
        # ward: two slopes and the root; oren_nayar: what sigma tilts, and the second bounce.
        assert split(models.get("ward").kernel).n == 3
        assert split(models.get("oren_nayar").kernel).n == 2
        for name in ("ward", "oren_nayar"):
            assert not {"sqrt", "acos"} & set(
                split(models.get(name).kernel).shape.__code__.co_names
            )

    def test_a_name_that_is_bound_again_is_another_one(self):
        parts = split(_bound_twice)
        both = parts.shape(*parts.geometry(0, 0, 0.5, 0, 0, 0.25), 2.0)
        assert both == _bound_twice(0, 0, 0.5, 0, 0, 0.25, 2.0)

    def test_a_kernel_with_a_branch_stays_whole(self):
        parts = split(_branching)
        assert parts.shape is _branching
        assert parts.geometry(1, 2, 3, 4, 5, 6) == (1, 2, 3, 4, 5, 6)


def _bound_twice(xi, yi, zi, xr, yr, zr, rho):
    a = zi + zr
    b = rho * a
    a *= a + 1
    b, c = a * b, rho + zi
    a = rho * a
    return a + b + c, b


def _branching(xi, yi, zi, xr, yr, zr, rho):
    if zi > zr:
        return rho, 1.0
    return rho * zi, zi


class TestCopies:
    def test_equal_numbers_are_suspected_and_few_others(self):
        rng = np.random.default_rng(1)
        value = rng.standard_normal(5000)
        value[100], value[200], value[300] = value[4000], 0.0, -0.0
        found = suspects(value)
        assert found[[100, 200, 300, 4000]].all()
        assert found.mean() < 0.2
        assert suspects(np.full(300, 0.1)).all()


class TestEvaluate:
    W_I, W_R = directions(20, 3000), directions(21, 3000, theta_max=1.7)

    @pytest.mark.parametrize(
        ("name", "real"),
        [
            *((name, np.float64) for name in models.names()),
            *((name, np.float32) for name in ("ward", "oren_nayar", "rough_plastic")),
        ],
    )
    def test_the_bits_do_not_depend_on_how_pairs_are_cut_into_blocks(self, name, real, monkeypatch):
        model = models.get(name)
        given = self.W_I.astype(real), self.W_R.astype(real), model.vector({})
        whole = model.gradient(*given, threads=1)
        monkeypatch.setattr(base, "pair_block", lambda n, threads, costly: 37)
        for cut, one in zip(model.gradient(*given, threads=2), whole, strict=True):
            np.testing.assert_array_equal(cut, one)
        np.testing.assert_array_equal(model.evaluate(*given), whole[0])

    def test_one_thread_makes_one_call(self, monkeypatch):
        calls = []
        loops = Loops(*[lambda *a: calls.append(a)] * len(fields(Loops)))
        monkeypatch.setattr(base.Model, "_loops", lambda *_: loops)
        MODEL.evaluate(np.ones((100_000, 3)), np.ones(3), P, threads=1)
        assert len(calls) == 1

    def test_contiguous_components_are_not_copied(self):
        parts, shape = pairs.components(self.W_I, self.W_R)
        assert shape == (3000,)
        for part, given in zip(parts, (*self.W_I.T, *self.W_R.T), strict=True):
            assert np.shares_memory(part, given)
        assert self.W_I.flags.writeable

    @pytest.mark.parametrize("real", [np.float32, np.float64])
    def test_out_is_filled_and_returned(self, real):
        w_i, w_r = self.W_I.reshape(30, 100, 3).astype(real), self.W_R[:100].astype(real)
        out = np.full((30, 100), np.nan, real)
        assert MODEL.evaluate(w_i, w_r, P, out=out) is out
        np.testing.assert_array_equal(out, MODEL.evaluate(w_i, w_r, P))

    @pytest.mark.parametrize(
        ("out", "given"),
        [
            (np.empty(7), r"out is an array of float64 and shape \(7,\); "),
            (np.empty(3000, np.float32), r"out is an array of float32 and shape \(3000,\); "),
            (np.empty(6000)[::2], r"shape \(3000,\) that is not C-contiguous; "),
            (np.broadcast_to(0.0, 3000).copy()[:], None),
        ],
    )
    def test_an_out_that_does_not_fit_is_refused(self, out, given):
        if given is None:
            out.flags.writeable = False
            given = r"shape \(3000,\) that is read-only; "
        wanted = (
            r"for these directions it must be np.empty\(\(3000,\), np.float64\), or be left out"
        )
        with pytest.raises(ConfigurationError, match=given + wanted) as caught:
            MODEL.evaluate(self.W_I, self.W_R, P, out=out)
        assert caught.value.value is out


def near_and_far(n: int, theta_max: float = 1.4) -> tuple[np.ndarray, np.ndarray]:
    """Float32 pairs in double: a half anywhere, a half near each other's mirror direction."""
    rng = np.random.default_rng(30)
    theta, phi = rng.uniform(0, theta_max, (2, n)), rng.uniform(0, 6.28, (2, n))
    half = n // 2
    theta[1, :half] = np.clip(theta[0, :half] + 0.1 * rng.standard_normal(half), 0, theta_max)
    phi[1, :half] = phi[0, :half] + np.pi + 0.1 * rng.standard_normal(half)
    w_i, w_r = (unit_vectors(*each).astype(np.float32) for each in zip(theta, phi, strict=True))
    return w_i.astype(float), w_r.astype(float)


def in_float32(*arrays: np.ndarray) -> list[np.ndarray]:
    return [array.astype(np.float32) for array in arrays]


every_model = pytest.mark.parametrize("name", models.names())


class TestSinglePrecision:
    @every_model
    def test_f_is_that_of_double_precision(self, name):
        model, (w_i, w_r) = models.get(name), near_and_far(1000)
        middle = [
            math.sqrt(a * b) if q.scale == "log" else 0.5 * (a + b)
            for q in model.parameters
            for a, b in [q.start or (q.lower, q.upper)]
        ]
        for p in (model.vector({}), np.array(middle)):
            exact = model.evaluate(w_i, w_r, p)
            f = model.evaluate(*in_float32(w_i, w_r), p)
            assert f.dtype == np.float32
            # Some thirty roundings of 6e-8 each; an exponent of -7 where the lobe has fallen to a
            # thousandth is itself rounded to 4e-7.
            lobe = np.abs(exact).max()
            assert np.all(np.abs(f - exact) < 1e-5 * (np.abs(exact) + 1e-3 * lobe))

    @pytest.mark.parametrize("name", ["ward", "oren_nayar", "ggx"])
    def test_derivatives_are_those_of_double_precision(self, name):
        model, (w_i, w_r) = models.get(name), near_and_far(1000)
        _, exact = model.gradient(w_i, w_r, model.vector({}))
        f, gradient = model.gradient(*in_float32(w_i, w_r), model.vector({}))
        assert f.dtype == gradient.dtype == np.float32
        np.testing.assert_array_equal(f, model.evaluate(*in_float32(w_i, w_r), model.vector({})))
        # As f, but derivatives are differences that may cancel.
        largest = np.abs(exact).max(axis=0)
        assert np.all(np.abs(gradient - exact) <= 5e-6 * largest)

    @every_model
    def test_f_is_zero_at_and_below_the_horizon_and_finite_just_above(self, name):
        model, horizon = models.get(name), np.pi / 2
        theta_i = np.array([horizon, 0.3, horizon, 1.6, 0.3, 2.5])
        theta_r = np.array([0.3, horizon, horizon, 0.3, 1.6, 2.5])
        below = in_float32(unit_vectors(theta_i, 0.0), unit_vectors(theta_r, 2.0))
        assert not model.evaluate(*below, model.vector({})).any()
        grazing = in_float32(*near_and_far(200, theta_max=horizon - 1e-6))
        for end in ("lower", "default", "upper"):
            p = np.array([getattr(q, end) for q in model.parameters])
            assert np.all(np.isfinite(model.evaluate(*grazing, p)))

    def test_mixed_types_are_computed_in_double(self):
        w_i, w_r = near_and_far(10)
        f = MODEL.evaluate(w_i.astype(np.float32), w_r, P)
        assert f.dtype == np.float64
        np.testing.assert_array_equal(f, MODEL.evaluate(w_i, w_r, P))

    @pytest.mark.parametrize("name", ["phong", "oren_nayar_numeric", "phong+lambert"])
    def test_what_single_precision_would_ruin_is_computed_in_double_and_rounded(self, name):
        model, (w_i, w_r) = models.get(name), near_and_far(100)
        p = model.vector({})
        f = model.evaluate(*in_float32(w_i, w_r), p)
        np.testing.assert_array_equal(f, model.evaluate(w_i, w_r, p).astype(np.float32))

    @pytest.mark.parametrize("name", single.DOUBLE)
    def test_the_names_of_what_is_computed_in_double_exist(self, name):
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:
            module, _, function = name.rpartition(".")
            assert callable(getattr(importlib.import_module(module), function))

    # Branches, complex numbers, and loops over tuples of constants.
    @pytest.mark.parametrize("name", ["oren_nayar", "ggx", "rough_plastic"])
    def test_nothing_is_computed_in_double(self, name):
        from numba import float32

        kernel = models.get(name).kernel
        twin = scalar.compiled(kernel, single=True)
        twin.compile((float32,) * kernel.__code__.co_argcount)
        seen = [twin]
        for function in seen:
            (compiled,) = function.overloads.values()
            types = compiled.type_annotation.typemap.items()
            # The literal in float32(literal) is a double; it is rounded when compiled.
            wide = [k for k, t in types if str(t) in {"float64", "complex128"} and "const" not in k]
            assert not wide
            called = (
                function.py_func.__globals__.get(n) for n in function.py_func.__code__.co_names
            )
            seen += [c for c in called if hasattr(c, "overloads") and c not in seen]

    def test_whole_numbers_stay_whole_where_they_count_and_become_real_where_they_measure(
        self, tmp_path, monkeypatch
    ):
        source = """
            from __future__ import annotations

            import math

            N, HALF, TABLE, ORDER = 3, 1 / 2, (0.1, 0.2, 0.3, 0.4), (2, 1)


            def scaled(x: float, n: int = 2) -> float:
                return x ** n * N + n


            def first(n: int) -> int:
                return n // 2


            def made_up(x: float, y: float) -> tuple[float, float]:
                total, k = 0, 0
                for j in range(N):
                    total += TABLE[j + 1] * x ** (j + 1) / (j + 1)
                    k += 1
                k -= first(k)
                for sign in (1, -1):
                    total += sign * y * ORDER[k - 2] + (0 if x > 1 else 2 * HALF)
                a = b = x if k == 2 else 0
                z = complex(x, -1) * 1j
                total += k * a - 1 / 3 * b + math.pi
                return total, scaled(x, n=k) + max(1, int(7 * x)) / z.real
            """
        (tmp_path / "made_up_source.py").write_text(textwrap.dedent(source))
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
        made_up = importlib.import_module("made_up_source").made_up
        try:
            twin = scalar.compiled(made_up, single=True)
            result = twin(np.float32(0.7), np.float32(1.3))
            (signature,) = twin.nopython_signatures
            assert str(signature.return_type) == "UniTuple(float32 x 2)"
            np.testing.assert_allclose(result, made_up(0.7, 1.3), rtol=1e-6)
        finally:
            sys.modules.pop("made_up_source", None)


class TestMapBlocks:
    @pytest.mark.parametrize("n", [0, 1, 7, 8, 9, 100])
    @pytest.mark.parametrize("threads", [1, 3])
    def test_blocks_cover_the_range_once(self, n, threads):
        seen = np.zeros(n, int)

        def work(start, stop):
            assert 0 < stop - start <= 8
            seen[start:stop] += 1

        map_blocks(work, n, threads=threads, block=8)
        assert np.all(seen == 1)

    def test_an_error_in_a_thread_reaches_the_caller(self):
        def work(start, stop):
            raise ZeroDivisionError("in a block")

        with pytest.raises(ZeroDivisionError, match="in a block"):
            map_blocks(work, 100, threads=2, block=8)

    def test_the_number_of_threads_comes_from_the_environment(self, monkeypatch):
        monkeypatch.setenv("GONIO_THREADS", "3")
        assert default_threads() == 3
        monkeypatch.setenv("GONIO_THREADS", "many")
        assert 1 <= default_threads() <= (os.cpu_count() or 1)


RUN = """
import numpy as np
from gonio import models
loops = models.get("lambert").loops
out = np.empty(1)
up = np.array([[0.0, 0.0, 1.0]])
loops.evaluate(*up.T, *up.T, np.array([0.5]), out)
stats = loops.evaluate.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), out[0])
"""


def run(folder: Path) -> list[str]:
    environment = {**os.environ, "GONIO_CACHE_DIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


class TestCache:
    def test_a_second_process_reads_the_code_of_the_first(self, tmp_path):
        assert run(tmp_path) == ["0", "1", "0.15915494309189535"]
        before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if p.is_file()}
        assert run(tmp_path) == ["1", "0", "0.15915494309189535"]
        after = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if p.is_file()}
        assert before == after

    def test_a_changed_kernel_or_a_changed_helper_makes_a_new_file(self, tmp_path, monkeypatch):
        monkeypatch.setenv("GONIO_CACHE_DIR", str(tmp_path / "cache"))
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
        cache.folder.cache_clear()
        build.loops_for.cache_clear()
        up, out = np.array([[0.0, 0.0, 1.0]]), np.empty(1)
        kernel = """
            from made_up_helper import scaled

            def kernel(xi, yi, zi, xr, yr, zr, a):
                return scaled(a) + {offset}, 2.0
            """
        helper = "def scaled(a):\n    return {factor} * a\n"

        def value(factor: float, offset: float) -> float:
            (tmp_path / "made_up_helper.py").write_text(helper.format(factor=factor))
            (tmp_path / "made_up_model.py").write_text(
                textwrap.dedent(kernel.format(offset=offset))
            )
            for name in ("made_up_model", "made_up_helper"):
                sys.modules.pop(name, None)
            importlib.invalidate_caches()
            module = importlib.import_module("made_up_model")
            build.loops_for(module.kernel, 1).evaluate(*up.T, *up.T, np.array([1.0]), out)
            return float(out[0])

        def files() -> int:
            return len(list((tmp_path / "cache").glob("made_up_model_*.py")))

        try:
            assert (value(2.0, 0.5), files()) == (2.5, 1)
            assert (value(2.0, 0.5), files()) == (2.5, 1)
            assert (value(2.0, 0.7), files()) == (2.7, 2)
            assert (value(3.0, 0.7), files()) == (3.7, 3)
        finally:
            for name in ("made_up_model", "made_up_helper"):
                sys.modules.pop(name, None)
            cache.folder.cache_clear()
            build.loops_for.cache_clear()

    def test_a_home_that_cannot_be_written_is_replaced_by_a_temporary_folder(
        self, tmp_path, monkeypatch
    ):
        blocked = tmp_path / "file"
        blocked.write_text("a file where a folder should be")
        monkeypatch.setenv("GONIO_CACHE_DIR", str(blocked / "cache"))
        cache.folder.cache_clear()
        try:
            folder = cache.folder()
            assert folder.is_dir()
            assert blocked not in folder.parents
            folder.rmdir()
        finally:
            cache.folder.cache_clear()


class TestFastMath:
    X = np.concatenate([np.linspace(-700, 700, 20001), np.linspace(-1, 1, 2001)])
    Z = np.concatenate([np.linspace(-1, 1, 20001), 1 - np.geomspace(1e-16, 0.1, 500)])

    # numpy's own functions are good to an ulp, 2.2e-16.
    def test_exp_is_good_to_four_parts_in_ten_to_the_sixteen(self):
        ours = np.array([fastmath.exp(float(x)) for x in self.X])
        np.testing.assert_allclose(ours, np.exp(self.X), rtol=4.5e-16)

    def test_acos_is_good_to_four_parts_in_ten_to_the_sixteen(self):
        ours = np.array([fastmath.acos(float(z)) for z in self.Z])
        np.testing.assert_allclose(ours, np.arccos(self.Z), rtol=4.5e-16)

    def test_a_small_angle_is_as_exact_as_its_versine(self):
        theta = np.geomspace(1e-150, 1.5, 500)
        w = 2 * np.sin(theta / 2) ** 2
        ours = np.array([fastmath.arcvers(float(each)) for each in w])
        np.testing.assert_allclose(ours, theta, rtol=6e-16)

    def test_exp_is_held_where_it_would_leave_the_numbers(self):
        assert 0 < fastmath.exp(-1e6) < 1e-300
        assert 1e300 < fastmath.exp(1e6) < np.inf

    def test_acos_is_exact_at_its_ends_and_held_beyond(self):
        for z in (1.0, 1 + 2e-16, 1.5):
            assert fastmath.acos(z) == 0
            assert fastmath.acos(-z) == math.pi
        assert fastmath.acos(0.0) == pytest.approx(math.pi / 2, abs=2.3e-16)

    def test_machine_code_gives_the_same(self):
        # It rounds a product and a sum together, where the interpreter rounds twice.
        exp, acos = scalar.compiled(fastmath.exp), scalar.compiled(fastmath.acos)
        for x in (-1e6, -650.0, -3.7, 0.0, 1e-9, 2.5):
            assert exp(x) == pytest.approx(fastmath.exp(x), rel=4.5e-16)
        for z in (-1.5, -1.0, -0.3, 0.0, 1e-9, 0.7, 1 - 1e-12, 1.0, 1.5):
            assert acos(z) == pytest.approx(fastmath.acos(z), rel=4.5e-16)

    def test_the_twins_in_single_precision_are_good_to_two_units_in_the_last_place(self):
        exp = scalar.compiled(fastmath.exp, single=True)
        acos = scalar.compiled(fastmath.acos, single=True)
        x, z = (each.astype(np.float32) for each in (self.X / 10, self.Z))
        ours = [np.array([f(v) for v in each]) for f, each in ((exp, x), (acos, z))]
        assert {str(f.nopython_signatures[0].return_type) for f in (exp, acos)} == {"float32"}
        np.testing.assert_allclose(ours[0], np.exp(x.astype(float)), rtol=2.4e-7)
        np.testing.assert_allclose(ours[1], np.arccos(z.astype(float)), rtol=2.4e-7)
        assert 0 < exp(np.float32(-1e6)) < 1e-37
        assert 1e37 < exp(np.float32(1e6)) < np.inf
