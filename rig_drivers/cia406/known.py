"""What the identity from the opening of an encoder states about its reports, checked; a log may contain any value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.errors import DeviceError
from rig_drivers.cia406 import wire
from rig_drivers.cia406.settings import Encoder

_ANY_POSITION = 2**32
_MAX_OFFSET = 8 - wire.POSITION_BYTES


def positions_of(encoder: Encoder, per_turn: int, identity: Mapping[str, Any]) -> int:
    """Return the number of different positions of an encoder; unlimited if it was not queried."""
    positions = identity.get(f"{encoder.name}_positions", _ANY_POSITION)
    if (
        type(positions) is int
        and 0 < positions <= _ANY_POSITION
        and (positions == _ANY_POSITION or positions % per_turn == 0)
    ):
        return positions
    raise DeviceError(
        f"identity of encoder {encoder.name}: expected a number of positions that is a multiple of {per_turn}, got "
        f"{positions!r:.80}"
    )


def sign_of(encoder: Encoder, identity: Mapping[str, Any]) -> int:
    """Return 1 if positions grow with the angle, also of an encoder that was not queried, otherwise -1."""
    counter_clockwise = identity.get(f"{encoder.name}_counter_clockwise", encoder.positive == "ccw")
    return 1 if bool(counter_clockwise) == (encoder.positive == "ccw") else -1


def offset_of(encoder: Encoder, identity: Mapping[str, Any]) -> int:
    """Return the place of the position in its reports, bytes; 0 if it was not queried."""
    offset = identity.get(f"{encoder.name}_offset", 0)
    if type(offset) is int and 0 <= offset <= _MAX_OFFSET:
        return offset
    raise DeviceError(
        f"identity of encoder {encoder.name}: expected a place of the position from 0 to {_MAX_OFFSET} bytes, got "
        f"{offset!r:.80}"
    )
