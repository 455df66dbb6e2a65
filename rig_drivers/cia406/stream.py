"""Pipeline of CANopen encoders: frames to pendulum angles, index marks and events.

With SYNC the time of a sample is that of the host's write of the SYNC, plus `sync_delay_s`; both angles are of the same
instant. Without SYNC see `synchronous.OwnTimer`. The reports have no checksum beyond that of the CAN bus: text that is
damaged between adapter and host is detected by its form, by its length, and by positions beyond the encoder's range.

Checks of the encoders in addition to those of every device: their faults, and what losses mean on their bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from daq import channels
from daq.drivers.can_lines import CanLines, FirstContact
from daq.drivers.canopen import cia301
from daq.drivers.canopen.objects import answer_text
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import Pipeline, PipelineStatus, SpeedControl
from daq.drivers.sparing import EachSecond
from daq.items import TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame
from rig_basics.texts import number_of
from rig_drivers.cia406 import wire
from rig_drivers.cia406.node_watch import FoundFaults, NodeWatch
from rig_drivers.cia406.reports import Instant, Marks, Turns, offset_of, positions_of, sign_of
from rig_drivers.cia406.settings import EncoderBus
from rig_drivers.cia406.sync_sender import SyncOrigin
from rig_drivers.cia406.synchronous import NewestOfB, OwnTimer, SilentEncoders, SyncSchedule, SyncTimes, Values

Items = Iterator[Batch | DeviceEvent]


class EncoderPipeline(Pipeline):
    """Decoder of the frames of the bus.

    Attributes:
        losses: see Pipeline. "samples": samples of both angles that are missing although a SYNC was sent; "unsampled":
            periods in which this host sent no SYNC; "reports": reports of any encoder that
            are missing; "heartbeats": losses of an encoder's heartbeat; "unasked": reports that answer no SYNC or come
            too late; "invalid": reports that are too short, beyond the encoder's range, or of an encoder that started
            again; "late": SYNCs that left the host late, so that their samples are missing; "foreign_syncs" are SYNCs
            of another host.

    Args:
        device: name of the device in the rig file.
        settings: table of the encoders in the rig file.
        identity: identity of the encoders; of encoders that were not queried, positions grow with the angle.

    Raises:
        DeviceError: the identity is impossible.
    """

    def __init__(self, device: str, settings: EncoderBus, identity: Mapping[str, Any]) -> None:
        super().__init__(
            device, "samples", "unsampled", "reports", "heartbeats", "unasked", "invalid", "late", "foreign_syncs"
        )
        self._complaint = ""
        self._settings = settings
        self._lines = CanLines(device, self.losses)
        encoders = settings.encoders
        self._contacts = {each.name: FirstContact() for each in encoders}
        self._watches = {
            each.name: NodeWatch(
                device, each, settings.heartbeat_ms, FoundFaults.of(each, identity), self._contacts[each.name]
            )
            for each in encoders
        }
        self._begun = False
        per_turn = settings.counts_per_revolution
        self._positions = {each.name: positions_of(each, per_turn, identity) for each in encoders}
        self._offsets = {each.name: offset_of(each, identity) for each in encoders}
        self._turns = {each.name: Turns(per_turn, each.zero_counts, sign_of(each, identity)) for each in encoders}
        self._by_frame: dict[int, tuple[str, Callable[[str, CanFrame, int], Items]]] = {}
        for each in encoders:
            self._by_frame[cia301.cob_tpdo(1, each.node)] = each.name, self._report
            self._by_frame[cia301.cob_heartbeat(each.node)] = each.name, self._heartbeat
            self._by_frame[cia301.cob_emergency(each.node)] = each.name, self._emergency
            self._by_frame[cia301.cob_sdo_answer(each.node)] = each.name, self._reply
        delay_ns, period_ns = round(settings.sync_delay_s * 1e9), round(1e9 / settings.rate_Hz)
        lateness_ns = round(settings.max_lateness_s * 1e9)
        self._sync = SyncTimes(tuple(self._watches), delay_ns, lateness_ns)
        self._both: dict[str, int] = {}  # positions of A and B of the present SYNC
        self._silent = SilentEncoders()
        self._refused_before = 0  # lines that the adapter had refused when all encoders had last answered
        self._timers = {name: OwnTimer(period_ns, delay_ns) for name in self._watches}
        self._b = NewestOfB()
        self._marks = Marks(per_turn, period_ns)
        self._mark_number, self._mark_ns = 0, 0
        self._lost = 0  # samples missing since the last one, with SYNC
        self._next_number: int | None = None  # of the sample after the last one, without SYNC
        self._last_ns, self._period_ns = 0, period_ns
        self._origin, self._schedule, self._has_sent = SyncOrigin(), SyncSchedule(period_ns), False
        self._each_foreign, self._each_late, self._each_pause = EachSecond(), EachSecond(), EachSecond()
        self._paused = 0  # periods without a SYNC since they were last reported
        self._waiting: dict[str, tuple[int, int]] = {}  # raw positions and host times of encoders, see SyncTimes.holds
        self._taken = True  # whether the newest SYNC has its sample
        self._asked_ns = 0  # host time of the newest SYNC, whose …
        self._shaft_seen = self._left_late = False  # … report of the shaft has come, and shows that it left late
        self._radian = 2 * math.pi / per_turn

    @property
    @override
    def status(self) -> PipelineStatus:
        return PipelineStatus(complaint=self._complaint)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        out: list[Batch | DeviceEvent] = []
        if not self._begun:
            self._begun = True
            out += [event for watch in self._watches.values() for event in watch.opened()]
        if direction == TX:
            for contact in self._contacts.values():
                contact.sent(data)
            for frame in cia301.own_frames(self._lines.sent(data)):
                if frame.arbitration_id == cia301.COB_SYNC:
                    self._has_sent = True
                    self._origin.sent(host_ns)
                    out += self._asked(host_ns)
                    out += self._pauses(host_ns)
            return out
        if not data:
            return [*out, *self._end()]
        frames, events = self._lines.received(data)
        out += events
        for frame in cia301.own_frames(frames):
            known = self._by_frame.get(frame.arbitration_id)
            if known is not None:
                out += known[1](known[0], frame, host_ns)
            elif frame.arbitration_id == cia301.COB_SYNC:
                out += self._sync_of_bus(host_ns)
        for watch in self._watches.values():
            for event in watch.passed(host_ns):
                self.losses["heartbeats"] += 1
                out.append(event)
        return out

    @property
    def faults(self) -> list[str]:
        """Present faults of the encoders, for the operator."""
        return [watch.fault for watch in self._watches.values() if watch.fault]

    @property
    def syncs(self) -> int:
        """Number of SYNCs so far."""
        return self._sync.count

    # --- SYNC --------------------------------------------------------------------------------------------------

    def _sync_of_bus(self, host_ns: int) -> Items:
        """Take a SYNC from the bus: an echo of this host's, of the host to which this session listens, or foreign."""
        if not self._has_sent:
            yield from self._asked(host_ns)
        elif self._origin.received(host_ns):
            if self._sync.foreign():
                self._both, self._waiting = {}, {}
            yield from self._foreign(host_ns)

    def _foreign(self, host_ns: int) -> Items:
        """Count the SYNCs of other nodes, and report them once a second."""
        before, self.losses["foreign_syncs"] = self.losses["foreign_syncs"], self._origin.foreign
        if self._origin.foreign > before and self._each_foreign.passes(host_ns):
            text = "another node sends SYNC: the encoders sample at its instants too. Switch it off (1005h bit 30)"
            yield DeviceEvent("fault", self._device, text, {"foreign_syncs": self._origin.foreign})

    def _asked(self, host_ns: int) -> Items:
        if not self._settings.sync:
            return
        yield from self._held()
        has_sample, self._taken = self._taken or self._left_late, False
        self._asked_ns, self._shaft_seen, self._left_late = host_ns, False, False
        missing = self._sync.sync(host_ns)
        self._both, self._waiting = {}, {}
        self.losses["reports"] += len(missing)
        if not has_sample:
            self._lost += 1
            self.losses["samples"] += 1
        if not missing:
            self._refused_before = self.losses["refused_lines"]
        for name, count in self._silent.sync(missing, host_ns).items():
            text = f"{self._watches[name].name} has not answered {count} SYNCs: {self._why_silent()}"
            yield DeviceEvent("network", self._device, text, {"encoder": name, "operational": False})
        if missing == ["shaft"]:
            yield DeviceEvent("gap", self._device, "a position of the shaft is missing", {"reports": 1})

    def _why_silent(self) -> str:
        refused = self.losses["refused_lines"] - self._refused_before
        if not refused:
            return "it gives no position"
        return (
            f"the adapter has refused {number_of(refused, 'line')} since the last answer, so they did not go "
            f"out. It was reset, or "
            "no node acknowledges them: look at its supply, the bus and its termination, and open the rig again"
        )

    def _pauses(self, host_ns: int) -> Items:
        """Count the periods in which this host has sent no SYNC, and report them once a second."""
        if not self._settings.sync:
            return
        skipped = self._schedule.sent(host_ns)
        self.losses["unsampled"] += skipped
        self._paused += skipped
        if self._paused and self._each_pause.passes(host_ns):
            yield from self._paused_for()

    def _paused_for(self) -> Items:
        paused, self._paused = self._paused, 0
        if paused:
            text = (
                f"{number_of(paused, 'sample')} not taken: the host waited for answers, or was busy, and sent no SYNC"
            )
            facts = {"unsampled": paused, "span_s": paused * self._period_ns * 1e-9}
            yield DeviceEvent("gap", self._device, text, facts)

    def _held(self) -> Items:
        """Take positions that wait for another report, and angles that wait for one of the shaft that has not come."""
        if (instant := self._sync.newest) is None:
            return
        waiting, self._waiting = self._waiting, {}
        for name in sorted(waiting, reverse=True):  # the shaft first: it shows whether the SYNC left late
            yield from self._answer(name, instant, *waiting[name])
        if len(self._both) == 2:
            yield from self._both_of(instant)

    # --- messages of an encoder --------------------------------------------------------------------------------

    def _reply(self, name: str, frame: CanFrame, host_ns: int) -> Items:
        self._contacts[name].heard()
        yield DeviceEvent("reply", self._device, answer_text(frame))

    def _heartbeat(self, name: str, frame: CanFrame, host_ns: int) -> Items:
        watch = self._watches[name]
        yield from watch.heartbeat(frame, host_ns)
        if watch.restarted and not self._complaint:
            self._complaint = f"{watch.name} started again: its set-up is gone. Open the rig again"

    def _emergency(self, name: str, frame: CanFrame, host_ns: int) -> Items:
        yield from self._watches[name].emergency(frame)

    def _report(self, name: str, frame: CanFrame, host_ns: int) -> Items:
        self._contacts[name].heard()
        raw = wire.position(frame.data, self._offsets[name])
        wrong = ""
        if raw is None:
            wrong = (
                f"a report of {number_of(len(frame.data), 'byte')}, expected "
                f"{wire.POSITION_BYTES + self._offsets[name]}"
            )
        elif raw >= self._positions[name]:
            wrong = f"position {raw}, expected less than {self._positions[name]}"
        elif self._watches[name].restarted:
            wrong = "a position after it started again"
        if raw is None or wrong:
            yield self.damage("invalid", f"{self._watches[name].name}: {wrong}; dropped", lines=1)
        elif self._settings.sync:
            yield from self._synchronous(name, raw, host_ns)
        else:
            yield from self._free_running(name, self._turns[name].counts(raw), host_ns)

    def _synchronous(self, name: str, raw: int, host_ns: int) -> Items:
        holds = self._sync.holds(name)
        instant = self._sync.report(name, host_ns)
        if instant is None:
            if not self._sync.begun:
                return
            if self._sync.prompt and not self._sync.explains_more:
                self._origin.doubled()
                yield from self._foreign(host_ns)
            yield self._unasked(name)
            return
        if not holds:
            self._origin.answered()
            yield from self._foreign(host_ns)
        if self._sync.doubtful:
            return
        if not holds:
            yield from self._answer(name, instant, raw, host_ns)
            return
        if name in self._waiting:
            yield self._unasked(name)
        self._waiting[name] = raw, host_ns

    def _unasked(self, name: str) -> DeviceEvent:
        text = f"{self._watches[name].name}: a report that answers no SYNC, or comes too late; dropped"
        return self.damage("unasked", text, lines=1)

    def _answer(self, name: str, instant: Instant, raw: int, host_ns: int) -> Items:
        """Take the answer of an encoder to the newest SYNC."""
        counts = self._turns[name].counts(raw)
        if name == "shaft":
            lateness_ns = 0 if self._sync.prompt else self._marks.lateness_ns(instant, counts)
            self._shaft_seen = True
            if abs(lateness_ns) > self._settings.max_lateness_s * 1e9:
                self._both, self._left_late = {}, True
                yield from self._late(host_ns)
                return
            yield from self._shaft(instant, counts)
        elif not self._left_late:
            self._both[name] = counts
        if len(self._both) == 2 and (self._shaft_seen or self._sync.prompt or "shaft" not in self._watches):
            yield from self._both_of(instant)

    def _both_of(self, instant: Instant) -> Items:
        """Take the angles of the newest SYNC."""
        both, self._both, self._taken = self._both, {}, True
        lost, self._lost = self._lost, 0
        yield from self._sample(instant, both["a"], both["b"], lost)

    def _late(self, host_ns: int) -> Items:
        """Count the samples of the newest SYNC as missing."""
        self.losses["late"] += 1
        self.losses["samples"] += 1
        self._lost += 1
        if self._each_late.passes(host_ns):
            text = (
                f"a SYNC was answered after {(host_ns - self._asked_ns) * 1e-6:.1f} ms, usually after "
                f"{self._sync.usual_ns * 1e-6:.1f} ms, and the shaft had turned further: it left late, and its samples "
                "count as missing. Look at the load of this host"
            )
            yield DeviceEvent("gap", self._device, text, {"late": self.losses["late"]})

    def _free_running(self, name: str, counts: int, host_ns: int) -> Items:
        timer, values = self._timers[name], (counts,)
        if name == "b":
            self._b.took(counts)
        elif name == "a":
            newest = self._b.at_report_of_a()
            values = (counts,) if newest is None else (counts, newest)
        yield from self._timed(name, timer.feed(values, host_ns))

    def _timed(self, name: str, found: list[tuple[Instant, Values]]) -> Items:
        """Take reports of an encoder whose times are known; of A without a position of B there is no sample."""
        before = self.losses["reports"]
        self.losses["reports"] = sum(timer.missing for timer in self._timers.values())
        if (missing := self.losses["reports"] - before) and name != "a":  # those of A are missing samples
            whose = self._watches[name].name
            text = number_of(missing, f"report of {whose} is missing", f"reports of {whose} are missing")
            yield DeviceEvent("gap", self._device, text, {"reports": missing})
        for instant, values in found:
            if name == "shaft":
                yield from self._shaft(instant, *values)
            elif len(values) == 2:
                missing = 0 if self._next_number is None else instant.number - self._next_number
                self._next_number = instant.number + 1
                self.losses["samples"] += missing
                yield from self._sample(instant, *values, missing)

    def _end(self) -> Items:
        yield from self._held()
        yield from self._paused_for()
        if not self._settings.sync:
            for name, timer in self._timers.items():
                yield from self._timed(name, timer.end())

    # --- samples -----------------------------------------------------------------------------------------------

    def _sample(self, instant: Instant, a: int, b: int, lost: int) -> Items:
        time_ns = self._last_ns = max(self._last_ns + 1, instant.time_ns)
        if lost:
            span_s = lost * self._period_ns * 1e-9
            facts = {"samples": lost, "span_s": span_s, "time_ns": time_ns}
            yield DeviceEvent("gap", self._device, f"{number_of(lost, 'sample')} lost", facts)
        flags = channels.ENCODER_FAULT_A * self._watches["a"].faulty
        flags |= channels.ENCODER_FAULT_B * self._watches["b"].faulty
        sequence = np.array([instant.number], np.int64).astype(np.uint32)
        columns = {
            "theta3_rad": np.array([a * self._radian]),
            "theta4_rad": np.array([b * self._radian]),
            "count_a": np.array([a], np.int64).astype(np.int32),
            "count_b": np.array([b], np.int64).astype(np.int32),
            "index": sequence,
            "node_time_us": np.array([instant.own_ns // 1000], np.uint64),
            "flags": np.array([flags], np.uint32),
        }
        yield Batch(channels.PENDULUMS, np.array([time_ns], np.int64), sequence, columns)

    def _shaft(self, instant: Instant, counts: int) -> Items:
        for revolution, time_ns, own_ns in self._marks.feed(instant, counts):
            self._mark_ns = max(self._mark_ns + 1, time_ns)
            number = np.array([self._mark_number], np.int64).astype(np.uint32)
            self._mark_number += 1
            columns = {
                "revolutions": np.array([revolution], np.int64).astype(np.uint32),
                "node_time_us": np.array([own_ns // 1000], np.int64).astype(np.uint64),
            }
            yield Batch(channels.TACHO, np.array([self._mark_ns], np.int64), number, columns)


_MAX_UNSAMPLED_SHARE = 0.02  # of the periods; a busy host misses a few

_FOREIGN = (
    "another node sends SYNC, and the encoders sample at its instants too: samples near them are dropped. Switch it "
    "off (1005h bit 30 of that node, or the other program)"
)
_UNASKED = (
    "an encoder has answered without or after its SYNC. Likely causes: another sender of SYNC; two encoders with one "
    "node number; an adapter that passes reports on late (its latency timer); a TPDO1 that is sent otherwise too"
)
_UNSAMPLED = (
    "this host waited for answers and sent no SYNC in these periods. Reduce rate_Hz or the latency timer of the "
    "adapter; if reports are missing too, look at slip ring and termination"
)


def emergency_words(event: DeviceEvent) -> str:
    """Return the text of an emergency; empty if it has ended."""
    code = int(event.facts["error_code"])
    return f"of encoder {event.facts['encoder']}: {cia301.emergency_words(code)}" if code else ""


def encoder_checks(
    settings: EncoderBus, pipeline: EncoderPipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the checks of open encoders; see Driver.checks."""
    losses = pipeline.losses
    emergencies = [words for event in events if event.kind == "emergency" and (words := emergency_words(event))]
    found = list(dict.fromkeys([*emergencies, *pipeline.faults]))
    missing, unsampled = losses["reports"], losses["unsampled"]
    periods = max(1, pipeline.syncs + unsampled)
    few = unsampled <= _MAX_UNSAMPLED_SHARE * periods
    return {
        "emergencies": DeviceCheck("; ".join(found) or "none", "none", not found),
        "missing reports": DeviceCheck(missing, 0, missing == 0, "Look at bit rate and termination" * (missing > 0)),
        "foreign_syncs": _none(losses["foreign_syncs"], _FOREIGN),
        "lost_unasked": _none(losses["unasked"], _UNASKED),
        "lost_unsampled": DeviceCheck(
            unsampled, f"at most {_MAX_UNSAMPLED_SHARE:.0%} of the periods", few, "" if few else _UNSAMPLED
        ),
    }


def _none(count: int, remedy: str) -> DeviceCheck:
    return DeviceCheck(count, 0, count == 0, remedy if count else "")
