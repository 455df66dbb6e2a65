"""Results of the packages below in the forms that JSON, terminal and report take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from analysis.plots.fit import FitCurve
from analysis.report.campaign import ConsistencyCheck, IdentificationResult, TestEstimate
from analysis.validation import Validation
from daq.errors import RecordingError
from daq.log.verdicts import Verdict, digest_of, keep_verdict
from daq.signals.run import Run, load_run
from daq.version import software_version
from identification import Identification
from rig_configs import PARAMETER_UNITS, IdentifiedParameters


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
    digests = {run.source: str(run.metadata["digest"]) for run in runs}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    faults = []
    for name, point in found.points.items():
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


def with_version(parameters: IdentifiedParameters, settings: Sequence[str] = ()) -> IdentifiedParameters:
    """The parameters with the software's version, and what was set beside the rig file, in their provenance."""
    said = {"settings": list(settings)} if settings else {}
    return replace(parameters, provenance={"software": software_version(), **said, **parameters.provenance})


def parameters_json(parameters: IdentifiedParameters) -> dict[str, dict[str, Any]]:
    """{name: {value, std, unit}}."""
    std = parameters.std
    return {
        name: {"value": value, "std": std[name], "unit": PARAMETER_UNITS[name]}
        for name, value in parameters.values.items()
    }


def identification_json(found: Identification) -> dict[str, Any]:
    """What `rig identify --json` prints."""
    return {
        "parameters": parameters_json(found.parameters),
        "correlation": {"order": list(found.parameters.values), "matrix": found.parameters.correlation.tolist()},
        "axis_angle_deg": {"value": found.axis_angle_deg, "std": found.axis_angle_std_deg},
        "tests": [
            {
                "test": e.test,
                "log": e.source,
                "values": dict(zip(e.names, e.values.tolist(), strict=True)),
                "std": e.std,
            }
            for e in found.estimates
        ],
        "consistency": [{"parameter": r.parameter, "test": r.test, "z": r.z, "p": r.p} for r in found.consistency],
        "warnings": found.warnings,
    }


def report_identification(found: Identification) -> IdentificationResult:
    """The identification in the report's own types."""
    estimates = [
        TestEstimate(e.test, e.source, dict(zip(e.names, e.values.tolist(), strict=True)), e.std)
        for e in found.estimates
    ]
    checks = [
        ConsistencyCheck(r.parameter, r.z, f"{r.test} against the other tests, p = {r.p:.2g}")
        for r in found.consistency
    ]
    fits = [
        FitCurve(
            f"{named.test}: {curve.label}", curve.time_s, curve.measured * scale, curve.fitted * scale, unit, label
        )
        for named in found.fits
        for curve in named.fit.curves
        for scale, unit, label in (_shown(curve.unit),)
    ]
    return IdentificationResult(found.parameters, estimates, checks, found.warnings, fits)


def _shown(unit: str) -> tuple[float, str, str]:
    return {"m": (1e3, "mm", "displacement"), "rad": (180 / np.pi, "°", "angle")}.get(unit, (1.0, unit, "value"))


def parameter_lines(parameters: IdentifiedParameters, truth: Mapping[str, float] | None = None) -> list[str]:
    """A table of the parameters for the terminal; with a simulated rig's truth, how far off."""
    lines = []
    for name, value in parameters.values.items():
        std = parameters.std[name]
        unit = "" if PARAMETER_UNITS[name] == "1" else f" {PARAMETER_UNITS[name]}"
        line = f"{name:16} {value:14.7g} ± {std:.2g}{unit} ({100 * std / abs(value):.3g} %)"
        if truth is not None and name in truth:
            line += f"   truth {truth[name]:.7g}, off by {(value - truth[name]) / std:+.2f} sd"
        lines.append(line)
    return lines
