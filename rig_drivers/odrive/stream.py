"""Pipeline of an ODrive: frames in both directions to speed, state and errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from daq.drivers.can_lines import CanLines, OtherHost
from daq.drivers.following import Following
from daq.drivers.motors import MotorPipeline
from daq.items import TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, opens_bus
from rig_basics.texts import number_of
from rig_drivers.odrive import wire
from rig_drivers.odrive.settings import Odrive

_JUMP_TURNS, _JUMP_S = 5.0, 1.0  # a position that differs by more than this, and this time's motion, has been reset


def statusword(beat: wire.Heartbeat) -> int:
    """Return the state of a heartbeat as it is stored in the log.

    Bits 0–7: state of the axis. Bits 8–15: number of the lowest error bit, from 1; 0 without an error. Bits 16–23: the
    heartbeat's byte after the state (0.5: motor error; 0.6: result of the last procedure).
    """
    lowest = (beat.error & -beat.error).bit_length()
    return beat.state | lowest << 8 | beat.flags[0] << 16


def state(beat: wire.Heartbeat, firmware: str) -> str:
    """Return the state of a heartbeat as text. An expired watchdog of an idle axis is not a fault."""
    if beat.error:
        expired = beat.error == wire.WATCHDOG[firmware] and beat.state != wire.CLOSED_LOOP
        return "WATCHDOG EXPIRED" if expired else "FAULT"
    return wire.STATES.get(beat.state, f"STATE {beat.state}")


class OdrivePipeline(MotorPipeline):
    """Decoder of frames to speed, state and errors. Samples get the host's time: a controller has no clock.

    The set-point is in the frames that the host sends, or, in a session that only receives, among the received frames.

    Attributes:
        losses: see Pipeline.
        beats: heartbeats of the last `feed`.
        speeds_rpm: reported speeds of the rotor of the last `feed`, rpm.
        errors: newest error codes by name, from the answers to requests.
        restarted: whether the last `feed` showed a restart of the controller.
    """

    def __init__(self, device: str, settings: Odrive, identity: Mapping[str, Any]) -> None:
        super().__init__(device)
        self._lines = CanLines(device, self.losses)
        self.losses["unreadable_frames"] = 0
        self.beats: list[wire.Heartbeat] = []
        self.speeds_rpm: list[float] = []
        self.errors: dict[str, int] = {}
        self.restarted: bool = False
        self._settings = settings
        self._following = Following(device, round(settings.follow_s * 1e3 / settings.estimates_ms))
        self._other_host = OtherHost(device)
        self._shown: dict[str, int] = {}  # error codes that an event has shown
        self._introduced: set[int] = set()  # commands whose first report since the bus was opened was announced
        self._target_rpm, self._commanded = 0.0, False
        self._beat: wire.Heartbeat | None = None
        self._last: tuple[float, float, int] | None = None  # position, speed, host time of the newest estimates

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        self.beats, self.speeds_rpm, self.restarted = [], [], False
        if direction == TX:
            if opens_bus(data):
                self._introduced.clear()
            for frame in self._lines.sent(data):
                if not frame.extended and wire.split(frame.arbitration_id)[0] == self._settings.node_id:
                    self._other_host.sent(frame)
                    self._take_command(frame)
            return []
        frames, events = self._lines.received(data)
        out: list[Batch | DeviceEvent] = [*events]
        rows: list[tuple[float, float, int]] = []
        for frame in frames:
            node, command = wire.split(frame.arbitration_id)
            if not (frame.extended or frame.remote) and node == self._settings.node_id:
                out += self._frame(command, frame, host_ns, rows)
        return out + self.samples(rows, host_ns)

    def _frame(
        self, command: int, frame: CanFrame, host_ns: int, rows: list[tuple[float, float, int]]
    ) -> list[DeviceEvent]:
        if command == wire.ESTIMATES:  # the most frequent case
            return self._estimates(frame.data, host_ns, rows)
        if command == wire.HEARTBEAT:
            return self._heartbeat(frame.data)
        if command in wire.COMMANDS:
            return self._command_of_another(frame, host_ns)
        return self._answer(command, frame.data)

    # --- reports ----------------------------------------------------------------------------------------------

    def _estimates(self, data: bytes, host_ns: int, rows: list[tuple[float, float, int]]) -> list[DeviceEvent]:
        found = wire.parse_estimates(data)
        if found is None:
            return self._unreadable("encoder estimates", data)
        position, speed = found
        out = self._announce(wire.ESTIMATES, "estimates") + self._jump(position, speed, host_ns)
        rpm = self._settings.rpm(speed)
        self.speeds_rpm.append(rpm)
        rows.append((rpm, self._target_rpm, 0 if self._beat is None else statusword(self._beat)))
        return out + self._following.check(self._commanded, self._target_rpm, rpm)

    def _jump(self, position: float, speed: float, host_ns: int) -> list[DeviceEvent]:
        """Return the event of a restart if the position has returned to the range after a start."""
        before, self._last = self._last, (position, speed, host_ns)
        if before is None:
            return []
        passed_s = max(0.0, (host_ns - before[2]) * 1e-9) + _JUMP_S
        allowed = _JUMP_TURNS + passed_s * max(abs(speed), abs(before[1]))
        if abs(position - before[0]) <= allowed or abs(position) >= abs(before[0]):
            return []
        text = f"the controller started again: its position was {before[0]:.1f} turns and is {position:.1f}"
        return self._restart(text)

    def _restart(self, text: str) -> list[DeviceEvent]:
        self.restarted = True
        return [DeviceEvent("restart", self._device, text)]

    def _heartbeat(self, data: bytes) -> list[DeviceEvent]:
        beat = wire.parse_heartbeat(data)
        if beat is None:
            return self._unreadable("heartbeat", data)
        out = self._announce(wire.HEARTBEAT, "heartbeat")
        before, self._beat = self._beat, beat
        self.beats.append(beat)
        if before is not None and self._starts(beat) and not self._starts(before):
            out += self._restart("the controller started again: its axis has no state yet")
        out += self.state_events(state(beat, self._settings.firmware), axis_state=beat.state)
        return out + self._emergency(beat, before)

    def _starts(self, beat: wire.Heartbeat) -> bool:
        return beat.state == 0 or (self._settings.firmware == "0.6" and beat.error == wire.INITIALIZING)

    def _emergency(self, beat: wire.Heartbeat, before: wire.Heartbeat | None) -> list[DeviceEvent]:
        """Return the event of new error bits, or of the end of all errors.

        An idle controller without commands reports an expired watchdog, as it should; this is not an emergency.
        """
        drove = before is not None and before.state == wire.CLOSED_LOOP
        expected = 0 if drove else wire.WATCHDOG[self._settings.firmware]
        expected |= wire.INITIALIZING if self._starts(beat) else 0
        known = 0 if before is None else before.error
        new = beat.error & ~known & ~expected
        if new:
            self._shown.clear()
            facts = {"error_code": beat.error, "axis_state": beat.state, "firmware": self._settings.firmware}
            return [DeviceEvent("emergency", self._device, f"axis error 0x{beat.error:08X}", facts)]
        if known & ~wire.WATCHDOG[self._settings.firmware] and not beat.error:
            return [DeviceEvent("emergency", self._device, "no axis error any more", {"error_code": 0})]
        return []

    def _answer(self, command: int, data: bytes) -> list[DeviceEvent]:
        """Take an answer to a request: version, serial number, error codes."""
        if command == wire.VERSION and (version := wire.parse_version(data)) is not None:
            facts: dict[str, Any] = {
                "firmware": ".".join(map(str, version.firmware)),
                "hardware": ".".join(map(str, version.hardware)),
            }
            return [DeviceEvent("reply", self._device, f"version {data.hex()}", facts)]
        if command == wire.ADDRESS and (address := wire.parse_address(data)) is not None:
            return [DeviceEvent("reply", self._device, f"address {data.hex()}", {"serial": address[1]})]
        errors = wire.parse_errors(self._settings.firmware, command, data)
        if not errors:
            return []
        self.errors |= errors
        if self._shown == self._shown | errors:  # some releases of 0.6 send them periodically
            return []
        self._shown |= errors
        text = ", ".join(f"{name} 0x{code:X}" for name, code in errors.items())
        return [DeviceEvent("status", self._device, text, errors)]

    def _announce(self, command: int, text: str) -> list[DeviceEvent]:
        """Return a reply for the first report of a kind since the bus was opened: the opening waits for it."""
        if command in self._introduced:
            return []
        self._introduced.add(command)
        return [DeviceEvent("reply", self._device, text)]

    def _unreadable(self, what: str, data: bytes) -> list[DeviceEvent]:
        text = f"unreadable {what} of {number_of(len(data), 'byte')} dropped: {data.hex(' ')}"
        return [self.damage("unreadable_frames", text, bytes=len(data))]

    # --- commands ---------------------------------------------------------------------------------------------

    def _take_command(self, frame: CanFrame) -> None:
        """Take the set-point of a command, from this host or, while this host sends none, from another."""
        command = wire.split(frame.arbitration_id)[1]
        if frame.remote:
            return
        if command == wire.INPUT_VELOCITY and (speed := wire.parse_velocity(frame)) is not None:
            self._target_rpm, self._commanded = self._settings.rpm(speed), True
        elif command == wire.ESTOP or (command == wire.AXIS_STATE and wire.parse_state(frame) == wire.IDLE):
            self._target_rpm, self._commanded = 0.0, False

    def _command_of_another(self, frame: CanFrame, host_ns: int) -> list[DeviceEvent]:
        """Report a command that this host did not send: it keeps the watchdog from expiring."""
        if not self._other_host.replaced:
            self._take_command(frame)
        return self._other_host.received(frame, host_ns)
