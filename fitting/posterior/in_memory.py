"""What a fit keeps in memory: the problem at its minimum, and the draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gonio.fitting.posterior.chain import Chain
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.models import Model
from gonio.samples import BRDFSamples


@dataclass(frozen=True)
class InMemory:
    """A fit's problem and posterior, for `FitResult.memory`.

    Parameters
    ----------
    model : Model
    problem : Problem
    p : ndarray
        Parameters at the minimum.
    noise_scale : float
    seed : int
    chain : Chain or None
    """

    model: Model
    problem: Problem
    p: FloatArray
    noise_scale: float
    seed: int
    chain: Chain | None = None

    @property
    def samples(self) -> BRDFSamples:
        """What the model was fitted to."""
        return self.problem.samples

    def fitted(self) -> FloatArray:
        """The model's value of each sample, (N,), sr^-1."""
        return self.problem.values(self.p)

    def part(self, index: int) -> InMemory:
        """One part of a joint fit; its draws stay with the whole."""
        piece, _, columns = self.problem.independent.pieces()[index]
        return InMemory(self.model, piece, self.p[columns], self.noise_scale, self.seed)

    def inference_data(self, *, log_likelihood: bool) -> Any:
        """The draws as arviz takes them; None where no posterior was sampled."""
        from gonio.fitting.posterior.inference_data import inference_data

        if self.chain is None:
            return None
        return inference_data(
            self.chain, self.problem, scale=self.noise_scale, seed=self.seed,
            log_likelihood=log_likelihood,
        )  # fmt: skip
