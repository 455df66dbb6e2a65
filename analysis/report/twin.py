"""The report's numbers in machine-readable form: one JSON file next to the page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

from analysis.errors import TakenName
from analysis.report.campaign import Campaign, Changes
from rig_configs import PARAMETER_UNITS

KIND = "rig report"


def twin_path(report: str | Path) -> Path:
    """Return the path of a report's numbers: its own name with the suffix .json."""
    return Path(report).with_suffix(".json")


def need_free_twin(report: str | Path) -> None:
    """Check that the numbers of a report would not overwrite a file that is not an earlier report's numbers.

    Raises:
        TakenName: another file exists under that name.
    """
    path = twin_path(report)
    if not path.exists():
        return
    try:
        kept: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # usual: another kind of file; TakenName is raised below
        kept = None
    if not (isinstance(kept, dict) and cast("dict[str, Any]", kept).get("kind") == KIND):
        raise TakenName(
            f"report {report}: its numbers go to {path}, where another file is already; give the report another name, "
            "or move that file"
        )


def twin(campaign: Campaign) -> dict[str, Any]:
    """Return the contents of the report as plain values with units in the keys, ready for json.dumps."""
    known = campaign.identification.parameters
    found = campaign.validation
    angle = known.axis_angle_deg
    return plain_json(
        {
            "kind": KIND,
            "title": campaign.title,
            "rig": campaign.rig.name,
            "software": campaign.software_version,
            "seed": campaign.seed,
            "what_if": list(campaign.what_if),
            "passed": None if found is None else found.passed,
            "parameters": {
                name: {"value": value, "std": known.std[name], "unit": PARAMETER_UNITS[name]}
                for name, value in known.values.items()
            },
            "correlation": {"order": list(known.values), "matrix": known.correlation.tolist()},
            "axis_angle_deg": None if angle is None else {"value": angle[0], "std": angle[1]},
            "truth": dict(campaign.truth) if campaign.truth is not None else None,
            "changes": None if campaign.changes is None else _changes(campaign.changes),
            "estimates": [
                {
                    "test": e.test,
                    "log": " + ".join(Path(s).name for s in e.sources),
                    "values": dict(e.values),
                    "std": dict(e.std),
                }
                for e in campaign.identification.estimates
            ],
            "fits": [
                {"title": fit.title, "residual_rms": fit.residual_rms, "unit": fit.unit}
                for fit in campaign.identification.fits
            ],
            "warnings": list(
                dict.fromkeys([*campaign.identification.warnings, *([] if found is None else found.warnings)])
            ),
            **({} if found is None else found.to_json()),
            "runs": [
                {
                    "test": run.test,
                    "log": Path(run.source).name,
                    "start": _time(run.start_s),
                    "losses": dict(run.losses),
                }
                for run in campaign.runs
            ],
            "losses": {Path(log).name: dict(row) for log, row in (campaign.losses or {}).items()} or None,
            "notes": list(campaign.notes),
        }
    )


def _changes(changes: Changes) -> dict[str, Any]:
    rows = {
        c.name: {"old": c.old, "new": c.new, "change": c.change, "std": c.std, "p_all_looks_counted": c.p}
        for c in changes.rows
    }
    return {"since": changes.since, "words": changes.words, "parameters": rows, "notes": list(changes.notes)}


def _time(start_s: float) -> str:
    return datetime.fromtimestamp(start_s, UTC).isoformat(timespec="seconds")


def plain_json(value: Any) -> Any:
    """Replace numbers that JSON cannot represent (NaN, infinite) by None, everywhere in a value."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain_json(each) for key, each in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [plain_json(each) for each in cast("list[Any]", value)]
    return value
