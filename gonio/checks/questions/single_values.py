"""What questions about single values far above the others have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray, angles, unit_vectors

GRAZING_DEG = 78.0  # polar angle from which on values may rise steeply


def away_from_lobes(
    evidence: Evidence, index: NDArray[np.int64], away_deg: float
) -> NDArray[np.bool_]:
    """Samples whose values may neither be a lobe, nor a retro lobe, nor rise towards the horizon.

    Parameters
    ----------
    evidence : Evidence
    index : ndarray of int64, shape (M,)
    away_deg : float
        Least tilt of the half vector from the normal, and half the least angle from the light.
    """
    w_i = unit_vectors(evidence.theta_i[index], evidence.phi_i[index])
    w_r = unit_vectors(evidence.theta_r[index], evidence.phi_r[index])
    tilt = angles(w_i + w_r)[0]
    phase = np.arccos(np.clip(np.sum(w_i * w_r, axis=-1), -1, 1))
    steep = np.maximum(evidence.theta_i[index], evidence.theta_r[index])
    away = np.degrees(np.minimum(tilt, phase / 2)) > away_deg
    return np.asarray(away & (np.degrees(steep) < GRAZING_DEG))


def standing_out(
    code: str,
    evidence: Evidence,
    index: NDArray[np.int64],
    times: FloatArray,
    others: str,
    then: str = "",
) -> Finding:
    """The finding that single values are many times others.

    Parameters
    ----------
    code : str
    evidence : Evidence
    index : ndarray of int64, shape (M,)
        The samples.
    times : ndarray, shape (M,)
        Their values over those of the others.
    others : str
        What the others are, with {them} for the samples, as in "the values around {them}".
    then : str
        What is said of their place behind the list of samples.
    """
    one = len(index) == 1
    span = f"{times.min():.2g}" + ("" if one else f" to {times.max():.2g}")
    than = others.format(them="it" if one else "them")
    return Finding(
        code,
        "warning",
        f"{len(index)} of {evidence.n} values {'is' if one else 'are'} {span} times {than} "
        f"({evidence.where(index)}){then}: stray light or a reading error. Measure these again or "
        "remove them.",
        tuple(index.tolist()),
        evidence.lines(index),
    )
