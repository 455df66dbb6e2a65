"""Pipeline of a RotorLink node behind XBee modules: API frames to samples and events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from typing_extensions import override

from daq.drivers.contract import PipelineStatus
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.stream import NodePipeline
from daq.drivers.sparing import Foreign
from daq.items import TX, Batch, DeviceEvent
from rig_drivers.xbee import framing, wire
from rig_drivers.xbee.settings import XBeeNode

_MAX_INDEX_ERROR_US = 100_000  # of a late block's time, from its index; a node's period is not exact
_LONG_US = 2**63  # longer than any node runs
_NO_FRAME_NS = 2_000_000_000  # of bytes without an API frame, after which the module is in another mode …
_NO_FRAME_BYTES = 2 * framing.MAX_FRAME_BYTES  # … if there are more than those of any frame


class XBeePipeline(NodePipeline):
    """Decoder of a node's payloads in API frames, and of the reports of the host's module.

    Every frame on air is counted by the node's own seq. API frames have no number of their own, so a frame lost on the
    serial line counts as a lost radio frame, like one lost on air. Damage on the serial line is counted in addition
    (`damaged_frames`).

    Args:
        device: name of the device in the rig file.
        config: table of the node in the rig file.
        identity: identity of the module; it may contain "rssi_dBm".
    """

    def __init__(self, device: str, config: XBeeNode, identity: Mapping[str, Any]) -> None:
        super().__init__(device, config, identity)
        del self.losses["cable_frames"]  # API frames have no number
        self.losses["foreign_frames"] = 0
        known = identity.get("rssi_dBm")
        self.rssi_dBm = known if type(known) is int else None
        self._address = wire.Address.parse(config.node_address)
        self._line = framing.ApiDecoder(escaped=config.api_mode == 2)
        self._foreign = Foreign(device)
        self._set_up_lost = ""  # the next API frame, for example the answer of the module, resets it
        self._unframed_bytes, self._unframed_ns = 0, 0  # since the newest API frame: their number, time of the first
        self._unheard = ""  # why no sample has been decoded yet

    @property
    @override
    def status(self) -> PipelineStatus:
        found = super().status
        decoded = self._next_index if self._records_angles else self._heard_frames
        complaint = found.complaint or (self._unheard if decoded is None else "")
        return replace(found, complaint=complaint, set_up_lost=self._set_up_lost)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        if direction == TX:
            return []
        if not data:
            return self.waited()
        out: list[Batch | DeviceEvent] = []
        parts = self._line.feed(data)
        self._notice_mode(len(data), any(isinstance(part, bytes) for part in parts), host_ns)
        for found in parts:
            if isinstance(found, framing.DamagedPart):
                out.append(self.damaged(found.reason))
                continue
            try:
                frame = wire.parse(found)
            except ValueError:  # usual: a damaged frame, which is counted and reported
                out.append(self.damaged("length"))
                continue
            out += self._api_frame(frame, host_ns)
        return out

    def _notice_mode(self, size: int, has_frame: bool, host_ns: int) -> None:
        """Take note of the size of a read, and of whether it ends an API frame."""
        if has_frame:
            self._unframed_bytes, self._set_up_lost = 0, ""
            return
        self._unframed_ns = self._unframed_ns if self._unframed_bytes else host_ns
        self._unframed_bytes += size
        if self._unframed_bytes > _NO_FRAME_BYTES and host_ns - self._unframed_ns > _NO_FRAME_NS:
            self._set_up_lost = (
                f"its bytes have contained no API frame for {_NO_FRAME_NS / 1e9:g} s. The module may have restarted "
                "with another AP or BD than the rig file's: values that were not written (WR) are lost"
            )

    def _api_frame(self, frame: wire.ApiFrame, host_ns: int) -> list[Batch | DeviceEvent]:
        match frame:
            case wire.Received():
                return self._received(frame, host_ns)
            case wire.TransmitStatus(frame_id, status):
                if status == wire.DELIVERED:
                    return []  # the node's own acknowledgement follows
                facts = {"frame_id": frame_id, "delivery_status": status}
                return [DeviceEvent("acknowledge", self._device, f"radio frame {frame_id}: {frame.words}", facts)]
            case wire.ModemStatus(status):
                text = f"the module at the host: {frame.words}"
                return [
                    DeviceEvent("modem", self._device, text, {"status": status, "restart": status in wire.RESTARTS})
                ]
            case wire.AtAnswer():
                return [self._answered(frame)]
            case wire.UnusedFrame(kind):
                return [*self._foreign.event(f"a frame of type 0x{kind:02X} ignored", {"frame_type": kind})]

    def _received(self, frame: wire.Received, host_ns: int) -> list[Batch | DeviceEvent]:
        if not frame.comes_from(self._address):
            self.losses["foreign_frames"] += 1
            text = f"frames from {frame.source} ignored: the rig file states node_address = {self._address}"
            if self._heard_frames is None and (not self._unheard or _has_node_frame(frame.payload)):
                self._unheard = text
            return [*self._foreign.event(text, {"source": frame.source})]
        if frame.rssi_dBm is not None:
            self.rssi_dBm = frame.rssi_dBm
        try:
            inner = rotorlink.parse_node(frame.payload)
        except rotorlink.BadFrame as fault:
            numbered = (
                [] if fault.skipped is None or fault.skipped.kind not in rotorlink.Skipped.NODES else [fault.skipped]
            )
            self._unheard = (
                f"frames from {frame.source} contain no whole payload of a node (payload {fault.reason}): its module "
                "must be in API mode, and send one payload, without COBS, in each frame"
            )
            return [self.damaged(f"payload {fault.reason}"), *self.take(numbered, host_ns)]
        if self._heard_frames is None:  # the address is right
            self._unheard = ""
        return self.take([inner], host_ns)

    def _is_late(self, frame: rotorlink.NodeFrame | rotorlink.Skipped, host_ns: int) -> bool:
        """See NodePipeline: modules repeat what was not acknowledged, and do not filter what comes twice.

        A block shows by its index, which does not wrap for weeks, for how long its node has run. Its index fits its
        time, unless the block is of another node. Other frames show no restart if blocks do.
        """
        if not self._node.is_behind(frame.seq):
            return False
        node_us: int | None = getattr(frame, "node_time_us", None)
        if node_us is None:
            return True
        if not isinstance(frame, rotorlink.EncoderBlock):
            up_us = node_us if self._next_index is None else _LONG_US
            return self._node.is_late(node_us, host_ns, up_us)
        if not self._node.is_late(node_us, host_ns, max(node_us, frame.first_index * frame.period_us)):
            return False
        if self._next_index is None:
            return True
        due_us = self._next_us - (self._next_index - self._index(frame.first_index)) * frame.period_us
        return abs(self._node.unwrap(node_us) - due_us) <= _MAX_INDEX_ERROR_US

    def _answered(self, answer: wire.AtAnswer) -> DeviceEvent:
        if answer.command == "DB" and answer.status == 0 and any(answer.value):  # 0: no packet has been received yet
            self.rssi_dBm = -int.from_bytes(answer.value, "big")
        facts = {"frame_id": answer.frame_id, "command": answer.command, "status": answer.status}
        return DeviceEvent("reply", self._device, answer.text, facts)


def _has_node_frame(payload: bytes) -> bool:
    """Whether radio data are an intact frame of a node."""
    try:
        rotorlink.parse_node(payload)
    except rotorlink.BadFrame:  # usual: radio data of another device
        return False
    return True
