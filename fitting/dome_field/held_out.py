"""Whether field and material predict images that the solution has not seen.

About the solution, chi-squared with the priors is Q + d^T H d, and that of a group G of images
c - 2 b d + d^T H_G d. Without the group the least Q is Q - c - b^T (H - H_G)^-1 b. The difference,

chi2_G = c + b^T (H - H_G)^-1 b,

is chi-squared of the group's residuals from the prediction by all other images, the uncertainty of
the prediction included: where the model is right its expectation is the number of samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.dome_field.equations import sums
from gonio.fitting.dome_field.part import azimuths
from gonio.fitting.dome_field.solve import Joint
from gonio.wording import counted

GROUPS = 3  # interleaved groups of incidences, and of rotations at most
ALARM = 1e-3  # chance below which a prediction fails
TOLERANCE = 0.25  # of chi2/n beyond 1 that is not held against a model


@dataclass(frozen=True)
class Prediction:
    """How well some images are predicted by the others.

    Parameters
    ----------
    left_out : str
        In words.
    chi2 : float
        Of the residuals from the prediction, its uncertainty included.
    n : int
        Number of samples.
    """

    left_out: str
    chi2: float
    n: int

    @property
    def ratio(self) -> float:
        """chi-squared a sample, 1 where the model is right."""
        return self.chi2 / self.n

    @property
    def fails(self) -> bool:
        """Whether it is larger than the tolerance, and chance does not explain that."""
        from scipy.stats import chi2

        return bool(self.ratio > 1 + TOLERANCE and chi2.sf(self.chi2, self.n) < ALARM)


def predictions(joint: Joint) -> tuple[Prediction, ...]:
    """Leave out rotations, and incidences, in turn.

    Neighbouring incidences see the same part of the dome: of three, one is left out at a time.
    """
    return tuple(_prediction(joint, words, chosen) for words, chosen in _groups(joint))


def _prediction(joint: Joint, words: str, chosen: list[NDArray[np.bool_]]) -> Prediction:
    from scipy.linalg import cho_factor, cho_solve

    group = sums(joint.rows, joint.layout, chosen)
    free = np.isfinite(np.diag(joint.information))
    without = (joint.information - group.information)[np.ix_(free, free)]
    b = group.gradient[free]
    scale = 1 / np.sqrt(np.maximum(np.diag(without), 1e-300))
    # Parameters that the other images do not determine keep a wide prior.
    factor = cho_factor(without * np.outer(scale, scale) + 1e-12 * np.eye(len(b)), lower=True)
    growth = float((scale * b) @ cho_solve(factor, scale * b))
    return Prediction(words, group.chi2 + growth, group.n)


def _groups(joint: Joint) -> Iterator[tuple[str, list[NDArray[np.bool_]]]]:
    turns, lamps = [], []
    for part in joint.parts:
        n, d = part.problem.n, part.problem.samples.directions
        turns.append(np.round(np.degrees(-azimuths(part.problem)), 6) % 360)
        lamps.append(np.round(np.degrees(np.broadcast_to(d.theta_i, n)), 6))
    rotations = np.unique(np.concatenate(turns))
    if len(rotations) > 1:
        step = max(len(rotations) // GROUPS, 1)
        for first in range(0, len(rotations), step):
            own = rotations[first : first + step]
            if len(own) == len(rotations):
                continue
            words = ", ".join(f"{turn:g}" for turn in own)
            yield f"rotation {words} deg", [np.isin(turn, own) for turn in turns]
    incidences = np.unique(np.concatenate(lamps))
    groups = min(GROUPS, len(incidences))
    if groups > 1:
        for first in range(groups):
            own = incidences[first::groups]
            words = counted(len(own), "incidence") + f" from {own[0]:.4g} deg on"
            yield words, [np.isin(lamp, own) for lamp in lamps]
