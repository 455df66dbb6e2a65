"""Terms of the suspension in a prediction: uncertain terms, their effects and those of their errors."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynamics import SteadyState
from rig_basics.arrays import Array
from rig_configs import IdentifiedParameters, Rig
from rig_configs.error_label import ErrorLabel
from rig_configs.suspension_terms import TERMS

TERM_STEPS: Mapping[str, float] = dict(zip(TERMS, (10.0, 10.0, 3e-3, 3e-3), strict=True))
"""Steps of differences by the terms, in their units."""
_MIN_SHARE = 5e-4  # least reported change of stiffness or damping


def uncertain_terms(identified: IdentifiedParameters) -> list[str]:
    """Return the terms of the suspension that are identified or likely."""
    terms = identified.terms
    return [] if terms is None else [n for n, std in zip(TERMS, terms.std.tolist(), strict=True) if std > 0]


def term_errors(rig: Rig, identified: IdentifiedParameters, by_term: Mapping[str, Array]) -> dict[ErrorLabel, Array]:
    """Return label → shift of dependent quantities per standard deviation of an error of the suspension's terms.

    Args:
        rig: rig file with the uncertainties of the gains.
        identified: parameters with the terms.
        by_term: derivative of the quantities by each term.
    """
    if identified.terms is None or not by_term:
        return {}
    errors = identified.terms.errors(rig.roles.gain_stds)
    at = {name: TERMS.index(name) for name in by_term}
    return {
        label: np.sum([by * shift[at[name]] for name, by in by_term.items()], axis=0) for label, shift in errors.items()
    }


def effects(identified: IdentifiedParameters, state: SteadyState, speed_rad_s: float) -> str:
    """Describe the effect of the identified terms on stiffness and damping of a steady orbit; empty without terms.

    At the amplitude a along its direction a spring has the stiffness k (1 + ¾ H a²) and a damper the damping ratio
    ζ (1 + (8/3π) Q ω a) (docs/theory/ring_down.md).
    """
    if identified.terms is None:
        return ""
    amplitudes = (abs(state.x_m), abs(state.y_m))
    parts: list[str] = []
    for i, (name, value) in enumerate(zip(TERMS, identified.terms.values.tolist(), strict=True)):
        a = amplitudes[i % 2]
        share = 0.75 * value * a**2 if i < 2 else 8 / (3 * math.pi) * value * speed_rad_s * a
        if name in identified.terms.found and abs(share) >= _MIN_SHARE:
            what = f"{'k' if i < 2 else 'ζ'}{i % 2 + 1}"
            side = "above" if share > 0 else "below"
            parts.append(f"{what} is {100 * abs(share):.2g} % {side} its value at zero amplitude ({1e3 * a:.2f} mm)")
    return ", ".join(parts)
