"""Raw frames to BRDF samples: merge, eq. (2), eq. (3) or the exact mirror, mask, thin."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gonio.calibration import effects
from gonio.calibration.dome import geometry_file
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.faults.session import inspected
from gonio.calibration.reduction.image import Progress, cells_of_session
from gonio.calibration.reduction.pixel_table import PixelTable
from gonio.calibration.reduction.samples import samples_of
from gonio.calibration.reflector import Mapping
from gonio.dome_map import LEARNT, DomeMap
from gonio.errors import ConfigurationError
from gonio.metadata import Metadata
from gonio.samples import BRDFSamples
from gonio.session import Session


def reduce(
    session: Session | str | Path,
    *,
    mapping: Mapping = "eq3",
    geometry: str | Path | None = None,
    dome: DomeMap | str | Path | None = None,
    retro: bool = False,
    force: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> BRDFSamples:
    """BRDF samples with uncertainties from a complete session.

    Parameters
    ----------
    session : Session or path
        Raw frames with their metadata.
    mapping : {"eq3", "exact"}
        How pixels become directions: Ward's eq. (3), as the paper does, or the law of reflection
        on the dome's shape. Both start from the calibrated pupil, image centre and camera azimuth
        where the session has them.
    geometry : path, optional
        File of a geometry by `gonio calibrate alignment`; it replaces what the session states.
    dome : DomeMap or path, optional
        Map of the dome by `gonio calibrate dome`, made of other sessions on the rig: it corrects
        directions, and its uncertainty replaces that of the dome's slope errors.
    retro : bool
        Keep the pixels that look through the patch of the dome where the lamp's beam enters, as
        samples of their own with the flag `FLAG_ENTRY`. Their light returns to the lamp; the
        lamp's stray light costs them shot noise and, where the lamp drifts, an error of the
        image. The other samples do not depend on it.
    force : bool
        Continue if the frames have errors; the history then lists them.
    threads : int, optional
        Number of worker threads; the result does not depend on it.
    progress : callable, optional
        Called with (images done, images in all).

    Returns
    -------
    BRDFSamples
        Adaptive cells with their members, in the frame of the sample.

    Raises
    ------
    ConfigurationError
        For an unknown mapping, an impossible lens or pupil, a geometry of another instrument,
        or a session of a mirror.
    DataError
        If frames are missing, damaged or wrong (`faults`), or no pixel is usable.

    Notes
    -----
    Each pixel is linearised and merged over its exposures, turned into a BRDF by Ward's eq. (2),
    placed by eq. (3) or exactly, masked (saturated, outside the image circle, beyond the usable
    rim, in the lamp's entry patch) and averaged with its neighbours in equal-area cells. A cell's
    members span the pixels' areas and the lamp's cone of half-angle a: for a lobe about the half
    vector the cone acts as a blur of the viewing direction of standard deviation a/2 on each axis.

    Examples
    --------
    >>> import gonio, tempfile
    >>> instrument = gonio.instrument.preset("ideal12").with_pixels(52)
    >>> plan = gonio.metadata.Plan(
    ...     theta_i_deg=(20,), rotations_deg=(0,), exposures_s=instrument.sensor.exposures_s
    ... )
    >>> session = gonio.simulate("white_ceramic_tile", output=tempfile.mkdtemp() + "/tile.gonio",
    ...                          instrument=instrument, plan=plan)
    >>> samples = reduce(session)
    >>> samples.u_independent is not None
    True
    """
    if not isinstance(session, Session):
        session = Session.open(session)
    session.require_complete()
    metadata, pixel_map, held = _located(session.metadata, mapping, geometry)
    chart = dome if dome is None or isinstance(dome, DomeMap) else DomeMap.load(dome)
    if chart is not None:
        chart.check(
            rig=metadata.rig, shape=metadata.geometry.shape, mapping=mapping,
            session=session.sha256,
        )  # fmt: skip
    table = PixelTable.of(metadata, pixel_map, chart)

    work = partial(cells_of_session, table, retro=retro, threads=threads, progress=progress)
    images, findings = inspected(session, metadata, table.theta_r, table.phi_r, work, force=force)
    samples = samples_of(metadata, pixel_map, effects.corrected(metadata, images), chart)
    lines = [finding.line for finding in findings]
    if held:
        undetermined = ", ".join(held)
        lines.insert(
            0, f"geometry: {undetermined} not determined by the alignment, as stated before"
        )
    known: dict[str, Any] = {}
    if chart is not None:
        share = 100 * float(np.mean(chart.known < LEARNT))
        lines.insert(
            0, f"slope errors of the dome: corrected by a map of {len(chart.sessions)} other "
            f"session(s), which knows {share:.0f} % of the dome"
        )  # fmt: skip
        known["dome_map"] = {"rig": chart.rig, "sessions": list(chart.sessions)}
    return replace(
        samples,
        history=(*samples.history, *lines),
        metadata={
            **samples.metadata,
            "session": str(session.path),
            "session_sha256": session.sha256,
            **known,
            "findings": [asdict(finding) for finding in findings],
        },
    )


def _located(
    metadata: Metadata, mapping: Mapping, geometry: str | Path | None
) -> tuple[Metadata, PixelMap, tuple[str, ...]]:
    """Metadata and mapping with the calibrated geometry, and the quantities left open."""
    if metadata.plan.mode == "mirror":
        raise ConfigurationError(
            "a session of a mirror has no BRDF; it is for 'gonio calibrate alignment'.",
            value=metadata.plan.mode,
        )
    if geometry is None:
        return metadata, PixelMap.of(metadata, mapping), ()
    calibrated = geometry_file.read(geometry)
    metadata = calibrated.applied(metadata)
    return metadata, PixelMap.of(metadata, mapping, calibrated.uncertain), calibrated.held
