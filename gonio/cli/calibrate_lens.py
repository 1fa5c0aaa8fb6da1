"""`gonio calibrate lens`: photographs of a board -> the lens with its covariance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.boards import board_options, chosen_board
from gonio.cli.inputs import require_photos
from gonio.errors import ConfigurationError, DataError

if TYPE_CHECKING:
    from gonio.calibration.lens.from_photos import LensFromPhotos

_PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"}


@click.command(name="lens")
@click.argument(
    "photos", metavar="PHOTO...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="LENS.toml",
    type=click.Path(path_type=Path),
    help="File to write, .toml or .json.",
)
@click.option(
    "--pitch-um",
    required=True,
    metavar="X[,Y]",
    help="Pixel pitch of the photographs.",
)
@board_options
@click.option(
    "--frame-binning",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    metavar="N",
    help="Binning: N x N pixels of the photographs make one pixel of the frames.",
)
@click.option(
    "--field-deg",
    type=click.FloatRange(min=30, max=300),
    default=180.0,
    show_default=True,
    metavar="DEG",
    help="Full field of view of the lens, at the edge of the image circle.",
)
@click.option("--fit-aspect", is_flag=True, help="Also fit the ratio of the two pixel pitches.")
@click.option(
    "--map",
    "picture",
    metavar="RESIDUALS.png",
    type=click.Path(path_type=Path),
    help="Write a plot of the residuals, .png, .pdf or .svg.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    photos: tuple[Path, ...],
    output: Path,
    pitch_um: str,
    kind: str,
    squares: str,
    square_mm: float,
    marker_mm: float | None,
    dictionary: str,
    frame_binning: int,
    field_deg: float,
    fit_aspect: bool,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Fit a fisheye lens to photographs of a board, in the axes and pixels of raw frames.

    PHOTO is an image file or a folder of image files. Take 15 to 30 photographs with the readout
    window of the frames; do not flip or crop them. Show the board in all parts of the field,
    including the rim, and tilted. The lens model is that of Kannala and Brandt. The output compares
    it with calibrations of the same corners by OpenCV.
    """
    from gonio.cli.options import check_target
    from gonio.cli.progress import progress

    paths = _pictures(photos)
    require_photos(paths)
    from gonio.calibration.lens import lens_file

    lens_file.check_suffix(output)
    check_target(output)
    board = chosen_board(kind, squares, square_mm, marker_mm, dictionary)
    pitch_mm = _pitch_mm(pitch_um)
    _check_picture(picture)
    from gonio.calibration.lens.cross_check import cross_check
    from gonio.calibration.lens.from_photos import calibrate_lens

    with progress(f"finding the board in {len(paths)} photographs", "readings") as callback:
        calibrated = calibrate_lens(
            paths,
            board,
            pitch_mm=pitch_mm,
            field_deg=field_deg,
            free_ratio=fit_aspect,
            progress=callback,
        )
    checks = cross_check(calibrated.fit, calibrated.shape)
    content = lens_file.document(calibrated, checks, frame_binning=frame_binning)
    lens_file.write(output, content)
    if picture is not None:
        _draw(calibrated, picture)
    for warning in calibrated.warnings():
        click.echo(f"Warning: {warning}", err=True)
    _print(content, calibrated, output, as_json)


def _pictures(given: tuple[Path, ...]) -> list[Path]:
    """The given files, and the image files in the given folders."""
    paths: list[Path] = []
    for path in given:
        if not path.is_dir():
            paths.append(path)
            continue
        inside = sorted(each for each in path.iterdir() if each.suffix.lower() in _PICTURES)
        if not inside:
            raise DataError(f"{path}: the folder holds no pictures.", value=path)
        paths += inside
    return paths


def _pitch_mm(text: str) -> tuple[float, float]:
    try:
        pitches = [float(word) for word in text.split(",")]
    except ValueError:
        pitches = []
    if len(pitches) not in (1, 2) or not all(0 < pitch < 1000 for pitch in pitches):
        raise ConfigurationError(
            f"--pitch-um {text!r} is not a pitch in micrometres such as 3.45 or 3.45,3.45.",
            value=text,
        )
    return pitches[0] * 1e-3, pitches[-1] * 1e-3


def _check_picture(picture: Path | None) -> None:
    """Refuse, before the computation, an output file that cannot be written."""
    if picture is None:
        return
    from gonio.cli.options import check_target
    from gonio.plotting.style import format_of

    format_of(picture)
    check_target(picture)


def _draw(calibrated: LensFromPhotos, picture: Path) -> None:
    from gonio.plotting import save
    from gonio.plotting.lens import residual_map

    save(residual_map(calibrated), picture)
    click.echo(f"written to {picture}", err=True)


def _print(
    content: dict[str, Any], calibrated: LensFromPhotos, output: Path, as_json: bool
) -> None:
    from gonio.cli.options import echo_json

    if as_json:
        echo_json({**content, "output": str(output)})
        return
    _show_figures(content)
    _show_angles(content)
    fit = content["fit"]
    for name, why in calibrated.dropped.items():
        click.echo(f"not used: {name}: {why}.")
    dropped = f", {fit['n_outliers']} more left out as outliers" if fit["n_outliers"] else ""
    click.echo(
        f"{output}: {fit['n_used']} of {fit['n_photos']} photographs, {fit['n_corners']} corners"
        f"{dropped}, rms {fit['rms_px']:.3f} px, to theta = {fit['theta_reached_deg']:.1f} deg."
    )


def _show_figures(content: dict[str, Any]) -> None:
    from rich.table import Table

    from gonio.cli.options import table_console

    lens, fit = content["lens"], content["fit"]
    values = [lens["focal_length_mm"], *lens["k"], *lens["centre_px"]]
    variances = lens["uncertain"]["covariance"]
    units = {"focal_length": "mm", "centre_x": "px", "centre_y": "px"}
    table = Table("figure", "value", "std. uncertainty", "unit")
    for k, (name, value) in enumerate(zip(lens["uncertain"]["names"], values, strict=True)):
        sd = variances[k][k] ** 0.5
        table.add_row(name, f"{value:.6f}", f"{sd:.2g}", units.get(name, ""))
    table_console().print(table)
    if fit["frame_binning"] > 1:
        rows, columns = content["frame"]["rows"], content["frame"]["columns"]
        click.echo(f"The centre is in pixels of the frames, {columns} x {rows}.")
    click.echo(f"Pitch of the photographs' pixels: {_listed(fit['pitch_um'], '.5g')} um.")


def _show_angles(content: dict[str, Any]) -> None:
    fit = content["fit"]
    click.echo(
        f"Standard uncertainty of theta at {_listed(fit['theta_deg'], 'g')} deg: "
        f"{_listed(fit['theta_sd_deg'], '.2g')} deg."
    )
    for check in fit["cross_check"]:
        if "failure" in check:
            click.echo(f"{check['name']}: failed ({check['failure']}).")
            continue
        click.echo(
            f"{check['name']}: rms {check['rms_px']:.3f} px; to theta = "
            f"{_listed(check['theta_to_deg'], 'g')} deg it differs by up to "
            f"{_listed(check['theta_difference_deg'], '.2g')} deg."
        )


def _listed(numbers: list[float], form: str) -> str:
    return ", ".join(format(number, form) for number in numbers)
