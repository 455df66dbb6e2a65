"""Stable steady states of the model at a speed."""

from __future__ import annotations

from dynamics import RotorParameters, SteadyState, steady_states
from dynamics.errors import NotConverged

_ACCURACIES = (1e-6, 1e-5, 1e-4)


def stable_states(physics: RotorParameters, speed_rad_s: float) -> list[SteadyState]:
    """Return all stable states, to 1e-6 if possible.

    Damping that grows with the speed has a kink where the motion reverses. Multipliers along such an orbit may be
    accurate to 1e-5 only. The search is therefore repeated with lower accuracies.

    Raises:
        DynamicsError: as `dynamics.steady_states`, at the lowest accuracy.
        numpy.linalg.LinAlgError: a linear system has no solution.
    """
    for accuracy in _ACCURACIES[:-1]:
        try:
            found = steady_states(physics, speed_rad_s, accuracy)
        except NotConverged:  # usual: the next accuracy is lower
            continue
        stable = [state for state in found if state.stable]
        if stable or not found.unresolved:
            return stable
    return [state for state in steady_states(physics, speed_rad_s, _ACCURACIES[-1]) if state.stable]
