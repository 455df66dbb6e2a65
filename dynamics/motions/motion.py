"""A computed motion: states at the output instants and, if kept, the polynomials between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dynamics.arrays import Array
from dynamics.compiled_code import compiled
from dynamics.errors import OutsideDomain
from dynamics.motions.explicit_steps import evaluate
from rig_basics.tabular import Column, Tabular
from rig_basics.times import seconds

COMPONENTS = ("x_m", "y_m", "theta3_rad", "theta4_rad", "x_m_per_s", "y_m_per_s", "theta3_rad_s", "theta4_rad_s")
"""Names of the components of a state."""


@dataclass(frozen=True)
class MotionEvent:
    """Event during a motion.

    Attributes:
        time_s: instant, s.
        kind: "release", "stick", "slide forward", "slide backward" or "stop" (the rotor comes to rest).
        pendulum: 0 for A, 1 for B, None for the rotor.
    """

    time_s: float
    kind: str
    pendulum: int | None


@dataclass(frozen=True)
class Piece:
    """Consecutive steps with the same packed parameters and free pendulums.

    Attributes:
        first, last: the steps first … last − 1 of a motion.
        packed: packed parameters, shape (26,).
        free_a, free_b: 1.0 for a free pendulum, 0.0 otherwise.
    """

    first: int
    last: int
    packed: Array
    free_a: float
    free_b: float


@dataclass(frozen=True)
class Polynomials:
    """The motion as one polynomial per step.

    Attributes:
        spans: start and length of each step, shape (m, 2), s. A step ends at the start of the next one if that is
            earlier than its length.
        coefficients: powers of (time − start)/length, shape (m, 8 powers, 8 components).
        end_s: last instant, s.
        pieces: parameters and free pendulums of the steps.
    """

    spans: Array
    coefficients: Array
    end_s: float
    pieces: tuple[Piece, ...]


@dataclass(frozen=True)
class Motion(Tabular):
    """A computed motion.

    Attributes:
        time_s: shape (n,), s.
        state: shape (n, 8): x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4 (SI).
        error_estimate: bound on the error over all instants: of angles in rad, of displacements relative to the
            longest pendulum arm. In metres displacement errors are below this number.
        step_s: mean step, s.
        method: "explicit" or "implicit".
        why: reason for the method.
        steps: accepted steps of the returned run.
        work_steps: all computed steps, including those of the error estimate.
        events: releases, changes between sticking and sliding, the rotor's stop, in order.
        polynomials: the motion between the instants, or None if it was not kept.
    """

    time_s: Array
    state: Array
    error_estimate: float
    step_s: float
    method: str = "explicit"
    why: str = ""
    steps: int = 0
    work_steps: int = 0
    events: tuple[MotionEvent, ...] = ()
    polynomials: Polynomials | None = field(default=None, repr=False)

    @property
    def heading(self) -> str:
        """Method and error."""
        return f"Motion: method {self.method}, error at most {self.error_estimate:.2g}"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each instant."""
        return {"time_s": self.time_s, **dict(zip(COMPONENTS, self.state.T, strict=True))}

    @property
    def displacement_m(self) -> Array:
        """Disk centre x, y, m; shape (n, 2)."""
        return self.state[:, :2]

    @property
    def angles_rad(self) -> Array:
        """θ3, θ4, rad; shape (n, 2)."""
        return self.state[:, 2:4]

    def at(self, time_s: Array | float) -> Array:
        """States at arbitrary instants within the motion, shape (n, 8).

        Raises:
            OutsideDomain: the motion was computed without dense=True, or an instant is a date or outside the motion.
        """
        kept, times = self._kept(), np.atleast_1d(seconds(time_s, OutsideDomain))
        first, last = float(kept.spans[0, 0]), kept.end_s
        if np.any(times < first) or np.any(times > last):
            raise OutsideDomain(f"the motion covers {first:.6g} to {last:.6g} s, got {times.min()} to {times.max()}")
        out = np.empty((len(times), 8))
        _interpolate(times, kept.spans, kept.coefficients, out)
        return out

    def crossings(self, component: int, level: float, direction: int = 0) -> Array:
        """Instants at which a component of the state crosses a level, ascending, s.

        Each step is searched between four points, so two crossings within a quarter of a step may be missed.

        Args:
            component: index into the state (2, 3: θ3, θ4).
            level: level in the component's unit.
            direction: +1 only upwards, −1 only downwards, 0 both.
        Raises:
            OutsideDomain: the motion was computed without dense=True.
        """
        kept = self._kept()
        ends = np.r_[kept.spans[1:, 0], kept.end_s]
        return _crossings(kept.spans, ends, np.ascontiguousarray(kept.coefficients[:, :, component]), level, direction)

    def _kept(self) -> Polynomials:
        if self.polynomials is None:
            raise OutsideDomain("the motion has no polynomials: compute it with simulate(..., dense=True)")
        return self.polynomials


@compiled
def _interpolate(times: Array, spans: Array, coefficients: Array, out: Array) -> None:
    starts = spans[:, 0]
    for i in range(len(times)):
        at: float = times[i]
        step = max(0, np.searchsorted(starts, at, side="right") - 1)
        evaluate(coefficients[step], (times[i] - spans[step, 0]) / spans[step, 1], out[i])


@compiled(part=True)
def _height(polynomial: Array, x: float, level: float) -> float:
    value = polynomial[7]
    for power in range(6, -1, -1):
        value = value * x + polynomial[power]
    return value - level


@compiled
def _crossings(spans: Array, ends: Array, polynomials: Array, level: float, direction: int) -> Array:
    found: list[float] = []
    below = _height(polynomials[0], 0.0, level)  # the last nonzero height, kept across the steps
    for step in range(len(spans)):
        polynomial, start, width = polynomials[step], spans[step, 0], spans[step, 1]
        reach = (ends[step] - start) / width
        low = 0.0
        for check in range(1, 5):
            high = reach * check / 4.0
            above = _height(polynomial, high, level)
            if below * above < 0.0 or (above == 0.0 and below != 0.0):
                if direction == 0 or direction * (above - below) > 0.0:
                    left, right = low, high
                    for _ in range(60):
                        middle = 0.5 * (left + right)
                        if _height(polynomial, middle, level) * below > 0.0:
                            left = middle
                        else:
                            right = middle
                    found.append(start + right * width)
                below = -below
            low = high
            if above != 0.0:
                below = above
    return np.array(found)
