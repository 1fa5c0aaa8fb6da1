"""Signals of the standard over the cosine of the incidence, which several questions use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from gonio.calibration.faults.evidence import Evidence
from gonio.calibration.faults.frame_statistics import middle
from gonio.calibration.frames import standard as eq2
from gonio.geometry import FloatArray, angles

FEWEST = 3  # blocks of the coarse grid; fewer are not judged


@dataclass(frozen=True)
class StandardLevels:
    """The standard's signals over their common shape and the cosine, by incidence.

    Parameters
    ----------
    ratio : mapping of int to ndarray
        Coarse image of the signal over the median of all incidences; NaN where it says nothing.
    level : mapping of int to float
        Median of the ratio, if enough blocks of the image have one.
    angle : mapping of int to float
        theta_i, radians, of the incidences that have a level.
    """

    ratio: dict[int, FloatArray]
    level: dict[int, float]
    angle: dict[int, float]

    @classmethod
    def of(cls, evidence: Evidence) -> StandardLevels | None:
        """The levels of a session; None where fewer than two incidences have one."""
        signals = standard_signals(evidence)
        if len(signals) < 2:
            return None
        common = _median(np.stack(list(signals.values())))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = {i: signal / common for i, signal in signals.items()}
        level = {i: middle(r) for i, r in ratio.items() if np.isfinite(r).sum() > FEWEST}
        if len(level) < 2:
            return None  # hardly a pixel saw the standard unsaturated; other questions say so
        angle = {i: evidence.theta_i(("standard", 0, i)) for i in level}
        return cls(ratio, level, angle)

    @cached_property
    def exchanged(self) -> tuple[int, int] | None:
        """The two incidences whose exchange would put both on the cosine, if there are two."""
        level, angle = self.level, self.angle
        for a, b in combinations(level, 2):
            cosines = np.cos(angle[a]) / np.cos(angle[b])
            both_off = min(abs(np.log(level[a])), abs(np.log(level[b]))) > 0.1
            swapped = (abs(np.log(level[a] * cosines)), abs(np.log(level[b] / cosines)))
            others = [abs(np.log(x)) for i, x in level.items() if i not in (a, b)]
            if both_off and max(swapped) < 0.08 and others and np.median(others) < 0.08:
                return a, b
        return None


def standard_signals(evidence: Evidence) -> dict[int, FloatArray]:
    """Standard above its background over what f_std cos(theta_i) predicts, by incidence.

    NaN where it says nothing: outside the usable hemisphere, in the lamp's entry patch.
    """
    metadata, regions = evidence.metadata, evidence.regions
    theta_r, phi_r = angles(regions.w_r)
    signals = {}
    for incidence, theta_deg in enumerate(metadata.plan.incidences("standard")):
        own = incidence if metadata.plan.standard_theta_i_deg is None else -1
        own %= len(metadata.plan.incidences("background"))
        white, black = evidence.mean("standard", incidence), evidence.mean("background", own)
        if white is None or black is None:
            continue
        theta_i = np.radians(theta_deg)
        f_std = eq2.standard_brdf(metadata.standard, theta_i, theta_r, phi_r)
        signal = white - black
        stray = black - metadata.camera.dark_e_per_s
        use = (regions.cover > 0.99) & (stray < eq2.ENTRY_SHARE * signal) & (f_std > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            signals[incidence] = np.where(use, signal / (f_std * np.cos(theta_i)), np.nan)
    return signals


def _median(stack: FloatArray) -> FloatArray:
    """Median of the finite values over the first axis; NaN where there are none."""
    finite = np.isfinite(stack)
    ordered = np.sort(np.where(finite, stack, np.inf), axis=0)
    n = finite.sum(axis=0)
    low, high = (
        np.take_along_axis(ordered, np.maximum(k, 0)[None], axis=0)[0]
        for k in ((n - 1) // 2, n // 2 - (n == 0))
    )
    return np.where(n > 0, (low + high) / 2, np.nan)
