"""`gonio calibrate`: lens, camera, alignment and dome of a rig."""

from __future__ import annotations

import importlib

import rich_click as click

from gonio.errors import unknown_name

# Each is a file of this folder, calibrate_NAME.py.
_SUBCOMMANDS = ("lens", "camera", "alignment", "dome")


class _Subcommands(click.RichGroup):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_SUBCOMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _SUBCOMMANDS:
            return None
        command: click.Command = importlib.import_module(f"gonio.cli.calibrate_{cmd_name}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in _SUBCOMMANDS and not args[0].startswith("-"):
            raise click.UsageError(str(unknown_name("calibration", args[0], _SUBCOMMANDS)), ctx)
        return super().resolve_command(ctx, args)


@click.group(name="calibrate", cls=_Subcommands)
def command() -> None:
    """Calibrate the lens, the camera, the alignment or the dome of a rig."""
