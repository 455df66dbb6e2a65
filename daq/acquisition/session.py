"""An open rig: one reader thread per device, fresh pipelines per log, the last seconds of every channel at hand."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.exceedance import compile_look
from daq.acquisition.interlocks import Interlocks, Stop
from daq.acquisition.rate_watch import RateWatches
from daq.acquisition.reader import DeviceReader, OpenDevice, keep_heap_whole
from daq.acquisition.recent import Recent
from daq.acquisition.recorder import DiskState, Recorder
from daq.clock import compile_line
from daq.drivers.checks import Checks
from daq.drivers.contract import MovesLocks, PendulumLocks, RotorGuard, SpeedSource, TellsItself, TurnsRotor
from daq.drivers.devices import channels_of, devices_of, make_pipelines
from daq.drivers.items import RX, TX, Batch, Event
from daq.errors import DeviceError, LinkLost, ProcedureError, RigError
from daq.log.file import ReservedName
from daq.transports import HostClock, open_link
from daq.version import software_version
from rig_configs.schema import Rig

_KEEP_S = 90.0
_ALIVE_S = 3.0  # wall seconds
_HEALTH_S = 1.0
_LOOK_S = 0.1  # wall seconds between two looks at every channel
_WATCH_S = 0.25  # wall seconds between two looks for silent devices, and at the disk
_SILENCE_S = 2.0  # wall seconds
_BY_ITSELF_S = 8.0  # wall seconds for a drive out of reach to stop by itself, and for the index marks to show it
_NEWEST_S = 20.0  # how far back the newest stretch of a channel may lie
_REASON_S = 0.3  # wall seconds that a drive may take to say why it stopped


class Session:
    """All devices of a rig, open and streaming.

    Args:
        rig: the rig file.
        clock: the host clock.
        identities: what the devices are known to be, for a session that only listens; `open` asks them itself.
        say: told what the operator has to know at once, a line each.
    Raises (from `open` and `listen`):
        LinkLost: a port cannot be opened.
        DeviceError: a device does not answer as it should.
    Raises (at the end of a `with` that nothing else ends):
        DeviceError: the rotor still turns.

    Attributes:
        trouble: the first thing that ended the run; None as long as it is fine.
        notices: what was said to the operator: a run with any is not a clean one.
    """

    def __init__(
        self,
        rig: Rig,
        clock: HostClock,
        identities: Mapping[str, Mapping[str, Any]] | None = None,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.rig, self.clock = rig, clock
        self._channels = tuple(channels_of(rig.devices).values())
        self.recent = Recent(_KEEP_S, self._channels)
        self.identities: dict[str, dict[str, Any]] = {name: dict(known) for name, known in (identities or {}).items()}
        self._known = devices_of(rig.devices)
        self.rates = RateWatches(rig.devices)
        self.observers: list[Callable[[Event], None]] = []  # told of every event
        self.trouble: Exception | None = None
        self.notices: list[str] = []
        self._say = say
        self.lenient = False  # whether a device that is not what the rig file says is only looked at, as by `rig check`
        self._drive: SpeedSource | None = None
        self._drive_name = ""
        self._devices: dict[str, DeviceReader] = {}
        self._recorder: Recorder | None = None
        self._locks: PendulumLocks | None = None
        self._interlocks = Interlocks(rig.limits, rig.roles, clock.patience, driving=True)
        self._commanding = self._opened = self._guarding = self._closing = False
        self._disk_slow = False

    def open(self) -> Session:
        """Open every link, identify the devices, start their streams."""
        try:
            self._open_links()
            self._take_command()
            self._start_readers()
            for name, device in self._known.items():
                self.identities[name] = device.driver.open(name, device.settings, self._talk(name))
            if self._drive is not None:
                self._drive.start()
            self._wait_alive("every device to send samples")
            self._begin_anew(None)  # what waited in the ports' buffers was late and would mislead the clock maps
            self._wait_alive("every device to go on sending samples")
            self._opened = self._guarding = True
            self._start_watching()
        except BaseException as error:
            self.close(error)
            raise
        return self

    def listen(self, path: Path | ReservedName, metadata: Mapping[str, str]) -> Session:
        """Open every link without a word and record from the first byte; whoever runs the rig is someone else.

        Nothing is configured and nothing is turned; a device may be silent. Identities are those given to the session,
        else the rig file's word counts.
        """
        self._interlocks = Interlocks(self.rig.limits, self.rig.roles, self.clock.patience, driving=False)
        try:
            self._open_links()
            self.start_recording(path, metadata)
            self._start_readers()
            self._opened = self._guarding = True
            self._start_watching()
        except BaseException as error:
            self.close(error)
            raise
        return self

    def _open_links(self) -> None:
        keep_heap_whole()
        compile_look()
        compile_line()
        for device in self._known.values():
            device.driver.prepare()
        for name, device in self._known.items():
            line = device.line
            link = open_link(line.port, line.baud, line.bitrate, line.parity)
            self._devices[name] = DeviceReader(name, link, device.pipeline({}), self.clock, device.driver.rest_s)

    def _take_command(self) -> None:
        """Of what turns the rotor and of what holds the pendulums."""
        self._commanding = True
        guard = RotorGuard(self._permit, self.rotor_at_rest, lambda: self._interlocks.speed_rpm(self.clock.now_ns()))
        for name, device in self._known.items():
            send = partial(self.send, name)
            if isinstance(device.driver, TurnsRotor):
                self._drive_name = name
                self._drive = device.driver.speed_source(device.settings, send, self.clock, guard)
            if isinstance(device.driver, MovesLocks):
                self._locks = device.driver.locks(device.settings, send)

    def _talk(self, name: str) -> OpenDevice:
        reader = self._devices[name]
        return OpenDevice(reader, partial(self._forget, reader))

    def _start_readers(self) -> None:
        for device in self._devices.values():
            device.start(partial(self._take, device), self._fail)

    def _start_watching(self) -> None:
        threading.Thread(target=self._watch, name="health", daemon=True).start()

    def __enter__(self) -> Session:
        return self if self._devices else self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(error)

    def close(self, because: BaseException | None = None) -> None:
        """Stop drive and streams, close every link; a log that is still open ends with how it ended.

        Args:
            because: what ended the session; None when it came to its end.
        Raises:
            DeviceError: the rotor still turns, or may, and nothing else ended the session.
        """
        if self._closing:
            return
        self._guarding = False  # what ends now ends because we say so
        rest = "the wait for the rotor to stop was interrupted"
        try:
            rest = self._stop_devices()
        finally:
            try:
                if self._recorder is not None:
                    ended = self._ended(because) or "session closed"
                    self.stop_recording({"ended": f"{ended}; {rest}" if rest else ended})
            finally:
                self._closing = True
                for device in self._devices.values():
                    device.stop()
        if rest and because is None:
            raise DeviceError(rest)

    def _ended(self, because: BaseException | None) -> str:
        """What ended the session or a log, in words; empty when nothing did."""
        if self.trouble is not None:
            return str(self.trouble)
        if isinstance(because, KeyboardInterrupt):
            return str(because) or "Ctrl-C"
        if because is None or isinstance(because, GeneratorExit | SystemExit):
            return ""
        return str(because) if isinstance(because, RigError) else f"{type(because).__name__}: {because}"

    def _stop_devices(self) -> str:
        """Rotor to rest, streams off; a device that is gone does not keep the others from being stopped.

        Returns:
            What there is to say of a rotor that is not known to stand; empty when it stands.
        """
        if not self._commanding:
            return ""
        try:
            rest = not self.turning() if self._drive is None else self._drive.stop(self._say)
        except (LinkLost, DeviceError):  # its own watchdog stops it now; the index marks show it
            rest, end = False, time.monotonic() + _BY_ITSELF_S
            while self._opened and self.rotor_at_rest() is False and time.monotonic() < end:
                time.sleep(0.02)
        for name, device in self._known.items():
            with contextlib.suppress(LinkLost, DeviceError):
                device.driver.stop(self._talk(name))
        if rest or not self._opened or self.rotor_at_rest():
            return ""
        still = "nobody can tell whether the rotor stands" if self.rotor_at_rest() is None else "the rotor still turns"
        text = f"{still} ({self.rotor_words()}); keep away from it"
        self._notice(text)
        return text

    def _notice(self, text: str) -> None:
        """Say something to the operator, once; it stays on record."""
        if text not in self.notices:
            self.notices.append(text)
            self._say(f"warning: {text}")

    @property
    def drive(self) -> SpeedSource:
        """What turns the rotor in an open session.

        Raises:
            DeviceError: nothing does.
        """
        if self._drive is None:
            raise DeviceError(f"rig {self.rig.name} has no open speed source: nothing turns its rotor by command")
        return self._drive

    @property
    def topics(self) -> tuple[str, ...]:
        """Channels that its devices fill all the time."""
        return tuple(channel.topic for device in self._known.values() for channel in device.channels)

    def _silent(self) -> list[str]:
        """Devices of which no sample has come."""
        return [
            name
            for name, device in self._known.items()
            if not all(len(self.recent.last(channel.topic, ())[0]) for channel in device.channels)
        ]

    def _wait_alive(self, what: str) -> None:
        """Wait for samples of every device; of those that give none, say what came instead."""
        try:
            self.wait_for(lambda: not self._silent(), _ALIVE_S, what)
        except DeviceError as error:
            silent = self._silent()
            if self.trouble is not None or not silent:
                raise
            raise DeviceError(f"{error}: {'; '.join(map(self._what_came, silent))}") from error

    def _what_came(self, name: str) -> str:
        device = self._devices[name]
        lost = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in device.pipeline.losses.items() if n)
        came = f"{device.bytes_in} bytes came, none of them a sample" if device.bytes_in else "silent"
        return f"{name}: {came}{f' ({lost})' if lost else ''}. Look at its power, its settings and the rig file"

    def _forget(self, device: DeviceReader) -> None:
        """A fresh pipeline for a device whose line has just run dry: what it sent before was told to someone else."""
        with device.lock:
            device.pipeline = self._known[device.name].pipeline(self.identities.get(device.name, {}))

    # --- bytes -------------------------------------------------------------------------------------------------

    def send(self, name: str, data: bytes) -> None:
        """Write to a device at once, whatever log and decoders are busy with; the log gets the bytes afterwards.

        Raises:
            LinkLost: the device is gone.
        """
        self._devices[name].send(data)

    def _take(self, device: DeviceReader, sent: Sequence[tuple[bytes, int]], data: bytes, host_ns: int) -> None:
        """What went to a device and then what came from it: into the log, through the pipeline, to the interlocks."""
        for written, written_ns in sent:
            self._keep(device, TX, written, written_ns)
        if not data:
            return
        found = self._keep(device, RX, data, host_ns)
        if self._drive is not None and device.name == self._drive_name:
            self._drive.notice(device.pipeline)
        for item in found:
            if isinstance(item, Batch):
                self.recent.add(item)
                self._heed(self._interlocks.feed(item, host_ns), host_ns)
                continue
            for observe in self.observers:
                observe(item)
            if item.kind == "reply":
                device.replies.put(item.text)
            elif item.kind == "acknowledge":
                if self._locks is not None:
                    self._locks.heard(item)
            else:
                self._happened(item, host_ns)

    def _keep(self, device: DeviceReader, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """Decode, and leave bytes and what they hold to the recorder together; the decoding keeps nobody waiting."""
        recorder = self._recorder
        found: list[Batch | Event] = []
        try:
            found = device.pipeline.feed(direction, data, host_ns)
            found += self.rates.feed(found, host_ns)
        finally:  # bytes that no decoder takes are those the log needs most
            if recorder is not None:
                with recorder.together():
                    # after the run's end the recorder takes no more; interlocks go on
                    for item in found if recorder.raw(device.name, direction, data, host_ns) else ():
                        recorder.batch(item, host_ns) if isinstance(item, Batch) else recorder.event(item, host_ns)
        return found

    def _happened(self, event: Event, host_ns: int) -> None:
        if event.kind == "emergency":
            self._tell_emergency(event)
        if self._guarding:
            self._heed(self._interlocks.happened(event), host_ns)

    def _tell_emergency(self, event: Event) -> None:
        words = self._known[event.device].driver.words(event)
        if words and not self._closing:
            self._notice(f"{event.device}: emergency {words}. The run is not clean")

    def _heed(self, found: Iterable[Event | Stop], host_ns: int) -> None:
        """Carry out what the interlocks found."""
        for item in found:
            if isinstance(item, Event):
                recorder = self._recorder
                if recorder is not None:
                    recorder.event(item, host_ns)
            elif not self._guarding:
                continue
            elif not self._commanding or self.lenient:
                self._notice(item.text)
            elif self.trouble is None:  # later ones change nothing
                kind = DeviceError if item.cause == "device" else ProcedureError
                turning = self._interlocks.turning(host_ns)
                self._fail(kind(f"{item.text}; {self._stopped_words}" if turning else item.text))

    @property
    def _stopped_words(self) -> str:
        return "stop the rotor" if self._drive is None else "the rotor was stopped"

    def _fail(self, error: Exception) -> None:
        """Remember the first trouble and stop the rotor; whoever waits is told."""
        first = self.trouble is None
        if first:
            self.trouble = error
        if self._drive is not None:
            with contextlib.suppress(Exception):  # the drive's own watchdog stops it when our heartbeat ends
                self._drive.quick_stop()
            self._interlocks.told(0.0)
        elif first and self._commanding and self.turning():
            self._say(f"warning: STOP THE ROTOR: {error}")
        recorder = self._recorder
        if first and recorder is not None:
            recorder.event(Event("stop", "host", str(error)), self.clock.now_ns())

    def _permit(self, rpm: float | None) -> None:
        """Whether the drive may be enabled (None) or told a speed; raises why not."""
        self.check()
        if rpm is not None and abs(rpm) > self.rig.limits.speed_rpm:
            limit = self.rig.limits.speed_rpm
            raise ProcedureError(f"{rpm:.0f} rpm wanted, limits.speed_rpm is {limit:.0f}: the drive was not told")
        if rpm != 0 and (obstacles := self._interlocks.obstacles(self.clock.now_ns())):
            raise DeviceError(f"the rotor is not turned: {'; '.join(obstacles)}")
        if rpm is not None:
            self._interlocks.told(rpm)

    def newest(self, topic: str, fields: tuple[str, ...], seconds: float) -> tuple[NDArray[np.int64], list[Any]]:
        """The newest stretch of a channel, counted back from its newest sample: a late read is no silence."""
        time_ns, columns = self.recent.last(topic, fields, self.clock.now_ns() - int(_NEWEST_S * 1e9))
        if len(time_ns) == 0:
            return time_ns, columns
        new = time_ns > time_ns[-1] - int(seconds * 1e9)
        return time_ns[new], [column[new] for column in columns]

    def note(self, event: Event) -> None:
        """Put what the host found out into the log, if one is being recorded."""
        recorder = self._recorder
        if recorder is not None:
            recorder.event(event, self.clock.now_ns())

    def need(self, *topics: str) -> None:
        """Channels that the running test lives on, at rest too; silence of one ends it. Without any: none."""
        self._interlocks.need(topics)

    def rotor_at_rest(self) -> bool | None:
        """Whether the rotor stands, by the drive's fresh word and the index marks; None when neither tells."""
        return self._interlocks.at_rest(self.clock.now_ns())

    def turning(self) -> bool:
        """Whether the rotor turns, or may: nobody can say that it does not."""
        return self._interlocks.turning(self.clock.now_ns())

    def rotor_rpm(self) -> float:
        """How fast the rotor turns, by all that is known; NaN when nobody can tell."""
        return self._interlocks.speed_rpm(self.clock.now_ns())

    def permit_by_hand(self, rpm: float | None) -> None:
        """Ask before the operator is told to turn the rotor; from then on it is watched as if a drive turned it.

        Args:
            rpm: the speed; None before anything turns.

        Raises:
            DeviceError, ProcedureError: a guard is missing, or the speed is beyond its limit.
        """
        self._permit(rpm)

    def rotor_words(self) -> str:
        """What is known of the rotor's speed, for a message."""
        return self._interlocks.rotor_words(self.clock.now_ns())

    def wait_for_rest(self, wall_s: float) -> None:
        """Wait until the rotor stands.

        Raises:
            DeviceError: it does not, or nobody can tell.
        """
        deadline = time.monotonic() + wall_s
        while not (rest := self.rotor_at_rest()):
            self.check()
            if time.monotonic() > deadline:
                still = "nobody can tell whether the rotor stands" if rest is None else "the rotor still turns"
                raise DeviceError(f"{still} after {wall_s:g} s: {self.rotor_words()}. Look at drive and rotor")
            time.sleep(0.003)

    def _watch(self) -> None:
        try:
            self._report_health()
        except Exception as error:  # nobody would look at disk and silence any more
            self._fail(error)

    def _report_health(self) -> None:
        due = look = time.monotonic()
        silent: set[str] = set()
        while not self._closing:
            time.sleep(_LOOK_S)
            now, now_ns = time.monotonic(), self.clock.now_ns()
            self._heed(self._interlocks.tick(now_ns), now_ns)
            if self._drive is not None and self._guarding:
                self._watch_drive(self._drive)
            if now < look:
                continue
            look = now + _WATCH_S
            still = {n for n, d in self._devices.items() if now - d.heard_s > _SILENCE_S}
            for name in still & silent if self._commanding else ():  # seen twice: no host that was asleep
                self._fail(
                    DeviceError(f"{name}: silent for {_SILENCE_S:g} s. Look at its cable, its power, its battery")
                )
            silent = still
            recorder = self._recorder
            if recorder is not None:
                self._look_at_disk(recorder)
            if now >= due and recorder is not None:
                due = now + _HEALTH_S / self.clock.rate
                facts = {"losses": self.losses(), "disk": recorder.state().facts()}
                facts["bytes"] = {n: d.bytes_in for n, d in self._devices.items()}
                recorder.health({"kind": "health", "device": "host", "text": "", **facts})

    def _watch_drive(self, drive: SpeedSource) -> None:
        if self.trouble is None and drive.dropped_out is not None:
            self._fail(self._dropped_out(drive.dropped_out))
        elif self.trouble is not None and drive.enabled:
            self._fail(self.trouble)  # again: one frame may be lost

    def _look_at_disk(self, recorder: Recorder) -> None:
        """Say that the disk is slow while nothing is lost yet; end the run when it has to be."""
        state = recorder.look()
        if state.slow != self._disk_slow:
            self._disk_slow = state.slow
            text = (
                f"the disk is slow: {state.backlog_bytes / 1e6:.1f} MB wait, the oldest for {state.unsynced_s:.1f} s"
                if state.slow
                else "the disk keeps up again"
            )
            recorder.event(Event("disk", "host", text, state.facts()), self.clock.now_ns())
        if recorder.trouble is not None:
            self._fail(recorder.trouble)

    def told(self, name: str) -> tuple[bool, str]:
        """Whether a device has said what it is, with all that this leads to done, and what was wrong with it.

        A device that never says anything of itself has said all there is.
        """
        device = self._devices[name]
        with device.lock:
            pipeline = device.pipeline
            return (pipeline.told, pipeline.complaint) if isinstance(pipeline, TellsItself) else (True, "")

    def all_told(self) -> bool:
        """Whether every device has said what it is."""
        return all(self.told(name)[0] for name in self._devices)

    def own_checks(self, events: Iterable[Event]) -> dict[str, Checks]:
        """What drivers look at in their open devices, by device.

        Args:
            events: of the seconds that were looked at.
        """
        happened = list(events)
        return {
            name: device.driver.checks(
                device.settings, self._devices[name].pipeline, self._drive if name == self._drive_name else None,
                [event for event in happened if event.device == name],
            )
            for name, device in self._known.items()
        }  # fmt: skip

    # --- recording ---------------------------------------------------------------------------------------------

    @property
    def bytes_in(self) -> int:
        """Bytes from all devices so far."""
        return sum(device.bytes_in for device in self._devices.values())

    @property
    def silent_s(self) -> float:
        """How long no device has sent anything, wall s."""
        return time.monotonic() - max(device.heard_s for device in self._devices.values())

    def disk(self) -> DiskState | None:
        """How the disk keeps up with the recording; None when nothing is recorded."""
        recorder = self._recorder
        return None if recorder is None else recorder.state()

    def losses(self) -> dict[str, dict[str, int]]:
        """Counted losses of every device since the recording began; a silence counts while it lasts."""
        return self._losses(self.clock.now_ns())

    def _losses(self, now_ns: int) -> dict[str, dict[str, int]]:
        silences = self._interlocks.losses(now_ns)
        return {name: {**device.pipeline.losses, **silences.get(name, {})} for name, device in self._devices.items()}

    def start_recording(self, path: Path | ReservedName, metadata: Mapping[str, str]) -> None:
        """Begin a log. Every device gets a fresh pipeline, so that the log alone decodes to the same samples."""
        if self._recorder is not None:
            self.stop_recording({"ended": self._ended(None) or "another recording began"})
        facts = {
            "rig": self.rig.name,
            "software": software_version(),
            "clock_rate": repr(self.clock.rate),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            **metadata,
        }
        attachments = {
            "rig.json": self.rig.snapshot_json(),
            "identities.json": json.dumps(self.identities).encode(),
            "roles.json": self.rig.roles_json(),
        }
        recorder = Recorder(path, self.clock, facts, attachments, tuple(self._devices), self._channels)
        self._begin_anew(recorder)

    def _begin_anew(self, recorder: Recorder | None) -> None:
        """Give every device a fresh pipeline, at a boundary between two reads."""
        pipelines = make_pipelines(self.rig.devices, self.identities)
        with self._between_reads():
            self.recent.clear()
            self.rates = RateWatches(self.rig.devices)
            for name, device in self._devices.items():
                device.pipeline = pipelines[name]
            self._recorder = recorder
            self._interlocks.begin(self.clock.now_ns())

    @contextlib.contextmanager
    def _between_reads(self) -> Iterator[None]:
        """No device is being read; what has gone out to them is in the log."""
        with ExitStack() as stack:
            for device in self._devices.values():
                stack.enter_context(device.lock)
                self._take(device, device.sent(), b"", 0)
            yield

    def stop_recording(self, summary: Mapping[str, Any]) -> Path:
        """End the log; losses and how it ended go into its summary."""
        recorder = self._recorder
        assert recorder is not None
        with self._between_reads():
            now_ns = self.clock.now_ns()
            losses, wrong_rates = self._losses(now_ns), self.rates.summary()  # a silence counts as its event says
            for event in self._interlocks.end(now_ns):
                recorder.event(event, now_ns)
            self._recorder = None
        ended = {"ended": self._ended(None) or "the test's end"}
        extra: dict[str, Any] = {"rates": wrong_rates} if wrong_rates else {}
        if self.notices:
            extra["warnings"] = self.notices
        return recorder.close({"losses": losses, **extra, **ended, **summary})

    # --- waiting and commands ----------------------------------------------------------------------------------

    def check(self) -> None:
        """Raise the first trouble a background thread met."""
        if self.trouble is None and self._drive is not None and self._drive.dropped_out is not None:
            self.trouble = self._dropped_out(self._drive.dropped_out)
        if self.trouble is not None:
            raise self.trouble

    def _dropped_out(self, state: str) -> ProcedureError:
        """What to say of a drive that left operation by itself; its reason may come a little after its state."""
        deadline = time.monotonic() + _REASON_S
        while not self.drive.why() and time.monotonic() < deadline:
            time.sleep(0.01)
        return ProcedureError(
            f"the drive went to {state} by itself{self.drive.why()}. Look at the log's events and at the drive, then "
            "repeat the test"
        )

    def wait_for(self, condition: Callable[[], bool], wall_s: float, what: str) -> None:
        """Wait until a condition holds, at most so long on the wall's clock.

        Raises:
            DeviceError: it does not come true in time.
        """
        deadline = time.monotonic() + wall_s
        while not condition():
            self.check()
            if time.monotonic() > deadline:
                raise DeviceError(f"waited {wall_s:g} s for {what}; it did not come")
            time.sleep(0.003)

    def command_node(self, action: str) -> None:
        """Have the pendulums locked or released, until it is acknowledged.

        Raises:
            DeviceError: refused (the message says why), never acknowledged, or the rig has no locks to command.
        """
        if self._locks is None or self.rig.roles.locks is None:
            raise DeviceError(f"rig {self.rig.name} has no locks that can be commanded: {action} by hand")
        self._locks.command(action, self.check)
