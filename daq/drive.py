"""The host's side of the motor drive: canopen's SDO client and NMT over our own recorded link, and the heartbeat."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from daq.errors import DeviceError
from daq.protocols import cia402, slcan
from daq.transports.host_clock import HostClock
from rig_configs.schema import Drive

_SETUP_WAIT_S = 0.3  # wall seconds to wait for an SDO answer
_REST_WAIT_S = 5.0  # wall seconds a quick stop may take


class _SendOnlyBus(can.BusABC):
    """What canopen needs to send: frames leave as slcan text through the recorded link.

    Received frames come to canopen from the link's reader thread (Network.notify), so there is no second reader.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        super().__init__(channel="recorded link")
        self._send_bytes = send
        self._is_shutdown = True  # it owns no hardware: nothing to shut down, and no warning about it

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame."""
        frame = slcan.CanFrame(msg.arbitration_id, bytes(msg.data), msg.is_extended_id, msg.is_remote_frame)
        self._send_bytes(slcan.encode(frame))


class DriveControl:
    """Commands the drive: set-up, speed, quick stop; keeps the host's heartbeat going.

    Args:
        config: the drive's table of the rig file.
        send: writes bytes to the drive's link (and to the log).
        clock: for time-outs.
    """

    def __init__(self, config: Drive, send: Callable[[bytes], None], clock: HostClock) -> None:
        self._config, self._send, self._clock = config, send, clock
        self._network = canopen.Network(bus=_SendOnlyBus(send))
        self._node = canopen.RemoteNode(config.node_id, canopen.ObjectDictionary())
        self._node.sdo.RESPONSE_TIMEOUT = _SETUP_WAIT_S
        self._network.add_node(self._node)
        self._beating = threading.Event()
        self._beat: threading.Thread | None = None
        self._target_rpm = 0
        self.statusword: int | None = None
        self.actual_rpm = 0.0
        self.was_reset = ""  # what enable found and reset, for whoever runs the rig
        self.dropped_out: str | None = None  # state it fell into by itself while it should have been running
        self._armed = False

    def notice(self, frames: list[slcan.CanFrame]) -> None:
        """Frames the link's reader decoded."""
        for frame in frames:
            if frame.arbitration_id == cia402.cob_tpdo(1, self._config.node_id) and len(frame.data) == 4:
                self.statusword, rpm = cia402.unpack_tpdo1(frame.data)
                self.actual_rpm = float(rpm)
                if self._armed and self.state != cia402.OPERATION_ENABLED and self.dropped_out is None:
                    self.dropped_out = self.state
            elif frame.arbitration_id == cia402.cob_sdo_answer(self._config.node_id) and len(frame.data) == 8:
                self._network.notify(frame.arbitration_id, bytearray(frame.data), self._clock.now_s())

    @property
    def state(self) -> str:
        """The drive's CiA 402 state as last reported."""
        return cia402.UNKNOWN if self.statusword is None else cia402.state(self.statusword)

    def start(self) -> None:
        """Open the bus, set the drive up, start the heartbeat, go operational.

        Raises:
            DeviceError: the drive does not answer or refuses a setting.
        """
        c = self._config
        rate = {125_000: b"S4", 250_000: b"S5", 500_000: b"S6", 1_000_000: b"S8"}[c.bitrate]
        self._send(b"\rC\r" + rate + b"\rO\r")
        watchdog_ms = min(65535, round(self._clock.patience(c.heartbeat_timeout_ms)))
        settings = (
            (0x1017, 0, c.heartbeat_ms, 2),
            (0x6060, 0, cia402.MODE_VELOCITY, 1),
            (0x1016, 1, cia402.consumer_heartbeat(c.host_node_id, watchdog_ms), 4),
        )
        for index, sub, value, size in settings:
            self._write(index, sub, value, size)
        self.set_ramp(c.ramp_rpm_per_s)
        self._start_heartbeat()
        self._network.send_message(0, bytes([1, c.node_id]))

    def _write(self, index: int, sub: int, value: int, size: int) -> None:
        for attempt in (1, 2, 3):
            try:
                self._node.sdo.download(index, sub, value.to_bytes(size, "little"))
                return
            except SdoCommunicationError as error:
                if attempt == 3:
                    raise DeviceError(
                        f"drive: no answer to writing {index:04X}h sub {sub} after 3 tries ({error}). Is node "
                        f"{self._config.node_id} powered, the bit rate right, the bus terminated?"
                    ) from error
            except SdoAbortedError as error:
                raise DeviceError(f"drive: refused {value} at {index:04X}h sub {sub}: {error}") from error

    def set_ramp(self, rpm_per_s: float) -> None:
        """Ramp for speeding up and slowing down, rpm/s."""
        seconds = 10  # resolution of 0.1 rpm/s
        for index in (0x6048, 0x6049):
            self._write(index, 1, max(1, round(rpm_per_s * seconds)), 4)
            self._write(index, 2, seconds, 2)

    def enable(self) -> None:
        """Walk the state machine to OPERATION ENABLED with target speed 0.

        A drive whose host was killed may stand in FAULT because the heartbeat stayed away: that one is reset. Any
        other fault is its operator's to look into.

        Raises:
            DeviceError: it does not get there, or stands in a fault of its own.
        """
        deadline = time.monotonic() + 3.0
        self._armed, self.dropped_out = False, None
        if self.state == cia402.FAULT:
            self._reset_if_only_heartbeat()
        while self.state != cia402.OPERATION_ENABLED:
            word = cia402.towards_operation(self.state)
            if word is not None:
                self._pdo(word, 0)
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"drive: expected OPERATION ENABLED, it stays in {self.state}. Look at its display for a fault"
                )
            time.sleep(0.005)
        self._armed = True

    def fault_code(self) -> int | None:
        """Why the drive stands in FAULT, by its own word; None when it tells nothing.

        603Fh, where it has none 1003h, and where it has neither the register 1001h, when only the line is at fault.
        """
        for index, sub in ((cia402.ERROR_CODE, 0), (cia402.PREDEFINED_ERROR_FIELD, 1)):
            try:
                code = int.from_bytes(self._node.sdo.upload(index, sub)[:2], "little")
            except (SdoAbortedError, SdoCommunicationError):
                continue
            if code:
                return code
        with contextlib.suppress(SdoAbortedError, SdoCommunicationError):
            if self._node.sdo.upload(cia402.ERROR_REGISTER, 0)[0] & ~0x01 == cia402.REGISTER_COMMUNICATION:
                return cia402.HEARTBEAT_ERROR
        return None

    def _reset_if_only_heartbeat(self) -> None:
        code = self.fault_code()
        if code != cia402.HEARTBEAT_ERROR:
            said = "it does not tell why" if code is None else f"its error code is 0x{code:04X}"
            raise DeviceError(
                f"drive: it stands in FAULT, {said}. Look into its manual, mend the cause and reset it there"
            )
        self.was_reset = "the drive stood in FAULT because a host's heartbeat had stayed away (0x8130); it was reset"
        self._pdo(cia402.DISABLE_VOLTAGE, 0)  # a reset is the bit's rising edge
        self._pdo(cia402.FAULT_RESET, 0)

    def set_speed(self, rpm: float) -> None:
        """Ramp to a speed (whole rpm on this drive's wire)."""
        self._target_rpm = round(rpm)
        self._pdo(cia402.ENABLE_OPERATION, self._target_rpm)

    def disable(self) -> None:
        """Take the torque away; the rotor must be at rest."""
        self._armed = False
        self._target_rpm = 0
        self._pdo(cia402.SHUTDOWN, 0)

    def quick_stop(self) -> None:
        """Stop as fast as the drive can."""
        self._armed = False
        self._target_rpm = 0
        self._pdo(cia402.QUICK_STOP, 0)

    def _pdo(self, control: int, rpm: int) -> None:
        self._network.send_message(cia402.cob_rpdo(1, self._config.node_id), cia402.pack_rpdo1(control, rpm))

    def _start_heartbeat(self) -> None:
        self._beating.set()
        period = self._config.heartbeat_ms * 1e-3

        def beat() -> None:
            identifier = cia402.cob_heartbeat(self._config.host_node_id)
            while self._beating.is_set():
                self._network.send_message(identifier, bytes([cia402.Heartbeat.OPERATIONAL]))
                time.sleep(period)

        self._beat = threading.Thread(target=self._guard(beat), name="heartbeat", daemon=True)
        self._beat.start()

    def _guard(self, beat: Callable[[], None]) -> Callable[[], None]:
        def run() -> None:
            try:
                beat()
            except Exception:  # the link is gone: its reader reports it; a silent heartbeat stops the drive
                self._beating.clear()

        return run

    def stop(self) -> None:
        """Stop the rotor, then end the heartbeat and the node's operation.

        Torque is taken away only at rest: a rotor left to run down would pass its resonances slowly.
        """
        if self._beat is not None:
            self._rest()
            self._beating.clear()
            self._beat.join(timeout=2.0)
            self._pdo(cia402.DISABLE_VOLTAGE, 0)
            self._network.send_message(0, bytes([0x80, self._config.node_id]))
            self._send(b"C\r")
            self._beat = None

    def _rest(self) -> None:
        """Quick stop, and wait for the drive's own word that the rotor stands."""
        if self.actual_rpm == 0 and self.state != cia402.OPERATION_ENABLED:
            return
        self.quick_stop()
        deadline = time.monotonic() + _REST_WAIT_S
        while self.actual_rpm != 0 and time.monotonic() < deadline:
            time.sleep(0.01)
