"""What all benchmarks share: the shortest of several runs, the cores given, a line of a table."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing import get_context

Work = Callable[[], object]


@dataclass(frozen=True)
class Row:
    """One comparison.

    Parameters
    ----------
    name : str
        What was done.
    ours_per_s : float or None
        How often a second; None where it was not measured.
    ratio_to : str
        What it was compared with, in the same run.
    ratio : float or None
        Ours over the other's.
    note : str
        What else one must know.
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


def spin(duration_s: float = 0.5) -> int:
    """Count in a busy loop."""
    count, end = 0, time.perf_counter() + duration_s
    while time.perf_counter() < end:
        count += 1
    return count


def cores() -> float:
    """How many busy loops ran at full speed when one was started on each core."""
    n = os.cpu_count() or 1
    alone = spin()
    if n == 1:
        return 1.0
    with get_context("spawn").Pool(n) as pool:
        pool.map(spin, [0.01] * n, chunksize=1)  # all of them are there
        return sum(pool.map(spin, [0.5] * n, chunksize=1)) / alone
