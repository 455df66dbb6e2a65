"""Pipeline of a CiA 402 drive: frames to speed, state and emergencies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

from typing_extensions import override

from daq.drivers.can_lines import CanLines, FirstContact
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.host_beats import HostBeats
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.wire import profile_of
from daq.drivers.contract import PipelineStatus
from daq.drivers.motors import MotorPipeline
from daq.drivers.sparing import EachSecond
from daq.items import TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame
from rig_basics.texts import number_of


class DrivePipeline(MotorPipeline):
    """Decoder of frames to the drive's speed, state and emergencies. A drive has no clock: samples get host time.

    The target speed is in the frames that the host sends, or, in a session that only receives, among the received
    frames. Frames are handled one by one in their order, so that both sessions give the same samples.

    Attributes:
        losses: see Pipeline.
        frames: frames of the last `feed`, for the host's own CANopen client.
        host_beats: heartbeats under the host's number.
    """

    def __init__(self, device: str, config: MotorDrive, identity: Mapping[str, Any]) -> None:
        super().__init__(device)
        self._lines = CanLines(device, self.losses)
        self.frames: list[CanFrame] = []
        self._complaint = ""  # about the mapping, which the length of the reports shows
        self._node, self._host_node = config.node_id, config.host_node_id
        self._profile = profile_of(config)
        self.host_beats: HostBeats = HostBeats(config.node_id, config.host_node_id)
        self._each_second = EachSecond()
        self._target_rpm = 0.0
        self._network: cia301.Heartbeat | None = None
        self._contact = FirstContact()

    @property
    @override
    def status(self) -> PipelineStatus:
        return PipelineStatus(complaint=self._complaint)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        if direction == TX:
            self._contact.sent(data)
            frames = cia301.own_frames(self._lines.sent(data))
            self.host_beats.sent(frames, host_ns)
            for frame in frames:
                self._take_target(frame)
            self.frames = []
            return []
        frames, events = self._lines.received(data)
        self.frames = cia301.own_frames(frames)
        out: list[Batch | DeviceEvent] = [*self._second_host(host_ns), *events]
        rows: list[tuple[float, float, int]] = []  # actual and target speed in rpm, statusword
        report, beat = cia301.cob_tpdo(1, self._node), cia301.cob_heartbeat(self._node)
        for frame in self.frames:
            if frame.arbitration_id == report:  # the most frequent case
                self._contact.heard()
                if len(frame.data) >= self._profile.size:
                    word, rpm = self._profile.unpack(frame.data)
                    rows.append((rpm, self._target_rpm, word))
                elif not self._complaint:
                    out.append(self._short(frame))
                continue
            self._take_target(frame)
            if frame.arbitration_id == beat:
                out += self._heartbeat(frame)
            elif frame.arbitration_id == cia301.cob_sdo_answer(self._node):
                self._contact.heard()
            elif frame.arbitration_id == cia301.cob_emergency(self._node) and len(frame.data) == 8:
                emergency = cia301.unpack_emergency(frame.data)
                facts: dict[str, Any] = {"error_code": emergency.error_code, "register": emergency.error_register}
                if any(emergency.maker_bytes):
                    facts["maker_bytes"] = emergency.maker_bytes.hex(" ")
                out.append(DeviceEvent("emergency", self._device, f"drive error 0x{emergency.error_code:04X}", facts))
        for word, _ in groupby(word for *_, word in rows):
            out += self.state_events(cia402.state(word), statusword=word)
        return out + self.samples(rows, host_ns)

    def _second_host(self, host_ns: int) -> Iterator[DeviceEvent]:
        """Report each second that another node sends the host's heartbeat, as long as it does."""
        if not self.host_beats.received(self.frames, host_ns) or not self._each_second.passes(host_ns):
            return
        text = (
            f"another node sends this host's heartbeat (node {self._host_node}): the drive would go on turning without "
            "its host. Find the node with this number, or give the host another one (host_node_id)"
        )
        yield DeviceEvent("fault", self._device, text, {"foreign_heartbeats": self.host_beats.foreign})

    def _short(self, frame: CanFrame) -> DeviceEvent:
        """Return the event about a report that is too short for statusword and speed; reported once."""
        self._complaint = (
            f"its reports (TPDO1) have {number_of(len(frame.data), 'byte')}; statusword and actual speed are "
            f"{self._profile.size}. Look at the drive's mapping (1A00h)"
        )
        return DeviceEvent("mapping", self._device, self._complaint, {"bytes": len(frame.data)})

    def _take_target(self, frame: CanFrame) -> None:
        if frame.arbitration_id == cia301.cob_rpdo(1, self._node) and len(frame.data) == self._profile.size:
            self._target_rpm = self._profile.unpack(frame.data)[1]

    def _heartbeat(self, frame: CanFrame) -> list[Batch | DeviceEvent]:
        """Return the event of a boot-up or of a change of the network state. A drive reports only if operational."""
        state = cia301.heartbeat(frame.data)
        before, self._network = self._network, self._network if state is None else state
        if state is not None and state != cia301.Heartbeat.BOOT_UP:
            self._contact.heard()
        if state is None or (state == before and state != cia301.Heartbeat.BOOT_UP):
            return []
        if state == cia301.Heartbeat.BOOT_UP and self._contact.pending:
            text = "the drive had started before the bus was opened (boot-up message); its set-up follows"
            return [DeviceEvent("network", self._device, text, {"network_state": int(state)})]
        if state == cia301.Heartbeat.BOOT_UP:
            text = "the drive started again (boot-up message): its settings are gone, its speed is unknown"
            return [DeviceEvent("restart", self._device, text)]
        operational = state == cia301.Heartbeat.OPERATIONAL
        if operational and before is None:
            return []  # the expected state
        text = f"network state {state.name.replace('_', '-')}" + ("" if operational else ": it reports no speed")
        return [DeviceEvent("network", self._device, text, {"network_state": int(state), "operational": operational})]
