"""Are the angles in radians?"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray

ROUND_DEG = 0.03  # radians written with three digits come back to degrees so closely
HITS = 0.9  # of the angles are whole degrees once they are read as radians
LEAST = 4  # different angles that decide


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Angles of a file in degrees that are whole degrees only if they are radians."""
    angles = evidence.theta_i, evidence.theta_r, evidence.phi_i, evidence.phi_r
    if not evidence.n:
        return
    of_i, of_r, azimuth_i, azimuth_r = (math.degrees(max(a.max(), -a.min())) for a in angles)
    polar = 0.05 < max(of_i, of_r) <= np.pi / 2 + 1e-3
    azimuths = 0.05 < max(azimuth_i, azimuth_r) <= 2 * np.pi + 1e-3
    if not polar and not azimuths:
        return
    theta, phi = (np.degrees(np.concatenate([angles[k], angles[k + 1]])) for k in (0, 2))
    whole_turns = azimuths and _quarter_turns(phi)
    if not polar and not whole_turns:
        return
    polar_round, azimuth_round = _whole_degrees(theta), _whole_degrees(phi)
    spread = azimuths and len(np.unique(phi)) >= 20 and np.ptp(phi) > 3.0
    if polar and (whole_turns or spread or (polar_round and (azimuths or not phi.any()))):
        yield _finding("theta and phi", theta, phi, sure=True)
    elif polar and polar_round:
        yield _finding("theta", theta, phi, sure=True)
    elif not polar and whole_turns and (azimuth_round or _quarter_turns(phi, every=True)):
        yield _finding("phi", theta, phi, sure=True)
    elif polar and theta.max() > 1.0 and not phi.any():
        yield _finding("theta", theta, phi, sure=False)


def _whole_degrees(angle: FloatArray) -> bool:
    """Whether angles are whole degrees when they are taken for radians, and not as they are."""
    different = np.unique(np.round(np.abs(angle), 6))
    different = different[different > 1e-6]
    if len(different) < LEAST:
        return False
    as_degrees = np.degrees(different)
    hits = np.mean(np.abs(as_degrees - np.round(as_degrees)) < ROUND_DEG)
    plain = np.mean(np.abs(different - np.round(different, 2)) < 1e-7)
    return bool(hits >= HITS and plain < 0.5)


def _quarter_turns(phi: FloatArray, *, every: bool = False) -> bool:
    """Whether an azimuth is pi/2, pi, 3 pi/2 or 2 pi as people write it, or each one or 0."""
    turns = np.abs(phi) / (np.pi / 2)
    near = np.abs(turns - np.round(turns)) * np.pi / 2 < 2e-3
    return bool(np.any((np.round(turns) > 0) & near) and (not every or near.all()))


def _finding(names: str, theta: FloatArray, phi: FloatArray, *, sure: bool) -> Finding:
    text = (
        f"taken as degrees, theta reaches {theta.max():.5g} deg and phi {np.abs(phi).max():.5g} deg"
    )
    if sure:
        return Finding(
            "radians",
            "refuse",
            f"{text}; as radians they are whole degrees or turns: {names} are in radians. "
            "Multiply them by 57.29577951 (180/pi).",
        )
    return Finding(
        "radians_possible",
        "note",
        f"{text}. If the angles are radians, multiply them by 57.29577951 (180/pi).",
    )


QUESTION = Question(
    key="angle_unit",
    order=80,
    asks="Are the angles in radians?",
    compares="the largest angles with pi/2 and 2 pi, the angles as radians with whole degrees",
    codes=("radians", "radians_possible"),
    ask=ask,
    of_file=True,
)
