"""Rows of the report's tables as text (the template escapes it)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from analysis.noticed import DetectableSizes
from analysis.report.campaign import Campaign, ParameterChange
from analysis.results import PointResult
from analysis.rounding import plain, signed, with_std
from analysis.scores import Z_LIMIT, Score
from daq.items import loss_words
from daq.signals.run import Run
from rig_basics.units import RPM
from rig_configs import PARAMETER_SYMBOLS, PARAMETER_UNITS

_QUANTITIES = (
    ("theta3", "θ3", "theta3_deg", "°"),
    ("theta4", "θ4", "theta4_deg", "°"),
    ("amplitude_x", "x amplitude, order 1", "amplitude_x_mm", "mm"),
    ("amplitude_y", "y amplitude, order 1", "amplitude_y_mm", "mm"),
    ("amplitude", "rms radius", "amplitude_mm", "mm"),
)
_EXAMPLE_SHARE, _MIN_EFFECT_STD, _MAX_SIZE = 1e-3, 0.05, 1e4
_CHANGED = 0.01  # p below which a parameter counts as changed
CLASSES = {"pass": "good", "fail": "bad"}


def run_rows(campaign: Campaign) -> list[dict[str, str]]:
    """Return one row per log: test, start, duration, samples."""
    return [
        {
            "test": run.test,
            "source": Path(run.source).name,
            "start": datetime.fromtimestamp(run.start_s, UTC).strftime("%Y-%m-%d %H:%M:%S"),
            "duration": f"{_duration(run):.1f}",
            "lasers": f"{len(run.x_time_s)} / {len(run.y_time_s)}",
            "angles": str(len(run.angle_time_s)),
            "marks": str(len(run.mark_time_s)),
            "invalid": str(int(np.isnan(run.x_m).sum() + np.isnan(run.y_m).sum())),
        }
        for run in campaign.runs
    ]


def _duration(run: Run) -> float:
    times = [t for t in (run.x_time_s, run.y_time_s, run.angle_time_s, run.mark_time_s) if len(t)]
    return max(t[-1] for t in times) - min(t[0] for t in times) if times else 0.0


def loss_table(campaign: Campaign) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return the streams with losses, and per log the counted losses of each."""
    losses: Mapping[str, Mapping[str, int]] = (
        campaign.losses if campaign.losses is not None else {run.source: run.losses for run in campaign.runs}
    )
    streams = sorted({stream for row in losses.values() for stream, lost in row.items() if lost})
    return streams, [(Path(log).name, [str(row.get(s, "–")) for s in streams]) for log, row in losses.items()]


def lost_words(campaign: Campaign) -> list[str]:
    """Return the losses of each stream over all logs, the largest first: "12 lasers x: samples"."""
    losses = campaign.losses if campaign.losses is not None else {run.source: run.losses for run in campaign.runs}
    total: dict[str, int] = {}
    for row in losses.values():
        for stream, lost in row.items():
            total[stream] = total.get(stream, 0) + lost
    named = sorted(((lost, stream) for stream, lost in total.items() if lost), reverse=True)
    return [loss_words(lost, stream) for lost, stream in named]


def parameter_rows(campaign: Campaign) -> list[dict[str, str]]:
    """Return identified values with 95 % intervals, against the rig file and, if known, the truth."""
    known = campaign.identification.parameters
    file = campaign.rig.physics.identified()
    changes = {c.name: c for c in campaign.changes.rows} if campaign.changes else {}
    rows: list[dict[str, str]] = []
    for name, value in known.values.items():
        std, unit = known.std[name], PARAMETER_UNITS[name]
        truth = (campaign.truth or {}).get(name)
        rows.append(
            {
                "symbol": PARAMETER_SYMBOLS.get(name, name),
                "value": with_std(value, std, unit),
                "relative": f"{100 * std / abs(value):.2g} %" if value else "–",
                "file": plain(file[name]),
                "change": f"{signed(100 * (value / file[name] - 1), 2)} %" if file[name] else "–",
                "since": _since(changes.get(name)),
                "changed": "yes" if name in changes and changes[name].p < _CHANGED else "",
                "truth": "" if truth is None else plain(truth),
                "truth_z": "" if truth is None or std <= 0 else signed((value - truth) / std),
            }
        )
    return rows


def _since(change: ParameterChange | None) -> str:
    """Format a change since the earlier identification, in percent."""
    if change is None or not change.old or change.std <= 1e-9 * abs(change.old):  # both use the same logs
        return "–"
    return f"{signed(100 * change.change / abs(change.old), 3)} ± {plain(100 * change.std / abs(change.old), 2)} %"


def correlation_rows(campaign: Campaign) -> tuple[list[str], list[tuple[str, list[tuple[str, float]]]]]:
    """Return names, and per parameter the correlations with their shade (0 to 1)."""
    known = campaign.identification.parameters
    names = [PARAMETER_SYMBOLS.get(n, n) for n in known.values]
    std = np.sqrt(np.diag(known.covariance))
    scale = np.where(std > 0, std, 1.0)
    matrix = known.covariance / np.outer(scale, scale)
    return names, [
        (name, [(signed(float(v), 2), round(min(1.0, abs(float(v))), 2)) for v in row])
        for name, row in zip(names, matrix, strict=True)
    ]


def estimate_rows(campaign: Campaign) -> list[dict[str, str]]:
    """Return every value estimated by every test alone."""
    rows: list[dict[str, str]] = []
    for estimate in campaign.identification.estimates:
        for name, value in estimate.values.items():
            unit = PARAMETER_UNITS.get(name, "")
            rows.append(
                {
                    "test": estimate.test,
                    "source": " + ".join(Path(s).name for s in estimate.sources),
                    "name": PARAMETER_SYMBOLS.get(name, name),
                    "value": with_std(value, estimate.std.get(name, math.nan), unit),
                }
            )
    return rows


def consistency_rows(campaign: Campaign) -> list[dict[str, str]]:
    """Return the agreement between tests."""
    return [
        {
            "name": PARAMETER_SYMBOLS.get(c.name, c.name),
            "z": signed(c.z),
            "text": c.text,
            "class": "" if abs(c.z) < 3 else "bad",
        }
        for c in campaign.identification.consistency
    ]


def summary_row(point: PointResult, name: str, campaign: Campaign) -> dict[str, Any]:
    """Return the row of a point in the table of all points."""
    values = point.to_json()
    measured = values["measured"]
    speed = measured["speed_rpm"]
    first = campaign.identification.parameters.applied_to(campaign.rig.physics).natural_frequencies_rad_s[0]
    agreement = campaign.validation.agreement if campaign.validation else None
    whole = agreement.points.get(name) if agreement else None
    largest = max((abs(z) for z in point.z_scores.values()), default=math.nan)
    return {
        "name": name,
        "speed": "–" if speed is None else f"{speed:.1f}",
        "ratio": "–" if speed is None else f"{speed * RPM / first:.3f}",
        "state": point.state,
        "expected": point.expected or "–",
        "model": point.prediction.state.type if point.prediction else "–",
        "largest": "–" if math.isnan(largest) else f"{largest:.1f}",
        "chi2": "–" if whole is None else f"{plain(whole.chi2, 3)} ({whole.dof})",
        "verdict": point.verdict,
        "class": CLASSES.get(point.verdict, "open"),
        "why": point.why,
        "cells": [_cell(row) for row in quantity_rows(point)[:4]] if measured["speed_rpm"] is not None else _NO_CELLS,
    }


_NO_CELLS = [{"measured": "–", "predicted": "–", "class": ""}] * 4


def _cell(row: Mapping[str, Any]) -> dict[str, str]:
    """Format measured and predicted values for the table of all points; the noise is left out."""
    return {"measured": row["measured"], "predicted": row["predicted_alone"], "class": row["class"]}


def noticed_rows(campaign: Campaign) -> list[dict[str, Any]]:
    """Return the smallest deviation of each cause that each point alone, and all together, would detect."""
    found = campaign.validation.noticed if campaign.validation else ()
    return [
        {
            "cause": one.cause.words,
            "names": list(one.sizes),
            "points": [_size(size, one) for size in one.sizes.values()],
            "together": _size(one.together, one),
        }
        for one in found
    ]


def _size(size: float, one: DetectableSizes) -> str:
    shown = size * one.cause.factor
    return f"{plain(shown, 2)} {one.cause.unit}" if shown < _MAX_SIZE else "–"


def exact_rows(campaign: Campaign) -> list[dict[str, str]]:
    """Return the exact numbers of the rig file, and the effect of 0.1 % of each on the identified parameters."""
    known, found = campaign.rig.known, campaign.identification.parameters
    rows: list[dict[str, str]] = []
    for number in known.exact:
        if number not in found.by_number:
            continue
        changes = found.by_number[number] * _EXAMPLE_SHARE * known.values[number]
        parts = [
            f"{PARAMETER_SYMBOLS.get(name, name)} {signed(100 * change / value, 2)} % ({signed(change / std)} std)"
            for (name, value), std, change in zip(found.values.items(), found.std.values(), changes, strict=True)
            if value and std > 0 and abs(change) > _MIN_EFFECT_STD * std
        ]
        rows.append(
            {"number": number, "value": plain(known.values[number]), "does": ", ".join(parts) or "nothing seen"}
        )
    return rows


def quantity_rows(point: PointResult) -> list[dict[str, Any]]:
    """Return measured and predicted values by quantity, with the uncertainties behind z."""
    values = point.to_json()
    rows: list[dict[str, Any]] = []
    for name, text, key, unit in _QUANTITIES:
        score = point.scores.get(name)
        value, std = values["measured"][key], values["measured_std"][key]
        model, model_std = values["predicted"][key], values["predicted_std"][key]
        small = unit == "mm" and max(abs(value or 0), abs(model or 0)) < 0.01
        factor, shown = (1e3, "µm") if small else (1.0, unit)
        predicted = _pair(model, model_std, factor, shown)
        row = {
            "name": text,
            "measured": _pair(value, std, factor, shown),
            "predicted": predicted,
            "predicted_alone": predicted,
            "difference": "–",
            "interval": "–",
            "z": "–" if score is None else signed(score.z, 2),
            "class": "bad" if score is not None and not abs(score.z) <= Z_LIMIT else "",
        }
        if score is not None and score.noise:
            row |= _noise_row(score, 1e6 if small else 1e3, shown)
        elif score is not None:
            scale = (180 / math.pi if unit == "°" else 1e3) * factor
            row["difference"] = _pair(score.error * scale, score.u_validation * scale, 1.0, shown)
            reach = 1.96 * score.u_validation
            low, high = ((score.error + side * reach) * scale for side in (-1, 1))
            row["interval"] = f"{signed(low, 3)} … {signed(high, 3)} {shown}"
        rows.append(row)
    return rows


def _noise_row(score: Score, factor: float, unit: str) -> dict[str, str]:
    """Return the row of an amplitude with no predicted vibration: probability of noise instead of a difference."""
    noise = " and ".join(plain(s * factor, 3) for s in score.noise)
    return {
        "measured": with_std(score.measured * factor, score.measured_std * factor, unit, digits=2),
        "predicted": f"0, noise {noise} {unit}",
        "predicted_alone": "0",
        "difference": f"χ² = {plain(score.chi2, 3)} on {2 * len(score.noise)}, p = {plain(score.p, 2)}",
        "z": f"|{score.z:.2f}|",
    }


def _pair(value: float | None, std: float | None, factor: float, unit: str) -> str:
    if value is None:
        return "–"
    return with_std(value * factor, math.nan if std is None else std * factor, unit, digits=2)
