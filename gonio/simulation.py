"""Material + instrument + plan + seed -> session: the raw frames that the instrument records."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gonio import __version__
from gonio.errors import ConfigurationError
from gonio.files import write_text
from gonio.geometry import FloatArray, rotated
from gonio.instrument import Instrument, load
from gonio.materials import get as get_material
from gonio.metadata import (
    Camera,
    Certificate,
    Geometry,
    LampRecord,
    LensCalibration,
    Limits,
    Metadata,
    Plan,
)
from gonio.models import Model
from gonio.models import get as get_model
from gonio.session import Session

N_INCIDENCES = 21  # as the paper: "measured at 21 incident angles" (Ward 1992, section 4.2)
ANISOTROPIC_ROTATIONS_DEG = (0.0, 45.0, 90.0)

_MAX_PENDING = 12  # frames that wait for the disk while the next image is computed

Progress = Callable[[int, int], None]


def default_plan(instrument: Instrument, *, anisotropic: bool) -> Plan:
    """21 incidence angles from 0 to the arm's reach; three rotations where phi_i matters."""
    angles = np.linspace(0, instrument.theta_i_max_deg, N_INCIDENCES)
    return Plan(
        theta_i_deg=tuple(float(a) for a in angles),
        rotations_deg=ANISOTROPIC_ROTATIONS_DEG if anisotropic else (0.0,),
        exposures_s=instrument.sensor.exposures_s,
    )


def is_anisotropic(model: Model, parameters: Mapping[str, float]) -> bool:
    """Whether turning the surface about its normal changes what it reflects.

    Not where the model claims so, nor where alpha_x = alpha_y.

    Parameters
    ----------
    model : Model
    parameters : mapping
        All of its parameters.

    Examples
    --------
    >>> is_anisotropic(get_model("ward"), {"alpha_x": 0.1, "alpha_y": 0.1})
    False
    """
    alike = "alpha_x" in parameters and parameters["alpha_x"] == parameters.get("alpha_y")
    return not (model.claims.isotropic or alike)


def simulate(
    material: str | None = None,
    *,
    output: str | Path,
    model: str | None = None,
    parameters: Mapping[str, float] | None = None,
    instrument: str | Instrument = "modern12",
    plan: Plan | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Session:
    """Record the raw frames of a surface on a virtual instrument.

    Parameters
    ----------
    material : str, optional
        A named material; or give `model` and `parameters`.
    output : path
        Folder of the session. Where the same call was interrupted it continues: frames that were
        acknowledged are kept, and the result is bit-identical to an uninterrupted run.
    model, parameters : str, mapping, optional
        A model by name and its parameters (radians for angles).
    instrument : str or Instrument
        A preset, a TOML file, or an instrument.
    plan : Plan, optional
        Angles, rotations, exposures, repeats; `default_plan` where not given.
    seed : int
        Everything random follows from it: 0 <= seed < 2**63.
    threads : int, optional
        The frames do not depend on it.
    progress : callable, optional
        Called with (frames done, frames in all).

    Returns
    -------
    Session

    Raises
    ------
    ConfigurationError
        For unknown names, parameters out of range, or another session at `output`.
    DataError
        If the disk refuses to take the frames.
    """
    if not 0 <= seed < 2**63:
        raise ConfigurationError(f"seed = {seed} is out of range; allowed is 0 to 2^63 - 1.")
    surface = _surface(material, model, parameters)
    rig = load(instrument) if isinstance(instrument, str) else instrument
    named = dict(zip(surface.model.names, surface.p.tolist(), strict=True))
    plan = plan or default_plan(rig, anisotropic=is_anisotropic(surface.model, named))
    recipe = {
        "version": __version__,
        "model": surface.model.name,
        "parameters": named,
        "instrument": rig.model_dump(mode="json"),
        "plan": plan.model_dump(mode="json"),
        "seed": seed,
    }
    fingerprint = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    session = Session.create(output, _metadata(rig, plan, surface.name, fingerprint))
    _write_truth(session.path, recipe, surface, rig, plan, seed)
    if not session.complete:
        _record(session, surface, rig, plan, seed, threads, progress)
    return session


@dataclass(frozen=True)
class _Surface:
    name: str
    model: Model
    p: FloatArray


def _surface(
    material: str | None, model: str | None, parameters: Mapping[str, float] | None
) -> _Surface:
    if (material is None) == (model is None):
        raise ConfigurationError("give either a material or a model with its parameters.")
    if material is not None:
        if parameters:
            raise ConfigurationError(
                f"material {material!r} has its own parameters; give a model to choose them."
            )
        found = get_material(material)
        chosen = get_model(found.model)
        return _Surface(found.name, chosen, chosen.vector(found.parameters))
    assert model is not None
    chosen = get_model(model)
    return _Surface(chosen.name, chosen, chosen.vector(parameters or {}))


def _metadata(rig: Instrument, plan: Plan, sample: str, fingerprint: str) -> Metadata:
    """What the operator of a real rig would know, and nothing else."""
    sensor, standard = rig.sensor, rig.standard
    rows, columns = sensor.shape
    pitch_x, pitch_y = (p * 1e-3 * sensor.binning for p in sensor.pitch_um)
    return Metadata(
        schema="gonio.session/1",
        instrument=rig.name,
        sample=sample,
        geometry=Geometry(
            shape=rig.dome.shape,
            R=rig.dome.R,
            D=rig.dome.D,
            usable_theta_r_deg=rig.usable_theta_r_deg,
        ),
        lens=LensCalibration(
            projection=rig.lens.projection,
            focal_length_mm=rig.lens.focal_length_mm,
            k=rig.lens.k,
            field_deg=rig.lens.field_deg,
        ),
        camera=Camera(
            rows=rows,
            columns=columns,
            pitch_mm=(pitch_x, pitch_y),
            gain_dn_per_e=sensor.gain_dn_per_e,
            black_dn=sensor.binned_black_dn,
            saturation_dn=sensor.saturation_dn,
            full_well_e=sensor.binned_full_well_e,
            noise_dn=sensor.binned_noise_dn,
            dark_e_per_s=sensor.dark_e_per_s * sensor.n_summed,
        ),
        standard=Certificate(
            reflectance=standard.reflectance,
            uncertainty=standard.uncertainty,
            rolloff=standard.rolloff if standard.rolloff_certified else 0.0,
            rolloff_uncertainty=standard.rolloff_uncertainty,
        ),
        lamp=LampRecord(half_angle_deg=rig.lamp.half_angle_deg, drift=rig.lamp.drift),
        limits=Limits(
            slope_error_deg=rig.dome.slope_error_deg,
            rim_slope_error_deg=rig.dome.rim_slope_error_deg,
            slope_correlation_deg=rig.dome.slope_correlation_deg,
            multibounce=rig.surroundings.multibounce,
        ),
        plan=plan,
        fingerprint=fingerprint,
    )


@dataclass(frozen=True)
class _Draws:
    """What chance decides once: the standard's error and the lamp's output for every image."""

    standard_scale: float
    lamp: FloatArray  # one factor an image, in the plan's order
    pattern_seed: int  # the camera's fixed pattern
    dome_seed: int  # the dome's slope errors
    noise_seed: int

    @classmethod
    def from_seed(cls, seed: int, rig: Instrument, n_images: int) -> _Draws:
        rng = np.random.default_rng(seed)
        seeds = rng.integers(0, 2**63, size=3)
        standard = 1 + rig.standard.uncertainty * rng.standard_normal()
        lamp = 1 + rig.lamp.drift * rng.standard_normal(n_images)
        return cls(float(standard), lamp, *(int(s) for s in seeds))


def _write_truth(
    path: Path,
    recipe: Mapping[str, Any],
    surface: _Surface,
    rig: Instrument,
    plan: Plan,
    seed: int,
) -> None:
    folder = path / "truth"
    folder.mkdir(exist_ok=True)
    images = list(plan.images())
    draws = _Draws.from_seed(seed, rig, len(images))
    truth = {
        "schema": "gonio.truth/1",
        "material": surface.name,
        **recipe,
        "standard_scale": draws.standard_scale,
        "lamp": draws.lamp.tolist(),
    }
    write_text(folder / "truth.json", json.dumps(truth, indent=1) + "\n")


def _record(
    session: Session,
    surface: _Surface,
    rig: Instrument,
    plan: Plan,
    seed: int,
    threads: int | None,
    progress: Progress | None,
) -> None:
    """Expose and write every frame that is not there yet, in the plan's order."""
    n = plan.n_frames
    sensor = rig.sensor
    writer = ThreadPoolExecutor(1)
    pending: deque[Future[None]] = deque()

    def finish_one() -> None:
        pending.popleft().result()
        if progress is not None:
            progress(session.n_done, n)

    try:
        for number, key, rate, draws in _images(session, surface, rig, plan, seed, threads):
            for k, time_s in enumerate(plan.exposures_s):
                if session.has(*key, k):
                    continue
                from gonio.instrument.noise import expose

                frame = expose(
                    rate,
                    time_s,
                    dark_e_per_s=sensor.dark_e_per_s * sensor.n_summed,
                    full_well_e=sensor.binned_full_well_e,
                    gain_dn_per_e=sensor.gain_dn_per_e,
                    noise_dn=sensor.binned_noise_dn,
                    black_dn=sensor.binned_black_dn,
                    saturation_dn=sensor.saturation_dn,
                    seed=draws.noise_seed,
                    frame=number * len(plan.exposures_s) + k,
                    threads=threads,
                )
                # Frames are written while later ones are exposed; the order stays the plan's.
                pending.append(writer.submit(session.write, *key, k, frame))
                if len(pending) > _MAX_PENDING:
                    finish_one()
        while pending:
            finish_one()
    finally:
        writer.shutdown(cancel_futures=True)


def _images(
    session: Session,
    surface: _Surface,
    rig: Instrument,
    plan: Plan,
    seed: int,
    threads: int | None,
) -> Iterator[tuple[int, tuple[str, int, int], FloatArray, _Draws]]:
    """Expected photo-electrons a second for every image that still lacks a frame."""
    from gonio.instrument import imaging

    images = list(plan.images())
    draws = _Draws.from_seed(seed, rig, len(images))
    rays = imaging.trace_rays(rig, draws.dome_seed, threads=threads)
    response = rig.sensor.response(draws.pattern_seed).ravel()
    white = imaging.white_rate(rig, rays)
    f_standard = imaging.standard_brdf(rig, rays)
    turned: tuple[float, FloatArray] = (0.0, rays.w_r)
    for number, (role, take, incidence) in enumerate(images):
        if all(session.has(role, take, incidence, k) for k in range(len(plan.exposures_s))):
            continue
        theta_i = np.radians(plan.theta_i_deg[incidence])
        signal = np.zeros(len(rays.pixel))
        if role != "background":
            lit = imaging.lit_weights(rig, rays, theta_i)
            if role == "standard":
                f = draws.standard_scale * np.einsum("ij,ij->i", lit, f_standard)
                rho = draws.standard_scale * rig.standard.reflectance
            else:
                psi = np.radians(plan.rotations_deg[take])
                if turned[0] != psi:
                    turned = (psi, imaging.in_sample_frame(rays, psi))
                w_i = rotated(rig.lamp.directions(theta_i, rays.source), psi)
                f = imaging.mean_brdf(
                    surface.model, surface.p, w_i, turned[1], lit, threads=threads
                )
                centre = w_i.mean(axis=0)
                rho = 0.0
                if rig.surroundings.multibounce:
                    rho = imaging.albedo(surface.model, surface.p, centre / np.linalg.norm(centre))
            gain = 1 + rig.surroundings.multibounce * rho
            signal = white * np.cos(theta_i) * np.pi * f * gain
        signal += imaging.stray_rate(rig, rays, theta_i)
        signal *= draws.lamp[number]
        signal += rig.surroundings.ambient * white
        rate = np.zeros(rig.sensor.shape)
        rate.ravel()[rays.pixel] = np.maximum(signal, 0.0)
        yield number, (role, take, incidence), (rate.ravel() * response).reshape(rate.shape), draws
