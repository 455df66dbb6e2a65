"""Stand-in for a RotorLink node behind XBee modules of a log while the log is played."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from rig_drivers.xbee import framing
from rig_drivers.xbee.settings import XBeeNode

_REFUSED = 0x02
_TRANSMIT_REQUESTS = (0x00, 0x01, 0x10)


class PlayedXBee(PlayedDevice):
    """The module answers with its identity in the log; commands to the node are neither executed nor acknowledged.

    Args:
        identity: identity of the module from its opening.
        settings: table of the node in the rig file.
    """

    def __init__(self, settings: XBeeNode, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._escaped = settings.api_mode == 2
        self._line = framing.ApiDecoder(escaped=self._escaped)
        self._registers = {"AP": bytes((settings.api_mode,)), **_registers(identity)}

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        answers = b""
        for found in self._line.feed(data):
            if not isinstance(found, bytes) or not found:
                continue
            self.commands += 1
            self.unfollowed += found[0] in _TRANSMIT_REQUESTS
            if found[0] == 0x08 and len(found) >= 4:
                value = self._registers.get(found[2:4].decode("latin-1"))
                status = bytes((_REFUSED,)) if value is None else b"\x00" + value
                answers += framing.encode(b"\x88" + found[1:4] + status, escaped=self._escaped)
        return answers


def _registers(identity: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the registers in an identity, those that have a valid form."""
    out: dict[str, bytes] = {}
    for name, command in (("firmware", "VR"), ("hardware", "HV"), ("serial", "SH")):
        try:
            out[command] = bytes.fromhex(str(identity[name]))
        except (KeyError, ValueError):  # usual: the identity in the log is incomplete
            continue
    if (serial := out.pop("SH", b"")) and len(serial) == 8:
        out["SH"], out["SL"] = serial[:4], serial[4:]
    payload = identity.get("payload_bytes")
    if isinstance(payload, int) and 0 <= payload < 2**16:
        out["NP"] = payload.to_bytes(2, "big")
    return out
