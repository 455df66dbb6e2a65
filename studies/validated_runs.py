"""Validation of loaded runs for the commands, and storage of the verdicts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from analysis.start_ups import START_UPS
from analysis.validation import Validation, validate
from daq.errors import RecordingError
from daq.log.verdicts import LoggedVerdict, keep_verdict, verdict_path
from daq.signals.run import Run
from daq.version import software_version
from identification.release_check import check_releases, check_run_ups
from rig_configs import IdentifiedParameters, Rig


def validated(
    runs: Sequence[Run],
    rig: Rig,
    known: IdentifiedParameters,
    notify: Callable[[str], None],
    axis_angle_deg: tuple[float, float] | None = None,
    set_by_hand: Collection[str] = (),
) -> Validation:
    """Validate points, and releases and further run-ups if the rig file requests them.

    Args:
        runs: loaded runs.
        rig: rig file.
        known: identified parameters.
        notify: called with a sentence on the current work.
        axis_angle_deg: replaces the identified angle, with its standard uncertainty.
        set_by_hand: parameters set by a what-if, which no run has identified.
    Returns:
        Its warnings include releases that deviate from the model, and run-ups that were not compared.
    """
    if not rig.validation.releases:
        return validate(runs, rig, known, axis_angle_deg, exact=set_by_hand)
    releases = check_releases(runs, rig, known, notify, set_by_hand)
    run_ups = check_run_ups(runs, rig, known, notify)
    found = validate(runs, rig, known, axis_angle_deg, [*releases, *run_ups], set_by_hand)
    left_out = [f"release at {each.point}: {each.sentence}" for each in releases if not each.followed]
    left_out += [f"{each.point} not compared: {each.sentence}" for each in run_ups if not each.rows]
    return replace(found, of_releases=[*found.of_releases, *left_out])


def keep_verdicts(found: Validation, runs: Sequence[Run], parameters: str) -> list[str]:
    """Store each point's verdict next to its log, for `rig logs`; return errors in words, one for each cause.

    Args:
        found: validation.
        runs: validated runs.
        parameters: parameter set of the model.
    """
    digests = {run.source: str(run.metadata["digest"]) for run in runs}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    faults: dict[str, list[str]] = {}
    repeated = [(START_UPS, each) for series in found.start_ups for each in series.results]
    for name, point in [*found.points.items(), *repeated]:
        if point.source not in digests:  # the point has no log
            continue
        verdict = LoggedVerdict(
            verdict=point.verdict,
            state=point.state,
            why=point.why,
            point=name,
            parameters=parameters,
            software=software_version(),
            judged_at=now,
            digest=digests[point.source],
        )
        try:
            keep_verdict(point.source, verdict)
        except RecordingError as fault:
            faults.setdefault(str(fault), []).append(verdict_path(Path(point.source)).name)
    return [f"{fault}: {', '.join(names)}" for fault, names in faults.items()]
