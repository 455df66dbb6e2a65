"""Recordings on the virtual rig through its drivers, wire bytes and logs, and their measured values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.results import PointResult
from daq.lockstep.rehearsal import Rehearsal
from daq.signals.run import Run
from identification import identify
from reproduction.errors import NoDataOfSeries
from rig_configs import IdentifiedParameters, Rig
from studies.runs import load_runs
from studies.validated_runs import validated

BEFORE_POINTS = ("ring-down-x", "ring-down-y", "spin-down", "run-up")
"""Tests that identify a rig before its points are run."""


@dataclass(frozen=True)
class KnownRig:
    """A virtual rig and its identified parameters.

    Attributes:
        name, settings: name of the rig file, and settings over it.
        rig: the rig file with its ports.
        parameters: identified from its logs.
    """

    name: str
    settings: tuple[str, ...]
    rig: Rig
    parameters: IdentifiedParameters


def known_rig(name: str, settings: Sequence[str], folder: Path) -> KnownRig:
    """Record the tests that identify a rig, and identify it.

    Args:
        name: name of a shipped rig file with a [virtual] table.
        settings: "key=value" over it; `virtual.seed` draws its noise and calibration errors.
        folder: of the logs.
    """
    with Rehearsal(name, folder, list(settings)) as rehearsal:
        logs = [rehearsal.record(test).log for test in BEFORE_POINTS]
        found = identify(load_runs(logs), rehearsal.rig)
        return KnownRig(name, tuple(settings), rehearsal.rig, found.parameters)


def recorded_point(known: KnownRig, point: str, folder: Path) -> tuple[Run, PointResult]:
    """Run a point on an identified rig and compare it with the model.

    Raises:
        NoDataOfSeries: the log does not contain the point.
    """
    with Rehearsal(known.name, folder, list(known.settings)) as rehearsal:
        log = rehearsal.record(f"point-{point}", known.parameters).log
        runs = load_runs([log])
        judged = validated(runs, rehearsal.rig, known.parameters, _ignore)
    if point not in judged.points:
        raise NoDataOfSeries(f"{log}: expected the point {point}, found {', '.join(judged.points) or 'none'}")
    return runs[0], judged.points[point]


def _ignore(text: str) -> None:
    del text
