"""`rig plot`: figures of logs, one of each or one of all, with the model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from daq.errors import LogError
from rig_basics.texts import number_of
from rig_cli.console import notify, print_json, show
from rig_cli.last_sentence import plot_sentence
from rig_cli.log_places import LogPlaces, logs_of
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Force, Json, Settings, what_if_words
from rig_cli.share_progress import share_progress
from rig_configs import IdentifiedParameters, RigFileError

if TYPE_CHECKING:
    from rig_cli.plotted import Drawn, NotDrawn, Wanted

Kind = Literal[
    "time",
    "orbit",
    "dial",
    "bode",
    "polar",
    "waterfall",
    "spectrum",
    "orders",
    "slip",
    "multipliers",
    "map",
    "residuals",
    "history",
    "health",
]


def plot(
    kind: Annotated[Kind, Parameter(help="what is drawn; see above")],
    *logs: Path,
    over: Annotated[Path | None, Parameter(help="a second log, drawn over the first")] = None,
    model: Annotated[
        Path | None, Parameter(help="parameters.toml of the model in the figure; without it the log's own rig file")
    ] = None,
    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"],
            group=OUTPUT,
            help="a figure (.svg, .png, .pdf, .html) or a folder; without: current folder",
        ),
    ] = None,
    force: Force = False,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Draw logs as orbit, Bode, polar, waterfall and more, with the model.

    time: displacements, pendulum angles, speed; --over is aligned by releases, else motor commands, plucks, the starts.
    orbit: path of the disk's centre, measured and model's ellipse with 95 % intervals; six for a run-up. dial:
    pendulums on the rotor, held, measured at the end, predicted. bode, polar: 1× vectors of a run-up over speed with
    95 % intervals. waterfall, orders: cascade of spectra, order map; over time where the speed is constant. spectrum:
    full spectrum and power densities in mm²/Hz, measured and simulated; needs 3 s at one speed. slip, multipliers, map,
    residuals take all logs: angles and slip orders over speed with the model's states; multipliers in the plane and the
    largest over the speed; stability map with the points; fit of the identification and residuals. history: parameters
    over time, of parameters files. health: rates, gaps, ages, losses and the disk's backlog over time. An .html figure
    zooms and needs no network.

    A folder means its logs. Logs that a kind cannot show, and unreadable ones, are named, the others are drawn. Exit 0
    when all logs given by name are drawn, 2 when one of them, or every log of a folder, is not.

    Example: `rig plot bode out/run-up.mcap`

    Args:
        logs: logs, and folders of them; of history parameters files.
    """
    from rig_cli.plotted import figures_of  # matplotlib and numba take seconds to import

    # The history reads folders of parameters files itself.
    places = LogPlaces(logs) if kind == "history" and logs else logs_of(f"rig plot {kind}", logs)
    known = None if model is None else IdentifiedParameters.load(model)
    wanted = figures_of(kind, places.logs, over, model, known, settings or [])
    drawn, left = _draw_all(kind, wanted, _places(kind, wanted.names, output, force), force)
    if json:
        print_json(
            {
                "kind": kind,
                "figures": drawn,
                "over": None if over is None else str(over),
                "model": None if model is None else str(model),
                "what_if": list(settings or []),
                "not_drawn": [{"log": str(each.log), "reason": each.reason} for each in left],
            }
        )
    else:
        if settings:
            print(what_if_words(settings))
        for figure in drawn if len(drawn) > 1 else ():
            show(f"written to {figure['file']}")
    for each in left:
        notify(f"not drawn: {each.reason}")
    if drawn and not json:
        show(plot_sentence(kind, [figure["file"] for figure in drawn], len(left)))
    return 0 if drawn and all(each.log in places.of_folders for each in left) else 2


def _draw_all(
    kind: Kind, wanted: Wanted, places: Sequence[Path], force: bool
) -> tuple[list[dict[str, Any]], list[NotDrawn]]:
    """Draw all figures; return the JSON of those drawn, and the logs that were not.

    Raises:
        AnalysisError, LogError: from the only log, or no log of a figure of all logs can be shown.
    """
    from analysis.errors import NotEnoughData
    from rig_cli.plotted import not_drawn

    drawn: list[dict[str, Any]] = []
    left: list[NotDrawn] = []
    with share_progress(f"drawing {kind}") as progress:
        for i, (place, draw) in enumerate(zip(places, wanted.draws, strict=True)):
            try:
                figure = draw()
                drawn.append(_drawn(place, figure, force))
                left += figure.left
            except (NotEnoughData, LogError) as error:
                if len(wanted.logs) < 2:
                    raise
                left.append(not_drawn(wanted.logs[i], error))
            progress((i + 1) / len(places))
    return drawn, left


def _places(kind: Kind, names: Sequence[str], output: Path | None, force: bool) -> list[Path]:
    """Return a file for each figure. Existing files and unusable names are rejected before the work."""
    from analysis.figures.page import SUFFIXES  # matplotlib
    from daq.exchange.staging import Staging

    folder = output is not None and (output.is_dir() or not output.suffix)
    if output is None or folder:
        found = [(output or Path()) / f"{name}.{kind}.svg" for name in names]
    elif output.suffix.lower() not in SUFFIXES:
        raise RigFileError(f"rig plot: -o {output}: expected a folder, or a name ending in {', '.join(SUFFIXES)}")
    elif len(names) > 1:
        raise RigFileError(f"rig plot: -o {output}: one file for {number_of(len(names), 'figure')}; give a folder")
    else:
        found = [output]
    if twice := sorted({str(place) for place in found if found.count(place) > 1}):
        raise RigFileError(f"rig plot: several logs would be drawn to {', '.join(twice)}; draw them one by one with -o")
    with Staging(force) as staging:
        for place in found:
            staging.place(place)
    return found


def _drawn(place: Path, figure: Drawn, force: bool) -> dict[str, Any]:
    """Write one figure and return its JSON."""
    from analysis.figures.page import write_figure  # matplotlib
    from daq.exchange.staging import Staging

    facts = figure.facts
    with Staging(force) as staging:
        part = staging.place(place)
        ending = part.with_suffix(place.suffix)  # the format is taken from the ending
        try:
            write_figure(ending, figure.figure, str(facts["title"]))
            ending.replace(part)
        finally:
            ending.unlink(missing_ok=True)
        staging.commit()
    for text in facts.get("warnings", []):
        notify(f"warning: {text}")
    return {"file": str(place), **facts}
