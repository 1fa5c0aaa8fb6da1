"""BRDF samples of any source: a session, a samples file, or any BRDF file that gonio reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import gonio.formats as formats
from gonio.calibration.reduction.reduce import reduce
from gonio.checks import measurements
from gonio.errors import DataError
from gonio.progress import StagedProgress, begin
from gonio.samples import BRDFSamples
from gonio.session import Session


def load(
    source: str | Path,
    *,
    select: Mapping[str, str] | None = None,
    max_theta_i: float | None = None,
    max_theta_r: float | None = None,
    threads: int | None = None,
    progress: StagedProgress | None = None,
) -> BRDFSamples:
    """BRDF samples from a session, a samples file, or any BRDF file that gonio reads.

    Codes for missing readings, such as -9999, are left out; the history of the samples says so, and
    `gonio.check` lists them.

    Parameters
    ----------
    source : path
        A session is reduced; a file is recognised by its content.
    select : mapping of str to str, optional
        ``{"wavelength": "600..700"}`` or ``{"channel": "red"}``; see `gonio.formats.read`.
    max_theta_i, max_theta_r : float, optional
        Largest angle of incidence and of viewing, radians.
    threads : int, optional
        Number of worker threads; the samples do not depend on it.
    progress : callable, optional
        Called with (stage, images done, total number of images) while a session is reduced.

    Returns
    -------
    BRDFSamples

    Raises
    ------
    DataError
        If the source cannot be read, a session lacks frames, or no sample remains.
    ConfigurationError
        If the selection is not possible.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "paint.csv"
    >>> _ = file.write_text("theta_i,phi_i,theta_r,phi_r,brdf\\n0,0,10,0,0.3\\n0,0,50,0,0.2\\n")
    >>> len(load(file)), len(load(file, max_theta_r=0.5))
    (2, 1)
    """
    samples, _ = load_with_session(Path(source), select or {}, threads=threads, progress=progress)
    return samples.limited(max_theta_i=max_theta_i, max_theta_r=max_theta_r)


def load_with_session(
    source: Path,
    select: Mapping[str, str],
    *,
    threads: int | None = None,
    progress: StagedProgress | None = None,
) -> tuple[BRDFSamples, Session | None]:
    """The selected samples of a source, and its session if the source is a session."""
    if not source.is_dir():
        if source.suffix.lower() == ".json" and source.is_file():
            raise DataError(
                f"{source}: JSON is no format of BRDF samples; a fit is read by "
                "gonio.FitResult.load and shown by 'gonio plot' and 'gonio report'.",
                value=source,
            )
        return measurements(formats.read(source, select=select)).samples, None
    session = Session.open(source)
    session.require_complete()
    callback = begin(progress, f"reducing {source.name or source}", "images")
    samples = reduce(session, threads=threads, progress=callback)
    return (formats.choose(samples, select) if select else samples), session


def several(samples: BRDFSamples) -> tuple[str, list[str]] | None:
    """The property that distinguishes several BRDFs in the samples; None if they hold one BRDF.

    Returns
    -------
    (key, values), or None
        "wavelength" or "channel", and its values in the form of a selection, in order.

    Examples
    --------
    >>> import numpy as np
    >>> from gonio.geometry import Directions
    >>> theta = np.array([0.1, 0.2])
    >>> directions = Directions(theta, 0.0, theta, 0.0)
    >>> several(BRDFSamples(directions, theta, wavelength_nm=np.array([650.0, 450.0])))
    ('wavelength', ['450', '650'])
    >>> several(BRDFSamples(directions, theta)) is None
    True
    """
    for key, column in (("wavelength", samples.wavelength_nm), ("channel", samples.channel)):
        values = [] if column is None else sorted(set(column.tolist()))
        if len(values) > 1:
            return key, [f"{v:g}" if isinstance(v, float) else str(v) for v in values]
    return None
