"""`gonio render`: an image of a simple scene of one material."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_material, complete_model
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.models import Model
    from gonio.rendering import Camera, Light, Scene

LIGHTS = ("directional", "area", "environment")
EDGE = 256  # pixels of the longer edge where no size is given


@click.command(name="render")
@click.argument("scene_name", metavar="SCENE")
@click.option(
    "--model",
    shell_complete=complete_model,
    help="Model: a name of 'gonio models', FILE.py or FILE.py:NAME.",
)
@click.option(
    "--material",
    shell_complete=complete_material,
    help="Named material to use instead of --model; see 'gonio materials'.",
)
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="Value of a parameter of the model, angles in degrees; repeat for each parameter.",
)
@click.option(
    "--light",
    "light_name",
    default="directional",
    show_default=True,
    metavar="|".join(LIGHTS),
    help="Kind of light: a distant lamp, a rectangle that faces the middle of the scene, or "
    "an environment around it.",
)
@click.option(
    "--theta-i",
    type=float,
    metavar="DEG",
    help="Angle of the light from the axis of the scene. The default depends on the scene: "
    "30 above left for the sphere, the viewer's direction for vase and objects.",
)
@click.option(
    "--phi-i",
    type=float,
    metavar="DEG",
    help="Azimuth of the light about the axis: 0 right, 90 above. Default with --theta-i: 0.",
)
@click.option(
    "--irradiance",
    type=float,
    metavar="E",
    help="Irradiance: of a directional light across its beam, of an area light in the middle "
    "of the scene. Default: pi, so that a white surface has radiance 1.",
)
@click.option(
    "--distance",
    type=float,
    default=5.0,
    show_default=True,
    metavar="D",
    help="Distance of an area light, in the unit of the scene: the radius of sphere and vase is 1.",
)
@click.option(
    "--light-size",
    default="1",
    show_default=True,
    metavar="W[xH]",
    help="Width and height of an area light.",
)
@click.option(
    "--map",
    "map_name",
    default="uniform",
    show_default=True,
    metavar="FILE|uniform|overcast|clear",
    help="Environment: .pfm, .hdr, .exr or .npy in latitude and longitude, or a sky by formula; "
    "--theta-i and --phi-i place the sun of 'clear'.",
)
@click.option(
    "--theta-r",
    type=float,
    metavar="DEG",
    help="Angle of the camera from the axis; default: that of the scene.",
)
@click.option(
    "--phi-r",
    type=float,
    metavar="DEG",
    help="Azimuth of the camera: 0 right, 90 above, -90 below. Default with --theta-r: 0.",
)
@click.option(
    "--projection",
    metavar="orthographic|perspective",
    help="Projection of the camera; default: that of the scene, which is perspective for the "
    "plane.",
)
@click.option(
    "--fov",
    type=float,
    default=30.0,
    show_default=True,
    metavar="DEG",
    help="Horizontal field of view in perspective.",
)
@click.option(
    "--turn",
    type=float,
    default=0.0,
    show_default=True,
    metavar="DEG",
    help="Turn the brushed direction, the model's x axis, about the normal. At 0 it goes round "
    "sphere, vase and block, and to the right on a plane.",
)
@click.option("--floor", is_flag=True, help="Add a floor under the scene, on which shadows fall.")
@click.option(
    "--bounces",
    type=int,
    default=0,
    show_default=True,
    metavar="N",
    help="Largest number of reflections between surfaces; 0 is direct light only.",
)
@click.option(
    "--size",
    metavar="W[xH]",
    help=f"Pixels; the shape of the scene where one or none is given, {EDGE} on the longer edge.",
)
@click.option(
    "--samples",
    type=int,
    default=16,
    show_default=True,
    metavar="N",
    help="Number of rays per pixel, a square number.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of the random numbers.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of worker threads; the image does not depend on it.",
)
@click.option(
    "--white",
    type=float,
    metavar="L",
    help="Radiance that a PNG shows as white, on a linear scale; set it for images that are "
    "to be compared. Default: the radiance that 99.5 % of the lit pixels do not exceed; "
    "dark values are raised where a highlight would leave the rest nearly black.",
)
@click.option(
    "-o",
    "--output",
    metavar="OUT.png",
    type=click.Path(path_type=Path),
    help="Image file to write: .png for viewing, or linear radiance as .pfm, .exr or .npy. "
    "Default: SCENE.png.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    scene_name: str,
    model: str | None,
    material: str | None,
    items: tuple[str, ...],
    light_name: str,
    theta_i: float | None,
    phi_i: float | None,
    irradiance: float | None,
    distance: float,
    light_size: str,
    map_name: str,
    theta_r: float | None,
    phi_r: float | None,
    projection: str | None,
    fov: float,
    turn: float,
    floor: bool,
    bounces: int,
    size: str | None,
    samples: int,
    seed: int,
    threads: int | None,
    white: float | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Draw a simple scene of one material: sphere, vase, plane or objects.

    The axis of the scene points to a viewer in front; for the plane it is the normal. Directions of
    light and camera are relative to it: theta is the angle from the axis, phi is 0 to the right and
    90 above. Without --bounces, only light that comes directly from the lamp is drawn. The text of
    a PNG states how radiance was converted to grey values.
    """
    from gonio.cli.options import check_target, echo_json
    from gonio.cli.progress import progress
    from gonio.rendering import render, save_picture, scene, white_of
    from gonio.rendering.pictures import check_name, lift_of

    drawn = scene(scene_name, floor=floor)
    output = Path(f"{scene_name}.png") if output is None else output
    check_target(output)
    suffix = check_name(output)
    _check_white(white, suffix)
    chosen, parameters = _surface(model, material, items)
    at = _direction("i", theta_i, phi_i, drawn.light)
    light = _light(light_name, at, irradiance, distance, light_size, map_name, drawn)
    camera = _camera(drawn, theta_r, phi_r, projection, fov)
    rows, columns = _size(size, drawn)
    with progress(f"rendering {scene_name}", "rows") as callback:
        image = render(
            drawn, light, chosen, parameters, camera=camera, size=(rows, columns),
            samples=samples, turn=math.radians(turn), bounces=bounces, seed=seed, threads=threads,
            progress=callback,
        )  # fmt: skip
    top = white_of(image) if white is None else white
    lift = lift_of(image, top) if white is None else 0.0
    document = {
        "schema": "gonio.rendering/1",
        "scene": scene_name,
        "floor": floor,
        "model": chosen.name,
        "parameters": {
            p.name: float(f"{p.to_file(parameters[p.name]):.15g}") for p in chosen.parameters
        },
        "units": {p.name: p.file_unit for p in chosen.parameters},
        "light": _light_record(light_name, at, irradiance, distance, light_size, map_name),
        "camera": {
            "theta_r_deg": _degrees(camera.theta_r),
            "phi_r_deg": _degrees(camera.phi_r),
            "projection": camera.projection,
            "fov_deg": fov if camera.projection == "perspective" else None,
        },
        "turn_deg": turn,
        "bounces": bounces,
        "size": [columns, rows],
        "samples": samples,
        "seed": seed,
        "white": top if suffix == ".png" else None,
        "lift": lift if suffix == ".png" else None,
    }
    save_picture(image, output, white=top, lift=lift, facts=document)
    document["radiance"] = {
        "max": float(image.max()), "mean": float(image.mean()),
        "clipped": float((image > top).mean()) if suffix == ".png" else None,
    }  # fmt: skip
    document["output"] = str(output)
    if as_json:
        echo_json(document)
    else:
        _print(document, suffix, bounces)


def _print(document: dict[str, Any], suffix: str, bounces: int) -> None:
    from gonio.rendering.pictures import tone_text

    columns, rows = document["size"]
    light = "direct light only" if not bounces else f"light of up to {bounces} bounces as well"
    click.echo(f"{document['output']}: {columns} x {rows} pixels; {light}.")
    if suffix == ".png":
        clipped = 100 * document["radiance"]["clipped"]
        tone = tone_text(document["white"], document["lift"])
        click.echo(f"Tone: {tone}. Clipped: {clipped:.2g} % of the pixels.")
    else:
        click.echo(f"Linear radiance, up to {document['radiance']['max']:.6g}.")


def _check_white(white: float | None, suffix: str) -> None:
    if white is None:
        return
    if suffix != ".png":
        raise ConfigurationError(
            f"--white is the tone of a PNG, and {suffix} keeps linear radiance; leave it out.",
            value=white,
        )
    if not (math.isfinite(white) and white > 0):
        raise ConfigurationError(
            f"--white {white:g}: the radiance that is shown as white must be positive.",
            value=white,
        )


def _surface(
    model: str | None, material: str | None, items: tuple[str, ...]
) -> tuple[Model, dict[str, float]]:
    """The model and all of its parameters, radians for angles."""
    import gonio.materials as materials
    import gonio.models as models
    from gonio.cli.options import file_text, parse_parameters

    if (model is None) == (material is None):
        given = "both were given" if model else "neither was given"
        raise ConfigurationError(f"give --model NAME or --material NAME; {given}.")
    values: dict[str, float] = {}
    if material is not None:
        named = materials.get(material)
        model, values = named.model, dict(named.parameters)
    chosen = models.resolve(str(model))
    values |= parse_parameters(chosen, items)
    left_out = [p for p in chosen.parameters if p.name not in values]
    if left_out:
        defaults = ", ".join(f"{p.name} = {file_text(p, p.default)}" for p in left_out)
        click.echo(f"Default values are used for {defaults}.", err=True)
    return chosen, {**{p.name: p.default for p in left_out}, **values}


def _direction(
    letter: str, theta: float | None, phi: float | None, own: tuple[float, float]
) -> tuple[float, float]:
    """theta and phi in radians; by default those of the scene."""
    if theta is None:
        if phi is not None:
            raise ConfigurationError(
                f"--phi-{letter} goes with --theta-{letter}; give both.", value=phi
            )
        return own
    if not 0 <= theta <= 180:
        raise ConfigurationError(
            f"--theta-{letter} {theta:g}: the angle from the axis of the scene is 0 to 180 deg; "
            f"--phi-{letter} 180 turns to the other side.",
            value=theta,
        )
    return math.radians(theta), math.radians(phi or 0.0)


def _light(
    name: str,
    at: tuple[float, float],
    irradiance: float | None,
    distance: float,
    light_size: str,
    map_name: str,
    drawn: Scene,
) -> Light:
    from gonio.errors import unknown_name
    from gonio.rendering import SKIES, WHITE, Directional, Environment, Rectangle, read_map, sky

    if name not in LIGHTS:
        raise unknown_name("light", name, LIGHTS)
    if irradiance is not None and (name == "environment" or not irradiance > 0):
        what = "an environment has its own radiance" if irradiance > 0 else "it must be positive"
        raise ConfigurationError(f"--irradiance {irradiance:g}: {what}.", value=irradiance)
    power = WHITE if irradiance is None else irradiance
    if name == "directional":
        return Directional(*at, irradiance=power)
    if name == "environment":
        if map_name in SKIES:
            return sky(map_name, *at)
        if not Path(map_name).suffix:
            raise unknown_name("sky", map_name, SKIES)
        return Environment(read_map(map_name))
    width, height = _two("--light-size", light_size, float)
    size = (width, height or width)
    return Rectangle.facing(*at, distance=distance, size=size, irradiance=power)


def _light_record(
    name: str,
    at: tuple[float, float],
    irradiance: float | None,
    distance: float,
    light_size: str,
    map_name: str,
) -> dict[str, Any]:
    """The light as a record for JSON: the settings that apply to its kind."""
    record: dict[str, Any] = {"kind": name}
    if name != "environment" or map_name == "clear":
        record |= {"theta_i_deg": _degrees(at[0]), "phi_i_deg": _degrees(at[1])}
    if name == "environment":
        return record | {"map": map_name}
    record["irradiance"] = math.pi if irradiance is None else irradiance
    if name == "area":
        width, height = _two("--light-size", light_size, float)
        record |= {"distance": distance, "size": [width, height or width]}
    return record


def _camera(
    drawn: Scene,
    theta_r: float | None,
    phi_r: float | None,
    projection: str | None,
    fov: float,
) -> Camera:
    from gonio.rendering import Camera

    own: Any = projection or drawn.projection
    return Camera(*_direction("r", theta_r, phi_r, drawn.view), own, math.radians(fov))


def _size(text: str | None, drawn: Scene) -> tuple[int, int]:
    """Rows and columns."""
    wide, high = drawn.extent
    if text is None:
        scale = EDGE / max(wide, high)
        return round(high * scale), round(wide * scale)
    columns, rows = _two("--size", text, int)
    return int(rows or max(1, round(columns * high / wide))), int(columns)


def _two(option: str, text: str, kind: type[int] | type[float]) -> tuple[float, float | None]:
    """One number, or two separated by x."""
    try:
        numbers = [kind(word) for word in text.lower().split("x")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 2 or not all(number > 0 for number in numbers):
        raise ConfigurationError(
            f"{option} {text!r} is not one positive number or two such as 320x240.", value=text
        )
    return numbers[0], numbers[1] if len(numbers) == 2 else None


def _degrees(angle: float) -> float:
    return float(f"{math.degrees(angle):.12g}")
