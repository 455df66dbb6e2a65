"""Warnings about runs whose logs are incomplete."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daq.signals.run import Run

_MAX_PLACES = 5  # missing places of one log that are listed


def missing_warnings(runs: Sequence[Run]) -> list[str]:
    """Return one sentence for each run with an incomplete log, and for each test that did not reach its end."""
    warnings: list[str] = []
    for run in runs:
        missing = run.metadata.get("missing") or ()
        if missing:
            more = [f"and {len(missing) - _MAX_PLACES} more"] if len(missing) > _MAX_PLACES else []
            places = "; ".join([*missing[:_MAX_PLACES], *more])
            warnings.append(f"{Path(run.source).name}: the log is incomplete: {places}")
        if missed := run.metadata.get("not_reached"):
            warnings.append(f"{Path(run.source).name}: the test did not reach its end: {missed}")
    return warnings
