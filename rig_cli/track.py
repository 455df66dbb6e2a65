"""`rig track`: states and pendulum damping of a recorded run over time, with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from daq.errors import LogError
from rig_cli.console import notify, print_json
from rig_cli.log_places import logs_of
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Force, Json, ParametersPath, Settings, warn_of_filled
from rig_cli.setting_costs import TRACKING_HELP
from rig_cli.share_progress import share_progress
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, RigFileError

if TYPE_CHECKING:
    from rig_cli.track_files import TrackFiles
    from rig_cli.track_page import Tracking
    from rig_configs.schema import Rig


def track(
    *logs: Annotated[Path, Parameter(help="logs, and folders of them")],
    rig: Annotated[str | None, Parameter(help="a rig file instead of the log's own, of the same rig")] = None,
    parameters: ParametersPath = None,
    setting: Annotated[Literal["fast", "reference"], Parameter(help=TRACKING_HELP)] = "fast",
    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"],
            group=OUTPUT,
            help="a folder, a table (.parquet, .csv, .npz; with its figure) or a figure (.svg, .png, .pdf)",
        ),
    ] = None,
    every_ms: Annotated[float, Parameter(help="readings are processed, and rows made, once in so many ms")] = 50.0,
    force: Force = False,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Follow states and pendulum damping through a log, with uncertainty.

    Spin-downs and points show the damping; rows are x, y, θ3, θ4, their rates, c3, c4 with standard deviations. The
    start values of c3 and c4 are those of --parameters, or of the rig file, and may be wrong by a factor of ten. A bow
    in --parameters acts on the motion. Of a folder those logs are tracked in which the pendulums swing; the others are
    named.

    Example: `rig track out/spin-down.mcap`
    """
    from daq.log.rig_of_logs import RigUse, rig_of_logs
    from identification import NotIdentifiable
    from rig_cli.track_page import print_tracking, tracking_json  # numba takes seconds to import

    places = logs_of("rig track", logs)
    if not 1.0 <= every_ms <= 1000.0:
        raise RigFileError(f"rig track: --every-ms {every_ms:g}: expected 1 to 1000 ms")
    known = None if parameters is None else IdentifiedParameters.load(parameters)
    estimates = frozenset(PARAMETER_UNITS) - {"c3_Nms_per_rad", "c4_Nms_per_rad"} - set(known.values if known else ())
    use = RigUse("rig track", estimates=estimates)
    wanted = _places(places.logs, output, force)
    found: list[Tracking] = []
    for log, place in zip(places.logs, wanted, strict=True):
        try:
            loaded = rig_of_logs([log], use, rig, known, settings or [])
            warn_of_filled(known, loaded, settings)
            found.append(_tracked(log, loaded, parameters, setting, every_ms, settings or [], place, force))
        except (NotIdentifiable, LogError) as error:
            if log not in places.of_folders:
                raise
            notify(f"not tracked: {error}")
    if not found:
        raise RigFileError("rig track: no log of the folder can be tracked; the reasons are above")
    if json:
        print_json({"setting": setting, "what_if": list(settings or []), "logs": [tracking_json(f) for f in found]})
        return 0
    for one in found:
        print_tracking(one)
    return 0


def _places(logs: Sequence[Path], output: Path | None, force: bool) -> list[TrackFiles]:
    """Return the files of each log's results. Existing files are rejected before the work."""
    from daq.exchange.staging import Staging
    from rig_cli.track_files import places  # matplotlib

    found = [places(output, log, len(logs) == 1) for log in logs]
    with Staging(force) as staging:
        for name in (name for place in found for name in (place.table, place.figure) if name is not None):
            staging.place(name)
    names = [place.table or place.figure for place in found if place.table or place.figure]
    twice = {str(name) for name in names if names.count(name) > 1}
    if twice:
        raise RigFileError(
            f"rig track: -o {output}: several logs would be written to {', '.join(sorted(twice))}; "
            "track them one by one"
        )
    return found


def _tracked(
    log: Path,
    rig: Rig,
    parameters: Path | None,
    setting: Literal["fast", "reference"],
    every_ms: float,
    settings: Sequence[str],
    place: TrackFiles,
    force: bool,
) -> Tracking:
    """Track one log and write its files."""
    from daq.signals.run import load_run
    from identification.tracking.replay import track as follow
    from rig_cli.track_files import write_files
    from rig_cli.track_page import Tracking, trackable
    from rig_cli.tracking import imbalance_std

    run = load_run(log)
    warnings = trackable(run)
    against = None if parameters is None else IdentifiedParameters.load(parameters)
    physics = rig.physics if against is None else against.with_effects(rig.physics)
    with share_progress(f"{setting} tracking of {log.name}") as progress:
        found = follow(
            run,
            physics,
            imbalance_std=imbalance_std(parameters, settings),
            batch_s=1e-3 * every_ms,
            setting=setting,
            progress=progress,
        )
    result = Tracking(run, rig, found, setting, against, parameters, warnings)
    for text in result.warnings:
        notify(f"warning: {text}")
    files = write_files(result, place, force)
    for file in files:
        notify(f"written to {file}")
    return result.with_files(files)
