"""Pipeline of an RF60x sensor: bytes to displacement of the disk centre.

The sensor sends no time and numbers its packets modulo 4. The pipeline counts the samples, including lost ones:
`counter` is the number of a sample, `device_ticks` is this number times the sampling period in units of 10 µs. The
accuracy of a loss count depends on the loss:

- Fewer than 4 results are missing between two received results. The count is exact, by the packets' numbers.
- More are missing, and their bytes arrived damaged. Four bytes correspond to one result. The count is the nearest
  number that fits modulo 4, if it is possible by the host's time.
- More are missing, and their bytes did not arrive. The count is estimated from the host's time
  (`rig_drivers.riftek.arrivals`). A read that is late by more than `Arrivals.far_ns` is held until the host has caught
  up or its delay has persisted: for 0.25 s, or for two reads before the stream is stopped or started. Its samples are
  returned late and have correct times. A smaller loss is found up to 1 s later; the samples until then have times that
  are early by the duration of the loss. The event of such a gap contains `uncertain_samples`. A multiple of 4 below the
  guard is never found.

`far_ns` is the largest of 30 ms, eight periods and three guards. Results between losses of three, one by one, look like
a stuck line. A sensor that was switched off and on gives a gap like any other, because the line does not show the
difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq import channels
from daq.clock import ClockMap
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.drivers.displacement import displacement_batch, range_of
from daq.drivers.plain import TICK_NS
from daq.drivers.spikes import LOOK_AHEAD, SpikeWatch
from daq.items import TX, Batch, DeviceEvent
from rig_drivers.riftek import wire
from rig_drivers.riftek.arrivals import Arrivals, ResultRate
from rig_drivers.riftek.decoder import DecodedResults, ResultDecoder
from rig_drivers.riftek.settings import RiftekLaser

NOT_NEW = 0x2
"""Bit of `flags`: the sensor sent an older result again."""

_NO_READING = 0x3FFFF  # code for the spike detector: above any reading
_WAIT_NS, _WAIT_READS = 250_000_000, 4  # a late read waits at least so long for the host to catch up
_MAX_WAIT_ROWS = 65_536  # results that may wait

Items = list[Batch | DeviceEvent]


@dataclass(frozen=True)
class _Rows:
    """Results in order.

    Attributes:
        code: results as sent.
        updated: whether each is a new result.
        step: number of samples by which each follows the one before.
        guessed: whether part of the step is estimated from the host's time.
    """

    code: NDArray[np.int64]
    updated: NDArray[np.bool_]
    step: NDArray[np.int64]
    guessed: NDArray[np.bool_]

    def part(self, begin: int, end: int | None) -> _Rows:
        return _Rows(self.code[begin:end], self.updated[begin:end], self.step[begin:end], self.guessed[begin:end])


class _Waiting:
    """Results that are held because they are too late for their numbers, until later reads show the cause."""

    def __init__(self, rows: _Rows, excess_ns: float, host_ns: int) -> None:
        self.parts = [rows]
        self.count = len(rows.code)
        self.excess_ns = excess_ns
        self._since_ns, self.reads = host_ns, 1

    def add(self, rows: _Rows, excess_ns: float, host_ns: int, guard_ns: float) -> None:
        """Take the next read; one that is less late restarts the wait, because the host is catching up."""
        self.parts.append(rows)
        self.count += len(rows.code)
        if excess_ns < self.excess_ns - guard_ns:
            self._since_ns, self.reads = host_ns, 0
        self.excess_ns = min(self.excess_ns, excess_ns)
        self.reads += 1

    def over(self, host_ns: int) -> bool:
        """Whether the wait is over."""
        return self.reads >= _WAIT_READS and host_ns - self._since_ns >= _WAIT_NS

    def rows(self, missing: int) -> _Rows:
        """Return all results; `missing` is the number of results lost before the first."""
        step = np.concatenate([part.step for part in self.parts])
        guessed = np.concatenate([part.guessed for part in self.parts])
        step[0] += missing
        guessed[0] |= missing > 0
        code = np.concatenate([part.code for part in self.parts])
        return _Rows(code, np.concatenate([part.updated for part in self.parts]), step, guessed)


class RiftekPipeline(Pipeline):
    """Decoder of RF60x bytes to displacement of the disk centre; see the module for the counting of losses.

    Displacement is 0 in the middle of the measuring range and increases with the distance from the sensor.

    Raises:
        DeviceError: the range of the identity is invalid.
    """

    def __init__(self, device: str, settings: RiftekLaser, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "bytes", "invalid", "suspect")
        self._channel = channels.displacement_channel(settings.topic)
        self._range_m = range_of(device, settings, identity)
        self._to_disk = 1.0 / settings.lever_ratio
        self._period_ns = 1000 * settings.period_us
        self._no_target = settings.no_target_codes
        self._decoder = ResultDecoder()
        self._arrivals = Arrivals(self._period_ns)
        self._clock = ClockMap(settings.clock_tolerance_ppm)
        self._spikes = SpikeWatch()
        self._number = -1  # number of the last sample returned, including lost ones
        self._given = 0  # samples returned
        self._decoded = 0  # results decoded: returned and waiting ones
        self._verdicts: list[int] = []  # positions of doubtful samples; the verdict is due LOOK_AHEAD positions later
        self._found_late = 0  # results found missing, to be reported with the next sample
        self._waiting: _Waiting | None = None
        self._rate = ResultRate(self._period_ns)

    @property
    @override
    def status(self) -> PipelineStatus:
        return PipelineStatus(set_up_lost=self._rate.sign, clock_std_ns=self._clock.std_ns)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            self._decoder.expect(wire.awaited(data))
            self._rate.sent(data)
            return self._ended(host_ns) if wire.codes_of(data) & {wire.START, wire.STOP} else []
        if not data:
            return self._ended(host_ns)
        found = self._decoder.feed(data)
        out: Items = [DeviceEvent("reply", self._device, answer.hex()) for answer in found.answers]
        if found.skipped_bytes:
            out.append(self.skipped_bytes(found.skipped_bytes, "packet"))
        self._verdicts += [self._decoded + place for place in found.doubted]
        self._decoded += len(found.code)
        self._rate.received(len(found.code), host_ns, damaged=found.skipped_bytes > 0)
        if len(found.code):
            out += self._place(self._counted(found, host_ns), host_ns)
        return out

    def _counted(self, found: DecodedResults, host_ns: int) -> _Rows:
        """Count steps by the packets' numbers; after damaged bytes add the results that these bytes can have been."""
        step = found.step.copy()
        guessed = np.zeros(len(step), np.bool_)
        for i in np.flatnonzero(found.skipped):
            likely = (int(found.skipped[i]) + 2) // wire.RESULT_BYTES + 1  # results that the bytes can have been
            more = wire.NUMBERS * max(0, round((likely - int(step[i])) / wire.NUMBERS))
            if more and self._room(int(np.sum(step)), host_ns) >= more:
                step[i] += more
                guessed[i] = True
        return _Rows(found.code, found.updated, step, guessed)

    def _last_number(self, steps: int) -> int:
        """Return the number of a result `steps` samples after those counted so far."""
        waiting = 0 if self._waiting is None else sum(int(np.sum(part.step)) for part in self._waiting.parts)
        return self._number + waiting + steps

    def _room(self, steps: int, host_ns: int) -> int:
        """Return how many additional results are possible by the host's time."""
        excess = self._arrivals.late_ns(self._last_number(steps), host_ns)
        return 0 if excess is None else int(excess / self._period_ns + 1.5)

    def _place(self, rows: _Rows, host_ns: int) -> Items:
        """Return the samples of results, or hold the results if they are too late for their numbers."""
        if self._waiting is None:
            self._found_late += self._arrivals.turn(host_ns)
        number = self._last_number(int(np.sum(rows.step))) + self._found_late
        excess = self._arrivals.late_ns(number, host_ns)
        if self._waiting is not None:
            assert excess is not None
            self._waiting.add(rows, excess, host_ns, self._arrivals.guard_ns)
            if excess <= self._arrivals.far_ns:
                return self._release(0, host_ns)
            if self._waiting.count > _MAX_WAIT_ROWS:
                return self._release(0, host_ns, late=True)
            if self._waiting.over(host_ns):
                return self._release(self._arrivals.missing(self._waiting.excess_ns), host_ns)
            return []
        if excess is None or excess <= self._arrivals.far_ns:
            return self._hand_out(rows, host_ns)
        first = int(np.argmax(rows.step > 1))  # index of the first gap; 0 without a gap
        out = self._hand_out(rows.part(0, first), host_ns, late=True) if first else []
        self._waiting = _Waiting(rows.part(first, None), excess, host_ns)
        return out

    def _ended(self, host_ns: int) -> Items:
        """Return the held samples when no read may follow: after a gap, unless only one read was late.

        The lateness of a single read may be that of the host. The log ends, or a command may stop the stream: after a
        cable was unplugged for seconds, the set-up begins while the first results wait.
        """
        waiting = self._waiting
        if waiting is None:
            return []
        missing = self._arrivals.missing(waiting.excess_ns) if waiting.reads > 1 else 0
        return self._release(missing, host_ns, late=not missing)

    def _release(self, missing: int, host_ns: int, *, late: bool = False) -> Items:
        assert self._waiting is not None
        waiting, self._waiting = self._waiting, None
        return self._hand_out(waiting.rows(missing), host_ns, late=late)

    def _hand_out(self, rows: _Rows, host_ns: int, *, late: bool = False) -> Items:
        """Make the samples of results.

        Args:
            rows: the results.
            host_ns: host time of the read, ns since 1970.
            late: whether the time of the read does not show when the results were measured.
        """
        found_late, self._found_late = self._found_late, 0
        step = rows.step
        if self._given == 0:
            step[0] = 1
        if found_late:
            step = step.copy()
            step[0] += found_late
        number = self._number + np.cumsum(step)
        self._number = int(number[-1])
        if not late:
            self._arrivals.look(self._number, host_ns)
        time_ns = self._clock.map(number * self._period_ns, host_ns)
        out = self._gaps(rows, step, time_ns, found_late)
        displacement, valid = self._measure(rows)
        counter = number.astype(np.uint32)  # wraps
        flags = self._spikes.feed(np.where(valid, rows.code, _NO_READING), counter)
        self._doubt(flags)
        suspect = np.flatnonzero(flags)
        flags[~rows.updated] |= NOT_NEW
        device_ns = number * self._period_ns
        out.append(displacement_batch(self._channel, time_ns, number, device_ns, displacement, rows.code, flags))
        if len(suspect):
            out.append(self._suspects(suspect, time_ns))
        return out

    def _measure(self, rows: _Rows) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the displacement of the disk, m, NaN without a reading, and whether each result is a reading."""
        displacement = (wire.readings(rows.code, self._range_m, self._no_target) - 0.5 * self._range_m) * self._to_disk
        displacement[~rows.updated] = np.nan
        valid = np.isfinite(displacement)
        self.losses["invalid"] += len(valid) - int(np.count_nonzero(valid))
        return displacement, valid

    def _doubt(self, flags: NDArray[np.uint32]) -> None:
        """Write the verdicts on samples whose packets turned out to be too long into `flags`."""
        first = self._given
        self._given += len(flags)
        later: list[int] = []
        for place in self._verdicts:
            at = place + LOOK_AHEAD - first
            if at < len(flags):
                flags[at] |= channels.SUSPECT_BEFORE
            else:
                later.append(place)
        self._verdicts = later

    def _suspects(self, found: NDArray[np.intp], time_ns: NDArray[np.int64]) -> DeviceEvent:
        """Return the event about spikes and samples of too long packets; its time is that of the first of them."""
        self.losses["suspect"] += len(found)
        first_ns = int(time_ns[found[0]]) - LOOK_AHEAD * self._period_ns
        what = "a sample" if len(found) == 1 else f"{len(found)} samples"
        text = f"{what} marked as suspect: a jump for one sample, or a packet that was too long"
        return DeviceEvent("suspect", self._device, text, {"suspect": len(found), "time_ns": first_ns})

    def _gaps(self, rows: _Rows, step: NDArray[np.int64], time_ns: NDArray[np.int64], found_late: int) -> Items:
        """Return the gaps between rows. The time of a gap is that of the first sample after it."""
        out: Items = []
        number = self._number - int(np.sum(step))
        numbers = number + np.cumsum(step)
        for i in np.flatnonzero(step != 1):
            lost = int(step[i]) - 1
            facts = {"time_ns": int(time_ns[i]), "device_ticks": int(numbers[i]) * self._period_ns // TICK_NS}
            event = self.lost_samples(lost, lost * self._period_ns * 1e-9, **facts)
            text, facts = event.text, dict(event.facts)
            if rows.guessed[i] or (found_late and i == 0):
                facts["uncertain_samples"] = self._arrivals.uncertainty
                text = f"about {text}: known modulo 4, the rest by the host's time, ± {self._arrivals.uncertainty}"
            if found_late and i == 0:
                facts["found_late"] = found_late
                text += f"; {found_late} of them within the last {self._arrivals.since_s:.2f} s: the times since "
                text += "their loss are early by that"
            out.append(replace(event, text=text, facts=facts))
        return out
