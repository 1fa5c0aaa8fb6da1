"""Are the angles in gradians, 400 to a turn, or the azimuths in turns?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.geometry import FloatArray, golden_fractions

PER_DEG = 0.9  # degrees in a gradian
ROUNDED = 0.012  # degrees to which angles written with two digits come back
HITS = 0.9  # of the angles are whole degrees once they are read as gradians
PLAIN = 0.25  # share of angles that may be multiples of 0.1 as written
LEAST = 4  # different angles that decide
LEAST_ALONE = 6  # the same where theta alone decides
STEEP = 10.0  # degrees of theta from which on azimuths within 1 deg are no plan
MOST = 20_000  # samples that are looked at
SCATTERED = 20  # azimuths anywhere in a turn


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Angles that are whole degrees, or whole turns, only in gradians; azimuths that are turns."""
    if not evidence.n:
        return
    some: slice | NDArray[np.int64] = slice(None)
    if evidence.n > MOST:
        some = np.unique((golden_fractions(MOST) * evidence.n).astype(np.int64))
    theta_i, phi_i = evidence.theta_i[some], evidence.phi_i[some]
    theta_r, phi_r = evidence.theta_r[some], evidence.phi_r[some]
    theta = _different(np.degrees(np.r_[theta_i, theta_r]))
    azimuths = _different(np.degrees(np.r_[phi_i, phi_r]))
    raw = _different(np.degrees(phi_r - phi_i))
    turns = _turns(azimuths, theta)
    if turns:
        yield Finding("azimuth_in_turns", "warning", turns)
        return
    of_phi = _closed_at_400(raw if raw[0] >= 0 else azimuths) or _quarters(raw)
    if not of_phi and _whole(azimuths, LEAST):
        of_phi = f"phi ({_listed(azimuths)}) is in whole degrees once it is multiplied by 0.9"
    of_theta = ""
    if _whole(theta, LEAST if of_phi else LEAST_ALONE):
        of_theta = f"theta ({_listed(theta)}) is in whole degrees once it is multiplied by 0.9"
    alone = bool(of_theta) and len(azimuths) <= 1
    if of_phi or alone:
        evidences = " and ".join(text for text in (of_phi, of_theta) if text)
        yield Finding(
            "gradians",
            "warning",
            f"{evidences}: the angles are in gradians, 400 to a turn. Multiply theta and phi by "
            "0.9.",
        )


def _different(angle: FloatArray) -> FloatArray:
    return np.unique(np.round(angle, 4))


def _whole(angle: FloatArray, least: int) -> bool:
    """Whether angles are whole degrees when they are taken for gradians, and odd as they are."""
    different = angle[np.abs(angle) > 1e-6]
    if len(different) < least:
        return False
    degrees = PER_DEG * different
    hits = np.mean(np.abs(degrees - np.round(degrees)) < ROUNDED)
    plain = np.mean(np.abs(10 * different - np.round(10 * different)) < 2e-3)
    return bool(hits >= HITS and plain < PLAIN)


def _closed_at_400(raw: FloatArray) -> str:
    """What is said of azimuths in even steps that close a turn at 400, else empty."""
    if len(raw) < LEAST or raw[0] < 0 or not 360 < raw[-1] <= 400.01:
        return ""
    step = float(np.median(np.diff(raw)))
    closes = min(abs(raw[-1] - 400), abs(raw[-1] + step - 400)) < 0.02 * max(step, 1)
    repeats = np.isin(np.round(raw - 360, 3), np.round(raw, 3)).any()
    if not closes or repeats:
        return ""
    return f"phi_r reaches {raw[-1]:.5g} in steps of {step:.4g}, which close a turn at 400"


def _quarters(raw: FloatArray) -> str:
    """What is said of azimuths that are quarters of 400 and none of 360, else empty."""
    quarters = np.abs(raw / 100 - np.round(raw / 100)) < 1e-4
    if len(raw) < 2 or not quarters.all() or not np.any(np.abs(np.abs(raw) - 200) < 1e-2):
        return ""
    return f"phi_r - phi_i takes only {_listed(raw)}, the plane of incidence in gradians"


def _turns(azimuths: FloatArray, theta: FloatArray) -> str:
    """What is said of azimuths that are fractions of a turn, else empty."""
    if len(azimuths) < 2 or azimuths[0] < 0 or not 0.4 < azimuths[-1] <= 1 or theta[-1] < STEEP:
        return ""
    step = float(np.diff(azimuths).min())
    steps = azimuths / step
    grid = abs(1 / step - round(1 / step)) < 0.02 / step and np.all(
        np.abs(steps - np.round(steps)) < 0.05 * np.maximum(np.round(steps), 1)
    )
    even = bool(grid) and bool(np.any(np.abs(azimuths - 0.5) < 1e-3))
    if not even and not (len(azimuths) >= SCATTERED and np.ptp(azimuths) > 0.8):
        return ""
    return (
        f"phi stays between {azimuths[0]:.4g} and {azimuths[-1]:.4g} deg in {len(azimuths)} "
        f"different values ({_listed(azimuths)}) while theta reaches {theta[-1]:.4g} deg: they are "
        "turns. Multiply phi by 360."
    )


def _listed(angle: FloatArray) -> str:
    shown = ", ".join(f"{a:.5g}" for a in angle[:5])
    return f"{shown}, ..." if len(angle) > 5 else shown


QUESTION = Question(
    key="gradians",
    order=85,
    asks="Are the angles in gradians, or the azimuths in turns?",
    compares="azimuths with 400 and with 1, the angles times 0.9 with whole degrees",
    codes=("gradians", "azimuth_in_turns"),
    ask=ask,
    of_file=True,
)
