"""Settings of one run: speed history, released pendulums, start state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arguments import check_number, check_pair, real_array
from dynamics.arrays import Array
from dynamics.equations.phase_segments import PhaseSegments, speed_crossings
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain


@dataclass(frozen=True)
class Scene:
    """One run: rotation of the rotor, released pendulums, start state.

    Attributes:
        history: the rotor's phase over time.
        released: whether pendulums A and B swing freely. A locked pendulum is a fixed mass at its start angle.
        start: state at the first instant, shape (8,): x, y (m), θ3, θ4 (rad, relative to the rotor), and
            their rates (m/s, rad/s). None: locked orbit at the start speed with the pendulums at 0 and π.
        release_time_s: release instants of A and B, s, for pendulums marked in `released`; before them they are locked.
            None: they are free from the start.
    """

    history: SpeedHistory
    released: tuple[bool, bool] = (True, True)
    start: Array | None = None
    release_time_s: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _check_history(self.history)
        times = self.release_time_s
        check_pair(released=self.released)
        if times is not None and (np.shape(times) != (2,) or np.any(np.isnan(real_array("release_time_s", times)))):
            raise OutsideDomain(f"release_time_s must be two times in s, for A and for B, got {times!r}")


def _check_history(history: object) -> None:
    if not isinstance(history, SpeedHistory):
        raise OutsideDomain(f"a scene's history must be a SpeedHistory, got {type(history).__name__}")


def time_at_speed(history: SpeedHistory, speed_rad_s: float, from_s: float, to_s: float) -> float:
    """First instant in [from_s, to_s] at which the rotor passes a speed, s. It is used for a release at speed.

    Raises:
        OutsideDomain: the rotor does not pass that speed in the interval.
    """
    check_number(speed_rad_s=speed_rad_s, from_s=from_s, to_s=to_s)
    found = speed_crossings(PhaseSegments.of(history), speed_rad_s, from_s, to_s)
    if len(found) == 0:
        first, last = history.phase(np.array([from_s, to_s]))[:, 1]
        if not np.any(history.coefficients[:, 2:]):
            raise OutsideDomain(
                f"the rotor turns at a constant {first:.6g} rad/s and passes no speed; "
                "give the instant of the release itself (Scene.release_time_s)"
            )
        raise OutsideDomain(
            f"the rotor does not pass {speed_rad_s:.6g} rad/s between {from_s:.6g} and {to_s:.6g} s "
            f"(its speed is {first:.6g} and {last:.6g} rad/s there)"
        )
    return float(found[0])
