"""Names the cause of a passage that the model does not explain: what contradicts phase, clock or locks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.signals.rotor_doubts import RotorDoubt, moved_pendulums, other_order, phase_jumps, sound_marks
from daq.signals.run import Run
from identification.errors import FitFailed, UnexplainedPassage
from identification.run_up.rotor_phase import PhaseHistory


def phase_of(run: Run) -> tuple[PhaseHistory, list[RotorDoubt]]:
    """Return the rotor's phase of a run, and what contradicts it and the locks of the pendulums, corrected or not."""
    if len(run.phase_time_s):
        phase = PhaseHistory.from_samples(run.phase_time_s, run.phase_rad)
        found = phase_jumps(run.phase_time_s, run.phase_rad)
    else:
        time_s, phase_rad, marks = sound_marks(run.mark_time_s, run.mark_phase_rad)
        phase, found = PhaseHistory.from_marks(time_s, phase_rad), list(marks)
    doubts = [*run.rotor_doubts, *found, *moved_pendulums(run.angle_time_s, run.angle_rad)]
    return phase, list(dict.fromkeys(doubts))


def explained(
    error: UnexplainedPassage,
    sensors: Sequence[tuple[np.ndarray, np.ndarray]],
    phase: PhaseHistory,
    doubts: Sequence[RotorDoubt],
) -> FitFailed:
    """Return the error with its causes: those that are not corrected, or else the order of the displacement.

    Args:
        error: the failed fit.
        sensors: times and displacements of x and y.
        phase: phase of the rotor.
        doubts: what contradicts phase and locks.
    """
    causes = [doubt for doubt in doubts if not doubt.mended] or _orders(sensors, phase)
    if causes:
        return FitFailed(f"{error}. {'; '.join(dict.fromkeys(doubt.words for doubt in causes))}")
    mended = "".join(f"; {doubt.words}" for doubt in doubts)
    return FitFailed(
        f"{error}. Marks, times and pendulum angles do not contradict it{mended}: look for a motion that the model "
        "does not contain, such as another disturbance of the rig"
    )


def _orders(sensors: Sequence[tuple[np.ndarray, np.ndarray]], phase: PhaseHistory) -> list[RotorDoubt]:
    """Return the order of the displacement if it is not the rotor's."""
    found: list[RotorDoubt] = []
    for time, value in sensors:
        inside = (time >= phase.start_s) & (time <= phase.end_s)
        found += other_order(phase.history.phase(time[inside])[:, 0], value[inside])
    return found
