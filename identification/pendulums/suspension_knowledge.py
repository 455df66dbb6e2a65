"""What is known of the other parameters when the pendulums' transients are fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.equations.parameters import RotorParameters
from identification.pendulums.friction import Friction

NAMES = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
NOMINAL_SHARE = (0.15, 0.15, 0.7, 0.7, 0.05)  # what a rig file's numbers are worth


@dataclass(frozen=True)
class Knowledge:
    """Parameters with independent relative uncertainties.

    Attributes:
        physics: the rig with the best values so far.
        log_std: standard deviation of the logarithm of k1, k2, ζ1, ζ2, S_P, shape (5,).
        friction: dry friction that a spin-down found; None where none is known of.
    """

    physics: RotorParameters
    log_std: np.ndarray
    friction: Friction | None = None

    @classmethod
    def nominal(cls, physics: RotorParameters) -> Knowledge:
        """A rig file's numbers, trusted as far as such numbers go."""
        return cls(physics, np.array(NOMINAL_SHARE))

    def with_found(self, values: dict[str, float], std: dict[str, float]) -> Knowledge:
        """The same with measured values where there are any; damping of the pendulums is not touched."""
        log_std = self.log_std.copy()
        for i, name in enumerate(NAMES):
            if name in values:
                # no tighter than integration and model carry
                log_std[i] = max(std[name] / abs(values[name]), 1e-6)
        found = {n: values[n] for n in NAMES if n in values}
        return Knowledge(self.physics.with_values(**found), log_std, self.friction)
