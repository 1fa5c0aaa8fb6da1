"""Data sets with known parameters for `benchmarks.sbc`: drawn from the prior that the fit uses.

Ranks of the truth in the posterior are uniform only if the truth is drawn from the prior of the
fit, and if no input of the fit depends on the truth. So the prior is flat between the bounds of a
case, which are also the bounds of the fitted model; the directions and the stated uncertainties of
the samples are drawn independently of the truth.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

import gonio
from gonio import models
from gonio.geometry import Directions, FloatArray, angles, unit_vectors
from gonio.instrument import Instrument, preset
from gonio.metadata import Plan
from gonio.models import Model
from gonio.samples import BRDFSamples, SharedTerm

Lie = Literal["none", "half", "double", "scale"]

NOISE = (0.01, 0.20)  # of the reference surface, drawn anew for each set
N_SAMPLES = (300, 1000)
N_INCIDENCES = (4, 8)
MAX_THETA_I, MAX_THETA_R = np.radians(70), np.radians(75)
SLOPES = (0.01, 0.5)  # widths of the clouds of half vectors about the normal
SCALE = 0.02  # standard deviation of an error that all samples share
LIES: dict[Lie, str] = {
    "none": "the truth",
    "half": "half the noise that there is",
    "double": "twice the noise that there is",
    "scale": f"nothing of a scale that is off by {100 * SCALE:.0f} %",
}
LIGHT = (0.03, 1.0)  # of the lamp's light on the small instrument
SIDE = 128  # px
DEG = np.pi / 180


@dataclass(frozen=True)
class Case:
    """A case to simulate and fit.

    Parameters
    ----------
    model : str
    bounds : mapping of str to tuple of float
        Bounds of the flat prior where they are narrower than the model's own, Python units.
    frames : bool
        From raw frames through the whole pipeline, else from samples.
    shared : bool
        All values share an error of scale, which is drawn and stated.
    """

    model: str
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    frames: bool = False
    shared: bool = False

    @property
    def fitted(self) -> Model:
        """The model with the bounds of the prior."""
        model = models.get(self.model)
        parameters = []
        for q in model.parameters:
            lower, upper = self.bounds.get(q.name, (q.lower, q.upper))
            start = q.start
            if q.name in self.bounds:
                start = None  # a fit looks for its start between the bounds
            parameters.append(replace(q, lower=lower, upper=upper, start=start))
        return replace(model, parameters=tuple(parameters))


ALPHA = (0.02, 0.4)
WIDE_ALPHA = (0.06, 0.4)  # a pixel of the small instrument is 0.025 rad wide
DULL = (0.1, 1.0)  # a surface that reflects nothing does not determine a shape
CASES = {
    "ward": Case("ward", {"alpha_x": ALPHA, "alpha_y": ALPHA}),
    "ward_isotropic": Case("ward_isotropic", {"alpha": ALPHA}),
    "oren_nayar": Case("oren_nayar"),
    "oren_nayar_torrance_sparrow": Case("oren_nayar_torrance_sparrow"),
    "ward_shared": Case("ward", {"alpha_x": ALPHA, "alpha_y": ALPHA}, shared=True),
    "ward_frames": Case("ward", {"alpha_x": WIDE_ALPHA, "alpha_y": WIDE_ALPHA}, frames=True),
    "oren_nayar_frames": Case("oren_nayar", {"rho": DULL}, frames=True),
}


@dataclass(frozen=True)
class DataSet:
    """Samples with the parameters (Python units) and the noise that they were made with."""

    samples: BRDFSamples
    truth: FloatArray
    noise: float


def drawn(case: Case, rng: np.random.Generator, lie: Lie = "none") -> DataSet:
    """A data set of the case; `lie` names the wrong statement of the samples."""
    fitted = case.fitted
    lower = np.array([q.lower for q in fitted.parameters])
    upper = np.array([q.upper for q in fitted.parameters])
    truth = rng.uniform(lower, upper)
    if case.frames:
        return _from_frames(case, truth, rng)
    return _from_samples(case, truth, (lower + upper) / 2, rng, lie)


def _from_samples(
    case: Case, truth: FloatArray, middle: FloatArray, rng: np.random.Generator, lie: Lie
) -> DataSet:
    """Values with normal errors; their size is that of the surface in the middle of the prior."""
    model = models.get(case.model)
    directions = some_directions(rng)
    w_i, w_r = directions.vectors()
    noise = float(np.exp(rng.uniform(*np.log(NOISE))))
    u = noise * model.evaluate(w_i, w_r, middle, threads=1)
    f = model.evaluate(w_i, w_r, truth, threads=1)
    if case.shared or lie == "scale":
        f = f * (1 + SCALE * rng.standard_normal())
    value = f + u * rng.standard_normal(len(u))
    stated = u * {"half": 0.5, "double": 2.0}.get(lie, 1.0)
    term = SharedTerm("scale", "the standard is not what it is taken for", relative=SCALE)
    samples = BRDFSamples(directions, value, stated, shared=(term,) if case.shared else ())
    return DataSet(samples, truth, noise)


def some_directions(rng: np.random.Generator) -> Directions:
    """Several incidences, each with views about the mirror direction and all over the hemisphere.

    The half vectors of half the views form clouds about the normal of many widths, so that
    some of them sample a lobe of any width.
    """
    n, n_i = int(rng.integers(*N_SAMPLES)), int(rng.integers(*N_INCIDENCES))
    incidence = rng.integers(0, n_i, n)
    theta_i = (rng.uniform(0, MAX_THETA_I, n_i))[incidence]
    phi_i = rng.uniform(-np.pi, np.pi, n_i)[incidence]
    w_i = unit_vectors(theta_i, phi_i)
    width = np.exp(rng.uniform(*np.log(SLOPES), n))
    slopes = width[:, None] * rng.standard_normal((n, 2))
    h = np.concatenate([-slopes, np.ones((n, 1))], axis=1)
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    theta_r, phi_r = angles(2 * np.sum(w_i * h, axis=1, keepdims=True) * h - w_i)
    anywhere = (rng.random(n) < 0.5) | (theta_r > MAX_THETA_R)
    even = np.arcsin(np.sin(MAX_THETA_R) * np.sqrt(rng.random(n)))
    theta_r = np.where(anywhere, even, theta_r)
    phi_r = np.where(anywhere, rng.uniform(-np.pi, np.pi, n), phi_r)
    return Directions(theta_i, phi_i, theta_r, phi_r)


def _from_frames(case: Case, truth: FloatArray, rng: np.random.Generator) -> DataSet:
    """Frames of a small, ideal instrument, reduced; the noise is set by the light of the lamp."""
    model = models.get(case.model)
    light = float(np.exp(rng.uniform(*np.log(LIGHT))))
    instrument = small_instrument(light)
    plan = Plan(
        theta_i_deg=tuple(float(a) for a in np.sort(rng.uniform(0, 70, 3))),
        rotations_deg=(0.0,) if model.claims.isotropic else (0.0, float(rng.uniform(30, 60))),
        exposures_s=instrument.sensor.exposures_s[1::2],
    )
    parameters = dict(zip(model.names, truth.tolist(), strict=True))
    with tempfile.TemporaryDirectory() as folder:
        session = gonio.simulate(
            model=case.model, parameters=parameters, output=Path(folder) / "set",
            instrument=instrument, plan=plan, seed=int(rng.integers(0, 2**62)), threads=1,
            truth_images=False,
        )  # fmt: skip
        # Eq. (3) is an approximation whose error is no random number.
        samples = gonio.reduce(session, mapping="exact", threads=1)
    assert samples.u_independent is not None
    noise = np.median(samples.u_independent / np.maximum(samples.value, 1e-12))
    return DataSet(samples, truth, float(noise))


def small_instrument(light: float = 1.0) -> Instrument:
    """`ideal12` with few, large pixels and its light times `light`."""
    instrument = preset("ideal12").with_pixels(SIDE)
    return instrument.altered(
        lamp={"white_rate_e_per_s": light * instrument.lamp.white_rate_e_per_s}
    )
