"""Pipeline of an optoNCDT sensor: bytes to displacement of the disk centre."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.clock import ClockMap, ClockSeed, Unwrap, steps_from
from daq.drivers.optoncdt import distance_words, sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.blocks import CleanBlocks, may_begin_block, measure, take_clean_blocks
from daq.drivers.optoncdt.rows import RowOrder
from daq.drivers.optoncdt.set_up_watch import SetUpWatch
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.words import WordsTrial
from daq.drivers.spikes import LOOK_AHEAD, SpikeWatch
from daq.errors import DeviceError
from daq.items import TX, Batch, DeviceEvent
from rig_basics.texts import number_of

DEFAULT_WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")
_MIN_RATE_DEVIATION = 2e-3  # relative deviation of the rate that is reported; a smaller one needs the host's clock

_MOST_BEFORE_FIRST = 1024  # bytes before the first block that are not counted; a block has at most 96

_MOST_CODES = 32  # different error codes that are counted

_SHORT_TIMESTAMP = (
    "expected a timestamp of two values in steps of 10 µs; by its manual an ILD2300 sends one value in steps of 256 µs "
    "on its serial line, which gives no times of samples. Connect it by Ethernet and use the driver optoncdt_ethernet. "
    "If its firmware sends two values, low half first, set devices.{device}.words, in stream order"
)

Items = list[Batch | DeviceEvent]


class LaserPipeline:
    """Decoder of optoNCDT bytes to displacement of the disk centre, with counted gaps.

    Attributes:
        error_codes: number of samples so far with each error code in place of a distance, of the first 32 codes.
        has_reported: see DescribesItself.

    Raises:
        DeviceError: range, scaling or words of the identity are invalid.
    """

    def __init__(self, device: str, config: Laser, channel: channels.Channel, identity: Mapping[str, Any]) -> None:
        kinds = ("samples", "bytes", "damaged", "invalid", "suspect", "unusable")
        self.losses: dict[str, int] = dict.fromkeys(kinds, 0)
        self.error_codes: dict[int, int] = {}
        self.has_reported: bool = True
        self._may_be_short = distance_words.model_of(str(identity.get("name", ""))) in distance_words.SHORT_TIMESTAMP
        self._device, self._channel = device, channel
        self._range_m = _range(device, identity.get("range_m", config.range_m))
        usual = config.scaling or distance_words.USUAL_SCALING  # of a sensor that was not queried
        self._scaling = _scaling(device, identity.get("scaling", usual))
        self._to_disk = 1.0 / config.lever_ratio
        words = _words(device, identity.get("words", config.output_words or DEFAULT_WORDS))
        self._decoder = optoncdt.BlockDecoder(words, follow_answers=True)
        self._places = sensor_answers.places_of(words)
        self._trial: WordsTrial | None = None
        self._reported_lines = 0  # lines already reported that the decoder has not reached yet
        self._unusable_reported = False
        self._tolerance_ppm = config.clock_tolerance_ppm
        self._nominal_ticks = 1.0 / (config.rate_Hz * optoncdt.TICK_S)
        self._joined = False
        self._before_first = 0  # bytes skipped before the first block
        self._tail = b""  # the beginning of an incomplete block
        self._order = RowOrder(self._nominal_ticks)
        self._reported_period = self._nominal_ticks
        self._set_up = SetUpWatch()
        self._restart()
        self._clock = ClockMap(self._tolerance_ppm, ClockSeed.of(identity))

    @property
    def complaint(self) -> str:
        """See DescribesItself: why there is no sample yet from a model whose timestamp may be one value."""
        return _SHORT_TIMESTAMP.format(device=self._device) if self._may_be_short and not self._joined else ""

    @property
    def set_up_lost(self) -> str:
        """See NoticesLostSetUp."""
        return self._set_up.lost

    @set_up_lost.setter
    def set_up_lost(self, sign: str) -> None:
        self._set_up.lost = sign

    @property
    def clock_std_ns(self) -> float:
        """See StatesClockError."""
        return self._clock.std_ns

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See HasClockSeed."""
        return self._clock.seed(round(optoncdt.TIMESTAMP_WRAP * optoncdt.TICK_S * 1e9))

    def _restart(self) -> None:
        self._ticks = Unwrap(optoncdt.TIMESTAMP_WRAP)
        self._clock = ClockMap(self._tolerance_ppm)
        self._last: tuple[int, int] | None = None  # counter, and unwrapped ticks
        self._spikes = SpikeWatch(self._scaling.most)

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            self._set_up.sent(data)
            return []
        out = self._received(data, host_ns)
        self._set_up.received(data, out, host_ns)
        return out

    def _received(self, data: bytes, host_ns: int) -> Items:
        data, self._tail = self._tail + data, b""
        clean = self._clean(data, host_ns)
        if clean is not None:
            out: Items = self._samples(clean, host_ns, gapless=True) if len(clean.code) else []
            if self._order.period_ticks != self._reported_period:
                self._report_rate(out)
            return out
        out = []
        while data:
            data = self._decode(data, host_ns, out) if self._trial is None else self._try(data, host_ns, out)
        return out

    def _decode(self, data: bytes, host_ns: int, out: Items) -> bytes:
        """Decode bytes with the present words; return those after an answer that announces other words."""
        found = self._decoder.feed(data)
        self._report_lines(found.text, out)
        skipped = found.skipped_bytes
        if not self._joined:
            skipped += self._counted_before_first(found.skipped_first, out) - found.skipped_first
        if skipped:
            self.losses["bytes"] += skipped
            text = f"{number_of(skipped, 'byte')} skipped to find the next block"
            out.append(DeviceEvent("damage", self._device, text, {"bytes": skipped}))
        if len(found.values):
            self._joined = True
            self._rows(found.values, host_ns, out)
        if found.announced is not None:
            self._trial = WordsTrial(self._decoder, found.announced, self._order.follows)
        self._decoder.follow_answers = True
        return found.rest

    def _counted_before_first(self, skipped: int, out: Items) -> int:
        """Return how many bytes count as lost after further bytes were skipped before the first block.

        The rest of a block in which the stream was joined does not count. Many bytes are another stream.
        """
        before, self._before_first = self._before_first, self._before_first + skipped
        if self._before_first <= _MOST_BEFORE_FIRST:
            return 0
        if before > _MOST_BEFORE_FIRST:
            return skipped
        words = " ".join(self._decoder.words)
        text = (
            f"{number_of(self._before_first, 'byte')} without a block of the words {words}: the sensor sends "
            f"other words, or the "
            "line has another baud rate"
        )
        out.append(DeviceEvent("words", self._device, text))
        return self._before_first

    def _try(self, data: bytes, host_ns: int, out: Items) -> bytes:
        """Continue the decision about the words; after it decode the held bytes. Return the bytes that follow."""
        assert self._trial is not None
        decided, lines, rest = self._trial.feed(data)
        self._report_lines(lines, out)
        self._reported_lines += len(lines)
        if decided is None:
            return b""
        words, held, self._trial = self._trial.announced, self._trial.held, None
        self._decoder.follow_answers = False  # the decision has taken the answers in the held bytes into account
        if decided and words != self._decoder.words:
            text = f"from here on the stream's words are {' '.join(words)}, no longer {' '.join(self._decoder.words)}"
            out.append(DeviceEvent("words", self._device, text))
            self._decoder.set_words(words)
            self._places, self._unusable_reported = sensor_answers.places_of(words), False
        elif not decided:
            text = f"an answer announces the words {' '.join(words)}, the stream does not consist of them: ignored"
            out.append(DeviceEvent("words", self._device, text))
        return self._decode(held, host_ns, out) + rest  # answers in the bytes that follow count again

    def _report_lines(self, lines: Sequence[str], out: Items) -> None:
        """Append an event for each line that has not been reported yet."""
        before = min(self._reported_lines, len(lines))
        self._reported_lines -= before
        out += [DeviceEvent("reply", self._device, line) for line in lines[before:]]

    def _clean(self, data: bytes, host_ns: int) -> CleanBlocks | None:
        """Decode all of `data` if it continues without damage; an incomplete block at its end is kept."""
        places = self._places
        if places is None or self._trial is not None or self._order.in_doubt or not data:
            return None
        if not self._decoder.idle:
            return None
        assert self._order.last is not None
        last_counter, last_tick = self._order.last.tolist()
        clean = take_clean_blocks(data, places, last_counter, last_tick, self._order.period_ticks)
        taken = len(clean.code)
        tail = data[3 * taken * places.words :]
        if len(tail) >= 3 * places.words or not may_begin_block(tail):
            return None
        self._tail = tail
        if taken:
            self._order.go_on(int(clean.counter[-1]), int(clean.ticks[-1]), host_ns)
        return clean

    def _rows(self, values: NDArray[np.uint32], host_ns: int, out: Items) -> None:
        """Append the samples of rows of words, and the events about them."""
        if self._places is None:
            self.losses["unusable"] += len(values)
            if not self._unusable_reported:
                self._unusable_reported = True
                text = (
                    f"the stream's words are {' '.join(self._decoder.words)}: no samples without distance, counter "
                    "and timestamp (OUTADD_RS422 COUNTER TIMESTAMP)"
                )
                out.append(DeviceEvent("words", self._device, text))
            return
        _, counter, ticks = _columns(values, self._places)
        found = self._order.sort(np.column_stack([counter.astype(np.int64), ticks]), values, host_ns)
        if found.dropped:
            self.losses["damaged"] += found.dropped
            what = "a sample" if found.dropped == 1 else f"{found.dropped} samples"
            text = f"{what} whose counter and timestamp do not fit {'was' if found.dropped == 1 else 'were'} dropped"
            out.append(DeviceEvent("damage", self._device, text, {"damaged": found.dropped}))
        self._report_rate(out)
        for restarted, rows in found.stretches:
            if restarted:
                text = "counter and timestamp do not continue: the sensor restarted"
                out.append(DeviceEvent("restart", self._device, text))
                self._restart()
            out += self._samples(_columns(rows, self._places), host_ns, gapless=False)

    def _report_rate(self, out: Items) -> None:
        """Append an event if the measuring rate differs from the rate reported last."""
        period = self._order.period_ticks
        if not self._order.is_period_measured or abs(period / self._reported_period - 1.0) < _MIN_RATE_DEVIATION:
            return
        self._reported_period = period
        rate, expected = 1.0 / (period * optoncdt.TICK_S), 1.0 / (self._nominal_ticks * optoncdt.TICK_S)
        text = f"the sensor measures {rate:.4g} times a second by its own clock, the rig file states {expected:g}"
        out.append(DeviceEvent("rate", self._device, text, {"rate_Hz": rate, "nominal_Hz": expected}))

    def _samples(self, rows: CleanBlocks, host_ns: int, *, gapless: bool) -> Items:
        before = self._last
        ticks = self._ticks.feed(rows.ticks)
        counter = np.ascontiguousarray(rows.counter, np.uint32)
        self._last = int(counter[-1]), int(ticks[-1])
        time_ns = self._clock.map(ticks * 10_000, host_ns)
        out = [] if gapless else self._gaps(before, counter, ticks, time_ns)
        code = np.ascontiguousarray(rows.code, np.uint32)
        displacement, invalid = measure(code, self._range_m, self._to_disk, self._scaling)
        self.losses["invalid"] += invalid
        if invalid:
            codes, counts = np.unique(code[np.isnan(displacement)], return_counts=True)
            for each, count in zip(codes.tolist(), counts.tolist(), strict=True):
                if each in self.error_codes or len(self.error_codes) < _MOST_CODES:  # garbage has any number of them
                    self.error_codes[each] = self.error_codes.get(each, 0) + count
        flags = self._spikes.feed(code, counter)
        columns = {
            "displacement_m": displacement,
            "code": code,
            "counter": counter,
            "device_ticks": ticks.astype(np.uint64),
            "flags": flags,
        }
        out.append(Batch(self._channel, time_ns, counter, columns))
        if self._spikes.found:
            out.append(self._suspects(flags, time_ns))
        return out

    def _suspects(self, flags: NDArray[np.uint32], time_ns: NDArray[np.int64]) -> DeviceEvent:
        """Return the event about samples that are spikes; its time is that of the first."""
        found = np.flatnonzero(flags)
        self.losses["suspect"] += len(found)
        first_ns = int(time_ns[found[0]]) - round(LOOK_AHEAD * self._order.period_ticks) * 10_000
        what = "a sample jumps" if len(found) == 1 else f"{len(found)} samples jump"
        text = f"{what} out of the signal for one sample: marked as suspect"
        return DeviceEvent("suspect", self._device, text, {"suspect": len(found), "time_ns": first_ns})

    def _gaps(
        self,
        before: tuple[int, int] | None,
        counter: NDArray[np.uint32],
        ticks: NDArray[np.int64],
        time_ns: NDArray[np.int64],
    ) -> Items:
        """Return the gaps between rows. The timestamp gives the number of wraps of the counter within a gap.

        The time of a gap is that of the first sample after it.
        """
        if before is None:
            before = int(counter[0]) - 1, int(ticks[0]) - round(self._order.period_ticks)
        counts = steps_from(before[0], counter.astype(np.int64)) % optoncdt.COUNTER_WRAP
        wraps = np.rint((steps_from(before[1], ticks) / self._order.period_ticks - counts) / optoncdt.COUNTER_WRAP)
        steps = counts + optoncdt.COUNTER_WRAP * wraps.astype(np.int64)
        out: list[Batch | DeviceEvent] = []
        for i in np.flatnonzero(steps != 1):
            lost = int(steps[i]) - 1
            self.losses["samples"] += lost
            span = lost * self._order.period_ticks * optoncdt.TICK_S
            out.append(
                DeviceEvent(
                    "gap",
                    self._device,
                    f"{number_of(lost, 'sample')} lost ({span * 1e3:.2f} ms)",
                    {"samples": lost, "span_s": span, "time_ns": int(time_ns[i]), "device_ticks": int(ticks[i])},
                )
            )
        return out


def _columns(values: NDArray[np.uint32], places: sensor_answers.WordPositions) -> CleanBlocks:
    """Return distance word, counter and timestamp of rows of words."""
    ticks = optoncdt.timestamp_ticks(values[:, places.low], values[:, places.high]).astype(np.int64)
    return CleanBlocks(values[:, places.distance], values[:, places.counter], ticks)


def _range(device: str, found: object) -> float:
    """Return the measuring range of an identity, m; raise DeviceError if it is invalid."""
    if isinstance(found, int | float) and not isinstance(found, bool) and math.isfinite(found) and found > 0:
        return float(found)
    raise DeviceError(f"{device}: expected a measuring range in m above 0 in its identity, got range_m {found!r:.80}")


def _scaling(device: str, found: object) -> distance_words.Scaling:
    """Return the scaling of an identity; raise DeviceError if it is unknown."""
    if isinstance(found, str) and found in distance_words.SCALINGS:
        return distance_words.SCALINGS[found]
    raise DeviceError(
        f"{device}: expected a scaling in its identity, one of {', '.join(distance_words.SCALINGS)}, got {found!r:.80}"
    )


def _words(device: str, found: object) -> tuple[str, ...]:
    """Return the output words of an identity; raise DeviceError if they are invalid."""
    items = cast("Sequence[object]", found) if isinstance(found, list | tuple) else ()
    if len(items) <= sensor_answers.MAX_WORDS:
        words = tuple(word for word in items if isinstance(word, str))
        if len({*words}) == len(items) and {*DEFAULT_WORDS} <= {*words}:
            return words
    raise DeviceError(
        f"{device}: expected the words of its stream in its identity, each once, {', '.join(DEFAULT_WORDS)} among "
        f"them, got words {found!r:.80}"
    )
