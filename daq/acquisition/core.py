# pyright: strict
"""The acquisition's decisions. It does no I/O and reads no clock.

It is fed with a device's bytes and the host time they came or went, and with ticks. It answers with orders: what is to
be kept in the log, what its operator has to learn at once, whether the rotor has to stop. Whoever holds the ports, the
clock and the disk carries them out (`daq.acquisition.session`): in real time, or on a simulated clock.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from daq.acquisition.channel_watch import HOST
from daq.acquisition.interlock_table import LINE_S
from daq.acquisition.interlocks import Interlocks, Stop
from daq.acquisition.rate_watch import RateWatches
from daq.acquisition.recent import Recent
from daq.acquisition.recorder import DiskState
from daq.acquisition.trips import Trips
from daq.drivers.contract import Pipeline
from daq.drivers.devices import channels_of, devices_of
from daq.drivers.items import RX, Batch, Event
from daq.errors import DeviceError, LinkLost, ProcedureError
from rig_configs.schema import Rig

KEEP_S = 90.0
"""How far back samples are at hand."""
PAST_S = 30.0
"""How far back bytes are at hand, for a log that begins before something happens."""
_PAST_BYTES = 8 * 2**20  # of one device
_WATCH_S = 0.25  # wall seconds between two looks for silent devices, and at the disk
_HEALTH_S = 1.0
_REASON_S = 0.3  # wall seconds that a drive may take to report why it stopped


@dataclass(frozen=True)
class Keep:
    """Bytes and what they hold belong into the log, together or not at all."""

    device: str
    direction: int
    data: bytes
    items: tuple[Batch | Event, ...]
    host_ns: int


@dataclass(frozen=True)
class Happened:
    """A device reported something; whoever waits for it has to learn of it."""

    event: Event


@dataclass(frozen=True)
class Note:
    """An event that the host found belongs into the log."""

    event: Event
    host_ns: int


@dataclass(frozen=True)
class Report:
    """A health report belongs into the log."""

    facts: Mapping[str, Any]


@dataclass(frozen=True)
class Warn:
    """The operator has to learn this at once."""

    text: str


@dataclass(frozen=True)
class StopRotor:
    """The drive, where there is one, has to stop the rotor as fast as it can."""


Order = Keep | Happened | Note | Report | Warn | StopRotor


@dataclass(frozen=True)
class DriveSeen:
    """How the speed source stands.

    Attributes:
        enabled: whether it holds a speed.
        dropped_out: the state it fell into by itself; None while it has not.
        why: its reason, in words; empty without one.
    """

    enabled: bool
    dropped_out: str | None
    why: str


class _Past:
    """The newest bytes of a device, in either direction, each with its host time: bounded in age and size."""

    def __init__(self) -> None:
        self._reads: deque[tuple[int, bytes, int]] = deque()
        self._size = 0

    def add(self, direction: int, data: bytes, host_ns: int) -> None:
        reads = self._reads
        reads.append((direction, data, host_ns))
        self._size += len(data)
        while reads[0][2] < host_ns - PAST_S * 1e9 or self._size > _PAST_BYTES:
            self._size -= len(reads.popleft()[1])

    def since(self, since_ns: int) -> list[tuple[int, bytes, int]]:
        return [read for read in self._reads if read[2] > since_ns]


class Core:
    """See the module. Several threads may feed it, one a device; one ticks.

    Args:
        rig: the rig file.
        patience: rig seconds of a time-out given in wall seconds (`HostClock.patience`).
        driving: whether this session may turn the rotor; one that only listens stops nothing.

    Attributes:
        commanding: whether what is found has to end the run.
        guarding: whether anything is stopped at all: not while devices are opened, nor once they are closed.
        lenient: whether a device that is not what the rig file says is only reported, as by `rig check`.
        closing: the end of the session is under way.
        trouble: the first thing that ended the run; None as long as it is fine.
        notices: what the operator learnt: a run with any is not a clean one.
        bytes_in: from each device so far.
        gone: devices whose link is lost, each with why.
        mute: devices whose link stands, and that have sent nothing for long.
        trips: what interlocks found while the log is recorded.
    """

    def __init__(self, rig: Rig, patience: Callable[[float], float], *, driving: bool) -> None:
        self._rig, self._patience, self._driving = rig, patience, driving
        self._known = devices_of(rig.devices)
        self.recent = Recent(KEEP_S, tuple(channels_of(rig.devices).values()))
        self.rates = RateWatches(rig.devices, patience)
        self.interlocks = Interlocks(rig.limits, rig.roles, patience, driving=driving)
        self.pipelines: dict[str, Pipeline] = {}
        self.commanding = self.guarding = self.lenient = self.closing = False
        self.trouble: Exception | None = None
        self._end: Note | None = None  # of the run, with its trouble
        self.notices: list[str] = []
        self.bytes_in = dict.fromkeys(self._known, 0)
        self.gone: dict[str, str] = {}
        self._past = {name: _Past() for name in self._known}
        self._undecodable: set[str] = set()
        self._heard_ns: dict[str, int] = {}
        self.mute: set[str] = set()
        self._suspect: set[str] = set()
        self._watch_ns = self._health_ns = 0
        self._dropped_ns: int | None = None
        self._disk_slow = False
        self._first = threading.Lock()
        self.trips = self._no_trips()

    def _no_trips(self) -> Trips:
        return Trips(channels_of(self._rig.devices).values(), self._rig.roles, self._patience)

    # --- a log begins ------------------------------------------------------------------------------------------

    def begin(self, pipelines: Mapping[str, Pipeline], now_ns: int, before_s: float = 0.0) -> list[Keep | Note]:
        """Fresh pipelines: the log that begins now decodes to the same samples by itself. No device is fed meanwhile.

        Args:
            pipelines: of every device.
            before_s: how much of what came before belongs to it, s; at most `PAST_S`.

        Returns:
            What of that has to be kept: what came, and what ended the run.
        """
        self.pipelines = dict(pipelines)
        self._undecodable.clear()
        self.recent.clear()
        self.rates = RateWatches(self._rig.devices, self._patience)
        self.interlocks.begin(now_ns)
        since = now_ns - int(before_s * 1e9)
        tripped, self.trips = self.trips.reasons, self._no_trips()
        for reason in tripped:
            if since <= reason.host_ns < now_ns:
                self.trips.tripped(reason.interlock, reason.text, reason.host_ns)
        for name in self._known:
            self._heard_ns.setdefault(name, now_ns)
        out: list[Keep | Note] = []
        for name, past in self._past.items():
            for direction, data, host_ns in past.since(since):
                kept = self._decoded(name, direction, data, host_ns)
                out.append(kept)
                for item in kept.items:
                    if isinstance(item, Batch):
                        self.recent.add(item)
        if self._end is not None and since <= self._end.host_ns < now_ns:
            out.append(self._end)
        return sorted(out, key=lambda kept: kept.host_ns)

    def finish(self, now_ns: int) -> Iterator[Keep]:
        """No more bytes come before the log's end: what pipelines still hold back belongs into it too."""
        for name in self._known:
            kept = self._decoded(name, RX, b"", now_ns)
            if kept.items:
                yield kept

    def end(self, now_ns: int) -> tuple[dict[str, Any], list[Event]]:
        """The log ends.

        Returns:
            Facts for its summary: losses, channels that were off their rate, what the operator learnt; and what else
            belongs into it.
        """
        facts: dict[str, Any] = {"losses": self.losses(now_ns)}  # a silence counts as its event reports it
        if wrong_rates := self.rates.summary():
            facts["rates"] = wrong_rates
        if self.notices:
            facts["warnings"] = self.notices
        return facts, [*self.interlocks.end(now_ns), *self.trips.end(now_ns, self.recent)]

    def renew(self, device: str, pipeline: Pipeline) -> None:
        """A fresh pipeline for one device; it is not fed meanwhile."""
        self.pipelines[device] = pipeline
        self._undecodable.discard(device)

    # --- what comes --------------------------------------------------------------------------------------------

    def feed(self, device: str, direction: int, data: bytes, host_ns: int) -> Iterator[Order]:
        """Bytes came from a device or went to it; each order is to be carried out before the next one is asked for."""
        if direction == RX:
            self.bytes_in[device] += len(data)
            self._heard_ns[device] = host_ns
        self._past[device].add(direction, data, host_ns)
        kept = self._decoded(device, direction, data, host_ns)
        yield kept
        for item in kept.items:
            if isinstance(item, Batch):
                self.recent.add(item)
                yield from self._heed(self.interlocks.feed(item, host_ns), host_ns)
                continue
            yield Happened(item)
            if item.kind == "emergency":
                yield from self._emergency(item)
            elif item.kind == "undecodable":
                yield from self.warn(item.text)
            if self.guarding and item.kind not in ("reply", "acknowledge"):
                yield from self._heed(self.interlocks.happened(item), host_ns)

    def _decoded(self, device: str, direction: int, data: bytes, host_ns: int) -> Keep:
        """Bytes with what they hold; bytes that no decoder takes are those the log needs most."""
        found: list[Batch | Event] = []
        if device not in self._undecodable:
            try:
                found = self.pipelines[device].feed(direction, data, host_ns)
                found += self.rates.feed(found, host_ns)
            except Exception as error:  # a decoder's bug
                self._undecodable.add(device)
                text = f"{device}: its bytes are kept, but no longer decoded ({type(error).__name__}: {error})"
                found = [Event("undecodable", HOST, text, {"of": device})]
        return Keep(device, direction, data, tuple(found), host_ns)

    def _emergency(self, event: Event) -> Iterator[Order]:
        words = self._known[event.device].driver.words(event)
        if words and not self.closing:
            yield from self.warn(f"{event.device}: emergency {words}. The run is not clean")

    def _heed(self, found: Iterable[Event | Stop], host_ns: int) -> Iterator[Order]:
        """What follows from what the interlocks found."""
        for item in found:
            if isinstance(item, Event):
                yield Note(item, host_ns)
            elif self.guarding and self.commanding and not self.lenient:
                yield from self._tripped(item, host_ns)
            elif self.guarding:
                yield from self.warn(item.text)

    def _tripped(self, stop: Stop, host_ns: int) -> Iterator[Order]:
        """The first one ends the run; those that come with it are named too."""
        self.trips.tripped(stop.interlock, stop.text, host_ns)
        if self.trouble is None:
            kind = DeviceError if stop.cause == "device" else ProcedureError
            turning = self.interlocks.turning(host_ns)
            yield from self.fail(kind(f"{stop.text}; {self._stopped}" if turning else stop.text), host_ns)

    @property
    def _stopped(self) -> str:
        return "stop the rotor" if self._rig.roles.speed is None else "the rotor was told to stop"

    # --- what ends the run -------------------------------------------------------------------------------------

    def fail(self, error: Exception, now_ns: int) -> Iterator[Order]:
        """Something ends the run: the first one counts. The rotor is stopped each time: an order may have got lost."""
        with self._first:
            first = self.trouble is None
            if first:
                self.trouble = error
        if self._rig.roles.speed is not None:
            yield StopRotor()
            self.interlocks.told(0.0)
        elif first and self.commanding and self.interlocks.turning(now_ns):
            yield Warn(f"STOP THE ROTOR: {error}")
        if first:
            self._end = Note(Event("stop", HOST, str(error)), now_ns)
            yield self._end

    def lost(self, device: str, error: Exception, now_ns: int) -> Iterator[Order]:
        """A device's link is gone: the run's end while the rotor turns or devices are opened, else a gap of one device.

        A link that fails with anything but LinkLost is a fault of this software, and the run's end.
        """
        turning = self._driving and self.interlocks.turning(now_ns)
        if isinstance(error, LinkLost):
            self.gone[device] = str(error)
        if turning or not self.guarding or not isinstance(error, LinkLost):
            yield from self.fail(error, now_ns)
            return
        if len(self.gone) == len(self._known):  # none is left to go on
            yield from self.fail(error, now_ns)
            return
        yield Note(Event("gone", HOST, str(error), {"of": device}), now_ns)
        yield from self.warn(f"{error}. The others go on; it is looked for")

    def back(self, device: str, port: str, now_ns: int) -> Iterator[Order]:
        """A device that was gone streams again."""
        self.gone.pop(device, None)
        self.rates.begin_anew(device)
        self._heard_ns[device] = now_ns
        yield Note(Event("back", HOST, f"{device}: streams again, on {port}", {"of": device, "port": port}), now_ns)

    def warn(self, text: str) -> Iterator[Order]:
        """The operator learns something, once; it stays on record."""
        if text not in self.notices:
            self.notices.append(text)
            yield Warn(f"warning: {text}")

    def permit(self, rpm: float | None, now_ns: int) -> None:
        """Ask before the rotor is made ready to turn (None), or ordered to turn at a speed.

        Raises:
            DeviceError, ProcedureError: it must not.
        """
        if self.trouble is not None:
            raise self.trouble
        limit = self._rig.limits.speed_rpm
        if rpm is not None and abs(rpm) > limit:
            raise ProcedureError(f"{rpm:.0f} rpm wanted, limits.speed_rpm is {limit:.0f}: the drive was not told")
        if rpm != 0 and (obstacles := self.interlocks.obstacles(now_ns)):
            raise DeviceError(f"the rotor is not turned: {'; '.join(obstacles)}")
        if rpm is not None:
            self.interlocks.told(rpm)

    # --- time passes -------------------------------------------------------------------------------------------

    def tick(
        self, now_ns: int, drive: DriveSeen | None, disk: DiskState | None, disk_trouble: Exception | None
    ) -> Iterator[Order]:
        """Some ten times a second of the wall.

        Args:
            drive: the speed source; None where there is none that is open.
            disk: how the disk keeps up; None while nothing is recorded.
            disk_trouble: why the recording has to end; None as long as it is fine.
        """
        yield from self._heed(self.interlocks.tick(now_ns), now_ns)
        for event in self.trips.tick(now_ns, self.recent):
            yield Note(event, now_ns)
        if drive is not None and self.guarding:
            yield from self._look_at_drive(drive, now_ns)
        if disk is not None and disk.slow != self._disk_slow:
            yield self._disk_event(disk, now_ns)
        if disk_trouble is not None:
            yield from self.fail(disk_trouble, now_ns)
        if now_ns >= self._watch_ns:
            self._watch_ns = now_ns + round(self._patience(_WATCH_S) * 1e9)
            yield from self._look_for_silence(now_ns)
        if disk is not None and now_ns >= self._health_ns:
            self._health_ns = now_ns + int(_HEALTH_S * 1e9)
            facts = {"kind": "health", "device": "host", "text": "", "losses": self.losses(now_ns)}
            yield Report({**facts, "disk": disk.facts(), "bytes": dict(self.bytes_in)})

    def _look_at_drive(self, drive: DriveSeen, now_ns: int) -> Iterator[Order]:
        """One that left operation by itself is stopped at once; its reason may come a little after its state."""
        if self.trouble is not None:
            if drive.enabled:
                yield from self.fail(self.trouble, now_ns)  # again: one frame may be lost
            return
        if drive.dropped_out is None:
            self._dropped_ns = None
            return
        if self._dropped_ns is None:
            self._dropped_ns = now_ns
            yield StopRotor()
        if drive.why or now_ns - self._dropped_ns > self._patience(_REASON_S) * 1e9:
            yield from self.fail(self.dropped_out(drive), now_ns)

    @staticmethod
    def dropped_out(drive: DriveSeen) -> ProcedureError:
        """The end of a run whose drive left operation by itself."""
        return ProcedureError(
            f"the drive went to {drive.dropped_out} by itself{drive.why}. Look at the log's events and at the drive, "
            "then repeat the test"
        )

    def _disk_event(self, disk: DiskState, now_ns: int) -> Note:
        self._disk_slow = disk.slow
        text = (
            f"the disk is slow: {disk.backlog_bytes / 1e6:.1f} MB wait, the oldest for {disk.unsynced_s:.1f} s"
            if disk.slow
            else "the disk keeps up again"
        )
        return Note(Event("disk", HOST, text, disk.facts()), now_ns)

    def _look_for_silence(self, now_ns: int) -> Iterator[Order]:
        """The operator learns of a device that sends nothing at all; interlocks decide whether that ends the run."""
        limit_ns = self._patience(LINE_S) * 1e9
        still = {name for name, heard in self._heard_ns.items() if now_ns - heard > limit_ns} - set(self.gone)
        certain = still & self._suspect if self.commanding and self.guarding else set[str]()
        for name in sorted(certain - self.mute):  # seen twice: no host that was asleep
            text = f"{name}: silent for {LINE_S:g} s. Look at its cable, its power, its battery"
            yield Note(Event("silent", HOST, text, {"of": name}), now_ns)
            yield from self.warn(text)
        for name in sorted(self.mute - still - set(self.gone)):
            yield Note(Event("heard", HOST, f"{name}: heard again", {"of": name}), now_ns)
        self._suspect, self.mute = still, (self.mute | certain) & still

    # --- what is known -----------------------------------------------------------------------------------------

    @property
    def calm(self) -> bool:
        """Whether nothing turns that a sample could stop, and no dialogue of the opening waits for an answer."""
        return self.guarding and self.interlocks.resting

    def losses(self, now_ns: int) -> dict[str, dict[str, int]]:
        """Counted losses of every device since the log began; a silence counts while it lasts."""
        silences = self.interlocks.losses(now_ns)
        return {name: {**pipeline.losses, **silences.get(name, {})} for name, pipeline in self.pipelines.items()}
