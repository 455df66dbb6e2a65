"""Prescribed phase of the rotor over time: constant speed, a ramp, or a measured history."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # loads scipy.interpolate, which takes 0.5 s, at its first use: only measured speeds need it
from numpy.typing import ArrayLike

from dynamics.arguments import check_number, real_array
from dynamics.arrays import Array
from dynamics.compiled_code import compiled
from dynamics.errors import OutsideDomain
from rig_basics.times import need_ascending, seconds


@dataclass(frozen=True)
class SpeedHistory:
    """The rotor's phase as a piecewise cubic of time, with constant speed outside its range.

    Attributes:
        knots_s: shape (m + 1,), ascending, s.
        coefficients: shape (m, 4): ψ = c0 + c1 s + c2 s² + c3 s³ with s = t − knot, rad.
    """

    knots_s: Array
    coefficients: Array

    @classmethod
    def constant(cls, speed_rad_s: float, phase_rad: float = 0.0, at_s: float = 0.0) -> SpeedHistory:
        """Constant speed with a given phase at one instant."""
        _check_finite(speed_rad_s=speed_rad_s, phase_rad=phase_rad, at_s=at_s)
        return cls(np.array([at_s, at_s + 1.0]), np.array([[phase_rad, speed_rad_s, 0.0, 0.0]]))

    @classmethod
    def ramp(cls, from_rad_s: float, to_rad_s: float, duration_s: float, phase_rad: float = 0.0) -> SpeedHistory:
        """Linear ramp that starts at t = 0, then constant speed."""
        _check_finite(from_rad_s=from_rad_s, to_rad_s=to_rad_s, duration_s=duration_s, phase_rad=phase_rad)
        if duration_s <= 0:
            raise OutsideDomain(f"a ramp's duration must be above 0 s, got {duration_s!r}")
        slope = (to_rad_s - from_rad_s) / duration_s
        return cls(np.array([0.0, duration_s]), np.array([[phase_rad, from_rad_s, slope / 2, 0.0]]))

    @classmethod
    def from_phases(cls, time_s: ArrayLike, phase_rad: ArrayLike) -> SpeedHistory:
        """Twice differentiable interpolation of measured phases (tachometer marks).

        Args:
            time_s, phase_rad: shape (n,), n ≥ 4, time strictly ascending.
        Raises:
            OutsideDomain: fewer than four marks, or times that are dates or not ascending.
        """
        times, phases = seconds(time_s, OutsideDomain), real_array("phase_rad", phase_rad)
        if times.ndim != 1 or phases.ndim != 1:
            raise OutsideDomain(
                f"marks of a speed history: expected one row of each, got {times.shape}, {phases.shape}"
            )
        if len(times) < 4 or len(times) != len(phases):
            raise OutsideDomain(
                f"a speed history needs at least 4 marks with a phase each, got {len(times)} and {len(phases)}"
            )
        need_ascending(times, OutsideDomain)
        if not (np.all(np.isfinite(times)) and np.all(np.isfinite(phases)) and np.all(np.diff(times) > 0)):
            raise OutsideDomain("the marks of a speed history must be finite and strictly ascending in time")
        spline = scipy.interpolate.CubicSpline(times, phases)
        return cls(np.asarray(times, float), np.ascontiguousarray(spline.c[::-1].T))

    def phase(self, time_s: ArrayLike) -> Array:
        """ψ in rad at the given times; shape (n, 3): phase, speed (rad/s), acceleration (rad/s²)."""
        return _phases(np.atleast_1d(seconds(time_s, OutsideDomain)), self.knots_s, self.coefficients)


def _check_finite(**values: float) -> None:
    """Check that each value is a finite real number.

    Raises:
        OutsideDomain: a value is not. The message contains its name.
    """
    check_number(**values)
    for name, value in values.items():
        if not np.isfinite(value):
            raise OutsideDomain(f"{name} must be finite, got {value!r}")


@compiled(part=True)
def phase_at(t: float, segment: int, knots: Array, coefficients: Array, out: Array) -> int:
    """Write (ψ, ω, α) at t to out. Returns the segment, a hint for the next call."""
    last = len(knots) - 2
    while segment < last and t >= knots[segment + 1]:
        segment += 1
    while segment > 0 and t < knots[segment]:
        segment -= 1
    c = coefficients[segment]
    s = t - knots[segment]
    if t < knots[0] or t > knots[last + 1]:  # constant speed outside the range
        edge = 0.0 if t < knots[0] else knots[last + 1] - knots[segment]
        speed = c[1] + edge * (2 * c[2] + edge * 3 * c[3])
        out[0] = c[0] + edge * (c[1] + edge * (c[2] + edge * c[3])) + speed * (s - edge)
        out[1], out[2] = speed, 0.0
        return segment
    out[0] = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    out[1] = c[1] + s * (2 * c[2] + s * 3 * c[3])
    out[2] = 2 * c[2] + 6 * c[3] * s
    return segment


@compiled
def _phases(times: Array, knots: Array, coefficients: Array) -> Array:
    out = np.empty((len(times), 3))
    segment = 0
    for i in range(len(times)):
        segment = phase_at(times[i], segment, knots, coefficients, out[i])
    return out
