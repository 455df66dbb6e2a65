"""Correction of laser readings for run-out, so that they contain only the disk's motion."""

from __future__ import annotations

import numpy as np

from identification.tracking.phase_clock import PhaseClock
from rig_basics.arrays import Array


def without_run_out(rows: Array, phase: PhaseClock, run_out_m: tuple[complex, complex]) -> Array:
    """Return readings with the run-out subtracted from those of the lasers.

    Args:
        rows: time, component, reading and variance, shape (n, 4).
        phase: rotor phase. Without marks the rows are returned unchanged.
        run_out_m: complex r_x, r_y, m. The lasers measure Re(r_x e^{iψ}) and Im(r_y e^{iψ}) in addition to the motion.
    """
    if not phase.known:
        return rows
    out, turn = rows.copy(), np.exp(1j * phase.at(rows[:, 0])[:, 0])
    for component, r in enumerate((run_out_m[0], -1j * run_out_m[1])):
        own = rows[:, 1] == component
        out[own, 2] -= np.real(r * turn[own])
    return out
