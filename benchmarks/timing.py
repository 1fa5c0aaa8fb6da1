"""Tools of all benchmarks: the shortest of several runs, available cores, a line of a table."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Work = Callable[[], object]

SPIN = """
import sys, time
start, duration = map(float, sys.argv[1:])
time.sleep(max(0.0, start - time.time()))
count = 0
while time.time() < start + duration:
    count += 1
print(count)
"""


@dataclass(frozen=True)
class Row:
    """One comparison.

    Parameters
    ----------
    name : str
        The work that was timed.
    ours_per_s : float or None
        How often a second; None where it was not measured.
    ratio_to : str
        The peer that it was compared with, in the same run.
    ratio : float or None
        Ours over the other's.
    note : str
        Remark on the comparison.
    """

    name: str
    ours_per_s: float | None
    ratio_to: str
    ratio: float | None
    note: str = ""


def best(work: Work, rounds: int = 7) -> float:
    """Shortest of several runs, s, after one to warm up."""
    work()
    return min(seconds(work) for _ in range(rounds))


def best_in_turn(works: Mapping[str, Work], rounds: int = 7) -> dict[str, float]:
    """`best` of several pieces of work, which take turns: what disturbs one disturbs all."""
    for work in works.values():
        work()
    times = [{name: seconds(work) for name, work in works.items()} for _ in range(rounds)]
    return {name: min(each[name] for each in times) for name in works}


def seconds(work: Work) -> float:
    """Seconds of one run by the clock."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def cores() -> float:
    """How many busy loops ran at full speed when one was started on each core."""
    alone, together = spins(1), spins(os.cpu_count() or 1)
    # The fastest one shows the speed of a core without other load.
    return sum(together) / max(alone + together)


def spins(n: int) -> list[int]:
    """How far n processes count that start to do so at the same time."""
    start = time.time() + 0.5  # all of them are there
    command = [sys.executable, "-c", SPIN, str(start), "0.5"]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(n)]
    return [int(each.communicate()[0]) for each in running]
