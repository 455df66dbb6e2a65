"""Tests in the provenance of a parameters.toml, for later budgets and comparisons.

Each test has its values and method (as `identify` writes them), its own covariance, its shared errors, the start of its
recording and its devices. Older files and files of other programs lack these; no assumption replaces them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from daq.signals.run import Run
from identification.estimate import Estimate
from identification.joint.combine import JointEstimate, joint_estimate
from identification.samples import correlation_inflation
from identification.sources import parts
from rig_basics.texts import number_of
from rig_configs.error_label import ErrorLabel
from rig_configs.errors import ParametersFileError
from rig_configs.parameters_file import IdentifiedParameters

if TYPE_CHECKING:
    from identification.identify import Identification


@dataclass(frozen=True)
class KeptTest:
    """One test as stored in a parameters.toml.

    Attributes:
        estimate: values with own covariance and shared errors. Its sources are the names of the logs.
        digest: digest of the log; "" if unknown.
        recorded: start of the recording; None if unknown.
        lasers: axis → serial number of the laser that measured along it, if it reports one.
        model_share: share of the own variance that is due to residuals beyond sensor noise, 0 to 1.
        left_out: reason why the joint estimate excludes the test; "" if it does not.
    """

    estimate: Estimate
    digest: str
    recorded: datetime | None
    lasers: Mapping[str, str]
    model_share: float
    left_out: str = ""


def with_tests(found: Identification, runs: Sequence[Run] = ()) -> IdentifiedParameters:
    """Return the parameters of an identification with its tests in the provenance.

    Args:
        found: result of `identify`.
        runs: identified runs, for recording times and devices.
    """
    joint = joint_estimate(found.estimates)
    entries = found.parameters.provenance.get("tests", [{} for _ in found.estimates])
    tests = [
        {**entry, **_entry(i, estimate, joint, found, [r for r in runs if r.source in estimate.sources])}
        for i, (entry, estimate) in enumerate(zip(entries, found.estimates, strict=True))
    ]
    facts: dict[str, Any] = {**found.parameters.provenance, "tests": tests}
    rigs = sorted({str(r.metadata["rig"]) for r in runs if r.metadata.get("rig")})
    if rigs:
        facts["rig"] = " + ".join(rigs)
    if joint.extra_std:
        facts["widened"] = joint.extra_std
    return replace(found.parameters, provenance=facts)


def _entry(
    number: int, estimate: Estimate, joint: JointEstimate, found: Identification, runs: Sequence[Run]
) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "covariance": estimate.covariance.tolist(),
        "shared": {
            label.text: dict(zip(estimate.names, shift.tolist(), strict=True))
            for label, shift in estimate.shared.items()
        },
        "model_share": model_share(estimate, found),
    }
    if number in joint.left_out:
        entry["left_out"] = joint.left_out[number]
    started = min((r.start_s for r in runs if r.start_s > 0), default=None)
    if started is not None:
        entry["recorded"] = datetime.fromtimestamp(started, UTC).isoformat(timespec="seconds")
    devices = {
        device: str(serial)
        for run in runs
        for device, identity in cast("Mapping[str, object]", run.metadata.get("identities", {})).items()
        if isinstance(identity, Mapping) and (serial := cast("Mapping[str, object]", identity).get("serial"))
    }
    if devices:
        entry["devices"] = devices
    lasers = {
        axis: serial for run in runs for axis in "xy" if (serial := devices.get(run.clocks.get(axis, ""))) is not None
    }
    if lasers:
        entry["lasers"] = lasers
    return entry


def model_share(estimate: Estimate, found: Identification) -> float:
    """1 − 1/f², where f is the factor by which residuals beyond sensor noise have widened the test's intervals."""
    worst = 1.0
    for named in found.fits:
        if (named.test, named.sources) != (estimate.test, estimate.sources):
            continue
        worst = max(worst, named.fit.chi2_per_dof)
        for curve in named.fit.curves:
            worst = max(worst, correlation_inflation(np.asarray(curve.measured - curve.fitted)) ** 2)
    return 1.0 - 1.0 / worst


def kept_tests(parameters: IdentifiedParameters) -> list[KeptTest] | None:
    """Return the tests of a parameters file; None if they are incomplete (older file or file of another program).

    Raises:
        ParametersFileError: a test is invalid. The message names the key.
    """
    found = parameters.provenance.get("tests")
    entries = cast("list[Mapping[str, Any]]", found) if isinstance(found, list) else []
    if not entries or not all("covariance" in t for t in entries):
        return None
    return [_kept(entry, number) for number, entry in enumerate(entries)]


def _kept(entry: Mapping[str, Any], number: int) -> KeptTest:
    try:
        names = tuple(entry["values"])
        shared = {
            ErrorLabel.read(str(text)): np.array([float(shift[n]) for n in names])
            for text, shift in entry.get("shared", {}).items()
        }
        covariance = np.array(entry["covariance"], float)
        if covariance.shape != (len(names), len(names)):
            raise ValueError(
                f"covariance: expected {len(names)} × {number_of(len(names), 'number')}, got {covariance.shape}"
            )
        recorded = entry.get("recorded")
        return KeptTest(
            Estimate(
                str(entry["test"]),
                parts(str(entry["log"])),
                names,
                np.array([float(entry["values"][n]) for n in names]),
                covariance,
                shared,
                str(entry.get("method", "")),
            ),
            str(entry.get("digest", "")),
            None if recorded is None else datetime.fromisoformat(str(recorded)),
            {str(k): str(v) for k, v in entry.get("lasers", {}).items()},
            float(entry.get("model_share", 0.0)),
            str(entry.get("left_out", "")),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as fault:
        raise ParametersFileError(
            f"provenance.tests[{number}]: expected test, log, values, covariance and shared errors by name; "
            f"problem: {fault!r}. `rig identify` writes the file again"
        ) from fault


def rebuilt(parameters: IdentifiedParameters) -> tuple[JointEstimate, list[KeptTest]] | None:
    """Recompute a file's joint estimate from its tests; None if the tests are missing or give other values.

    The values of a file from a version with another rule differ. They are used as they are, without the tests.
    """
    tests = kept_tests(parameters)
    if tests is None:
        return None
    joint = joint_estimate([t.estimate for t in tests])
    std = parameters.std
    same = joint.parameters.values.keys() == parameters.values.keys() and all(
        abs(value - parameters.values[name]) <= 1e-2 * std[name]
        and 0.99 < joint.parameters.std[name] / std[name] < 1.01
        for name, value in joint.parameters.values.items()
    )
    return (joint, tests) if same else None
