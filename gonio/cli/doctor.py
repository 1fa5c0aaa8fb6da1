"""`gonio doctor`: versions of this installation, and a test whether it works."""

from __future__ import annotations

import sys
from typing import Any

import rich_click as click

from gonio.verbs.doctor import doctor


@click.command(name="doctor")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.pass_context
def command(ctx: click.Context, as_json: bool) -> None:
    """Check this installation: versions, cores, cache, and two computations.

    The exit code is 1 if a dependency is missing or a computation is wrong.
    """
    from gonio.cli.options import echo_json

    report = doctor()
    if as_json:
        echo_json(report)
    else:
        _show(report)
    ctx.exit(0 if report["ok"] else 1)


def _show(report: dict[str, Any]) -> None:
    versions = [
        ("gonio", report["gonio"]),
        ("Python", f"{report['python']} on {report['platform']}"),
        ("run by", sys.executable),
    ]
    for label, text in versions:
        _line(label, text)
    for name, version in report["dependencies"].items():
        _line(f"  {name}", version or "MISSING; install gonio again with its dependencies")
    for name, extra in report["extras"].items():
        installed = [
            f"{package} {version}" for package, version in extra["packages"].items() if version
        ]
        state = ", ".join(installed) if extra["installed"] else f"not installed; {extra['install']}"
        _line(f"extra {name}", f"for {extra['for']}: {state}")
    _line("cores", f"{report['cores']} for this process")
    if report["threads"] is not None:
        _line("threads", f"{report['threads']} (set GONIO_THREADS to change)")
    if report["cache"] is not None:
        state = (
            "can be written"
            if report["cache"]["writable"]
            else "CANNOT be written, code is compiled anew each time; set GONIO_CACHE_DIR"
        )
        _line("cache", f"{report['cache']['folder']}: {state}")
    for check in report["checks"]:
        _line("pass" if check["ok"] else "FAIL", f"{check['check']}: {check['detail']}")
    click.echo("Everything works." if report["ok"] else "Something is wrong: see above.")


def _line(label: str, text: str) -> None:
    click.echo(f"{label:<14} {text}")
