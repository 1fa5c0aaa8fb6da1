"""Compiled loops over a scalar reflectance kernel, and the cache that keeps them between runs."""

from gonio.kernels.build import Loops, loops_for
from gonio.kernels.threads import default_threads, map_blocks

__all__ = ["Loops", "default_threads", "loops_for", "map_blocks"]
