"""A rig at a constant speed as a map of its states over one revolution of the rotor."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dynamics.arguments import check_speed
from dynamics.arrays import Array, RealSystem
from dynamics.compiled_code import compiled
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.equations.phase_segments import PhaseSegments
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain
from dynamics.motions.locked_motion import damping_rates
from dynamics.stability.turn_map import turn_derivatives
from dynamics.steady.basins.pursuit import advance, steps_needed
from rig_basics.thread_pool import ThreadPool

STEP_RAD = 0.4
"""Step in radians of the fastest oscillation: an error of about 1e-9 per revolution."""
COARSE_RAD = 0.6
"""Coarse step in radians of the fastest oscillation: an error of about 1e-8 per revolution."""
_REACH = 10.0  # largest product of fastest decay and step, in units of STEP_RAD
_MAX_STEPS = 20_000.0  # per revolution
_MANY = 128  # number of states above which threads are used


@dataclass(frozen=True)
class RevolutionMap:
    """The once-a-revolution map of a rig.

    Attributes:
        parameters: parameters of the rotor, without dry friction.
        speed_rad_s: speed of the rotor.
    """

    parameters: RotorParameters
    speed_rad_s: float

    @classmethod
    def of(cls, rig: RigOrParameters, speed_rad_s: float) -> RevolutionMap:
        """The map of a rig.

        Raises:
            OutsideDomain: an invalid speed, no pendulum, dry friction, or motions too stiff for explicit steps.
        """
        p = physics_of(rig)
        check_speed(speed_rad_s, p.natural_frequencies_rad_s)
        if not (p.a.present or p.b.present):
            raise OutsideDomain("a release needs a pendulum: both masses are 0")
        if p.has_friction:
            raise OutsideDomain(
                "basins are defined for motion without dry friction, got friction_arm_m "
                f"{max(p.a.friction_arm_m, p.b.friction_arm_m):g}: set it to 0, or simulate single releases"
            )
        found = cls(p, float(speed_rad_s))
        if not found.pace / speed_rad_s * 2 * math.pi / STEP_RAD < _MAX_STEPS:
            raise OutsideDomain(
                f"at {speed_rad_s:.4g} rad/s the fastest rate, {found.pace:.3g} /s, takes more than {_MAX_STEPS:g} "
                "explicit steps a revolution; expected a faster rotor or weaker damping"
            )
        return found

    @property
    def period_s(self) -> float:
        """Time of a revolution, s."""
        return 2 * math.pi / self.speed_rad_s

    @cached_property
    def pace(self) -> float:
        """The fastest rate of suspension and damping that limits the step, 1/s."""
        return max(*self.parameters.natural_frequencies_rad_s, max(damping_rates(self.parameters)) / _REACH)

    @cached_property
    def system(self) -> tuple[Any, ...]:
        """Argument of compiled code: packed parameters, existing pendulums, one infinite segment of phase."""
        p, segments = self.parameters, PhaseSegments.of(SpeedHistory.constant(self.speed_rad_s))
        return (
            p.packed(),
            float(p.a.present),
            float(p.b.present),
            np.array([-np.inf, np.inf]),
            segments.origins,
            segments.cubics,
        )

    @property
    def there(self) -> tuple[int, ...]:
        """Existing pendulums: 0 for A, 1 for B."""
        return tuple(i for i, q in enumerate((self.parameters.a, self.parameters.b)) if q.present)

    @property
    def free(self) -> list[int]:
        """Components of the state that move."""
        return [0, 1, *(2 + i for i in self.there), 4, 5, *(6 + i for i in self.there)]

    @cached_property
    def units(self) -> Array:
        """Units in which the components of the state are comparable, shape (8,): displacements by sqrt(J/M_S)."""
        inertia = float(np.mean([(self.parameters.a, self.parameters.b)[i].inertia_kg_m2 for i in self.there]))
        length, w = math.sqrt(inertia / self.parameters.total_mass_kg), self.speed_rad_s
        return np.array([length, length, 1.0, 1.0, length * w, length * w, w, w])

    def after(self, states: Array, revolutions: int = 1, step_rad: float = STEP_RAD) -> Array:
        """States after a number of revolutions, shape (n, 8)."""
        out = np.array(states, np.float64)
        none = np.zeros((1, 0, 8))

        def part(some: Array) -> None:
            _many(some, self.speed_rad_s, revolutions, self.pace, step_rad, self.system, none)

        if len(out) < _MANY:
            part(out)
        else:
            workers = os.cpu_count() or 1
            with ThreadPool(workers) as pool:
                list(pool.map(part, np.array_split(out, workers)))
        return out

    def strobed(self, start: Array, revolutions: int) -> Array:
        """One state per revolution, the start included, shape (revolutions + 1, 8)."""
        track = np.empty((1, revolutions, 8))
        _many(np.array(start[None, :]), self.speed_rad_s, revolutions, self.pace, STEP_RAD, self.system, track)
        return np.concatenate([start[None, :], track[0]])

    def derivatives(self, states: Array) -> Array:
        """Derivatives of the map at each state, shape (n, 8, 8), SI.

        Raises:
            OutsideDomain: the motion is too stiff for explicit steps.
        """
        found = turn_derivatives(self.parameters, self.speed_rad_s, np.ascontiguousarray(states))
        if found is None:
            raise OutsideDomain("the motion is too stiff or the rotor too slow for explicit steps")
        return found

    def means(self, start: Array, revolutions: int = 1) -> tuple[float, float, float]:
        """Root mean square distance of the disk centre from its mean, m, and mean angles of A and B, rad."""
        means = np.zeros(3)
        motion = (self.speed_rad_s, self.pace, STEP_RAD, self.system)
        _means(np.array(start), revolutions, motion, means)
        return float(means[0]), float(means[1]), float(means[2])

    def mean_radius(self, start: Array, revolutions: int = 1) -> float:
        """Root mean square distance of the disk centre from its mean over some revolutions, m."""
        return self.means(start, revolutions)[0]


@compiled(nogil=True)
def _many(
    states: Array, omega: float, revolutions: int, pace: float, step_rad: float, system: RealSystem, track: Array
) -> None:
    k, work, phase, orbit = np.zeros((16, 8)), np.empty(8), np.empty(3), np.zeros(5)
    for i in range(len(states)):
        for n in range(revolutions):
            steps = steps_needed(states[i], omega, pace, step_rad)
            advance(states[i], omega, steps, system, k, work, phase, orbit)
            if i < len(track) and n < track.shape[1]:
                track[i, n] = states[i]


@compiled(nogil=True)
def _means(state: Array, revolutions: int, motion: tuple[float, float, float, RealSystem], means: Array) -> None:
    """Write rms radius and mean angles to means (3,)."""

    omega, pace, step_rad, system = motion
    k, work, phase, orbit, mean = np.zeros((16, 8)), np.empty(8), np.empty(3), np.zeros(5), np.zeros(3)
    for _ in range(revolutions):
        begin_a, begin_b = state[2], state[3]
        steps = steps_needed(state, omega, pace, step_rad)
        advance(state, omega, steps, system, k, work, phase, orbit)
        means[1] += orbit[3] + 0.5 * (begin_a - state[2]) / steps
        means[2] += orbit[4] + 0.5 * (begin_b - state[3]) / steps
        mean += orbit[:3]
    mean /= revolutions
    means[1] /= revolutions
    means[2] /= revolutions
    means[0] = math.sqrt(max(0.0, mean[2] - mean[0] ** 2 - mean[1] ** 2))
