"""The simulated encoder node behind a pair of XBee modules: the RotorLink far end with API frames at the host.

Stand-in for a RotorLink node behind XBee modules of a log while the log is played.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.far_end import Air, SimulatedNode
from daq.drivers.simulated import FaultKind
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import DeviceClock
from rig_drivers.xbee import framing, wire
from rig_drivers.xbee.settings import XBeeNode

_TRIES = 11  # transmissions on air before a module reports a frame as not delivered
_RSSI_DBM = -58
_MODULE_64 = 0x0013_A200_4052_2BAA
_NO_ACK, _NO_NETWORK_ACK, _NO_SUCH_ADDRESS = 0x01, 0x21, 0x24
_NODE = 1


class SimulatedXBeeNode(SimulatedNode):
    """See SimulatedNode; the dongle is an XBee module in API mode.

    Attributes:
        out_of_reach: whether no frame passes between the modules; the host's module still answers.
        receive_type: type of the frames with radio data: 0x90, 0x91, 0x80 or 0x81.

    Args:
        config: table of the node in the rig file; see SimulatedNode for the other arguments.
    """

    samples_per_block: ClassVar[int] = 10
    """98 bytes of payload, which fit into a frame of an 802.15.4 module."""
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        **SimulatedNode.fault_kinds,
        "out of reach": FaultKind("no frame passes between the modules; the host's own one answers"),
        "module restart": FaultKind(
            "the host's module starts again", end=None, meaning="its modem status", limits=(0, 255)
        ),
        "foreign": FaultKind("frames of another node come", 10, end=None, meaning="how many", limits=(0, 1000)),
    }

    def __init__(
        self,
        config: XBeeNode,
        motion: SimulatedMotion,
        zero_error_rad: NDArray[np.floating],
        noise_counts: float,
        play_rad: float,
        clock: DeviceClock,
        air: Air,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(config, motion, zero_error_rad, noise_counts, play_rad, clock, air, rng)
        self._address = wire.Address.parse(config.node_address)
        self._escaped = config.api_mode == 2
        self._line = framing.ApiDecoder(escaped=self._escaped)
        self._waiting: list[bytes] = []  # frame data on their way to the host
        self.out_of_reach: bool = False
        self.receive_type = 0x90 if self._address.bits == 64 else 0x81
        self._registers = {
            "AP": bytes((config.api_mode,)),
            "VR": bytes.fromhex("100A"),
            "HV": bytes.fromhex("2E48"),
            "SH": (_MODULE_64 >> 32).to_bytes(4, "big"),
            "SL": (_MODULE_64 & 0xFFFFFFFF).to_bytes(4, "big"),
            "NP": (100).to_bytes(2, "big"),
        }

    def fail(self, what: str, value: Any) -> None:
        """See FarEnd and `fault_kinds`; the value 0 ends a lasting fault."""
        match what:
            case "out of reach":
                self.out_of_reach = bool(value)
            case "module restart":
                self.air.lose_flying()
                self._waiting = [bytes((0x8A, int(value)))]
            case "foreign":
                self._waiting += [self._foreign_mark(i) for i in range(int(value))]
            case _:
                super().fail(what, value)

    def _foreign_mark(self, number: int) -> bytes:
        payload = rotorlink.IndexMark(_NODE, number & 0xFFFF, 50_000 * number, number).pack()
        return self._received(wire.Address(self._address.value ^ 1, self._address.bits), payload)

    def _received(self, source: wire.Address, payload: bytes) -> bytes:
        """Return the frame data with which the host's module reports radio data."""
        long = source.value.to_bytes(8, "big") if source.bits == 64 else b"\xff" * 8
        short = source.value.to_bytes(2, "big") if source.bits == 16 else b"\xff\xfe"
        heads = {
            0x90: b"\x90" + long + short + b"\xc1",
            0x91: b"\x91" + long + short + b"\xe8\xe8\x00\x11\xc1\x05\xc1",
            0x80: b"\x80" + long + bytes((-_RSSI_DBM, 0)),
            0x81: b"\x81" + short + bytes((-_RSSI_DBM, 0)),
        }
        return heads[self.receive_type] + payload

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host to its module; bytes that are not a frame in its mode are ignored."""
        for found in self._line.feed(data):
            if isinstance(found, bytes):
                self._host_request(found, now_s)
        return b""

    def _host_request(self, data: bytes, now_s: float) -> None:
        """Execute one frame of the host."""
        match data[0]:
            case 0x08 if len(data) >= 4:
                self._waiting.append(self._answer(data[1:2], data[2:4]))
            case 0x10 if len(data) >= 14:
                to = data[2:10] if self._address.bits == 64 else data[10:12]
                status = self._transmit(to, data[14:], now_s, _NO_SUCH_ADDRESS, _NO_NETWORK_ACK)
                self._report_status(data[1], bytes((0x8B, data[1])) + b"\xff\xfe\x00" + bytes((status, 0)))
            case 0x00 if len(data) >= 11:
                status = self._transmit(data[2:10], data[11:], now_s, _NO_ACK, _NO_ACK)
                self._report_status(data[1], bytes((0x89, data[1], status)))
            case 0x01 if len(data) >= 5:
                status = self._transmit(data[2:4], data[5:], now_s, _NO_ACK, _NO_ACK)
                self._report_status(data[1], bytes((0x89, data[1], status)))
            case _:
                pass

    def _report_status(self, frame_id: int, status: bytes) -> None:
        if frame_id:  # 0 requests no status
            self._waiting.append(status)

    def _answer(self, frame_id: bytes, command: bytes) -> bytes:
        name = command.decode("latin-1")
        value = (
            bytes((-_RSSI_DBM if self.air.last_delivered >= 0 else 0,)) if name == "DB" else self._registers.get(name)
        )
        return b"\x88" + frame_id + command + (b"\x02" if value is None else b"\x00" + value)

    def _transmit(self, to: bytes, payload: bytes, now_s: float, unknown: int, unheard: int) -> int:
        """Send a payload on air; return the transmit status."""
        if to != self._address.value.to_bytes(self._address.bits // 8, "big"):
            return unknown
        if self.out_of_reach or self.dead or self._without_supply:
            return unheard
        try:
            frame = rotorlink.parse(payload)
        except rotorlink.BadFrame:  # usual: the radio does not check the content
            return wire.DELIVERED
        return wire.DELIVERED if self.hear(frame, now_s, _TRIES) else unheard

    def dongle(self, now_s: float) -> bytes:
        """Return the bytes from the module to the host: its own reports, then received node frames."""
        if self.out_of_reach:
            self.air.lose_flying()
        frames, self._waiting = self._waiting, []
        frames += [self._received(self._address, payload) for _, payload in self.air.landed(now_s)]
        return b"".join(framing.encode(frame, escaped=self._escaped) for frame in frames)


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

    @override
    def hear(self, data: bytes) -> bytes:
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
