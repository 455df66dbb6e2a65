# pyright: strict
"""The suspension's terms in what is predicted: which of them are uncertain, and what their errors do."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from rig_configs import IdentifiedParameters, Rig
from rig_configs.suspension_terms import TERMS

Array = NDArray[np.float64]

TERM_STEPS: Mapping[str, float] = dict(zip(TERMS, (10.0, 10.0, 3e-3, 3e-3), strict=True))
"""Steps of differences by the terms, in their units."""


def uncertain_terms(identified: IdentifiedParameters) -> list[str]:
    """Terms of the suspension that are found or likely."""
    terms = identified.terms
    return [] if terms is None else [n for n, std in zip(TERMS, terms.std.tolist(), strict=True) if std > 0]


def term_errors(rig: Rig, identified: IdentifiedParameters, by_term: Mapping[str, Array]) -> dict[str, Array]:
    """How errors of the suspension's terms shift what goes with them: label → shift for one standard deviation.

    Args:
        by_term: derivative of any quantities by each term.
    """
    if identified.terms is None or not by_term:
        return {}
    errors = identified.terms.errors(rig.roles.gain_stds)
    at = {name: TERMS.index(name) for name in by_term}
    return {
        label: np.sum([by * shift[at[name]] for name, by in by_term.items()], axis=0) for label, shift in errors.items()
    }
