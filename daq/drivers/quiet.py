# pyright: strict
"""Silence on a line: a device that streams is ordered to stop, until nothing has come for a while."""

from __future__ import annotations

from daq.drivers.contract import Talk

_TRIES, _TRY_S, _QUIET_S = 3, 1.0, 0.1  # wall seconds


def run_dry(talk: Talk, order: bytes) -> bool:
    """Order a device to stop its stream, up to three times; whether its line has run dry.

    A host that was killed leaves its sensor streaming. What still comes of that stream belongs to no recording of ours.

    Args:
        order: the bytes that stop it.

    Raises:
        LinkLost: it is gone.
    """
    clock = talk.clock
    for _ in range(_TRIES):
        talk.send(order)
        seen, since = talk.bytes_in, clock.wall_s()
        deadline = since + _TRY_S
        while clock.wall_s() < deadline:
            clock.wait(_QUIET_S / 10)
            if talk.bytes_in != seen:
                seen, since = talk.bytes_in, clock.wall_s()
            elif clock.wall_s() - since > _QUIET_S:
                return True
    return False
