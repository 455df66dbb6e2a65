"""States of a converter in its status word, and the word that is stored in the log."""

from __future__ import annotations

from rig_drivers.modbus_converter.registers import Registers

FAULT, RUNNING, READY, NOT_READY, UNKNOWN = "FAULT", "RUNNING", "READY", "NOT READY", "UNKNOWN"


def state(registers: Registers, status: int) -> str:
    """Return the state of a status word."""
    r = registers
    if status & r.fault_mask in r.fault_values:
        return FAULT
    if status & r.running_mask in r.running_values:
        return RUNNING
    return READY if not r.ready_values or status & r.ready_mask in r.ready_values else NOT_READY


def reported_counts(registers: Registers, status: int, raw: int) -> int:
    """Return a reported speed with its sign, in counts of its register."""
    r = registers
    if r.speed_signed:
        return (raw ^ 0x8000) - 0x8000
    return -raw if status & r.reverse_mask in r.reverse_values else raw


def statusword(status: int, fault: int) -> int:
    """Return the word in the log: bits 0–15 status word, bits 16–31 code of the present fault."""
    return status | fault << 16


def fault_text(code: int) -> str:
    """Return a fault code for a message."""
    return f"fault {code}, see its manual" if code else "no fault any more"
