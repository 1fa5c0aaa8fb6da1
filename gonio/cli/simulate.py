"""`gonio simulate`: material + instrument + seed -> raw frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import rich_click as click

from gonio.cli.completion import complete_instrument, complete_material, complete_model
from gonio.errors import ConfigurationError, SessionInterruptedError

if TYPE_CHECKING:
    from gonio.instrument import Instrument
    from gonio.instrument.plans import Values
    from gonio.metadata import Plan
    from gonio.models import Model
    from gonio.session import Session

MAX_WEDGE_DEG = 45.0


@click.command(name="simulate")
@click.argument("material", required=False, shell_complete=complete_material)
@click.option(
    "--model",
    shell_complete=complete_model,
    help="Model to use instead of MATERIAL: a name of 'gonio models', FILE.py or FILE.py:NAME.",
)
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE[,VALUE...]",
    help="Value of a parameter of --model, angles in degrees: one value, or one for each "
    "channel of the instrument. Repeat for each parameter.",
)
@click.option(
    "--instrument",
    default="modern12",
    show_default=True,
    metavar="PRESET|FILE.toml",
    shell_complete=complete_instrument,
    help="Virtual instrument; see 'gonio instruments'.",
)
@click.option(
    "--seed",
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of the random numbers.",
)
@click.option(
    "--rig-seed",
    type=int,
    metavar="N",
    help="Seed of what belongs to the rig: dome, camera, multi-bounce, standard. Sessions with one "
    "--rig-seed and different --seed were recorded on one rig. Default: --seed.",
)
@click.option(
    "--standard-seed",
    type=int,
    metavar="N",
    help="Seed of the white standard's error. Default: that of the rig.",
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="SESSION",
    type=click.Path(path_type=Path),
    help="Folder of raw frames to create, or to continue after an interruption.",
)
@click.option(
    "--plan",
    "plan_file",
    metavar="PLAN.toml",
    type=click.Path(path_type=Path),
    help="Plan file written by 'gonio design -o': angles, exposures and repeats.",
)
@click.option(
    "--theta-i",
    metavar="DEG,DEG,...",
    help="Angles of incidence; default: 21 angles from 0 to the largest angle of the lamp arm.",
)
@click.option(
    "--rotations",
    metavar="DEG,DEG,...",
    help="Rotations of the sample; default: 0,45,90 for anisotropic surfaces, else 0.",
)
@click.option(
    "--standard-at",
    type=float,
    metavar="DEG",
    help="Take the white standard at this incidence only; default: at every incidence.",
)
@click.option(
    "--transmission",
    is_flag=True,
    help="Light the sample from below. The standard is measured in reflection, at "
    "--standard-at or else at 45.",
)
@click.option(
    "--mirror",
    is_flag=True,
    help="Record a plane mirror; 'gonio calibrate alignment' finds the viewing directions from it.",
)
@click.option(
    "--wedge",
    type=float,
    metavar="DEG",
    help="Tilt the mirror's normal by this angle, towards the azimuth of its rotation.",
)
@click.option(
    "--truth-images/--no-truth-images",
    default=None,
    help="Write the true values of each pixel next to the frames. Default: only if they take "
    "at most a fifth of the space of the frames.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of worker threads; the frames do not depend on it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    material: str | None,
    model: str | None,
    items: tuple[str, ...],
    instrument: str,
    seed: int,
    rig_seed: int | None,
    standard_seed: int | None,
    output: Path,
    plan_file: Path | None,
    theta_i: str | None,
    rotations: str | None,
    standard_at: float | None,
    transmission: bool,
    mirror: bool,
    wedge: float | None,
    truth_images: bool | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Record the raw frames of a surface on a virtual instrument.

    Give a MATERIAL of 'gonio materials', or --model with its parameters, or --mirror. Each frame is
    written as it is taken. After an interruption the same command continues, and the result is
    identical to the last bit.
    """
    from gonio.cli.progress import progress
    from gonio.instrument import load
    from gonio.plan_file import read_plan
    from gonio.simulation import MIRROR, simulate

    _check_mirror(mirror, wedge, material or model, items, standard_at, transmission)
    _check_plan(plan_file, theta_i, rotations, standard_at, mirror or transmission)
    planned = None if plan_file is None else read_plan(plan_file)
    chosen, parameters = (None, {}) if mirror else _surface(material, model, items)
    chosen_instrument = load(instrument)
    if planned is None:
        plan = _plan(
            chosen_instrument,
            chosen,
            parameters,
            standard_at,
            transmission=transmission,
            wedge=wedge,
        )
        plan = _with_angles(plan, chosen_instrument, theta_i, rotations)
    else:
        plan = planned
        for angle in plan.theta_i_deg:
            _check_reach("--plan", angle, chosen_instrument, 0.0)
    n_before = _frames_there(output)
    name = material or (chosen.name if chosen else MIRROR)
    try:
        with progress(f"simulating {name} on {chosen_instrument.name}", "frames") as callback:
            session = simulate(
                material,
                output=output,
                model=chosen if model else None,
                parameters=parameters if model else None,
                instrument=chosen_instrument,
                plan=plan,
                seed=seed,
                rig_seed=rig_seed,
                standard_seed=standard_seed,
                threads=threads,
                progress=callback,
                truth_images=truth_images,
            )
    except KeyboardInterrupt:
        _interrupted(output, plan)
    _print(session, n_before, seed, as_json)


def _check_mirror(
    mirror: bool,
    wedge: float | None,
    surface: str | None,
    items: tuple[str, ...],
    standard_at: float | None,
    transmission: bool,
) -> None:
    """Refuse options that do not fit a mirror, and options that need one."""
    if not mirror:
        if wedge is not None:
            raise ConfigurationError("--wedge tilts a mirror; give --mirror with it.", value=wedge)
        return
    others = {
        "a MATERIAL or --model": surface is not None,
        "-p": bool(items),
        "--standard-at": standard_at is not None,
        "--transmission": transmission,
    }
    for name, given in others.items():
        if given:
            raise ConfigurationError(
                f"--mirror records a mirror alone; leave {name} out.", value=surface
            )


def _check_plan(
    plan: Path | None,
    theta_i: str | None,
    rotations: str | None,
    standard_at: float | None,
    other_mode: bool,
) -> None:
    """Refuse options that a plan file already sets."""
    given = {
        "--theta-i": theta_i is not None,
        "--rotations": rotations is not None,
        "--standard-at": standard_at is not None,
        "--mirror and --transmission": other_mode,
    }
    for name, is_given in given.items() if plan is not None else ():
        if is_given:
            raise ConfigurationError(
                f"--plan {plan} says which images are taken; leave {name} out.", value=plan
            )


def _surface(
    material: str | None, model: str | None, items: tuple[str, ...]
) -> tuple[Model, dict[str, Values]]:
    import gonio.materials as materials
    import gonio.models as models
    from gonio.cli.options import file_text

    if (material is None) == (model is None):
        given = "both were given" if model else "neither was given"
        raise ConfigurationError(f"give a MATERIAL or --model NAME; {given}.")
    if material is not None:
        named = materials.get(material)
        if items:
            raise ConfigurationError(
                f"-p goes with --model, and {material} has its own parameters; "
                f"give --model {named.model} and all of its parameters to change one.",
                value=items,
            )
        return models.get(named.model), dict(named.parameters)
    chosen = models.resolve(str(model))
    parameters = _values(chosen, items)
    left_out = [p for p in chosen.parameters if p.name not in parameters]
    if left_out:
        defaults = ", ".join(f"{p.name} = {file_text(p, p.default)}" for p in left_out)
        click.echo(f"Default values are used for {defaults}.", err=True)
    return chosen, {**{p.name: p.default for p in left_out}, **parameters}


def _values(model: Model, items: tuple[str, ...]) -> dict[str, Values]:
    """Parameters by name, radians for angles; a list if one value per channel was given."""
    from gonio.cli.options import parse_parameters

    one_by_one = [_one_value_each(item) for item in items]
    # Channel by channel, each item with its own value there, or its only or last one.
    columns = [
        parse_parameters(model, [words[min(c, len(words) - 1)] for words in one_by_one])
        for c in range(max(map(len, one_by_one), default=1))
    ]
    counts = dict(zip(columns[0], map(len, one_by_one), strict=True))
    return {
        name: [column[name] for column in columns[:n]] if n > 1 else columns[0][name]
        for name, n in counts.items()
    }


def _one_value_each(item: str) -> list[str]:
    """NAME=0.1,0.2 as NAME=0.1 and NAME=0.2.

    Examples
    --------
    >>> _one_value_each("rho_d=0.1,0.2")
    ['rho_d=0.1', 'rho_d=0.2']
    """
    name, sign, values = item.partition("=")
    return [f"{name}{sign}{value}" for value in values.split(",")]


def _plan(
    instrument: Instrument,
    model: Model | None,
    parameters: dict[str, Values],
    standard_at: float | None,
    *,
    transmission: bool,
    wedge: float | None,
) -> Plan:
    """The default plan for the surface."""
    from gonio.instrument.plans import default_plan, is_anisotropic, mirror_plan, transmission_plan

    if wedge is not None and not 0 <= wedge < MAX_WEDGE_DEG:
        raise ConfigurationError(
            f"--wedge {wedge:g}: the mirror's normal can be tilted by 0 to less than "
            f"{MAX_WEDGE_DEG:g} deg.",
            value=wedge,
        )
    if model is None:
        return mirror_plan(instrument, wedge_deg=wedge or 0.0)
    if standard_at is not None:
        _check_reach("--standard-at", standard_at, instrument, 0.0)
    anisotropic = is_anisotropic(model, parameters)
    if transmission:
        return transmission_plan(
            instrument, anisotropic=anisotropic, standard_theta_i_deg=standard_at
        )
    plan = default_plan(instrument, anisotropic=anisotropic)
    return plan.model_copy(update={"standard_theta_i_deg": standard_at})


def _with_angles(
    plan: Plan, instrument: Instrument, theta_i: str | None, rotations: str | None
) -> Plan:
    """The plan with the given angles in place of its own."""
    change = {}
    if theta_i is not None:
        change["theta_i_deg"] = _degrees("--theta-i", theta_i)
        lowest = -instrument.theta_i_max_deg if plan.mode == "mirror" else 0.0
        for angle in change["theta_i_deg"]:
            _check_reach("--theta-i", angle, instrument, lowest)
    if rotations is not None:
        change["rotations_deg"] = _degrees("--rotations", rotations)
    return plan.model_copy(update=change)


def _check_reach(option: str, angle: float, instrument: Instrument, lowest: float) -> None:
    if not lowest <= angle <= instrument.theta_i_max_deg:
        raise ConfigurationError(
            f"{option}: {angle:g} deg is out of reach of the lamp arm of {instrument.name}; "
            f"allowed is {lowest:g} to {instrument.theta_i_max_deg:g} deg.",
            value=angle,
        )


def _degrees(option: str, text: str) -> tuple[float, ...]:
    try:
        angles = tuple(float(word) for word in text.split(","))
    except ValueError:
        angles = ()
    if not angles or not all(abs(angle) <= 360 for angle in angles):
        raise ConfigurationError(
            f"{option} {text!r} is not a list of angles in degrees such as 0,15,30.", value=text
        )
    return angles


def _frames_there(output: Path) -> int:
    from gonio.session import Session

    return Session.open(output).n_done if (output / "session.json").is_file() else 0


def _interrupted(output: Path, plan: Plan) -> NoReturn:
    """Report how many frames are saved, from the manifest on the disk."""
    raise SessionInterruptedError(
        f"interrupted; run the same command again to continue. {_frames_there(output)} of "
        f"{plan.n_frames} frames are safe in {output}.",
        value=output,
    ) from None


def _print(session: Session, n_before: int, seed: int, as_json: bool) -> None:
    from gonio.cli.options import echo_json

    path = session.path
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    if as_json:
        echo_json(_document(session, n_before, seed) | {"bytes": size})
    elif n_before == session.n_done:
        click.echo(f"{path}: already complete, {n_before} frames, {size / 1e6:.1f} MB.")
    else:
        added = f", {n_before} of them from before" if n_before else ""
        click.echo(f"{path}: {session.n_done} frames{added}, {size / 1e6:.1f} MB.")
        click.echo(_summary(session))


def _summary(session: Session) -> str:
    """What was recorded, in one line.

    The plan states every number; this line shows at a glance whether the intended frames were
    taken.
    """
    plan, camera = session.metadata.plan, session.metadata.camera
    images = ", ".join(
        f"{role} {plan.takes(role)} x {len(plan.incidences(role))}" for role in plan.roles
    )
    parts = [
        plan.mode,
        f"images (takes x incidences): {images}",
        f"{len(plan.exposures_s)} exposures of {1e3 * plan.exposures_s[0]:.3g} to "
        f"{1e3 * plan.exposures_s[-1]:.3g} ms",
        f"{camera.columns} x {camera.rows} pixels",
    ]
    if len(plan.channels) > 1:
        parts.append(f"channels {', '.join(channel.name for channel in plan.channels)}")
    return "; ".join(parts) + "."


def _document(session: Session, n_before: int, seed: int) -> dict[str, Any]:
    metadata, plan = session.metadata, session.metadata.plan
    return {
        "schema": "gonio.simulate/1",
        "session": str(session.path),
        "sample": metadata.sample,
        "instrument": metadata.instrument,
        "seed": seed,
        "mode": plan.mode,
        "theta_i_deg": list(plan.theta_i_deg),
        "rotations_deg": list(plan.rotations_deg),
        "exposures_s": list(plan.exposures_s),
        "standard_theta_i_deg": plan.standard_theta_i_deg,
        "wedge_deg": plan.wedge_deg,
        "channels": [channel.model_dump() for channel in plan.channels],
        "images": {role: plan.takes(role) * len(plan.incidences(role)) for role in plan.roles},
        "rows": metadata.camera.rows,
        "columns": metadata.camera.columns,
        "frames": session.n_done,
        "frames_added": session.n_done - n_before,
    }
