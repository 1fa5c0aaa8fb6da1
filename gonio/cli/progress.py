"""Progress of long commands on stderr: a line at the start, one at the end, a bar between."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from typing import TYPE_CHECKING

import rich_click as click

if TYPE_CHECKING:
    from gonio.progress import Stage


@contextmanager
def progress(doing: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A callback (done, total) that shows how far the work is.

    Parameters
    ----------
    doing : str
        The work, as the beginning of the line: "simulating rolled_brass".
    unit : str
        The counted things, in the plural.

    Notes
    -----
    Nothing is written to stdout. One line marks the start and one the end; between them a terminal
    shows a bar. After an error or an interruption there is no end line.
    """
    click.echo(f"{doing} ...", err=True)
    start = time.monotonic()
    last: tuple[int, int] | None = None

    def callback(done: int, total: int) -> None:
        nonlocal last
        last = (done, total)
        show(done, total)

    with _bar(unit) if sys.stderr.isatty() else nullcontext(_nothing) as show:
        yield callback
    if last is not None:
        seconds = time.monotonic() - start
        click.echo(f"{doing}: {last[0]} of {last[1]} {unit} in {seconds:.1f} s", err=True)


@contextmanager
def stages() -> Iterator[Callable[[Stage, int, int], None]]:
    """A callback (stage, done, total) that shows the stages of the work one after the other.

    A stage ends when all of it is done; the next one begins with its first call.
    """
    current: Stage | None = None
    show: Callable[[int, int], None] = _nothing

    with ExitStack() as stack:

        def callback(stage: Stage, done: int, total: int) -> None:
            nonlocal current, show
            if stage != current:
                stack.close()
                show = stack.enter_context(progress(stage.doing, stage.unit))
                current = stage
            if total:
                show(done, total)
            if 0 < total <= done:
                stack.close()
                current = None

        yield callback


def _nothing(done: int, total: int) -> None:
    """Show nothing, to keep the log of a batch job short."""


@contextmanager
def _bar(unit: str) -> Iterator[Callable[[int, int], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(bar_width=30),
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        # No total before the first call: the bar moves while rays are traced and code is compiled.
        task = bar.add_task("preparing", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, description=f"{done} of {total} {unit}", completed=done, total=total)

        yield show
