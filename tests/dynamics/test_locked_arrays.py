"""Locked orbits and start states of many speeds and angles, for linear and other suspensions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from nominal import rig

from dynamics import OutsideDomain, locked_orbit, locked_state

SPEEDS, THETA = np.array([10.0, 20.0, 60.0]), np.array([[0.1], [0.4]])


@pytest.mark.parametrize("hardening", [0.0, 1e4])
def test_arrays_broadcast_and_agree_with_numbers(hardening: float) -> None:
    p = replace(rig(gravity_m_per_s2=9.81 if hardening else 0.0), hardening_per_m2=(hardening, 0.0))
    x, y = locked_orbit(p, SPEEDS, THETA, 3.0)
    states = locked_state(p, SPEEDS, 0.5, THETA, 3.0)
    assert x.shape == y.shape == (2, 3)
    assert states.shape == (2, 3, 8)
    for i, theta in enumerate(THETA[:, 0].tolist()):
        for j, speed in enumerate(SPEEDS.tolist()):
            assert (x[i, j], y[i, j]) == pytest.approx(locked_orbit(p, speed, theta, 3.0), rel=1e-12)
            assert states[i, j] == pytest.approx(locked_state(p, speed, 0.5, theta, 3.0), rel=1e-12)


def test_the_resonant_speed_of_several_is_named() -> None:
    p = rig(zeta=0.0)
    resonance = float(np.sqrt(p.k1_N_per_m / p.total_mass_kg))
    p = replace(p, k1_N_per_m=p.total_mass_kg * resonance * resonance)
    with pytest.raises(OutsideDomain, match=f"at {resonance:.6g} rad/s the rotor runs in an undamped resonance"):
        locked_orbit(p, [10.0, resonance])


def test_text_is_refused() -> None:
    with pytest.raises(OutsideDomain, match="theta3_rad: expected real numbers"):
        locked_orbit(rig(), 10.0, "a")  # type: ignore[call-overload]
