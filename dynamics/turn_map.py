"""How neighbours of a motion move over whole revolutions of the rotor: derivatives of the once-a-revolution map.

The explicit steps of dynamics.explicit_steps taken with complex numbers: moved by iε in one component of the state,
the imaginary part over ε is the derivative of the same arithmetic, exact to rounding.
"""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynamics.explicit_steps import explicit_step
from dynamics.locked_motion import damping_rates
from dynamics.parameters import RotorParameters
from dynamics.phase_segments import PhaseSegments, phase_within
from dynamics.quick_rates import quick_rates
from dynamics.speed_history import SpeedHistory

_STEP_RAD = 0.5  # of the fastest oscillation: an error of about 1e-7 a revolution
_STABLE_REACH = 4.0  # radians of the fastest decay a step may take
_MOST_STEPS = 4000  # a revolution; beyond it the motion is too stiff or too slow for explicit steps


@njit(cache=True, error_model="numpy", nogil=True)
def _derivatives(states, steps, period, system, out):
    """Derivatives (8, 8) of the state after a revolution by the state before it, for states (n, 8), into out."""
    knots, origins, cubics = system[3], system[4], system[5]
    k, z, end = np.zeros((16, 8), np.complex128), np.empty(8, np.complex128), np.empty(8, np.complex128)
    phase, h = np.empty(3), period / steps
    for n in range(len(states)):
        for column in range(8):
            for i in range(8):
                z[i] = states[n, i]
            z[column] += 1e-30j
            for s in range(steps):
                phase_within(s * h, 1, 1, knots, origins, cubics, phase)
                quick_rates(z, phase[0], phase[1], phase[2], system[0], system[1], system[2], k, 0)
                explicit_step(z, s * h, h, 1, 1, system, k, end, phase)
                for i in range(8):
                    z[i] = end[i]
            for i in range(8):
                out[n, i, column] = z[i].imag * 1e30


def turn_derivatives(
    parameters: RotorParameters, speed_rad_s: float, states: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Derivatives of the state one revolution later, by the state.

    Args:
        parameters: without dry friction.
        states: at ψ = 0, shape (n, 8).
    Returns:
        Shape (n, 8, 8) in SI; None where explicit steps would be too many.
    """
    turning = float(np.max(np.abs(states[:, 6:]), initial=0.0))
    rate = max(speed_rad_s + turning, *parameters.natural_frequencies_rad_s) / _STEP_RAD
    rate = max(rate, max(damping_rates(parameters)) / _STABLE_REACH)
    period = 2 * math.pi / speed_rad_s
    if not rate * period < _MOST_STEPS:
        return None
    segments = PhaseSegments.of(SpeedHistory.constant(speed_rad_s))
    # one endless segment: the phase is linear everywhere
    system = (
        parameters.packed(), float(parameters.a.present), float(parameters.b.present),
        np.array([-np.inf, np.inf]), segments.origins, segments.cubics,
    )  # fmt: skip
    out = np.empty((len(states), 8, 8))
    _derivatives(np.ascontiguousarray(states), math.ceil(rate * period), period, system, out)
    return out
