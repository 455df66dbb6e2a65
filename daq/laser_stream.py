"""optoNCDT bytes to displacement of the disk centre."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.clock import ClockMap, Unwrap, steps_from
from daq.laser_blocks import CleanBlocks, may_begin_block, take_clean_blocks
from daq.protocols import optoncdt
from daq.stream_items import TX, Batch, Event
from rig_configs.schema import Laser

DEFAULT_WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")
_AGREE = 3  # rows in a row that make a new beat
_LONG_JUMP_TICKS = 100_000  # 1 s


class LaserPipeline:
    """optoNCDT bytes to displacement of the disk centre, with counted gaps."""

    def __init__(self, device: str, config: Laser, channel: channels.Channel, identity: Mapping[str, Any]) -> None:
        self.losses = {"samples": 0, "bytes": 0, "damaged": 0, "invalid": 0}
        self._device, self._channel = device, channel
        self._range_m = float(identity.get("range_m", config.range_m))
        self._to_disk = 1.0 / config.lever_ratio
        self._decoder = optoncdt.StreamDecoder(tuple(identity.get("words", DEFAULT_WORDS)))
        self._tolerance_ppm = config.clock_tolerance_ppm
        self._nominal_ticks = 1.0 / (config.rate_Hz * optoncdt.TICK_S)
        self._joined = False
        self._tail = b""  # the beginning of a block whose rest has not come
        self._restart()

    def _restart(self) -> None:
        self._ticks = Unwrap(optoncdt.TIMESTAMP_WRAP)
        self._clock = ClockMap(self._tolerance_ppm)
        self._last_tick: int | None = None
        self._last_raw: NDArray[np.int64] | None = None

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """See Pipeline."""
        if direction == TX:
            return []
        data, self._tail = self._tail + data, b""
        clean = self._clean(data)
        if clean is not None:
            return self._samples(clean, host_ns, gapless=True) if len(clean.code) else []
        found = self._decoder.feed(data)
        out: list[Batch | Event] = [Event("reply", self._device, line) for line in found.text]
        for line in found.text:
            if line.upper().startswith("GETOUTINFO_RS422 "):
                self._decoder.set_words(optoncdt.parse_outinfo(line))
        if found.skipped_bytes and self._joined:
            self.losses["bytes"] += found.skipped_bytes
            out.append(
                Event("damage", self._device, f"{found.skipped_bytes} bytes skipped to find the beat again",
                      {"bytes": found.skipped_bytes})
            )  # fmt: skip
        if len(found.values):
            self._joined = True
            for restarted, rows in self._stretches(found.values, out):
                if restarted:
                    text = "counter and timestamp do not continue: the sensor restarted"
                    out.append(Event("restart", self._device, text))
                    self._restart()
                if len(rows):
                    out += self._samples(self._columns(rows), host_ns, gapless=False)
        return out

    def _clean(self, data: bytes) -> CleanBlocks | None:
        """All of `data`, if it continues without any damage; the beginning of a block at its end waits for the rest."""
        if self._last_raw is None or not self._decoder.idle or not data:
            return None
        last_counter, last_tick = self._last_raw.tolist()
        words = self._decoder.words
        clean = take_clean_blocks(data, words, last_counter, last_tick, self._nominal_ticks)
        taken = len(clean.code)
        tail = data[3 * taken * len(words) :]
        if len(tail) >= 3 * len(words) or not may_begin_block(tail):
            return None
        self._tail = tail
        if taken:
            self._last_raw = np.array([clean.counter[-1], clean.ticks[-1]], np.int64)
        return clean

    def _columns(self, values: NDArray[np.uint32]) -> CleanBlocks:
        """Distance word, counter and timestamp of rows of words."""
        words = self._decoder.words
        low, high = values[:, words.index("TIMESTAMP_LO")], values[:, words.index("TIMESTAMP_HI")]
        ticks = optoncdt.timestamp_ticks(low, high).astype(np.int64)
        return CleanBlocks(values[:, 0], values[:, words.index("COUNTER")], ticks)

    def _stretches(self, values: NDArray[np.uint32], out: list[Batch | Event]) -> list[tuple[bool, NDArray[np.uint32]]]:
        """Rows that continue one another, each with whether it begins anew; lone rows that fit nowhere are dropped.

        The line has no checksum. Counter and timestamp must advance together; a row that disagrees with what came
        before it is damage, unless the rows after it agree with it: then the sensor has restarted.
        """
        _, counter, ticks = self._columns(values)
        counter = counter.astype(np.int64)
        rows = np.column_stack([counter, ticks])
        previous = rows[:1] - [[1, round(self._nominal_ticks)]] if self._last_raw is None else self._last_raw[None]
        chain = np.concatenate([previous, rows])
        if bool(np.all(self._continues(chain[:-1], chain[1:]))):
            self._last_raw = rows[-1]
            return [(False, values)]
        stretches: list[tuple[bool, list[int]]] = [(False, [])]
        last = previous[0]
        for i in range(len(rows)):
            ahead = rows[i : i + _AGREE]
            if self._continues(last, rows[i]) and self._leads_on(last, rows, i):
                stretches[-1][1].append(i)
            elif self._is_new_beat(last, ahead):
                stretches.append((True, [i]))
            else:
                self.losses["damaged"] += 1
                out.append(
                    Event("damage", self._device, "a sample whose counter and timestamp fit nowhere was dropped")
                )
                continue
            last = rows[i]
        self._last_raw = last
        return [(restarted, values[kept]) for restarted, kept in stretches]

    def _is_new_beat(self, last: NDArray[np.int64], ahead: NDArray[np.int64]) -> bool:
        """Whether rows agree with one another and none of them with what came before."""
        return (
            len(ahead) == _AGREE
            and bool(np.all(self._continues(ahead[:-1], ahead[1:])))
            and not bool(np.any(self._continues(last, ahead[1:])))
        )

    def _leads_on(self, last: NDArray[np.int64], rows: NDArray[np.int64], i: int) -> bool:
        """Whether the next row confirms row i; without a next row, whether it is no long jump."""
        if i + 1 < len(rows):
            return bool(self._continues(rows[i], rows[i + 1])) or not bool(self._continues(last, rows[i + 1]))
        return int(rows[i, 1] - last[1]) % optoncdt.TIMESTAMP_WRAP < _LONG_JUMP_TICKS

    def _continues(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether counter and ticks advance together, modulo their wraps; rows (…, 2)."""
        counts = (after[..., 0] - before[..., 0]) % optoncdt.COUNTER_WRAP
        passed = (after[..., 1] - before[..., 1]) % optoncdt.TIMESTAMP_WRAP
        # the counter alone may have wrapped several times in a long gap
        expected = counts * self._nominal_ticks
        around = optoncdt.COUNTER_WRAP * self._nominal_ticks
        off = np.abs((passed - expected + around / 2) % around - around / 2)
        return (passed > 0) & (passed < optoncdt.TIMESTAMP_WRAP // 2) & (off <= 1e-3 * passed + 2)

    def _samples(self, rows: CleanBlocks, host_ns: int, *, gapless: bool) -> list[Batch | Event]:
        before = self._last_tick
        ticks = self._ticks.feed(rows.ticks)
        self._last_tick = int(ticks[-1])
        time_ns = self._clock.map(ticks * 10_000, host_ns)
        out = [] if gapless else self._gaps(before, ticks, time_ns)
        displacement = (optoncdt.metres(rows.code, self._range_m) - 0.5 * self._range_m) * self._to_disk
        self.losses["invalid"] += int(np.count_nonzero(np.isnan(displacement)))
        counter = rows.counter.astype(np.uint32)
        columns = {
            "displacement_m": displacement,
            "code": rows.code.astype(np.uint32),
            "counter": counter,
            "device_ticks": ticks.astype(np.uint64),
        }
        out.append(Batch(self._channel, time_ns, counter, columns))
        return out

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
