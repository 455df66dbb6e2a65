"""One check of a device: a value compared with its expected value."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

Verdict = Literal["pass", "fail", "not resolved"]


@dataclass(frozen=True)
class DeviceCheck:
    """One check of a device.

    Attributes:
        value: value found; None if none was found.
        expected: value in the rig file, or of a healthy device; None if any value is accepted.
        passed: whether the check passed; None if the observation does not resolve the limit: no pass and no failure.
        note: explanation, or what to do next; may be empty.
    """

    value: Any
    expected: Any
    passed: bool | None
    note: str = ""

    @property
    def failed(self) -> bool:
        """Whether the value contradicts the expected one."""
        return self.passed is False

    @property
    def verdict(self) -> Verdict:
        """The verdict in a word."""
        return "not resolved" if self.passed is None else "pass" if self.passed else "fail"

    def facts(self) -> dict[str, Any]:
        """Return the check as a JSON object."""
        note = {"note": self.note} if self.note else {}
        return {"value": self.value, "expected": self.expected, "verdict": self.verdict, **note}


Checks = dict[str, DeviceCheck]


def signal_check(strength_dBm: int | None, least_dBm: int, remedy: str) -> Checks:
    """Return the check of a radio signal's strength; none if it is unknown."""
    if strength_dBm is None:
        return {}
    weak = strength_dBm < least_dBm
    return {"signal_dBm": DeviceCheck(strength_dBm, f"at least {least_dBm}", not weak, f"weak: {remedy}" * weak)}


def at_most(value: float, bound: float, limit: float) -> bool | None:
    """Compare a value of limited certainty with a limit.

    Args:
        value: value found, ≥ 0.
        bound: bound of its error.
        limit: largest accepted value.

    Returns:
        True if the whole interval value ± bound is accepted, False if nothing of it is, None if it contains the limit.
    """
    if value + bound <= limit:
        return True
    return False if not value - bound <= limit else None


def longer(seconds: float, bound: float, room: float) -> str:
    """Return the advice of an observation that does not resolve a limit.

    Args:
        seconds: duration of the observation, s.
        bound: bound of the error, which decreases with the duration.
        room: distance of the value from the limit.
    """
    needed_s = seconds * bound / room if room > 0 else math.inf
    if needed_s > _MAX_OBSERVATION_S:
        return "not resolved: the value is too near the limit, or too uncertain on this host"
    return f"not resolved: observe for {math.ceil(needed_s)} s"


_MAX_OBSERVATION_S = 120.0
