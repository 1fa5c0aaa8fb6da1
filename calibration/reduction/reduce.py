"""Raw frames to BRDF samples: merge, eq. (2), eq. (3) or the exact mirror, mask, thin."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.calibration import effects
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.effects.base import Measured
from gonio.calibration.faults import session as faults
from gonio.calibration.faults.evidence import Evidence, Finding
from gonio.calibration.frames import standard
from gonio.calibration.frames.exposure import Rate, average, merge
from gonio.calibration.image_cells import ImageCells
from gonio.calibration.reduction import cells
from gonio.calibration.reflector import Mapping
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import Directions, FloatArray, angles, equal_area, rotated
from gonio.kernels.threads import default_threads
from gonio.metadata import Metadata, Plan
from gonio.samples import FLAG_ENTRY, FLAG_PARTIAL, BRDFSamples, Cells
from gonio.session import Session

Progress = Callable[[int, int], None]


def reduce(
    session: Session | str | Path,
    *,
    mapping: Mapping = "eq3",
    geometry: str | Path | None = None,
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
        File of a geometry by `gonio calibrate alignment`, in place of what the session states.
    retro : bool
        Keep the pixels that look through the patch of the dome where the lamp's beam enters, as
        samples of their own with the flag `FLAG_ENTRY`. Their light returns to the lamp; the
        lamp's stray light costs them shot noise and, where the lamp drifts, an error of the
        image. The other samples do not depend on it.
    force : bool
        Go on where the frames are found to be wrong; what is wrong then stands in the history.
    threads : int, optional
        Images are reduced in so many threads; the result does not depend on it.
    progress : callable, optional
        Called with (images done, images in all).

    Returns
    -------
    BRDFSamples
        Adaptive cells with their members, in the frame of the sample.

    Raises
    ------
    ConfigurationError
        For an unknown mapping, a lens or pupil that cannot be, a geometry of another instrument,
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
    """
    if not isinstance(session, Session):
        session = Session.open(session)
    session.require_complete()
    metadata, seen, held = _located(session.metadata, mapping, geometry)
    table = _pixel_table(metadata, seen)
    plan = metadata.plan
    channels, incidences = range(len(plan.channels)), range(len(plan.theta_i_deg))
    n_images = len(channels) * len(incidences) * len(plan.rotations_deg)
    evidence = [Evidence(metadata, table.theta_r, table.phi_r) for _ in channels]
    tasks = [(channel, incidence) for channel in channels for incidence in incidences]
    parts: list[ImageCells] = []
    with ThreadPoolExecutor(threads or default_threads()) as pool:
        work = pool.map(
            lambda task: list(
                _reduce_incidence(session, table, evidence[task[0]], task[0], task[1], retro)
            ),
            tasks,
        )
        for done in work:
            parts.extend(done)
            if progress is not None:
                progress(sum(not part.entry for part in parts), n_images)
    found = _findings(plan, evidence)
    if not force:
        _stop_at_errors(session, found)
    samples = _collect(metadata, seen, effects.corrected(metadata, parts))
    if held:
        line = f"geometry: {', '.join(held)} not determined by the alignment, as stated before"
        samples = replace(samples, history=(*samples.history, line))
    return replace(
        samples,
        history=(*samples.history, *(f"{finding.severity}: {finding.text}" for finding in found)),
        metadata={
            **samples.metadata,
            "session": str(session.path),
            "findings": [asdict(finding) for finding in found],
        },
    )


def _findings(plan: Plan, evidence: list[Evidence]) -> tuple[Finding, ...]:
    """What is wrong with the frames, channel by channel, errors first."""
    found: list[Finding] = []
    for channel, seen in zip(plan.channels, evidence, strict=True):
        own = faults.findings(seen)
        if len(evidence) > 1:
            own = tuple(replace(f, text=f"channel {channel.name}: {f.text}") for f in own)
        found += own
    return tuple(sorted(found, key=lambda finding: finding.severity != "error"))


def _stop_at_errors(session: Session, found: tuple[Finding, ...]) -> None:
    errors = [finding for finding in found if finding.severity == "error"]
    if errors:
        more = f" ({len(errors) - 1} more such findings.)" if len(errors) > 1 else ""
        raise DataError(f"{session.path}: {errors[0].text}{more}", value=errors)


def _located(
    metadata: Metadata, mapping: Mapping, geometry: str | Path | None
) -> tuple[Metadata, PixelMap, tuple[str, ...]]:
    """Metadata and mapping with a calibrated geometry in place, and what that left open."""
    if metadata.plan.mode == "mirror":
        raise ConfigurationError(
            "a session of a mirror has no BRDF; it is for 'gonio calibrate alignment'.",
            value=metadata.plan.mode,
        )
    if geometry is None:
        return metadata, PixelMap.of(metadata, mapping), ()
    from gonio.calibration.dome import geometry_file

    calibrated = geometry_file.read(geometry)
    metadata = calibrated.applied(metadata)
    return metadata, PixelMap.of(metadata, mapping, calibrated.uncertain), calibrated.held


@dataclass(frozen=True)
class _PixelTable:
    """Pixels of the usable hemisphere in Morton order, laboratory frame."""

    index: NDArray[np.int64]  # flat index in the frame
    keys: NDArray[np.int64]
    at: FloatArray  # (n, 2) column and row
    w_r: FloatArray  # (n, 3) centres
    points: FloatArray  # (n, 4, 3) Gauss points of each pixel's area
    solid_angle: FloatArray  # (n,) sr on the side of the sample
    theta_r: FloatArray  # (rows, columns), NaN outside the image circle
    phi_r: FloatArray


def _pixel_table(metadata: Metadata, seen: PixelMap) -> _PixelTable:
    camera, geometry = metadata.camera, metadata.geometry
    columns, rows = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    w_r = seen.directions(columns, rows)
    theta_r, phi_r = angles(w_r)
    index = np.flatnonzero(theta_r <= np.radians(geometry.usable_theta_r_deg))
    if len(index) == 0:
        raise DataError(
            f"no pixel lies inside theta_r <= {geometry.usable_theta_r_deg:g} deg; "
            "check the lens calibration and the pixel pitch in session.json."
        )
    x, y = equal_area(w_r.reshape(-1, 3)[index])
    keys = cells.morton_keys(x, y)
    order = np.argsort(keys, kind="stable")
    index = index[order]
    columns, rows = columns.ravel()[index], rows.ravel()[index]
    # Gauss-Legendre points of order 2 in each direction integrate over the pixel's area.
    half = 0.5 / np.sqrt(3)
    points = np.stack(
        [seen.directions(columns + dx, rows + dy) for dx in (-half, half) for dy in (-half, half)],
        axis=1,
    )
    return _PixelTable(
        index=index,
        keys=keys[order],
        at=np.stack([columns, rows], axis=1).astype(float),
        w_r=np.ascontiguousarray(w_r.reshape(-1, 3)[index]),
        points=np.ascontiguousarray(points),
        solid_angle=seen.solid_angles(columns, rows),
        theta_r=theta_r,
        phi_r=phi_r,
    )


def _reduce_incidence(
    session: Session,
    table: _PixelTable,
    evidence: Evidence,
    channel: int,
    incidence: int,
    retro: bool,
) -> Iterator[ImageCells]:
    """All rotations of one incidence in one channel, which share background and standard."""
    metadata = session.metadata
    plan, camera = metadata.plan, metadata.camera

    def taken(role: str, take: int, at: int) -> Rate:
        bracket = session.bracket(role, take, at, channel=channel)
        rate = merge(bracket, plan.exposures_s, camera)
        evidence.see(role, take, at, bracket, rate)
        return rate

    def averaged(role: str, at: int) -> Rate:
        return average([taken(role, k, at) for k in range(plan.repeats)])

    theta_i = float(np.radians(plan.theta_i_deg[incidence]))
    # Where the standard was taken once, the last of the backgrounds is its own.
    at_one = plan.standard_theta_i_deg
    alone = at_one is not None
    theta_std = theta_i if at_one is None else float(np.radians(at_one))
    ref = standard.reference(
        averaged("background", incidence),
        averaged("standard", 0 if alone else incidence),
        standard.standard_brdf(metadata.standard, theta_std, table.theta_r, table.phi_r),
        dark_e_per_s=camera.dark_e_per_s,
        irradiance=standard.irradiance_ratio(metadata, theta_i),
        standard_background=averaged("background", len(plan.theta_i_deg)) if alone else None,
    )
    evidence.see_reference(incidence, ref)
    for rotation in range(len(plan.rotations_deg)):
        measured = taken("sample", rotation, incidence)
        for entry in (False, True) if retro else (False,):
            yield _reduce_image(
                metadata, table, ref, measured, channel, incidence, rotation, entry=entry
            )


def _reduce_image(
    metadata: Metadata,
    table: _PixelTable,
    ref: standard.Reference,
    measured: Rate,
    channel: int,
    incidence: int,
    rotation: int,
    *,
    entry: bool,
) -> ImageCells:
    """Cells of one image, outside the lamp's entry patch or inside it."""
    f = standard.brdf(measured, ref)
    # Splits and weights follow a median-filtered guide, not the noise that is averaged.
    guide = cells.median(f)
    own, shared = standard.variances(measured, ref, guide)
    wanted = ref.entry if entry else ref.usable
    good = wanted & ~measured.saturated & (measured.time > 0)
    safe_time = np.where(good, measured.time, 1.0)
    # sum of counts over sum of (time x standard): optimal for shot noise and free of it.
    weight = np.where(good, safe_time / np.where(good, ref.f_per_rate, 1.0), 0.0)
    slope = ref.f_per_rate / safe_time
    at = table.index
    weight_s, guide_s = weight.ravel()[at], guide.ravel()[at]
    columns = np.stack([image.ravel()[at] for image in (f, own, shared, slope, slope * guide)])
    total_variance = np.maximum(columns[1] + columns[2], 1e-300)
    first, last = cells.split(table.keys, guide_s, total_variance, weight_s)
    means, centroid, solid_angle, partial = cells.gather(
        first, last, weight_s, columns, table.w_r, table.solid_angle
    )
    means = _at_own_value(means)
    # A uniform disc of half-angle a has the standard deviation a/2 on each axis.
    cone = float(np.radians(metadata.lamp.half_angle_deg or 0.0)) / 2
    w_m, share, offsets = cells.members(first, last, weight_s, table.points, centroid, cone)
    psi = np.radians(metadata.plan.rotations_deg[rotation])
    return ImageCells(
        theta_i=float(np.radians(metadata.plan.theta_i_deg[incidence])),
        psi=float(psi),
        incidence=incidence,
        rotation=rotation,
        means=means,
        centroid=rotated(centroid, psi),
        at=cells.mean_of(first, last, weight_s, table.at),
        stray=cells.mean_of(
            first,
            last,
            weight_s,
            np.stack([image.ravel()[at] for image in (ref.stray, ref.standard_stray)], axis=1),
        ),
        solid_angle=solid_angle,
        partial=partial,
        members=Cells(rotated(w_m, psi), share, offsets),
        n_used=int(np.count_nonzero(weight_s > 0)),
        n_saturated=int(np.count_nonzero((wanted & measured.saturated).ravel()[at])),
        n_reference=0 if entry else int(np.count_nonzero(~ref.usable.ravel()[at])),
        entry=entry,
        channel=channel,
    )


def _at_own_value(means: FloatArray) -> FloatArray:
    """Variances of the cells at their own value instead of at the guide.

    The fit moves them from there to the model's value; what is left of the guide's own noise
    would otherwise bias it by a part in 10^5.
    """
    value, own, shared, slope, slope_times_guide = means
    value = np.maximum(value, 0.0)
    guide = slope_times_guide / slope
    own = np.maximum(own + slope * (value - guide), 0.1 * own)
    ratio = value / np.where(guide > 0, guide, 1.0)
    return np.stack([means[0], own, shared * np.clip(ratio, 0.7, 1.4) ** 2, slope])


def _collect(metadata: Metadata, seen: PixelMap, parts: list[ImageCells]) -> BRDFSamples:
    """Put the images' cells together, with the errors they share."""
    parts = [part for part in parts if part.means.shape[1]]
    if not parts:
        raise DataError(
            "no pixel of the session is usable: every one is saturated, too dark or masked."
        )
    counts = [part.means.shape[1] for part in parts]
    rotations = len(metadata.plan.rotations_deg)
    # Every channel has frames of its own, and so a lamp that drifts by itself.
    steps = len(metadata.plan.theta_i_deg)
    step = [part.channel * steps + part.incidence for part in parts]
    image = np.repeat(
        [k * rotations + part.rotation for k, part in zip(step, parts, strict=True)], counts
    )
    incidence = np.repeat(step, counts)
    channels = metadata.plan.channels
    names = np.repeat([channels[part.channel].name for part in parts], counts)
    wavelengths = [channels[part.channel].wavelength_nm for part in parts]
    known = [w for w in wavelengths if w is not None]
    theta_r, phi_r = angles(np.concatenate([part.centroid for part in parts]))
    value, own, shared, slope = np.concatenate([part.means for part in parts], axis=1)
    ends = np.cumsum([0] + [len(part.members.weight) for part in parts])
    offsets = [part.members.offsets[1:] + end for part, end in zip(parts, ends, strict=False)]
    partial = np.concatenate([part.partial for part in parts])
    entry = np.repeat([part.entry for part in parts], counts)
    alone = metadata.plan.standard_theta_i_deg is not None
    return BRDFSamples(
        directions=Directions(
            np.repeat([part.theta_i for part in parts], counts),
            np.repeat([-part.psi for part in parts], counts),
            theta_r,
            phi_r,
        ),
        value=value,
        u_independent=np.sqrt(own + shared),
        noise_slope=slope,
        u_reference=np.sqrt(shared),
        # Where the standard was taken once every image uses it; that each has a background of its
        # own is left out, which errs on the safe side.
        reference_sharing=len(metadata.plan.theta_i_deg) * rotations if alone else rotations,
        shared=effects.shared_terms(Measured(metadata, seen, parts, image, incidence)),
        solid_angle=np.concatenate([part.solid_angle for part in parts]),
        flags=(partial * FLAG_PARTIAL + entry * FLAG_ENTRY).astype(np.uint8),
        image=image,
        channel=names if len(channels) > 1 or names[0] else None,
        wavelength_nm=(
            np.repeat(known, counts) if wavelengths and len(known) == len(wavelengths) else None
        ),
        cells=Cells(
            np.concatenate([part.members.w_r for part in parts]),
            np.concatenate([part.members.weight for part in parts]),
            np.concatenate([[0], *offsets]).astype(np.int64),
        ),
        history=_history(metadata, seen, parts, sum(counts)),
        metadata={
            "instrument": metadata.instrument,
            "sample": metadata.sample,
            "unknown": list(effects.unknown(metadata, seen)),
        },
        quantity="BTDF" if metadata.plan.mode == "transmission" else "BRDF",
    )


def _history(
    metadata: Metadata, seen: PixelMap, parts: list[ImageCells], n: int
) -> tuple[str, ...]:
    geometry = metadata.geometry
    retro = sum(part.n_used for part in parts if part.entry)
    masked = {
        "saturated": sum(part.n_saturated for part in parts),
        "entry patch or dark standard": sum(part.n_reference for part in parts) - retro,
    }
    used = sum(part.n_used for part in parts)
    images = {(part.channel, part.incidence, part.rotation) for part in parts}
    return (
        f"{metadata.instrument}: {metadata.sample}, {len(images)} images of "
        f"{len(metadata.plan.exposures_s)} exposures merged",
        standard.describe(metadata),
        seen.describe(),
        f"masked: theta_r > {geometry.usable_theta_r_deg:g} deg; "
        + "; ".join(f"{k} {v} pixels" for k, v in masked.items()),
        f"{used} pixels in {n} equal-area cells",
        *([f"retro: {retro} of them in the lamp's entry patch, flagged"] if retro else []),
        *effects.notes(metadata, seen),
    )
