"""A plan as a file: the table [plan] that a search writes and a simulation or a rig reads."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import ValidationError

from gonio.errors import ConfigurationError, DataError
from gonio.metadata import Plan


def plan_text(plan: Plan, comment: Sequence[str] = ()) -> str:
    """The plan as a table [plan] of TOML, under a comment of some lines."""
    lines = [
        *(f"# {line}" for line in comment),
        "[plan]",
        f"theta_i_deg = [{listed(plan.theta_i_deg)}]",
        f"rotations_deg = [{listed(plan.rotations_deg)}]",
        f"exposures_s = [{listed(plan.exposures_s)}]",
        f"repeats = {plan.repeats}",
    ]
    for channel in plan.channels if plan.channels[0].name else ():
        lines += ["", "[[plan.channels]]", f"name = {json.dumps(channel.name)}"]
        if channel.wavelength_nm is not None:
            lines.append(f"wavelength_nm = {channel.wavelength_nm!r}")
    return "\n".join(lines) + "\n"


def listed(values: Iterable[float]) -> str:
    """Numbers with commas between, as TOML and the command line take them.

    Examples
    --------
    >>> listed((0.0, 22.5))
    '0, 22.5'
    """
    return ", ".join(f"{value:.10g}" for value in values)


def read_plan(path: str | Path) -> Plan:
    """The plan in a file that `plan_text` wrote, or in any TOML with a table [plan].

    Raises
    ------
    DataError
        If there is no such file.
    ConfigurationError
        If it is no TOML, or holds no valid table [plan].

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "plan.toml"
    >>> table = "[plan]\\ntheta_i_deg = [0, 30]\\nrotations_deg = [0]\\nexposures_s = [0.1]\\n"
    >>> _ = file.write_text(table)
    >>> read_plan(file).theta_i_deg
    (0.0, 30.0)
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        reason = error.strerror or error
        raise DataError(f"{path}: cannot be read ({reason}).", value=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: not valid TOML: {error}.", value=path) from None
    if not isinstance(table.get("plan"), dict):
        raise ConfigurationError(
            f"{path}: holds no table [plan]; give a file that 'gonio design -o' wrote.", value=path
        )
    try:
        return Plan.model_validate(table["plan"])
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in ("plan", *first["loc"]))
        raise ConfigurationError(f"{path}: {key}: {first['msg']}.", value=path) from None
