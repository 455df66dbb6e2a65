"""Ring-down with a single working laser: selection of the laser, and fit of its direction."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.signals.run import Run
from identification.errors import NotIdentifiable
from identification.methods import pulled_along
from identification.ring_down.fit import fit_ring_down
from identification.ring_down.result import RingDownFit
from identification.setting import Setting
from rig_configs.roles import AXIS_TOLERANCE_DEG


def living_lasers(run: Run) -> tuple[Run, list[str]]:
    """Remove the readings of a dead laser (none, or constant) if the other laser works. Return messages, too."""
    readings = {"x": run.x_m, "y": run.y_m}
    dead = [a for a, r in readings.items() if len(r) and not np.any(np.diff(r[np.isfinite(r)]))]
    if len(dead) != 1:
        return run, []
    (axis,), none = dead, np.empty(0)
    gone = {f"{axis}_time_s": none, f"{axis}_m": none}
    finite = readings[axis][np.isfinite(readings[axis])]
    what = f"reads {1e3 * finite[0]:.6g} mm throughout" if len(finite) else "has no valid reading"
    return replace(run, **gone), [f"{Path(run.source).name}: laser {axis} {what}; check its cable and its range"]


def fit_one_laser(
    run: Run,
    mass: float,
    setting: Setting,
    without: Collection[str] = (),
    notify: Callable[[str], None] | None = None,
) -> RingDownFit:
    """Fit the direction along which the column was pulled, from the laser of this direction.

    Raises:
        NotIdentifiable, FitFailed: as in fit_ring_down; NotIdentifiable also if the laser of the pulled direction does
            not work or the lasers are turned.
    """
    seen = "x" if len(run.x_time_s) else "y"
    if abs(run.turn_deg) > AXIS_TOLERANCE_DEG:
        raise NotIdentifiable(
            f"{run.source}: only laser {seen} works, and it stands turned by {run.turn_deg:g}°: it measures a "
            "combination of both directions"
        )
    pulled = pulled_along(run.test)
    if pulled is not None and pulled != seen:  # laser x may show either direction after a pull along y
        raise NotIdentifiable(f"{run.source}: pulled along {pulled}, but only laser {seen} works in it")
    time_s, value_m = (run.x_time_s, run.x_m) if seen == "x" else (run.y_time_s, run.y_m)
    return fit_ring_down(time_s, value_m, mass, setting=setting, without=without, axis=seen, notify=notify)
