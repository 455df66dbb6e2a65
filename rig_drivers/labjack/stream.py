"""Pipeline of a LabJack: answers to stream reads to displacements, index marks and other quantities.

The stream has no times: scans are counted. A scan's time is its number times the scan period on the device's clock,
mapped to the common clock. Scans that the device reports as skipped advance the count. Answers that are missing, and a
stream that the host started again, leave an unknown number of scans out: those due by the host's time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq import channels
from daq.clock import ClockMap
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.drivers.displacement import displacement_batch
from daq.drivers.index_marks import MarkSequence
from daq.items import TX, Batch, DeviceEvent
from daq.numbered.due_line import DueLine
from rig_basics.texts import number_of
from rig_drivers.labjack import wire
from rig_drivers.labjack.marks import IndexMarks
from rig_drivers.labjack.scans import Counts, CutAnswer, ScanCutter, VoltScale, have_no_value, nominal
from rig_drivers.labjack.settings import LabJack, other_channel

_FILLING_BYTES, _EMPTY_BYTES = wire.BUFFER_BYTES // 2, wire.BUFFER_BYTES // 8
_MOST_SHARE = 0.502  # of the output from its middle: more than half, so that noise at an end is a reading
_MOST_REFUSED = 3  # reads refused in a row, after which the stream is not read any more
_MOST_EARLY_NS = 2_000_000_000  # by which skipped scans may exceed the host's time, for times that are not known well
_INPUT_NS = 10_000  # from one input of a scan to the next, about
_STEP_NS = 20_000_000  # least step of the clock that is reported; smaller ones are delays of the network
_PACE_NS, _OTHER_PACE = 4_000_000_000, 0.05
"""Time without losses after which another pace of the scans is that of another set-up: delays of a network that becomes
slower grow by less."""
_GOOD = (wire.Status.GOOD, wire.Status.RECOVERING, wire.Status.RECOVERED, wire.Status.RECOVERED_TOO_MANY)
_ENDED = (wire.Status.RECOVERED, wire.Status.RECOVERED_TOO_MANY)

Items = list[Batch | DeviceEvent]


class LabJackPipeline(Pipeline):
    """Decoder of one device's answers.

    Attributes:
        losses: see Pipeline. "samples": scans that the device skipped, scans of missing answers and scans before a new
            start of the stream (both estimated); "bytes": skipped; "refused": stream reads that the device refused;
            "invalid": voltages beyond the output of a displacement sensor, or above the range of its input.
        warning: text of the device's identity about nominal scales; empty if all are those of its flash.
    """

    def __init__(self, device: str, settings: LabJack, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "bytes", "refused", "invalid")
        self._settings = settings
        self._lasers = [(each, channels.displacement_channel(each.topic)) for each in settings.lasers.values()]
        self._others = [(each, other_channel(name, each)) for name, each in settings.others.items()]
        self.warning: str = str(identity.get("warning", ""))
        rate = identity.get("scan_rate_Hz")
        self._period_ns = 1e9 / (rate if isinstance(rate, float) and rate > 0 else settings.scan_rate_Hz)
        model = str(identity.get("model", "T7"))
        self._scales = {
            name: VoltScale.of(identity, name) or nominal(model, range_V) for name, range_V in settings.ranges_V.items()
        }
        self._inputs = len(settings.scan_list)
        self._decoder = wire.MessageDecoder()
        self._set_up_lost = ""  # the scans have another pace than that of the set-up
        sequence = MarkSequence(device, self.losses)
        self._marks = None if settings.tacho is None else IndexMarks(settings.tacho, self._period_ns, sequence)
        self._skips = False  # whether scans are being skipped: the age of samples is unknown
        self._next = 0  # number of the next scan
        self._cutter = ScanCutter(self._inputs)
        self._ended: wire.StreamRead | None = None  # answer with the status of a separator that is not complete
        self._start: tuple[int, int] | None = None  # number and host time of a start command without an answer
        self._started_ns: int | None = None  # host time of the start of a stream of which no scan has been read
        self._refusals = 0  # in a row
        self._scan_ns: int | None = None  # time of the newest scan
        self._standing: set[str] = set()  # conditions that were reported and have not ended
        self._clock = ClockMap(settings.clock_tolerance_ppm)
        self._has_learned = False  # whether the clock's map has seen a read whose age is known
        self._begin_due()

    @property
    def status(self) -> PipelineStatus:
        """See Pipeline. The inputs of a scan are read one after the other, but have the same time."""
        std_ns = math.hypot(self._clock.std_ns, (self._inputs - 1) * _INPUT_NS / math.sqrt(3.0))
        return PipelineStatus(set_up_lost=self._set_up_lost, clock_std_ns=std_ns)

    def _begin_clock(self) -> None:
        """Begin with scans whose numbers do not continue those before with certainty."""
        self._clock.restart()
        self._has_learned = False
        self._begin_due()

    def _begin_due(self) -> None:
        self._due, self._due_ns = DueLine(_STEP_NS), 0  # and the time of its first answer

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            number = wire.start_number(data)
            self._start = self._start if number is None else (number, host_ns)
            return []
        found = self._decoder.feed(data)
        out: Items = []
        if found.skipped_bytes:
            out.append(self.skipped_bytes(found.skipped_bytes, "message"))
        for message in found.messages:
            if message.number == wire.ERROR_NUMBER:
                out += self._explained(message)
            elif message.number < wire.FIRST_STREAM_ID:
                self._note_start(message)
                text = wire.encode(message).hex()
                out.append(DeviceEvent("reply", self._device, text))
            elif message.function == wire.REFUSED:
                out += self._refused(message)
            else:
                out += self._stream(message, host_ns)
        return out

    def _note_start(self, message: wire.Message) -> None:
        """Note the answer to the command that starts the stream: the next stream read is the first of a new stream."""
        if self._start is None or self._start[0] != message.number:
            return
        if message.function == wire.FEEDBACK:
            self._started_ns = self._start[1]
            self._cutter.begin()
            self._begin_due()
            self._set_up_lost = ""
        self._start = None

    def _refused(self, message: wire.Message) -> Items:
        """Count a refused read. One of them has no consequence: its scans are read with the next answer."""
        self.losses["refused"] += 1
        self._cutter.refused(message.number)
        self._refusals += 1
        code = message.body[0] if message.body else 0
        text = f"it refuses to be read (exception {code})"
        out = self._reported("refuses", True, "refused", text, exception=code)
        text = f"it refuses to be read: {_MOST_REFUSED} times in a row (exception {code})"
        return [*out, *self._reported("refused", self._refusals >= _MOST_REFUSED, "fault", text)]

    def _explained(self, message: wire.Message) -> Items:
        """Return the event about the error of a refused read; see `poller.StreamReads`."""
        if message.function != wire.FEEDBACK or len(message.body) != 2 or not self._refusals:
            return []
        code = int.from_bytes(message.body, "big")
        text = f"it refuses to be read: {wire.explain(code)}"
        if code == wire.Status.STREAM_NOT_RUNNING:
            return self._reported("refused", True, "fault", text, error=code)
        return self._reported("explained", True, "refused", text, error=code)

    def _reported(self, condition: str, holds: bool, kind: str, text: str, **facts: int) -> Items:
        """Return an event about a condition when it begins."""
        began = holds and condition not in self._standing
        (self._standing.add if holds else self._standing.discard)(condition)
        return [DeviceEvent(kind, self._device, text, facts)] if began else []

    def _stream(self, message: wire.Message, host_ns: int) -> Items:
        read = wire.parse_stream(message.body)
        if read is None:
            count = len(message.body)
            text = f"the answer to a stream read has {number_of(count, 'byte')}, fewer than it states"
            return [self.damage("bytes", text, count, bytes=count)]
        return [item for each in self._cutter.feed(message.number, read, host_ns) for item in self._decoded(each)]

    def _decoded(self, answer: CutAnswer) -> Items:
        """Return the events and samples of an answer."""
        read, host_ns, scans, _, dropped = answer
        out: Items = []
        if dropped:
            text = f"samples are missing within a scan, without a report (another program reads the stream): {dropped} "
            text += "samples whose inputs are not certain were dropped"
            out.append(DeviceEvent("damage", self._device, text, {"samples": dropped}))
        if scans is None:
            return [*out, *self._state(read)]
        if self._started_ns is not None:
            out += self._started_again(self._started_ns, read, host_ns)
        elif answer.is_after_missing:
            out += self._missing_answers(read, host_ns)
        out += self._state(read)
        ended, self._ended = self._ended or (read if read.status in _ENDED else None), None
        waiting = read.waiting // self._inputs
        sent_ns = host_ns - round(waiting * self._period_ns)
        self._skips |= read.status == wire.Status.RECOVERING
        if ended is not None:
            self._skips = True
            empty = np.flatnonzero(have_no_value(scans))
            if len(empty) or not self._cutter.begins_without_value:
                at = int(empty[0]) if len(empty) else 0
                out += self._scans(scans[:at], sent_ns)
                self._skips = False
                out += self._skipped(ended, host_ns, len(scans) - at + waiting)
                scans = scans[at + bool(len(empty)) :]
            else:  # the rest of the separator comes with the next answer
                self._ended = ended
        out += self._scans(scans, sent_ns)
        self._watch_pace(self._next + waiting, host_ns)
        return out

    def _watch_pace(self, number: int, host_ns: int) -> None:
        """Take the number of the newest scan that the device has measured, and compare the scans' pace."""
        if self._skips:
            self._begin_due()
            return
        self._due.take(number * self._period_ns, host_ns)
        self._due_ns = self._due_ns or host_ns
        if host_ns - self._due_ns > _PACE_NS and abs(1 / self._due.pace - 1) > _OTHER_PACE:
            rate_Hz = 1e9 / self._period_ns
            self._set_up_lost = (
                f"its scans come at about {rate_Hz / self._due.pace:.0f} Hz instead of {rate_Hz:.0f} Hz, so that their "
                "times are wrong: another program has set up its stream. End that program"
            )

    def _state(self, read: wire.StreamRead) -> Items:
        """Return the events about the state of the stream."""
        overlap = read.status == wire.Status.SCAN_OVERLAP
        why = (
            "a scan began before the previous one had ended. Lower scan_rate_Hz" if overlap else "the stream has ended"
        )
        text = f"status {read.status} of the stream: {why}"
        out = self._reported("stopped", read.status not in _GOOD, "fault", text, status=read.status)
        self._refusals = 0
        self._standing -= {"refused", "refuses", "explained"}
        return [*out, *self._buffer(read)]

    def _buffer(self, read: wire.StreamRead) -> Items:
        """Return the events of a buffer that fills, and of one that was full."""
        backlog = read.backlog_bytes
        fills = backlog > _FILLING_BYTES or ("backlog" in self._standing and backlog > _EMPTY_BYTES)
        text = f"{backlog} of {wire.BUFFER_BYTES} bytes wait in its buffer: the host or the network is late"
        out = self._reported("backlog", fills, "backlog", text, backlog_bytes=backlog)
        full = read.status == wire.Status.RECOVERING
        text = "its buffer was full: it skips scans until the buffer has been read"
        return [*out, *self._reported("full", full, "backlog", text, backlog_bytes=backlog)]

    # --- lost scans ----------------------------------------------------------------------------------------------

    def _behind(self, at_ns: int, scans: int) -> int:
        """Return the number of scans due by a host time, without these, of which the last one was measured then."""
        return 0 if self._scan_ns is None else round((at_ns - self._scan_ns) / self._period_ns) - scans

    def _scans_of(self, read: wire.StreamRead) -> int:
        """Return the number of scans that an answer has, and that wait behind it."""
        return (len(read.samples) + read.waiting) // self._inputs

    def _missing_answers(self, read: wire.StreamRead, host_ns: int) -> Items:
        """Return the event about answers missing before this one; the number of their scans is estimated.

        The scans that a device with a full buffer skips are not among them: it will report their number.
        """
        self._ended = None
        lost = self._behind(host_ns, self._scans_of(read))
        if lost <= 0 or read.status == wire.Status.RECOVERING:
            return []
        return [self._lost(lost, f"about {number_of(lost, 'scan')} lost: answers are missing")]

    def _started_again(self, started_ns: int, read: wire.StreamRead, host_ns: int) -> Items:
        """Return the event about a new stream. Its first answer gives the number of scans lost before it (estimated).

        The start of the first stream of a log loses nothing.
        """
        self._started_ns, self._skips, self._ended = None, False, None
        if self._scan_ns is None:
            return []
        behind = self._behind(started_ns, 1)
        if read.status != wire.Status.RECOVERING:
            behind = max(behind, self._behind(host_ns, self._scans_of(read)))
        lost = max(0, behind)
        text = (
            f"its stream was started again: about {number_of(lost, 'scan')} lost "
            f"({lost * self._period_ns * 1e-6:.0f} ms)"
        )
        return [self._lost(lost, text, keeps_clock=behind < 0)]  # times that are ahead do not go back

    def _skipped(self, read: wire.StreamRead, host_ns: int, waiting: int) -> Items:
        """Return the event about scans that the device skipped because its buffer was full.

        Args:
            waiting: number of scans from the separator on.
        """
        behind = self._behind(host_ns, waiting)
        stated = read.info + (not self._settings.separator_counts)
        is_possible = not self._has_learned or (stated - behind) * self._period_ns < _MOST_EARLY_NS
        if read.status == wire.Status.RECOVERED and is_possible:
            span = f"{stated * self._period_ns * 1e-6:.1f} ms"
            self._advance(stated)
            text = f"{number_of(stated, 'scan')} skipped by the device, whose buffer was full ({span})"
            facts = {"samples": stated, "span_s": stated * self._period_ns * 1e-9}
            return [DeviceEvent("gap", self._device, text, facts)]
        why = "more than it counts" if read.status != wire.Status.RECOVERED else f"it states {stated}, too many"
        lost = max(0, behind)
        return [self._lost(lost, f"about {number_of(lost, 'scan')} skipped by the device: {why}")]

    def _lost(self, lost: int, text: str, *, keeps_clock: bool = False) -> DeviceEvent:
        """Return the event about lost scans, whose number is an estimate."""
        self._advance(lost)
        if not keeps_clock:
            self._begin_clock()
        span = lost * self._period_ns * 1e-9
        return DeviceEvent("gap", self._device, text, {"samples": lost, "span_s": span, "uncertain_samples": lost})

    def _advance(self, lost: int) -> None:
        self.losses["samples"] += lost
        self._next += lost
        if self._marks is not None:
            self._marks.scans_lost()

    # --- samples -------------------------------------------------------------------------------------------------

    def _scans(self, scans: Counts, sent_ns: int) -> Items:
        """Return the samples of scans. The last one was measured about `sent_ns`: those that wait are newer."""
        if not len(scans):
            return []
        number = np.arange(self._next, self._next + len(scans))
        self._next += len(scans)
        device_ns = np.rint(number * self._period_ns).astype(np.int64)
        out, time_ns = self._times(device_ns, sent_ns)
        column = dict(zip(self._settings.ranges_V, range(self._inputs), strict=False))
        volts = {name: self._scales[name].volts(scans[:, place]) for name, place in column.items()}
        over = {name: scans[:, place] == wire.NO_VALUE for name, place in column.items()}
        sequence = number.astype(np.uint32)
        for laser, channel in self._lasers:
            values = volts[laser.input]
            share = (values - laser.near_V) / (laser.far_V - laser.near_V) - 0.5
            share[(np.abs(share) > _MOST_SHARE) | over[laser.input]] = np.nan
            self.losses["invalid"] += int(np.count_nonzero(np.isnan(share)))
            displacement = share * laser.range_m / laser.lever_ratio
            code = scans[:, column[laser.input]]
            out.append(displacement_batch(channel, time_ns, number, device_ns, displacement, code))
        for other, channel in self._others:
            value = (volts[other.input] - other.zero_V) * other.per_V
            value[over[other.input]] = np.nan
            out.append(Batch(channel, time_ns, sequence, {other.quantity: value, "scan": sequence}))
        return [*out, *self._index_marks(scans, volts, number, time_ns)]

    def _times(self, device_ns: NDArray[np.int64], sent_ns: int) -> tuple[Items, NDArray[np.int64]]:
        """Return the times of scans on the common clock, and the event about a step of the clock."""
        learn = not self._skips
        if learn and not self._has_learned:  # times until here had no known age
            self._clock.restart()
            self._has_learned = True
        time_ns = self._clock.map(device_ns, sent_ns, learn=learn)
        self._scan_ns = int(time_ns[-1])
        step_ns = self._clock.step_ns
        if abs(step_ns) < _STEP_NS:
            return [], time_ns
        scans = round(step_ns / self._period_ns)
        shift = f"{-step_ns * 1e-6:.0f} ms earlier" if step_ns < 0 else f"{step_ns * 1e-6:.0f} ms later"
        text = f"its scans arrive {shift} than before: the clock of the host was set"
        if scans > 0:
            text += (
                f", or about {number_of(scans, 'scan is', 'scans are')} missing without a report (another "
                f"program reads the stream)"
            )
        facts = {"step_s": step_ns * 1e-9, "scans": scans}
        return [DeviceEvent("clock", self._device, text, facts)], time_ns

    def _index_marks(
        self, scans: Counts, volts: Mapping[str, NDArray[np.float64]], number: NDArray[np.int64], time_ns: NDArray[Any]
    ) -> Items:
        """Return the index marks. Scans without any value have no state of the tachometer: no edge is found there."""
        empty = have_no_value(scans) if self._inputs > 1 else np.zeros(len(scans), np.bool_)
        text = "scans without a value at any input (FFFFh), and no number of skipped scans"
        out = self._reported("empty", bool(empty.any()), "damage", text, samples=int(np.count_nonzero(empty)))
        tacho = self._settings.tacho
        if tacho is None or self._marks is None:
            return out
        signal = scans[:, -1] if tacho.is_digital else volts[tacho.input]
        edges = [0, *(np.flatnonzero(np.diff(empty)) + 1).tolist(), len(scans)]
        for start, end in pairwise(edges):
            if empty[start]:
                self._marks.scans_lost()
            else:
                out += self._marks.feed(signal[start:end], number[start:end], time_ns[start:end])
        return out
