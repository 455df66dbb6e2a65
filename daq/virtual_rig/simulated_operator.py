"""The simulated operator, which operates the virtual rig through its control port as a person operates a real rig."""

from __future__ import annotations

from typing import Any, Protocol

_MAX_PUSH_RAD_S = 25.0
_HAND_TURN_RAD_S = 4.0  # of a pendulum that a hand turns, which friction stops
_GOLDEN, _SILVER = (5**0.5 - 1) / 2, 2**0.5 - 1  # their multiples modulo 1 fill (0, 1) evenly, pairs of them its square


class ControlLine(Protocol):
    """Connection to the control port of a simulated rig, in this process or in another one."""

    def ask(self, do: str, **what: Any) -> dict[str, Any]:
        """See OperatorLine."""
        ...


class SimulatedOperator:
    """Operates the virtual rig by hand; implements `daq.guided_tests.hands.Operator`.

    Args:
        line: connection to the control port.
    """

    def __init__(self, line: ControlLine) -> None:
        self._line = line
        self._scattered = 0

    def pluck(self, axis: str, mm: float | None = None) -> None:
        """Displace the column along the axis, with the error of direction of a hand, and release it.

        Args:
            axis: "x" or "y".
            mm: larger component of the displacement, mm; None for the displacement of a guided test.
        """
        x, y = (2.6, 0.25) if axis == "x" else (-0.2, 2.4)
        share = 1.0 if mm is None else mm / max(abs(x), abs(y))
        self._line.ask("pluck", x_mm=share * x, y_mm=share * y, hold_s=0.4)

    def place(self, device: str, mm: float | None) -> None:
        """Displace the target of a displacement sensor along its beam and hold it there, as a gauge block does.

        Args:
            device: name of the sensor in the rig file.
            mm: displacement from the rest position, mm; None: release the target.
        """
        self._line.ask("place", device=device, mm=mm)

    def turn_pendulum(self, pendulum: int) -> None:
        """Turn a free pendulum counter-clockwise by some tens of degrees.

        Args:
            pendulum: 0 for A, 1 for B.
        """
        self._line.ask("flick", pendulum=pendulum, speed_rad_s=_HAND_TURN_RAD_S)

    def flick(self) -> None:
        """Set the pendulums spinning in opposite directions."""
        self._line.ask("flick", pendulum=0, speed_rad_s=11.5)
        self._line.ask("flick", pendulum=1, speed_rad_s=-10.8)

    def scatter(self) -> None:
        """Push both pendulums with different speeds each time, so that they come to rest at different angles."""
        self._scattered += 1
        for pendulum, step in ((0, _GOLDEN), (1, _SILVER)):
            share = 2 * ((self._scattered * step) % 1.0) - 1
            self._line.ask("flick", pendulum=pendulum, speed_rad_s=_MAX_PUSH_RAD_S * share)

    def lock(self, seen: bool) -> None:
        """Lock both pendulums."""
        self._line.ask("lock")

    def release(self) -> None:
        """Release both pendulums."""
        self._line.ask("release")

    def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """Turn the rotor of a rig without a drive."""
        self._line.ask("turn", rpm=rpm, ramp_rpm_per_s=ramp_rpm_per_s)

    def radio(self) -> dict[str, Any]:
        """Return the state of the simulation, which contains the frames that the radio dropped."""
        return self._line.ask("state")
