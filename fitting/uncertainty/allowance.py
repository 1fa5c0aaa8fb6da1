"""What the uncertainties of a fit allow for beyond independent noise of one size, in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class Allowance:
    """Why and how the uncertainties of a fit are not those of its noise alone.

    Parameters
    ----------
    basis : {"samples", "samples and incidences"}
        What was left out in turn.
    p : float
        Chance of residuals as these under noise alone.
    incidences : int
        Groups of samples of one incidence.
    structure : bool
        The residuals have structure: the model does not hold. Otherwise they follow the value.
    lone : tuple of str
        Parameters that one incidence alone informs for the most part.
    parts : tuple of int
        To how many parts of a joint fit it applies, of how many.
    """

    basis: Literal["samples", "samples and incidences"]
    p: float
    incidences: int
    structure: bool = True
    lone: tuple[str, ...] = ()
    parts: tuple[int, int] = (1, 1)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a JSON document."""
        return {
            **asdict(self),
            "lone": list(self.lone),
            "parts": list(self.parts),
            "text": self.text,
        }

    @property
    def text(self) -> str:
        """One sentence for the page of a fit.

        Examples
        --------
        >>> print(Allowance("samples", 1e-9, 0, structure=False).text)
        intervals allow for noise that follows the value (p < 1e-06): each sample left out in \
turn, Student's t
        >>> print(Allowance("samples and incidences", 0.002, 6).text)
        intervals allow for misfit (p = 0.002): each sample and each of 6 incidences left out in \
turn, the larger counts, Student's t
        """
        what = "misfit" if self.structure else "noise that follows the value"
        chance = f"p = {self.p:.2g}" if self.p >= 1e-6 else "p < 1e-06"
        how = "each sample left out in turn"
        if self.basis == "samples and incidences":
            how = (
                f"each sample and each of {self.incidences} incidences left out in turn, the "
                "larger counts"
            )
        text = f"intervals allow for {what} ({chance}): {how}, Student's t"
        if self.parts[0] < self.parts[1]:
            text += f"; in {self.parts[0]} of {self.parts[1]} parts"
        return text

    @property
    def warnings(self) -> list[str]:
        """What these uncertainties cannot hold."""
        sentences = []
        if self.structure and self.basis == "samples":
            number = "one incidence" if self.incidences == 1 else f"{self.incidences} incidences"
            sentences.append(
                f"the model does not fit, and {number} cannot show how far the parameters "
                "would differ at another: the uncertainties allow for misfit within what was "
                "measured alone; measure at three incidences or more."
            )
        if self.lone:
            names = " and ".join(self.lone)
            sentences.append(
                f"one incidence alone informs {names}: how far another would move "
                f"{'it' if len(self.lone) == 1 else 'them'} under this misfit is not in the "
                "uncertainty."
            )
        return sentences
