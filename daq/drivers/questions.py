"""Questions of a dialogue: a request is repeated until a fitting reply arrives.

Stop of a stream: the stop command is repeated until no byte has arrived for a while.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from typing import TypeVar

from daq.drivers.contract import Talk

ANSWER_S, TRIES = 0.5, 3
"""Usual time within which a device answers, s, and number of times that a request is sent."""
_Found = TypeVar("_Found")


def drop_replies(talk: Talk) -> None:
    """Drop the replies that have arrived: they belong to no request to come."""
    while not talk.replies.empty():
        talk.replies.get_nowait()


def replies_within(talk: Talk, seconds: float) -> Iterator[str]:
    """Yield the replies that arrive within a number of seconds."""
    deadline = talk.clock.now_s() + seconds
    while (left := deadline - talk.clock.now_s()) > 0:
        try:
            reply = talk.replies.get(timeout=left)
        except queue.Empty:  # usual: no further reply in time
            return
        yield reply


def ask(
    talk: Talk,
    request: bytes,
    found_in: Callable[[str], _Found | None],
    seconds: float | None = None,
    tries: int = TRIES,
) -> _Found | None:
    """Send a request until it is answered.

    Args:
        talk: the open device.
        request: the request.
        found_in: returns what a reply answers; None for a reply to something else. It may raise.
        seconds: time within which an answer arrives, s; None: `ANSWER_S`.
        tries: number of times that the request is sent.

    Returns:
        What `found_in` returned; None without an answer.

    Raises:
        LinkLost: the connection to the device is lost.
    """
    drop_replies(talk)
    for _ in range(tries):
        talk.send(request)
        for reply in replies_within(talk, ANSWER_S if seconds is None else seconds):
            if (found := found_in(reply)) is not None:
                return found
    return None


_TRY_S, _QUIET_S = 1.0, 0.1  # seconds


def stop_stream(talk: Talk, command: bytes) -> bool:
    """Send a device the command that stops its stream, up to three times.

    A host that was killed leaves its sensor streaming. The bytes of that stream do not belong to the new recording.

    Args:
        command: bytes of the stop command.

    Returns:
        Whether the line has become silent.

    Raises:
        LinkLost: the connection to the device is lost.
    """
    clock = talk.clock
    for _ in range(TRIES):
        talk.send(command)
        count, since = talk.bytes_in, clock.now_s()
        deadline = since + _TRY_S
        while clock.now_s() < deadline:
            clock.wait(_QUIET_S / 10)
            if talk.bytes_in != count:
                count, since = talk.bytes_in, clock.now_s()
            elif clock.now_s() - since > _QUIET_S:
                return True
    return False
