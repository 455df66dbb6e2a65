"""Derivatives of identified values by the moving masses: k = M ω² is proportional to M for a measured ω."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rig_configs.known import MASSES


def mass_slopes(names: Sequence[str], values: NDArray[np.float64], mass_kg: float) -> dict[str, NDArray[np.float64]]:
    """Derivatives of identified values by each mass that moves with the disk centre, shape (n,) each, per kg.

    Args:
        names: parameters. The stiffnesses among them are proportional to the mass.
        values: shape (n,), SI.
        mass_kg: total moving mass, kg.
    """
    slope = np.array(
        [value / mass_kg if name.startswith("k") else 0.0 for name, value in zip(names, values, strict=True)]
    )
    return dict.fromkeys(MASSES, slope)
