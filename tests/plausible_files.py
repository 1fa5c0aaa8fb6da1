"""Files of samples that are right, and what is said of them, for the tests of plausibility."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gonio import models
from gonio.checks import plausible
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

GLOSSY = {"rho_d": 0.3, "rho_s": 0.1, "alpha_x": 0.2, "alpha_y": 0.2}


def hemisphere(thetas=(10.0, 30.0, 50.0, 70.0), step=10.0, turns=(0.0,)) -> Directions:
    """A grid over the hemisphere, with the sample turned."""
    grids = np.meshgrid(
        np.radians(thetas), np.radians(turns), np.radians(np.arange(10.0, 80.0, step)),
        np.radians(np.arange(0.0, 360.0, 30.0)), indexing="ij",
    )  # fmt: skip
    theta_i, phi_i, theta_r, delta = (grid.ravel() for grid in grids)
    return Directions(theta_i, phi_i, theta_r, phi_i + delta)


def plane(thetas=(15.0, 30.0, 45.0, 60.0), step=5.0) -> Directions:
    """Scans in the plane of incidence, from horizon to horizon."""
    scan = np.arange(-75.0, 75.1, step)
    theta_i, side = (grid.ravel() for grid in np.meshgrid(thetas, scan, indexing="ij"))
    phi_r = np.where(side < 0, 0.0, np.pi)
    return Directions(np.radians(theta_i), 0 * theta_i, np.radians(abs(side)), phi_r)


def values(d: Directions, name="ward", **parameters) -> np.ndarray:
    return np.asarray(models.get(name)(d, **parameters))


def noisy(d: Directions, f: np.ndarray, noise=0.02, *, stated=False, seed=1) -> BRDFSamples:
    u = noise * f + 1e-4 * np.median(f)
    y = f + u * np.random.default_rng(seed).standard_normal(f.shape)
    return BRDFSamples(d, np.array([float(f"{v:.6g}") for v in y]), u if stated else None)


def glossy(d: Directions | None = None, **options) -> BRDFSamples:
    d = hemisphere() if d is None else d
    return noisy(d, values(d, **GLOSSY), **options)


def turned(samples: BRDFSamples, **angles) -> BRDFSamples:
    """The same values with other angles."""
    d = samples.directions
    four = {name: getattr(d, name) for name in ("theta_i", "phi_i", "theta_r", "phi_r")}
    return replace(samples, directions=Directions(**{**four, **angles}))


def codes(samples: BRDFSamples, *levels: str) -> list[str]:
    return [f.code for f in plausible(samples).findings if not levels or f.level in levels]


def only(samples: BRDFSamples, code: str, level: str) -> str:
    """The text of the one finding of these samples."""
    (finding,) = plausible(samples).findings
    assert (finding.code, finding.level) == (code, level), finding
    return finding.text
