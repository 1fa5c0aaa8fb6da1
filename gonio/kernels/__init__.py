"""Compiled loops over a scalar reflectance kernel, and the cache that keeps them between runs."""

from gonio.kernels.build import (
    loops_for,
    moment_loops_for,
    single_loops_for,
    texel_loops_for,
)
from gonio.kernels.loops import Loops
from gonio.kernels.moments import MomentLoops
from gonio.kernels.pairs import PairLoops
from gonio.kernels.texels import TexelLoops
from gonio.kernels.threads import default_threads, map_blocks, pair_block

__all__ = [
    "Loops",
    "MomentLoops",
    "PairLoops",
    "TexelLoops",
    "default_threads",
    "loops_for",
    "map_blocks",
    "moment_loops_for",
    "pair_block",
    "single_loops_for",
    "texel_loops_for",
]
