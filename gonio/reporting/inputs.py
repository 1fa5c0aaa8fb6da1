"""Inputs of a report: the fit, and those of its data that can still be found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any

import gonio.formats as formats
from gonio.checks.plausibility import measurements
from gonio.errors import ConfigurationError, DataError, GonioError
from gonio.files import sha256_of
from gonio.fitting.problem.copies import usable
from gonio.fitting.provenance import data_hash
from gonio.fitting.result import FitResult
from gonio.plotting.summary import read_draws
from gonio.samples import BRDFSamples
from gonio.session import Session
from gonio.wording import counted

Reducer = Callable[[Session], BRDFSamples]


@dataclass(frozen=True)
class Inputs:
    """A fit and its data; what is missing is None and has a sentence in `absent`.

    Parameters
    ----------
    fit : FitResult
    name : str
        File of the fit.
    samples : BRDFSamples or None
        The samples that were fitted, with the cuts of the fit applied.
    session : Session or None
        The raw frames.
    draws : xarray.Dataset or None
        The posterior's draws.
    absent : tuple of str
        Reason for each input that is missing, one sentence each.
    """

    fit: FitResult
    name: str
    samples: BRDFSamples | None = None
    session: Session | None = None
    draws: Any = None
    absent: tuple[str, ...] = ()


def gather(
    source: str | Path,
    reducer: Reducer | None = None,
    choose: Callable[[FitResult], FitResult] | None = None,
    samples: BRDFSamples | str | Path | None = None,
) -> Inputs:
    """Read a fit and look for its samples, session and draws by the names they had.

    The search covers the current folder and the folder of the fit. Only the fit is required.

    Parameters
    ----------
    source : path
        A FIT.json that `gonio fit` wrote.
    reducer : callable, optional
        Turns the session into samples where the fit was made to a session; `gonio.reduce` where
        not given.
    choose : callable, optional
        Takes one part out of a joint fit.
    samples : BRDFSamples or path, optional
        Those that the fit was made to, where they are not to be looked for.

    Raises
    ------
    DataError
        If the fit is missing or is not a fit, or the given samples are not those of the fit.
    ConfigurationError
        If it is a joint fit and no part was chosen.
    """
    source = Path(source)
    fit = FitResult.load(source)
    fit = fit if choose is None else choose(fit)
    if fit.parts:
        raise ConfigurationError(
            f"{source}: a joint fit of {', '.join(part.name for part in fit.parts)}; choose one "
            "of them with its method part().",
            value=source,
        )
    absent: list[str] = []
    reducer = reducer or _reduce
    if samples is None:
        measured = _or_none(absent, "samples", lambda: _samples(source, fit, reducer))
    else:
        measured = _given(samples, fit, reducer)
    session = _or_none(absent, "session", lambda: _session(source, fit))
    draws = _or_none(absent, "draws", lambda: _draws(source, fit))
    return Inputs(fit, source.name, measured, session, draws, tuple(absent))


def _or_none(absent: list[str], kind: str, read: Callable[[], Any]) -> Any:
    """Result of `read`; an error of gonio or of the system becomes a line of `absent`."""
    try:
        return read()
    except (GonioError, OSError) as error:
        absent.append(f"The {kind}: {error}")
        return None


def _samples(source: Path, fit: FitResult, reducer: Reducer) -> BRDFSamples:
    name = fit.source.get("input") or fit.source.get("path")
    if not name:
        raise DataError("the fit does not say which samples it was made to.")
    path = _find(str(name), source)
    if path.is_file():
        _require_unchanged(path, fit)
    samples = _as_fitted(_read(path, reducer), fit)
    if len(samples) != fit.n_samples:
        raise DataError(
            f"{name} holds {counted(len(samples), 'sample')} and the fit was made to "
            f"{fit.n_samples}; it has changed since."
        )
    return samples


def _given(samples: BRDFSamples | str | Path, fit: FitResult, reducer: Reducer) -> BRDFSamples:
    """Samples that the caller names; their numbers must be those of the fit."""
    named = "the samples" if isinstance(samples, BRDFSamples) else str(samples)
    if not isinstance(samples, BRDFSamples):
        samples = _read(Path(samples), reducer)
    samples = _as_fitted(samples, fit)
    recorded = None if fit.source.get("joint") else fit.source.get("data_sha256")
    if len(samples) != fit.n_samples or (recorded and data_hash(samples) != recorded):
        raise DataError(
            f"{named}: not the samples that the fit was made to (their number or SHA-256 "
            "differs); give those, or fit again.",
            value=named,
        )
    return samples


def _read(path: Path, reducer: Reducer) -> BRDFSamples:
    """The samples of a file or of a session."""
    if not path.is_dir():
        return formats.read(path)
    session = Session.open(path)
    session.require_complete()
    return reducer(session)


def _as_fitted(samples: BRDFSamples, fit: FitResult) -> BRDFSamples:
    """The samples that a fit takes of these, by its selection and limits."""
    select: Mapping[str, str] = fit.cuts.get("select") or {}
    samples = measurements(formats.choose(samples, select)).samples
    limits = [fit.cuts.get(f"max_{angle}_deg") for angle in ("theta_i", "theta_r")]
    theta_i, theta_r = (None if limit is None else radians(float(limit)) for limit in limits)
    return usable(samples.limited(max_theta_i=theta_i, max_theta_r=theta_r))


def _require_unchanged(path: Path, fit: FitResult) -> None:
    digest = fit.source.get("sha256")
    if digest and sha256_of(path) != digest:
        raise DataError(f"{path.name} has changed since the fit was made to it.", value=path)


def _session(source: Path, fit: FitResult) -> Session | None:
    name = fit.source.get("session")
    return None if not name else Session.open(_find(str(name), source))


def _draws(source: Path, fit: FitResult) -> Any:
    if fit.posterior is None or fit.posterior.draws is None:
        return None
    draws = read_draws(_find(fit.posterior.draws, source))
    names = (fit.source.get("joint") or {}).get("parameters") or {}
    names = {new: old for new, old in names.items() if old in draws}  # fixed ones have no draws
    if names:
        # The draws of a joint fit are named as its parameters are.
        draws = draws[list(names.values())].rename({old: new for new, old in names.items()})
    if not all(name in draws for name, e in fit.parameters.items() if e.unknown):
        raise DataError(f"{fit.posterior.draws} does not hold the parameters of this fit.")
    return draws


def _find(name: str, source: Path) -> Path:
    """A file by the name it had: from the current folder, or beside the fit."""
    for path in (Path(name), source.parent / name, source.parent / Path(name).name):
        if path.exists():
            return path
    raise DataError(f"{name} is neither in the current folder nor beside the fit.", value=name)


def _reduce(session: Session) -> BRDFSamples:
    from gonio.calibration.reduction.reduce import reduce

    return reduce(session)
