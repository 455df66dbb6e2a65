"""Figures of `rig plot`: logs, rigs and models combined for each kind of figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from analysis.errors import NotEnoughData
from analysis.figures.kinds import KINDS, FigureKind
from analysis.rig_model import RigModel
from daq.errors import LogError
from daq.guided_test_kinds import point_of
from daq.log import open_log
from daq.log.rig_of_logs import RigUse, rig_of_logs
from daq.signals.run import Run, load_run
from rig_cli.console import STDERR
from rig_cli.options import warn_of_filled
from rig_configs import IdentifiedParameters, Rig, RigFileError, overridden, with_parameters

_LEVEL = 0.01  # probability of marking any change of a parameter if there is none


@dataclass(frozen=True)
class NotDrawn:
    """A log that is in no figure, and the reason."""

    log: Path
    reason: str


def not_drawn(log: Path, error: Exception) -> NotDrawn:
    """Return why a log is in no figure."""
    reason = str(error)
    named = reason if log.name in reason else f"{log}: {reason}"
    return NotDrawn(log, named)


@dataclass(frozen=True)
class Drawn:
    """A figure, its facts for JSON, and the logs that it was asked for and does not show."""

    figure: Figure
    facts: dict[str, Any]
    left: tuple[NotDrawn, ...] = ()


@dataclass(frozen=True)
class Wanted:
    """Figures to be drawn: file names without ending, and functions that draw them and return facts for JSON.

    Attributes:
        logs: the log of each figure; empty if one figure shows all.
    """

    names: tuple[str, ...]
    draws: tuple[Callable[[], Drawn], ...]
    logs: tuple[Path, ...] = ()


@dataclass(frozen=True)
class _Model:
    """Source of the model's numbers."""

    path: Path | None
    known: IdentifiedParameters | None
    settings: Sequence[str]

    def of(self, kind: str, logs: Sequence[Path]) -> RigModel:
        """Return the model of the logs' rig."""
        return self.with_rig(rig_of_logs(logs, RigUse(f"rig plot {kind}"), settings=self.settings))

    def with_rig(self, rig: Rig) -> RigModel:
        if self.known is None:
            return RigModel.of(rig)
        left = self.known.without(overridden(self.known, self.settings))
        warn_of_filled(self.known, rig, self.settings)
        name = self.path.name if self.path else "parameters"
        return RigModel.of(with_parameters(rig, left), left, name)


def figures_of(
    kind: str,
    logs: Sequence[Path],
    over: Path | None,
    model: Path | None,
    known: IdentifiedParameters | None,
    settings: Sequence[str],
) -> Wanted:
    """Return the figures to be drawn of the logs.

    Args:
        kind: one of KINDS.
        logs: for "history" parameters files and folders of them.
        over: a log to draw over each.
        model, known: the parameters file and its contents; None: the rig file in each log.
        settings: `--set` texts over the rig file.
    Raises:
        RigFileError: this kind of figure takes no second log.
    """
    found = KINDS[kind]
    if over is not None and not found.overlays:
        names = ", ".join(name for name, each in KINDS.items() if each.overlays)
        raise RigFileError(f"rig plot {kind}: --over {over}: expected one of {names}, which take a second log")
    source = _Model(model, known, settings)
    if found.of == "all":
        draw = {
            "map": _map,
            "residuals": _residuals,
            "history": _history,
            "slip": _slip,
            "multipliers": _multipliers,
        }[kind]
        return Wanted((_stem(logs[0]) if len(logs) == 1 else kind,), (partial(draw, logs, source),))
    if found.of == "log":
        return Wanted(tuple(map(_stem, logs)), tuple(partial(_health, log) for log in logs), tuple(logs))
    draws = tuple(partial(_run, found, log, over, source) for log in logs)
    return Wanted(tuple(map(_stem, logs)), draws, tuple(logs))


def _stem(log: Path) -> str:
    return log.name.removesuffix(".part").removesuffix(".mcap").removesuffix(".toml")


def _run(kind: FigureKind, log: Path, over: Path | None, source: _Model) -> Drawn:
    run = load_run(log)
    model = source.of(kind.name, [log])
    other = None if over is None else load_run(over)
    figure = kind.draw(run, model, other)
    return Drawn(figure, _facts(kind.name, [log], model.name, run))


def _facts(kind: str, logs: Sequence[Path], model: str, run: Run | None = None) -> dict[str, Any]:
    title = f"{kind}: {', '.join(log.name for log in logs)}"
    return {
        "title": title,
        "logs": [str(log) for log in logs],
        "test": None if run is None else run.test,
        "beside": model,
        "warnings": [] if run is None else list(run.metadata.get("missing", [])),
    }


def _health(log: Path) -> Drawn:
    from analysis.figures.health import draw_health

    with open_log(log) as opened:
        return Drawn(draw_health(opened), _facts("health", [log], ""))


@dataclass(frozen=True)
class _Shown:
    """Logs of one figure of all logs: those that it shows, with their runs and their rig's model, and the others."""

    logs: list[Path]
    runs: list[Run]
    model: RigModel
    left: tuple[NotDrawn, ...]


def _shown(kind: str, logs: Sequence[Path], source: _Model, check: Callable[[Run, RigModel], object]) -> _Shown:
    """Load all logs and check each of them.

    Args:
        kind: one of KINDS.
        logs: at least one.
        source: of the model.
        check: raises NotEnoughData for a run that this kind of figure, with this model, cannot show.
    Raises:
        RigFileError: the logs are of different rigs.
        LogError, NotEnoughData: no log can be shown.
    """
    runs, left = dict[Path, Run](), dict[Path, LogError | NotEnoughData]()
    for log in logs:
        try:
            runs[log] = load_run(log)
        except LogError as error:
            left[log] = error
    model = source.of(kind, list(runs)) if runs else None
    for log, run in list(runs.items()):
        try:
            assert model is not None  # there is a run
            check(run, model)
        except NotEnoughData as error:
            left[log] = error
            del runs[log]
    reasons = tuple(not_drawn(log, error) for log, error in left.items())
    if model is None or not runs:
        if len(logs) == 1:
            raise left[logs[0]]
        raise NotEnoughData(f"{kind} can show no log of {len(logs)}: {'; '.join(each.reason for each in reasons)}")
    return _Shown(list(runs), list(runs.values()), model, reasons)


def _map(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.figures.stability_map import MapPoint, draw_points_on_map
    from analysis.steady_state import measure

    points: list[MapPoint] = []

    def place(run: Run, model: RigModel) -> None:
        try:
            found = measure(run, model.rig)
        except NotEnoughData as error:
            raise NotEnoughData(f"{run.source} is not a point on the map: {error}") from error
        ratio = found.speed_rad_s.value / model.speeds_rad_s[0]
        points.append(MapPoint(point_of(run.test) or run.test, ratio, found.state))

    shown = _shown("map", logs, source, place)
    model = shown.model
    figure = draw_points_on_map(model.physics, points, f"Stability map: {model.rig.name}, {model.name}")
    return Drawn(figure, _facts("map", shown.logs, model.name), shown.left)


def _slip(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.figures.slip import draw_slip, need_slip

    shown = _shown("slip", logs, source, lambda run, _: need_slip(run))
    figure = draw_slip(shown.runs, shown.model)
    return Drawn(figure, _facts("slip", shown.logs, shown.model.name), shown.left)


def _multipliers(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.figures.multipliers import draw_multipliers, speed_point

    shown = _shown("multipliers", logs, source, lambda run, _: speed_point(run))
    figure = draw_multipliers([speed_point(run) for run in shown.runs], shown.model)
    return Drawn(figure, _facts("multipliers", shown.logs, shown.model.name), shown.left)


def _residuals(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.figures.residuals import draw_residuals
    from identification import identify
    from rig_cli.report_forms import report_identification

    shown = _shown("residuals", logs, source, lambda _run, _model: None)
    found = report_identification(identify(shown.runs, shown.model.rig, STDERR.print))
    facts = _facts("residuals", shown.logs, "fitted")
    return Drawn(draw_residuals(found.fits), {**facts, "warnings": list(found.warnings)}, shown.left)


def _history(files: Sequence[Path], source: _Model) -> Drawn:
    from identification.history import parameter_history
    from rig_cli.history_figure import history_figure

    return Drawn(history_figure(parameter_history(list(files), None), _LEVEL), _facts("history", files, ""))
