# pyright: strict
"""One thing looked at on a device, held against what it should be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    Attributes:
        value: what was seen; None when nothing was.
        expected: what the rig file says, or what a healthy device does; None where any value will do.
        passed: the verdict.
        note: what to know or to do.
    """

    value: Any
    expected: Any
    passed: bool
    note: str = ""

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        note = {"note": self.note} if self.note else {}
        return {"value": self.value, "expected": self.expected, "verdict": "pass" if self.passed else "fail", **note}


Checks = dict[str, Check]
