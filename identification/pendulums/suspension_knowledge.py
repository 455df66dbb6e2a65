"""What is known of the other parameters when the pendulums' transients are fitted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from dynamics.equations.parameters import Pendulum, RotorParameters
from identification.pendulums.friction import Friction
from rig_configs.known import DRAG, physical_numbers, with_number
from rig_configs.suspension_terms import TERMS, moved_term

NAMES = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
BOW = ("bow_x_m", "bow_y_m")
"""Components of a bow, by their places in RotorParameters."""
NOMINAL_SHARE = (0.15, 0.15, 0.7, 0.7, 0.05)  # what a rig file's numbers are worth


@dataclass(frozen=True)
class Knowledge:
    """Parameters with independent relative uncertainties.

    Attributes:
        physics: the rig with the best values so far.
        log_std: standard deviation of the logarithm of k1, k2, ζ1, ζ2, S_P, shape (5,).
        friction: dry friction that a spin-down found; None where none is known of.
        numbers: physical numbers whose effect on an answer is wanted.
        by_number: number → derivative of the logarithms of k1, k2, ζ1, ζ2, S_P by it, shape (5,), as the tests so far
            have found them with that number.
        number_std: number → its standard uncertainty, in its unit, of those that a release may leave open.
        terms: of the suspension's TERMS those whose effect on an answer is wanted.
    """

    physics: RotorParameters
    log_std: np.ndarray
    friction: Friction | None = None
    numbers: tuple[str, ...] = ()
    by_number: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    number_std: Mapping[str, float] = field(default_factory=dict[str, float])
    terms: tuple[str, ...] = ()

    @classmethod
    def nominal(cls, physics: RotorParameters) -> Knowledge:
        """A rig file's numbers, trusted as far as such numbers go."""
        numbers = tuple(name for name, value in physical_numbers(physics).items() if value)
        return cls(physics, np.array(NOMINAL_SHARE), numbers=numbers)

    def moved(self, number: str, step: float) -> Knowledge:
        """The same with one physical number larger by a step, and with it what the tests have found.

        Args:
            number: or a component of BOW, or one of DRAG or TERMS.
            step: in the number's unit.
        """
        if number in BOW:
            return replace(self, physics=replace(self.physics, **{number: getattr(self.physics, number) + step}))
        if number in DRAG:
            part = "ab"[DRAG.index(number)]
            own: Pendulum = getattr(self.physics, part)
            own = replace(own, drag_Nms2_per_rad2=own.drag_Nms2_per_rad2 + step)
            return replace(self, physics=replace(self.physics, **{part: own}))
        if number in TERMS:
            return replace(self, physics=moved_term(self.physics, number, step))
        physics = with_number(self.physics, number, physical_numbers(self.physics)[number] + step)
        found = physics.identified()
        shift = np.exp(self.by_number.get(number, np.zeros(len(NAMES))) * step)
        values = {name: found[name] * float(factor) for name, factor in zip(NAMES, shift, strict=True)}
        return replace(self, physics=physics.with_values(**values))

    def with_found(self, values: dict[str, float], std: dict[str, float]) -> Knowledge:
        """The same with measured values where there are any; damping of the pendulums is not touched."""
        log_std = self.log_std.copy()
        for i, name in enumerate(NAMES):
            if name in values:
                # no tighter than integration and model carry
                log_std[i] = max(std[name] / abs(values[name]), 1e-6)
        found = {n: values[n] for n in NAMES if n in values}
        return replace(self, physics=self.physics.with_values(**found), log_std=log_std)

    def with_slopes(self, values: Mapping[str, float], by_number: Mapping[str, Mapping[str, float]]) -> Knowledge:
        """The same with how found values go with the known numbers.

        Args:
            values: what was found, by parameter.
            by_number: number → parameter → derivative.
        """
        slopes = {
            number: np.array([by.get(name, 0.0) / values[name] if values.get(name) else 0.0 for name in NAMES])
            for number, by in by_number.items()
        }
        return replace(self, by_number=slopes)
