"""A fit as one HTML page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from gonio.calibration.reduction.reduce import reduce
from gonio.files import write_text
from gonio.fitting.part_choice import part_chooser
from gonio.fitting.result import FitResult
from gonio.progress import StagedProgress, begin
from gonio.reporting import Inputs, gather, page
from gonio.reporting.statement import Statement
from gonio.samples import BRDFSamples
from gonio.session import Session


@dataclass(frozen=True)
class Report:
    """A page, and what it could not show.

    Parameters
    ----------
    html : str
        The page; it opens without a network.
    absent : tuple of str
        Why something is left out, one sentence each.
    """

    html: str
    absent: tuple[str, ...]

    def save(self, path: str | Path) -> Path:
        """Write the page, whole or not at all; returns its path."""
        write_text(Path(path), self.html)
        return Path(path)

    def _repr_html_(self) -> str:
        return self.html


def report(
    fit: FitResult | str | Path,
    *,
    samples: BRDFSamples | None = None,
    session: Session | None = None,
    select: Mapping[str, str] | None = None,
    choose: Callable[[FitResult], FitResult] | None = None,
    statement: Statement | None = None,
    progress: StagedProgress | None = None,
) -> Report:
    """Make one HTML page of a fit that opens without a network.

    Parameters
    ----------
    fit : FitResult or path
        A fit, or the FIT.json of one. Samples, session and draws of a file are looked for by the
        names they had, from the current folder and from that of the file.
    samples : BRDFSamples, optional
        What a fit in memory was made to.
    session : Session, optional
        The raw frames behind a fit in memory.
    select : mapping of str to str, optional
        Part of a joint fit: ``{"wavelength": "650"}``, ``{"channel": "red"}``, ``{"part": NAME}``.
    choose : callable, optional
        Takes one part out of a joint fit, in place of `select`.
    statement : Statement, optional
        Operator, dates, serial numbers, coverage factor and degrees of freedom to state.
    progress : callable, optional
        Called with (stage, images done, images in all) while a session is reduced.

    Returns
    -------
    Report

    Raises
    ------
    DataError
        If the file is missing or no fit.
    ConfigurationError
        If it is a joint fit and no part is chosen.

    Examples
    --------
    >>> import gonio
    >>> import numpy as np
    >>> theta = np.linspace(0, 1.2, 20)
    >>> directions = gonio.geometry.Directions(0.3 * np.ones(20), 0.0, theta, 0.0)
    >>> samples = BRDFSamples(directions, 0.1 + 0.001 * np.cos(40 * theta))
    >>> made = report(gonio.fit(samples, model="lambert"), samples=samples)
    >>> made.html.startswith("<!DOCTYPE html>")
    True
    """
    if isinstance(fit, FitResult):
        taken = (choose or part_chooser(select or {}))(fit)
        inputs = Inputs(taken, "the fit", samples, session)
    else:
        taker = choose or part_chooser(select or {}, where=str(fit))
        inputs = gather(fit, reducer(progress), taker)
    return Report(page(inputs, statement), inputs.absent)


def reducer(progress: StagedProgress | None) -> Callable[[Session], BRDFSamples]:
    """`gonio.reduce` of a session, as a stage of longer work."""

    def reduced(session: Session) -> BRDFSamples:
        callback = begin(progress, f"reducing {session.path.name or session.path}", "images")
        return reduce(session, progress=callback)

    return reduced
