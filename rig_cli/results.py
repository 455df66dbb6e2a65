"""Results of other packages converted for JSON, terminal and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from daq.log.time_span import TimeSpan
from daq.version import software_version
from identification import Identification
from rig_configs import PARAMETER_UNITS, IdentifiedParameters


def with_version(
    parameters: IdentifiedParameters, settings: Sequence[str] = (), part: TimeSpan | None = None
) -> IdentifiedParameters:
    """Return the parameters with the software's version, the `--set` texts and the part of the logs in their facts."""
    given: dict[str, Any] = {"settings": list(settings)} if settings else {}
    if part is not None and not part.is_whole:
        given["part_of_each_log"] = str(part)
    return replace(parameters, provenance={"software": software_version(), **given, **parameters.provenance})


def parameters_json(parameters: IdentifiedParameters) -> dict[str, dict[str, Any]]:
    """Return {name: {value, std, unit}}."""
    std = parameters.std
    return {
        name: {"value": value, "std": std[name], "unit": PARAMETER_UNITS[name]}
        for name, value in parameters.values.items()
    }


def identification_json(found: Identification) -> dict[str, Any]:
    """Return the numbers of `rig identify --json`."""
    return {
        "parameters": parameters_json(found.parameters),
        "correlation": {"order": list(found.parameters.values), "matrix": found.parameters.correlation.tolist()},
        "axis_angle_deg": {"value": found.axis_angle_deg, "std": found.axis_angle_std_deg},
        "slow_roll": found.parameters.slow_roll.table() if found.parameters.slow_roll else None,
        "suspension_terms": found.parameters.terms.table() if found.parameters.terms else None,
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
        "witnesses": [asdict(one) for one in found.witnesses],
        "warnings": found.warnings,
    }


def parameter_lines(parameters: IdentifiedParameters, truth: Mapping[str, float] | None = None) -> list[str]:
    """Return a table of the parameters for the terminal; with a simulated rig's truth, also the deviations from it."""
    lines: list[str] = []
    for name, value in parameters.values.items():
        std = parameters.std[name]
        unit = "" if PARAMETER_UNITS[name] == "1" else f" {PARAMETER_UNITS[name]}"
        line = f"{name:16} {value:14.7g} ± {std:.2g}{unit} ({100 * std / abs(value):.3g} %)"
        if truth is not None and name in truth:
            line += f"   truth {truth[name]:.7g}, off by {(value - truth[name]) / std:+.2f} sd"
        lines.append(line)
    lines += parameters.terms.sentences if parameters.terms else []
    return lines + (parameters.slow_roll.sentences if parameters.slow_roll else [])
