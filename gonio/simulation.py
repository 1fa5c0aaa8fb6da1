"""Material + instrument + plan + seed -> session: the raw frames that the instrument records."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio._version import __version__
from gonio.errors import ConfigurationError
from gonio.files import write_text
from gonio.geometry import FloatArray
from gonio.instrument import Instrument, load
from gonio.instrument.plans import Values, default_plan, is_anisotropic
from gonio.instrument.realisation import Realisation
from gonio.materials import get as get_material
from gonio.metadata import Plan, Role
from gonio.models import Model
from gonio.models import get as get_model
from gonio.plan_file import read_plan
from gonio.session import Session

if TYPE_CHECKING:
    from gonio.instrument.images import Images, Surface
    from gonio.instrument.truth import TruthImages

MIRROR = "mirror"  # name of the sample in a session for the alignment

_MAX_PENDING = 12  # frames that wait for the disk while the next image is computed

Progress = Callable[[int, int], None]


def simulate(
    material: str | None = None,
    *,
    output: str | Path,
    model: str | Model | None = None,
    parameters: Mapping[str, Values] | None = None,
    instrument: str | Instrument = "modern12",
    plan: Plan | str | Path | None = None,
    seed: int = 0,
    rig_seed: int | None = None,
    standard_seed: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    truth_images: bool | None = None,
) -> Session:
    """Record the raw frames of a surface on a virtual instrument.

    Parameters
    ----------
    material : str, optional
        A named material. Alternatives: `model` and `parameters`, or neither with a plan for a
        mirror.
    output : path
        Folder of the session. After an interruption the same call continues: acknowledged frames
        are kept, and the result is bit-identical to an uninterrupted run.
    model, parameters : str or Model, mapping, optional
        A model, or its name, and its parameters (radians for angles), one value or one for each
        channel of the instrument.
    instrument : str or Instrument
        A preset, a TOML file, or an instrument.
    plan : Plan or path, optional
        Angles, rotations, exposures, repeats, or a TOML file with a table [plan] such as
        `gonio design -o` writes; default: `default_plan`. See also `transmission_plan` and
        `mirror_plan`. Its channels are those of the instrument.
    seed : int
        Seed of the random numbers: 0 <= seed < 2**63.
    rig_seed : int, optional
        Seed of what belongs to the rig: the dome's slope errors and coating, the camera's fixed
        patterns, the multi-bounce and, without a seed of its own, the white standard. Sessions
        with one `rig_seed` and different seeds are sessions on one rig; `seed` then draws what
        each session has for itself: the lamp, the azimuth of the sample and the noise. By default
        `seed` draws all.
    standard_seed : int, optional
        Seed of the white standard's error.
    threads : int, optional
        Number of worker threads; the frames do not depend on it.
    progress : callable, optional
        Called with (frames done, total number of frames).
    truth_images : bool, optional
        Write the true values of each pixel to the folder `truth` of the session. Default: only if
        they take at most a fifth of the space of the frames.

    Returns
    -------
    Session

    Raises
    ------
    ConfigurationError
        For unknown names, parameters out of range, or another session at `output`.
    DataError
        If the frames cannot be written, or the file of a plan is missing.

    Examples
    --------
    >>> import tempfile
    >>> from gonio.instrument import preset
    >>> instrument = preset("ideal12").with_pixels(52)
    >>> plan = Plan(theta_i_deg=(0, 30), rotations_deg=(0,), exposures_s=(0.01, 0.1))
    >>> session = simulate("white_ceramic_tile", output=tempfile.mkdtemp() + "/tile.gonio",
    ...                    instrument=instrument, plan=plan)
    >>> session.complete, session.n_done
    (True, 12)
    """
    from gonio.instrument.records import metadata
    from gonio.instrument.truth import economical

    seeds = {"seed": seed, "rig_seed": rig_seed, "standard_seed": standard_seed}
    for name, number in seeds.items():
        if number is not None and not 0 <= number < 2**63:
            raise ConfigurationError(
                f"{name} = {number} is out of range; allowed is 0 to 2^63 - 1.", value=number
            )
    virtual = load(instrument) if isinstance(instrument, str) else instrument
    plan = read_plan(plan) if isinstance(plan, str | Path) else plan
    is_mirror = plan is not None and plan.mode == "mirror"
    surface = _mirror(virtual, material, model) if is_mirror else _surface(
        virtual, material, model, parameters
    )  # fmt: skip
    plan = _completed(virtual, plan, surface)
    recipe = _recipe(virtual, surface, plan, seeds)
    fingerprint = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    # An operator knows a rig by its number, which tells nothing of what was drawn.
    own = seed if rig_seed is None else rig_seed
    rig = f"{virtual.name} no. {hashlib.sha256(f'rig {own}'.encode()).hexdigest()[:8]}"
    session = Session.create(output, metadata(virtual, plan, surface.name, fingerprint, rig))
    realisation = Realisation.from_seeds(
        seed, virtual, plan, rig_seed=rig_seed, standard_seed=standard_seed
    )
    _write_truth(session.path, recipe, surface, virtual, plan, realisation)
    if not session.complete:
        wanted = economical(plan) if truth_images is None else truth_images
        _record(session, surface, virtual, plan, realisation, threads, progress, wanted)
    return session


def _completed(instrument: Instrument, plan: Plan | None, surface: Surface) -> Plan:
    """The plan, completed with properties of the instrument; `default_plan` if there is none."""
    from gonio.instrument.records import channels, irradiance_uncertainty

    if plan is None:
        assert surface.model is not None
        plan = default_plan(instrument, anisotropic=is_anisotropic(surface.model, _named(surface)))
    change: dict[str, Any] = {"channels": channels(instrument)}
    if plan.u_irradiance is None:
        change["u_irradiance"] = irradiance_uncertainty(instrument, plan)
    return plan.model_copy(update=change)


def _named(surface: Surface) -> dict[str, Values]:
    """Parameters by name: a number, or a list with one value per channel if they differ."""
    if surface.model is None:
        return {}
    columns = np.stack(surface.p, axis=1).tolist()
    return {
        name: values if len(set(values)) > 1 else values[0]
        for name, values in zip(surface.model.names, columns, strict=True)
    }


def _recipe(
    instrument: Instrument, surface: Surface, plan: Plan, seeds: Mapping[str, int | None]
) -> dict[str, Any]:
    """All inputs of a session; seeds that are not given leave it as it was without them."""
    return {
        "version": __version__,
        "model": surface.model.name if surface.model else MIRROR,
        "parameters": _named(surface),
        "instrument": instrument.model_dump(mode="json"),
        "plan": plan.model_dump(mode="json"),
        **{name: number for name, number in seeds.items() if number is not None},
    }


def _mirror(instrument: Instrument, material: str | None, model: str | Model | None) -> Surface:
    from gonio.instrument.images import Surface

    if material is not None or model is not None:
        raise ConfigurationError(
            "the plan is one for a mirror; give neither a material nor a model with it.",
            value=material or model,
        )
    return Surface(MIRROR, None, (np.empty(0),) * len(instrument.channels))


def _surface(
    instrument: Instrument,
    material: str | None,
    model: str | Model | None,
    parameters: Mapping[str, Values] | None,
) -> Surface:
    from gonio.instrument.images import Surface

    if (material is None) == (model is None):
        raise ConfigurationError("give either a material or a model with its parameters.")
    if material is not None:
        if parameters:
            raise ConfigurationError(
                f"material {material!r} has its own parameters; give a model to choose them."
            )
        entry = get_material(material)
        chosen = get_model(entry.model)
        return Surface(
            entry.name, chosen, (chosen.vector(entry.parameters),) * len(instrument.channels)
        )
    assert model is not None
    chosen = get_model(model)
    return Surface(chosen.name, chosen, parameter_vectors(instrument, chosen, parameters or {}))


def parameter_vectors(
    instrument: Instrument, model: Model, parameters: Mapping[str, Values]
) -> tuple[FloatArray, ...]:
    """A model's checked parameter vector for every channel of an instrument.

    Raises
    ------
    ConfigurationError
        If a parameter has neither one value nor one for each channel, or a value is not allowed.

    Examples
    --------
    >>> from gonio.instrument import preset
    >>> instrument = preset("ideal12")
    >>> [p.tolist() for p in parameter_vectors(instrument, get_model("lambert"), {"rho": 0.3})]
    [[0.3]]
    """
    n = len(instrument.channels)
    by_name: dict[str, FloatArray] = {}
    for name, values in parameters.items():
        model.parameter(name)
        given = np.atleast_1d(np.asarray(values, float))
        if given.shape not in ((1,), (n,)):
            raise ConfigurationError(
                f"{name} has {given.size} values and {instrument.name} has {n} "
                f"channel{'s' if n > 1 else ''}; give one value{' or one for each' * (n > 1)}.",
                value=values,
            )
        by_name[name] = np.broadcast_to(given, n)
    return tuple(
        model.vector({name: float(values[c]) for name, values in by_name.items()}) for c in range(n)
    )


def _write_truth(
    path: Path,
    recipe: Mapping[str, Any],
    surface: Surface,
    instrument: Instrument,
    plan: Plan,
    realisation: Realisation,
) -> None:
    from gonio.instrument import imaging

    folder = path / "truth"
    folder.mkdir(exist_ok=True)
    entry = {
        angle: imaging.entry_transmittance(instrument, np.radians(angle), realisation.dome_seed)
        for role in plan.roles
        for angle in plan.incidences(role)
    }
    truth = {
        "schema": "gonio.truth/1",
        "material": surface.name,
        **recipe,
        "standard_scale": realisation.standard_scale,
        "multibounce_scale": realisation.multibounce_scale,
        "half_angle_scale": realisation.half_angle_scale,
        "azimuth_deg": float(np.degrees(realisation.azimuth)),
        "lamp": realisation.lamp.ravel().tolist(),  # channels of an image stand together
        "entry_transmittance": [{"theta_i_deg": a, "relative": t} for a, t in entry.items()],
    }
    write_text(folder / "truth.json", json.dumps(truth, indent=1) + "\n")


def _record(
    session: Session,
    surface: Surface,
    instrument: Instrument,
    plan: Plan,
    realisation: Realisation,
    threads: int | None,
    progress: Progress | None,
    truth_images: bool,
) -> None:
    """Expose and write every missing frame, in the order of the plan."""
    from gonio.instrument.images import Fixed, Images

    fixed = Fixed(
        realisation.dome_seed,
        realisation.pattern_seed,
        realisation.standard_scale,
        realisation.multibounce_scale,
        realisation.azimuth,
    )
    true = realisation.instrument(instrument)
    images = Images(true, surface, plan, fixed, threads=threads)
    truth = _truth_images(session, images) if truth_images else None
    writer = ThreadPoolExecutor(1)
    pending: deque[Future[None]] = deque()

    def finish_one() -> None:
        pending.popleft().result()
        if progress is not None:
            progress(session.n_done, plan.n_frames)

    try:
        for write in _frames(session, images, realisation, truth):
            # Frames are written while later ones are exposed, in the order of the plan.
            pending.append(writer.submit(write))
            if len(pending) > _MAX_PENDING:
                finish_one()
        while pending:
            finish_one()
    finally:
        writer.shutdown(cancel_futures=True)


def _truth_images(session: Session, images: Images) -> TruthImages:
    from gonio.instrument.truth import TruthImages

    truth = TruthImages(session.path / "truth", images)
    truth.write_maps()
    return truth


def _frames(
    session: Session, images: Images, realisation: Realisation, truth: TruthImages | None
) -> Iterator[Callable[[], None]]:
    """Functions that write each missing frame, which is already exposed."""
    from gonio.instrument.noise import expose

    plan, sensor = images.plan, images.instrument.sensor
    n_exposures, n_channels = len(plan.exposures_s), len(plan.channels)
    dark = sensor.dark_current(realisation.pattern_seed)
    readout = sensor.readout() | {"seed": realisation.noise_seed, "threads": images.threads}
    for number, image, missing in _missing(session, plan):
        if truth is not None and image[0] == "sample":
            truth.write_brdf(*image[1:])
        rates = images.rates(*image, realisation.lamp[number])
        for channel, k in missing:
            frame = expose(
                rates[channel] + dark,
                plan.exposures_s[k],
                frame=(number * n_channels + channel) * n_exposures + k,
                **readout,
            )
            yield partial(session.write, *image, k, frame, channel=channel)


def _missing(
    session: Session, plan: Plan
) -> Iterator[tuple[int, tuple[Role, int, int], list[tuple[int, int]]]]:
    """Number and key of every image that lacks frames, with the (channel, exposure) of each."""
    for number, image in enumerate(plan.images()):
        frames = [
            (channel, k)
            for channel in range(len(plan.channels))
            for k in range(len(plan.exposures_s))
            if not session.has(*image, k, channel=channel)
        ]
        if frames:
            yield number, image, frames
