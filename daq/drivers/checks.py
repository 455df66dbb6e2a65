"""One check of a device: a value compared with its expected value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class DeviceCheck:
    """One check of a device.

    Attributes:
        value: value found; None if none was found.
        expected: value in the rig file, or of a healthy device; None if any value is accepted.
        passed: whether the check passed.
        note: explanation, or what to do next; may be empty.
    """

    value: Any
    expected: Any
    passed: bool
    note: str = ""

    def facts(self) -> dict[str, Any]:
        """Return the check as a JSON object."""
        note = {"note": self.note} if self.note else {}
        return {"value": self.value, "expected": self.expected, "verdict": "pass" if self.passed else "fail", **note}


Checks = dict[str, DeviceCheck]
