"""optoNCDT bytes to displacement of the disk centre."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.clock import ClockMap, Unwrap, steps_from
from daq.errors import DeviceError
from daq.laser_blocks import CleanBlocks, may_begin_block, take_clean_blocks
from daq.laser_spikes import LOOK_AHEAD, SpikeWatch
from daq.laser_words import WordsTrial
from daq.protocols import optoncdt
from daq.stream_items import TX, Batch, Event
from rig_configs.schema import Laser

DEFAULT_WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")
_AGREE = 3  # rows in a row that make a new beat
_LONG_JUMP_TICKS = 100_000  # 1 s
_HELD_UP_TICKS = 3_000_000  # 30 s; a restart looks like such a gap in two of a thousand cases at most
_LATE_NS = 2_000_000_000  # by how much longer than on the host a gap may last on the sensor: bytes wait in buffers

Items = list[Batch | Event]
_Chain = list[tuple[NDArray[np.int64], NDArray[np.uint32]]]  # rows that continue one another: counter and ticks, words


class LaserPipeline:
    """optoNCDT bytes to displacement of the disk centre, with counted gaps.

    Raises:
        DeviceError: the identity's range or words are none.
    """

    def __init__(self, device: str, config: Laser, channel: channels.Channel, identity: Mapping[str, Any]) -> None:
        self.losses = {"samples": 0, "bytes": 0, "damaged": 0, "invalid": 0, "suspect": 0, "unusable": 0}
        self._device, self._channel = device, channel
        self._range_m = _range(device, identity.get("range_m", config.range_m))
        self._to_disk = 1.0 / config.lever_ratio
        words = _words(device, identity.get("words", DEFAULT_WORDS))
        self._decoder = optoncdt.StreamDecoder(words, heed_answers=True)
        self._places = optoncdt.places_of(words)
        self._trial: WordsTrial | None = None
        self._said = 0  # lines handed out that the decoder is still to come to
        self._useless_told = False
        self._tolerance_ppm = config.clock_tolerance_ppm
        self._nominal_ticks = 1.0 / (config.rate_Hz * optoncdt.TICK_S)
        self._joined = False
        self._tail = b""  # the beginning of a block whose rest has not come
        self._last_raw: NDArray[np.int64] | None = None  # counter and ticks of the last row that fitted, …
        self._last_host_ns = 0  # … and when it came
        self._doubtful: list[_Chain] = []  # rows that fit nowhere yet
        self._restart()

    def _restart(self) -> None:
        self._ticks = Unwrap(optoncdt.TIMESTAMP_WRAP)
        self._clock = ClockMap(self._tolerance_ppm)
        self._last_tick: int | None = None
        self._spikes = SpikeWatch()

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            return []
        data, self._tail = self._tail + data, b""
        clean = self._clean(data, host_ns)
        if clean is not None:
            return self._samples(clean, host_ns, gapless=True) if len(clean.code) else []
        out: Items = []
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
            self._trial = WordsTrial(self._decoder, found.told, self._follows)
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
        if places is None or self._trial is not None or self._last_raw is None or self._doubtful or not data:
            return None
        if not self._decoder.idle:
            return None
        last_counter, last_tick = self._last_raw.tolist()
        clean = take_clean_blocks(data, places, last_counter, last_tick, self._nominal_ticks)
        taken = len(clean.code)
        tail = data[3 * taken * places.words :]
        if len(tail) >= 3 * places.words or not may_begin_block(tail):
            return None
        self._tail = tail
        if taken:
            self._last_raw = np.array([clean.counter[-1], clean.ticks[-1]], np.int64)
            self._last_host_ns = host_ns
        return clean

    def _rows(self, values: NDArray[np.uint32], host_ns: int, out: Items) -> None:
        """Samples of rows of words."""
        if self._places is None:
            self.losses["unusable"] += len(values)
            if not self._useless_told:
                self._useless_told = True
                text = (f"the stream's words are {' '.join(self._decoder.words)}: no samples without distance, counter "
                        "and timestamp (OUTADD_RS422 COUNTER TIMESTAMP)")  # fmt: skip
                out.append(Event("words", self._device, text))
            return
        for restarted, rows in self._stretches(values, self._places, host_ns, out):
            if restarted:
                text = "counter and timestamp do not continue: the sensor restarted"
                out.append(Event("restart", self._device, text))
                self._restart()
            out += self._samples(_columns(rows, self._places), host_ns, gapless=False)

    def _stretches(
        self, values: NDArray[np.uint32], places: optoncdt.Places, host_ns: int, out: Items
    ) -> list[tuple[bool, NDArray[np.uint32]]]:
        """Rows that continue one another, each with whether it begins anew; lone rows that fit nowhere are dropped.

        The line has no checksum. Counter and timestamp must advance together, and by no more than the host's time
        allows; a row that disagrees with what came before it is damage, unless the rows after it agree with it: then
        the sensor has restarted, or this is the first of all, or a long gap is over. Until they have come it waits.
        A host that was held up reads full buffers late and what came after them at once: its time has no room for
        the gap between them, yet counter and timestamp advance together over it, which those of a restart do not.
        """
        _, counter, ticks = _columns(values, places)
        rows = np.column_stack([counter.astype(np.int64), ticks])
        if self._last_raw is not None and not self._doubtful:
            all_rows = np.concatenate([self._last_raw[None], rows])
            if bool(np.all(self._follows(all_rows[:-1], all_rows[1:]))):
                self._last_raw, self._last_host_ns = rows[-1], host_ns
                return [(False, values)]
        stretches: list[tuple[bool, list[NDArray[np.uint32]]]] = [(False, [])]
        dropped = 0
        for row, value in zip(rows, values, strict=True):
            last = self._last_raw
            if last is not None and self._follows(last, row):
                chain: _Chain = [(row, value)]
            else:
                chain = self._doubt(row, value)
                onward = last is not None and self._resumes(last, chain[0][0], host_ns)
                if len(chain) < (2 if onward or last is None else _AGREE):
                    if len(self._doubtful) > _AGREE:
                        dropped += len(self._doubtful.pop(0))
                    continue
                if not onward and last is not None and not self._goes_on(last, chain[0][0]):
                    stretches.append((True, []))
                self._doubtful = [other for other in self._doubtful if other is not chain]
            dropped += sum(map(len, self._doubtful))
            self._doubtful = []
            stretches[-1][1].extend(value for _, value in chain)
            self._last_raw, self._last_host_ns = row, host_ns
        if dropped:
            self.losses["damaged"] += dropped
            what = "a sample" if dropped == 1 else f"{dropped} samples"
            text = f"{what} whose counter and timestamp fit nowhere {'was' if dropped == 1 else 'were'} dropped"
            out.append(Event("damage", self._device, text, {"damaged": dropped}))
        return [(restarted, np.array(kept, np.uint32)) for restarted, kept in stretches if kept]

    def _doubt(self, row: NDArray[np.int64], value: NDArray[np.uint32]) -> _Chain:
        """Keep a row that does not follow what came before; returns the rows it goes on from, and itself."""
        chain = next((chain for chain in self._doubtful if self._follows(chain[-1][0], row)), None)
        if chain is None:
            chain = []
            self._doubtful.append(chain)
        chain.append((row, value))
        return chain

    def _follows(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> Any:
        """Whether counter and ticks advance together, by one sample or over a short gap; rows (…, 2)."""
        passed, fits = self._advance(before, after)
        return fits & (passed <= _LONG_JUMP_TICKS)

    def _resumes(self, before: NDArray[np.int64], after: NDArray[np.int64], host_ns: int) -> bool:
        """Whether counter and ticks advance together over a gap that the host's time has room for."""
        passed, fits = self._advance(before, after)
        room_ns = max(0, host_ns - self._last_host_ns) + _LATE_NS
        return bool(fits) and int(passed) * 10_000 <= room_ns

    def _goes_on(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> bool:
        """Whether counter and ticks advance together over a gap that no restart explains, whatever the host's time."""
        passed, fits = self._advance(before, after)
        return bool(fits) and int(passed) <= _HELD_UP_TICKS

    def _advance(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> tuple[Any, Any]:
        """Ticks passed, and whether the counter agrees, modulo both wraps; rows (…, 2)."""
        counts = (after[..., 0] - before[..., 0]) % optoncdt.COUNTER_WRAP
        passed = (after[..., 1] - before[..., 1]) % optoncdt.TIMESTAMP_WRAP
        # the counter alone may have wrapped several times in a long gap
        expected = counts * self._nominal_ticks
        around = optoncdt.COUNTER_WRAP * self._nominal_ticks
        off = np.abs((passed - expected + around / 2) % around - around / 2)
        ahead = (passed > 0.5 * self._nominal_ticks) & (passed < optoncdt.TIMESTAMP_WRAP // 2)
        return passed, ahead & (off <= 1e-3 * passed + 2)

    def _samples(self, rows: CleanBlocks, host_ns: int, *, gapless: bool) -> list[Batch | Event]:
        before = self._last_tick
        ticks = self._ticks.feed(rows.ticks)
        self._last_tick = int(ticks[-1])
        time_ns = self._clock.map(ticks * 10_000, host_ns)
        out = [] if gapless else self._gaps(before, ticks, time_ns)
        displacement = (optoncdt.metres(rows.code, self._range_m) - 0.5 * self._range_m) * self._to_disk
        self.losses["invalid"] += int(np.count_nonzero(np.isnan(displacement)))
        counter = rows.counter.astype(np.uint32)
        code = rows.code.astype(np.uint32)
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
        first_ns = int(time_ns[found[0]]) - round(LOOK_AHEAD * self._nominal_ticks) * 10_000
        what = "a sample jumps" if len(found) == 1 else f"{len(found)} samples jump"
        text = f"{what} out of the signal and is back at once: marked as suspect"
        return Event("suspect", self._device, text, {"suspect": len(found), "time_ns": first_ns})

    def _gaps(self, before: int | None, ticks: NDArray[np.int64], time_ns: NDArray[np.int64]) -> list[Batch | Event]:
        """Samples missing between rows; the timestamp tells, since the counter wraps within a minute.

        A gap's own time is that of the first sample after it.
        """
        first = int(ticks[0]) - round(self._nominal_ticks) if before is None else before
        steps = np.rint(steps_from(first, ticks) / self._nominal_ticks).astype(np.int64)
        out: list[Batch | Event] = []
        for i in np.flatnonzero(steps != 1):
            lost = int(steps[i]) - 1
            self.losses["samples"] += lost
            span = lost * self._nominal_ticks * optoncdt.TICK_S
            out.append(Event("gap", self._device, f"{lost} samples lost ({span * 1e3:.2f} ms)",
                             {"samples": lost, "span_s": span, "time_ns": int(time_ns[i]),
                              "device_ticks": int(ticks[i])}))  # fmt: skip
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


def _words(device: str, told: object) -> tuple[str, ...]:
    """The output words that a sensor, or a log, says its stream is made of."""
    if isinstance(told, list | tuple) and 0 < len(told) <= optoncdt.MOST_WORDS:
        words = tuple(word for word in told if isinstance(word, str))
        if len(words) == len(told):
            return words
    raise DeviceError(f"{device}: expected names of output words in its identity, got words {told!r:.80}")
