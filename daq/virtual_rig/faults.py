"""Faults of a simulated rig: a device's own faults, and the faults that every device and its line can have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from daq.drivers.simulated import FarEnd, FaultKind

LINE_FAULTS: Mapping[str, FaultKind] = {
    "power": FaultKind("the supply fails; when it returns, the device restarts"),
    "mute": FaultKind("the bytes of the device do not reach the host"),
    "unheard": FaultKind("the bytes of the host do not reach the device"),
    "garbage": FaultKind("random bytes are inserted into its stream", 200, meaning="bytes per second", limits=(0, 1e6)),
    "bit errors": FaultKind("bits of its stream are wrong", 1e-3, meaning="share of its bytes"),
    "lost bytes": FaultKind("bytes of its stream are lost", 1e-3, meaning="share of its bytes"),
}
"""Faults of every device. A device's own fault of the same name takes precedence."""

_MAX_NUMBER = 1e15


def number(request: Mapping[str, Any], key: str, default: float | None = None) -> float:
    """Return a finite number of a request.

    Raises:
        ValueError: the value is not a finite number, or it is missing and has no default.
    """
    value = request.get(key, default)
    if not isinstance(value, int | float) or not abs(value) <= _MAX_NUMBER:  # the negated form rejects NaN
        raise ValueError(f"expected a finite number for {key!r}, got {value!r}")
    return value


class FaultInjector:
    """Sets and ends the faults of all devices, and applies them to the bytes.

    Args:
        far_ends: far ends by name of the device.
        random: returns the random number stream of a name.
    """

    def __init__(self, far_ends: Mapping[str, FarEnd], random: Callable[[str], np.random.Generator]) -> None:
        self._far_ends = far_ends
        self._random = {name: random(f"line {name}") for name in far_ends}
        self._standing: dict[tuple[str, str], float] = {}
        self._ends_s: dict[tuple[str, str], float] = {}

    def kinds(self, device: str) -> dict[str, FaultKind]:
        """Return the kinds of faults of a device, its own first.

        Raises:
            ValueError: the device does not exist.
        """
        if device not in self._far_ends:
            raise ValueError(f"no device {device!r}; this rig has {', '.join(self._far_ends)}")
        own = self._far_ends[device].fault_kinds
        return {**own, **{what: kind for what, kind in LINE_FAULTS.items() if what not in own}}

    def standing(self, device: str) -> dict[str, float]:
        """Return the values of a device's present faults, by name."""
        return {what: value for (name, what), value in self._standing.items() if name == device}

    def place(self, request: Mapping[str, Any], now_s: float) -> None:
        """Set or end a fault.

        Args:
            request: "device" and "what"; "value" (default: that of the kind); "end": true ends the fault; "seconds":
                duration of the fault, s.
            now_s: rig time, s.

        Raises:
            ValueError: device or fault do not exist, the value is invalid, or the fault cannot be ended or timed.
        """
        device, what = str(request.get("device")), str(request.get("what"))
        kinds = self.kinds(device)
        if what not in kinds:
            raise ValueError(f"{device}: no fault {what!r}; it can have: {', '.join(kinds)}")
        kind = kinds[what]
        value, seconds = request.get("value", kind.value), request.get("seconds")
        if (request.get("end") or seconds is not None) and kind.end is None:
            raise ValueError(f"{what!r} of {device} cannot be ended or timed: it happens once")
        if request.get("end"):
            value = kind.end
        if seconds is not None and not 0 < number(request, "seconds") <= 86_400:
            raise ValueError(f"expected seconds above 0 and up to 86400, got {seconds!r}")
        low, high = kind.limits
        if not isinstance(value, int | float) or not low <= value <= high:
            meant = f"{kind.meaning}, {low:g} to {high:g}" if kind.meaning else "1, or 0 to end it"
            raise ValueError(f"{what!r} of {device} takes {meant}; got {value!r}")
        self._apply(device, what, kind, value, now_s)
        self._ends_s.pop((device, what), None)
        if seconds is not None and (device, what) in self._standing:
            self._ends_s[device, what] = now_s + seconds

    def _apply(self, device: str, what: str, kind: FaultKind, value: float, now_s: float) -> None:
        far_end = self._far_ends[device]
        if what in far_end.fault_kinds:
            far_end.fail(what, value)
        elif what == "power" and bool(value) != ((device, what) in self._standing):
            far_end.power(not value, now_s)
        if value == kind.end:
            self._standing.pop((device, what), None)
        elif kind.end is not None:
            self._standing[device, what] = value

    def end_in_time(self, now_s: float) -> None:
        """End the faults whose duration is over."""
        for device, what in [place for place, end_s in self._ends_s.items() if end_s <= now_s]:
            self.place({"device": device, "what": what, "end": True}, now_s)

    def heard(self, device: str, data: bytes) -> bytes:
        """Return the bytes of the host that reach a device."""
        alive = self._far_ends[device].line_alive and not self._lasts(device, "unheard")
        return data if alive else b""

    def arrives(self, device: str, data: bytes, seconds: float) -> bytes:
        """Return the bytes that reach the host, of the bytes that a device sent in a number of seconds."""
        if self._standing:
            if self._lasts(device, "mute") or not self._far_ends[device].line_alive:
                return b""
            if share := self._lasts(device, "lost bytes"):
                data = self._lossy(device, data, share)
            if share := self._lasts(device, "bit errors"):
                data = self._flipped(device, data, share)
            if rate := self._lasts(device, "garbage"):
                data = self._with_garbage(device, data, rate * seconds)
        return data

    def _lasts(self, device: str, what: str) -> float:
        """Return the value of a present fault of the line; 0 if there is none, or if it is a fault of the device."""
        return 0.0 if what in self._far_ends[device].fault_kinds else self._standing.get((device, what), 0.0)

    def _lossy(self, device: str, data: bytes, share: float) -> bytes:
        kept = self._random[device].random(len(data)) >= share
        return np.frombuffer(data, np.uint8)[kept].tobytes()

    def _flipped(self, device: str, data: bytes, share: float) -> bytes:
        rng = self._random[device]
        hit = rng.random(len(data)) < share
        bits = np.left_shift(np.uint8(1), rng.integers(0, 8, len(data), np.uint8))
        return (np.frombuffer(data, np.uint8) ^ np.where(hit, bits, np.uint8(0))).tobytes()

    def _with_garbage(self, device: str, data: bytes, expected: float) -> bytes:
        rng = self._random[device]
        garbage = rng.bytes(int(rng.poisson(min(expected, 1e6))))
        at = int(rng.integers(0, len(data) + 1))
        return data[:at] + garbage + data[at:]


def listed(kinds: Mapping[str, FaultKind]) -> dict[str, dict[str, Any]]:
    """Return kinds of faults as JSON values."""
    return {
        what: {
            "words": kind.words,
            "value": kind.value,
            "meaning": kind.meaning,
            "limits": kind.limits,
            "lasts": kind.end is not None,
        }
        for what, kind in kinds.items()
    }
