# pyright: strict
"""What `rig plot` draws: logs, rigs and models brought together for each kind of figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from analysis.figures.kinds import KINDS, FigureKind
from analysis.rig_model import RigModel
from rig_cli.console import STDERR
from daq.log import open_log
from daq.log.snapshot import rig_of
from daq.signals.run import Run, load_run, point_of
from rig_configs import IdentifiedParameters, Rig, RigFileError, overridden, with_parameters

Drawn = tuple[Figure, dict[str, Any]]
_LEVEL = 0.01  # chance of marking any change of a parameter when there is none


def logs_in(kind: str, places: Sequence[Path]) -> tuple[list[Path], frozenset[Path]]:
    """Every log that was named and those of folders that were, at most one folder further down, and which are of these.

    Args:
        kind: one of KINDS; "history" takes folders of parameters files itself.
    Raises:
        RigFileError: a folder without logs.
    """
    if kind == "history":
        return list(places), frozenset()
    logs, of_folders = list[Path](), set[Path]()
    for place in places:
        if not place.is_dir():
            logs.append(place)
            continue
        found = sorted([*place.glob("*.mcap"), *place.glob("*/*.mcap")])
        if not found:
            raise RigFileError(f"rig plot {kind}: {place}: expected logs (*.mcap) in this folder, found none")
        more = [log for log in found if log not in logs]
        logs += more
        of_folders.update(more)
    return logs, frozenset(of_folders)


@dataclass(frozen=True)
class Wanted:
    """Figures to be drawn: what each file is called without its ending, and what draws it (with facts for JSON).

    Attributes:
        logs: what each is of; none where one figure is of all.
    """

    names: tuple[str, ...]
    draws: tuple[Callable[[], Drawn], ...]
    logs: tuple[Path, ...] = ()


@dataclass(frozen=True)
class _Model:
    """Where the model's numbers come from."""

    path: Path | None
    known: IdentifiedParameters | None
    settings: Sequence[str]

    def of(self, log: Path) -> RigModel:
        """The model of a log's rig."""
        with open_log(log) as opened:
            rig = rig_of(opened, self.settings)
        return self.with_rig(rig)

    def with_rig(self, rig: Rig) -> RigModel:
        if self.known is None:
            return RigModel.of(rig)
        left = self.known.without(overridden(self.known, self.settings))
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
    """What is to be drawn of the logs.

    Args:
        kind: one of KINDS.
        logs: of "history", parameters files and folders of them.
        over: a log to draw over each.
        model, known: the parameters file and what is in it; None: the rig file in each log.
        settings: laid over.
    Raises:
        RigFileError: nothing can be drawn over this kind of figure.
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
    model = source.of(log)
    other = None if over is None else load_run(over)
    figure = kind.draw(run, model, other)
    return figure, _facts(kind.name, [log], model.name, run)


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
    from analysis.figures.health import draw_health  # noqa: PLC0415 (one kind need not load another)

    with open_log(log) as opened:
        return draw_health(opened), _facts("health", [log], "")


def _map(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.errors import NotEnoughData  # noqa: PLC0415
    from analysis.figures.stability_map import MapPoint, draw_points_on_map  # noqa: PLC0415
    from analysis.steady_state import measure  # noqa: PLC0415

    model, points, warnings = source.of(logs[0]), list[MapPoint](), list[str]()
    for log in logs:
        run = load_run(log)
        try:
            found = measure(run, model.rig)
        except NotEnoughData as error:
            warnings.append(f"{log.name} is no point on the map: {error}")
            continue
        ratio = found.speed_rad_s.value / model.speeds_rad_s[0]
        points.append(MapPoint(point_of(run.test) or run.test, ratio, found.state))
    figure = draw_points_on_map(model.physics, points, f"Stability map: {model.rig.name}, {model.name}")
    return figure, {**_facts("map", logs, model.name), "warnings": warnings}


def _slip(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.figures.slip import draw_slip  # noqa: PLC0415

    model = source.of(logs[0])
    return draw_slip([load_run(log) for log in logs], model), _facts("slip", logs, model.name)


def _multipliers(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.figures.multipliers import draw_multipliers, speed_point  # noqa: PLC0415

    model = source.of(logs[0])
    points = [speed_point(load_run(log)) for log in logs]
    return draw_multipliers(points, model), _facts("multipliers", logs, model.name)


def _residuals(logs: Sequence[Path], source: _Model) -> Drawn:
    from analysis.figures.residuals import draw_residuals  # noqa: PLC0415
    from rig_cli.report_forms import report_identification  # noqa: PLC0415
    from identification import identify  # noqa: PLC0415

    runs = [load_run(log) for log in logs]
    found = report_identification(identify(runs, source.of(logs[0]).rig, STDERR.print))
    facts = _facts("residuals", logs, "fitted")
    return draw_residuals(found.fits), {**facts, "warnings": list(found.warnings)}


def _history(files: Sequence[Path], source: _Model) -> Drawn:
    from rig_cli.history_figure import history_figure  # noqa: PLC0415
    from identification.history import history  # noqa: PLC0415

    return history_figure(history(list(files), None), _LEVEL), _facts("history", files, "")
