"""Other people's programs on the same work: Mitsuba, SCATMECH and Radiance.

Run from the root of the checkout: python -m benchmarks --only peers

They come with the extra `bench`; one that is absent is skipped, and the table says so.
tests/test_peers.py tests that all of them agree with gonio; this module times them in turn with
ours, one thread against one thread.

Mitsuba's vectorised variants need LLVM 16 or newer as a shared library: DRJIT_LIBLLVM_PATH names
it. A version that Dr.Jit cannot use ends the process; therefore they run in a process of their own.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.kernels import N, ours, pairs
from benchmarks.timing import Row, Work, best_in_turn

FEW = 20_000  # for what is called once for each pair
RAYS = N // 4
SCENE = """
void light lamp 0 0 3 1e8 1e8 1e8
lamp source sun 0 0 4 0.5 0.2 0.8 0.01
void plastic2 surface 4 1 0 0 . 0 6 0.2 0.2 0.2 0.1 0.1 0.25
surface polygon plane 0 0 12 -9 -9 0 9 -9 0 9 9 0 -9 9 0
"""
DIRECT = "-ab 0 -aa 0 -av 0 0 0 -dj 0 -ds 0 -dt 0 -st 1 -ss 0 -lw 0"


class AbsentError(Exception):
    """The peer is not installed or cannot run; the text gives the reason."""


def load(module: str) -> Any:
    """The module of a peer."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise AbsentError(f"{module.split('.')[0]} is not installed") from None


def conductor(mi: Any, distribution: str) -> Any:
    """Mitsuba's anisotropic microfacets of metal, of distribution "beckmann" or "ggx"."""
    return mi.load_dict(
        {
            "type": "roughconductor",
            "distribution": distribution,
            "alpha_u": 0.1,
            "alpha_v": 0.25,
            "eta": {"type": "spectrum", "value": 0.2},
            "k": {"type": "spectrum", "value": 3.9},
        }
    )


def mitsuba_vectorised(distribution: str) -> Work:
    """Mitsuba's `llvm_ad_mono` on N pairs; may end the process."""
    mi, dr = load("mitsuba"), load("drjit")
    mi.set_variant("llvm_ad_mono")
    dr.set_thread_count(1)
    w_i, w_r = (mi.Vector3f(np.ascontiguousarray(w.T)) for w in pairs(np.float32))
    at = dr.zeros(mi.SurfaceInteraction3f, N)
    at.wi = w_i
    dr.eval(at, w_r)
    surface, context = conductor(mi, distribution), mi.BSDFContext()

    def work() -> None:
        dr.eval(surface.eval(context, at, w_r))
        dr.sync_thread()

    return work


def mitsuba_scalar() -> Work:
    """Mitsuba's `scalar_rgb` on FEW pairs."""
    mi = load("mitsuba")
    mi.set_variant("scalar_rgb")
    surface, context = conductor(mi, "beckmann"), mi.BSDFContext()
    at, vectors = mi.SurfaceInteraction3f(), [w.tolist() for w in pairs(np.float32, FEW)]

    def work() -> None:
        for i, r in zip(*vectors, strict=True):
            at.wi = mi.Vector3f(*i)
            surface.eval(context, at, mi.Vector3f(*r))

    return work


def scatmech() -> Work:
    """SCATMECH's facets with Gaussian slopes, shadows and Fresnel on FEW pairs."""
    facets = load("pySCATMECH.brdf").BRDF_Model(
        "Shadowed_Facet_BRDF_Model",
        {
            "substrate": "(1.5,0)",
            "sdf": {None: "Gaussian_Slope_Distribution_Function", "s": "0.2"},
            "shadow": "Torrance_Sparrow_Shadow_Function",
        },
    )
    angles = np.random.default_rng(1).uniform(0, 1.4, (FEW, 3)).tolist()

    def work() -> None:
        for theta_i, theta_r, phi in angles:
            facets.BRDF(theta_i, theta_r, phi)

    return work


def radiance_formula() -> Work:
    """Radiance's rcalc with its formula file of ward_gmd on N pairs, its start included."""
    radiance = load("pyradiance")
    formula = radiance.BINPATH.parent / "lib" / "WGMDaniso.cal"
    command = [radiance.BINPATH / "rcalc", "-id6", "-od", "-f", formula,
               "-e", "$1=wgmdaniso($1,$2,$3,$4,$5,$6)"]  # fmt: skip
    data = np.concatenate(pairs(np.float64), axis=1).tobytes()
    return lambda: subprocess.run(command, input=data, capture_output=True, check=True)


def radiance_rays() -> Work:
    """Radiance's rtrace on a plane of plastic2 under one lamp, RAYS rays, its start included."""
    radiance = load("pyradiance")
    _, w_r = pairs(np.float64, RAYS)
    rays = np.concatenate([w_r, -w_r], axis=1).tobytes()
    folder = tempfile.TemporaryDirectory()
    scene = Path(folder.name) / "scene.rad"
    scene.write_text(SCENE)
    done = subprocess.run([radiance.BINPATH / "oconv", scene], capture_output=True, check=True)
    octree = scene.with_suffix(".oct")
    octree.write_bytes(done.stdout)

    def work() -> None:
        assert folder  # lives as long as this function
        command = [radiance.BINPATH / "rtrace", "-h", "-fdd", *DIRECT.split(), octree]
        subprocess.run(command, input=rays, capture_output=True, check=True)

    return work


@dataclass(frozen=True)
class Comparison:
    """One of our models against one way to call a peer.

    Parameters
    ----------
    model : str
        Ours.
    peer : str
        Program and part of it.
    prepare : callable
        Gives the peer's work.
    n : int
        Pairs in that work.
    note : str
        What the peer does besides.
    real : type
        Precision of both.
    apart : bool
        Whether it is measured in a process of its own.
    """

    model: str
    peer: str
    prepare: Callable[[], Work]
    n: int
    note: str
    real: type = np.float64
    apart: bool = False

    def named(self) -> Row:
        """The row without values."""
        single = ", float32" if self.real is np.float32 else ""
        return Row(self.model + single, None, self.peer, None, self.note)


COMPARISONS = (
    Comparison(
        "ward",
        "Mitsuba llvm_ad_mono, roughconductor",
        partial(mitsuba_vectorised, "beckmann"),
        N,
        "anisotropic Beckmann with masking and Fresnel",
        np.float32,
        apart=True,
    ),
    Comparison(
        "ggx",
        "Mitsuba llvm_ad_mono, roughconductor",
        partial(mitsuba_vectorised, "ggx"),
        N,
        "the same but for the masking",
        np.float32,
        apart=True,
    ),
    Comparison(
        "ward",
        "Mitsuba scalar_rgb, Python loop",
        mitsuba_scalar,
        FEW,
        "Beckmann, called once for each pair",
        np.float32,
    ),
    Comparison(
        "cook_torrance",
        "SCATMECH, Python loop",
        scatmech,
        FEW,
        "the same formula, as a Mueller matrix, called once for each pair",
    ),
    Comparison(
        "ward_gmd", "Radiance rcalc", radiance_formula, N, "the same formula, read from a file"
    ),
    Comparison(
        "ward_gmd",
        "Radiance rtrace, plastic2",
        radiance_rays,
        RAYS,
        "the same formula; a ray also finds plane and lamp",
    ),
)


def in_this_process(comparison: Comparison) -> Row:
    """A comparison in this process."""
    works = {"peer": comparison.prepare(), "ours": ours(comparison.model, comparison.real)}
    times = best_in_turn(works)
    mine = N / times["ours"]
    return replace(comparison.named(), ours_per_s=mine, ratio=mine * times["peer"] / comparison.n)


def in_own_process(comparison: Comparison) -> Row:
    """A comparison in a process of its own."""
    for package in ("mitsuba", "drjit"):
        if importlib.util.find_spec(package) is None:
            raise AbsentError(f"{package} is not installed")
    command = [sys.executable, "-m", "benchmarks.peers", str(COMPARISONS.index(comparison))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        if "LLVM" not in done.stdout + done.stderr:
            raise RuntimeError(done.stderr)
        raise AbsentError("Dr.Jit finds no LLVM that it can use; DRJIT_LIBLLVM_PATH names one")
    return Row(**json.loads(done.stdout.splitlines()[-1]))


def compared(comparison: Comparison) -> Row:
    """One line of the table."""
    try:
        return in_own_process(comparison) if comparison.apart else in_this_process(comparison)
    except AbsentError as reason:
        return replace(comparison.named(), note=f"skipped: {reason}")


def run() -> list[Row]:
    """Pairs a second, ours and as a ratio to each peer that is there."""
    return [compared(each) for each in COMPARISONS]


if __name__ == "__main__":
    print(json.dumps(asdict(in_this_process(COMPARISONS[int(sys.argv[1])]))))
