"""Runs of logs for the commands, and the verdicts kept beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from daq.errors import RecordingError
from daq.log.verdicts import Verdict, digest_of, keep_verdict
from daq.signals.run import Run, load_run
from daq.version import software_version

if TYPE_CHECKING:
    from analysis.validation import Validation


def load_runs(logs: Sequence[str | Path]) -> list[Run]:
    """Runs of several logs, each with its file's digest in its metadata."""
    return [_with_digest(load_run(path), Path(path)) for path in logs]


def _with_digest(run: Run, path: Path) -> Run:
    return replace(run, metadata={**run.metadata, "digest": digest_of(path)})


def keep_verdicts(found: Validation, runs: Sequence[Run], parameters: str) -> list[str]:
    """Keep each point's verdict beside the log it was found in, for `rig logs`; returns what could not be kept.

    Args:
        parameters: which parameter set the model had.
    """
    from analysis.start_ups import START_UPS  # noqa: PLC0415 (scipy takes a second to import)

    digests = {run.source: str(run.metadata["digest"]) for run in runs}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    faults = []
    repeated = [(START_UPS, each) for series in found.start_ups for each in series.results]
    for name, point in [*found.points.items(), *repeated]:
        if point.source not in digests:  # the point has no log: nothing to keep it beside
            continue
        verdict = Verdict(
            verdict=point.verdict, state=point.state, why=point.why, point=name, parameters=parameters,
            software=software_version(), judged_at=now, digest=digests[point.source],
        )  # fmt: skip
        try:
            keep_verdict(point.source, verdict)
        except RecordingError as fault:
            faults.append(str(fault))
    return faults
