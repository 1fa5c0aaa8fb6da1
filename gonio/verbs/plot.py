"""Plots of a model, BRDF samples, a session, a fit or a map of a dome."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gonio.formats as formats
import gonio.models as models
from gonio.dome_map import DomeMap, is_dome_map
from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.fitting.part_choice import part_chooser
from gonio.fitting.result import FitResult
from gonio.models import Model
from gonio.progress import StagedProgress
from gonio.samples import BRDFSamples
from gonio.session import Session
from gonio.verbs.surface import named_surface

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The data that each kind of plot needs.
KINDS = {
    "summary": "samples",
    "slices": "samples",
    "hemisphere": "samples or model",
    "residuals": "fit",
    "frames": "session",
    "lobe": "model",
    "solid": "model",
    "albedo": "model",
    "dome": "dome",
}
SIGNS = ("model:", "material:")

Note = Callable[[str], None]


@dataclass(frozen=True)
class _Content:
    """The data to draw; None where there is none."""

    fit: FitResult | None = None
    samples: BRDFSamples | None = None
    session: Session | None = None
    draws: Any = None
    model: Model | None = None
    parameters: Mapping[str, float] | None = None
    dome: DomeMap | None = None

    def has(self, what: str) -> bool:
        """Whether one of the named data is present, as in "samples or model"."""
        return any(getattr(self, word) is not None for word in what.split(" or "))


@dataclass(frozen=True)
class _Reader:
    """How a source is read: the selection, and the function that receives notes."""

    select: Mapping[str, str]
    choose: Callable[[FitResult], FitResult] | None
    note: Note
    progress: StagedProgress | None


def plot(
    source: Model | FitResult | BRDFSamples | Session | DomeMap | Path | str,
    kind: str | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    samples: BRDFSamples | str | Path | None = None,
    select: Mapping[str, str] | None = None,
    choose: Callable[[FitResult], FitResult] | None = None,
    note: Note | None = None,
    progress: StagedProgress | None = None,
) -> Figure:
    """Draw a model, BRDF samples, a session, a fit or a map of a dome.

    Parameters
    ----------
    source : Model, FitResult, BRDFSamples, Session, DomeMap, path or str
        What to draw: an object; a FIT.json, a DOME.nc, samples or the folder of a session; or
        "model:NAME" or "material:NAME". With a FIT.json, the samples, posterior and frames that it
        names are also drawn, if they exist.
    kind : str, optional
        "summary", "slices", "hemisphere", "residuals", "frames", "lobe", "solid", "albedo" or
        "dome"; default: one page with all of them, the lobe of a model, or the dome of a map.
    parameters : mapping of str to float, optional
        Parameters of a model, radians for angles.
    samples : BRDFSamples or path, optional
        The samples of a fit. By default those that a fit of this process was made to, or those
        that a FIT.json names.
    select : mapping of str to str, optional
        Part of a file or of a joint fit: ``{"wavelength": "650"}``, ``{"channel": "red"}`` or
        ``{"part": NAME}``.
    choose : callable, optional
        Function that selects one part of a joint fit, instead of `select`.
    note : callable, optional
        Called with a sentence for each choice or omission; default: `warnings.warn`.
    progress : callable, optional
        Called with (stage, images done, total number of images) while a session is reduced.

    Returns
    -------
    matplotlib.figure.Figure
        `gonio.plotting.save` writes it.

    Raises
    ------
    ConfigurationError
        For an unknown kind, a kind for which the source has no data, or parameters of measured
        data.
    DataError
        If a file is missing or cannot be read.

    Examples
    --------
    >>> figure = plot("model:ward", "albedo", parameters={"rho_d": 0.3})
    >>> len(figure.axes)
    1
    """
    if kind is not None and kind not in KINDS:
        raise unknown_name("kind of picture", kind, KINDS)
    note = note or (lambda text: warnings.warn(text, stacklevel=3))
    reader = _Reader(select or {}, choose, note, progress)
    named = isinstance(source, Model) or (isinstance(source, str) and source.startswith(SIGNS))
    if parameters and not named:
        raise ConfigurationError(
            f"parameters go with a model or a material, and {_called(source)} has its own values.",
            value=dict(parameters),
        )
    content = _content(source, parameters, samples, reader)
    kind = kind or ("lobe" if named else "summary")
    if content.dome is not None and kind == "summary":
        kind = "dome"
    if not content.has(KINDS[kind]):
        raise ConfigurationError(
            f"kind {kind} is drawn of {KINDS[kind]}, and {_called(source)} has none; it can be "
            f"drawn as {', '.join(k for k, what in KINDS.items() if content.has(what))}.",
            value=kind,
        )
    return _drawn(kind, content)


def _called(source: object) -> str:
    """What messages call a source."""
    return str(source) if isinstance(source, str | Path) else f"this {type(source).__name__}"


def _content(
    source: Model | FitResult | BRDFSamples | Session | DomeMap | Path | str,
    parameters: Mapping[str, float] | None,
    samples: BRDFSamples | str | Path | None,
    reader: _Reader,
) -> _Content:
    match source:
        case Model():
            return _Content(model=source, parameters=parameters or {})
        case FitResult():
            choose = reader.choose or part_chooser(reader.select)
            if samples is None and source.memory is not None and not source.parts:
                samples = source.memory.samples
            elif isinstance(samples, str | Path):
                samples = formats.read(Path(samples))
            return _of_fit(choose(source), samples, None, None)
        case BRDFSamples():
            chosen = formats.choose(source, reader.select)
            return _Content(samples=_one_channel("the samples", chosen, reader.note))
        case Session():
            return _Content(session=source)
        case DomeMap():
            return _Content(dome=source)
        case str() if source.startswith(SIGNS):
            sign, _, name = source.partition(":")
            model, material = (name, None) if sign == "model" else (None, name)
            chosen_model, values = named_surface(model, material, parameters)
            return _Content(model=chosen_model, parameters=values)
        case _:
            return _read(Path(source), samples, reader)


def _read(source: Path, given: BRDFSamples | str | Path | None, reader: _Reader) -> _Content:
    from gonio.reading import load_with_session

    if source.suffix == ".json":
        return _fitted(source, given, reader)
    if given is None and is_dome_map(source):
        return _Content(dome=DomeMap.load(source))
    if given is not None:
        raise ConfigurationError(f"samples go with a fit, and {source} is not one; leave them out.")
    samples, session = load_with_session(source, reader.select, progress=reader.progress)
    session = session or _session(source, samples, reader.note)
    return _Content(samples=_one_channel(str(source), samples, reader.note), session=session)


def _fitted(source: Path, given: BRDFSamples | str | Path | None, reader: _Reader) -> _Content:
    """A fit with its samples, which must exist, and its session and draws, which may be missing."""
    from gonio.reporting.inputs import gather
    from gonio.verbs.report import reducer

    choose = reader.choose or part_chooser(reader.select, where=str(source))
    inputs = gather(source, reducer(reader.progress), choose, given)
    if inputs.samples is None:
        why = next(line for line in inputs.absent if line.startswith("The samples: "))
        raise DataError(
            f"{source}: {why.removeprefix('The samples: ')} Give them with --samples FILE, in "
            "Python with samples=.",
            value=source,
        )
    for line in inputs.absent:
        reader.note(f"Left out of the picture: {line}")
    session = inputs.session or _session(source, inputs.samples, reader.note)
    return _of_fit(inputs.fit, inputs.samples, session, inputs.draws)


def _of_fit(
    fit: FitResult, samples: BRDFSamples | None, session: Session | None, draws: Any
) -> _Content:
    return _Content(fit, samples, session, draws, models.of_fit(fit), fit.values())


def _session(path: Path, samples: BRDFSamples, note: Note) -> Session | None:
    """The session that the samples came from; without it the frames are left out."""
    name = samples.metadata.get("session")
    if not name:
        return None
    candidates = (Path(name), path.parent / name, path.parent / Path(name).name)
    for candidate in candidates:
        if candidate.exists():
            return Session.open(candidate)
    note(f"the session {name} is not there: its frames are left out of the picture.")
    return None


def _one_channel(where: str, samples: BRDFSamples, note: Note) -> BRDFSamples:
    """One BRDF at a time: of several wavelengths or channels the middle one, and says which."""
    for key, column in (("wavelength", samples.wavelength_nm), ("channel", samples.channel)):
        values = [] if column is None else sorted(set(column.tolist()))
        if len(values) > 1:
            middle = str(values[len(values) // 2])
            note(f"{where} holds {len(values)} {key}s: drawn is {key} {middle}.")
            samples = formats.choose(samples, {key: middle})
    return samples


def _drawn(kind: str, content: _Content) -> Figure:
    """The figure of one kind; `content` has what the kind is made of."""
    import gonio.plotting as plotting

    fit, samples, session = content.fit, content.samples, content.session
    model, values = content.model, content.parameters
    figures: dict[str, Callable[[], Figure]] = {}
    if content.dome is not None:
        dome = content.dome
        figures["dome"] = lambda: _figure(*plotting.dome_map(dome))
    if samples is not None:
        figures["summary"] = lambda: plotting.summary(fit, samples, session, content.draws)
        figures["slices"] = lambda: _figure(plotting.slices(samples, fit))
        figures["hemisphere"] = lambda: _figure(*plotting.hemisphere_samples(samples))
        if fit is not None:
            figures["residuals"] = lambda: _figure(*plotting.residual_map(samples, fit))
    if session is not None:
        figures["frames"] = lambda: _figure(*plotting.frames(session))
    if model is not None:
        figures["lobe"] = lambda: _figure(*plotting.model_lobes(model, values))
        figures["solid"] = lambda: _figure(plotting.lobe_solid(model, values))
        figures["albedo"] = lambda: _figure(plotting.albedo_curve(model, values))
        figures.setdefault("hemisphere", lambda: _figure(*plotting.hemisphere_map(model, values)))
    return figures[kind]()


def _figure(*axes: Axes) -> Figure:
    """The figure on which these axes stand."""
    figure = axes[0].get_figure(root=True)
    assert figure is not None
    return figure
