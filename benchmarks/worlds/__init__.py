"""An independent laboratory: true rigs drawn around a rig file, and their campaigns recorded.

    world = draw_world(seed)                 # benchmarks.worlds.world: what is true
    run = record(world, seed, "point-C")     # benchmarks.worlds.recording: what was recorded

The motion comes from benchmarks.worlds.motion, which shares no line with the packages under test.
"""

from benchmarks.worlds.recording import campaign_tests, record
from benchmarks.worlds.world import Effects, Spread, World, draw_world, with_effect

__all__ = ["Effects", "Spread", "World", "campaign_tests", "draw_world", "record", "with_effect"]
