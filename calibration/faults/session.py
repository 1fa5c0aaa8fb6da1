"""What is wrong with the frames of a session: frame, value and consequence of each fault.

A few statistics of every image are kept when it is read (`frame_statistics`). At the end they are
compared with the session's metadata and with each other, one question a file. A finding is an error
if samples would be wrong without any sign of it, else a warning. Nothing here repairs anything: the
reduction masks dead, hot and saturated pixels.

Faults that the frames do not show are not judged. A standard of another reflectance scales all
images by one factor, and a lamp that drifts smoothly with the incidence looks like a dome whose
transmittance varies.
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
    """Process the frames of a session, then ask what is wrong with the frames that were read.

    Parameters
    ----------
    session : Session
    metadata : Metadata
        Of the session, with a calibrated geometry in place where there is one.
    theta_r, phi_r : ndarray, shape (rows, columns)
        Directions of the pixels, radians, frame of the laboratory; NaN outside the image circle.
    work : callable
        Called with one reader of frames for each channel.
    force : bool
        Continue if an error is found.

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
    wrong = _of_channels(metadata.plan, evidence)
    errors = [finding for finding in wrong if finding.severity == "error"]
    if errors and not force:
        more = f" ({len(errors) - 1} more such findings.)" if len(errors) > 1 else ""
        raise DataError(f"{session.path}: {errors[0].text}{more}", value=errors)
    return done, wrong


def _of_channels(plan: Plan, evidence: Sequence[Evidence]) -> tuple[Finding, ...]:
    """What is wrong with the frames, channel by channel, errors first."""
    wrong: list[Finding] = []
    for channel, of_channel in zip(plan.channels, evidence, strict=True):
        own = findings(of_channel)
        if len(evidence) > 1:
            own = tuple(replace(f, text=f"channel {channel.name}: {f.text}") for f in own)
        wrong += own
    return tuple(sorted(wrong, key=lambda finding: finding.severity != "error"))


def check_session(session: Session, *, threads: int | None = None) -> tuple[Finding, ...]:
    """Read every frame of a session and say what is wrong with it.

    Parameters
    ----------
    session : Session
        Complete.
    threads : int, optional
        Number of worker threads; the findings do not depend on it.
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
