"""An independent laboratory: true rigs drawn around a rig file, and their campaigns recorded.

    world = draw_world(seed)                 # benchmarks.worlds.world: what is true
    run = record(world, seed, "point-C")     # benchmarks.worlds.recording: what was recorded

The motion comes from benchmarks.worlds.motion, which shares no line with the packages under test.
"""

from benchmarks.worlds.recording import record, tests_of
from benchmarks.worlds.world import Effects, Spread, World, draw_world, with_effect

__all__ = ["Effects", "Spread", "World", "draw_world", "record", "tests_of", "with_effect"]
