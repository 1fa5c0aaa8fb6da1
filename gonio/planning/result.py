"""Result of a plan search: the plan, and the uncertainties that are expected of it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gonio.files import write_text
from gonio.instrument import Instrument
from gonio.metadata import Plan
from gonio.models import Parameter
from gonio.plan_file import plan_text
from gonio.planning.information import Expected
from gonio.planning.virtual_session import Setup

AS_GOOD = 1 + 1e-9  # times a wanted uncertainty: rounding does not make a plan fail


@dataclass(frozen=True)
class DesignResult:
    """A plan with the uncertainties that are expected of it.

    Parameters
    ----------
    setup : Setup
        The instrument that the search used: coarse, of one channel.
    instrument : Instrument
        The instrument as it was given.
    parameters, wanted : mapping
        Values, radians for angles, and relative standard uncertainties to reach.
    plan, default_plan : Plan
        For the instrument's channels.
    expected, expected_of_default : Expected
        What a fit to each plan will state.
    most_helpful : list
        For each parameter theta_i and rotation, degrees, of the image without which its
        uncertainty grows most, and the factor of that growth.
    determined : list of bool
        Parameters that some candidate image determines.
    meanings : mapping of str to str
        Meaning of each source of uncertainty.
    constant : frozenset of str
        Sources that are the same in every simulated session: they bias, and do not scatter.
    verification : mapping, optional
        See `gonio.planning.verification.verify`.
    """

    setup: Setup
    instrument: Instrument
    parameters: Mapping[str, float]
    wanted: Mapping[str, float]
    plan: Plan
    default_plan: Plan
    expected: Expected
    expected_of_default: Expected
    most_helpful: list[tuple[float, float, float] | None]
    determined: list[bool]
    meanings: Mapping[str, str]
    constant: frozenset[str] = frozenset()
    verification: Mapping[str, Any] | None = None

    @property
    def u_relative(self) -> dict[str, float | None]:
        """Expected relative standard uncertainty of each parameter; None where not determined."""
        return {row["name"]: row["u_relative"] for row in self._rows()}

    def document(self) -> dict[str, Any]:
        """The result as one JSON document, in the units of files."""
        rows = self._rows()
        reached = [row["u_relative"] is not None and row["u_relative"] <= row["wanted"] * AS_GOOD
                   for row in rows if row["wanted"] is not None]  # fmt: skip
        return {
            "schema": "gonio.design/1",
            "model": self.setup.model.name,
            "instrument": self.instrument.name,
            "pixels": list(self.setup.instrument.sensor.shape),
            "plan": _described(self.plan),
            "default": _described(self.default_plan),
            "parameters": rows,
            "reached": all(reached) if reached else None,
            "remarks": self._remarks(rows),
        }

    def plan_text(self) -> str:
        """The plan as a table [plan] of TOML; a comment names the model and its parameters."""
        model = self.setup.model
        values = ", ".join(
            f"{q.name} = {q.to_file(self.parameters[q.name]):.6g}{' ' * bool(q.file_unit)}"
            f"{q.file_unit}"
            for q in model.parameters
        )
        heading = f"Plan of 'gonio design' for {model.name} on {self.instrument.name}:"
        return plan_text(self.plan, [heading, *textwrap.wrap(values, 90)])

    def save(self, path: str | Path) -> Path:
        """Write the plan for ``gonio.simulate(plan=...)`` or a rig's session.toml, as TOML."""
        write_text(Path(path), self.plan_text())
        return Path(path)

    def _rows(self) -> list[dict[str, Any]]:
        _, _, reported = self.setup.constraints.unknowns(self.setup.model)
        rows = []
        for r in reported:
            row = self._row(r.parameter, r.unknown)
            # Only fixed and tied parameters have these keys.
            if r.unknown is None:
                row["fixed"] = True
            if r.tied_to is not None:
                row["tied_to"] = r.tied_to
            rows.append(row)
        return rows

    def _row(self, parameter: Parameter, j: int | None) -> dict[str, Any]:
        value = self.parameters[parameter.name]
        determined = j is not None and self._is_determined(j, self.expected)
        source: str | None = None
        largest, u, u_of_default, helpful = math.nan, math.nan, None, None
        if j is not None:
            u = float(self.expected.u[j])
            if determined:
                source, largest = self.expected.largest_source(j)
                helpful = self.most_helpful[j]
            if self._is_determined(j, self.expected_of_default):
                u_of_default = parameter.to_file(float(self.expected_of_default.u[j]))
        return {
            "name": parameter.name,
            "value": parameter.to_file(value),
            "unit": parameter.file_unit,
            "u": parameter.to_file(u) if determined else None,
            "u_relative": _share(u, value) if determined else None,
            "u_of_default": u_of_default,
            "wanted": self.wanted.get(parameter.name),
            "largest_source": source,
            "largest_source_u": parameter.to_file(largest) if determined else None,
            "helped_most_by": None if helpful is None else _helping(*helpful),
        }

    def _is_determined(self, j: int, expected: Expected) -> bool:
        """Whether the images determine a parameter better than its allowed range does."""
        parameter = self.setup.unknowns[j]
        return bool(expected.determined[j] and expected.u[j] < (parameter.upper - parameter.lower))

    def _remarks(self, rows: list[dict[str, Any]]) -> list[str]:
        lines = []
        names = [row["name"] for row in rows]
        for j, q in enumerate(self.setup.unknowns):
            row = rows[names.index(q.name)]
            if not self.determined[j]:
                value = f"{row['value']:.4g}{' ' * bool(row['unit'])}{row['unit']}"
                lines.append(
                    f"{row['name']}: no plan of {self.instrument.name} determines it where it is "
                    f"{value}."
                    if row["wanted"] is None
                    else f"{row['name']}: {100 * row['wanted']:.2g} % was wanted, and no plan of "
                    f"{self.instrument.name} determines it where it is {value}."
                )
            elif row["u"] is None:
                lines.append(f"{row['name']}: this plan does not determine it.")
            elif row["wanted"] is not None and row["u_relative"] > row["wanted"] * AS_GOOD:
                lines.append(self._limited(row))
        if len(self.instrument.channels) > 1:
            dimmest = self.setup.instrument.channels[0].name
            lines.append(
                f"{len(self.instrument.channels)} channels: planned in the dimmest, {dimmest}; "
                "frames are counted in all."
            )
        return lines

    def _limited(self, row: dict[str, Any]) -> str:
        """Why a wanted precision is out of reach."""
        share = _share(row["largest_source_u"], row["value"])
        assert share is not None
        meaning = self.meanings[row["largest_source"]]
        per_cent = f"{100 * share:.2g} %"
        alone = (
            f"{meaning} alone is {per_cent}, more than that"
            if share > row["wanted"]
            else f"the largest source is {meaning} with {per_cent}"
        )
        return (
            f"{row['name']}: {100 * row['wanted']:.2g} % was wanted and "
            f"{100 * row['u_relative']:.2g} % is reached; {alone}."
        )


def _helping(theta_i_deg: float, rotation_deg: float, growth: float) -> dict[str, float | None]:
    """The most helpful image; no growth where the parameter is not determined without it."""
    finite = growth if math.isfinite(growth) else None
    return {"theta_i_deg": theta_i_deg, "rotation_deg": rotation_deg, "growth": finite}


def _share(u: float, value: float) -> float | None:
    return float(u) / abs(value) if value else None


def _described(plan: Plan) -> dict[str, Any]:
    return {
        "theta_i_deg": list(plan.theta_i_deg),
        "rotations_deg": list(plan.rotations_deg),
        "exposures_s": list(plan.exposures_s),
        "repeats": plan.repeats,
        "images": plan.n_images,
        "frames": plan.n_frames,
    }
