"""What is wrong with the frames of a session, named: frame, figure, consequence.

Every image leaves a few figures behind when it is read (`frame_figures`); at the end they are
compared with the session's metadata and with each other. A finding is an error where samples would
be wrong and nobody would see it, else a warning. Nothing here repairs anything: dead, hot and
saturated pixels are masked where they are met.

What data cannot tell is not judged: a standard of another reflectance scales every image alike, and
a lamp that drifts smoothly with the incidence looks like a dome whose transmittance varies.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.faults import of_frames as faults_of_frames
from gonio.calibration.faults import of_images as faults_of_images
from gonio.calibration.faults.evidence import Evidence, Finding, Image
from gonio.calibration.frames import standard as eq2
from gonio.calibration.frames.exposure import Rate, merge
from gonio.geometry import angles
from gonio.kernels.threads import default_threads
from gonio.session import Session


def findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Everything that is wrong, errors first."""
    checks = (*faults_of_frames.CHECKS, *faults_of_images.CHECKS)
    found = [finding for check in checks for finding in check(evidence)]
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

    def look(image: Image) -> Rate:
        bracket = session.bracket(*image)
        rate = merge(bracket, plan.exposures_s, camera)
        evidence.see(*image, bracket, rate)
        return rate

    # Standard and background of an incidence are needed together, and no longer than that.
    alone = plan.standard_theta_i_deg is not None
    pairs = [
        (("standard", 0, i), ("background", 0, len(plan.theta_i_deg) if alone else i))
        for i in range(len(plan.incidences("standard")))
    ]

    def compare(pair: tuple[Image, Image]) -> None:
        white, black = (look(image) for image in pair)
        theta_i = evidence.theta_i(pair[0])
        f_std = eq2.standard_brdf(metadata.standard, theta_i, theta_r, phi_r)
        dark = camera.dark_e_per_s
        evidence.see_reference(pair[0][2], eq2.reference(black, white, f_std, dark_e_per_s=dark))

    def look_only(image: Image) -> None:
        look(image)

    rest = [image for image in plan.images() if not any(image in pair for pair in pairs)]
    with ThreadPoolExecutor(threads or default_threads()) as pool:
        list(pool.map(compare, pairs))
        list(pool.map(look_only, rest))
    return findings(evidence)


def of_float_frame(frame: NDArray[Any], name: str) -> tuple[Finding, ...]:
    """What a frame of floating-point numbers holds that is no count.

    Parameters
    ----------
    frame : ndarray
        As another program wrote it.
    name : str
        What to call it.

    Examples
    --------
    >>> [finding.text for finding in of_float_frame(np.array([[1.0, np.nan]]), "dark.tif")]
    ['dark.tif: 1 of 2 pixels are NaN or infinite; take the frame again or mask them.']
    """
    bad = int(np.count_nonzero(~np.isfinite(frame)))
    if bad:
        text = f"{name}: {bad} of {frame.size} pixels are NaN or infinite; take the frame again or "
        return (Finding("not_finite", "error", text + "mask them."),)
    below = int(np.count_nonzero(frame < -0.5))
    if below:
        text = f"{name}: {below} of {frame.size} pixels are below 0; give raw counts, not frames "
        return (Finding("not_raw", "error", text + "from which something was subtracted."),)
    broken = int(np.count_nonzero(frame != np.rint(frame)))
    if broken:
        text = f"{name}: {broken} of {frame.size} pixels are no whole counts; give raw frames, not "
        return (Finding("not_raw", "error", text + "processed ones."),)
    return ()
