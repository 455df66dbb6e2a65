"""Derivatives of the once-a-revolution map: change of neighbouring motions over whole revolutions of the rotor.

The explicit steps of dynamics.motions.explicit_steps are applied to the state and, with the same coefficients, to its
derivatives by the initial state: K' = J (Y' + h Σ a K'), J the derivatives of the right-hand side in closed form. The
result is the derivative of the same arithmetic, exact to rounding, at an eighth of the cost of complex steps.
"""

from __future__ import annotations

import math

import numpy as np

from dynamics.arrays import Array, RealSystem
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import rates
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.phase_segments import PhaseSegments, phase_within
from dynamics.equations.quick_derivatives import rate_derivatives
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.explicit_steps import BEGIN, COLUMN, NODE, VALUE
from dynamics.motions.locked_motion import damping_rates

_STEP_RAD = 0.8  # step in radians of the fastest oscillation: an error of about 1e-6 per revolution
_STABLE_REACH = 4.0  # largest step in units of the fastest decay time
_MAX_STEPS = 4000  # per revolution; beyond it the motion is too stiff or too slow for explicit steps


@compiled(nogil=True, contract=True)
def _derivatives(states: Array, steps: int, period: float, system: RealSystem, out: Array) -> None:
    """Write derivatives (8, 8) of the state after a revolution by the state before it, for states (n, 8), to out."""
    p, free_a, free_b, knots, origins, cubics = system
    k, tangents, by_state = np.zeros((12, 8)), np.zeros((12, 8, 8)), np.zeros((4, 8))
    y, work, end, moved = np.empty(8), np.empty(8), np.empty((8, 8)), np.empty((8, 8))
    phase, h = np.empty(3), period / steps
    for n in range(len(states)):
        y[:] = states[n]
        end[:] = np.eye(8)
        for s in range(steps):
            for row in range(13):
                work[:] = y
                moved[:] = end
                for m in range(BEGIN[row], BEGIN[row + 1]):
                    a, j = h * VALUE[m], COLUMN[m]
                    for i in range(8):
                        work[i] += a * k[j, i]
                        for c in range(8):
                            moved[i, c] += a * tangents[j, i, c]
                if row == 12:
                    break
                phase_within((s + NODE[row]) * h, 1, 1, knots, origins, cubics, phase)
                rates(work, phase[0], phase[1], phase[2], p, free_a, free_b, k[row])
                rate_derivatives(work, phase[0], phase[1], p, free_a, free_b, by_state)
                for c in range(8):
                    tangents[row, 0, c], tangents[row, 1, c] = moved[4, c], moved[5, c]
                    tangents[row, 2, c], tangents[row, 3, c] = free_a * moved[6, c], free_b * moved[7, c]
                for i in range(4):
                    for c in range(8):
                        tangents[row, 4 + i, c] = 0.0
                    for m in range(8):
                        for c in range(8):
                            tangents[row, 4 + i, c] += by_state[i, m] * moved[m, c]
            y[:] = work
            end[:] = moved
        out[n] = end


def turn_derivatives(parameters: RotorParameters, speed_rad_s: float, states: Array) -> Array | None:
    """Derivatives of the state one revolution later by the state.

    Args:
        parameters: parameters without dry friction.
        states: states at ψ = 0, shape (n, 8).
    Returns:
        Shape (n, 8, 8) in SI, or None if too many explicit steps are needed.
    """
    turning = float(np.max(np.abs(states[:, 6:]), initial=0.0))
    rate = max(speed_rad_s + turning, *parameters.natural_frequencies_rad_s) / _STEP_RAD
    rate = max(rate, max(damping_rates(parameters)) / _STABLE_REACH)
    period = 2 * math.pi / speed_rad_s
    if not rate * period < _MAX_STEPS:
        return None
    segments = PhaseSegments.of(SpeedHistory.constant(speed_rad_s))
    # one infinite segment: the phase is linear everywhere
    system = (
        parameters.packed(),
        float(parameters.a.present),
        float(parameters.b.present),
        np.array([-np.inf, np.inf]),
        segments.origins,
        segments.cubics,
    )
    out = np.empty((len(states), 8, 8))
    _derivatives(np.ascontiguousarray(states), math.ceil(rate * period), period, system, out)
    return out
