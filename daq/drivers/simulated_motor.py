"""A simulated device that turns the rotor: its torque, the speed that it reports, and faults of every such device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from typing_extensions import override

from daq.drivers.simulated import FarEnd, FaultKind
from rig_basics.units import RPM

COAST_RPM_S, LOOP_RPM_S, QUICK_RPM_S = 30.0, 2000.0, 4000.0
"""Rates of the rotor, rpm/s: by bearings and windage, without torque; by a speed loop at its current limit, faster than
any ramp of the host; by a quick stop."""
_MAX_LATE_S = 0.05  # longest time, s, for which a stalled simulation sends its reports afterwards


class TurnedRotor(Protocol):
    """Motion of the rotor as the device sees it.

    Attributes:
        target_rad_s: speed that it is driven to, rad/s.
        ramp_rad_s2: rate at which it approaches it, rad/s².
        braking: whether the device brakes at its current limit.
    """

    target_rad_s: float
    ramp_rad_s2: float
    braking: bool

    @property
    def speed_rad_s(self) -> float:
        """True speed, rad/s."""
        ...


class Periodic:
    """A message that is sent periodically, also while the simulation stalls, for a short time."""

    def __init__(self) -> None:
        self._due_s = 0.0

    def begin(self, now_s: float) -> None:
        """Begin: the next message is due now."""
        self._due_s = now_s

    def due(self, now_s: float, period_s: float) -> int:
        """Return the number of messages that are due, and take them as sent."""
        count = 0
        while now_s >= self._due_s:
            self._due_s = max(self._due_s + period_s, now_s - _MAX_LATE_S)
            count += 1
        return count


class SimulatedMotor(FarEnd):
    """Base class of simulated devices that turn the rotor.

    Args:
        motion: motion of the rotor.

    Attributes:
        emergencies: codes of its faults so far.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "restart": FaultKind("it starts again at once", end=None),
        "reported share": FaultKind(
            "it reports a wrong speed", 0.5, end=1, meaning="share of the true speed", limits=(-2, 2)
        ),
        "speed": FaultKind(
            "it runs away while it is in operation",
            1000,
            end=None,
            meaning="to this speed, rpm",
            limits=(-10_000, 10_000),
        ),
    }

    def __init__(self, motion: TurnedRotor) -> None:
        self._motion = motion
        self._now_s = 0.0
        self._faults = {name: kind.end for name, kind in self.fault_kinds.items() if kind.end is not None}
        self._runaway_rpm: float | None = None
        self._newest_rpm = 0.0  # speed in the newest report
        self.emergencies: list[int] = []

    @property
    def speed_rpm(self) -> float:
        """True speed of the rotor, rpm."""
        return self._motion.speed_rad_s / RPM

    @property
    def _reported_rpm(self) -> float:
        return self.speed_rpm * self._faults["reported share"]

    def _reported_speeds(self, count: int) -> list[float]:
        """Return the speeds in the reports that are due, rpm: the rotor's since the newest report, at equal times."""
        if count:
            before, self._newest_rpm = self._newest_rpm, self._reported_rpm
            return np.linspace(before, self._newest_rpm, count + 1)[1:].tolist()
        return []

    @property
    def watchdog_ms(self) -> int:
        """Silence of the host after which it stops the rotor by itself, ms; 0 without such a watch."""
        return 0

    def fail(self, what: str, value: Any) -> None:
        """See FarEnd and `fault_kinds`. Faults that end are values in `_faults`; subclasses carry out the others."""
        if what in self._faults:
            self._faults[what] = float(value)
        elif what == "restart":
            self._restart()
        elif what == "speed":
            self._runaway_rpm = float(value)
        else:
            super().fail(what, value)

    def _restart(self) -> None:
        """Set the state after power-up."""

    @override
    def facts(self) -> dict[str, Any]:
        return {"speed_rpm": self.speed_rpm, "emergencies": self.emergencies, "watchdog_ms": self.watchdog_ms}

    def _passed_s(self, now_s: float) -> float:
        """Take the time, s; return how much has passed."""
        before, self._now_s = self._now_s, max(self._now_s, now_s)
        return self._now_s - before

    def _drive(self, rpm: float, ramp_rpm_s: float, *, braking: bool = False) -> None:
        """Drive the rotor to a speed, rpm, along a ramp, rpm/s."""
        self._motion.target_rad_s, self._motion.ramp_rad_s2 = rpm * RPM, ramp_rpm_s * RPM
        self._motion.braking = braking
