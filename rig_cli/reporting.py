"""The report of a campaign, for `rig demo` and `rig report`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from analysis.report.campaign import Campaign, Changes, IdentificationResult
from analysis.report.write import write_report
from daq.signals.completeness import missing_warnings
from daq.signals.run import Run, disagreements
from rig_cli import results
from rig_cli.parameters_budget import all_budgets
from rig_cli.report_forms import report_changes, report_identification
from rig_configs import IdentifiedParameters, Rig

if TYPE_CHECKING:
    from analysis.validation import Validation
    from identification import Identification


def reported(
    path: Path,
    rig: Rig,
    runs: Sequence[Run],
    before: IdentifiedParameters,
    joint: Identification | None,
    validation: Validation | None,
    *,
    since: tuple[str, IdentifiedParameters] | None = None,
    facts: Mapping[str, Any] | None = None,
) -> Path:
    """Write the report of a campaign.

    Args:
        path: the HTML file; its numbers are written next to it.
        before: parameters with which the points were validated.
        joint: joint identification of all logs; None shows only `before`.
        since: name and parameters of an earlier identification.
        facts: "truth" and "seed" of a simulated rig, "notes".
    """
    given = dict(facts or {})
    identities: dict[str, dict[str, Any]] = runs[0].metadata.get("identities", {}) if runs else {}
    devices = {name: {k: _shown(v) for k, v in identity.items()} for name, identity in identities.items()}
    shown = IdentificationResult(before) if joint is None else report_identification(joint)
    extra = missing_warnings(list(runs)) + [f"{Path(r.source).name}: {text}" for r in runs for text in disagreements(r)]
    shown = replace(shown, warnings=list(dict.fromkeys([*shown.warnings, *extra])))
    changes: Changes | None = None
    if since is not None:
        changes = report_changes(since[0], since[1], shown.parameters)
    campaign = Campaign(
        title=f"Campaign on {rig.name}",
        rig=rig,
        runs=runs,
        identification=shown,
        validation=validation,
        axis_angle_deg=before.axis_angle_deg,
        devices=devices,
        truth=given.get("truth"),
        notes=given.get("notes", ()),
        software_version=results.software_version(),
        seed=given.get("seed"),
        budgets=all_budgets(rig, shown.parameters),
        changes=changes,
    )
    return write_report(path, campaign)


def _shown(value: object) -> str:
    """Return a value of a device's identity as text; members of lists and tables are separated by commas."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_shown(v)}" for k, v in cast("Mapping[object, object]", value).items())
    if isinstance(value, list | tuple):
        return ", ".join(_shown(each) for each in cast("list[object]", value))
    return f"{value}"
