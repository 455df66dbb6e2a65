"""A complete virtual rig in one thread on a simulated clock: far ends, acquisition and operator.

Time advances during waits, as fast as the machine computes. All random numbers come from the seed, so that a campaign
with faults at given microseconds is repeatable bit for bit.
"""

from daq.lockstep.rehearsal import Rehearsal

__all__ = ["Rehearsal"]
