"""Register tables of frequency converters.

Addresses are those on the wire, from 0. Sources and marks: docs/protocols/modbus_converter.md, which also states what
is not verified. A rig file overrides single entries in its table `registers`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

from pydantic import BeforeValidator, Field

from rig_configs.table import Positive, RigTable


def _tuple(given: object) -> object:
    return tuple(cast("list[object]", given)) if isinstance(given, list) else given


Word = Annotated[int, Field(ge=0, le=0xFFFF)]
Words = Annotated[tuple[Word, ...], BeforeValidator(_tuple)]
Unit = Literal["Hz", "rpm", "%"]


FAULT, RUNNING, READY, NOT_READY, UNKNOWN = "FAULT", "RUNNING", "READY", "NOT READY", "UNKNOWN"
"""States of a converter."""


class Registers(RigTable):
    """Registers of a converter; the defaults are those of the table "generic", which is no real converter's.

    A state is active if the status word, with the state's mask, is one of the state's values. A state without values is
    not reported.

    Attributes:
        read_function, write_function: function codes for reading (3 or 4) and writing (6 or 16).
        reads_gaps: whether one read may also span registers that the converter does not have.
        control: register of the command word.
        before_run: command words that are written before `run`, in this order.
        run, run_reverse: command words for both directions of rotation; None: it does not turn backwards, or the sign
            of the reference is the direction.
        stop: command word for a stop along the deceleration ramp.
        quick_stop: command word for its fastest stop; None: the host shortens the deceleration ramp and sends `stop`.
        reset: command word that resets a fault.
        reference, reference_unit, reference_step, reference_signed: register of the set-point, its unit, units of one
            count, and whether its sign is the direction. "%" is a share of `max_Hz`.
        status: register of the status word.
        running_mask, running_values, fault_mask, fault_values, ready_mask, ready_values, reverse_mask, reverse_values:
            states in it.
        speed, speed_unit, speed_step, speed_signed: register of the output frequency or speed.
        fault_code: register of the present fault's code; None: not readable.
        acceleration, deceleration, ramp_step_s: registers of the ramp times, and the time of one count, s.
        watchdog, watchdog_step_s: register of the communication timeout, and the time of one count, s; None: it can
            only be set by hand.
        watchdog_action, watchdog_action_value: register of the reaction to a timeout, and the value for a stop; None:
            it is set by hand.
        watchdog_off: value that ends the communication timeout at rest; None: it cannot be ended.
        watchdog_fault: fault code after a timeout; None: unknown, so that a fault is never reset by the host.
        write_offset: added to the address of ramp and watchdog registers when they are written, so that the converter
            does not store them in its EEPROM.
    """

    read_function: Literal[3, 4] = 3
    write_function: Literal[6, 16] = 6
    reads_gaps: bool = True
    control: Word = 0x2000
    before_run: Words = ()
    run: Word = 1
    run_reverse: Word | None = 2
    stop: Word = 0
    quick_stop: Word | None = 4
    reset: Word = 0x80
    reference: Word = 0x2001
    reference_unit: Unit = "Hz"
    reference_step: Positive = 0.01
    reference_signed: bool = False
    status: Word = 0x2100
    running_mask: Word = 0x0001
    running_values: Words = (0x0001,)
    fault_mask: Word = 0x0008
    fault_values: Words = (0x0008,)
    ready_mask: Word = 0x0010
    ready_values: Words = (0x0010,)
    reverse_mask: Word = 0x0002
    reverse_values: Words = (0x0002,)
    speed: Word = 0x2103
    speed_unit: Unit = "Hz"
    speed_step: Positive = 0.01
    speed_signed: bool = False
    fault_code: Word | None = 0x2101
    acceleration: Word = 0x2010
    deceleration: Word = 0x2011
    ramp_step_s: Positive = 0.1
    watchdog: Word | None = 0x2012
    watchdog_step_s: Positive = 0.1
    watchdog_action: Word | None = None
    watchdog_action_value: Word = 0
    watchdog_off: Word | None = 0
    watchdog_fault: Word | None = 18
    write_offset: Word = 0

    def state(self, status: int) -> str:
        """Return the state of a status word."""
        if status & self.fault_mask in self.fault_values:
            return FAULT
        if status & self.running_mask in self.running_values:
            return RUNNING
        return READY if not self.ready_values or status & self.ready_mask in self.ready_values else NOT_READY

    def reported_counts(self, status: int, raw: int) -> int:
        """Return a reported speed with its sign, in counts of its register."""
        if self.speed_signed:
            return (raw ^ 0x8000) - 0x8000
        return -raw if status & self.reverse_mask in self.reverse_values else raw


def fault_text(code: int) -> str:
    """Return a fault code for a message."""
    return f"fault {code}, see its manual" if code else "no fault any more"


TABLES: Mapping[str, Mapping[str, Any]] = {
    "generic": {},
    "invt": {
        "run": 1,
        "run_reverse": 2,
        "stop": 5,
        "quick_stop": None,
        "reset": 7,
        "status": 0x2100,
        "running_mask": 0xFFFF,
        "running_values": (1, 2),
        "fault_mask": 0xFFFF,
        "fault_values": (4,),
        "ready_mask": 0xFFFF,
        "ready_values": (1, 2, 3),
        "reverse_mask": 0xFFFF,
        "reverse_values": (2,),
        "speed": 0x3000,
        "fault_code": 0x2102,
        "acceleration": 0x000B,
        "deceleration": 0x000C,
        "watchdog": 0x0E04,
        "watchdog_action": 0x0E05,
        "watchdog_action_value": 3,
        "watchdog_fault": None,
        "write_offset": 0x8000,
    },
    "m-max": {
        "control": 2000,
        "run": 0x0301,
        "run_reverse": 0x0303,
        "stop": 0x0300,
        "quick_stop": None,
        "reset": 0x0304,
        "reference": 2002,
        "reference_unit": "%",
        "reference_step": 0.01,
        "status": 2100,
        "running_mask": 0x02,
        "running_values": (0x02,),
        "fault_mask": 0x08,
        "fault_values": (0x08,),
        "ready_mask": 0x01,
        "ready_values": (0x01,),
        "reverse_mask": 0x04,
        "reverse_values": (0x04,),
        "speed": 2103,
        "speed_signed": True,
        "fault_code": 2110,
        "acceleration": 102,
        "deceleration": 103,
        "watchdog": 813,
        "watchdog_step_s": 1.0,
        "watchdog_fault": 53,
    },
    "altivar": {
        "reads_gaps": False,
        "control": 8501,
        "before_run": (0x0006, 0x0007),
        "run": 0x000F,
        "run_reverse": None,
        "stop": 0x0007,
        "quick_stop": 0x000B,
        "reset": 0x0080,
        "reference": 8602,
        "reference_unit": "rpm",
        "reference_step": 1.0,
        "reference_signed": True,
        "status": 3201,
        "running_mask": 0x004F,
        "running_values": (0x0007,),
        "fault_mask": 0x004F,
        "fault_values": (0x0008,),
        "ready_mask": 0x004F,
        "ready_values": (0x0007, 0x0003, 0x0001),
        "reverse_values": (),
        "speed": 8604,
        "speed_unit": "rpm",
        "speed_step": 1.0,
        "speed_signed": True,
        "fault_code": 8606,
        "acceleration": 9001,
        "deceleration": 9002,
        "watchdog": 6005,
        "watchdog_off": None,
        "watchdog_fault": 0x7510,
    },
}
"""Entries of each table that differ from "generic"."""


def completed(table: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a table with those of the rig file in their place."""
    return {**TABLES[table], **own}
