"""The command `gonio`: one file of this folder is one command, imported when it is run.

Exit codes: 0 success; 1 the result fails its own checks, or gonio has a fault; 2 wrong usage or
configuration; 3 unusable data; 4 interrupted: the same command continues.
"""

from __future__ import annotations

import errno
import importlib
import os
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

import rich_click as click

from gonio import progress
from gonio._version import __version__
from gonio.errors import GonioError, SessionInterruptedError, unknown_name

# In the order of the work. The help of the group comes from here and imports no command.
_COMMANDS = {
    "design": "Choose which images to take for a wanted precision.",
    "simulate": "Record the raw frames of a surface on a virtual instrument.",
    "import": "Make a session of a camera's files.",
    "reduce": "Turn raw frames into BRDF samples with uncertainties.",
    "fit": "Fit a reflectance model to BRDF samples.",
    "compare": "Tell which of several models BRDF samples prefer.",
    "plot": "Draw BRDF samples or a fit.",
    "report": "Write a fit as one HTML page.",
    "render": "Draw a simple scene of one material.",
    "evaluate": "Evaluate a model at the directions of a file.",
    "budget": "List where the uncertainty of the samples comes from.",
    "check": "Check a model or a file: reciprocity, energy, which quantity.",
    "calibrate": "Calibrate a rig from photographs and frames taken for it.",
    "flats": "Record flat and dark frames of a virtual camera.",
    "boards": "Photograph a calibration board virtually, or print it.",
    "materials": "List the papers' materials, or show one.",
    "models": "List the reflectance models, or show one.",
    "instruments": "List the virtual instruments, or show one.",
    "doctor": "Check this installation.",
}
# Where the command's file cannot have its name, a word of Python.
_FILES = {"import": "import_session"}


class _Commands(click.RichGroup):
    """The group of all commands; a command's module is imported when the command is run."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        # Help and completion ask for every command in turn: a name and one line serve them.
        if cmd_name not in _COMMANDS:
            return None
        return click.RichCommand(name=cmd_name, help=_COMMANDS[cmd_name])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, *rest = args
        if name.startswith("-"):
            return super().resolve_command(ctx, args)
        if name not in _COMMANDS:
            raise click.UsageError(str(unknown_name("command", name, _COMMANDS)), ctx)
        file = _FILES.get(name, name)
        command: click.Command = importlib.import_module(f"gonio.cli.{file}").command
        return name, command, rest


@click.group(
    name="gonio",
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="gonio", message="%(prog)s %(version)s")
@click.pass_context
def group(ctx: click.Context) -> None:
    """A virtual imaging gonioreflectometer and a BRDF fitting toolkit.

    simulate records raw frames, reduce turns them into BRDF samples, fit estimates the parameters
    of a reflectance model. 'gonio COMMAND --help' describes a command.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        ctx.exit(2)


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code.

    Parameters
    ----------
    args : sequence of str, optional
        Arguments after `gonio`; those of this process by default.
    """
    code = _run(args)
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has gone. Python would flush once more at exit and complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = code or 1
    sys.exit(code)


def _run(args: Sequence[str] | None) -> int:
    """Exit code of a run; errors become one sentence on stderr."""
    progress.on_compiling = _say
    try:
        code = group.main(args, prog_name="gonio", standalone_mode=False)
    except GonioError as error:
        return _print_error(error)
    except click.ClickException as error:
        return _print_usage(error)
    except (click.Abort, KeyboardInterrupt):
        return _print_error(SessionInterruptedError("interrupted; run the same command again."))
    except OSError as error:
        return _print_system_error(error)
    except Exception as error:
        return _print_fault(error)
    finally:
        progress.on_compiling = None
    return code if isinstance(code, int) else 0


def _print_error(error: GonioError) -> int:
    _say(str(error) if isinstance(error, SessionInterruptedError) else f"Error: {error}")
    return error.exit_code


def _print_usage(error: click.ClickException) -> int:
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is not None:
        pieces = " ".join(context.command.collect_usage_pieces(context))
        _say(f"Usage: {context.command_path} {pieces}")
        _say(f"Try '{context.command_path} --help' for help.")
    _say(f"Error: {error.format_message()}")
    return error.exit_code


def _print_system_error(error: OSError) -> int:
    """Report an error of the operating system that no part of gonio has turned into its own."""
    if error.errno is None or error.errno == errno.EPIPE:
        return _print_fault(error)
    where = f"{error.filename}: " if error.filename is not None else ""
    _say(f"Error: {where}{error.strerror}.")
    return 3


def _print_fault(error: Exception) -> int:
    if os.environ.get("GONIO_DEBUG") == "1":
        traceback.print_exception(error)
        return 1
    text = " ".join(str(error).split())
    _say(
        f"Error: unexpected {type(error).__name__}{': ' if text else ''}{text}. This is a fault in "
        "gonio: run it again with GONIO_DEBUG=1 and report what it prints, together with the "
        "output of 'gonio doctor'."
    )
    return 1


def _say(text: str) -> None:
    click.echo(text, err=True)
