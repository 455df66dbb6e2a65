"""An invalid setting or mass raises an error with an explanation, not a KeyError or a negative stiffness."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from identification import fit_ring_down, fit_run_up, fit_spin_down

TIME = np.arange(0, 5, 1e-3)
DECAY = 1e-3 * np.exp(-0.5 * TIME) * np.cos(20 * TIME) + 1e-6 * np.random.default_rng(0).standard_normal(len(TIME))


@pytest.mark.parametrize(
    "fit",
    [
        lambda setting: fit_ring_down(TIME, DECAY, setting=setting),
        lambda setting: fit_run_up(TIME, np.column_stack([DECAY, DECAY]), 10 * TIME**2, setting=setting),
        lambda setting: fit_spin_down(TIME, 10 * (1 - np.exp(-TIME)), setting=setting),
    ],
)
def test_there_are_three_settings(fit: Any) -> None:
    with pytest.raises(ValueError, match="setting: expected fast, balanced, reference, got 'slow'"):
        fit("slow")


@pytest.mark.parametrize("mass", [0.0, -1.0, np.nan])
def test_a_mass_is_above_zero(mass: float) -> None:
    with pytest.raises(ValueError, match="a mass above 0 kg"):
        fit_ring_down(TIME, DECAY, mass)
