"""Run the commands of README.md as a reader would, one after the other in an empty folder.

Takes every fenced block marked `console` (lines that begin with `$ ` are commands, the rest is
output) or `sh` (every line is a command). A backslash at the end of a line and a here-document
continue a command. Stops at the first failure:

    .venv/bin/python tests/readme_commands.py
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
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
    for language, given in blocks(markdown):
        if language not in {"console", "sh"}:
            continue
        lines = iter(given)
        for line in lines:
            if language == "console":
                if not line.startswith("$ "):
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
            yield "\n".join(command)


def main() -> int:
    found = list(commands((ROOT / "README.md").read_text(encoding="utf-8")))
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    run = 0
    with tempfile.TemporaryDirectory() as folder:
        for command in found:
            if DONE_BEFORE.match(command):
                print(f"-- skipped: {command}", flush=True)
                continue
            print(f"$ {command}", flush=True)
            # make is run for itself; here it is enough that its targets exist.
            is_make = command.split()[0] == "make"
            start = time.monotonic()
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", f"{command} --dry-run" if is_make else command],
                cwd=ROOT if is_make else folder,
                env={**os.environ, "PATH": path},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL if is_make else None,
                timeout=LIMIT,
                check=False,
            )
            print(f"-- {time.monotonic() - start:.1f} s", flush=True)
            if done.returncode != 0:
                print(f"README.md: exit code {done.returncode} from: {command}", file=sys.stderr)
                return 1
            run += not is_make
    if run == 0:
        print("README.md: no command to run in a `console` or `sh` block.", file=sys.stderr)
        return 1
    print(f"README.md: {run} commands ran.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
