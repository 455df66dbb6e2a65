"""Answers of a base station or node, as text in the replies of a dialogue, and the beacon's time in such an answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from rig_drivers.microstrain import wire

_BEACON_BYTES = 11


@dataclass(frozen=True)
class Answer:
    """One answer.

    Attributes:
        kind: type of its packet.
        address: sender.
        payload: its content; it begins with the number of the command.
        host_ns: host time of its arrival, ns since 1970.
    """

    kind: int
    address: int
    payload: bytes
    host_ns: int

    @property
    def text(self) -> str:
        """The answer as text; see `of_text`."""
        return f"{self.kind} {self.address} {self.host_ns} {self.payload.hex()}"

    @classmethod
    def of_text(cls, text: str) -> Answer:
        """Return the answer of a text.

        Raises:
            ValueError: the text is not that of an answer.
        """
        kind, address, host_ns, payload = text.split(" ")
        return cls(int(kind), int(address), bytes.fromhex(payload), int(host_ns))

    @property
    def command(self) -> int:
        """Number of the command that is answered."""
        return int.from_bytes(self.payload[:2], "big")


class Beacon(NamedTuple):
    """State of the beacon.

    Attributes:
        is_on: whether the base station sends it.
        time_ns: its time, ns since 1970.
    """

    is_on: bool
    time_ns: int


def beacon_of(packet: wire.Packet | Answer) -> Beacon | None:
    """Return the beacon's state in an answer to BEACON_STATUS; None for any other packet."""
    data = packet.payload
    if packet.kind != wire.BASE_SUCCESS or len(data) != _BEACON_BYTES:
        return None
    if int.from_bytes(data[:2], "big") != wire.BEACON_STATUS:
        return None
    return Beacon(data[2] == 1, int.from_bytes(data[3:7], "big") * 10**9 + int.from_bytes(data[7:11], "big"))
