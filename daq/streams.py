"""One pipeline per device: bytes in, samples and events out.

Live recording and replay run the same object on the same bytes with the same host times, so decoding a log's raw
bytes again gives its decoded channels bit for bit. A pipeline does no I/O and reads no clock.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.clock import ClockMap, Unwrap
from daq.protocols import cia402, optoncdt, rotorlink, slcan
from rig_configs.schema import Devices, Drive, EncoderNode, Laser

RX, TX = 0, 1
_AGREE = 3  # rows in a row that make a new beat
_LONG_JUMP_TICKS = 100_000  # 1 s
DEFAULT_WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")


@dataclass(frozen=True)
class Batch:
    """Samples of one channel from one read.

    Attributes:
        channel: the log channel.
        time_ns: sample times on the common clock, int64, shape (n,).
        sequence: device counters, uint32, shape (n,).
        columns: the channel's fields, each of shape (n,).
    """

    channel: channels.Channel
    time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    columns: Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Event:
    """Something that happened on a device: a gap, a released lock, an answer, damage.

    Attributes:
        kind: "gap", "damage", "restart", "lock", "acknowledge", "reply", "status", "emergency", "drive", "fault".
        facts: numbers and words that go into the log with it.
    """

    kind: str
    device: str
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)


class Pipeline(Protocol):
    """What turns one device's bytes into samples."""

    losses: dict[str, int]

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """Take one read (RX) or one write (TX) with the host time it happened."""
        ...


def make_pipelines(devices: Devices, identities: Mapping[str, Mapping[str, Any]]) -> dict[str, Pipeline]:
    """Fresh pipelines for all devices of a rig.

    Args:
        identities: what each device said of itself when it was opened ("words" of a laser, for instance).
    """
    return {
        "laser_x": LaserPipeline("laser_x", devices.laser_x, channels.LASER_X, identities.get("laser_x", {})),
        "laser_y": LaserPipeline("laser_y", devices.laser_y, channels.LASER_Y, identities.get("laser_y", {})),
        "encoder": NodePipeline("encoder", devices.encoder),
        "drive": DrivePipeline("drive", devices.drive),
    }


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
                    out += self._samples(rows, host_ns)
        return out

    def _stretches(self, values: NDArray[np.uint32], out: list[Batch | Event]) -> list[tuple[bool, NDArray[np.uint32]]]:
        """Rows that continue one another, each with whether it begins anew; lone rows that fit nowhere are dropped.

        The line has no checksum. Counter and timestamp must advance together; a row that disagrees with what came
        before it is damage, unless the rows after it agree with it: then the sensor has restarted.
        """
        words = self._decoder.words
        counter = values[:, words.index("COUNTER")].astype(np.int64)
        ticks = optoncdt.timestamp_ticks(
            values[:, words.index("TIMESTAMP_LO")], values[:, words.index("TIMESTAMP_HI")]
        ).astype(np.int64)
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

    def _samples(self, values: NDArray[np.uint32], host_ns: int) -> list[Batch | Event]:
        words = self._decoder.words
        code = values[:, 0]
        counter_raw = values[:, words.index("COUNTER")]
        ticks_raw = optoncdt.timestamp_ticks(
            values[:, words.index("TIMESTAMP_LO")], values[:, words.index("TIMESTAMP_HI")]
        )
        out: list[Batch | Event] = []
        before = self._last_tick
        ticks = self._ticks.feed(ticks_raw)
        self._last_tick = int(ticks[-1])
        time_ns = self._clock.map(ticks * 10_000, host_ns)
        out += self._gaps(before, ticks)
        displacement = (optoncdt.metres(code, self._range_m) - 0.5 * self._range_m) * self._to_disk
        self.losses["invalid"] += int(np.count_nonzero(np.isnan(displacement)))
        columns = {
            "displacement_m": displacement,
            "code": code,
            "counter": counter_raw,
            "device_ticks": ticks.astype(np.uint64),
        }
        out.append(Batch(self._channel, time_ns, counter_raw.astype(np.uint32), columns))
        return out

    def _gaps(self, before: int | None, ticks: NDArray[np.int64]) -> list[Batch | Event]:
        """Samples missing between rows; the timestamp tells, since the counter wraps within a minute."""
        first = ticks[0] - self._nominal_ticks if before is None else before
        steps = np.rint(np.diff(ticks, prepend=first) / self._nominal_ticks).astype(np.int64)
        out: list[Batch | Event] = []
        for i in np.flatnonzero(steps != 1):
            lost = int(steps[i]) - 1
            self.losses["samples"] += lost
            span = lost * self._nominal_ticks * optoncdt.TICK_S
            out.append(Event("gap", self._device, f"{lost} samples lost ({span * 1e3:.2f} ms)",
                             {"samples": lost, "span_s": span, "device_ticks": int(ticks[i])}))  # fmt: skip
        return out


class NodePipeline:
    """RotorLink bytes to pendulum angles, tachometer marks and lock events; losses on air and cable counted apart."""

    def __init__(self, device: str, config: EncoderNode) -> None:
        self.losses = {"radio_frames": 0, "cable_frames": 0, "damaged_frames": 0, "samples": 0}
        self._device = device
        self._counts_per_revolution = config.counts_per_revolution
        self._radian = 2 * math.pi / config.counts_per_revolution
        self._tolerance_ppm = config.clock_tolerance_ppm
        self._decoder = rotorlink.FrameDecoder()
        self._cable = rotorlink.SequenceCounter()
        self._joined = False
        self._restart()

    def _restart(self) -> None:
        self._air = rotorlink.SequenceCounter()
        self._time = Unwrap(2**32)
        self._clock = ClockMap(self._tolerance_ppm)
        self._next_index: int | None = None
        self._last_us: int | None = None

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """See Pipeline."""
        if direction == TX:
            return []
        found = self._decoder.feed(data)
        out: list[Batch | Event] = []
        bad = found.bad if self._joined else found.bad[1:]  # a log may begin in the middle of a frame
        self._joined |= bool(found.frames or found.bad)
        for reason, _ in bad:
            self.losses["damaged_frames"] += 1
            out.append(Event("damage", self._device, f"frame dropped: {reason}", {"reason": reason}))
        for frame in found.frames:
            if isinstance(frame, rotorlink.Wrapped):
                lost, repeated = self._cable.feed(frame.seq)
                self._count("cable_frames", lost, out)
                if frame.inner is not None and not repeated:
                    out += self._node_frame(frame.inner, host_ns)
            elif isinstance(frame, rotorlink.DongleStatus):
                lost, _ = self._cable.feed(frame.seq)
                self._count("cable_frames", lost, out)
            elif not isinstance(frame, rotorlink.Command | rotorlink.Ping):
                out += self._node_frame(frame, host_ns)
        return out

    def _count(self, what: str, lost: int, out: list[Batch | Event]) -> None:
        if lost:
            self.losses[what] += lost
            out.append(Event("gap", self._device, f"{lost} {what.replace('_', ' ')} lost", {what: lost}))

    def _node_frame(self, frame: rotorlink.NodeFrame, host_ns: int) -> list[Batch | Event]:
        out: list[Batch | Event] = []
        restarts = self._air.restarts
        stepped_back = self._time_stepped_back(getattr(frame, "node_time_us", None))
        lost, repeated = (0, False) if stepped_back else self._air.feed(frame.seq)
        if repeated:
            return out
        if stepped_back or self._air.restarts > restarts:
            out.append(Event("restart", self._device, "the node started again: its counters begin anew"))
            self._restart()
            self._air.feed(frame.seq)
            self._time_stepped_back(getattr(frame, "node_time_us", None))
        self._count("radio_frames", lost, out)
        match frame:
            case rotorlink.EncoderBlock():
                out += self._encoder(frame, host_ns)
            case rotorlink.IndexMark():
                node_us = self._time.feed(np.array([frame.node_time_us]))
                time_ns = self._clock.map(node_us * 1000, host_ns)
                columns = {"revolutions": np.array([frame.revolutions]), "node_time_us": node_us.astype(np.uint64)}
                out.append(Batch(channels.TACHO, time_ns, np.array([frame.seq], np.uint32), columns))
            case rotorlink.LockEvent():
                node_us = self._time.feed(np.array([frame.node_time_us]))
                name, state = "AB"[frame.pendulum & 1], rotorlink.LOCK_STATES[min(frame.state, 3)]
                out.append(Event("lock", self._device, f"pendulum {name} {state}",
                                 {"pendulum": frame.pendulum, "state": state, "node_time_us": int(node_us[0]),
                                  "time_ns": int(self._clock.map(node_us * 1000, host_ns)[0])}))  # fmt: skip
            case rotorlink.Acknowledge():
                result = rotorlink.RESULTS[min(frame.result, len(rotorlink.RESULTS) - 1)]
                out.append(Event("acknowledge", self._device, f"command {frame.command_seq}: {result}",
                                 {"command_seq": frame.command_seq, "result": frame.result}))  # fmt: skip
            case rotorlink.Status():
                if frame.counts_per_revolution != self._counts_per_revolution:
                    text = (
                        f"the node says {frame.counts_per_revolution} counts per revolution, the rig file "
                        f"{self._counts_per_revolution}: every angle would be scaled wrongly. Correct the rig file"
                    )
                    out.append(Event("fault", self._device, text))
                out.append(Event("status", self._device, f"battery {frame.battery_mv} mV",
                                 {"battery_mv": frame.battery_mv, "frames_sent": frame.frames_sent,
                                  "overruns": frame.overruns, "counts_per_revolution": frame.counts_per_revolution,
                                  "temperature_degC": frame.temperature_decidegc / 10}))  # fmt: skip
            case _:
                pass
        return out

    def _time_stepped_back(self, node_time_us: int | None) -> bool:
        """Whether a frame's node time lies well before the last one's (frames on air keep their order)."""
        if node_time_us is None:
            return False
        back = 0 if self._last_us is None else (self._last_us - node_time_us) & 0xFFFFFFFF
        stepped = 1_000_000 < back < 0x80000000
        if not stepped and (self._last_us is None or back > 0x80000000):
            self._last_us = node_time_us
        return stepped

    def _encoder(self, block: rotorlink.EncoderBlock, host_ns: int) -> list[Batch | Event]:
        out: list[Batch | Event] = []
        n = len(block.counts)
        index = block.first_index + np.arange(n, dtype=np.int64)
        first_us = self._time.feed(np.array([block.node_time_us]))[0]
        node_us = first_us + block.period_us * np.arange(n, dtype=np.int64)
        fresh = 0 if self._next_index is None else max(0, self._next_index - block.first_index)
        if self._next_index is not None and block.first_index > self._next_index:
            missing = block.first_index - self._next_index
            self.losses["samples"] += missing
            out.append(Event("gap", self._device, f"{missing} encoder samples lost",
                             {"samples": missing, "span_s": missing * block.period_us * 1e-6}))  # fmt: skip
        self._next_index = int(index[-1]) + 1 if self._next_index is None else max(self._next_index, int(index[-1]) + 1)
        if fresh >= n:
            return out
        counts = block.counts[fresh:]
        columns = {
            "theta3_rad": counts[:, 0] * self._radian,
            "theta4_rad": counts[:, 1] * self._radian,
            "count_a": counts[:, 0],
            "count_b": counts[:, 1],
            "index": index[fresh:].astype(np.uint32),
            "node_time_us": node_us[fresh:].astype(np.uint64),
            "flags": np.full(n - fresh, block.flags, np.uint32),
        }
        time_ns = self._clock.map(node_us[fresh:] * 1000, host_ns)
        out.append(Batch(channels.PENDULUMS, time_ns, columns["index"], columns))
        return out


class DrivePipeline:
    """slcan text to the drive's speed word, its state and its emergencies. A drive has no clock: host time counts."""

    def __init__(self, device: str, config: Drive) -> None:
        self.losses = {"damaged_lines": 0}
        self.frames: list[slcan.CanFrame] = []  # what the last feed found, for the host's own CANopen client
        self._device, self._node = device, config.node_id
        self._rx, self._tx = slcan.LineDecoder(), slcan.LineDecoder()
        self._joined = False
        self._target_rpm = 0.0
        self._status: int | None = None

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """See Pipeline."""
        if direction == TX:
            for frame in self._tx.feed(data).frames:
                if frame.arbitration_id == cia402.cob_rpdo(1, self._node) and len(frame.data) == 4:
                    self._target_rpm = float(cia402.unpack_rpdo1(frame.data)[1])
            self.frames = []
            return []
        found = self._rx.feed(data)
        self.frames = found.frames
        out: list[Batch | Event] = []
        damaged = found.damaged if self._joined else max(0, found.damaged - 1)
        self._joined = True
        if damaged:
            self.losses["damaged_lines"] += damaged
            out.append(Event("damage", self._device, f"{damaged} damaged lines dropped", {"lines": damaged}))
        rows: list[tuple[int, int]] = []
        for frame in found.frames:
            if frame.arbitration_id == cia402.cob_tpdo(1, self._node) and len(frame.data) == 4:
                rows.append(cia402.unpack_tpdo1(frame.data))
            elif frame.arbitration_id == cia402.cob_emergency(self._node) and len(frame.data) == 8:
                emergency = cia402.unpack_emergency(frame.data)
                facts = {"error_code": emergency.error_code, "register": emergency.error_register}
                out.append(Event("emergency", self._device, f"drive error 0x{emergency.error_code:04X}", facts))
        if rows:
            out += self._speed(rows, host_ns)
        return out

    def _speed(self, rows: list[tuple[int, int]], host_ns: int) -> list[Batch | Event]:
        out: list[Batch | Event] = []
        status = np.array([r[0] for r in rows], np.uint32)
        for word in status:
            if self._status is None or cia402.state(int(word)) != cia402.state(self._status):
                out.append(Event("drive", self._device, cia402.state(int(word)), {"statusword": int(word)}))
            self._status = int(word)
        columns = {
            "speed_rpm": np.array([r[1] for r in rows], float),
            "target_rpm": np.full(len(rows), self._target_rpm),
            "statusword": status,
        }
        time_ns = np.full(len(rows), host_ns, np.int64)
        out.append(Batch(channels.MOTOR, time_ns, np.zeros(len(rows), np.uint32), columns))
        return out
