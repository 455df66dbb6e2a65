# pyright: strict
"""Readings of lasers that see run-out, as the filter takes them: of the disk's motion alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from identification.tracking.phase_clock import PhaseClock

Array = NDArray[np.float64]


def without_run_out(rows: Array, phase: PhaseClock, run_out_m: tuple[complex, complex]) -> Array:
    """Rows (time, component, reading, variance), shape (n, 4), with the lasers' as of round surfaces.

    Args:
        phase: where no marks have told it, the rows stay as they are.
        run_out_m: complex r_x, r_y; the lasers show Re(r_x e^{iψ}) and Im(r_y e^{iψ}) beside the motion.
    """
    if not phase.known:
        return rows
    out, turn = rows.copy(), np.exp(1j * phase.at(rows[:, 0])[:, 0])
    for component, r in enumerate((run_out_m[0], -1j * run_out_m[1])):
        own = rows[:, 1] == component
        out[own, 2] -= np.real(r * turn[own])
    return out
