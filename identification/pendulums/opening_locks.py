"""State of the rig when the later of both locks opens; each lock opens at an instant of its own.

Up to the first instant t1 both pendulums are locked (identification.pendulums.locked_start), between t1 and t2 one of
them is free. With f1 for the rates of that motion, y2 = Φ(y1), D = ∂y2/∂y1 and the rates f2 of two free pendulums, the
state at t2 of a motion that starts there changes by f1(y2) − f2(y2) for a later t2, and by D (∂y1/∂t1 − f1(y1)) for a
later t1. Locks open within milliseconds of each other, in which dry friction has no visible effect; it is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.equations.kernels import rates
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.integrate import fastest_rate, integrate
from identification.pendulums.locked_start import LockedStart
from rig_basics.arrays import Array

_STEP_SHARE = 0.08  # step over the inverse of the fastest rate, as for the free motion
_MAX_STEPS = 2000  # between the instants: some 40 are usual, a distant trial of a minimiser would need billions
_DIFFERENCE = 1e-6  # step of a state, over its typical size, and of the logarithm of a parameter
_LOGARITHMS = 7  # ln c3, ln c4, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P
_UNUSUAL_STDS = 3.0  # standard deviations of a usual lock that it exceeds in one of 370 openings


@dataclass(frozen=True)
class Opening:
    """Instant at which a lock opened, by the motion of its pendulum.

    Attributes:
        pendulum: "A" or "B".
        late_s: instant minus that of the message that the lock is open, s.
        std_s: standard uncertainty of that difference by the fit, s.
        expected_std_s: its standard uncertainty by the rig file and the stamp of the message, s.
    """

    pendulum: str
    late_s: float
    std_s: float
    expected_std_s: float

    @property
    def unusual(self) -> bool:
        """Whether the lock opened at another instant than the rig file's uncertainty allows."""
        return abs(self.late_s) > _UNUSUAL_STDS * math.hypot(self.expected_std_s, self.std_s)

    @property
    def sentence(self) -> str:
        """The instant in words."""
        side = "after" if self.late_s > 0 else "before"
        return (
            f"lock {self.pendulum} opened {1e3 * abs(self.late_s):.1f} ± {1e3 * self.std_s:.1g} ms {side} its message, "
            f"expected within ± {1e3 * self.expected_std_s:.2g} ms (pendulums.release_std_s). The fit uses the instant "
            "that it found. Look at the lock, or state its uncertainty in the rig file"
        )


@dataclass(frozen=True)
class OpenedLocks:
    """State of the rig when the later lock opens.

    Attributes:
        state: state at that instant, shape (8,).
        at_s: that instant, s.
        by_angle: derivatives of the state by the locked angles θ3, θ4, shape (8, 2).
        by_instant: derivatives of the state by the instants at which A and B open, without the change of the free
            motion's own start (`later`), shape (8, 2).
        later: index of the pendulum that opens later.
        by_deviation: derivatives of the state by the disk's deviation x, y, ẋ, ẏ from its locked orbit, shape (8, 4).
        by_logarithm: derivatives of the state by ln c3, ln c4, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P, shape (8, 7).
    """

    state: Array
    at_s: float
    by_angle: Array
    by_instant: Array
    later: int
    by_deviation: Array
    by_logarithm: Array

    def start_by_instant(self, free_rates: Array) -> Array:
        """Return the derivatives of a free motion's start by both instants, shape (8, 2).

        Args:
            free_rates: rates of the free motion at its start, shape (8,).
        """
        found = self.by_instant.copy()
        found[:, self.later] -= free_rates
        return found


def opened_locks(
    rest: LockedStart,
    physics_of: Callable[[Array], RotorParameters],
    angles_rad: tuple[float, float],
    shifts_s: tuple[float, float],
    deviation: Array,
) -> OpenedLocks | None:
    """Return the state when the later lock opens; None if its motion cannot be integrated, as for a distant trial.

    Args:
        rest: locked rig before the release.
        physics_of: changes of the seven logarithms, shape (7,), ↦ parameters.
        angles_rad: true locked angles of A and B.
        shifts_s: instants at which the locks of A and B open, minus `rest.release_s`.
        deviation: deviation of x, y, ẋ, ẏ from the locked orbit, shape (4,).
    """
    later = int(shifts_s[1] >= shifts_s[0])
    first, last = shifts_s[1 - later], shifts_s[later]
    physics = physics_of(np.zeros(_LOGARITHMS))
    state, by = rest.at(physics, *angles_rad, first)
    state[[0, 1, 4, 5]] += deviation
    span = rest.release_s + np.array([first, last])
    free = (1.0, 0.0) if later == 1 else (0.0, 1.0)

    step = _STEP_SHARE / fastest_rate(physics, rest.speed_rad_s)  # the same for all differences
    if span[1] - span[0] > _MAX_STEPS * step:
        return None
    knots, coefficients = rest.history.knots_s, rest.history.coefficients

    def moved(start: Array, changed: RotorParameters) -> Array:
        if span[1] == span[0]:
            return start
        return integrate(start, span, step, knots, coefficients, changed.packed(), *free)[-1]

    def rates_at(at: Array, instant_s: float) -> Array:
        out, (psi, omega, alpha) = np.empty(8), rest.history.phase(instant_s)[0]
        rates(at, psi, omega, alpha, physics.packed(), *free, out)
        return out

    end = moved(state, physics)
    orbit = float(np.max(np.abs(state[:2]))) + 1e-6
    size = np.r_[orbit, orbit, 1.0, 1.0, np.array([orbit, orbit, 1.0, 1.0]) * rest.speed_rad_s] * _DIFFERENCE
    flow = np.column_stack([(moved(state + size * unit, physics) - end) / size[i] for i, unit in enumerate(np.eye(8))])
    direct = [(moved(state, physics_of(_DIFFERENCE * unit)) - end) / _DIFFERENCE for unit in np.eye(_LOGARITHMS)]
    by_instant = np.empty((8, 2))
    by_instant[:, 1 - later] = flow @ (by[:, 2] - rates_at(state, span[0]))
    by_instant[:, later] = rates_at(end, span[1])
    by_logarithm = np.column_stack(direct)
    by_logarithm[:, 2:] += flow @ by[:, 3:]
    return OpenedLocks(end, float(span[1]), flow @ by[:, :2], by_instant, later, flow[:, [0, 1, 4, 5]], by_logarithm)
