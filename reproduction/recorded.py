"""Points recorded on the virtual rig through its drivers and logs, with their measured values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from analysis import SteadyMeasurement, measure
from daq.lockstep.rehearsal import Rehearsal
from daq.signals.run import Run
from rig_configs import Rig, load_rig
from studies.runs import load_runs


@dataclass(frozen=True)
class Recorded:
    """A point's log and what it shows.

    Attributes:
        rig: the rig file with its settings.
        run: signals on one clock.
        measured: measured values with uncertainties.
        missed: what the guided test did not reach; "" for nothing.
    """

    rig: Rig
    run: Run
    measured: SteadyMeasurement
    missed: str


def as_stated(rig: str, settings: Sequence[str]) -> tuple[str, ...]:
    """Return settings that make a shipped rig's truth equal to its file, in addition to the given ones.

    The source identified its parameters before its comparison. Here they are given: the recording differs from the
    model only by sensors, clocks, locks, drive and noise.

    Args:
        rig: name of a shipped rig file.
        settings: "key=value".
    """
    loaded = load_rig(rig, settings=list(settings))
    assert loaded.virtual is not None
    stated: dict[str, Any] = loaded.model_dump()
    true = _leaves(loaded.virtual.truth.model_dump(exclude_none=True))
    return (*settings, *(f"virtual.truth.{'.'.join(path)}={_at(stated, path)!r}" for path in true))


def _leaves(table: Mapping[str, Any], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Return the paths of a table's numbers."""
    found = list[tuple[str, ...]]()
    for key, value in table.items():
        if isinstance(value, dict):
            found += _leaves(cast("dict[str, Any]", value), (*above, key))
        else:
            found.append((*above, key))
    return found


def _at(table: Mapping[str, Any], path: tuple[str, ...]) -> Any:
    found: Any = table
    for key in path:
        found = found[key]
    return found


_KEPT: dict[tuple[str, tuple[str, ...], int, str], tuple[Recorded, ...]] = {}


def recorded_points(
    folder: Path, rig: str, settings: tuple[str, ...], count: int = 1, point: str = "above"
) -> tuple[Recorded, ...]:
    """Record and measure start-ups to a point's speed, each with a release, until the motion is steady.

    Items of one group share the recordings: equal ones are recorded once in a process.

    Args:
        folder: of the logs, if they are not recorded yet.
        rig: name of a shipped rig file.
        settings: "key=value".
        count: number of start-ups; the locks' play is drawn again for each.
        point: the point with the speed.
    """
    key = (rig, settings, count, point)
    if key not in _KEPT:
        with Rehearsal(rig, folder, settings) as opened:
            found = list[Recorded]()
            for _ in range(count):
                done = opened.record(f"point-{point}")
                (run,) = load_runs([done.log])
                found.append(Recorded(opened.rig, run, measure(run, opened.rig), done.missed))
        _KEPT[key] = tuple(found)
    return _KEPT[key]
