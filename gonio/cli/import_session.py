"""`gonio import`: a folder of image files from a laboratory -> a session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import rich_click as click

from gonio.errors import ConfigurationError, DataError, SessionInterruptedError

if TYPE_CHECKING:
    from gonio.rig import Imported

TEMPLATE = "session_template.toml"
DEMO = "demo_rig"


@click.command(name="import")
@click.argument("rig", metavar="[RIG_FOLDER]", required=False, type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="SESSION",
    type=click.Path(path_type=Path),
    help="Folder of the session to create or to continue; with --template, the file to write.",
)
@click.option(
    "--check", is_flag=True, help="Check RIG_FOLDER and its frames without writing anything."
)
@click.option(
    "--template",
    is_flag=True,
    help="Write a session.toml to fill in, with unit and meaning of every key; to stdout "
    "without -o.",
)
@click.option(
    "--demo",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Copy a small example of a rig folder to FOLDER.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of worker threads; the session does not depend on it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def command(
    rig: Path | None,
    output: Path | None,
    check: bool,
    template: bool,
    demo: Path | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Make a session from the image files of a camera.

    RIG_FOLDER holds the file session.toml and the frames. session.toml describes the rig and
    assigns the files to frames. Frames are PNG or TIFF of 8 or 16 bits, float TIFF or EXR, or raw
    files of the camera. Faults are reported file by file. After an interruption, or after files
    were replaced, the same command continues.
    """
    _check_usage(rig, output, check=check, template=template, demo=demo)
    if template:
        _write_template(output)
    elif demo is not None:
        _copy_demo(demo)
    elif rig is not None:
        _import(rig, output, threads, as_json)


def _check_usage(
    rig: Path | None, output: Path | None, *, check: bool, template: bool, demo: Path | None
) -> None:
    """Refuse options that do not go together."""
    if template or demo is not None:
        name = "--template" if template else "--demo"
        others = {"RIG_FOLDER": rig is not None, "--check": check}
        others |= {"--demo": demo is not None} if template else {"-o": output is not None}
        for other, is_given in others.items():
            if is_given:
                raise ConfigurationError(f"{name} stands alone; leave {other} out.")
    elif rig is None:
        raise ConfigurationError(
            "give a RIG_FOLDER; 'gonio import --template' writes the session.toml that belongs "
            "into it, 'gonio import --demo FOLDER' a folder to try."
        )
    elif check == (output is not None):
        given = "both were given" if check else "neither was given"
        raise ConfigurationError(f"give -o SESSION to import or --check to check; {given}.")


def _write_template(output: Path | None) -> None:
    from importlib import resources

    from gonio.cli.options import check_target
    from gonio.files import write_text

    text = (resources.files("gonio.data") / TEMPLATE).read_text("utf-8")
    if output is None:
        click.echo(text, nl=False)
        return
    check_target(output)
    if output.exists():
        raise ConfigurationError(
            f"{output}: exists and is not overwritten; give another name.", value=output
        )
    write_text(output, text)
    click.echo(f"{output}: fill it in, then run 'gonio import --check {output.parent}'.")


def _copy_demo(folder: Path) -> None:
    """Copy the files of the example to `folder`, which must be new or empty."""
    from importlib import resources

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigurationError(
            f"{folder}: exists and is not an empty folder; give another name.", value=folder
        )
    with resources.as_file(resources.files("gonio.data") / DEMO) as source:
        files = sorted(path for path in source.rglob("*") if path.is_file())
        try:
            for path in files:
                target = folder / path.relative_to(source)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(path.read_bytes())
        except OSError as error:
            raise DataError(
                f"{folder}: cannot be written ({error.strerror or error}).", value=folder
            ) from None
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    click.echo(f"{folder}: session.toml and {len(files) - 1} frames, {size / 1e6:.1f} MB.")


def _import(rig: Path, output: Path | None, threads: int | None, as_json: bool) -> None:
    from gonio.cli.inputs import require_rig
    from gonio.cli.progress import progress

    require_rig(rig)
    from gonio.rig import check_frames, import_rig

    name = rig.resolve().name
    try:
        if output is None:
            with progress(f"checking {name}", "frames") as callback:
                imported = check_frames(rig, threads=threads, progress=callback)
        else:
            with progress(f"importing {name}", "frames") as callback:
                imported = import_rig(rig, output, threads=threads, progress=callback)
    except KeyboardInterrupt:
        _interrupted(output)
    _print(imported, rig, output, as_json)
    _stop_at_errors(imported, rig, output)


def _interrupted(output: Path | None) -> NoReturn:
    """Report how many frames are saved, from the manifest on the disk."""
    from gonio.session import Session

    safe = ""
    if output is not None and (output / "session.json").is_file():
        session = Session.open(output)
        safe = f" {session.n_done} of {session.metadata.plan.n_frames} frames are safe in {output}."
    raise SessionInterruptedError(
        f"interrupted; run the same command again to continue.{safe}", value=output
    ) from None


def _print(imported: Imported, rig: Path, output: Path | None, as_json: bool) -> None:
    from gonio.cli.options import echo_json

    if as_json:
        echo_json(_document(imported, rig, output))
        return
    for line in imported.done:
        click.echo(f"- {line}")
    for warning in imported.warnings:
        click.echo(f"warning: {warning}")
    for finding in imported.findings:
        click.echo(f"{finding.severity}: {finding.text}")
    plan, camera = imported.metadata.plan, imported.metadata.camera
    what = f"{plan.n_frames} frames of {camera.columns} x {camera.rows} pixels"
    if output is None:
        fault = any(finding.severity == "error" for finding in imported.findings)
        click.echo(f"{rig}: {what}, {'not' if fault else ''} in order.".replace("  ", " "))
    else:
        before = plan.n_frames - imported.n_new
        added = f", {before} of them from before" if before else ""
        click.echo(f"{output}: {what}{added}.")


def _document(imported: Imported, rig: Path, output: Path | None) -> dict[str, Any]:
    from dataclasses import asdict

    metadata, plan = imported.metadata, imported.metadata.plan
    return {
        "schema": "gonio.import/1",
        "rig": str(rig),
        "session": None if output is None else str(output),
        "sample": metadata.sample,
        "instrument": metadata.instrument,
        "mode": plan.mode,
        "theta_i_deg": list(plan.theta_i_deg),
        "rotations_deg": list(plan.rotations_deg),
        "exposures_s": list(plan.exposures_s),
        "rows": metadata.camera.rows,
        "columns": metadata.camera.columns,
        "frames": plan.n_frames,
        "frames_added": imported.n_new,
        "done": list(imported.done),
        "warnings": list(imported.warnings),
        "findings": [asdict(finding) for finding in imported.findings],
    }


def _stop_at_errors(imported: Imported, rig: Path, output: Path | None) -> None:
    errors = [finding for finding in imported.findings if finding.severity == "error"]
    if errors:
        n = len(errors)
        after = "" if output is None else (
            f" The session is in {output}; after files are replaced the same command reads them "
            "again."
        )  # fmt: skip
        raise DataError(
            f"{rig}: {n} {'error' if n == 1 else 'errors'} in the frames, said above.{after}",
            value=errors,
        )
