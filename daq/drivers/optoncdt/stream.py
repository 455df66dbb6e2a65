"""Pipeline of an optoNCDT sensor: bytes to displacement of the disk centre."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq import channels
from daq.clock import ClockMap, ClockSeed, steps_from
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.drivers.displacement import displacement_batch, range_of
from daq.drivers.optoncdt import distance_words, sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.set_up_watch import SetUpWatch
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.true_rows import Rows, SampleTimes, TrueRows
from daq.drivers.optoncdt.words import WordsTrial
from daq.drivers.plain import TICK_NS
from daq.drivers.spikes import LOOK_AHEAD, SpikeWatch
from daq.errors import DeviceError
from daq.items import TX, Batch, DeviceEvent
from daq.numbered.messages import Count, Stretch
from daq.numbered.stream import NumberedStream
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


class LaserPipeline(Pipeline):
    """Decoder of optoNCDT bytes to displacement of the disk centre, with counted gaps.

    Attributes:
        error_codes: number of samples so far with each error code in place of a distance, of the first 32 codes.

    Raises:
        DeviceError: range, scaling or words of the identity are invalid.
    """

    def __init__(self, device: str, config: Laser, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "bytes", "damaged", "invalid", "suspect", "unusable")
        self.error_codes: dict[int, int] = {}
        self._may_be_short = distance_words.model_of(str(identity.get("name", ""))) in distance_words.SHORT_TIMESTAMP
        self._channel = channels.displacement_channel(config.topic)
        self._range_m = range_of(device, config, identity)
        usual = config.scaling or distance_words.USUAL_SCALING  # of a sensor that was not queried
        self._scaling = _scaling(device, identity.get("scaling", usual))
        self._to_disk = 1.0 / config.lever_ratio
        words = _words(device, identity.get("words", config.output_words or DEFAULT_WORDS))
        self._decoder = optoncdt.BlockDecoder(words, follow_answers=True)
        self._places = sensor_answers.places_of(words)
        self._trial: WordsTrial | None = None
        self._reported_lines = 0  # lines already reported that the decoder has not reached yet
        self._unusable_reported = False
        self._nominal_ticks = 1.0 / (config.rate_Hz * optoncdt.TICK_S)
        self._joined = False
        self._before_first = 0  # bytes skipped before the first block
        period_ns = self._nominal_ticks * TICK_NS
        wraps = optoncdt.COUNTER_WRAP, optoncdt.TIMESTAMP_WRAP
        count = Count(wraps[0], period_ns, clock_size=wraps[1], clock_step=self._nominal_ticks)
        self._numbered = NumberedStream[Rows](count, np.concatenate)
        self._true, self._times = TrueRows(self._nominal_ticks), SampleTimes()
        self._damaged = 0  # samples that were reported as damaged
        self._reported_period = self._nominal_ticks
        self._set_up = SetUpWatch()
        self._clock = ClockMap(config.clock_tolerance_ppm, ClockSeed.of(identity))
        self._place: int | None = None  # of the newest sample
        self._spikes = SpikeWatch(self._scaling.most)

    @property
    def status(self) -> PipelineStatus:
        """See Pipeline. There may be no sample yet because the model's timestamp is one value."""
        complaint = _SHORT_TIMESTAMP.format(device=self._device) if self._may_be_short and not self._joined else ""
        return PipelineStatus(
            complaint=complaint,
            set_up_lost=self._set_up.lost,
            clock_seed=self._clock.seed(optoncdt.TIMESTAMP_WRAP * TICK_NS),
            clock_std_ns=self._clock.std_ns,
        )

    def _restart(self) -> None:
        self._clock.restart()
        self._place = None
        self._spikes = SpikeWatch(self._scaling.most)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            self._set_up.sent(data)
            return []
        out: Items = []
        if not data:
            self._placed(self._numbered.end(), out)
        unread = data
        while unread:
            unread = self._decode(unread, host_ns, out) if self._trial is None else self._try(unread, host_ns, out)
        self._set_up.received(data, out, host_ns)
        return out

    def _decode(self, data: bytes, host_ns: int, out: Items) -> bytes:
        """Decode bytes with the present words; return those after an answer that announces other words."""
        found = self._decoder.feed(data)
        self._report_lines(found.text, out)
        skipped = found.skipped_bytes
        if not self._joined:
            skipped += self._counted_before_first(found.skipped_first, out) - found.skipped_first
        if skipped:
            out.append(self.skipped_bytes(skipped, "block"))
        if len(found.values):
            self._joined = True
            self._rows(found.values, host_ns, out)
        if found.announced is not None:
            self._trial = WordsTrial(self._decoder, found.announced)
        self._decoder.follow_answers = True
        return found.unread

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
        decided, lines, unread = self._trial.feed(data)
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
        return self._decode(held, host_ns, out) + unread  # answers in the bytes that follow count again

    def _report_lines(self, lines: Sequence[str], out: Items) -> None:
        """Append an event for each line that has not been reported yet."""
        before = min(self._reported_lines, len(lines))
        self._reported_lines -= before
        out += [DeviceEvent("reply", self._device, line) for line in lines[before:]]

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
        places = self._places
        ticks = optoncdt.timestamp_ticks(values[:, places.low], values[:, places.high])
        rows = np.column_stack([values[:, places.counter], ticks, values[:, places.distance]]).astype(np.int64)
        rows = self._true.feed(rows)
        self._report_damage(out)
        self._report_rate(out)
        if len(rows):
            self._placed(self._numbered.feed(rows[:, 0], rows, host_ns, rows[:, 1]), out)

    def _placed(self, stretches: Sequence[Stretch[Rows]], out: Items) -> None:
        """Append the samples that have a place in the sensor's count, and the events about them."""
        reads: list[Stretch[Rows]] = []  # stretches of one read have one time, that of its newest sample
        for stretch in stretches:
            if reads and not stretch.is_restart and stretch.host_ns == reads[-1].host_ns:
                numbers = np.concatenate([reads[-1].numbers, stretch.numbers])
                reads[-1] = replace(reads[-1], numbers=numbers, rows=np.concatenate([reads[-1].rows, stretch.rows]))
            else:
                reads.append(stretch)
        for stretch in reads:
            if stretch.is_restart:
                self._times.restart()
            ticks = self._times.feed(stretch.numbers, stretch.rows[:, 1], self._true)
            if stretch.is_restart or ticks is None:
                text = "counter and timestamp do not continue: the sensor restarted"
                out.append(DeviceEvent("restart", self._device, text))
                self._restart()
                self._true.measure_again()
            if ticks is None:
                self._times.restart()
                ticks = self._times.feed(stretch.numbers, stretch.rows[:, 1], self._true)
                assert ticks is not None
            out += self._samples(stretch.numbers, ticks, stretch.rows[:, 2], stretch.host_ns)

    def _report_damage(self, out: Items) -> None:
        """Append an event about samples that were dropped since the last one."""
        dropped = self._true.damaged - self._damaged
        if dropped:
            self._damaged += dropped
            what = "a sample" if dropped == 1 else f"{dropped} samples"
            text = f"{what} whose counter and timestamp do not fit {'was' if dropped == 1 else 'were'} dropped"
            out.append(self.damage("damaged", text, dropped, damaged=dropped))

    def _report_rate(self, out: Items) -> None:
        """Append an event if the measuring rate differs from the rate reported last."""
        period = self._true.period_ticks
        if not self._true.is_measured or abs(period / self._reported_period - 1.0) < _MIN_RATE_DEVIATION:
            return
        self._reported_period = period
        rate, expected = 1.0 / (period * optoncdt.TICK_S), 1.0 / (self._nominal_ticks * optoncdt.TICK_S)
        text = f"the sensor measures {rate:.4g} times a second by its own clock, the rig file states {expected:g}"
        out.append(DeviceEvent("rate", self._device, text, {"rate_Hz": rate, "nominal_Hz": expected}))

    def _samples(self, place: Rows, ticks: Rows, words: Rows, host_ns: int) -> Items:
        time_ns = self._clock.map(ticks * TICK_NS, host_ns)
        out = self._gaps(place, ticks, time_ns)
        self._place = int(place[-1])
        counter = (place % optoncdt.COUNTER_WRAP).astype(np.uint32)
        displacement = (
            distance_words.metres(words, self._range_m, self._scaling) - 0.5 * self._range_m
        ) * self._to_disk
        invalid: list[int] = words[words > self._scaling.most].tolist()
        self.losses["invalid"] += len(invalid)
        for each, count in Counter(invalid).items():
            if each in self.error_codes or len(self.error_codes) < _MOST_CODES:  # garbage has any number of them
                self.error_codes[each] = self.error_codes.get(each, 0) + count
        flags = self._spikes.feed(words, counter)
        batch = displacement_batch(self._channel, time_ns, counter, ticks * TICK_NS, displacement, words, flags)
        out.append(batch)
        if self._spikes.found:
            out.append(self._suspects(flags, time_ns))
        return out

    def _suspects(self, flags: NDArray[np.uint32], time_ns: NDArray[np.int64]) -> DeviceEvent:
        """Return the event about samples that are spikes; its time is that of the first."""
        found = np.flatnonzero(flags)
        self.losses["suspect"] += len(found)
        first_ns = int(time_ns[found[0]]) - round(LOOK_AHEAD * self._true.period_ticks) * TICK_NS
        what = "a sample jumps" if len(found) == 1 else f"{len(found)} samples jump"
        text = f"{what} out of the signal for one sample: marked as suspect"
        return DeviceEvent("suspect", self._device, text, {"suspect": len(found), "time_ns": first_ns})

    def _gaps(self, place: Rows, ticks: Rows, time_ns: Rows) -> Items:
        """Return the gaps between samples. The time of a gap is that of the first sample after it."""
        before = int(place[0]) - 1 if self._place is None else self._place
        steps = steps_from(before, place)
        out: Items = []
        for i in np.flatnonzero(steps != 1):
            lost = int(steps[i]) - 1
            period_s = self._true.period_ticks * optoncdt.TICK_S
            facts = {"time_ns": int(time_ns[i]), "device_ticks": int(ticks[i])}
            out.append(self.lost_samples(lost, lost * period_s, **facts))
        return out


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
