"""Settings of a LabJack T4 or T7 in a rig file: the device, and a table for each of its inputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from daq.channels import Channel
from rig_basics.texts import number_of
from rig_configs.device import DeviceSettings, DisplacementTable
from rig_configs.roles import OtherQuantity, Role, RotorPhase
from rig_configs.table import Finite, NotNegative, Positive, RigTable
from rig_drivers.labjack import wire
from rig_drivers.labjack.scans import RANGES_V

Analogue = Annotated[str, Field(pattern=r"^AIN([0-9]|1[0-3])$")]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")]


def _known_range(range_V: float) -> float:
    if range_V not in RANGES_V:
        raise ValueError(f"expected one of {', '.join(map(str, RANGES_V))} V, got {range_V:g}")
    return range_V


RangeV = Annotated[float, AfterValidator(_known_range)]

MOST_SAMPLES_PER_S = 30_000
"""Samples of all inputs together that the reads by command carry, with as many again to catch up."""
_STATES = ("FIO", "EIO")


class AnalogueLaser(DisplacementTable):
    """A displacement sensor with an analogue voltage output.

    Attributes:
        input: analogue input to which it is connected, single-ended.
        near_V, far_V: output at the near end and at the far end of its measuring range, V. Displacement grows with the
            distance.
        range_V: range of the input, V; a T4 has 10 V only.
    """

    names_its_channel: ClassVar[bool] = True

    input: Analogue
    near_V: Finite = 0.0
    far_V: Finite = 10.0
    range_V: RangeV = 10.0

    @model_validator(mode="after")
    def _has_a_slope(self) -> AnalogueLaser:
        if self.near_V == self.far_V:
            raise ValueError(f"near_V and far_V: expected two voltages, got {self.near_V:g} twice")
        if max(abs(self.near_V), abs(self.far_V)) > self.range_V:
            raise ValueError(f"near_V and far_V: expected at most {self.range_V:g} V, the range of the input (range_V)")
        return self


class Tachometer(RigTable):
    """A pulse once per revolution.

    Attributes:
        input: an analogue input (AIN2), or a digital line (FIO0 … FIO7, EIO0 … EIO7; up to half a scan early or late).
        threshold_V: voltage at which the pulse marks the index; of an analogue input.
        hysteresis_V: the next pulse needs a voltage so far on the other side before it.
        edge: "rising" or "falling", at positive speed.
        range_V: range of the input, V; a T4 has 10 V only.
        index_angle_deg, index_angle_std_deg: see RotorPhase.
    """

    input: Annotated[str, Field(pattern=r"^(AIN([0-9]|1[0-3])|[FE]IO[0-7])$")]
    threshold_V: Finite = 2.5
    hysteresis_V: Positive = 0.5
    edge: Literal["rising", "falling"] = "rising"
    range_V: RangeV = 10.0
    index_angle_deg: Finite = 0.0
    index_angle_std_deg: NotNegative = 0.0

    @property
    def is_digital(self) -> bool:
        """Whether the input is a digital line."""
        return self.input[:3] in _STATES

    @property
    def bit(self) -> int:
        """Bit of a digital line in the state of its port."""
        return int(self.input[3:])

    @property
    def line(self) -> int:
        """Number of a digital line among all lines: FIO0 … FIO7 are 0 to 7, EIO0 … EIO7 8 to 15."""
        return 8 * _STATES.index(self.input[:3]) + self.bit


class AnalogueQuantity(RigTable):
    """Any other quantity with a voltage, such as an acceleration; it is recorded in the channel `analogue/NAME`.

    Attributes:
        input: analogue input.
        quantity: name of the recorded field, with its unit: "acceleration_m_per_s2".
        per_V: value of 1 V above zero_V, in that unit.
        zero_V: voltage of the value 0, V.
        range_V: range of the input, V; a T4 has 10 V only.
    """

    input: Analogue
    quantity: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,60}$")]
    per_V: Finite
    zero_V: Finite = 0.0
    range_V: RangeV = 10.0


class LabJack(DeviceSettings):
    """A LabJack T4 or T7 on Ethernet or WiFi. Its port is `socket://ADDRESS:502`.

    Attributes:
        scan_rate_Hz: scans per second. Each scan reads every input once, one after the other.
        clock_tolerance_ppm: standard uncertainty of the rate of its clock.
        lasers: displacement sensors by name.
        tacho: pulse once per revolution.
        others: other quantities by name.
        separator_counts: whether the number of skipped scans that the device reports contains the one for which the
            separator stands. Not verified: of this maker's U3 it does.
    """

    calibration: ClassVar[tuple[str, ...]] = ("lasers", "tacho", "others", "clock_tolerance_ppm")

    serial_limit: ClassVar[int | None] = 2**32

    scan_rate_Hz: Annotated[float, Field(ge=10, le=MOST_SAMPLES_PER_S)] = 4000.0
    clock_tolerance_ppm: Positive = 30.0
    lasers: dict[Name, AnalogueLaser] = Field(default_factory=dict[str, AnalogueLaser])
    tacho: Tachometer | None = None
    others: dict[Name, AnalogueQuantity] = Field(default_factory=dict[str, AnalogueQuantity])
    separator_counts: bool = True

    @field_validator("port")
    @classmethod
    def _is_no_second_port(cls, port: str) -> str:
        if port.endswith(":702"):
            raise ValueError("expected port 502, that of the commands; the stream is read by commands, not on port 702")
        return port

    @model_validator(mode="after")
    def _is_possible(self) -> LabJack:
        inputs = [table.input for table in self._tables]
        if not inputs:
            raise ValueError("expected at least one input: a table lasers.NAME, tacho or others.NAME")
        if twice := next((name for name in inputs if inputs.count(name) > 1), None):
            raise ValueError(f"input {twice} has two tables, expected one")
        samples = self.scan_rate_Hz * len(inputs)
        if samples > MOST_SAMPLES_PER_S:
            raise ValueError(
                f"{number_of(len(inputs), 'input')} at {self.scan_rate_Hz:g} Hz are {samples:.0f} samples a second, "
                f"expected at most {MOST_SAMPLES_PER_S}: "
                f"set scan_rate_Hz to {MOST_SAMPLES_PER_S / len(inputs):.0f} or less"
            )
        axes = [laser.topic for laser in self.lasers.values()]
        if len({*axes}) < len(axes):
            raise ValueError(f"two lasers have the same channel, expected one each: {', '.join(axes)}")
        return self

    @property
    def _tables(self) -> list[AnalogueLaser | AnalogueQuantity | Tachometer]:
        return [*self.lasers.values(), *self.others.values(), *([self.tacho] if self.tacho else [])]

    @property
    def ranges_V(self) -> Mapping[str, float]:
        """Range of every analogue input, V, in the order of the scan list."""
        analogue = [t for t in self._tables if not (isinstance(t, Tachometer) and t.is_digital)]
        return {table.input: float(table.range_V) for table in analogue}

    @property
    def scan_list(self) -> tuple[int, ...]:
        """Addresses of the inputs in the order of a scan: lasers, other quantities, tachometer."""
        return tuple(_address(table.input) for table in self._tables)

    @property
    def read_period_s(self) -> float:
        """Time from one stream read to the next, s: a read is then half full."""
        inputs = len(self.scan_list)
        return 0.5 * wire.samples_per_read(inputs) / inputs / self.scan_rate_Hz

    def roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles; see DeviceSettings."""
        rate, tolerance = self.scan_rate_Hz, self.clock_tolerance_ppm
        lasers = [laser.sensor(device, rate, tolerance) for laser in self.lasers.values()]
        others = [
            OtherQuantity(device, other_channel(name, each).topic, (each.quantity,))
            for name, each in self.others.items()
        ]
        if self.tacho is None:
            return (*lasers, *others)
        angle, std = self.tacho.index_angle_deg, self.tacho.index_angle_std_deg
        return (*lasers, RotorPhase(device, "tacho", angle, tolerance, std), *others)


def other_channel(name: str, other: AnalogueQuantity) -> Channel:
    """Return the channel of another quantity from the name of its table."""
    return Channel(f"analogue/{name}", f"rig.Analogue_{name}", ((other.quantity, "double"), ("scan", "fixed32")))


def _address(name: str) -> int:
    return 2 * int(name[3:]) if name.startswith("AIN") else wire.Register.LINE_STATES + _STATES.index(name[:3])
