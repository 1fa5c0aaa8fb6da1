"""Where on the sphere the residuals of a fit are: mean residuals of groups of samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gonio.fitting.residual_tests.groups import Grouping
from gonio.fitting.residual_tests.structure import Test
from gonio.fitting.residual_tests.whitened import Whitened

MOST_GROUPS = 3  # that are reported
CLEAR = 3.0  # standard deviations by which a group that is reported stands out of the noise


@dataclass(frozen=True)
class GroupResidual:
    """Mean residual of a group of samples.

    Both numbers are of one estimate: the factor on the fitted values that the group asks for.

    Parameters
    ----------
    where : str
        In words.
    theta_i_deg : float or None
        Angle of incidence; None where all are taken together.
    n : int
    z : float
        The mean residual over its standard deviation under noise alone.
    relative : float or None
        The mean of measured less fitted, as a fraction of the fitted values; None where the fitted
        values are not positive.
    """

    where: str
    theta_i_deg: float | None
    n: int
    z: float
    relative: float | None

    @property
    def text(self) -> str:
        """The place in words."""
        at = "" if self.theta_i_deg is None else f"at theta_i = {self.theta_i_deg:.0f} deg"
        return " ".join(part for part in (self.where, at) if part)

    @property
    def sentence(self) -> str:
        """How far the model is off there, as a part of a sentence."""
        side = "low" if self.z > 0 else "high"
        by = "" if self.relative is None else f" by {100 * abs(self.relative):.2g} %"
        return f"too {side}{by} {self.text}"


def group_residuals(left: Whitened, grouping: Grouping) -> list[GroupResidual]:
    """Every group with its mean residual, in the order of the grouping."""
    inside = grouping.group >= 0
    number = grouping.group[inside]
    k = len(grouping.words)
    level = (left.root * left.f)[inside]
    noise = np.sqrt(max(float(left.z @ left.z) / left.dof, 1e-300))
    counts = np.bincount(number, minlength=k)
    above = np.bincount(number, weights=level * left.z[inside], minlength=k)
    below = np.bincount(number, weights=level**2, minlength=k)
    positive = np.bincount(number, weights=left.f[inside], minlength=k) > 0
    return [
        GroupResidual(
            grouping.words[g],
            grouping.theta_i_deg[g],
            int(counts[g]),
            round(float(above[g] / (noise * np.sqrt(below[g]))), 3) if below[g] > 0 else 0.0,
            float(f"{above[g] / below[g]:.3g}") if below[g] > 0 and positive[g] else None,
        )
        for g in range(k)
    ]


def largest_groups(
    left: Whitened, groupings: Mapping[str, Grouping], significant: list[Test]
) -> list[GroupResidual]:
    """The groups that stand out most in the test that sees most of the structure."""
    if not significant:
        return []
    best = max(significant, key=lambda test: test.share)
    groups = group_residuals(left, groupings[best.name])
    groups.sort(key=lambda group: -abs(group.z))
    return [group for group in groups[:MOST_GROUPS] if abs(group.z) > CLEAR]
