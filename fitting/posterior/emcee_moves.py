"""Moves of emcee's walkers."""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np

from gonio.fitting.posterior.proposal import Proposal
from gonio.geometry import FloatArray


class IndependenceMove(emcee.moves.RedBlueMove):  # type: ignore[misc]
    """Propose from a mixture that was fitted to the posterior, whatever the walkers' places."""

    def __init__(self, proposal: Proposal) -> None:
        self.proposal = proposal
        super().__init__()

    def get_proposal(
        self, sample: FloatArray, complement: Any, random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """New places and the log of the ratio of proposal densities, old over new."""
        proposed = self.proposal.draw(len(sample), random)
        both = self.proposal.log_density(np.concatenate([sample, proposed]))
        return proposed, both[: len(sample)] - both[len(sample) :]


class SnookerMove(emcee.moves.RedBlueMove):  # type: ignore[misc]
    """Differential evolution along the line through another walker (ter Braak & Vrugt 2008).

    emcee's own move neither normalises the direction of the line nor takes the whole ratio of
    the distances, and so does not leave the posterior as it is.
    """

    def __init__(self) -> None:
        super().__init__(nsplits=4)

    def get_proposal(
        self, sample: FloatArray, complement: Any, random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """New places q and (d - 1) log(|q - z| / |x - z|)."""
        n, d = sample.shape
        z, z1, z2 = (c[random.randint(len(c), size=n)] for c in complement)
        line = sample - z
        length = np.linalg.norm(line, axis=1)
        unit = line / length[:, None]
        proposed = sample + 1.7 * np.sum(unit * (z1 - z2), axis=1)[:, None] * unit
        return proposed, (d - 1) * np.log(np.linalg.norm(proposed - z, axis=1) / length)
