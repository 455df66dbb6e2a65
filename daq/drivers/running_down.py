# pyright: strict
"""The wait for a rotor that was ordered to stop: as long as it grows slower, or runs down by itself."""

from __future__ import annotations

import math
from collections.abc import Callable

from daq.drivers.contract import RotorGuard
from daq.errors import LinkLost
from daq.transports.host_clock import HostClock

_RUN_DOWN_S = 60.0  # rig seconds a rotor without torque may take
_NO_SLOWER_S = 5.0  # wall seconds after which a rotor that grows no slower is given up
_MISSES, _AGAIN_S = 3, 0.05  # orders that may not be taken; wall seconds until the next one then
_REPEAT_S, _SAY_EVERY_S = 0.25, 2.0  # wall seconds between two orders, between two words about the wait


def runs_down(clock: HostClock, rotor: RotorGuard, order: Callable[[], None], told: Callable[[str], None]) -> bool:
    """Order the rotor to stop until it stands; whether it does.

    Args:
        clock: for the waits.
        rotor: whether it stands, and its speed.
        order: orders it to stop; repeated, as one frame may be lost.
        told: called with what is being waited for.

    Raises:
        LinkLost: no order goes out any more.
    """
    begun = slower = said = clock.wall_s()
    next_order, least, missed = begun, math.inf, 0
    while not (rest := rotor.at_rest()):
        now, speed = clock.wall_s(), rotor.speed_rpm()
        if not speed > least - 1.0:  # also where no device reports it: index marks alone decide then
            slower, least = now, speed
        too_long = now - begun > clock.wall(_RUN_DOWN_S) or now - slower > _NO_SLOWER_S
        if too_long or (rest is None and now - begun > _NO_SLOWER_S):
            return False
        if now >= next_order:
            next_order = now + _REPEAT_S
            try:
                order()
            except LinkLost:  # one frame that was not taken; or the line is gone
                missed += 1
                if missed > _MISSES:
                    raise
                next_order = now + _AGAIN_S
        if now - said > _SAY_EVERY_S:
            told("waiting for the rotor to stop" + ("" if math.isnan(speed) else f", {speed:.0f} rpm"))
            said = now
        clock.wait(0.01)
    return True
