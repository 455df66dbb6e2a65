"""An open rig: the ports, the clock and the disk around the acquisition's core.

Every device has a reader; what it takes goes to the core (`daq.acquisition.core`), and what the core orders is carried
out here: bytes and samples into the log, a warning to the operator, a stop to the drive.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.core import Core, Happened, Keep, Note, Order, Report, StopRotor, Warn
from daq.acquisition.edge import Edge, real_edge
from daq.acquisition.exceedance import compile_look
from daq.acquisition.interlock_table import LOOK_S
from daq.acquisition.links import Links
from daq.acquisition.rate_watch import RateWatches
from daq.acquisition.reader import keep_heap_whole
from daq.acquisition.recent import Recent
from daq.acquisition.recorder import DiskState, Recorder
from daq.acquisition.rotor_command import RotorCommand
from daq.clock import CLOCK_RULES, NEWEST_RULES, compile_line
from daq.drivers.checks import Checks
from daq.drivers.contract import KeepsTime, LearnsIdentity, SpeedSource, TellsItself
from daq.drivers.devices import channels_of, devices_of, make_pipelines
from daq.drivers.items import RX, TX, Batch, Event
from daq.errors import DeviceError, OperatorStop, RigError
from daq.log.file import ReservedName
from daq.log.outcome import ENDED, tripping
from daq.transports import HostClock
from daq.transports.host_clock import Repeated
from daq.version import software_version
from rig_configs.ports import refuse_shared_ports
from rig_configs.schema import Rig

_ALIVE_S = 3.0  # wall seconds
_NEWEST_S = 20.0  # how far back the newest stretch of a channel may lie


class Session:
    """All devices of a rig, open and streaming.

    Args:
        rig: the rig file.
        clock: the host clock.
        identities: what the devices are known to be, for a session that only listens; `open` asks them itself.
        say: told what the operator has to know at once, a line each.
        edge: the ports and the disk; the machine's own if None.
    Raises (from `open` and `listen`):
        LinkLost: a port cannot be opened.
        DeviceError: a device does not answer as it should.
    Raises:
        RigFileError: two devices have one port.
    Raises (at the end of a `with` that nothing else ends):
        DeviceError: the rotor still turns.
    """

    def __init__(
        self,
        rig: Rig,
        clock: HostClock,
        identities: Mapping[str, Mapping[str, Any]] | None = None,
        say: Callable[[str], None] = lambda text: None,
        edge: Edge | None = None,
    ) -> None:
        self.rig, self.clock = rig, clock
        self.identities: dict[str, dict[str, Any]] = {name: dict(known) for name, known in (identities or {}).items()}
        self.observers: list[Callable[[Event], None]] = []  # told of every event of a device
        self.noted: list[Callable[[Event, int], None]] = []  # told of every event of the host, with its time
        self.reported: list[Callable[[Mapping[str, Any], int], None]] = []  # told of every health report, with its time
        self.left = ""  # at its end: of a rotor that may turn, or a drive that may hold it; empty when neither
        self.log: Path | None = None  # of the newest recording
        self._edge = edge or real_edge()
        self._channels = tuple(channels_of(rig.devices).values())
        self._known = devices_of(rig.devices)
        refuse_shared_ports(rig.devices)  # a rig that no file was read for, as a log's
        self._say = say
        self._core = Core(rig, clock.patience, driving=True)
        self._links: Links | None = None
        self._recorder: Recorder | None = None
        self._command: RotorCommand | None = None
        self._ticking: Repeated | None = None
        self._opened = False
        self._log_changes = threading.RLock()  # no tick between a log's last words and its end

    # --- beginning and end -------------------------------------------------------------------------------------

    def open(self) -> Session:
        """Open every link, identify the devices, start their streams."""
        try:
            links = self._open_links()
            self._core.commanding = True
            self._command = RotorCommand(self._core, self._known, self.send, self.clock, self.check)
            links.read()
            links.start_streams()
            if self._command.drive is not None:
                self._command.drive.start()
            self._wait_alive("every device to send samples")
            self._begin_anew(None)  # what waited in the ports' buffers was late and would mislead the clock maps
            self._wait_alive("every device to go on sending samples")
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
        self._core = Core(self.rig, self.clock.patience, driving=False)
        try:
            links = self._open_links()
            self.start_recording(path, metadata)
            links.read()
            self._start_watching()
        except BaseException as error:
            self.close(error)
            raise
        return self

    def _open_links(self) -> Links:
        keep_heap_whole()
        compile_look()
        compile_line()
        links = Links(self._known, self.clock, self._edge, self._core, self.identities, self._take, self._lost)
        self._links = links  # what is open when one fails is closed again
        links.open()
        return links

    @property
    def _open(self) -> Links:
        assert self._links is not None, "a session that is not open has no lines"
        return self._links

    def _start_watching(self) -> None:
        self._opened = self._core.guarding = True
        # nobody would look at disk and silence any more: that ends the run
        self._ticking = self.clock.every(LOOK_S, self._tick, "health", self._fail)

    def __enter__(self) -> Session:
        return self if self._links is not None else self.open()

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
        if self._core.closing:
            return
        self._core.guarding = False  # what ends now ends because we say so
        self.left = "the wait for the rotor to stop was interrupted"
        stands: bool | None = False
        try:
            stands, self.left = self._stop_devices()
        finally:
            try:
                if self._recorder is not None:
                    ended = self._ended(because) or "session closed"
                    self.stop_recording({"ended": f"{ended}; {self.left}" if self.left else ended})
            finally:
                self._core.closing = True
                if self._ticking is not None:
                    self._ticking.stop()
                if self._links is not None:
                    self._links.close()
        if not stands and because is None:
            raise DeviceError(self.left)

    @property
    def closed(self) -> bool:
        """Whether it has come to its end: the log is whole, the lines are given up."""
        return self._core.closing

    def _ended(self, because: BaseException | None) -> str:
        """What ended the session or a log, in words; empty when nothing did."""
        if self.trouble is not None:
            return str(self.trouble)
        if isinstance(because, KeyboardInterrupt):
            return str(because) or "Ctrl-C"
        if because is None or isinstance(because, GeneratorExit | SystemExit):
            return ""
        return str(because) if isinstance(because, RigError) else f"{type(because).__name__}: {because}"

    def _reach_drive(self) -> bool:
        """Open the drive's line again where it was lost; whether it is there now."""
        links, command = self._links, self._command
        assert links is not None and command is not None  # noqa: PT018
        name = command.drive_name
        if name not in self._core.gone:
            return False
        self._carry_out(links.reopened(name, command))
        return name not in self._core.gone

    def _stop_devices(self) -> tuple[bool, str]:
        """Rotor to rest, streams off; a device that is gone does not keep the others from being stopped.

        Returns:
            Whether the rotor stands, as far as it is ours to stop; what there is to say of one that is not known to, or
            of a drive that is not known to have let go of it: empty when both are.
        """
        if self._command is None or self._links is None:
            return True, ""
        drive = self._command.drive_name
        released = self._command.bring_to_rest(self._say, self._opened, self._reach_drive)
        self._links.stop_streams()
        stands = self.rotor_at_rest()
        if released or not self._opened or (stands and not drive):
            return True, ""
        if stands:
            text = (
                f"{drive}: nobody can tell whether it has let go of the rotor, which stands; look at its power and line"
            )
        else:
            still = "nobody can tell whether the rotor stands" if stands is None else "the rotor still turns"
            text = f"{still} ({self.rotor_words()}); keep away from it"
        self._carry_out(self._core.warn(text))
        return bool(stands), text

    def _wait_alive(self, what: str) -> None:
        """Wait for samples of every device; of those that give none, say what came instead."""
        try:
            self.wait_for(lambda: not self._silent(), _ALIVE_S, what)
        except DeviceError as error:
            silent = self._silent()
            if self.trouble is not None or not silent:
                raise
            raise DeviceError(f"{error}: {'; '.join(map(self._what_came, silent))}") from error

    def _silent(self) -> list[str]:
        """Devices of which no sample has come."""
        return [
            name
            for name, device in self._known.items()
            if not all(len(self.recent.last(channel.topic, ())[0]) for channel in device.channels)
        ]

    def _what_came(self, name: str) -> str:
        bytes_in, losses = self._core.bytes_in[name], self._core.pipelines[name].losses
        lost = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in losses.items() if n)
        came = f"{bytes_in} bytes came, none of them a sample" if bytes_in else "silent"
        why = self.told(name)[1] or "Look at its power, its settings and the rig file"
        return f"{name}: {came}{f' ({lost})' if lost else ''}. {why[:1].upper()}{why[1:]}"

    # --- bytes, and what the core makes of them ------------------------------------------------------------------

    def send(self, name: str, data: bytes) -> None:
        """Write to a device at once, whatever log and decoders are busy with; the log gets the bytes afterwards.

        Raises:
            LinkLost: the device is gone.
        """
        self._open.send(name, data)

    def _take(self, name: str, sent: Sequence[tuple[bytes, int]], data: bytes, host_ns: int) -> None:
        """What went to a device and then what came from it."""
        for written, written_ns in sent:
            self._carry_out(self._core.feed(name, TX, written, written_ns))
        if data:
            self._carry_out(self._core.feed(name, RX, data, host_ns))

    def _lost(self, name: str, error: Exception) -> None:
        self._carry_out(self._core.lost(name, error, self.clock.now_ns()))

    def _fail(self, error: Exception) -> None:
        self._carry_out(self._core.fail(error, self.clock.now_ns()))

    def _tick(self) -> None:
        with self._log_changes:
            recorder, command = self._recorder, self._command
            self._carry_out(
                self._core.tick(
                    self.clock.now_ns(),
                    command.seen() if command is not None else None,
                    recorder.look() if recorder is not None else None,
                    recorder.trouble if recorder is not None else None,
                )
            )

    def _carry_out(self, orders: Iterable[Order]) -> None:
        for order in orders:
            recorder = self._recorder
            match order:
                case Keep():
                    if recorder is not None:
                        _keep(recorder, order)
                    if self._command is not None and order.direction == RX:
                        self._command.notice(order.device, self._core.pipelines[order.device])
                case Happened(event):
                    self._happened(event)
                case Note(event, host_ns):
                    self._note(event, host_ns)
                case Report(facts):
                    if recorder is not None:
                        recorder.health(facts)
                    for reported in self.reported:
                        reported(facts, self.clock.now_ns())
                case Warn(text):
                    self._say(text)
                case StopRotor():
                    if self._command is not None:
                        self._command.quick_stop()

    def _happened(self, event: Event) -> None:
        for observe in self.observers:
            observe(event)
        if event.kind == "reply":
            self._open.answered(event.device, event.text)
        elif event.kind == "acknowledge" and self._command is not None:
            self._command.acknowledged(event)

    # --- what is known -------------------------------------------------------------------------------------------

    @property
    def recent(self) -> Recent:
        """The last seconds of every channel."""
        return self._core.recent

    @property
    def rates(self) -> RateWatches:
        """The rates of the devices' clocks."""
        return self._core.rates

    @property
    def trouble(self) -> Exception | None:
        """The first thing that ended the run; None as long as it is fine."""
        return self._core.trouble

    @trouble.setter
    def trouble(self, error: Exception | None) -> None:
        self._core.trouble = error

    @property
    def notices(self) -> list[str]:
        """What the operator learnt: a run with any is not a clean one."""
        return self._core.notices

    @property
    def lenient(self) -> bool:
        """Whether a device that is not what the rig file says is only looked at, as by `rig check`."""
        return self._core.lenient

    @lenient.setter
    def lenient(self, value: bool) -> None:
        self._core.lenient = value

    @property
    def drive(self) -> SpeedSource:
        """What turns the rotor in an open session.

        Raises:
            DeviceError: nothing does.
        """
        if self._command is None or self._command.drive is None:
            raise DeviceError(f"rig {self.rig.name} has no open speed source: nothing turns its rotor by command")
        return self._command.drive

    @property
    def topics(self) -> tuple[str, ...]:
        """Channels that its devices fill all the time."""
        return tuple(channel.topic for device in self._known.values() for channel in device.channels)

    @property
    def bytes_in(self) -> int:
        """Bytes from all devices so far."""
        return sum(self._core.bytes_in.values())

    @property
    def silent_s(self) -> float:
        """How long no device has sent anything, wall s."""
        return self.clock.wall_s() - self._open.heard_s()

    def newest(self, topic: str, fields: tuple[str, ...], seconds: float) -> tuple[NDArray[np.int64], list[Any]]:
        """The newest stretch of a channel, counted back from its newest sample: a late read is no silence."""
        time_ns, columns = self.recent.last(topic, fields, self.clock.now_ns() - int(_NEWEST_S * 1e9))
        if len(time_ns) == 0:
            return time_ns, columns
        new = time_ns > time_ns[-1] - int(seconds * 1e9)
        return time_ns[new], [column[new] for column in columns]

    def told(self, name: str) -> tuple[bool, str]:
        """Whether a device has said what it is, with all that this leads to done, and what was wrong with it.

        A device that never says anything of itself has said all there is.
        """
        with self._open.unread(name):
            pipeline = self._core.pipelines[name]
            return (pipeline.told, pipeline.complaint) if isinstance(pipeline, TellsItself) else (True, "")

    def all_told(self) -> bool:
        """Whether every device has said what it is."""
        return all(self.told(name)[0] for name in self._known)

    def own_checks(self, events: Iterable[Event]) -> dict[str, Checks]:
        """What drivers look at in their open devices, by device.

        Args:
            events: of the seconds that were looked at.
        """
        happened, command = list(events), self._command
        return {
            name: device.driver.checks(
                device.settings,
                self._core.pipelines[name],
                command.drive if command is not None and name == command.drive_name else None,
                [event for event in happened if event.device == name],
            )
            for name, device in self._known.items()
        }

    def rotor_at_rest(self) -> bool | None:
        """Whether the rotor stands, by the drive's fresh word and the index marks; None when neither is there."""
        return self._core.interlocks.at_rest(self.clock.now_ns())

    def turning(self) -> bool:
        """Whether the rotor turns, or may: nobody can say that it does not."""
        return self._core.interlocks.turning(self.clock.now_ns())

    def rotor_rpm(self) -> float:
        """How fast the rotor turns, by all that is known; NaN when nobody can tell."""
        return self._core.interlocks.speed_rpm(self.clock.now_ns())

    def rotor_words(self) -> str:
        """What is known of the rotor's speed, for a message."""
        return self._core.interlocks.rotor_words(self.clock.now_ns())

    # --- recording -----------------------------------------------------------------------------------------------

    def disk(self) -> DiskState | None:
        """How the disk keeps up with the recording; None when nothing is recorded."""
        recorder = self._recorder
        return None if recorder is None else recorder.state()

    def losses(self) -> dict[str, dict[str, int]]:
        """Counted losses of every device since the recording began; a silence counts while it lasts."""
        return self._core.losses(self.clock.now_ns())

    def note(self, event: Event) -> None:
        """Put what the host found out into the log, if one is being recorded."""
        self._note(event, self.clock.now_ns())

    def _note(self, event: Event, host_ns: int) -> None:
        recorder = self._recorder
        if recorder is not None:
            recorder.event(event, host_ns)
        for tell in self.noted:
            tell(event, host_ns)

    def start_recording(self, path: Path | ReservedName, metadata: Mapping[str, str], before_s: float = 0.0) -> None:
        """Begin a log. Every device gets a fresh pipeline, so that the log alone decodes to the same samples.

        Args:
            path: of the log.
            metadata: facts of the run.
            before_s: how much of what came before now belongs to it, s; at most `daq.acquisition.core.PAST_S`.
        """
        if self._recorder is not None:
            self.stop_recording({"ended": self._ended(None) or "another recording began"})
        self._learn()
        facts = {
            "rig": self.rig.name,
            "software": software_version(),
            "clock_rate": repr(self.clock.rate),
            CLOCK_RULES: str(NEWEST_RULES),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self.clock.now_s())),
            **metadata,
        }
        attachments = {
            "rig.json": self.rig.snapshot_json(),
            "identities.json": json.dumps(self.identities).encode(),
            "roles.json": self.rig.roles_json(),
        }
        seeds = self._seeds()
        if seeds:
            attachments["clocks.json"] = json.dumps(seeds).encode()
        devices = tuple(self._known)
        self.log = path if isinstance(path, Path) else path.path
        recorder = Recorder(path, self.clock, facts, attachments, devices, self._channels, self._edge.disk)
        self._begin_anew(recorder, before_s, seeds)

    def _learn(self) -> None:
        """What devices are by their own bytes holds from log to log, as what they say when they are opened."""
        for name, pipeline in self._core.pipelines.items():
            if isinstance(pipeline, LearnsIdentity):
                with self._open.unread(name):
                    self.identities.setdefault(name, {}).update(pipeline.learned)

    def _seeds(self) -> dict[str, dict[str, Any]]:
        """How the devices' clocks stand, as far as it is known: a log's first samples need not find it out again."""
        seeds: dict[str, dict[str, Any]] = {}
        for name, pipeline in self._core.pipelines.items():
            with self._open.unread(name):
                seed = pipeline.clock_seed if isinstance(pipeline, KeepsTime) else None
            if seed is not None:
                seeds[name] = asdict(seed)
        return seeds

    def _begin_anew(
        self, recorder: Recorder | None, before_s: float = 0.0, seeds: Mapping[str, Mapping[str, Any]] | None = None
    ) -> None:
        """Give every device a fresh pipeline, at a boundary between two reads."""
        pipelines = make_pipelines(self.rig.devices, self.identities, seeds=seeds)
        with self._log_changes, self._open.between_reads():
            self._recorder = recorder
            for order in self._core.begin(pipelines, self.clock.now_ns(), before_s):
                if recorder is None:
                    continue
                if isinstance(order, Keep):
                    _keep(recorder, order)
                else:
                    recorder.event(order.event, order.host_ns)

    def stop_recording(self, summary: Mapping[str, Any]) -> Path:
        """End the log; losses and how it ended go into its summary."""
        recorder = self._recorder
        assert recorder is not None
        with self._log_changes, self._open.between_reads():
            now_ns = self.clock.now_ns()
            for order in self._core.finish(now_ns):
                _keep(recorder, order)
            facts, events = self._core.end(now_ns)
            for event in events:
                recorder.event(event, now_ns)
            self._recorder = None
        facts = {**facts, ENDED: self._ended(None) or "the test's end", **summary}
        reasons = [(reason.interlock, reason.text) for reason in self._core.trips.reasons]
        return recorder.close({**facts, **tripping(facts[ENDED], reasons)})

    # --- waiting and commands ------------------------------------------------------------------------------------

    def check(self) -> None:
        """Raise the first trouble; devices that were unplugged are looked for meanwhile."""
        core, command = self._core, self._command
        if core.trouble is None and command is not None and command.dropped_out and core.guarding:
            end = self.clock.wall_s() + 2.0  # the core stops the rotor, and waits a moment for the drive's reason
            while core.trouble is None and self.clock.wall_s() < end:
                self.clock.wait(0.01)
        if core.trouble is not None:
            raise core.trouble
        if self._opened:
            self._carry_out(self._open.attend(command))

    def wait_for(self, condition: Callable[[], bool], wall_s: float, what: str) -> None:
        """Wait until a condition holds, at most so long on the wall's clock.

        Raises:
            DeviceError: it does not come true in time.
        """
        deadline = self.clock.wall_s() + wall_s
        while not condition():
            self.check()
            if self.clock.wall_s() > deadline:
                raise DeviceError(f"waited {wall_s:g} s for {what}; it did not come")
            self.clock.wait(0.003)

    def wait_for_rest(self, wall_s: float) -> None:
        """Wait until the rotor stands.

        Raises:
            DeviceError: it does not, or nobody can tell.
        """
        deadline = self.clock.wall_s() + wall_s
        while not (rest := self.rotor_at_rest()):
            self.check()
            if self.clock.wall_s() > deadline:
                still = "nobody can tell whether the rotor stands" if rest is None else "the rotor still turns"
                raise DeviceError(f"{still} after {wall_s:g} s: {self.rotor_words()}. Look at drive and rotor")
            self.clock.wait(0.003)

    def need(self, *topics: str) -> None:
        """Channels that the running test lives on, at rest too; silence of one ends it. Without any: none."""
        self._core.interlocks.need(topics)

    def permit_by_hand(self, rpm: float | None) -> None:
        """Ask before the operator is told to turn the rotor; from then on it is watched as if a drive turned it.

        Args:
            rpm: the speed; None before anything turns.

        Raises:
            DeviceError, ProcedureError: a guard is missing, or the speed is beyond its limit.
        """
        assert self._command is not None
        self._command.permit(rpm)

    def stop(self, reason: str) -> None:
        """The operator wants the rotor stopped: the drive is told at once, by the caller's thread, and the run ends."""
        self._carry_out(self._core.fail(OperatorStop(reason), self.clock.now_ns()))

    def command_node(self, action: str) -> None:
        """Have the pendulums locked or released, until it is acknowledged.

        Raises:
            DeviceError: refused (the message says why), never acknowledged, or the rig has no locks to command.
        """
        if self._command is None or self._command.locks is None or self.rig.roles.locks is None:
            raise DeviceError(f"rig {self.rig.name} has no locks that can be commanded: {action} by hand")
        self._command.locks.command(action, self.check)


def _keep(recorder: Recorder, order: Keep) -> None:
    """Bytes and what they hold, together; after the run's end the recorder takes neither, and interlocks go on."""
    with recorder.together():
        if recorder.raw(order.device, order.direction, order.data, order.host_ns):
            for item in order.items:
                if isinstance(item, Batch):
                    recorder.batch(item, order.host_ns)
                else:
                    recorder.event(item, order.host_ns)
