"""Runs of logs for the commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from daq.log.time_span import TimeSpan
from daq.log.verdicts import digest_of
from daq.signals.run import Run, load_run

WHOLE = TimeSpan()


def load_runs(logs: Sequence[str | Path], span: TimeSpan = WHOLE) -> list[Run]:
    """Load the runs of several logs, or the same part of each, with the digests of the files in their metadata."""
    return [_with_digest(load_run(path, span), Path(path)) for path in logs]


def _with_digest(run: Run, path: Path) -> Run:
    return replace(run, metadata={**run.metadata, "digest": digest_of(path)})
