"""Pipeline of a LabJack: answers to stream reads to displacements, index marks and other quantities.

The stream has no times: scans are counted. A scan's time is its number times the scan period on the device's clock,
mapped to the common clock. Scans that the device reports as skipped advance the count. An answer that is missing (the
connection was lost, and the stream began again) has an unknown number of scans: it is estimated from the host's time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.channels import Channel
from daq.clock import ClockMap, clock_rules
from daq.drivers.labjack import wire
from daq.drivers.labjack.marks import IndexMarks
from daq.drivers.labjack.settings import LabJack
from daq.drivers.labjack.volts import VoltScale, nominal
from daq.items import TX, Batch, DeviceEvent

_TICK_NS = round(channels.DEVICE_TICK_S * 1e9)
BUFFER_BYTES = 32_768
"""Size of the device's buffer; it must be a power of 2."""
_FILLING_BYTES, _EMPTY_BYTES = BUFFER_BYTES // 2, BUFFER_BYTES // 8
_MOST_SHARE = 0.502  # of the output from its middle: more than half, so that noise at an end is a reading
_GOOD = (wire.Status.GOOD, wire.Status.RECOVERING, wire.Status.RECOVERED, wire.Status.RECOVERED_TOO_MANY)

Items = list[Batch | DeviceEvent]
Counts = NDArray[np.uint16]


class LabJackPipeline:
    """Decoder of one device's answers.

    Attributes:
        losses: see Pipeline. "samples": scans that the device skipped, and scans of missing answers (estimated);
            "bytes": skipped; "refused": stream reads that the device refused; "invalid": voltages beyond the output of
            a displacement sensor.
    """

    def __init__(
        self, device: str, settings: LabJack, of_topic: Mapping[str, Channel], identity: Mapping[str, Any]
    ) -> None:
        self.losses: dict[str, int] = dict.fromkeys(("samples", "bytes", "refused", "invalid"), 0)
        self._device, self._settings, self._channels = device, settings, of_topic
        rate = identity.get("scan_rate_Hz")
        self._period_ns = 1e9 / (rate if isinstance(rate, float) and rate > 0 else settings.scan_rate_Hz)
        model = str(identity.get("model", "T7"))
        self._scales = {
            name: VoltScale.of(identity, name) or nominal(model, range_V) for name, range_V in settings.ranges_V.items()
        }
        self._inputs = len(settings.scan_list)
        self._marks = None if settings.tacho is None else IndexMarks(settings.tacho, self._period_ns)
        self._decoder = wire.MessageDecoder()
        self._rules = clock_rules(identity)
        self._clock = self._new_clock()
        self._next = 0  # number of the next scan
        self._rest: Counts = np.empty(0, np.uint16)  # samples of a scan whose others have not arrived
        self._number: int | None = None  # transaction number of the newest stream read
        self._newest: tuple[int, int] | None = None  # its host time, and its backlog in scans
        self._scan_ns: int | None = None  # time of the newest scan
        self._standing: set[str] = set()  # conditions that were reported and have not ended

    def _new_clock(self) -> ClockMap:
        return ClockMap(self._settings.clock_tolerance_ppm, self._rules)

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            return []
        found = self._decoder.feed(data)
        out: Items = []
        if found.skipped_bytes:
            self.losses["bytes"] += found.skipped_bytes
            text = f"{found.skipped_bytes} bytes skipped that do not belong to a message"
            out.append(DeviceEvent("damage", self._device, text, {"bytes": found.skipped_bytes}))
        for message in found.messages:
            if message.number < wire.FIRST_STREAM_ID:
                text = wire.encode(message).hex()
                out.append(DeviceEvent("reply", self._device, text))
            elif message.function == wire.REFUSED:
                out += self._refused(message)
            else:
                out += self._stream(message, host_ns)
        return out

    def _refused(self, message: wire.Message) -> Items:
        self.losses["refused"] += 1
        self._number = message.number
        code = message.body[0] if message.body else 0
        text = f"it refuses to be read (exception {code}): its stream has stopped"
        return self._reported("refused", True, "fault", text)

    def _reported(self, condition: str, holds: bool, kind: str, text: str, **facts: int) -> Items:
        """Return an event about a condition when it begins."""
        began = holds and condition not in self._standing
        (self._standing.add if holds else self._standing.discard)(condition)
        return [DeviceEvent(kind, self._device, text, facts)] if began else []

    def _stream(self, message: wire.Message, host_ns: int) -> Items:
        read = wire.parse_stream(message.body)
        if read is None:
            self.losses["bytes"] += len(message.body)
            text = f"the answer to a stream read has {len(message.body)} bytes, fewer than it states"
            return [DeviceEvent("damage", self._device, text, {"bytes": len(message.body)})]
        out = self._missing_answers(message.number, read, host_ns)
        overlap = read.status == wire.Status.SCAN_OVERLAP
        why = (
            "a scan began before the previous one had ended. Lower scan_rate_Hz" if overlap else "the stream has ended"
        )
        text = f"status {read.status} of the stream: {why}"
        out += self._reported("stopped", read.status not in _GOOD, "fault", text, status=read.status)
        out += self._reported("refused", False, "", "")
        out += self._buffer(read)
        ended = read.status in (wire.Status.RECOVERED, wire.Status.RECOVERED_TOO_MANY)
        samples = np.concatenate([self._rest, read.samples])
        whole = len(samples) // self._inputs
        self._rest = samples[whole * self._inputs :]
        scans = samples[: whole * self._inputs].reshape(whole, self._inputs)
        sent_ns = host_ns - round(read.backlog_bytes // (2 * self._inputs) * self._period_ns)
        separators = np.flatnonzero(scans[:, 0] == wire.SEPARATOR)
        if ended or len(separators):
            at = int(separators[0]) if len(separators) else 0
            out += self._scans(scans[:at], sent_ns)
            out += self._skipped(read, host_ns, len(scans) - at) if ended else self._separator()
            scans = scans[at:][scans[at:, 0] != wire.SEPARATOR]
        out += self._scans(scans, sent_ns)
        self._newest = host_ns, read.backlog_bytes // (2 * self._inputs)
        return out

    def _buffer(self, read: wire.StreamRead) -> Items:
        """Return the events of a buffer that fills, and of one that was full."""
        backlog = read.backlog_bytes
        fills = backlog > _FILLING_BYTES or ("backlog" in self._standing and backlog > _EMPTY_BYTES)
        text = f"{backlog} of {BUFFER_BYTES} bytes wait in its buffer: the host or the network is late"
        out = self._reported("backlog", fills, "backlog", text, backlog_bytes=backlog)
        full = read.status == wire.Status.RECOVERING
        text = "its buffer was full: it skips scans until the buffer has been read"
        return [*out, *self._reported("full", full, "backlog", text, backlog_bytes=backlog)]

    # --- lost scans ----------------------------------------------------------------------------------------------

    def _missing_answers(self, number: int, read: wire.StreamRead, host_ns: int) -> Items:
        """Return the event about answers missing before this one; the number of their scans is estimated.

        The scans that a device with a full buffer skips are not among them: it will report their number.
        """
        before, self._number = self._number, number
        if before is None or self._newest is None or (number - before) % wire.FIRST_STREAM_ID == 1:
            return []
        then_ns, waited = self._newest
        came = (len(read.samples) + read.backlog_bytes // 2) // self._inputs - waited
        lost = round((host_ns - then_ns) / self._period_ns) - came
        self._rest = self._rest[:0]
        if lost <= 0 or read.status == wire.Status.RECOVERING:
            return []
        return [self._lost(lost, f"about {lost} scans lost: answers are missing", uncertain_samples=lost)]

    def _skipped(self, read: wire.StreamRead, host_ns: int, after: int) -> Items:
        """Return the event about scans that the device skipped because its buffer was full.

        Args:
            after: number of scans of this answer from the separator on.
        """
        if read.status == wire.Status.RECOVERED:
            lost = read.info + (not self._settings.separator_counts)
            text = f"{lost} scans skipped by the device, whose buffer was full ({lost * self._period_ns * 1e-6:.1f} ms)"
            self._advance(lost)
            facts = {"samples": lost, "span_s": lost * self._period_ns * 1e-9}
            return [DeviceEvent("gap", self._device, text, facts)]
        waiting = after + read.backlog_bytes // (2 * self._inputs)
        behind_ns = 0.0 if self._scan_ns is None else host_ns - self._scan_ns - waiting * self._period_ns
        lost = max(0, round(behind_ns / self._period_ns))
        return [
            self._lost(lost, f"about {lost} scans skipped by the device: more than it counts", uncertain_samples=lost)
        ]

    def _separator(self) -> Items:
        """A separator without its status: the stream is damaged. Edges are not found across it."""
        if self._marks is not None:
            self._marks.scans_lost()
        return [DeviceEvent("damage", self._device, "a separator in the stream, without the number of skipped scans")]

    def _lost(self, lost: int, text: str, **facts: int) -> DeviceEvent:
        self._advance(lost)
        self._clock = self._new_clock()
        span = lost * self._period_ns * 1e-9
        return DeviceEvent("gap", self._device, text, {"samples": lost, "span_s": span, **facts})

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
        time_ns = self._clock.map(device_ns, sent_ns)
        self._scan_ns = int(time_ns[-1])
        column = dict(zip(self._settings.ranges_V, range(self._inputs), strict=False))
        volts = {name: self._scales[name].volts(scans[:, place]) for name, place in column.items()}
        sequence = number.astype(np.uint32)
        out: Items = []
        for laser in self._settings.lasers.values():
            values = volts[laser.input]
            share = (values - laser.near_V) / (laser.far_V - laser.near_V) - 0.5
            share[np.abs(share) > _MOST_SHARE] = np.nan
            self.losses["invalid"] += int(np.count_nonzero(np.isnan(share)))
            columns: dict[str, NDArray[Any]] = {
                "displacement_m": share * laser.range_m / laser.lever_ratio,
                "code": scans[:, column[laser.input]].astype(np.uint32),
                "counter": sequence,
                "device_ticks": (device_ns // _TICK_NS).astype(np.uint64),
                "flags": np.zeros(len(scans), np.uint32),
            }
            out.append(Batch(self._channels[laser.topic], time_ns, sequence, columns))
        for name, other in self._settings.others.items():
            channel = self._channels[f"analogue/{name}"]
            value = (volts[other.input] - other.zero_V) * other.per_V
            out.append(Batch(channel, time_ns, sequence, {other.quantity: value, "scan": sequence}))
        tacho = self._settings.tacho
        if tacho is None or self._marks is None:
            return out
        signal = scans[:, -1] if tacho.is_digital else volts[tacho.input]
        return [*out, *self._marks.feed(signal, number, time_ns)]
