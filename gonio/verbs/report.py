"""A fit as one HTML page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import gonio.formats as formats
from gonio.calibration.reduction.reduce import reduce
from gonio.errors import ConfigurationError
from gonio.files import write_text
from gonio.fitting.part_choice import part_chooser
from gonio.fitting.result import FitResult
from gonio.progress import StagedProgress, begin
from gonio.reporting import Inputs, gather, page
from gonio.reporting.statement import statement
from gonio.samples import BRDFSamples
from gonio.session import Session


@dataclass(frozen=True)
class Report:
    """A page, and the reasons for what it leaves out.

    Parameters
    ----------
    html : str
        The page; it opens without a network.
    absent : tuple of str
        Reason for each part that is left out, one sentence each.
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
    output: str | Path | None = None,
    *,
    samples: BRDFSamples | str | Path | None = None,
    session: Session | None = None,
    select: Mapping[str, str] | None = None,
    choose: Callable[[FitResult], FitResult] | None = None,
    operator: str | None = None,
    dates: Iterable[str] = (),
    issued: str | None = None,
    serials: Mapping[str, str] | Iterable[str] = (),
    coverage: str | float | None = None,
    dof: float | None = None,
    progress: StagedProgress | None = None,
) -> Report:
    """Make one HTML page of a fit that opens without a network.

    Parameters
    ----------
    fit : FitResult or path
        A fit, or the FIT.json of one. The samples, session and draws of a file are looked
        for by the names they had, in the current folder and in that of the file.
    output : path, optional
        Where to write the page, .html; `Report.save` writes it later.
    samples : BRDFSamples or path, optional
        The samples of the fit. By default those that a FIT.json names, or those that a fit of
        this process was made to.
    session : Session, optional
        The raw frames behind a fit in memory.
    select : mapping of str to str, optional
        Part of a joint fit: ``{"wavelength": "650"}``, ``{"channel": "red"}``, ``{"part": NAME}``.
    choose : callable, optional
        Takes one part out of a joint fit, in place of `select`.
    operator : str, optional
        Name of the person who measured.
    dates : iterable of str
        Days of the measurement, YYYY-MM-DD.
    issued : str, optional
        Day of the report, YYYY-MM-DD.
    serials : mapping of str to str, or iterable of str
        Serial number of the sample, the lamp or the standard by its name, or texts NAME=NUMBER.
    coverage : str or float, optional
        Adds expanded uncertainties U = k u: a factor, 2 or "k=2", or a probability, "95%", from
        which k follows.
    dof : float, optional
        Effective degrees of freedom of the uncertainties, at least 1; a probability then gives k
        by Student's distribution.
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
        If it is a joint fit and no part is chosen, or a date, a serial number, the coverage or
        the degrees of freedom cannot be read, or the output does not end in .html.

    Examples
    --------
    >>> import gonio
    >>> import numpy as np
    >>> theta = np.linspace(0, 1.2, 20)
    >>> directions = gonio.geometry.Directions(0.3 * np.ones(20), 0.0, theta, 0.0)
    >>> samples = BRDFSamples(directions, 0.1 + 0.001 * np.cos(40 * theta))
    >>> fit = gonio.fit(samples, model="lambert")
    >>> made = report(fit, samples=samples, operator="A. Ampère", coverage=2)
    >>> made.html.startswith("<!DOCTYPE html>"), "U (k = 2)" in made.html
    (True, True)
    """
    if output is not None:
        check_page_name(Path(output))
    stated = statement(operator, dates, issued, serials, coverage, dof)
    if isinstance(fit, FitResult):
        part = (choose or part_chooser(select or {}))(fit)
        if samples is None and fit.memory is not None and not fit.parts:
            samples = fit.memory.samples
        elif isinstance(samples, str | Path):
            samples = formats.read(Path(samples))
        inputs = Inputs(part, "the fit", samples, session)
    else:
        choose = choose or part_chooser(select or {}, where=str(fit))
        inputs = gather(fit, reducer(progress), choose, samples)
    made = Report(page(inputs, stated), inputs.absent)
    if output is not None:
        made.save(output)
    return made


def check_page_name(path: Path) -> None:
    """Refuse a name that no browser would take for a page.

    Raises
    ------
    ConfigurationError
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise ConfigurationError(
            f"{path}: a report is written as HTML; give a name that ends in .html.", value=path
        )


def reducer(progress: StagedProgress | None) -> Callable[[Session], BRDFSamples]:
    """`gonio.reduce` of a session, as a stage of longer work."""

    def reduced(session: Session) -> BRDFSamples:
        callback = begin(progress, f"reducing {session.path.name or session.path}", "images")
        return reduce(session, progress=callback)

    return reduced
