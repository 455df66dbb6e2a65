"""Settings of a frequency converter in a rig file."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, cast

from pydantic import Field, model_validator

from daq.drivers.motors import LINE_SHARE, MotorSettings, check_load
from rig_configs.table import Positive
from rig_drivers.modbus_converter.registers import TABLES, Registers, Unit, completed

_LONGEST_BLOCK = 16  # registers that some converters return at most
_EXCHANGE_BYTES = 8 + 5 + 7  # a read and its answer without the registers, with 3.5 characters of silence each


class ModbusConverter(MotorSettings):
    """A frequency converter with an induction or synchronous motor, by Modbus RTU.

    Attributes:
        table: register table by name, a key of `registers.TABLES`. "generic" is no real converter's.
        registers: entries that replace those of the table; see Registers.
        address: Modbus address of the converter.
        baud, parity, stop_bits: those of the line. The standard requires two stop bits without a parity bit.
        pole_pairs: pole pairs of the motor.
        gear: turns of the motor per turn of the rotor.
        max_Hz: highest output frequency set in the converter, Hz: the end of its ramps, and 100 % of a reference.
        slip: share by which the rotor is slower than the field at its usual load. The converter reports the field.
        quick_rpm_per_s: rate of a quick stop without a command of its own, rpm/s. A steeper one than the motor and its
            brake resistor sustain causes an over-voltage fault, and then the rotor runs down without torque.
        watchdog_s: time without a request after which the converter stops by itself, s.
        answer_s: longest time from a request to its answer, s.
        report_Hz: rate at which state and speed are read, Hz.
    """

    table: Literal["generic", "invt", "m-max", "altivar"] = "generic"
    registers: Registers = Registers()
    address: Annotated[int, Field(ge=1, le=247)] = 1
    baud: Annotated[int, Field(ge=1200, le=921_600)] = 19_200
    parity: Literal["N", "E", "O"] = "E"
    stop_bits: Literal[1, 2] = 1
    pole_pairs: Annotated[int, Field(ge=1, le=50)] = 2
    gear: Positive = 1.0
    max_Hz: Annotated[float, Field(gt=0, le=1000)] = 50.0
    slip: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    quick_rpm_per_s: Annotated[float, Field(gt=0, le=10_000)] = 1000.0
    watchdog_s: Annotated[float, Field(ge=0.2, le=5.0)] = 1.0
    answer_s: Annotated[float, Field(ge=0.02, le=0.15)] = 0.1
    report_Hz: Annotated[float, Field(ge=10, le=50)] = 20.0

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, given: Any) -> Any:
        """Put the entries of the named table where the rig file has none of its own."""
        if not isinstance(given, dict):
            return given
        whole = cast("dict[str, Any]", given)
        name, own = whole.get("table", "generic"), whole.get("registers", {})
        if name not in TABLES or not isinstance(own, dict):
            return whole
        return {**whole, "registers": completed(name, cast("dict[str, Any]", own))}

    @model_validator(mode="after")
    def _is_possible(self) -> ModbusConverter:
        if self.watchdog_s < 2 * self.answer_s + 1 / self.report_Hz:
            raise ValueError("watchdog_s must be above 2 answer_s + 1/report_Hz, or one lost answer stops the rig")
        bits = 9 + (self.parity != "N") + self.stop_bits
        needed = sum(_EXCHANGE_BYTES + 2 * count for _, count in self.blocks) * bits * self.report_Hz
        remedy = "reduce report_Hz, or raise baud here and in the converter"
        check_load(f"report_Hz = {self.report_Hz:g} needs", needed, "line", self.baud, LINE_SHARE, remedy)
        return self

    @property
    def blocks(self) -> tuple[tuple[int, int], ...]:
        """First register and number of registers of the reads of one report; the one with the speed is the last."""
        r = self.registers
        blocks: list[tuple[int, int]] = []
        wanted: set[int] = {r.status, r.speed} if r.fault_code is None else {r.status, r.speed, r.fault_code}
        for register in sorted(wanted):
            first, count = blocks[-1] if blocks else (-_LONGEST_BLOCK, 0)
            longest = _LONGEST_BLOCK if r.reads_gaps else count + 1
            if register - first < longest:
                blocks[-1] = first, register - first + 1
            else:
                blocks.append((register, 1))
        return tuple(sorted(blocks, key=lambda block: block[0] <= r.speed < sum(block)))

    def _rpm_per_unit(self, unit: Unit) -> float:
        """Speed of the rotor for one unit of a reference or of a reported speed, rpm."""
        rpm_per_Hz = 60 / self.pole_pairs
        motor_rpm = {"Hz": rpm_per_Hz, "rpm": 1.0, "%": rpm_per_Hz * self.max_Hz / 100}[unit]
        return motor_rpm * (1 - self.slip) / self.gear

    @property
    def reference_rpm(self) -> float:
        """Speed of the rotor for one count of the reference, rpm."""
        return self.registers.reference_step * self._rpm_per_unit(self.registers.reference_unit)

    @property
    def speed_rpm(self) -> float:
        """Speed of the rotor for one count of the reported speed, rpm."""
        return self.registers.speed_step * self._rpm_per_unit(self.registers.speed_unit)

    @property
    def max_rpm(self) -> float:
        """Speed of the rotor at `max_Hz`, rpm."""
        return self.max_Hz * self._rpm_per_unit("Hz")

    def ramp_counts(self, rpm_per_s: float) -> int:
        """Return the time of a ramp from rest to `max_Hz`, in counts of its register, at least 1."""
        return max(1, round(self.max_rpm / rpm_per_s / self.registers.ramp_step_s))

    def watchdog_counts(self, seconds: float) -> int:
        """Return the communication timeout in counts of its register, rounded up."""
        return math.ceil(round(seconds / self.registers.watchdog_step_s, 6))
