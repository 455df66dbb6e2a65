"""Decisions of the acquisition, without I/O and without a clock.

The input is the bytes of the devices with their host time, and ticks. The output is effects: bytes and events for the
log, messages for the operator, stops of the rotor. The session, which owns ports, clock and disk, carries them out
(`daq.acquisition.session`) in real time or on a simulated clock.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from daq.acquisition.channel_watch import HOST
from daq.acquisition.effects import Effect, Happened, Keep, Note, StopRotor, Warn, WriteHealth
from daq.acquisition.host_load import HostLoad
from daq.acquisition.interlock_table import LINE_S, LOOK_S
from daq.acquisition.interlocks import Interlocks, Stop
from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.life import Life, Policy, Stage
from daq.acquisition.rate_watch import RateWatches
from daq.acquisition.recent import Recent
from daq.acquisition.recorder import DiskState
from daq.acquisition.trips import Reason, Trips
from daq.drivers.calibrated import Calibration
from daq.drivers.contract import Pipeline
from daq.drivers.devices import channels_of, devices_of
from daq.errors import DeviceError, LinkLost, ProcedureError
from daq.items import RX, Batch, DeviceEvent
from rig_configs.schema import Rig

KEEP_S = 90.0
"""Age up to which samples are kept in memory, s."""
PAST_S = 30.0
"""Age up to which bytes are kept in memory for a log with a pre-trigger, s."""
_MAX_PAST_BYTES = 8 * 2**20  # of one device
_WATCH_PERIOD_S = 0.25  # of the check for silent devices, s
_HEALTH_PERIOD_S = 1.0  # of health reports, s
_NOT_CLEAN = {"restart": ". Its clock is not continuous: this log is not analysed", "doubt": ""}  # of sensors at rest
_MAX_REASON_DELAY_S = 0.3  # between the state of a drive that stopped and its report of the reason, s


@dataclass(frozen=True)
class DriveState:
    """State of the speed source.

    Attributes:
        enabled: whether it controls the speed.
        dropped_out: state that the drive entered without a command; None if it did not.
        why: text of the reason; empty if unknown.
    """

    enabled: bool
    dropped_out: str | None
    why: str


class _Past:
    """The newest bytes of a device in both directions with their host times, bounded in age and size."""

    def __init__(self) -> None:
        self._reads: deque[tuple[int, bytes, int]] = deque()
        self._size = 0

    def add(self, direction: int, data: bytes, host_ns: int) -> None:
        reads = self._reads
        reads.append((direction, data, host_ns))
        self._size += len(data)
        while reads[0][2] < host_ns - PAST_S * 1e9 or self._size > _MAX_PAST_BYTES:
            self._size -= len(reads.popleft()[1])

    def since(self, since_ns: int) -> list[tuple[int, bytes, int]]:
        return [read for read in self._reads if read[2] > since_ns]


class Core:
    """Decides what is recorded, reported and stopped; see the module.

    Several threads may call `feed`, one for each device. One thread calls `tick`.

    Args:
        rig: the rig file.
        policy: what the session may do. Sessions that only receive stop nothing.
        life: stage of the session.

    Attributes:
        rig, policy, life: see above.
        trouble: the first error that ended the run; None if there is none.
        notices: warnings shown to the operator. A run with warnings is not a clean run.
        bytes_in: number of bytes received, by device.
        gone: reason of the lost link, by device.
        mute: devices that have an open link and have sent nothing for `LINE_S`.
        altered: devices that have an open link and send, but no longer as they were set up, each with what shows it.
            They were reported.
        trips: findings of the interlocks in the log that is being recorded.
        host: lateness of the host.
    """

    def __init__(self, rig: Rig, policy: Policy, life: Life) -> None:
        self.rig: Rig = rig
        self.policy: Policy = policy
        self.life: Life = life
        self._known = devices_of(rig.devices)
        self.recent: Recent = Recent(KEEP_S, tuple(channels_of(rig.devices).values()))
        self.rates: RateWatches = RateWatches(rig.devices)
        least = LeastMotion.of(rig)
        self.interlocks: Interlocks = Interlocks(rig.limits, rig.roles, least, driving=policy.commands)
        self.host: HostLoad = HostLoad(LOOK_S)
        self.pipelines: dict[str, Pipeline] = {}
        self._calibrations = {name: Calibration.of(device.settings) for name, device in self._known.items()}
        self.trouble: Exception | None = None
        self._end: Note | None = None  # the event that ended the run
        self.notices: list[str] = []
        self.bytes_in: dict[str, int] = dict.fromkeys(self._known, 0)
        self.gone: dict[str, str] = {}
        self._past = {name: _Past() for name in self._known}
        self._undecodable: set[str] = set()
        self._heard_ns: dict[str, int] = {}
        self.mute: set[str] = set()
        self._suspect: set[str] = set()
        self.altered: dict[str, str] = {}
        self._lost_set_ups: dict[str, str] = {}  # as `altered`, found in bytes before this log
        self._watch_ns = self._health_ns = 0
        self._dropped_ns: int | None = None
        self._disk_slow = False
        self._first = threading.Lock()
        self.trips: Trips = self._no_trips()

    def _no_trips(self) -> Trips:
        return Trips(channels_of(self.rig.devices).values())

    # --- a log begins --------------------------------------------------------------------------------------------

    def begin(self, pipelines: Mapping[str, Pipeline], now_ns: int, before_s: float = 0.0) -> list[Keep | Note]:
        """Begin a log with new pipelines, so that the log alone decodes to the same samples.

        `feed` must not be called meanwhile.

        Args:
            pipelines: new pipeline of every device.
            before_s: length of the pre-trigger, s; at most `PAST_S`.

        Returns:
            Content of the pre-trigger for the log: bytes with their samples, and the event that ended the run.
        """
        self._lost_set_ups = self._found_lost_set_ups()
        self.pipelines = dict(pipelines)
        self._undecodable.clear()
        self.recent.clear()
        self.rates.begin()
        self.interlocks.begin(now_ns)
        since = now_ns - int(before_s * 1e9)
        tripped, self.trips = self.trips.reasons, self._no_trips()
        for reason in tripped:
            if since <= reason.host_ns < now_ns:
                self.trips.tripped(reason)
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
        """Yield the items that the pipelines still hold back, after the last bytes of the log."""
        for name in self._known:
            kept = self._decoded(name, RX, b"", now_ns)
            if kept.items:
                yield kept

    def end(self, now_ns: int) -> tuple[dict[str, Any], list[DeviceEvent]]:
        """End the log.

        Returns:
            Facts for the summary of the log (losses, channels with a wrong rate, warnings), and its last events.
        """
        facts: dict[str, Any] = {"losses": self.losses(now_ns)}  # before the silences end, as in their events
        if wrong_rates := self.rates.summary():
            facts["rates"] = wrong_rates
        if self.notices:
            facts["warnings"] = self.notices
        return facts, [*self.interlocks.end(now_ns), *self.trips.end(now_ns, self.recent)]

    def renew(self, device: str, pipeline: Pipeline) -> None:
        """Give one device a new pipeline. `feed` must not be called for this device meanwhile."""
        self.pipelines[device] = pipeline
        self._undecodable.discard(device)

    # --- bytes of the devices ------------------------------------------------------------------------------------

    def feed(self, device: str, direction: int, data: bytes, host_ns: int) -> Iterator[Effect]:
        """Process bytes from or to a device. The caller carries out each effect before it requests the next one."""
        if direction == RX:
            self.bytes_in[device] += len(data)
            self._heard_ns[device] = host_ns
        self._past[device].add(direction, data, host_ns)
        kept = self._decoded(device, direction, data, host_ns)
        yield kept
        for item in kept.items:
            if isinstance(item, Batch):
                self.recent.add(item)
                yield from self._act_on(self.interlocks.feed(item, host_ns), host_ns)
                continue
            yield Happened(item)
            if item.kind == "emergency":
                yield from self._emergency(item)
            elif item.kind == "undecodable":
                yield from self.warn(item.text)
            if self.life.guarding and item.kind not in ("reply", "acknowledge"):
                stops = self.interlocks.happened(item)
                yield from self._act_on(stops, host_ns)
                if not stops and item.kind in _NOT_CLEAN:
                    yield from self.warn(f"{item.device}: {item.text}{_NOT_CLEAN[item.kind]}")

    def _decoded(self, device: str, direction: int, data: bytes, host_ns: int) -> Keep:
        """Decode bytes. If the decoder fails, the bytes are kept and the device is no longer decoded."""
        found: list[Batch | DeviceEvent] = []
        if device not in self._undecodable:
            try:
                found = self._calibrations[device].decode(self.pipelines[device], direction, data, host_ns)
                found += self.rates.feed(found, host_ns)
            except Exception as error:  # a bug of the decoder
                self._undecodable.add(device)
                text = f"{device}: its bytes are kept, but no longer decoded ({type(error).__name__}: {error})"
                found = [DeviceEvent("undecodable", HOST, text, {"of": device})]
        return Keep(device, direction, data, tuple(found), host_ns)

    def _emergency(self, event: DeviceEvent) -> Iterator[Effect]:
        words = self._known[event.device].driver.words(event)
        if words and self.life.stage is not Stage.CLOSED:
            yield from self.warn(f"{event.device}: emergency {words}. The run is not clean")

    def _act_on(self, found: Iterable[DeviceEvent | Stop], host_ns: int) -> Iterator[Effect]:
        """Convert findings of the interlocks to effects."""
        for item in found:
            if isinstance(item, DeviceEvent):
                yield Note(self._explained(item), host_ns)
            elif self.life.guarding and self.policy.stops:
                yield from self._tripped(item, host_ns)
            elif self.life.guarding:
                yield from self.warn(item.text)

    def _explained(self, event: DeviceEvent) -> DeviceEvent:
        """Add the meaning of the code to the event that a sensor sends only codes."""
        device, code = self._known.get(str(event.facts.get("of"))), event.facts.get("code")
        if event.kind != "blind" or device is None or not event.text.endswith(f"code {code}"):
            return event
        if not (meaning := device.driver.code_meaning(int(code or 0))):
            return event
        return replace(event, text=f"{event.text} ({meaning})")

    def _tripped(self, stop: Stop, host_ns: int) -> Iterator[Effect]:
        """Add a stop to the trip. The first one ends the run."""
        self.trips.tripped(Reason(stop.interlock, stop.text, host_ns, self.interlocks.speed_rpm(host_ns)))
        if self.trouble is None:
            kind = DeviceError if stop.cause == "device" else ProcedureError
            turning = self.interlocks.turning(host_ns)
            yield from self.fail(kind(f"{stop.text}; {self._stopped}" if turning else stop.text), host_ns)

    @property
    def _stopped(self) -> str:
        return "stop the rotor" if self.rig.roles.speed is None else "the rotor was commanded to stop"

    # --- errors that end the run ---------------------------------------------------------------------------------

    def fail(self, error: Exception, now_ns: int) -> Iterator[Effect]:
        """End the run with its first error, and stop the rotor with every error, since a stop may get lost."""
        with self._first:
            first = self.trouble is None
            if first:
                self.trouble = error
        if self.rig.roles.speed is not None:
            yield StopRotor()
            self.interlocks.commanded(0.0)
        elif first and self.policy.commands and self.interlocks.turning(now_ns):
            yield Warn(f"STOP THE ROTOR: {str(error).removesuffix(f'; {self._stopped}')}")
        if first:
            self._end = Note(DeviceEvent("stop", HOST, str(error)), now_ns)
            yield self._end

    def lost(self, device: str, error: Exception, now_ns: int) -> Iterator[Effect]:
        """Handle the loss of a device's link.

        The run ends if the rotor turns, while devices are opened, and if no device is left. Otherwise the run continues
        with a gap of one device. An error other than LinkLost is a bug of this software and always ends the run.
        """
        turning = self.policy.commands and self.interlocks.turning(now_ns)
        if isinstance(error, LinkLost):
            self.gone[device] = str(error)
        if turning or not self.life.guarding or not isinstance(error, LinkLost):
            yield from self.fail(error, now_ns)
            return
        if len(self.gone) == len(self._known):  # no device is left
            yield from self.fail(error, now_ns)
            return
        yield Note(DeviceEvent("gone", HOST, str(error), {"of": device}), now_ns)
        yield from self.warn(f"{error}. The other devices continue; the program tries to open it again")

    def back(self, device: str, port: str, now_ns: int) -> Iterator[Effect]:
        """Record that a device with a lost link streams again."""
        self.gone.pop(device, None)
        self._set_up(device)
        self._heard_ns[device] = now_ns
        yield Note(
            DeviceEvent("back", HOST, f"{device}: streams again, on {port}", {"of": device, "port": port}), now_ns
        )

    def restored(self, device: str, now_ns: int) -> Iterator[Effect]:
        """Record that a device is set up again which was silent or sent something else."""
        self._set_up(device)
        yield Note(DeviceEvent("set_up", HOST, f"{device}: set up again", {"of": device}), now_ns)

    def warn(self, text: str) -> Iterator[Effect]:
        """Show a warning to the operator once, and keep it in `notices`."""
        if text not in self.notices:
            self.notices.append(text)
            yield Warn(f"warning: {text}")

    def permit(self, rpm: float | None, now_ns: int) -> None:
        """Permit that the rotor is prepared to turn (`rpm` is None), or turned at a speed.

        Raises:
            DeviceError: a device that guards the rotor is missing or has failed.
            ProcedureError: the speed exceeds the limit.
        """
        if self.trouble is not None:
            raise self.trouble
        limit = self.rig.limits.speed_rpm
        if rpm is not None and abs(rpm) > limit:
            raise ProcedureError(f"{rpm:.0f} rpm requested, limits.speed_rpm is {limit:.0f}: no speed was commanded")
        if rpm != 0 and (obstacles := self.interlocks.obstacles(now_ns)):
            raise DeviceError(f"the rotor is not turned: {'; '.join(obstacles)}")
        if rpm is not None:
            self.interlocks.commanded(rpm)

    # --- ticks ---------------------------------------------------------------------------------------------------

    def tick(
        self, now_ns: int, drive: DriveState | None, disk: DiskState | None, disk_trouble: Exception | None
    ) -> Iterator[Effect]:
        """Check deadlines, drive and disk. It is called every `LOOK_S`.

        Args:
            now_ns: host time, ns since 1970.
            drive: state of the speed source; None if no speed source is open.
            disk: state of the disk; None if no log is recorded.
            disk_trouble: error that ends the recording; None if there is none.
        """
        self.host.tick(now_ns)
        yield from self._act_on(self.interlocks.tick(now_ns), now_ns)
        for event in self.trips.tick(now_ns, self.recent):
            yield Note(event, now_ns)
        if drive is not None and self.life.guarding:
            yield from self._look_at_drive(drive, now_ns)
        if disk is not None and disk.slow != self._disk_slow:
            yield self._disk_event(disk, now_ns)
        if disk_trouble is not None:
            yield from self.fail(disk_trouble, now_ns)
        if now_ns >= self._watch_ns:
            self._watch_ns = now_ns + round(_WATCH_PERIOD_S * 1e9)
            yield from self._look_for_silence(now_ns)
            yield from self._look_for_lost_set_ups(now_ns)
        if disk is not None and now_ns >= self._health_ns:
            self._health_ns = now_ns + int(_HEALTH_PERIOD_S * 1e9)
            facts = {"kind": "health", "device": HOST, "text": "", "losses": self.losses(now_ns)}
            yield WriteHealth({**facts, "disk": disk.facts(), "bytes": dict(self.bytes_in)}, now_ns)

    def _look_at_drive(self, drive: DriveState, now_ns: int) -> Iterator[Effect]:
        """Stop a drive that left operation without a command.

        The stop is immediate. The run ends when the drive has reported its reason, or after `_MAX_REASON_DELAY_S`.
        """
        if self.trouble is not None:
            if drive.enabled:
                yield from self.fail(self.trouble, now_ns)  # repeated, since a frame may be lost
            return
        if drive.dropped_out is None:
            self._dropped_ns = None
            return
        if self._dropped_ns is None:
            self._dropped_ns = now_ns
            yield StopRotor()
        if drive.why or now_ns - self._dropped_ns > _MAX_REASON_DELAY_S * 1e9:
            yield from self.fail(self.dropped_out(drive, self.host.words(now_ns)), now_ns)

    @staticmethod
    def dropped_out(drive: DriveState, host: str) -> ProcedureError:
        """Return the error of a run whose drive left operation without a command; `host` is what the host explains."""
        advice = host or "Look at the events of the log and at the drive, then repeat the test"
        return ProcedureError(f"the drive entered {drive.dropped_out} without a command{drive.why}. {advice}")

    def _disk_event(self, disk: DiskState, now_ns: int) -> Note:
        self._disk_slow = disk.slow
        text = (
            f"the disk is slow: {disk.backlog_bytes / 1e6:.1f} MB wait, the oldest for {disk.unsynced_s:.1f} s"
            if disk.slow
            else "the disk keeps up again"
        )
        return Note(DeviceEvent("disk", HOST, text, disk.facts()), now_ns)

    def _look_for_silence(self, now_ns: int) -> Iterator[Effect]:
        """Warn of devices that send no bytes. The interlocks decide whether the run ends."""
        limit_ns = LINE_S * 1e9
        silent = {name for name, heard in self._heard_ns.items() if now_ns - heard > limit_ns} - set(self.gone)
        certain = silent & self._suspect if self.policy.commands and self.life.guarding else set[str]()
        for name in sorted(certain - self.mute):  # found twice, so the host was not suspended
            text = f"{name}: silent for {LINE_S:g} s. Look at its cable, its power, its battery"
            yield Note(DeviceEvent("silent", HOST, text, {"of": name}), now_ns)
            yield from self.warn(text)
        for name in sorted(self.mute - silent - set(self.gone)):
            yield Note(DeviceEvent("heard", HOST, f"{name}: heard again", {"of": name}), now_ns)
        self._suspect, self.mute = silent, (self.mute | certain) & silent

    def _look_for_lost_set_ups(self, now_ns: int) -> Iterator[Effect]:
        """Warn of devices that send, but no longer as they were set up; of each once."""
        found = self._found_lost_set_ups() if self.policy.commands and self.life.guarding else {}
        unwell = {name: sign for name, sign in found.items() if name not in self.gone and name not in self.mute}
        for name, sign in unwell.items():
            if self.altered.get(name) != sign:
                text = f"{name}: {sign}. It is set up again while the rotor is at rest"
                yield Note(DeviceEvent("altered", HOST, text, {"of": name}), now_ns)
                yield from self.warn(text)
        self.altered = unwell

    def _found_lost_set_ups(self) -> dict[str, str]:
        """Return the devices that send otherwise than they were set up, each with what shows it."""
        signs = {name: pipeline.status.set_up_lost for name, pipeline in self.pipelines.items()}
        return {**self._lost_set_ups, **{name: sign for name, sign in signs.items() if sign}}

    def _set_up(self, name: str) -> None:
        """Take note that a device was opened again, with all its settings."""
        self.rates.restart(name)
        self._lost_set_ups.pop(name, None)
        self.altered = {other: sign for other, sign in self.altered.items() if other != name}

    # --- state ---------------------------------------------------------------------------------------------------

    @property
    def calm(self) -> bool:
        """Whether the interlocks are active and the rotor is at rest, so that samples may be processed later."""
        return self.life.guarding and self.interlocks.resting

    def losses(self, now_ns: int) -> dict[str, dict[str, int]]:
        """Return the losses of every device since the start of the log, including silences that have not ended."""
        silences = self.interlocks.losses(now_ns)
        return {name: {**pipeline.losses, **silences.get(name, {})} for name, pipeline in self.pipelines.items()}
