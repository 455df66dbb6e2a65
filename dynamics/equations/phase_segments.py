"""The rotor's phase for a stepping method: every step stays on one cubic or has a known jump at each crossed knot.

A speed history is a piecewise cubic with constant speed outside its range. Here the two outer intervals are segments,
so that a method can evaluate any instant on the segment of its step. At the knot where a ramp ends, the step before it
has the acceleration of the ramp and the step after it has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array
from dynamics.compiled_code import compiled
from dynamics.equations.speed_history import SpeedHistory


@dataclass(frozen=True)
class PhaseSegments:
    """A speed history as segments for stepping.

    Attributes:
        knots: shape (n,), ascending, s. Segment j lies between knots[j − 1] and knots[j].
        origins: shape (n + 1,), s.
        cubics: shape (n + 1, 4): ψ = c0 + c1 s + c2 s² + c3 s³, s = t − origin.
        jumps: shape (n, 2): jumps of the acceleration (rad/s²) and of its rate (rad/s³) at each knot.
    """

    knots: Array
    origins: Array
    cubics: Array
    jumps: Array

    @classmethod
    def of(cls, history: SpeedHistory) -> PhaseSegments:
        """Segments of a history."""
        knots = np.ascontiguousarray(history.knots_s, float)
        inner = np.ascontiguousarray(history.coefficients, float)
        width = np.diff(knots)[-1]
        c0, c1, c2, c3 = inner[-1]
        first = [inner[0, 0], inner[0, 1], 0.0, 0.0]
        last = [c0 + width * (c1 + width * (c2 + width * c3)), c1 + width * (2 * c2 + width * 3 * c3), 0.0, 0.0]
        cubics = np.vstack([first, inner, last])
        origins = np.r_[knots[0], knots]
        before = 2 * cubics[:-1, 2] + 6 * cubics[:-1, 3] * (knots - origins[:-1])
        jumps = np.abs(np.column_stack([2 * cubics[1:, 2] - before, 6 * np.diff(cubics[:, 3])]))
        return cls(knots, origins, cubics, jumps)

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """knots, origins, cubics, jumps: arguments of compiled functions."""
        return self.knots, self.origins, self.cubics, self.jumps

    def phase(self, time_s: float) -> Array:
        """ψ (rad), ω (rad/s), α (rad/s²) at one instant, at a knot their values after it; shape (3,)."""
        out = np.empty(3)
        phase_within(time_s, 0, len(self.knots), self.knots, self.origins, self.cubics, out)
        return out


@compiled(part=True)
def segment_of(t: float, segment: int, knots: Array) -> int:
    """Segment that contains t (at a knot the later one), searched upwards from a given segment."""
    while segment < len(knots) and t >= knots[segment]:
        segment += 1
    return segment


@compiled
def phase_within(t: float, first: int, last: int, knots: Array, origins: Array, cubics: Array, out: Array) -> None:
    """Write (ψ, ω, α) at t to out, for a step that covers the segments first … last."""
    segment = first
    while segment < last and t >= knots[segment]:
        segment += 1
    s = t - origins[segment]
    c0, c1, c2, c3 = cubics[segment, 0], cubics[segment, 1], cubics[segment, 2], cubics[segment, 3]
    out[0] = c0 + s * (c1 + s * (c2 + s * c3))
    out[1] = c1 + s * (2.0 * c2 + s * 3.0 * c3)
    out[2] = 2.0 * c2 + 6.0 * c3 * s


def speed_crossings(segments: PhaseSegments, level_rad_s: float, from_s: float, to_s: float) -> Array:
    """Instants in [from_s, to_s] at which the speed crosses a level, ascending, s (exact: the speed is quadratic)."""
    edges, found = np.concatenate([[-np.inf], segments.knots, [np.inf]]), list[float]()
    for j in np.flatnonzero(np.any(segments.cubics[:, 2:] != 0.0, axis=1)):
        _, c1, c2, c3 = segments.cubics[j]
        roots = np.roots(np.trim_zeros([3 * c3, 2 * c2, c1 - level_rad_s], "f"))
        at = segments.origins[j] + roots[np.abs(roots.imag) == 0].real
        found.extend(at[(at >= edges[j]) & (at <= edges[j + 1]) & (at >= from_s) & (at <= to_s)].tolist())
    return np.unique(np.array(found, np.float64))
