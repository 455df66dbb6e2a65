"""Writing of the report: figures, tables and one template."""

from __future__ import annotations

import json
import logging
import math
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from analysis.errors import NotEnoughData
from analysis.figures.bode import draw_bode
from analysis.figures.fit import FitCurve, draw_fit
from analysis.figures.point import draw_point, simulate_release
from analysis.figures.stability_map import MapPoint, draw_stability_map
from analysis.figures.style import to_svg
from analysis.prediction import known_axis_angle
from analysis.report import tables
from analysis.report.budget_tables import budget_tables
from analysis.report.campaign import Campaign
from analysis.report.twin import need_free_twin, twin, twin_path
from analysis.results import PointResult
from analysis.rig_model import RigModel
from analysis.rounding import plain
from analysis.scores import Z_LIMIT
from daq.guided_test_kinds import point_of
from daq.signals.run import Run
from dynamics.errors import DynamicsError
from rig_basics.whole_file import write_whole_text

_log = logging.getLogger(__name__)

_TEMPLATE, _SCRIPT = "template.html.j2", "page.js"


def write_report(path: str | Path, campaign: Campaign) -> Path:
    """Write a campaign's report as one self-contained HTML file, and its numbers as JSON next to it.

    Args:
        path: file to write; its folder must exist.
        campaign: recorded runs, identification and validation.
    Returns:
        The path written.
    Raises:
        TakenName: the JSON file exists and does not contain an earlier report's numbers.
    """
    path = Path(path)
    need_free_twin(path)
    write_whole_text(path, render(campaign))
    numbers = json.dumps(twin(campaign), ensure_ascii=False, indent=1, allow_nan=False)
    write_whole_text(twin_path(path), numbers + "\n")
    return path


def render(campaign: Campaign) -> str:
    """Return the report's HTML. Equal campaigns yield equal text."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    folder = resources.files("analysis.report")
    text = folder.joinpath(_TEMPLATE).read_text(encoding="utf-8")
    script = folder.joinpath(_SCRIPT).read_text(encoding="utf-8")
    points = dict(campaign.validation.points) if campaign.validation else {}
    angle = known_axis_angle(campaign.identification.parameters, campaign.rig, campaign.axis_angle_deg)
    names, correlations = tables.correlation_rows(campaign)
    streams, losses = tables.loss_table(campaign)
    return environment.from_string(text).render(
        campaign=campaign,
        runs=tables.run_rows(campaign),
        streams=streams,
        losses=losses,
        parameters=tables.parameter_rows(campaign),
        axis_angle=tables.with_std(*angle, "°"),
        axis_angle_known=angle != campaign.rig.roles.mounted_deg,
        correlation_names=names,
        correlations=correlations,
        estimates=tables.estimate_rows(campaign),
        consistency=tables.consistency_rows(campaign),
        fits=[_fit(curve, i) for i, curve in enumerate(campaign.identification.fits)],
        points=[_point(campaign, name, point, i) for i, (name, point) in enumerate(points.items())],
        summary=[tables.summary_row(point, name, campaign) for name, point in points.items()],
        counts=_counts(points),
        agreement=campaign.validation.agreement if campaign.validation else None,
        explained=_explained(campaign),
        noticed=tables.noticed_rows(campaign),
        exact=tables.exact_rows(campaign),
        budgets=budget_tables(campaign.budgets),
        start_ups=[series.sentences for series in campaign.validation.start_ups] if campaign.validation else [],
        passages=_passages(campaign),
        stability=_map(campaign, points),
        z_limit=f"{Z_LIMIT:g}",
        lost=tables.lost_words(campaign),
        script=Markup(script),
    )


def _counts(points: dict[str, PointResult]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for point in points.values():
        counts[point.verdict] = counts.get(point.verdict, 0) + 1
    return counts


def _explained(campaign: Campaign) -> list[str]:
    """Return the known reasons of a failure, then its explanations, the likeliest first."""
    if campaign.validation is None:
        return []
    found = campaign.validation.explanations
    return [*campaign.validation.reasons, *([] if found is None else found.sentences)]


def _fit(curve: FitCurve, index: int) -> dict[str, Any]:
    unit, scale = curve.residual_unit
    return {
        "title": curve.title,
        "aside": curve.aside,
        "notes": curve.notes,
        "rms": plain(scale * curve.residual_rms, 2),
        "unit": unit,
        "figure": Markup(draw_fit(curve, f"fit{index}")),
    }


def _point(campaign: Campaign, name: str, point: PointResult, index: int) -> dict[str, Any]:
    """Return a point's section: figure (if there is a measurement) and table."""
    figure, simulated = None, None
    run = _run_of(campaign, point)
    if point.measurement is not None and run is not None:
        physics = campaign.identification.parameters.applied_to(campaign.rig.physics)
        angle = known_axis_angle(campaign.identification.parameters, campaign.rig, campaign.axis_angle_deg)
        simulated = simulate_release(run, point.measurement, physics, math.radians(angle[0]))
        figure = Markup(draw_point(run, point.measurement, point.prediction, simulated, f"point{index}"))
    return {
        **tables.summary_row(point, name, campaign),
        "source": Path(point.source).name,
        "rows": tables.quantity_rows(point) if point.measurement else [],
        "figure": figure,
        "simulated": simulated is not None,
        "averaged": ""
        if point.measurement is None
        else f"{point.measurement.to_s - point.measurement.from_s:.1f} s averaged, "
        f"{point.measurement.to_s - point.measurement.release_s:.0f} s after release",
    }


def _passages(campaign: Campaign) -> list[dict[str, Any]]:
    """Return the first run-up and run-down, each with a simulation by the model."""
    known = campaign.identification.parameters
    angle = known_axis_angle(known, campaign.rig, campaign.axis_angle_deg)
    model = replace(RigModel.of(campaign.rig, known), axis_angle_rad=math.radians(angle[0]))
    shown: dict[str, dict[str, Any]] = {}
    for run in campaign.runs:
        if run.test not in ("run-up", "run-down") or run.test in shown:
            continue
        try:
            bode = draw_bode(run, model)
        except NotEnoughData as error:
            _log.warning("%s: report without its Bode plot: %s", run.source, error)
            continue
        name, title = f"passage{len(shown)}", run.test.capitalize()
        shown[run.test] = {
            "title": title,
            "figure": Markup(to_svg(bode, name, f"{title}: Bode plot, measured and simulated")),
        }
    return list(shown.values())


def _run_of(campaign: Campaign, point: PointResult) -> Run | None:
    own = [r for r in campaign.runs if r.source == point.source and point_of(r.test) == point.name]
    return own[0] if own else None


def _map(campaign: Campaign, points: dict[str, PointResult]) -> Markup | None:
    """Draw the stability map with the measured points; None if the rig has no balanced state."""
    physics = campaign.identification.parameters.applied_to(campaign.rig.physics)
    first = physics.natural_frequencies_rad_s[0]
    marks = [
        MapPoint(name, point.measurement.speed_rad_s.value / first, point.state)
        for name, point in points.items()
        if point.measurement is not None
    ]
    try:
        return Markup(draw_stability_map(physics, marks))
    except DynamicsError as error:
        _log.warning("report without its stability map: %s", error)
        return None
