# pyright: strict
"""The stable steady states of the model at a speed."""

from __future__ import annotations

from dynamics import RotorParameters, SteadyState, steady_states
from dynamics.errors import NotConverged

_ACCURACIES = (1e-6, 1e-5, 1e-4)


def stable_states(physics: RotorParameters, speed_rad_s: float) -> list[SteadyState]:
    """All that are found, to 1e-6 where that can be had.

    A damping that grows with the speed has a kink where the motion turns back, and multipliers along such an orbit may
    be had to 1e-5 only. A state is then no reason to say that there is none.

    Raises:
        DynamicsError: as `dynamics.steady_states`, at the least accuracy.
        LinAlgError: as numpy.linalg.
    """
    for accuracy in _ACCURACIES[:-1]:
        try:
            found = steady_states(physics, speed_rad_s, accuracy)
        except NotConverged:
            continue
        stable = [state for state in found if state.stable]
        if stable or not found.unresolved:
            return stable
    return [state for state in steady_states(physics, speed_rad_s, _ACCURACIES[-1]) if state.stable]
