"""What is wrong with the frames of a session, named: frame, figure, consequence.

Every image leaves a few figures behind when it is read (`frame_statistics`); at the end they are
compared with the session's metadata and with each other, one question a file. A finding is an error
where samples would be wrong and nobody would see it, else a warning. Nothing here repairs anything:
dead, hot and saturated pixels are masked where they are met.

What data cannot tell is not judged: a standard of another reflectance scales every image alike, and
a lamp that drifts smoothly with the incidence looks like a dome whose transmittance varies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

import numpy as np

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.faults import findings
from gonio.calibration.faults.base import Finding
from gonio.calibration.faults.evidence import Evidence, Image
from gonio.calibration.frames.reader import FrameReader
from gonio.errors import DataError
from gonio.geometry import FloatArray, angles
from gonio.kernels.threads import default_threads
from gonio.metadata import Metadata, Plan
from gonio.session import Session

Work = TypeVar("Work")


def inspected(
    session: Session,
    metadata: Metadata,
    theta_r: FloatArray,
    phi_r: FloatArray,
    work: Callable[[Sequence[FrameReader]], Work],
    *,
    force: bool = False,
) -> tuple[Work, tuple[Finding, ...]]:
    """Do work on the frames of a session and ask afterwards what was wrong with those it read.

    Parameters
    ----------
    session : Session
    metadata : Metadata
        Of the session, with a calibrated geometry in place where there is one.
    theta_r, phi_r : ndarray, shape (rows, columns)
        Where the pixels look, radians, frame of the laboratory; NaN outside the image circle.
    work : callable
        Called with one reader of frames for each channel.
    force : bool
        Go on where an error is found.

    Returns
    -------
    work : object
        What the work returned.
    findings : tuple of Finding
        Errors first.

    Raises
    ------
    DataError
        If an error is found, unless forced.
    """
    channels = range(len(metadata.plan.channels))
    evidence = [Evidence(metadata, theta_r, phi_r) for _ in channels]
    done = work([FrameReader(session, k, theta_r, phi_r, evidence[k]) for k in channels])
    found = _of_channels(metadata.plan, evidence)
    errors = [finding for finding in found if finding.severity == "error"]
    if errors and not force:
        more = f" ({len(errors) - 1} more such findings.)" if len(errors) > 1 else ""
        raise DataError(f"{session.path}: {errors[0].text}{more}", value=errors)
    return done, found


def _of_channels(plan: Plan, evidence: Sequence[Evidence]) -> tuple[Finding, ...]:
    """What is wrong with the frames, channel by channel, errors first."""
    found: list[Finding] = []
    for channel, seen in zip(plan.channels, evidence, strict=True):
        own = findings(seen)
        if len(evidence) > 1:
            own = tuple(replace(f, text=f"channel {channel.name}: {f.text}") for f in own)
        found += own
    return tuple(sorted(found, key=lambda finding: finding.severity != "error"))


def check_session(session: Session, *, threads: int | None = None) -> tuple[Finding, ...]:
    """Read every frame of a session and say what is wrong with it.

    Parameters
    ----------
    session : Session
        Complete.
    threads : int, optional
        The findings do not depend on it.
    """
    session.require_complete()
    metadata, plan = session.metadata, session.metadata.plan
    camera = metadata.camera
    columns, rows = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    theta_r, phi_r = angles(PixelMap.of(metadata).directions(columns, rows))
    evidence = Evidence(metadata, theta_r, phi_r)
    reader = FrameReader(session, 0, theta_r, phi_r, evidence)

    def look_only(image: Image) -> None:
        reader.rate(*image)

    # Standard and background of an incidence are needed together, and no longer than that.
    standards = range(len(plan.incidences("standard")))
    pairs = [reader.standard_images(i) for i in standards]
    rest = [image for image in plan.images() if not any(image in pair for pair in pairs)]
    with ThreadPoolExecutor(threads or default_threads()) as pool:
        list(pool.map(reader.compare_standard, standards))
        list(pool.map(look_only, rest))
    return findings(evidence)
