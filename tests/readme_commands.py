"""Run the commands of README.md as a reader would, one after the other in an empty folder.

Takes every fenced block marked `console` (lines that begin with `$ ` are commands, the rest is
output) or `sh` (every line is a command). A backslash at the end of a line and a here-document
continue a command. Output that is shown must be what the command prints; a line `...` stands for
any number of lines. Stops at the first failure:

    .venv/bin/python tests/readme_commands.py
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 600  # seconds for one command

# Set-up, which is done when this script runs.
DONE_BEFORE = re.compile(r"(git clone|cd|apt-get install|sudo apt-get install|source|\.) ")
HERE_DOCUMENT = re.compile(r"<<-?\s*['\"]?(\w+)['\"]?")


def blocks(markdown: str) -> Iterator[tuple[str, list[str]]]:
    """Language and lines of each fenced block.

    Examples
    --------
    >>> list(blocks("text\\n```sh\\nls\\n```\\n"))
    [('sh', ['ls'])]
    """
    for match in re.finditer(r"^```(\w*)[^\n]*\n(.*?)^```", markdown, re.MULTILINE | re.DOTALL):
        yield match[1], match[2].splitlines()


def commands(markdown: str) -> Iterator[str]:
    """Every command of the `console` and `sh` blocks, in order."""
    for command, _ in steps(markdown):
        yield command


def steps(markdown: str) -> Iterator[tuple[str, list[str]]]:
    """Every command of the `console` and `sh` blocks with the lines of output below it.

    Examples
    --------
    >>> list(steps("```console\\n$ echo 1\\n1\\n$ true\\n```\\n"))
    [('echo 1', ['1']), ('true', [])]
    """
    for language, given in blocks(markdown):
        if language not in {"console", "sh"}:
            continue
        lines = iter(given)
        found: list[tuple[str, list[str]]] = []
        for line in lines:
            if language == "console":
                if not line.startswith("$ "):
                    if found:
                        found[-1][1].append(line)
                    continue
                line = line.removeprefix("$ ")
            if not line.strip() or line.lstrip().startswith("#"):
                continue
            command = [line]
            while command[-1].endswith("\\"):
                command.append(next(lines))
            if end := HERE_DOCUMENT.search(line):
                while command[-1].strip() != end[1]:
                    command.append(next(lines))
            found.append(("\n".join(command), []))
        yield from found


def unlike(shown: Sequence[str], printed: str) -> str | None:
    """The first line that is shown and not printed in its place; None where all are.

    Blanks at the end of a line and empty lines do not count.

    Examples
    --------
    >>> unlike(["a", "...", "c"], "a\\nb\\nc\\n"), unlike(["a", "c"], "a\\nb\\nc\\n")
    (None, 'c')
    """
    lines = [line.rstrip() for line in printed.splitlines() if line.strip()]
    wanted = [line.rstrip() for line in shown if line.strip()]
    at, skip = 0, False
    for line in wanted:
        if line == "...":
            skip = True
            continue
        rest = lines[at:] if skip else lines[at : at + 1]
        if line not in rest:
            return line
        at += rest.index(line) + 1
        skip = False
    return None if skip or at == len(lines) or not wanted else f"the end, before {lines[at]!r}"


def main() -> int:
    found = list(steps((ROOT / "README.md").read_text(encoding="utf-8")))
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    run = 0
    with tempfile.TemporaryDirectory() as folder:
        for command, shown in found:
            if DONE_BEFORE.match(command):
                print(f"-- skipped: {command}", flush=True)
                continue
            print(f"$ {command}", flush=True)
            # make is run for itself where nothing is shown; it is enough that its targets exist.
            is_make = command.split()[0] == "make"
            dry = is_make and not shown
            start = time.monotonic()
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", f"{command} --dry-run" if dry else command],
                cwd=ROOT if is_make else folder,
                env={**os.environ, "PATH": path},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=LIMIT,
                check=False,
            )
            print(f"{'' if dry else done.stdout}-- {time.monotonic() - start:.1f} s", flush=True)
            if done.returncode != 0:
                print(f"README.md: exit code {done.returncode} from: {command}", file=sys.stderr)
                return 1
            if (line := unlike(shown, done.stdout)) is not None:
                print(f"README.md shows what is not printed: {line}", file=sys.stderr)
                return 1
            run += not dry
    if run == 0:
        print("README.md: no command to run in a `console` or `sh` block.", file=sys.stderr)
        return 1
    print(f"README.md: {run} commands ran.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
