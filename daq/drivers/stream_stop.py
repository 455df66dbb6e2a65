"""Stop of a stream: the stop command is repeated until no byte has arrived for a while."""

from __future__ import annotations

from daq.drivers.contract import Talk

_TRIES, _TRY_S, _QUIET_S = 3, 1.0, 0.1  # seconds


def stop_stream(talk: Talk, order: bytes) -> bool:
    """Send a device the command that stops its stream, up to three times.

    A host that was killed leaves its sensor streaming. The bytes of that stream do not belong to the new recording.

    Args:
        order: bytes of the stop command.

    Returns:
        Whether the line has become silent.

    Raises:
        LinkLost: the connection to the device is lost.
    """
    clock = talk.clock
    for _ in range(_TRIES):
        talk.send(order)
        count, since = talk.bytes_in, clock.wall_s()
        deadline = since + _TRY_S
        while clock.wall_s() < deadline:
            clock.wait(_QUIET_S / 10)
            if talk.bytes_in != count:
                count, since = talk.bytes_in, clock.wall_s()
            elif clock.wall_s() - since > _QUIET_S:
                return True
    return False
