"""A whole rig in one thread, on a clock of its own: the far ends, the acquisition, the operator.

Time passes while somebody waits, and as fast as the machine computes. Everything random comes from the seed, so that a
campaign, with faults placed to the microsecond, is repeatable bit for bit.
"""

from daq.lockstep.rehearsal import Rehearsal

__all__ = ["Rehearsal"]
