"""Simulated sensors on CAN behind an slcan adapter. cantools encodes their frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from typing_extensions import override

from daq.drivers.can_lines import Adapter
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.transports.can_frames import CanFrame, encode
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World
from rig_drivers.dbc.layouts import database
from rig_drivers.dbc.settings import CanSensors, LaserGroup, LaserSignal

_QUANTITY_S = 0.1  # period of messages without a displacement
_MOST_COUNT: int = 2**32
_FOREIGN = CanFrame(0x7E5, b"\x01\x02\x03")


@dataclass
class _Sender:
    """The sensor that sends one group of displacements.

    Attributes:
        counter: number of its next frame.
    """

    group: LaserGroup
    beams: list[Beam]
    counter: int

    @property
    def period_s(self) -> float:
        return 1.0 / self.group.lasers[0][0].rate_Hz


@dataclass
class _Messages:
    """cantools messages by name, with raw numbers for every signal."""

    by_name: Mapping[str, Any]
    fixed: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])

    def frame(self, name: str, raw: Mapping[str, Any], signals: tuple[str, ...]) -> CanFrame:
        """Return a frame with these raw numbers in which `signals` are present; all other signals are 0."""
        message = self.by_name[name]
        if name not in self.fixed:
            self.fixed[name] = {signal.name: 0 for signal in message.signals}
        values = {**self.fixed[name], **raw}
        for signal in signals:
            inner = message.get_signal_by_name(signal)
            while inner.multiplexer_signal is not None:
                values[inner.multiplexer_signal] = min(inner.multiplexer_ids)
                inner = message.get_signal_by_name(inner.multiplexer_signal)
        data = message.encode(values, scaling=False, strict=False)
        return CanFrame(message.frame_id, bytes(data), message.is_extended_frame)


class SimulatedCanSensors(FarEnd):
    """The sensors of one bus, and its adapter.

    Args:
        settings: table of the device in the rig file.
        senders: sensors with displacements.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the beams are blocked: displacements have the value without a reading"),
        "dropped": FaultKind("frames of displacements are not sent", 100, None, "how many", (0, 1e6)),
        "silent": FaultKind("the displacements are not sent; the bus carries other frames"),
        "foreign": FaultKind("another node sends frames that the DBC file does not describe"),
        "short": FaultKind("frames have one byte less than the DBC file states"),
    }

    def __init__(self, settings: CanSensors, senders: list[_Sender]) -> None:
        self._settings, self._senders = settings, senders
        self._messages = _Messages({message.name: message for message in database(settings.dbc_text).messages})
        self._adapter = Adapter()
        self._faults: dict[str, float] = dict.fromkeys(self.fault_kinds, 0)
        self._due_s, self._page = 0.0, 0

    @classmethod
    def of(cls, device: str, settings: CanSensors, world: World) -> SimulatedCanSensors:
        """Make the sensors of a simulated rig."""
        groups = settings.groups()
        senders: list[_Sender] = []
        for group in groups:
            name = device if len(groups) == 1 else f"{device} {group.message.name}"
            beams = [Beam.of(f"{device} {table.axis}", table, world) for table, _ in group.lasers]
            clock = world.clock(name)
            for beam in beams:
                beam.clock = clock
            senders.append(_Sender(group, beams, int(beams[0].rng.integers(0, _MOST_COUNT))))
        return cls(settings, senders)

    @override
    def receive(self, data: bytes, now_s: float) -> bytes:
        self._adapter.receive(data)
        return b""

    def sample(self, motion: MotionInterval) -> bytes:
        """Return the frames of an interval of motion in the order of their times."""
        frames = [frame for sender in self._senders for frame in self._displacements(sender, motion)]
        frames += self._quantities(float(motion.time_s[-1]))
        if self._faults["foreign"]:
            frames.append((float(motion.time_s[-1]), _FOREIGN))
        if not self._adapter.open:
            return b""
        return b"".join(encode(frame) for _, frame in sorted(frames, key=lambda timed: timed[0]))

    def _displacements(self, sender: _Sender, motion: MotionInterval) -> list[tuple[float, CanFrame]]:
        """Return the frames of a sensor with their rig times, s."""
        group, clock = sender.group, sender.beams[0].clock
        device_s = sender.beams[0].due(motion, sender.period_s) * sender.period_s
        if not len(device_s):
            return []
        readings = [beam.reading(motion, device_s) for beam in sender.beams]
        times = clock.rig_s(device_s)
        out: list[tuple[float, CanFrame]] = []
        for row, own_s in enumerate(device_s.tolist()):
            raw: dict[str, Any] = {
                table.signal: self._raw(group, table, float(reading[row]))
                for (table, _), reading in zip(group.lasers, readings, strict=True)
            }
            if group.counter is not None:
                raw[group.counter.name] = sender.counter % 2**group.counter.bits.length
            if group.timestamp is not None:
                raw[group.timestamp.name] = round(own_s * 1e9 / group.tick_ns) % 2**group.timestamp.bits.length
            sender.counter += 1
            if self._faults["dropped"] > 0:
                self._faults["dropped"] -= 1
            elif not self._faults["silent"]:
                frame = self._messages.frame(group.message.name, raw, (group.lasers[0][0].signal,))
                short = CanFrame(frame.arbitration_id, frame.data[:-1], frame.extended)
                out.append((float(times[row]), short if self._faults["short"] else frame))
        return out

    def _raw(self, group: LaserGroup, table: LaserSignal, reading_m: float) -> float:
        """Return the raw number of a reading; beyond the range that without a reading, if there is one."""
        layout = group.message.signals[table.signal]
        invalid = self._settings.invalid_raw(table.invalid, layout)
        half_m = 0.5 * table.range_m
        if invalid and (self._faults["blocked"] or abs(reading_m) > half_m):
            return invalid[0]
        sign = 1.0 if table.positive == "away" else -1.0
        value = table.middle + sign * min(max(reading_m, -half_m), half_m) / self._settings.unit_m(table, layout)
        raw = (value - layout.offset) / layout.scale
        if layout.is_float:
            return raw
        bits = layout.bits.length
        least, most = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if layout.signed else (0, 2**bits - 1)
        return min(max(round(raw), least), most)

    def _quantities(self, now_s: float) -> list[tuple[float, CanFrame]]:
        """Return the frames of further messages that are due: of each in turn one in which a signal is present."""
        if now_s < self._due_s:
            return []
        self._due_s, self._page = now_s + _QUANTITY_S, self._page + 1
        own = {sender.group.message.name for sender in self._senders}
        out: list[tuple[float, CanFrame]] = []
        for quantity in self._settings.quantities.values():
            names = tuple(quantity.fields.values())
            if quantity.message not in own:
                raw = {name: (self._page + place) % 2 for place, name in enumerate(names)}
                out.append((now_s, self._messages.frame(quantity.message, raw, (names[self._page % len(names)],))))
        return out

    @override
    def fail(self, what: str, value: Any) -> None:
        if what not in self._faults:
            super().fail(what, value)
        self._faults[what] = float(value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. The adapter is supplied by the host; after power-up the sensors count from 0."""
        super().power(on, now_s)
        if on:
            for sender in self._senders:
                sender.counter = 0
                for beam in sender.beams:
                    beam.power_up(now_s)
