"""Compiled loops over a scalar reflectance kernel, and the cache that keeps them between runs."""

from gonio.kernels.build import Loops, SingleLoops, loops_for, single_loops_for
from gonio.kernels.threads import default_threads, map_blocks, pair_block

__all__ = [
    "Loops",
    "SingleLoops",
    "default_threads",
    "loops_for",
    "map_blocks",
    "pair_block",
    "single_loops_for",
]
