"""Settings of sensors on CAN in a rig file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator
from typing_extensions import override

from daq.channels import Channel
from rig_configs.device import DISPLACEMENT_CALIBRATION, DeviceSettings, SampledTable
from rig_configs.roles import Axis, OtherQuantity, Role
from rig_configs.table import Finite, NotNegative, Positive, RigTable
from rig_drivers.dbc import layouts
from rig_drivers.dbc.layouts import MessageLayout, SignalLayout

Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,127}$")]
FieldName = Annotated[str, Field(pattern=r"^[a-z][A-Za-z0-9_]{0,60}$")]
TableName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
Invalid = Annotated[tuple[str | int, ...], Field(strict=False, max_length=100)]

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
_LEAST_WRAP_S = 1.0
_FRAME_OVERHEAD_BITS = {False: 47, True: 67}
"""Bits of a data frame of classic CAN without its data and without stuffed bits: 11-bit and 29-bit identifiers."""


class LaserSignal(SampledTable):
    """A displacement in a message, in addition to the numbers of a SampledTable.

    Attributes:
        message, signal: names in the DBC file.
        middle: value of the signal in the middle of the range, in its unit.
        positive: direction in which its values grow: away from the sensor, or towards it.
        unit_m: unit of the signal, m; by default the unit in the DBC file.
        invalid: values without a reading: names of the DBC file's value table, or raw numbers.
        counter: signal of the same message that counts its frames; "" without one.
        timestamp: signal of the same message with the sensor's time; "" without one.
        timestamp_unit_s: unit of the timestamp, s; by default the unit in the DBC file.
    """

    message: Name
    signal: Name
    middle: Finite = 0.0
    positive: Literal["away", "towards"] = "away"
    unit_m: Positive | None = None
    invalid: Invalid = ()
    counter: Name | Literal[""] = ""
    timestamp: Name | Literal[""] = ""
    timestamp_unit_s: Positive | None = None


class SignalX(LaserSignal):
    """The displacement along x."""

    axis: Axis = "x"


class SignalY(LaserSignal):
    """The displacement along y."""

    axis: Axis = "y"


class Quantity(RigTable):
    """Further signals of one message, in the channel `can/NAME`. They are recorded, plotted and exported.

    Attributes:
        message: name in the DBC file.
        fields: names of the channel's fields, with their units, each with the name of its signal.
        invalid: see LaserSignal; for all signals.
        timeout_s: longest time between two messages, s; 0: any.
    """

    message: Name
    fields: Annotated[dict[FieldName, Name], Field(min_length=1, max_length=15)]
    invalid: Invalid = ()
    timeout_s: NotNegative = 0.0


@dataclass(frozen=True)
class LaserGroup:
    """Displacements that are in the same frames of one message, with their clock.

    Attributes:
        message: the message.
        lasers: table and signal of each displacement.
        counter, timestamp: signals, or None.
        tick_ns: unit of the timestamp's raw number, ns.
    """

    message: MessageLayout
    lasers: tuple[tuple[LaserSignal, SignalLayout], ...]
    counter: SignalLayout | None
    timestamp: SignalLayout | None
    tick_ns: float

    @property
    def has_clock(self) -> bool:
        """Whether its samples have a time or a number of the sensor."""
        return self.counter is not None or self.timestamp is not None


class CanSensors(DeviceSettings):
    """Sensors on one CAN bus behind one port, described by a DBC file.

    Attributes:
        bitrate: bit rate of the bus, bit/s.
        dbc: path of the DBC file, relative to the rig file.
        dbc_text: text of the DBC file, in place of its path; a log contains it.
        x, y: displacements.
        quantities: further signals, by the name of their channel.
        timeout_s: longest time without a frame of a displacement, s.
    """

    calibration: ClassVar[tuple[str, ...]] = tuple(
        f"{axis}.{name}" for axis in "xy" for name in (*DISPLACEMENT_CALIBRATION, "middle", "unit_m")
    )
    files: ClassVar[Mapping[str, str]] = {"dbc": "dbc_text"}

    bitrate: Literal[125_000, 250_000, 500_000, 1_000_000] = 500_000
    dbc: Annotated[str, Field(max_length=1000)] = ""
    dbc_text: Annotated[str, Field(max_length=layouts.MOST_TEXT)] = ""
    x: SignalX | None = None
    y: SignalY | None = None
    quantities: Annotated[dict[TableName, Quantity], Field(max_length=100)] = Field(default_factory=dict[str, Quantity])
    timeout_s: Positive = 1.0

    @property
    def lasers(self) -> tuple[LaserSignal, ...]:
        """Tables of the displacements."""
        return tuple(laser for laser in (self.x, self.y) if laser is not None)

    def groups(self) -> tuple[LaserGroup, ...]:
        """Return the displacements by the frames that contain them.

        Raises:
            ValueError: a message or signal that the DBC file does not have, or that cannot be used so.
        """
        found: dict[tuple[object, ...], list[tuple[LaserSignal, SignalLayout]]] = {}
        for laser in self.lasers:
            layout = self._signal(laser.message, laser.signal)
            found.setdefault((laser.message, layout.when), []).append((laser, layout))
        return tuple(self._group(lasers) for lasers in found.values())

    def message(self, name: str) -> MessageLayout:
        """Return a message of the DBC file."""
        return layouts.message(self.dbc_text, name)

    def invalid_raw(self, named: tuple[str | int, ...], signal: SignalLayout) -> tuple[int, ...]:
        """Return the raw numbers of a signal without a reading."""
        for name in named:
            if isinstance(name, str) and name not in signal.choices:
                raise ValueError(
                    f"invalid: signal {signal.name} has no value {name!r:.60} in the DBC file, only "
                    f"{', '.join(signal.choices) or 'numbers':.200}"
                )
        return tuple(signal.choices[name] if isinstance(name, str) else name for name in named)

    def unit_m(self, laser: LaserSignal, signal: SignalLayout) -> float:
        """Return the unit of a displacement, m."""
        unit_m = laser.unit_m or _METRES.get(signal.unit.strip())
        if unit_m is None:
            raise ValueError(f"signal {signal.name} has the unit {signal.unit!r:.20} in the DBC file: state unit_m")
        return unit_m

    @override
    def roles(self, device: str) -> tuple[Role, ...]:
        several = self.x is not None and self.y is not None and self.x.message != self.y.message
        sensors = [
            laser.sampled(device, laser.message if several and (laser.counter or laser.timestamp) else "")
            for laser in self.lasers
        ]
        others = [OtherQuantity(device, f"can/{name}", tuple(q.fields)) for name, q in self.quantities.items()]
        return (*sensors, *others)

    @model_validator(mode="after")
    def _fits_the_file(self) -> CanSensors:
        if not self.dbc_text:
            raise ValueError("expected a DBC file (dbc) or its text (dbc_text), got none")
        if not self.lasers and not self.quantities:
            raise ValueError("expected signals to record: tables x, y or quantities.NAME, got none")
        for axis, laser in (("x", self.x), ("y", self.y)):
            if laser is not None and laser.axis != axis:
                raise ValueError(f"{axis}.axis: expected {axis!r}, got {laser.axis!r}")
        bits_per_s = 0.0
        for group in self.groups():
            rate_Hz = group.lasers[0][0].rate_Hz
            bits_per_s += rate_Hz * (_FRAME_OVERHEAD_BITS[group.message.extended] + 8 * group.message.size)
        if bits_per_s > self.bitrate:
            raise ValueError(f"rate_Hz: the frames are {bits_per_s:.0f} bit/s, more than the bus carries (bitrate)")
        for quantity in self.quantities.values():
            for name in quantity.fields.values():
                self.invalid_raw(quantity.invalid, self._signal(quantity.message, name))
        return self

    def _signal(self, message: str, name: str) -> SignalLayout:
        signals = self.message(message).signals
        if name not in signals:
            raise ValueError(f"message {message} has no signal {name!r:.60}, only {', '.join(signals):.200}")
        return signals[name]

    def _group(self, lasers: list[tuple[LaserSignal, SignalLayout]]) -> LaserGroup:
        table, layout = lasers[0]
        for other, signal in lasers:
            self.invalid_raw(other.invalid, signal)
            self.unit_m(other, signal)
            for key in ("rate_Hz", "counter", "timestamp", "timestamp_unit_s", "clock_tolerance_ppm"):
                if getattr(other, key) != getattr(table, key):
                    raise ValueError(f"x and y are in the same frames: expected the same {key}, got different ones")
        counter = self._clock_signal(table.message, table.counter, layout) if table.counter else None
        if table.counter and counter is not None and (counter.scale, counter.offset) != (1.0, 0.0):
            raise ValueError(f"counter {counter.name}: expected scale 1 and offset 0")
        timestamp = self._clock_signal(table.message, table.timestamp, layout) if table.timestamp else None
        tick_ns = 0.0
        if timestamp is not None:
            unit_s = table.timestamp_unit_s or _SECONDS.get(timestamp.unit.strip())
            if unit_s is None:
                raise ValueError(f"signal {timestamp.name} has the unit {timestamp.unit!r:.20}: state timestamp_unit_s")
            tick_ns = 1e9 * unit_s * timestamp.scale
            if not 0 < tick_ns * table.rate_Hz <= 1e9 or tick_ns * 2.0**timestamp.bits.length < 1e9 * _LEAST_WRAP_S:
                raise ValueError(
                    f"timestamp {timestamp.name}: expected at least one unit between two samples, and more than "
                    f"{_LEAST_WRAP_S:g} s until it begins again"
                )
        return LaserGroup(self.message(table.message), tuple(lasers), counter, timestamp, tick_ns)

    def _clock_signal(self, message: str, name: str, laser: SignalLayout) -> SignalLayout:
        """Return a counter or timestamp, which must be a whole number in the same frames as the displacement."""
        found = self._signal(message, name)
        if found.is_float or found.signed or found.bits.length < 2:
            raise ValueError(f"signal {name}: expected a whole number of 2 bits or more without sign")
        if found.when and found.when != laser.when:
            raise ValueError(f"signal {name} is not in the same frames as {laser.name} (multiplexed otherwise)")
        if laser.when and not found.when:
            raise ValueError(
                f"signal {name} is in all frames, {laser.name} in some (multiplexed): it cannot be counted"
            )
        return found


def quantity_channel(name: str, quantity: Quantity) -> Channel:
    """Return the channel of a quantity from the name of its table."""
    return Channel(f"can/{name}", f"rig.Can_{name}", tuple((field, "double") for field in quantity.fields))
