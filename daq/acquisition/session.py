"""An open rig: ports, clock and disk for the core of the acquisition.

Every device has a reader. The session passes the bytes of the readers to the core (`daq.acquisition.core`) and carries
out its effects: it writes to the log, warns the operator and stops the drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from daq.acquisition.core import Core
from daq.acquisition.edge import Edge, real_edge
from daq.acquisition.effects import Effect, Happened, Keep, Note, StopRotor, Warn, WriteHealth
from daq.acquisition.interlock_table import LOOK_S
from daq.acquisition.life import COMMANDING, Life, Policy, Stage, Step, guarded
from daq.acquisition.links import Links
from daq.acquisition.newest import Channels
from daq.acquisition.open_devices import OpenDevices
from daq.acquisition.reader import keep_heap_whole
from daq.acquisition.rotor_command import RotorCommand
from daq.acquisition.session_log import SessionLog
from daq.drivers.contract import SpeedControl
from daq.drivers.devices import devices_of
from daq.errors import AcquisitionError, DeviceError, LinkLost, OperatorStop
from daq.items import RX, TX, DeviceEvent
from daq.log.file import ReservedName
from daq.transports import HostClock
from daq.transports.host_clock import Repeated
from rig_configs.ports import refuse_shared_ports
from rig_configs.schema import Rig

_MAX_START_S = 3.0  # from the start of the streams to samples of every device, s
_MAX_BUSY_S = 0.25  # longest wait of 3 ms on a busy host; a longer one is a stall (suspended, stopped), s


class Session:
    """All devices of a rig, open and streaming.

    Args:
        rig: the rig file.
        clock: the host clock.
        identities: identities of the devices. Used by sessions that only receive. `open` queries the devices itself.
        notify: called with one line of text for the operator.
        edge: ports and disk; those of the machine if None.
        policy: what the session may do.
    Raises:
        RigFileError: two devices use the same port.
        LinkLost: `open` or `listen`: a port cannot be opened.
        DeviceError: `open` or `listen`: a device does not respond as configured. End of the `with` block, if no other
            error ended it: the rotor still turns.

    Attributes:
        life: stage of the session.
        rotor: speed source, locks and state of the rotor.
        channels: newest samples and rates.
        devices: what is open, and what the devices report of themselves.
        recording: the log that is recorded, its disk and its losses.
        device_event_observers: called with every event of a device.
        host_event_observers: called with every event of the host and its time, ns.
        health_observers: called with every health report and its time, ns.
        rotor_warning: after `close`, the warning that the rotor may turn or the drive may hold it; empty if neither.
    """

    def __init__(
        self,
        rig: Rig,
        clock: HostClock,
        identities: Mapping[str, Mapping[str, Any]] | None = None,
        notify: Callable[[str], None] = lambda text: None,
        edge: Edge | None = None,
        policy: Policy = COMMANDING,
    ) -> None:
        self.rig: Rig = rig
        self.clock: HostClock = clock
        self.identities: dict[str, dict[str, Any]] = {name: dict(known) for name, known in (identities or {}).items()}
        self.device_event_observers: list[Callable[[DeviceEvent], None]] = []
        self.host_event_observers: list[Callable[[DeviceEvent, int], None]] = []
        self.health_observers: list[Callable[[Mapping[str, Any], int], None]] = []
        self.rotor_warning: str = ""
        self.life: Life = Life()
        self._known = devices_of(rig.devices)
        refuse_shared_ports(rig.devices)  # the rig may come from a log and not from a checked file
        self._notify = notify
        edge = edge or real_edge()
        core = self._core = Core(rig, policy, self.life)
        self._links = Links(self._known, clock, edge, core, self.identities, self._on_bytes, self._on_link_lost)
        self.rotor: RotorCommand = RotorCommand(core, self._known, self._links.send, clock, self.check)
        topics = tuple(channel.topic for device in self._known.values() for channel in device.channels)
        self.channels: Channels = Channels(core, clock, topics)
        self.devices: OpenDevices = OpenDevices(self._known, core, self._links, clock)
        self.recording: SessionLog = SessionLog(rig, clock, self.identities, core, self._links, edge.disk)
        self._ticking: Repeated | None = None
        self._stop_reason: str | None = None  # of a stop that was requested and not yet carried out

    # --- beginning and end ---------------------------------------------------------------------------------------

    def open(self) -> Session:
        """Open every link, identify the devices and start their streams."""
        if not self.policy.commands:
            raise ValueError("a session that only receives begins with `listen`")
        try:
            self._open_links()
            self.life.go(Step.START)
            self._links.read()
            self._links.start_streams()
            for name, identity in self.identities.items():
                if text := identity.get("warning"):
                    self._execute(self._core.warn(f"{name}: {text}"))
            if self.rotor.drive_name not in self._links.refused:
                with self._links.refusing(self.rotor.drive_name, DeviceError, LinkLost):
                    self.rotor.start()
            self._wait_alive("every device to send samples")
            # bytes from the port buffers were delayed and would disturb the clock maps
            self.recording.renew_pipelines(None)
            self._wait_alive("every device to continue to send samples")
            self._watch()
        except BaseException as error:
            self.close(error)
            raise
        return self

    def listen(self, path: Path | ReservedName, metadata: Mapping[str, str]) -> Session:
        """Open every link without sending anything, and record from the first byte. Another program runs the rig.

        No device is configured and the rotor is not turned. A device may be silent. The identities are those given to
        the session; where one is missing, the rig file applies.

        Args:
            path: of the log.
            metadata: facts of the run.
        Raises:
            ValueError: the policy of the session is to command the rig.
        """
        if self.policy.commands:
            raise ValueError("a session that only receives needs the policy `LISTENING`")
        try:
            self._open_links()
            self._watch()
            self.start_recording(path, metadata)
            self._links.read()
        except BaseException as error:
            self.close(error)
            raise
        return self

    def _open_links(self) -> None:
        keep_heap_whole()
        self.life.go(Step.OPEN)
        self._links.open()

    def _watch(self) -> None:
        self.life.go(Step.WATCH)
        # an error in a tick ends the run, since disk and silence would no longer be monitored
        self._ticking = self.clock.every(LOOK_S, self._tick, "health", self.fail)

    def __enter__(self) -> Session:
        return self if self.life.stage is not Stage.NEW else self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(error)

    def close(self, because: BaseException | None = None) -> None:
        """Stop drive and streams, finish an open log with the reason of its end, and close every link.

        Args:
            because: error that ended the session; None if it ended without one.
        Raises:
            DeviceError: the rotor turns or may turn, and `because` is None. A `lenient` session has it in
                `rotor_warning` only.
        """
        if self.closed:
            return
        left = self.life.go(Step.CLOSE)  # streams that end from here on were ended by the session
        at_rest: bool | None = False
        try:
            if left in (Stage.NEW, Stage.OPENING):
                at_rest = True
            else:
                self.rotor_warning = "the wait for the rotor to stop was interrupted"
                at_rest, self.rotor_warning = self._stop_devices(guarded(left))
        finally:
            try:
                if self.recording.recorder is not None:
                    ended = self._ended(because) or "session closed"
                    self.stop_recording({"ended": f"{ended}; {self.rotor_warning}" if self.rotor_warning else ended})
            finally:
                self.life.go(Step.FINISH)
                if self._ticking is not None:
                    self._ticking.stop()
                self._links.close()
        if not at_rest and because is None and not self.policy.lenient:
            raise DeviceError(self.rotor_warning)

    @property
    def closed(self) -> bool:
        """Whether the session has ended: the log is complete and the links are closed."""
        return self.life.stage is Stage.CLOSED

    def _ended(self, because: BaseException | None) -> str:
        """Return the text of the error that ended the session or a log; empty if there is none."""
        if self.trouble is not None:
            return str(self.trouble)
        if isinstance(because, KeyboardInterrupt):
            return str(because) or "Ctrl-C"
        if because is None or isinstance(because, GeneratorExit | SystemExit):
            return ""
        return str(because) if isinstance(because, AcquisitionError) else f"{type(because).__name__}: {because}"

    def _reach_drive(self) -> bool:
        """Open the drive's link again if it was lost. Return whether it was lost and is open now."""
        name = self.rotor.drive_name
        if name not in self._core.gone:
            return False
        self._execute(self._links.reopened(name, self.rotor))
        return name not in self._core.gone

    def _stop_devices(self, watched: bool) -> tuple[bool, str]:
        """Bring the rotor to rest and stop the streams. A lost device does not prevent the stop of the others.

        Args:
            watched: whether all devices had been opened.

        Returns:
            Whether the rotor is at rest (True if this session does not turn it), and a warning if the rotor may turn
            or the drive may not have released it; empty otherwise.
        """
        if not self.policy.commands:
            return True, ""
        drive = self.rotor.drive_name
        if drive in self._links.refused and not self.rotor.started:
            self._links.stop_streams()
            return True, ""
        released = self.rotor.bring_to_rest(self._notify, watched, self._reach_drive)
        self._links.stop_streams()
        at_rest = self.rotor.at_rest()
        if released or not watched or (at_rest and not drive):
            return True, ""
        if at_rest:
            text = f"{drive}: the rotor is at rest, but the drive may not have released it; check its power and cable"
        else:
            text = f"{self.rotor.words()}; keep away from it"
        self._execute(self._core.warn(text))
        return bool(at_rest), text

    def _wait_alive(self, what: str) -> None:
        """Wait for samples of every device. The error describes what the other devices sent."""
        try:
            self.wait_for(lambda: not self.devices.without_samples(), _MAX_START_S, what)
        except DeviceError as error:
            silent = {name: self.devices.received_words(name) for name in self.devices.without_samples()}
            if self.trouble is not None or not silent:
                raise
            if self.policy.lenient:
                self._links.refused.update(silent)
                return
            raise DeviceError(f"{error}: {'; '.join(silent.values())}") from error

    # --- bytes, and the effects of the core ----------------------------------------------------------------------

    def _on_bytes(self, name: str, sent: Sequence[tuple[bytes, int]], data: bytes, host_ns: int) -> None:
        """Pass the bytes sent to a device, and then the bytes received from it, to the core."""
        for written, written_ns in sent:
            self._execute(self._core.feed(name, TX, written, written_ns))
        if data:
            self._execute(self._core.feed(name, RX, data, host_ns))

    def _on_link_lost(self, name: str, error: Exception) -> None:
        self._execute(self._core.lost(name, error, self.clock.now_ns()))

    def _tick(self) -> None:
        with self.recording.changes:
            recorder = self.recording.recorder
            self._execute(
                self._core.tick(
                    self.clock.now_ns(),
                    self.rotor.drive_state(),
                    recorder.look() if recorder is not None else None,
                    recorder.trouble if recorder is not None else None,
                )
            )

    def _execute(self, effects: Iterable[Effect]) -> None:
        for effect in effects:
            recorder = self.recording.recorder
            if recorder is not None and isinstance(effect, Keep | Note | WriteHealth):
                recorder.add(effect)
            match effect:
                case Keep():
                    if effect.direction == RX:
                        self.rotor.notice(effect.device, self._core.pipelines[effect.device])
                case Happened(event):
                    self._on_device_event(event)
                case Note(event, host_ns):
                    for observe in self.host_event_observers:
                        observe(event, host_ns)
                case WriteHealth(facts, host_ns):
                    for reported in self.health_observers:
                        reported(facts, host_ns)
                case Warn(text):
                    self._notify(text)
                case StopRotor():
                    self.rotor.quick_stop()

    def _on_device_event(self, event: DeviceEvent) -> None:
        for observe in self.device_event_observers:
            observe(event)
        if event.kind == "reply":
            self._links.answered(event.device, event.text)
        elif event.kind == "acknowledge":
            self.rotor.acknowledged(event)

    # --- state ---------------------------------------------------------------------------------------------------

    @property
    def trouble(self) -> Exception | None:
        """The first error that ended the run; None if there is none."""
        return self._core.trouble

    @property
    def notices(self) -> list[str]:
        """Warnings shown to the operator. A run with warnings is not a clean run."""
        return self._core.notices

    def warn_of_obstacles(self) -> None:
        """Warn of each reason why the rotor must not be turned now, for example a sensor without valid readings."""
        for text in self._core.interlocks.obstacles(self.clock.now_ns()):
            self._execute(self._core.warn(text))

    @property
    def policy(self) -> Policy:
        """What the session may do."""
        return self._core.policy

    @property
    def drive(self) -> SpeedControl:
        """Speed source of an open session.

        Raises:
            DeviceError: the session has none.
        """
        if self.rotor.drive is None:
            raise DeviceError(f"rig {self.rig.name} has no open speed source: its rotor cannot be turned by command")
        return self.rotor.drive

    def host_words(self) -> str:
        """Return a sentence about the host if it was late recently; empty if not."""
        return self._core.host.words(self.clock.now_ns())

    # --- recording -----------------------------------------------------------------------------------------------

    def note(self, event: DeviceEvent) -> None:
        """Write an event of the host to the log, if one is recorded, and notify the observers."""
        self._execute((Note(event, self.clock.now_ns()),))

    def start_recording(self, path: Path | ReservedName, metadata: Mapping[str, str], before_s: float = 0.0) -> None:
        """Begin a log. Every device gets a new pipeline, so that the log alone decodes to the same samples.

        Args:
            path: of the log.
            metadata: facts of the run.
            before_s: length of the pre-trigger, s; at most `daq.acquisition.core.PAST_S`. The bytes that were
                kept of every device pass through the new pipelines first.
        """
        if self.recording.recorder is not None:
            self.stop_recording({"ended": self._ended(None) or "another recording began"})
        self.life.after(Step.RECORD)  # refused before the file is created
        self.recording.begin(path, metadata, before_s)
        self.life.go(Step.RECORD)

    def stop_recording(self, summary: Mapping[str, Any]) -> Path:
        """End the log and return its path. Losses and the reason of the end are written to its summary."""
        self.life.go(Step.END_LOG)
        return self.recording.end(lambda: self._ended(None) or "the test's end", summary)

    # --- waiting and commands ------------------------------------------------------------------------------------

    def check(self) -> None:
        """Raise the error that ended the run, if any, and try to reopen devices with a lost link."""
        core = self._core
        if self._stop_reason is not None:
            reason, self._stop_reason = self._stop_reason, None
            self.stop(reason)
        if core.trouble is None and self.rotor.dropped_out and self.life.guarding:
            end = self.clock.now_s() + 2.0  # the core stops the rotor and waits for the drive's reason
            while core.trouble is None and self.clock.now_s() < end:
                self.clock.wait(0.01)
        if core.trouble is not None:
            raise core.trouble
        if self.life.guarding:
            self._execute(self._links.attend(self.rotor))

    def wait_for(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait until a condition is true.

        Args:
            condition: is evaluated every 3 ms.
            seconds: timeout, s, without the time for which the host was stalled.
            what: description of the condition for the message.

        Raises:
            DeviceError: timeout.
        """
        deadline = self.clock.now_s() + seconds
        while not condition():
            self.check()
            if self.clock.now_s() > deadline:
                raise DeviceError(f"waited {seconds:g} s for {what}: timeout")
            deadline += self._stalled_s()

    def _stalled_s(self) -> float:
        """Wait 3 ms, and return the time by which a stalled host exceeded this, s; 0 for a host that is busy.

        The devices' bytes waited as well, so that their time-outs would blame the devices.
        """
        before_s = self.clock.now_s()
        self.clock.wait(0.003)
        return max(0.0, self.clock.now_s() - before_s - _MAX_BUSY_S)

    def stop(self, reason: str) -> None:
        """End the run for the operator. The drive gets the stop immediately, in the caller's thread."""
        self.fail(OperatorStop(reason))

    def request_stop(self, reason: str) -> None:
        """End the run for the operator at the next check, in the thread that checks.

        On simulated time only the thread that advances it may send.
        """
        self._stop_reason = reason

    def fail(self, error: Exception) -> None:
        """End the run with an error, and stop the rotor immediately, in the caller's thread."""
        self._execute(self._core.fail(error, self.clock.now_ns()))
