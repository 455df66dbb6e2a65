"""optoNCDT bytes to displacement of the disk centre."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.clock import ClockMap, ClockSeed, Unwrap, clock_rules, steps_from
from daq.drivers.items import TX, Batch, Event
from daq.drivers.optoncdt import wire as optoncdt
from daq.drivers.optoncdt.blocks import CleanBlocks, may_begin_block, measure, take_clean_blocks
from daq.drivers.optoncdt.rows import RowOrder
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.words import WordsTrial
from daq.drivers.spikes import LOOK_AHEAD, SpikeWatch
from daq.errors import DeviceError

DEFAULT_WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")
_TOLD_SHARE = 2e-3  # by which a rate differs when it is told; less is for who knows the host's clock

Items = list[Batch | Event]


class LaserPipeline:
    """optoNCDT bytes to displacement of the disk centre, with counted gaps.

    Raises:
        DeviceError: the identity's range, scaling or words are none.
    """

    def __init__(self, device: str, config: Laser, channel: channels.Channel, identity: Mapping[str, Any]) -> None:
        self.losses = {"samples": 0, "bytes": 0, "damaged": 0, "invalid": 0, "suspect": 0, "unusable": 0}
        self._device, self._channel = device, channel
        self._range_m = _range(device, identity.get("range_m", config.range_m))
        usual = config.scaling or optoncdt.USUAL_SCALING  # logs of earlier versions do not tell
        self._scaling = _scaling(device, identity.get("scaling", usual))
        self._to_disk = 1.0 / config.lever_ratio
        words = _words(device, identity.get("words", config.output_words or DEFAULT_WORDS))
        self._decoder = optoncdt.StreamDecoder(words, heed_answers=True)
        self._places = optoncdt.places_of(words)
        self._trial: WordsTrial | None = None
        self._said = 0  # lines handed out that the decoder is still to come to
        self._useless_told = False
        self._tolerance_ppm, self._rules = config.clock_tolerance_ppm, clock_rules(identity)
        self._nominal_ticks = 1.0 / (config.rate_Hz * optoncdt.TICK_S)
        self._joined = False
        self._tail = b""  # the beginning of a block whose rest has not come
        self._order = RowOrder(self._nominal_ticks)
        self._told_beat = self._nominal_ticks
        self._restart()
        self._clock = ClockMap(self._tolerance_ppm, self._rules, ClockSeed.of(identity))

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See KeepsTime."""
        return self._clock.seed(round(optoncdt.TIMESTAMP_WRAP * optoncdt.TICK_S * 1e9))

    def _restart(self) -> None:
        self._ticks = Unwrap(optoncdt.TIMESTAMP_WRAP)
        self._clock = ClockMap(self._tolerance_ppm, self._rules)
        self._last: tuple[int, int] | None = None  # counter and ticks, these unwrapped
        self._spikes = SpikeWatch(self._scaling.most)

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            return []
        data, self._tail = self._tail + data, b""
        clean = self._clean(data, host_ns)
        if clean is not None:
            out = self._samples(clean, host_ns, gapless=True) if len(clean.code) else []
            if self._order.beat != self._told_beat:
                self._tell_rate(out)
            return out
        out = []
        while data:
            data = self._decode(data, host_ns, out) if self._trial is None else self._try(data, host_ns, out)
        return out

    def _decode(self, data: bytes, host_ns: int, out: Items) -> bytes:
        """Take bytes by the words that hold; returns those behind an answer that tells of other words."""
        found = self._decoder.feed(data)
        self._say(found.text, out)
        skipped = found.skipped_bytes if self._joined else found.skipped_bytes - found.skipped_first
        if skipped:
            self.losses["bytes"] += skipped
            text = f"{skipped} bytes skipped to find the beat again"
            out.append(Event("damage", self._device, text, {"bytes": skipped}))
        if len(found.values):
            self._joined = True
            self._rows(found.values, host_ns, out)
        if found.told is not None:
            self._trial = WordsTrial(self._decoder, found.told, self._order.follows)
        self._decoder.heed_answers = True
        return found.rest

    def _try(self, data: bytes, host_ns: int, out: Items) -> bytes:
        """Let the stream decide which words it is made of, and decode by them what waited; returns what follows."""
        assert self._trial is not None
        decided, lines, rest = self._trial.feed(data)
        self._say(lines, out)
        self._said += len(lines)
        if decided is None:
            return b""
        told, held, self._trial = self._trial.told, self._trial.held, None
        self._decoder.heed_answers = False  # what was told meanwhile has been looked at
        if decided and told != self._decoder.words:
            text = f"from here on the stream's words are {' '.join(told)}, no longer {' '.join(self._decoder.words)}"
            out.append(Event("words", self._device, text))
            self._decoder.set_words(told)
            self._places, self._useless_told = optoncdt.places_of(told), False
        elif not decided:
            text = f"an answer tells of the words {' '.join(told)}, the stream is not made of them: ignored"
            out.append(Event("words", self._device, text))
        return self._decode(held, host_ns, out) + rest  # answers in what follows count again

    def _say(self, lines: Sequence[str], out: Items) -> None:
        before = min(self._said, len(lines))
        self._said -= before
        out += [Event("reply", self._device, line) for line in lines[before:]]

    def _clean(self, data: bytes, host_ns: int) -> CleanBlocks | None:
        """All of `data`, if it continues without any damage; the beginning of a block at its end waits for the rest."""
        places = self._places
        if places is None or self._trial is not None or self._order.in_doubt or not data:
            return None
        if not self._decoder.idle:
            return None
        assert self._order.last is not None
        last_counter, last_tick = self._order.last.tolist()
        clean = take_clean_blocks(data, places, last_counter, last_tick, self._order.beat)
        taken = len(clean.code)
        tail = data[3 * taken * places.words :]
        if len(tail) >= 3 * places.words or not may_begin_block(tail):
            return None
        self._tail = tail
        if taken:
            self._order.go_on(int(clean.counter[-1]), int(clean.ticks[-1]), host_ns)
        return clean

    def _rows(self, values: NDArray[np.uint32], host_ns: int, out: Items) -> None:
        """Samples of rows of words."""
        if self._places is None:
            self.losses["unusable"] += len(values)
            if not self._useless_told:
                self._useless_told = True
                text = (
                    f"the stream's words are {' '.join(self._decoder.words)}: no samples without distance, counter "
                    "and timestamp (OUTADD_RS422 COUNTER TIMESTAMP)"
                )
                out.append(Event("words", self._device, text))
            return
        _, counter, ticks = _columns(values, self._places)
        found = self._order.sort(np.column_stack([counter.astype(np.int64), ticks]), values, host_ns)
        if found.dropped:
            self.losses["damaged"] += found.dropped
            what = "a sample" if found.dropped == 1 else f"{found.dropped} samples"
            text = f"{what} whose counter and timestamp fit nowhere {'was' if found.dropped == 1 else 'were'} dropped"
            out.append(Event("damage", self._device, text, {"damaged": found.dropped}))
        self._tell_rate(out)
        for restarted, rows in found.stretches:
            if restarted:
                text = "counter and timestamp do not continue: the sensor restarted"
                out.append(Event("restart", self._device, text))
                self._restart()
            out += self._samples(_columns(rows, self._places), host_ns, gapless=False)

    def _tell_rate(self, out: Items) -> None:
        """An event when the sensor turns out to measure at another rate than was taken for it."""
        beat = self._order.beat
        if not self._order.knows_beat or abs(beat / self._told_beat - 1.0) < _TOLD_SHARE:
            return
        self._told_beat = beat
        rate, expected = 1.0 / (beat * optoncdt.TICK_S), 1.0 / (self._nominal_ticks * optoncdt.TICK_S)
        text = f"the sensor measures {rate:.4g} times a second by its own clock, the rig file says {expected:g}"
        out.append(Event("rate", self._device, text, {"rate_Hz": rate, "nominal_Hz": expected}))

    def _samples(self, rows: CleanBlocks, host_ns: int, *, gapless: bool) -> list[Batch | Event]:
        before = self._last
        ticks = self._ticks.feed(rows.ticks)
        counter = np.ascontiguousarray(rows.counter, np.uint32)
        self._last = int(counter[-1]), int(ticks[-1])
        time_ns = self._clock.map(ticks * 10_000, host_ns)
        out = [] if gapless else self._gaps(before, counter, ticks, time_ns)
        code = np.ascontiguousarray(rows.code, np.uint32)
        displacement, invalid = measure(code, self._range_m, self._to_disk, self._scaling)
        self.losses["invalid"] += invalid
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

    def _suspects(self, flags: NDArray[np.uint32], time_ns: NDArray[np.int64]) -> Event:
        """Samples that were lone spikes; the event's time is that of the first."""
        found = np.flatnonzero(flags)
        self.losses["suspect"] += len(found)
        first_ns = int(time_ns[found[0]]) - round(LOOK_AHEAD * self._order.beat) * 10_000
        what = "a sample jumps" if len(found) == 1 else f"{len(found)} samples jump"
        text = f"{what} out of the signal and is back at once: marked as suspect"
        return Event("suspect", self._device, text, {"suspect": len(found), "time_ns": first_ns})

    def _gaps(
        self,
        before: tuple[int, int] | None,
        counter: NDArray[np.uint32],
        ticks: NDArray[np.int64],
        time_ns: NDArray[np.int64],
    ) -> list[Batch | Event]:
        """Samples missing between rows: the counter says how many, the timestamp how often it wrapped meanwhile.

        A gap's own time is that of the first sample after it.
        """
        if before is None:
            before = int(counter[0]) - 1, int(ticks[0]) - round(self._order.beat)
        counts = steps_from(before[0], counter.astype(np.int64)) % optoncdt.COUNTER_WRAP
        wraps = np.rint((steps_from(before[1], ticks) / self._order.beat - counts) / optoncdt.COUNTER_WRAP)
        steps = counts + optoncdt.COUNTER_WRAP * wraps.astype(np.int64)
        out: list[Batch | Event] = []
        for i in np.flatnonzero(steps != 1):
            lost = int(steps[i]) - 1
            self.losses["samples"] += lost
            span = lost * self._order.beat * optoncdt.TICK_S
            out.append(
                Event(
                    "gap",
                    self._device,
                    f"{lost} samples lost ({span * 1e3:.2f} ms)",
                    {"samples": lost, "span_s": span, "time_ns": int(time_ns[i]), "device_ticks": int(ticks[i])},
                )
            )
        return out


def _columns(values: NDArray[np.uint32], places: optoncdt.Places) -> CleanBlocks:
    """Distance word, counter and timestamp of rows of words."""
    ticks = optoncdt.timestamp_ticks(values[:, places.low], values[:, places.high]).astype(np.int64)
    return CleanBlocks(values[:, places.distance], values[:, places.counter], ticks)


def _range(device: str, told: object) -> float:
    """The measuring range that a sensor, or a log, says it has."""
    if isinstance(told, int | float) and not isinstance(told, bool) and math.isfinite(told) and told > 0:
        return float(told)
    raise DeviceError(f"{device}: expected a measuring range in m above 0 in its identity, got range_m {told!r:.80}")


def _scaling(device: str, told: object) -> optoncdt.Scaling:
    """The scaling that a sensor, or a log, says it has."""
    if isinstance(told, str) and told in optoncdt.SCALINGS:
        return optoncdt.SCALINGS[told]
    raise DeviceError(
        f"{device}: expected a scaling in its identity, one of {', '.join(optoncdt.SCALINGS)}, got {told!r:.80}"
    )


def _words(device: str, told: object) -> tuple[str, ...]:
    """The output words that a sensor, or a log, says its stream is made of."""
    if isinstance(told, list | tuple) and 0 < len(told) <= optoncdt.MOST_WORDS:
        words = tuple(word for word in told if isinstance(word, str))
        if len({*words}) == len(told) and {*DEFAULT_WORDS} <= {*words}:
            return words
    raise DeviceError(
        f"{device}: expected the words of its stream in its identity, each once, {', '.join(DEFAULT_WORDS)} among "
        f"them, got words {told!r:.80}"
    )
