"""`gonio design`: which images determine the parameters of a surface."""

from __future__ import annotations

import json
import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError, unknown_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from gonio.cli.pilot import Bench, Domes, Virtual
    from gonio.fitting.design import Candidates, Design, Expected, Merit
    from gonio.instrument import Instrument
    from gonio.metadata import Plan
    from gonio.models import Model
    from gonio.samples import BRDFSamples

ROTATIONS_DEG = (0.0, 22.5, 45.0, 67.5, 90.0)  # for models whose f depends on phi_i
SMALLEST = 3  # images: one each of sample, standard and background
_TRIM = 0.02  # that the merit may grow by for exposures left out: 1 % of an uncertainty
_SEEN = 0.995  # share of solid angle and light that must stay without them
_AS_GOOD = 1 + 1e-9


@click.command(name="design")
@click.option("--model", required=True, help="Model of the surface; see 'gonio models'.")
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter about which to plan; degrees for angles.",
)
@click.option(
    "--instrument",
    default="modern12",
    show_default=True,
    metavar="PRESET|FILE.toml",
    help="Virtual instrument; see 'gonio instruments'.",
)
@click.option(
    "--want",
    metavar="NAME=SHARE,...",
    help="Relative standard uncertainties to reach, such as alpha_x=0.01,rho_s=0.02; those of the "
    "default plan where neither --want nor --budget is given.",
)
@click.option(
    "--budget",
    type=int,
    metavar="N",
    help="Largest number of images of sample, standard and background together.",
)
@click.option(
    "-o",
    "--output",
    metavar="PLAN.toml",
    type=click.Path(path_type=Path),
    help="File to write the plan to, as a table [plan].",
)
@click.option(
    "--verify",
    type=click.IntRange(min=2),
    metavar="N",
    help="Simulate the plan with N seeds, reduce and fit, and compare the scatter.",
)
@click.option("--threads", type=click.IntRange(min=1), metavar="N", help="Threads to use.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    model: str,
    items: tuple[str, ...],
    instrument: str,
    want: str | None,
    budget: int | None,
    output: Path | None,
    verify: int | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Choose which images to take for a wanted precision of parameters.

    Incidence angles, rotations, takes of standard and background, and exposures are chosen by
    Fisher information, the errors that images share included. The surface is taken to be exactly
    the model with the parameters that are given.
    """
    from gonio.cli.options import check_target, echo_json
    from gonio.files import write_text
    from gonio.instrument import load

    chosen, parameters = _surface(model, items)
    wanted = _wanted(chosen, parameters, want)
    if budget is not None and budget < SMALLEST:
        raise ConfigurationError(
            f"--budget {budget}: at least {SMALLEST} images are needed, one each of sample, "
            "standard and background.",
            value=budget,
        )
    if output is not None:
        check_target(output)
    rig = load(instrument)
    found = plan_for(rig, chosen, parameters, wanted, budget=budget, threads=threads)
    document = found.document() | {"command": _command(found, instrument)}
    if verify is not None:
        document["verification"] = _verified(found, verify)
    if output is not None:
        write_text(output, _toml(found))
    if as_json:
        echo_json(document | {"output": None if output is None else str(output)})
    else:
        _show(document, output)


def _surface(name: str, items: tuple[str, ...]) -> tuple[Model, dict[str, float]]:
    import gonio.models as models
    from gonio.cli.options import file_text, parse_parameters

    model = models.get(name)
    given = parse_parameters(model, items)
    left_out = [p for p in model.parameters if p.name not in given]
    if left_out:
        defaults = ", ".join(f"{p.name} = {file_text(p, p.default)}" for p in left_out)
        click.echo(f"Default values are used for {defaults}.", err=True)
    return model, {p.name: given.get(p.name, p.default) for p in model.parameters}


def _wanted(model: Model, parameters: dict[str, float], text: str | None) -> dict[str, float]:
    """Wanted relative standard uncertainties by name.

    Examples
    --------
    >>> from gonio import models
    >>> _wanted(models.get("ward"), {"alpha_x": 0.1}, "alpha_x=0.01")
    {'alpha_x': 0.01}
    """
    found: dict[str, float] = {}
    for item in text.split(",") if text is not None else ():
        name, sign, share = (part.strip() for part in item.partition("="))
        if not sign or not name:
            raise ConfigurationError(
                f"--want {item!r} is not NAME=SHARE; write for example "
                f"--want {model.parameters[0].name}=0.01 for 1 %.",
                value=item,
            )
        if name not in model.names:
            raise unknown_name(f"parameter of {model.name}", name, model.names)
        if name in found:
            raise ConfigurationError(f"--want {name} is given twice; give it once.", value=item)
        try:
            number = float(share)
        except ValueError:
            number = math.nan
        if not 0 < number < math.inf:
            raise ConfigurationError(
                f"--want {name}={share}: a relative standard uncertainty is a positive number; "
                "0.01 is 1 %.",
                value=share,
            )
        if parameters[name] == 0:
            raise ConfigurationError(
                f"--want {name}={share}: {name} is 0, of which no share can be wanted; "
                f"give another value with -p {name}=VALUE.",
                value=share,
            )
        found[name] = number
    return found


# ---------------------------------------------------------------- the choice


@dataclass(frozen=True)
class Found:
    """A plan with what is expected of it.

    Parameters
    ----------
    bench : Bench
        The instrument as it was planned with.
    rig : Instrument
        The instrument as it was given.
    parameters, wanted : mapping
        Values in the unit of Python, and relative standard uncertainties to reach.
    plan, default : Plan
    expected, of_default : Expected
        For both plans.
    helped : list
        For each parameter theta_i and rotation of the image that it would miss most, degrees, and
        the factor by which its uncertainty grows without it.
    determined : ndarray of bool, shape (P,)
        Parameters of which some candidate image says something.
    meanings : mapping of str to str
        What the sources of uncertainty are.
    """

    bench: Bench
    rig: Instrument
    parameters: dict[str, float]
    wanted: dict[str, float]
    plan: Plan
    default: Plan
    expected: Expected
    of_default: Expected
    helped: list[tuple[float, float, float] | None]
    determined: list[bool]
    meanings: dict[str, str]

    def document(self) -> dict[str, Any]:
        """What 'gonio design --json' prints."""
        rows = [self._row(j) for j in range(len(self.bench.model.parameters))]
        reached = [row["u_relative"] is not None and row["u_relative"] <= row["wanted"] * _AS_GOOD
                   for row in rows if row["wanted"] is not None]  # fmt: skip
        return {
            "schema": "gonio.design/1",
            "model": self.bench.model.name,
            "instrument": self.rig.name,
            "pixels": list(self.bench.rig.sensor.shape),
            "plan": _described(self.plan),
            "default": _described(self.default),
            "parameters": rows,
            "reached": all(reached) if reached else None,
            "remarks": self._remarks(rows),
        }

    def _row(self, j: int) -> dict[str, Any]:
        parameter = self.bench.model.parameters[j]
        value = self.parameters[parameter.name]
        known = self._known(j, self.expected)
        source, largest = self.expected.limit(j) if known else (None, math.nan)
        helped = self.helped[j] if known else None
        return {
            "name": parameter.name,
            "value": parameter.to_file(value),
            "unit": parameter.file_unit,
            "u": parameter.to_file(float(self.expected.u[j])) if known else None,
            "u_relative": _share(self.expected.u[j], value) if known else None,
            "u_of_default": (
                parameter.to_file(float(self.of_default.u[j]))
                if self._known(j, self.of_default)
                else None
            ),
            "wanted": self.wanted.get(parameter.name),
            "largest_source": source,
            "largest_source_u": parameter.to_file(largest) if known else None,
            "helped_most_by": None if helped is None else _helping(*helped),
        }

    def _known(self, j: int, expected: Expected) -> bool:
        """Whether the images say more of a parameter than its allowed range does."""
        parameter = self.bench.model.parameters[j]
        return bool(expected.determined[j] and expected.u[j] < (parameter.upper - parameter.lower))

    def _remarks(self, rows: list[dict[str, Any]]) -> list[str]:
        lines = []
        for j, row in enumerate(rows):
            if not self.determined[j]:
                value = f"{row['value']:.4g}{' ' * bool(row['unit'])}{row['unit']}"
                lines.append(
                    f"{row['name']}: no plan of {self.rig.name} determines it where it is {value}."
                    if row["wanted"] is None
                    else f"{row['name']}: {100 * row['wanted']:.2g} % was wanted, and no plan of "
                    f"{self.rig.name} determines it where it is {value}."
                )
            elif row["u"] is None:
                lines.append(f"{row['name']}: this plan does not determine it.")
            elif row["wanted"] is not None and row["u_relative"] > row["wanted"] * _AS_GOOD:
                lines.append(self._limited(row))
        if len(self.rig.channels) > 1:
            dimmest = self.bench.rig.channels[0].name
            lines.append(
                f"{len(self.rig.channels)} channels: planned in the dimmest, {dimmest}; "
                "frames are counted in all."
            )
        return lines

    def _limited(self, row: dict[str, Any]) -> str:
        """Why a wanted precision is out of reach."""
        share = _share(row["largest_source_u"], row["value"])
        assert share is not None
        meaning = self.meanings[row["largest_source"]]
        per_cent = f"{100 * share:.2g} %"
        alone = (
            f"{meaning} alone is {per_cent}, more than that"
            if share > row["wanted"]
            else f"the largest source is {meaning} with {per_cent}"
        )
        return (
            f"{row['name']}: {100 * row['wanted']:.2g} % was wanted and "
            f"{100 * row['u_relative']:.2g} % is reached; {alone}."
        )


def _helping(theta_i_deg: float, rotation_deg: float, growth: float) -> dict[str, float | None]:
    """The image that a parameter would miss most; no growth where nothing is left without it."""
    finite = growth if math.isfinite(growth) else None
    return {"theta_i_deg": theta_i_deg, "rotation_deg": rotation_deg, "growth": finite}


def _share(u: float, value: float) -> float | None:
    return float(u) / abs(value) if value else None


def _described(plan: Plan) -> dict[str, Any]:
    return {
        "theta_i_deg": list(plan.theta_i_deg),
        "rotations_deg": list(plan.rotations_deg),
        "exposures_s": list(plan.exposures_s),
        "repeats": plan.repeats,
        "images": plan.n_images,
        "frames": plan.n_frames,
    }


def plan_for(
    rig: Instrument,
    model: Model,
    parameters: dict[str, float],
    wanted: dict[str, float],
    *,
    budget: int | None = None,
    threads: int | None = None,
) -> Found:
    """The plan of an instrument for a surface.

    Parameters
    ----------
    rig : Instrument
    model : Model
    parameters : mapping
        All of its parameters, radians for angles.
    wanted : mapping
        Relative standard uncertainties to reach; may be empty.
    budget : int, optional
        Images at most. Where neither is given the plan is to be as good as the default one.
    threads : int, optional
        The result does not depend on it.
    """
    import numpy as np

    from gonio.cli.pilot import Bench, coarse, one_channel, with_channels
    from gonio.fitting.design import choose, merit_of_all, merit_of_targets
    from gonio.simulation import default_plan, is_anisotropic

    p = model.vector(parameters)
    bench = Bench(coarse(one_channel(rig)), model, p, threads)
    default = default_plan(bench.rig, anisotropic=is_anisotropic(model, parameters))
    rotations = (0.0,) if model.claims.isotropic else ROTATIONS_DEG
    everything = default.model_copy(update={"rotations_deg": rotations})
    candidates = _candidates(bench, everything)
    of_default = candidates.expected(_design(everything, default))
    determined = candidates.expected(candidates.everything).determined
    targets = np.array([wanted.get(q.name, np.nan) for q in model.parameters]) * np.abs(p)
    if not wanted and budget is None:
        targets = np.where(of_default.determined, of_default.u, np.nan)
    asked = np.isfinite(targets)
    merit = merit_of_targets(targets) if asked.any() else merit_of_all(determined)

    def reached(expected: Expected) -> bool:
        # A parameter that nobody asked for must still be known, or the fit would not settle.
        settled = bool(np.all(expected.determined[determined]))
        return settled and bool(np.all(expected.u[asked] <= targets[asked] * _AS_GOOD))

    design = choose(candidates, merit, budget=budget, reached=reached if asked.any() else None)
    full = _plan(everything, design)
    plan, own, samples = _trimmed(bench, full, merit, reached if asked.any() else None)
    same = own.everything
    helped = [
        None if h is None else (plan.theta_i_deg[h[0]], plan.rotations_deg[h[1]], h[2])
        for h in own.helps_most(same)
    ]
    return Found(
        bench, rig, parameters, wanted,
        with_channels(plan, rig), with_channels(default, rig),
        own.expected(same), of_default, helped,
        determined.tolist(),
        {"independent": "noise of the counts"} | {t.name: t.meaning for t in samples.shared},
    )  # fmt: skip


def _candidates(bench: Bench, plan: Plan) -> Candidates:
    """Every image of a plan, from a virtual session of it."""
    from gonio.cli.pilot import Domes
    from gonio.cli.progress import progress

    doing = f"looking at {len(plan.theta_i_deg)} x {len(plan.rotations_deg)} images"
    with progress(doing, "images") as callback:
        session = bench.session(plan, progress=callback)
    return _judged(bench, session, Domes.drawn(bench.rig, 0))[0]


def _judged(bench: Bench, session: Virtual, domes: Domes) -> tuple[Candidates, BRDFSamples]:
    """What a session's images say of the parameters, and its samples.

    Its takes of standard and background are in its variances already.
    """
    from gonio.calibration.reduction.reduce import reduce
    from gonio.cli.pilot import AVERAGED
    from gonio.fitting.design import Candidates

    plan = session.metadata.plan
    samples = reduce(session, threads=bench.threads)
    samples = domes.given_to(samples)
    made = Candidates(
        samples,
        bench.model,
        bench.p,
        n_incidences=len(plan.theta_i_deg),
        n_rotations=len(plan.rotations_deg),
        averaged=AVERAGED,
        threads=bench.threads,
    )
    return made, samples


def _design(everything: Plan, plan: Plan) -> Design:
    """The numbers of a plan's angles among those of the candidates."""
    from gonio.fitting.design import Design

    incidences = (everything.theta_i_deg.index(a) for a in plan.theta_i_deg)
    rotations = (everything.rotations_deg.index(a) for a in plan.rotations_deg)
    return Design(tuple(incidences), tuple(rotations), plan.repeats)


def _plan(everything: Plan, design: Design) -> Plan:
    return everything.model_copy(
        update={
            "theta_i_deg": tuple(everything.theta_i_deg[i] for i in design.incidences),
            "rotations_deg": tuple(everything.rotations_deg[r] for r in design.rotations),
            "repeats": design.repeats,
        }
    )


def _trimmed(
    bench: Bench, plan: Plan, merit: Merit, reached: Callable[[Expected], bool] | None
) -> tuple[Plan, Candidates, BRDFSamples]:
    """The plan without the exposures that no pixel needs, and what its images say."""
    from gonio.calibration.reduction.reduce import reduce
    from gonio.cli.pilot import FIELDS, Domes, seen
    from gonio.cli.progress import progress
    from gonio.errors import DataError

    with progress("leaving out exposures", "images") as callback:
        session = bench.session(plan, progress=callback)
    # Other domes than those that the plan was chosen by: it may have found a way around them.
    domes = Domes.drawn(bench.rig, FIELDS)
    own, samples = _judged(bench, session, domes)
    expected = own.expected(own.everything)
    limit, area = merit(expected) + _TRIM, seen(samples)
    good = reached is not None and reached(expected)
    keep = list(range(len(plan.exposures_s)))
    for k in range(len(plan.exposures_s)):
        fewer = [other for other in keep if other != k]
        if not fewer:
            break
        less = session.with_exposures(fewer)
        if less.overexposed() > 1 - _SEEN:
            continue
        try:
            found = reduce(less, threads=bench.threads)
        except DataError:
            continue  # without it frames are wrong, or nothing is left
        if any(now < _SEEN * before for now, before in zip(seen(found), area, strict=True)):
            continue
        tried, found = _judged(bench, less, domes)
        then = tried.expected(tried.everything)
        if merit(then) <= limit and (not good or (reached is not None and reached(then))):
            keep, own, samples = fewer, tried, found
    exposures = tuple(plan.exposures_s[k] for k in keep)
    return plan.model_copy(update={"exposures_s": exposures}), own, samples


# ---------------------------------------------------------------- verification


def _verified(found: Found, n: int) -> dict[str, Any]:
    """Scatter of fits to simulated sessions against what was expected of it."""
    import numpy as np

    from gonio.calibration.reduction.reduce import reduce
    from gonio.cli.pilot import CONSTANT
    from gonio.cli.progress import progress
    from gonio.fitting.fit import fit
    from gonio.metadata import Channel

    bench = found.bench
    plan = found.plan.model_copy(update={"channels": (Channel(),)})
    fitted = []
    with progress(f"verifying with {n} seeds", "seeds") as callback:
        for seed in range(n):
            samples = reduce(bench.drawn(plan, seed), threads=bench.threads)
            result = fit(samples, model=bench.model, threads=bench.threads)
            fitted.append([result.parameters[q.name].value for q in bench.model.parameters])
            callback(seed + 1, n)
    values = np.array(fitted)
    constant = {*CONSTANT}
    if bench.rig.surroundings.multibounce_uncertainty is None:
        constant.add("multi-bounce")
    rows = []
    for j, q in enumerate(bench.model.parameters):
        known = bool(found.expected.determined[j])
        parts = {k: u[j] for k, u in found.expected.components.items() if k not in constant}
        predicted = q.to_file(float(np.sqrt(sum(u**2 for u in parts.values())))) if known else None
        scatter = float(values[:, j].std(ddof=1))
        rows.append(
            {
                "name": q.name,
                "predicted": predicted,
                "scatter": scatter,
                "ratio": scatter / predicted if predicted else None,
                "bias": float(values[:, j].mean() - q.to_file(found.parameters[q.name])),
            }
        )
    return {"seeds": n, "relative_sd_of_scatter": 1 / math.sqrt(2 * (n - 1)), "parameters": rows}


# ---------------------------------------------------------------- what is told


def _numbers(values: list[float] | tuple[float, ...]) -> str:
    return ", ".join(f"{value:.10g}" for value in values)


def _toml(found: Found) -> str:
    """The plan as a table that 'gonio import' and `gonio.metadata.Plan` read."""
    plan, model = found.plan, found.bench.model
    values = ", ".join(
        f"{q.name} = {q.to_file(found.parameters[q.name]):.6g}{' ' * bool(q.file_unit)}"
        f"{q.file_unit}"
        for q in model.parameters
    )
    lines = [
        f"# Plan of 'gonio design' for {model.name} on {found.rig.name}:",
        *(f"# {line}" for line in textwrap.wrap(values, 90)),
        "[plan]",
        f"theta_i_deg = [{_numbers(plan.theta_i_deg)}]",
        f"rotations_deg = [{_numbers(plan.rotations_deg)}]",
        f"exposures_s = [{_numbers(plan.exposures_s)}]",
        f"repeats = {plan.repeats}",
    ]
    for channel in plan.channels if plan.channels[0].name else ():
        lines += ["", "[[plan.channels]]", f"name = {json.dumps(channel.name)}"]
        if channel.wavelength_nm is not None:
            lines.append(f"wavelength_nm = {channel.wavelength_nm!r}")
    return "\n".join(lines) + "\n"


def _command(found: Found, instrument: str) -> str:
    """The words that record the plan's angles."""
    plan, model = found.plan, found.bench.model
    given = " ".join(
        f"-p {q.name}={q.to_file(found.parameters[q.name]):.10g}" for q in model.parameters
    )
    theta_i = _numbers(plan.theta_i_deg).replace(" ", "")
    rotations = _numbers(plan.rotations_deg).replace(" ", "")
    return (
        f"gonio simulate --model {model.name} {given} --instrument {instrument} "
        f"--theta-i {theta_i} --rotations {rotations} -o SESSION"
    )


def _show(document: dict[str, Any], output: Path | None) -> None:
    plan, default = document["plan"], document["default"]
    rows, columns = document["pixels"]
    click.echo(f"{document['model']} on {document['instrument']} ({rows} x {columns} pixels)")
    click.echo()
    for label, values in (
        ("theta_i, deg", plan["theta_i_deg"]),
        ("rotations, deg", plan["rotations_deg"]),
        ("exposures, ms", [1e3 * t for t in plan["exposures_s"]]),
        ("takes of standard and background", [plan["repeats"]]),
    ):
        _say(f"{label}: {_numbers(values)}")
    click.echo(
        f"{plan['images']} images, {plan['frames']} frames; default plan: "
        f"{default['images']} images, {default['frames']} frames"
    )
    click.echo()
    _show_parameters(document["parameters"])
    if "verification" in document:
        _show_verification(document["verification"])
    click.echo()
    for line in document["remarks"]:
        _say(line)
    _say(
        "Expected is how far a 'gonio fit' to this plan's images lies off, one standard "
        "deviation, if the surface follows the model. Whether it does, further angles must tell."
    )
    _show_use(document, output)


def _show_parameters(rows: list[dict[str, Any]]) -> None:
    click.echo("standard uncertainty in % of the value (in its unit where that is 0)")
    head = ("value", "default", "expected", "wanted")
    click.echo(_line("", head, "largest source", "helped most by"))
    for row in rows:
        helped = row["helped_most_by"]
        at = "-"
        if helped is not None:
            at = f"theta_i {helped['theta_i_deg']:g}, rotation {helped['rotation_deg']:g}"
        figures = (
            f"{row['value']:.4g}{' ' * bool(row['unit'])}{row['unit']}",
            *(_percent(row[key], row["value"]) for key in ("u_of_default", "u")),
            "-" if row["wanted"] is None else f"{100 * row['wanted']:.3g}",
        )
        click.echo(_line(row["name"], figures, row["largest_source"] or "-", at))


def _show_verification(check: dict[str, Any]) -> None:
    click.echo()
    click.echo(
        f"{check['seeds']} simulated sessions; their scatter is itself known to "
        f"{check['relative_sd_of_scatter']:.0%}"
    )
    click.echo(f"{'':<12}{'predicted':>12}{'scatter':>12}{'ratio':>8}{'bias':>12}")
    for row in check["parameters"]:
        figures = [row["predicted"], row["scatter"], row["bias"]]
        predicted, scatter, bias = ("-" if x is None else f"{x:.3g}" for x in figures)
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.2f}"
        click.echo(f"{row['name']:<12}{predicted:>12}{scatter:>12}{ratio:>8}{bias:>12}")


def _show_use(document: dict[str, Any], output: Path | None) -> None:
    """How to take the plan: on the command line its angles, in Python and for a rig all of it."""
    click.echo()
    click.echo("Its angles, with every exposure of the instrument:")
    click.echo(f"  {document['command']}")
    if output is None:
        click.echo("With -o PLAN.toml the whole plan goes to a file.")
        return
    click.echo("All of it, from Python or as the [plan] of a session.toml for 'gonio import':")
    click.echo(f"  {output}: Plan(**tomllib.load(file)['plan']) for gonio.simulate(..., plan=plan)")


def _line(name: str, figures: Iterable[str], source: str, at: str) -> str:
    numbers = "".join(f"{text:>10}" for text in figures)
    return f"{name:<10}{numbers}  {source:<20}{at}".rstrip()


def _percent(u: float | None, value: float) -> str:
    if u is None:
        return "?"
    return f"{100 * u / abs(value):.3g}" if value else f"{u:.3g}"


def _say(text: str) -> None:
    click.echo(textwrap.fill(text, 90, subsequent_indent="  ", break_long_words=False))
