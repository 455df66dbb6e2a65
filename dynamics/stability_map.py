"""Largest multiplier of the balanced state over a plane of speed ratio and stiffness ratio."""

from __future__ import annotations

import dataclasses

import numpy as np

from dynamics.errors import NotConverged
from dynamics.parameters import RotorParameters
from dynamics.steady_states import _TURN, _half_turn, _steps, balanced_angles


def stability_map(
    parameters: RotorParameters, speed_ratios: np.ndarray, stiffness_ratios: np.ndarray, accuracy: float = 1e-3
) -> np.ndarray:
    """Largest modulus of the Type I multipliers over one revolution on a grid.

    Args:
        parameters: the rig; k1 and the damping ratios stay, k2 = K k1.
        speed_ratios: Ω = ω/ω_n1, shape (n,), above 0.
        stiffness_ratios: K = k2/k1, shape (m,), above 0.
        accuracy: wanted absolute error of a multiplier.
    Returns:
        shape (m, n), row by stiffness ratio.
    Raises:
        NotConverged: no balanced state exists for these first mass moments.
    """
    angles = balanced_angles(parameters)
    if not angles:
        raise NotConverged("no balanced state: it needs |S_A − S_B| ≤ S_P ≤ S_A + S_B")
    start = np.zeros(8)
    start[2:4] = angles[0]
    derivatives = np.empty((len(stiffness_ratios), len(speed_ratios), 8, 8))
    for i, ratio in enumerate(stiffness_ratios):
        rig = dataclasses.replace(parameters, k2_N_per_m=float(ratio) * parameters.k1_N_per_m)
        packed = rig.packed()
        for j, speed_ratio in enumerate(speed_ratios):
            speed = rig.speed_rad_s(float(speed_ratio))
            derivatives[i, j] = _half_turn(start, speed, _steps(rig, speed, accuracy), packed, True)[1]
    halves = np.linalg.eigvals(_TURN[:, None] * derivatives)
    return np.max(np.abs(halves), axis=-1) ** 2
