"""What a result says of its origin: versions of the programs, and a hash of the data."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib import metadata
from typing import Any

import numpy as np

from gonio._version import __version__
from gonio.samples import BRDFSamples

UNSTATED_ANGLES = "errors of the directions"  # of samples whose file does not state them


def provenance(samples: BRDFSamples) -> dict[str, Any]:
    """What a result says of its origin: versions of the programs, and the data."""
    source = {"data_sha256": data_hash(samples), **samples.metadata}
    if samples.cells is None and not any(term.moves_directions for term in samples.shared):
        source["unknown"] = [*(source.get("unknown") or ()), UNSTATED_ANGLES]
    return {"versions": dict(_versions()), "source": source}


@cache
def _versions() -> dict[str, str]:
    packages = ("numpy", "scipy", "numba", "nlopt", "emcee")
    versions = {name: metadata.version(name) for name in packages}
    return {"gonio": __version__, "python": platform.python_version(), **versions}


def data_hash(samples: BRDFSamples) -> str:
    """SHA-256 of the numbers: directions, values and uncertainties."""
    digest = hashlib.sha256()
    d = samples.directions
    for array in (d.theta_i, d.phi_i, d.theta_r, d.phi_r, samples.value, samples.u_independent):
        if array is not None:
            digest.update(np.ascontiguousarray(np.broadcast_to(array, (len(samples),))).tobytes())
    return digest.hexdigest()
