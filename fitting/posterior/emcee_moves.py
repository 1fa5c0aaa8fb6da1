"""Moves of emcee's walkers."""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray

from gonio.fitting.posterior.proposal import Proposal
from gonio.geometry import FloatArray

STEPS_AHEAD = 24  # steps whose independent proposals are drawn at once


class IndependenceMove(emcee.moves.Move):  # type: ignore[misc]
    """Propose from a mixture that was fitted to the posterior, whatever the walkers' places.

    As no proposal depends on where a walker stands, those of many steps are drawn at once and
    their densities computed in one call.
    """

    def __init__(self, proposal: Proposal) -> None:
        self.proposal = proposal
        self.ahead: list[Any] = []

    def propose(self, model: Any, state: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Every walker moved to its proposal, or left where it is; and which moved."""
        n = len(state.coords)
        if not self.ahead:
            self.ahead = self._drawn(model, n)
        new, log_proposal = self.ahead.pop()
        gain = new.log_prob - state.log_prob
        gain += self.proposal.log_density(state.coords) - log_proposal
        accepted = np.log(model.random.random_sample(n)) < gain
        return self.update(state, new, accepted), accepted

    def _drawn(self, model: Any, n: int) -> list[Any]:
        """Proposals for n walkers and some steps, with their densities."""
        x = self.proposal.draw(STEPS_AHEAD * n, model.random)
        log_prob, blobs = model.compute_log_prob_fn(x)
        log_proposal = self.proposal.log_density(x)
        found = []
        for k in range(STEPS_AHEAD):
            some = slice(k * n, (k + 1) * n)
            own = None if blobs is None else blobs[some]
            state = emcee.State(x[some], log_prob=log_prob[some], blobs=own)
            found.append((state, log_proposal[some]))
        return found


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
