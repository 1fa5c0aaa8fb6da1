"""What a fit has learnt of the errors that its samples share, as lines for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gonio.fitting.result import NuisanceEstimate


def lines(learnt: Sequence[NuisanceEstimate]) -> list[str]:
    """A line for each shared error, in units of its stated standard uncertainty.

    Examples
    --------
    >>> from gonio.fitting.result import NuisanceEstimate
    >>> lamp = [NuisanceEstimate("lamp", k, z, 0.5) for k, z in enumerate((0.3, -0.4))]
    >>> for line in lines([NuisanceEstimate("standard", None, 0.02, 0.999), *lamp]):
    ...     print(line)
    shared errors learnt, in units of their stated standard uncertainty (prior 0 ± 1):
      standard       +0.02 ± 1.00
      lamp           2 draws of rms 0.35, the largest -0.40 ± 0.50
    """
    names = list(dict.fromkeys(e.name for e in learnt))
    width = max(14, *map(len, names))
    found = ["shared errors learnt, in units of their stated standard uncertainty (prior 0 ± 1):"]
    for name in names:
        draws = [e for e in learnt if e.name == name]
        largest = max(draws, key=lambda e: abs(e.estimate))
        text = f"{largest.estimate:+.2f} ± {largest.stderr:.2f}"
        if len(draws) > 1:
            rms = (sum(e.estimate**2 for e in draws) / len(draws)) ** 0.5
            text = f"{len(draws)} draws of rms {rms:.2f}, the largest {text}"
        found.append(f"  {name:<{width}} {text}")
    return found
