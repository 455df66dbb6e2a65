"""Prior knowledge of the other parameters in the fits of the pendulums' transients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from dynamics.equations.parameters import Pendulum, RotorParameters
from identification.pendulums.friction import Friction
from rig_configs.known import BOW, DRAG, physical_numbers, with_number
from rig_configs.physical_numbers import PARAMETERS
from rig_configs.roles import USUAL_RELEASE_STD_S
from rig_configs.suspension_terms import TERMS, moved_term

NAMES = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")
NOMINAL_SHARE = tuple(PARAMETERS[name].design_share for name in NAMES)
"""Relative standard uncertainties of a rig file's k1, k2, ζ1, ζ2, S_P."""


@dataclass(frozen=True)
class Knowledge:
    """Parameters with independent relative uncertainties.

    Attributes:
        physics: best values so far.
        log_std: standard deviation of the logarithm of k1, k2, ζ1, ζ2, S_P, shape (5,).
        friction: dry friction found by a spin-down; None if no friction is known.
        numbers: physical numbers by which derivatives of a result are required.
        by_number: number → derivative of the logarithms of k1, k2, ζ1, ζ2, S_P by it in the tests so far, shape (5,).
        number_std: number that may be free in a release → its standard uncertainty, in its unit.
        terms: names of TERMS of the suspension by which derivatives of a result are required.
        release_std_s: standard uncertainty of the instant at which a lock opens after its message, s.
    """

    physics: RotorParameters
    log_std: np.ndarray
    friction: Friction | None = None
    numbers: tuple[str, ...] = ()
    by_number: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    number_std: Mapping[str, float] = field(default_factory=dict[str, float])
    terms: tuple[str, ...] = ()
    release_std_s: float = USUAL_RELEASE_STD_S

    @classmethod
    def nominal(cls, physics: RotorParameters) -> Knowledge:
        """Create prior knowledge from a rig file's numbers with the uncertainties NOMINAL_SHARE."""
        numbers = tuple(name for name, value in physical_numbers(physics).items() if value)
        return cls(physics, np.array(NOMINAL_SHARE), numbers=numbers)

    def moved(self, number: str, step: float) -> Knowledge:
        """Return the knowledge with one physical number larger by a step, and the test results that depend on it.

        Args:
            number: physical number, component of BOW, or one of DRAG or TERMS.
            step: change of the number, in its unit.
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
        """Return the knowledge with measured values and their uncertainties; the pendulums' damping is not changed."""
        log_std = self.log_std.copy()
        for i, name in enumerate(NAMES):
            if name in values:
                # lower bound by the errors of integration and model
                log_std[i] = max(std[name] / abs(values[name]), 1e-6)
        found = {n: values[n] for n in NAMES if n in values}
        return replace(self, physics=self.physics.with_values(**found), log_std=log_std)

    def with_slopes(self, values: Mapping[str, float], by_number: Mapping[str, Mapping[str, float]]) -> Knowledge:
        """Return the knowledge with derivatives of measured values by the known numbers.

        Args:
            values: measured values by parameter.
            by_number: number → parameter → derivative.
        """
        slopes = {
            number: np.array([by.get(name, 0.0) / values[name] if values.get(name) else 0.0 for name in NAMES])
            for number, by in by_number.items()
        }
        return replace(self, by_number=slopes)
