"""`rig map`: stability of the balanced state over two numbers of a rig, and its borders."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from analysis.errors import BadFigureName
from rig_cli.console import notify, plain, print_json, wait_for_compilation
from rig_cli.map_tiles import in_tiles
from rig_cli.model import Accuracy
from rig_cli.numbers import PositiveSeconds
from rig_cli.option_groups import OUTPUT, PLANE, WORK
from rig_cli.options import Force, Json, ParametersPath, RigFile, Settings, check_outputs, warn_of_filled
from rig_cli.scheduler import Scheduler
from rig_cli.share_progress import share_progress
from rig_cli.speed import NO_SPEED, SpeedChoice

if TYPE_CHECKING:
    from analysis.maps.question import MapQuestion, SourceText

_X, _Y = "speed_ratio=0.3:7:400", "stiffness_ratio=1:16:250"
_X_OF_MOTIONS, _Y_OF_MOTIONS = "speed_ratio=0.3:7:80", "stiffness_ratio=1:16:40"


@Parameter(name="*", group=PLANE)
@dataclass(frozen=True)
class MapPlane:
    """Axes, quantity and borders of a map.

    Attributes:
        x, y: axes, see rig_cli.map_axes; None: the usual ones.
        quantity: what is computed at every point.
        borders: whether the borders of stability are followed.
        family: further number and its values for which the borders are followed.
        best: number and range in which the largest stable area is searched.
    """

    x: Annotated[
        str | None,
        Parameter(
            help="KEY=A:B:N or KEY=A:B:N:log, N values from A to B; KEY+KEY change alike; without, "
            f"{_X}, fewer of releases"
        ),
    ] = None
    y: Annotated[str | None, Parameter(help=f"the same, of another number; {_Y} without")] = None
    quantity: Annotated[
        Literal["multiplier", "decay-rate", "state", "amplitude", "settling-time", "coexisting"],
        Parameter(
            help="the largest multiplier; the decay rate per second that follows from it; or of a release at every "
            "point the state reached, the amplitude left, the time it took; or which stable motions coexist"
        ),
    ] = "multiplier"
    borders: Annotated[
        bool, Parameter(negative="", help="follow the borders of stability, every branch to 1e-10, with the map")
    ] = False
    family: Annotated[
        str | None, Parameter(help="KEY=V,V,V or KEY=A:B:N[:log]: follow the borders for each value of another number")
    ] = None
    best: Annotated[
        str | None, Parameter(help="KEY=A:B[:log]: search the value at which most of the plane is stable")
    ] = None


@Parameter(name="*", group=WORK)
@dataclass(frozen=True)
class MapWork:
    """How a map is computed.

    Attributes:
        refine: number of bisections of the grid's cells near borders.
        seconds: how long a release is followed.
        accuracy: of the largest multiplier.
        scheduler: see `Scheduler`.
    """

    refine: Annotated[
        int, Parameter(help="halve the grid's cells so often both ways, but only where stability changes")
    ] = 0
    seconds: Annotated[PositiveSeconds, Parameter(help="how long a release is followed")] = 20.0
    accuracy: Accuracy = 1e-8
    scheduler: Scheduler = None


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True)
class MapFiles:
    """Files of a map; None: not written. force: whether existing files are replaced."""

    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], group=OUTPUT, help="write the arrays: .npz, .parquet or .zarr")
    ] = None
    plot: Annotated[Path | None, Parameter(help="write a figure: .svg, .png, .pdf, or .html, which zooms")] = None
    force: Force = False


_PLANE, _WORK, _NO_FILES = MapPlane(), MapWork(), MapFiles()


def map(
    rig: RigFile,
    *,
    plane: MapPlane = _PLANE,
    work: MapWork = _WORK,
    speed: SpeedChoice = NO_SPEED,
    files: MapFiles = _NO_FILES,
    parameters: ParametersPath = None,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Map where the balanced state is stable, over any two numbers of the rig file.

    KEY is speed_ratio, speed_rpm, stiffness_ratio or a number of the rig file, such as imbalance.radius_m or
    suspension.zeta1+suspension.zeta2. If neither axis is a speed, --point, --speed-ratio or --speed-rpm gives it.

    --borders reports the largest island that it may have missed. --family draws ticks on the unstable side and reports
    the stable share of the plane for each value. --best computes nine values, then a bounded search; it reports the
    nearest significantly smaller shares on both sides, and "not resolved" where pendulums creep too slowly. --refine
    interpolates elsewhere (`computed` marks the other points); --borders then finds islands between the coarse points.

    Example: `rig map my.toml --borders`
    """
    with wait_for_compilation("stability map"):
        from analysis.maps.answers import compile_maps  # numba takes a while to load
        from analysis.maps.question import parameters_source, rig_source
        from rig_cli.map_page import report_omissions

        _check_files(files)
        sources = rig_source(rig), parameters_source(parameters)
        question = _question(*sources, tuple(settings or ()), plane, work, speed)
        warn_of_filled(question.known, question.loaded(), settings)
        if not question.is_nonlinear:
            report_omissions(question)
            compile_maps(question)
    if question.is_nonlinear:
        from rig_cli.map_motions import map_motions

        return map_motions(question, files.output, files.plot, work.scheduler, json)
    return _answered(question, files.output, files.plot, work.scheduler, json)


def _question(
    rig: SourceText,
    parameters: SourceText | None,
    settings: tuple[str, ...],
    plane: MapPlane,
    work: MapWork,
    speed: SpeedChoice,
) -> MapQuestion:
    """Return the question of a map.

    Raises:
        RigFileError: an axis, a family, a range or the speed is not valid.
    """
    from analysis.maps.question import NONLINEAR, MapQuestion, speed_of
    from rig_cli.map_axes import read_axis, read_family, read_range

    usual = (_X_OF_MOTIONS, _Y_OF_MOTIONS) if plane.quantity in NONLINEAR else (_X, _Y)
    question = MapQuestion(
        rig,
        read_axis("--x", plane.x or usual[0]),
        read_axis("--y", plane.y or usual[1]),
        parameters,
        settings,
        None,
        plane.quantity,
        work.accuracy,
        plane.borders,
        work.refine,
        None if plane.family is None else read_family("--family", plane.family),
        None if plane.best is None else read_range("--best", plane.best),
        work.seconds,
    )
    chosen = speed_of(question.loaded(), speed.point, speed.speed_ratio, speed.speed_rpm)
    return replace(question, speed_rad_s=chosen)


def _check_files(files: MapFiles) -> None:
    """Check that the files can be written, before the work is done.

    Raises:
        RigFileError, AnalysisError: they cannot; the message contains the reason.
    """
    from analysis.figures.page import SUFFIXES  # matplotlib
    from analysis.maps.files import need_map_suffix

    output, plot = files.output, files.plot
    replaces_store = output is not None and output.suffix == ".zarr" and output.is_dir()
    check_outputs("rig map:", plot, output / "zarr.json" if output and replaces_store else output, force=files.force)
    if output is not None:
        need_map_suffix(output)
    if plot is not None and plot.suffix.lower() not in SUFFIXES:
        raise BadFigureName(f"rig map: --plot {plot}: expected a name ending in {', '.join(SUFFIXES)}")


def _answered(question: MapQuestion, output: Path | None, plot: Path | None, scheduler: str | None, json: bool) -> int:
    """Compute, write, draw and print the map."""
    from analysis.maps.answers import answer
    from analysis.maps.files import write_map
    from analysis.maps.records import record
    from rig_cli.map_page import draw, map_json, print_map

    with in_tiles(question, output, scheduler) as grid_of:
        try:
            found = answer(question, share_progress, grid_of)
        except KeyboardInterrupt:
            if grid_of is None:
                notify("rig map: nothing is written before the whole map is computed; the computed part is lost")
            raise
        result = map_json(found)
        written = [] if output is None else write_map(output, record(found, plain(result)))
    if plot is not None:
        draw(plot, found)
        written.append(plot)
    result |= {
        "what_if": list(question.settings),
        "file": None if output is None else str(output),
        "plot": None if plot is None else str(plot),
        "written": [str(path) for path in written],
    }
    if json:
        print_json(result)
        return 0
    print_map(result, question.settings)
    for path in written:
        print(f"written to {path}")
    if not written:
        notify("no file written: give -o FILE.npz for the arrays, --plot FILE for the figure")
    return 0
