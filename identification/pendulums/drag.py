"""A torque proportional to the square of the speed, found by transients in addition to the viscous one.

A spin-down alone does not separate the air's drag from friction with the contact force (rig_configs.drag), so its
result is stored as one quantity Q. The roots L of its covariance LLᵀ are two errors that the damping, releases and
predictions share, in c3 and c4 by their correlation with Q times their own error. Masses and lengths change Q, M and c
by the same share, dQ/dp = Q · (dc/dp)/c. Source: docs/theory/pendulum_damping.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.pendulums.open_friction import DAMPING, OpenFriction, profile
from identification.pendulums.transient import TransientFit
from rig_basics.arrays import Array
from rig_configs.drag import LABELS, Drag
from rig_configs.error_label import ErrorLabel

_DAMPING_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")
_UNIT = np.array([1e-6, 1e-6, 1e-9, 1e-9])


@dataclass(frozen=True)
class FoundDrag:
    """Drag and its correlation with the damping.

    Attributes:
        drag: drag of A and B.
        correlation: correlation of c3 and c4 with each independent part of the drag's error, shape (2, 2).
    """

    drag: Drag
    correlation: Array

    def shifts(self, values: Mapping[str, float], std: Mapping[str, float]) -> dict[ErrorLabel, Array]:
        """Return the shifts of the values for one standard deviation of each part of the drag's error.

        Args:
            values: parameters by name, n of them.
            std: standard deviations of the values without shared errors, which are independent of the drag's error.
        Returns:
            Label → shift, shape (n,).
        """
        names = list(values)
        out = {label: np.zeros(len(names)) for label in LABELS}
        for name, row in zip(_DAMPING_NAMES, self.correlation, strict=True):
            if name in names:
                for label, share in zip(LABELS, row.tolist(), strict=True):
                    out[label][names.index(name)] = share * std[name]
        return out


def drag_by_spin_down(found: OpenFriction) -> FoundDrag:
    """Return the drag of a spin-down: the most likely F ≥ 0 with M ≥ 0 on a rotor at rest.

    Its standard deviation is the longer side of the 95 % interval over 1.96.

    Args:
        found: result of the spin-down with free friction.
    """
    values, std = np.zeros(2), np.zeros(2)
    for i in range(2):
        at = [4 + i, 2, 3, 5 - i]
        unit = np.r_[_UNIT[2], _UNIT[:2], _UNIT[2]]
        best, low, high = profile(found.values[at] / unit, found.covariance[np.ix_(at, at)] / np.outer(unit, unit), 0)
        values[i], std[i] = best * _UNIT[2], max(high - best, best - low) * _UNIT[2] / 1.96
    at = [*range(*DAMPING.indices(6)), 4, 5]
    spread = np.sqrt(np.diag(found.covariance)[at])
    together = found.covariance[np.ix_(at, at)] / np.outer(spread, spread)
    # for the same deceleration a heavier or longer pendulum has a proportionally larger torque of every kind
    by_number = {name: values * by[DAMPING] / found.values[DAMPING] for name, by in found.by_number.items()}
    drag = Drag(values, together[2:, 2:] * np.outer(std, std), True, by_number)
    # with LLᵀ the drag's covariance its independent errors are e = L⁻¹ δ, and corr(c, e) = corr(c, δ/s) (L/s)⁻ᵀ
    return FoundDrag(drag, together[:2, 2:] @ np.linalg.inv(drag.root / std[:, None]).T)


def with_undecided_drag(fit: TransientFit) -> TransientFit:
    """Return a spin-down's fit without information on the share of friction in its torque with the square of speed."""
    found = fit.open_friction
    shown = fit.friction is not None and fit.friction.speed_rad_s == 0 and max(fit.friction.contact_std_kg_m2) > 0
    return replace(fit, open_friction=found.without_contact_information()) if shown and found is not None else fit


def found_drag(fits: Sequence[TransientFit]) -> FoundDrag | None:
    """Return the torque with the square of the speed from the spin-downs; None if no spin-down found one.

    Args:
        fits: fits of all transients.
    """
    for fit in fits:
        friction, opened = fit.friction, fit.open_friction
        if friction is None or opened is None:
            continue
        if friction.speed_rad_s == 0 and max(friction.contact_std_kg_m2) > 0:
            return drag_by_spin_down(opened)
    return None
