# pyright: strict
"""The simulated operator: does through the control port of the virtual rig what a person does by hand at a real one."""

from __future__ import annotations

from typing import Any, Protocol

_PUSH_RAD_S = 25.0
_GOLDEN, _SILVER = (5**0.5 - 1) / 2, 2**0.5 - 1  # multiples of these fill (0, 1) evenly, together its square


class Asked(Protocol):
    """A simulated rig, however far away."""

    def ask(self, do: str, **what: Any) -> dict[str, Any]:
        """See OperatorLine."""
        ...


class SimulatedOperator:
    """Does at the virtual rig what a person does by hand at a real one."""

    def __init__(self, line: Asked) -> None:
        self._line = line
        self._scattered = 0

    def pluck(self, axis: str, mm: float | None = None) -> None:
        """Displace mostly along the axis, as well as a hand can, and let go.

        Args:
            axis: "x" or "y".
            mm: how far; None: as a guided test asks for.
        """
        x, y = (2.6, 0.25) if axis == "x" else (-0.2, 2.4)
        share = 1.0 if mm is None else mm / max(abs(x), abs(y))
        self._line.ask("pluck", x_mm=share * x, y_mm=share * y, hold_s=0.4)

    def flick(self) -> None:
        """Set the pendulums spinning, one each way."""
        self._line.ask("flick", pendulum=0, speed_rad_s=11.5)
        self._line.ask("flick", pendulum=1, speed_rad_s=-10.8)

    def scatter(self) -> None:
        """Push both pendulums, each differently each time, so that they come to rest elsewhere."""
        self._scattered += 1
        for pendulum, step in ((0, _GOLDEN), (1, _SILVER)):
            share = 2 * ((self._scattered * step) % 1.0) - 1
            self._line.ask("flick", pendulum=pendulum, speed_rad_s=_PUSH_RAD_S * share)

    def lock(self, seen: bool) -> None:
        """Put both pendulums at their places and hold them."""
        self._line.ask("lock")

    def release(self) -> None:
        """Let both pendulums go."""
        self._line.ask("release")

    def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """Turn the rotor, where no drive does."""
        self._line.ask("turn", rpm=rpm, ramp_rpm_per_s=ramp_rpm_per_s)

    def radio(self) -> dict[str, Any]:
        """What the radio dropped, as only an onlooker of a simulation can know."""
        return self._line.ask("state")
