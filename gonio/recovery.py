"""True parameters of simulated sessions, for comparison with the estimates of a fit.

No fit reads them; only recovery tables use them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gonio.errors import ConfigurationError, DataError
from gonio.fitting.problem.channels import split
from gonio.fitting.result import FitResult
from gonio.models import Model
from gonio.samples import BRDFSamples
from gonio.session import Session, read_truth


def true_by_part(
    sources: Mapping[str, Path],
    samples: Mapping[str, BRDFSamples],
    model: Model,
    *,
    session: Path | None = None,
) -> tuple[list[dict[str, float] | None], list[str]]:
    """True parameters of every part of a fit, if the sources are simulated sessions.

    Parameters
    ----------
    sources, samples : mapping by name
        The sources of the samples, and the samples.
    model : Model
    session : path, optional
        The simulated session to read instead of the sources.

    Returns
    -------
    parts : list of dict, or None
        Values in the unit of files, for each channel, wavelength and source; None if unknown.
    others : list of str
        The models of those sessions that were simulated with another model than `model`.

    Raises
    ------
    DataError
        If `session` is not a simulated session.
    ConfigurationError
        If true values differ between channels and the samples state no channel.
    """
    others: list[str] = []
    raw: dict[str, dict[str, Any] | None] = {}
    for name, source in sources.items():
        truth = _truth(session or source, asked=session is not None)
        if truth is not None and truth["model"] != model.name:
            others.append(truth["model"])
            truth = None
        raw[name] = None
        if truth is not None:
            raw[name] = {q.name: truth["parameters"][q.name] for q in model.parameters}
    parts: list[dict[str, float] | None] = []
    for channel in split(samples if len(samples) > 1 else next(iter(samples.values()))):
        name = channel.material or next(iter(sources))
        values = raw[name]
        if values is not None and any(isinstance(value, list) for value in values.values()):
            k = _channel_index(session or sources[name], channel.samples)
            values = {q: v[k] if isinstance(v, list) else v for q, v in values.items()}
        parts.append(None if values is None else _in_file_units(model, values))
    return parts, others


def _in_file_units(model: Model, values: Mapping[str, Any]) -> dict[str, float]:
    return {q.name: q.to_file(values[q.name]) for q in model.parameters}


def true_parameters(
    result: FitResult, by_part: Sequence[Mapping[str, float] | None]
) -> dict[str, float] | None:
    """True values by the names of the fit, for values on which all parts agree."""
    if not result.parts:
        return dict(by_part[0]) if by_part[0] is not None else None
    values: dict[str, set[float]] = {}
    for part, true_values in zip(result.parts, by_part, strict=True):
        for q, value in (true_values or {}).items():
            values.setdefault(part.parameters[q], set()).add(value)
    return {name: each.pop() for name, each in values.items() if len(each) == 1} or None


def _truth(session: Path, *, asked: bool) -> dict[str, Any] | None:
    """The truth of a simulated session; None for a measured one."""
    truth = read_truth(session) if session.is_dir() else None
    if truth is None and asked:
        raise DataError(
            f"{session}: holds no truth; give a session that 'gonio simulate' wrote.",
            value=session,
        )
    return truth


def _channel_index(session: Path, samples: BRDFSamples) -> int:
    """Index of the samples' channel in a simulated session, by name or else by wavelength."""
    channels = Session.open(session).metadata.plan.channels
    listed: list[Any] = [channel.name for channel in channels]
    own: Any = None
    of = "of no stated channel"
    if samples.channel is not None:
        own = str(samples.channel[0])
        of = f"of channel {own}"
    elif samples.wavelength_nm is not None:
        listed = [channel.wavelength_nm for channel in channels]
        own = float(samples.wavelength_nm[0])
        of = f"of {own:g} nm"
    if listed.count(own) == 1:
        return listed.index(own)
    names = ", ".join(channel.name for channel in channels)
    raise ConfigurationError(
        f"{session}: its true parameters differ between the channels {names}, and the samples are "
        f"{of}; give samples of one of these channels, or a session of their own.",
        value=own,
    )
