"""Runs side by side for cascades and order maps: measured, another run, simulated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.errors import NotEnoughData
from analysis.figures.order_vectors import changes_speed
from analysis.quantities.rotor_phase import phase_at, speed_at
from analysis.rig_model import RigModel
from analysis.simulated_run import simulate_run
from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.units import TO_RPM


@dataclass(frozen=True)
class PassageSignal:
    """One displacement over time with the rotor's phase: shapes (n,); s, m, rad."""

    time_s: Array
    value_m: Array
    phase_rad: Array


@dataclass(frozen=True)
class Passage:
    """One run as a column of a figure.

    Attributes:
        title: title of the column.
        signals: "x", "y" → displacement.
        run: run with the speed history.
        by_speed: whether the axis is the speed; else it is time.
        is_model: whether it is simulated.
    """

    title: str
    signals: dict[str, PassageSignal]
    run: Run
    by_speed: bool
    is_model: bool = False

    @property
    def level_label(self) -> str:
        """Label of the axis along the run."""
        return "speed, rpm" if self.by_speed else "time since the run's start, s"

    def level(self, time_s: Array) -> Array:
        """Return the positions of times on that axis."""
        return TO_RPM * speed_at(self.run, time_s) if self.by_speed else time_s

    def orders_Hz(self, time_s: Array) -> Array:
        """Return the frequency of 1× at times, Hz."""
        return speed_at(self.run, time_s) / (2 * np.pi)


def passages(run: Run, model: RigModel | None, over: Run | None) -> list[Passage]:
    """Return the columns: measured, other run, simulated run, as far as they exist.

    Raises:
        NotEnoughData: no index marks, or no displacement.
    """
    found = [_measured(run, "measured")]
    if over is not None:
        found.append(_measured(over, Path(over.source).name))
    simulated = None if model is None else simulate_run(run, model)
    if model is not None and simulated is not None:
        signals = {
            name: PassageSignal(simulated.time_s, values, simulated.phase_rad)
            for name, values in (("x", simulated.x_m), ("y", simulated.y_m))
            if name in found[0].signals
        }
        found.append(Passage(f"same run simulated, {model.name}", signals, run, found[0].by_speed, is_model=True))
    return found


def _measured(run: Run, title: str) -> Passage:
    by_speed = changes_speed(run)
    signals = {
        name: PassageSignal(time, values, phase_at(run, time))
        for name, time, values in (("x", run.x_time_s, run.x_m), ("y", run.y_time_s, run.y_m))
        if np.isfinite(values).any()
    }
    if not signals:
        raise NotEnoughData(f"{run.source}: expected displacements, the log has none")
    return Passage(title, signals, run, by_speed)
