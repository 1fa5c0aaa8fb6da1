"""Metadata of a session, from the description of a rig and the size of its frames."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from gonio._version import __version__
from gonio.certificate import Certificate
from gonio.errors import ConfigurationError, DataError
from gonio.metadata import SCHEMA, Camera, LensCalibration, Metadata, Uncertain
from gonio.rig.headers import Header
from gonio.rig.pictures import Sampling
from gonio.rig.raw import RawHeader
from gonio.rig.session_file import RigFile, sentence
from gonio.rig.standards import tabulated
from gonio.rig.tables import HOW_TO_MEASURE, CameraTable

MAX_COUNT = 65535


@dataclass(frozen=True)
class Described:
    """A session's metadata with how they came about.

    Parameters
    ----------
    metadata : Metadata
    done : tuple of str
        What was derived from the description, in sentences.
    """

    metadata: Metadata
    done: tuple[str, ...]


def describe(rig: RigFile, header: Header, sampling: Sampling, name: str) -> Described:
    """Metadata of a session of frames with this header.

    Parameters
    ----------
    rig : RigFile
    header : Header
        Of all frames.
    sampling : Sampling
    name : str
        A frame's file, for messages.

    Raises
    ------
    ConfigurationError
        If a value is missing, or sums of counts do not fit into 16 bits.
    DataError
        If the lens was calibrated with frames of another size.
    """
    table = rig.table
    done = [_of_frames(header, sampling, rig)]
    camera = _complete(rig, header, sampling, done)
    certificate = _certificate(rig, done)
    content = Metadata(
        schema=SCHEMA,
        instrument=table.instrument.name,
        sample=table.instrument.sample,
        geometry=table.geometry,
        lens=_lens(rig, sampling, name, done),
        camera=_camera(camera, sampling, rig),
        standard=certificate,
        lamp=table.lamp,
        limits=table.limits,
        plan=table.plan,
        rig=table.instrument.name,
    )
    metadata = content.model_copy(update={"fingerprint": _fingerprint(content, rig, sampling)})
    return Described(metadata, tuple(done))


def _fingerprint(metadata: Metadata, rig: RigFile, sampling: Sampling) -> str:
    """Hash of all that determines the frames, except the files themselves."""
    frames = rig.table.frames
    recipe = {
        "version": __version__,
        "metadata": metadata.model_dump(mode="json"),
        "sampling": [sampling.cell, sampling.positions, sampling.region, sampling.binning],
        "counts": [frames.divide_by, frames.counts_per_unit],
    }
    return hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()


def _of_frames(header: Header, sampling: Sampling, rig: RigFile) -> str:
    rows, columns = sampling.shape
    text = f"{header.kind} frames of {header.columns} x {header.rows} pixels, {header.depth}"
    if isinstance(header, RawHeader) and header.pattern:
        plane = rig.table.frames.plane
        summed = "the sum of both greens" if plane == "green" else "one pixel"
        text += f"; {plane} of the filters {header.pattern}, {summed} of every 2 x 2"
    if rig.table.frames.region_px:
        x, y, width, height = sampling.region
        text += f"; region of {width} x {height} from column {x}, row {y}"
    if sampling.binning > 1:
        text += f"; {sampling.binning} x {sampling.binning} pixels summed"
    if rig.table.frames.divide_by > 1:
        text += f"; counts divided by {rig.table.frames.divide_by}"
    if header.is_float:
        text += f"; 1.0 is {rig.table.frames.counts_per_unit:g} counts"
    return text + (f": {columns} x {rows} in the session" if sampling.step > 1 else "")


def _complete(rig: RigFile, header: Header, sampling: Sampling, done: list[str]) -> CameraTable:
    """The camera with black level and saturation, which raw files may state themselves."""
    camera = rig.table.camera
    from_raw: dict[str, float | int] = {}
    if isinstance(header, RawHeader):
        from_raw = {"black_dn": header.black_of(sampling.positions), "saturation_dn": header.white}
    taken: dict[str, float | int] = {}
    for key in ("black_dn", "saturation_dn"):
        if getattr(camera, key) is None:
            if key not in from_raw:
                meaning = (CameraTable.model_fields[key].description or "").partition(";")[0]
                raise ConfigurationError(
                    f"{rig.path}: camera.{key} is missing ({meaning}); "
                    f"{HOW_TO_MEASURE[f'camera.{key}']}.",
                    value=key,
                )
            taken[key] = from_raw[key]
    if taken:
        settings = " and ".join(f"{key} = {value:g}" for key, value in taken.items())
        done.append(f"camera: {settings}, as the raw files say")
    if camera.gamma != 1 and sampling.n_summed > 1:
        raise ConfigurationError(
            f"{rig.path}: with camera.gamma = {camera.gamma:g} counts are not in proportion to the "
            "light and their sums mean nothing; leave frames.binning at 1, and read one plane of "
            "raw files.",
            value=camera.gamma,
        )
    saturation = int(taken.get("saturation_dn", camera.saturation_dn or 0))
    largest = ((1 << header.bits) - 1) // rig.table.frames.divide_by
    if not header.is_float and saturation > largest:
        raise ConfigurationError(
            f"{rig.path}: camera.saturation_dn = {saturation}, and the frames hold {header.bits} "
            f"bits, {largest} counts at most; correct it, with black_dn and gain_dn_per_e, or "
            "write the frames with all bits of the camera.",
            value=saturation,
        )
    try:
        return CameraTable.model_validate(camera.model_dump() | taken)
    except ValidationError as error:
        raise ConfigurationError(f"{rig.path}: camera: {sentence(error)}", value=taken) from None


def _camera(camera: CameraTable, sampling: Sampling, rig: RigFile) -> Camera:
    """The camera of the session's pixels: sums of n pixels of the files."""
    n = sampling.n_summed
    assert camera.black_dn is not None
    assert camera.saturation_dn is not None
    if n * camera.saturation_dn > MAX_COUNT:
        raise ConfigurationError(
            f"{rig.path}: sums of {n} pixels of up to {camera.saturation_dn} counts do not fit "
            f"into 16 bits ({n * camera.saturation_dn} > {MAX_COUNT}); choose a smaller "
            "frames.binning, or one plane in place of green.",
            value=n,
        )
    rows, columns = sampling.shape
    pitch_x, pitch_y = (p * 1e-3 * sampling.step for p in camera.pitch_um)
    # Each count that is summed was rounded by itself; the reduction adds one rounding of its own.
    variance = n * (camera.gain_dn_per_e * camera.read_noise_e) ** 2 + (n - 1) / 12
    return Camera(
        rows=rows,
        columns=columns,
        pitch_mm=(pitch_x, pitch_y),
        gain_dn_per_e=camera.gain_dn_per_e,
        black_dn=n * camera.black_dn,
        saturation_dn=n * camera.saturation_dn,
        full_well_e=n * camera.full_well_e,
        noise_dn=float(np.sqrt(variance)),
        dark_e_per_s=n * camera.dark_e_per_s,
        gamma=camera.gamma,
        nonlinearity_per_decade=camera.nonlinearity_per_decade,
        u_nonlinearity_per_decade=camera.u_nonlinearity_per_decade,
    )


def _lens(rig: RigFile, sampling: Sampling, name: str, done: list[str]) -> LensCalibration:
    """The lens with its centre in pixels of the session."""
    lens, file = rig.table.lens, rig.lens_file
    if file is not None:
        done.append(f"lens: as {file.name} says")
        given = (file.rows, file.columns)
        if given == sampling.shape and given != (sampling.rows, sampling.columns):
            return lens
        if given != (sampling.rows, sampling.columns):
            rows, columns = sampling.shape
            also = f" ({columns} x {rows} in the session)" if sampling.step > 1 else ""
            raise DataError(
                f"{rig.path}: the lens of {file.name} was calibrated with frames of "
                f"{file.columns} x {file.rows} pixels, and {name} has {sampling.columns} x "
                f"{sampling.rows}{also}; calibrate with frames of the same window, or give "
                "'gonio calibrate lens' the right --frame-binning.",
                value=given,
            )
    whole = (0, 0, sampling.columns // sampling.cell, sampling.rows // sampling.cell)
    centre = lens.centre_px
    if centre is None:
        if sampling.region == whole:
            return lens
        centre = (sampling.columns - 1) / 2, (sampling.rows - 1) / 2
    return lens.model_copy(
        update={
            "centre_px": sampling.moved(centre),
            "uncertain": _in_session_pixels(lens.uncertain, sampling.step),
        }
    )


def _in_session_pixels(uncertain: Uncertain | None, step: int) -> Uncertain | None:
    """The covariance with the centre in pixels that are `step` of the file's."""
    if uncertain is None or step == 1:
        return uncertain
    unit = np.array([1 / step if name.startswith("centre_") else 1.0 for name in uncertain.names])
    covariance = np.array(uncertain.covariance) * np.outer(unit, unit)
    return Uncertain(
        names=uncertain.names, covariance=tuple(tuple(row) for row in covariance.tolist())
    )


def _certificate(rig: RigFile, done: list[str]) -> Certificate:
    standard, plan = rig.table.standard, rig.table.plan
    reflectance, table = standard.reflectance, standard.table
    if standard.model is not None:
        incidences = plan.incidences("standard")
        reflectance, table, error = tabulated(
            standard.model, standard.parameters, tuple(abs(angle) for angle in incidences)
        )
        values = ", ".join(f"{name} = {value:g}" for name, value in standard.parameters.items())
        done.append(
            f"standard: f of {standard.model} ({values}), tabulated within {max(error, 1e-8):.1g} "
            f"of its value; reflectance {reflectance:.4f} at 8 deg"
        )
    if reflectance is None and standard.brdf is None:
        raise ConfigurationError(
            f"{rig.path}: standard.reflectance is missing; "
            f"{HOW_TO_MEASURE['standard.reflectance']}, or give a model of it.",
            value="reflectance",
        )
    try:
        return Certificate(
            kind=standard.kind,
            reflectance=reflectance,
            uncertainty=standard.uncertainty,
            rolloff=standard.rolloff,
            reciprocal=standard.reciprocal,
            rolloff_uncertainty=standard.rolloff_uncertainty,
            u_shape=standard.u_shape,
            table=table,
            brdf=standard.brdf,
        )
    except ValidationError as error:
        raise ConfigurationError(
            f"{rig.path}: standard: {sentence(error)}", value="standard"
        ) from None
