# pyright: strict
"""What a person should know about runs whose logs do not hold all that was to be recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daq.signals.run import Run

_MOST_TOLD = 5  # missing places of one log


def missing_warnings(runs: Sequence[Run]) -> list[str]:
    """A sentence for each run whose log is not whole, or whose test did not reach its end."""
    warnings: list[str] = []
    for run in runs:
        missing = run.metadata.get("missing") or ()
        if missing:
            more = [f"and {len(missing) - _MOST_TOLD} more"] if len(missing) > _MOST_TOLD else []
            told = "; ".join([*missing[:_MOST_TOLD], *more])
            warnings.append(f"{Path(run.source).name}: the log is not whole: {told}")
        if missed := run.metadata.get("not_reached"):
            warnings.append(f"{Path(run.source).name}: the test did not reach its end: {missed}")
    return warnings
