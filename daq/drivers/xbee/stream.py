# pyright: strict
"""API frames of an XBee module to the samples and events of the RotorLink node behind it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.drivers.items import TX, Batch, Event
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.stream import NodePipeline
from daq.drivers.xbee import framing, wire
from daq.drivers.xbee.settings import XBeeNode

_STRANGERS = 16  # so many senders and frame types get an event, the rest is only counted


class XBeePipeline(NodePipeline):
    """A node's payloads out of API frames; beside them what the module has to say.

    Every frame on air is counted by the node's own sequence number: one that the serial line lost is a lost radio frame
    like one that the air lost, since API frames bear no number of their own. Damage on the serial line is counted
    beside it (`damaged_frames`).

    Args:
        identity: may hold "rssi_dBm", as the module gave it when it was opened.
    """

    def __init__(self, device: str, config: XBeeNode, identity: Mapping[str, Any]) -> None:
        super().__init__(device, config, identity)
        del self.losses["cable_frames"]  # nobody can count them
        self.losses["foreign_frames"] = 0
        known = identity.get("rssi_dBm")
        self.rssi_dBm = known if type(known) is int else None
        self._address = wire.Address.parse(config.node_address)
        self._line = framing.ApiDecoder(escaped=config.api_mode == 2)
        self._strangers: set[str] = set()

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """See Pipeline."""
        if direction == TX:
            return []
        if not data:
            return self.waited()
        out: list[Batch | Event] = []
        for found in self._line.feed(data):
            if isinstance(found, framing.Damage):
                out.append(self.damaged(found.reason))
                continue
            try:
                frame = wire.parse(found)
            except ValueError:
                out.append(self.damaged("length"))
                continue
            out += self._api_frame(frame, host_ns)
        return out

    def _api_frame(self, frame: wire.ApiFrame, host_ns: int) -> list[Batch | Event]:
        match frame:
            case wire.Received():
                return self._received(frame, host_ns)
            case wire.TransmitStatus(frame_id, status):
                if status == wire.DELIVERED:
                    return []  # the node's own acknowledgement decides
                facts = {"frame_id": frame_id, "delivery_status": status}
                return [Event("acknowledge", self._device, f"radio frame {frame_id}: {frame.words}", facts)]
            case wire.ModemStatus(status):
                text = f"the module at the host: {frame.words}"
                return [Event("modem", self._device, text, {"status": status, "restart": status in wire.RESTARTS})]
            case wire.AtAnswer():
                return [self._answered(frame)]
            case wire.Other(kind):
                return self._stranger(f"a frame of type 0x{kind:02X} ignored", {"frame_type": kind})

    def _received(self, frame: wire.Received, host_ns: int) -> list[Batch | Event]:
        if not frame.comes_from(self._address):
            self.losses["foreign_frames"] += 1
            text = f"frames from {frame.source} ignored: the rig file says node_address = {self._address}"
            return self._stranger(text, {"source": frame.source})
        if frame.rssi_dBm is not None:
            self.rssi_dBm = frame.rssi_dBm
        try:
            inner = rotorlink.parse_node(frame.payload)
        except rotorlink.BadFrame as fault:
            numbered = (
                [] if fault.skipped is None or fault.skipped.kind not in rotorlink.Skipped.NODES else [fault.skipped]
            )
            return [self.damaged(f"payload {fault.reason}"), *self.take(numbered, host_ns)]
        return self.take([inner], host_ns)

    def _stranger(self, text: str, facts: Mapping[str, Any]) -> list[Batch | Event]:
        """An event for what comes from elsewhere, once for each."""
        if text in self._strangers or len(self._strangers) >= _STRANGERS:
            return []
        self._strangers.add(text)
        return [Event("foreign", self._device, text, facts)]

    def _answered(self, answer: wire.AtAnswer) -> Event:
        if answer.command == "DB" and answer.status == 0 and any(answer.value):  # 0: no packet came yet
            self.rssi_dBm = -int.from_bytes(answer.value, "big")
        status = wire.AT_STATUS[answer.status] if answer.status < len(wire.AT_STATUS) else f"status {answer.status}"
        text = f"{answer.frame_id} {answer.command} {answer.value.hex()} {status}"
        facts = {"frame_id": answer.frame_id, "command": answer.command, "status": answer.status}
        return Event("reply", self._device, text, facts)
