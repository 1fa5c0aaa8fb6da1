"""Compiled loops: they equal plain sums, and their machine code is kept and renewed."""

import importlib
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from types import FunctionType

import numpy as np
import pytest

from gonio import models
from gonio.geometry import unit_vectors
from gonio.kernels import build, default_threads, fastmath, loops, map_blocks
from gonio.kernels.build import Loops

MODEL = models.get("ward")
P = np.array([0.2, 0.1, 0.1, 0.25])


def directions(seed: int, n: int, theta_max: float = 1.5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return unit_vectors(rng.uniform(0, theta_max, n), rng.uniform(0, 6.28, n))


def f(w_i: np.ndarray, w_r: np.ndarray, p: np.ndarray = P) -> np.ndarray:
    return np.array([MODEL.plain(i, r, p) for i, r in zip(w_i, w_r, strict=True)])


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
        w_i, w_r, p = directions(10, 6), directions(11, 6, theta_max=2.0), np.array([0.3])
        out, gradient = np.empty(6), np.empty((1, 6))
        loops.evaluate(*w_i.T, *w_r.T, p, out)
        np.testing.assert_array_equal(out, np.where(w_r[:, 2] > 0, 0.3, 0))
        loops.evaluate_gradient(*w_i.T, *w_r.T, p, out, gradient)
        np.testing.assert_array_equal(gradient[0], np.where(w_r[:, 2] > 0, 1, 0))

    def test_every_loop_of_the_source_is_compiled(self):
        functions = {name for name, value in vars(loops).items() if isinstance(value, FunctionType)}
        public = {name for name in functions if not name.startswith("_")}
        public -= {"call", "store", "unpack"}  # these the header brings
        assert public == set(Loops.__dataclass_fields__)


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


def run(cache: Path) -> list[str]:
    environment = {**os.environ, "GONIO_CACHE_DIR": str(cache)}
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
        build._cache_folder.cache_clear()
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
            build._cache_folder.cache_clear()
            build.loops_for.cache_clear()

    def test_a_home_that_cannot_be_written_is_replaced_by_a_temporary_folder(
        self, tmp_path, monkeypatch
    ):
        blocked = tmp_path / "file"
        blocked.write_text("a file where a folder should be")
        monkeypatch.setenv("GONIO_CACHE_DIR", str(blocked / "cache"))
        build._cache_folder.cache_clear()
        try:
            folder = build._cache_folder()
            assert folder.is_dir()
            assert blocked not in folder.parents
            folder.rmdir()
        finally:
            build._cache_folder.cache_clear()


class TestExp:
    def test_it_is_exp_to_four_parts_in_ten_to_the_sixteen(self):
        x = np.concatenate([np.linspace(-700, 700, 20001), np.linspace(-1, 1, 2001)])
        ours = np.array([fastmath.exp(float(v)) for v in x])
        # numpy's own exp is good to an ulp, 2.2e-16.
        np.testing.assert_allclose(ours, np.exp(x), rtol=4.5e-16)

    def test_it_is_held_where_it_would_leave_the_numbers(self):
        assert 0 < fastmath.exp(-1e6) < 1e-300
        assert 1e300 < fastmath.exp(1e6) < np.inf

    def test_machine_code_gives_the_same(self):
        twin = build.compiled(fastmath.exp)
        for x in (-650.0, -3.7, 0.0, 1e-9, 2.5):
            assert twin(x) == pytest.approx(fastmath.exp(x), rel=3e-16)
