"""`gonio simulate`: material + instrument + seed -> raw frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import rich_click as click

from gonio.errors import ConfigurationError, SessionInterruptedError

if TYPE_CHECKING:
    from gonio.instrument import Instrument
    from gonio.metadata import Plan
    from gonio.models import Model
    from gonio.session import Session


@click.command(name="simulate")
@click.argument("material", required=False)
@click.option("--model", help="A model instead of MATERIAL; see 'gonio models'.")
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter of --model, angles in degrees; repeat for each.",
)
@click.option(
    "--instrument",
    default="modern12",
    show_default=True,
    metavar="PRESET|FILE.toml",
    help="The instrument; see 'gonio instruments'.",
)
@click.option(
    "--seed",
    default=0,
    show_default=True,
    metavar="N",
    help="Everything random follows from this number.",
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="SESSION",
    type=click.Path(path_type=Path),
    help="Folder of raw frames to make, or to continue after an interruption.",
)
@click.option(
    "--theta-i",
    metavar="DEG,DEG,...",
    help="Incidence angles; 21 from 0 to the reach of the lamp arm where not given.",
)
@click.option(
    "--rotations",
    metavar="DEG,DEG,...",
    help="Rotations of the sample; 0,45,90 for anisotropic surfaces, else 0, where not given.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Threads to use; the frames do not depend on it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    material: str | None,
    model: str | None,
    items: tuple[str, ...],
    instrument: str,
    seed: int,
    output: Path,
    theta_i: str | None,
    rotations: str | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Record the raw frames of a surface on a virtual instrument.

    Give a MATERIAL of 'gonio materials', or --model with its parameters. The frames are on the
    disk as they are taken: after an interruption the same command continues, and the result is
    the same to the last bit.
    """
    from gonio.cli.progress import progress
    from gonio.instrument import load
    from gonio.simulation import is_anisotropic, simulate

    chosen, parameters = _surface(material, model, items)
    rig = load(instrument)
    plan = _plan(rig, theta_i, rotations, anisotropic=is_anisotropic(chosen, parameters))
    there = _frames_there(output)
    name = material or chosen.name
    try:
        with progress(f"simulating {name} on {rig.name}", "frames") as callback:
            session = simulate(
                material,
                output=output,
                model=model,
                parameters=parameters if model else None,
                instrument=rig,
                plan=plan,
                seed=seed,
                threads=threads,
                progress=callback,
            )
    except KeyboardInterrupt:
        _interrupted(output, plan)
    _tell(session, there, seed, as_json)


def _surface(
    material: str | None, model: str | None, items: tuple[str, ...]
) -> tuple[Model, dict[str, float]]:
    from gonio import materials, models
    from gonio.cli.options import file_text, parse_parameters

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
    chosen = models.get(str(model))
    parameters = parse_parameters(chosen, items)
    left_out = [p for p in chosen.parameters if p.name not in parameters]
    if left_out:
        defaults = ", ".join(f"{p.name} = {file_text(p, p.default)}" for p in left_out)
        click.echo(f"Default values are used for {defaults}.", err=True)
    return chosen, {**{p.name: p.default for p in left_out}, **parameters}


def _plan(
    rig: Instrument, theta_i: str | None, rotations: str | None, *, anisotropic: bool
) -> Plan:
    """The default plan with the angles that were given in place of its own."""
    from gonio.simulation import default_plan

    plan = default_plan(rig, anisotropic=anisotropic)
    change = {}
    if theta_i is not None:
        change["theta_i_deg"] = _degrees("--theta-i", theta_i)
        for angle in change["theta_i_deg"]:
            if not 0 <= angle <= rig.theta_i_max_deg:
                raise ConfigurationError(
                    f"--theta-i: {angle:g} deg is out of reach of the lamp arm of {rig.name}; "
                    f"allowed is 0 to {rig.theta_i_max_deg:g} deg.",
                    value=angle,
                )
    if rotations is not None:
        change["rotations_deg"] = _degrees("--rotations", rotations)
    return plan.model_copy(update=change)


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
    """Say what is safe. The manifest on the disk is read: it is what a new start will find."""
    raise SessionInterruptedError(
        f"interrupted; run the same command again to continue. {_frames_there(output)} of "
        f"{plan.n_frames} frames are safe in {output}.",
        value=output,
    ) from None


def _tell(session: Session, there: int, seed: int, as_json: bool) -> None:
    from gonio.cli.options import echo_json

    metadata, path = session.metadata, session.path
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    if as_json:
        echo_json(
            {
                "schema": "gonio.simulate/1",
                "session": str(path),
                "sample": metadata.sample,
                "instrument": metadata.instrument,
                "seed": seed,
                "theta_i_deg": list(metadata.plan.theta_i_deg),
                "rotations_deg": list(metadata.plan.rotations_deg),
                "exposures_s": list(metadata.plan.exposures_s),
                "frames": session.n_done,
                "frames_added": session.n_done - there,
                "bytes": size,
            }
        )
    elif there == session.n_done:
        click.echo(f"{path}: already complete, {there} frames, {size / 1e6:.1f} MB.")
    else:
        added = f", {there} of them from before" if there else ""
        click.echo(f"{path}: {session.n_done} frames{added}, {size / 1e6:.1f} MB.")
