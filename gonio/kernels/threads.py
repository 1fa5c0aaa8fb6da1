"""Run compiled loops on slices in a few threads, with results that do not depend on how many."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

BLOCK = 8192


def default_threads() -> int:
    """Threads to use: `GONIO_THREADS` where set, else the cores this process may run on."""
    setting = os.environ.get("GONIO_THREADS", "")
    if setting.isdigit() and int(setting) > 0:
        return int(setting)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def pair_block(n: int, threads: int, *, costly: bool = False) -> int:
    """Block for `map_blocks` of n pairs of directions that a closed formula takes 1 to 100 ns each.

    All of them for one thread; for several a few blocks each, of which none is so small that
    starting threads takes longer than the work. A model that is `costly` takes 1000 times longer:
    small blocks balance the work, and an interrupt takes effect between them.

    Examples
    --------
    >>> pair_block(1_000_000, 1), pair_block(1_000_000, 2), pair_block(20_000, 2)
    (1000000, 125000, 65536)
    >>> pair_block(20_000, 2, costly=True)
    512
    """
    if costly:
        return 512
    return max(n, 1) if threads == 1 else max(n // (4 * threads), 8 * BLOCK)


def map_blocks(
    work: Callable[[int, int], object],
    n: int,
    *,
    threads: int | None = None,
    block: int = BLOCK,
) -> None:
    """Call `work(start, stop)` for consecutive blocks that cover range(n).

    The blocks are the same whatever the number of threads, and each call must touch only its own
    slice of the outputs, so one thread and many give the same bits.

    Examples
    --------
    >>> blocks = []
    >>> map_blocks(lambda a, b: blocks.append((a, b)), 5, threads=1, block=2)
    >>> blocks
    [(0, 2), (2, 4), (4, 5)]
    """
    if 0 < n <= block:
        work(0, n)
        return
    bounds = [(start, min(start + block, n)) for start in range(0, n, block)]
    threads = threads or default_threads()
    if threads == 1 or len(bounds) < 2:
        for start, stop in bounds:
            work(start, stop)
        return
    with ThreadPoolExecutor(threads) as pool:
        for done in [pool.submit(work, start, stop) for start, stop in bounds]:
            done.result()
