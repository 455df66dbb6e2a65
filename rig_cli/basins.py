"""Ends of releases over the angles at which the locks hold the pendulums."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_basics.units import TO_RPM
from rig_basics.whole_file import written_whole
from rig_cli.console import notify, print_json, wait_for_compilation
from rig_cli.model import Plot
from rig_cli.numbers import Positive, PositiveSeconds
from rig_cli.option_groups import OUTPUT, RELEASES
from rig_cli.options import Force, Json, ParametersPath, RigFile, Settings, check_outputs, warn_of_filled, what_if_words
from rig_cli.scheduler import Scheduler, worked_out
from rig_cli.share_progress import share_progress
from rig_cli.speed import NO_SPEED, SpeedChoice
from rig_configs import IdentifiedParameters, Rig, RigFileError, load_rig

if TYPE_CHECKING:
    from dynamics.steady.basins.basin_map import BasinMap
    from dynamics.steady.basins.ends import End
    from studies.basins import BasinQuestion
    from studies.study import Study

_MOST = 1_000_000


@Parameter(name="*", group=RELEASES)
@dataclass(frozen=True)
class BasinReleases:
    """Releases of a basin map, and of rigs drawn from the parameters.

    Attributes:
        grid: "N3xN4" releases along θ3 and θ4.
        seconds: how long each is followed.
        probabilities: number of drawn rigs; None: none are drawn.
        play_deg: play of the locks for these, °.
    """

    grid: Annotated[str, Parameter(help="releases along θ3 and θ4, N3xN4, over the whole circle")] = "60x40"
    seconds: Annotated[PositiveSeconds, Parameter(help="how long each release is followed")] = 20.0
    probabilities: Annotated[
        int | None,
        Parameter(help="also draw so many rigs from the parameters' covariance, released within the locks' play"),
    ] = None
    play_deg: Annotated[Positive, Parameter(help="the locks' play to either side, for --probabilities")] = 0.2


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True)
class BasinFiles:
    """Files of a basin map; None: not written.

    Attributes:
        output: the arrays, .npz.
        plot: the figure.
        force: whether existing files are replaced.
    """

    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], group=OUTPUT, help="write the arrays as .npz")
    ] = None
    plot: Plot = None
    force: Force = False


_DEFAULT_RELEASES, _NO_FILES = BasinReleases(), BasinFiles()


def basins(
    rig: RigFile,
    *,
    speed: SpeedChoice = NO_SPEED,
    releases: BasinReleases = _DEFAULT_RELEASES,
    files: BasinFiles = _NO_FILES,
    scheduler: Scheduler = None,
    parameters: ParametersPath = None,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Map where releases end, over the angles at which the locks hold the pendulums.

    An end is balance, another steady state, or slipping. Each release starts on the orbit of the locked rotor and is
    followed until it is within the domain of attraction of a stable motion. Cells whose end changes within the stated
    error are marked as boundaries.

    Example: `rig basins my.toml --point B`
    """
    _check(releases, files)
    numbers = _grid(releases.grid)
    known = IdentifiedParameters.load(parameters) if parameters else IdentifiedParameters({}, np.zeros((0, 0)))
    loaded = load_rig(rig, known, settings or [])
    warn_of_filled(known, loaded, settings)
    speed_rad_s = speed.rad_s("rig basins", loaded)
    with wait_for_compilation("basins"):
        from analysis.maps.question import parameters_source, rig_source
        from studies.basins import KIND, BasinQuestion, basin_study

        what = BasinQuestion(
            rig_source(rig),
            parameters_source(parameters),
            tuple(settings or ()),
            speed_rad_s,
            numbers,
            releases.seconds,
        )
        study = basin_study(what)
        KIND.warm_up(study.text)
    result = _computed(what, study, loaded, known, releases, files, scheduler) | {
        "what_if": list(settings or []),
        "file": None if files.output is None else str(files.output),
        "plot": None if files.plot is None else str(files.plot),
    }
    if json:
        print_json(result)
        return 0
    _print(result, settings)
    for path in (files.output, files.plot):
        if path is not None:
            print(f"written to {path}")
    return 0


def _check(releases: BasinReleases, files: BasinFiles) -> None:
    """Check files and number of draws before the work.

    Raises:
        RigFileError: a file cannot be written, or the number is out of range.
    """
    check_outputs("rig basins:", files.output, files.plot, force=files.force)
    if files.output is not None and files.output.suffix != ".npz":
        raise RigFileError(f"rig basins: -o expected a name ending in .npz, got {files.output}")
    draws = releases.probabilities
    if draws is not None and not 1 <= draws <= _MOST:
        raise RigFileError(f"rig basins: --probabilities expected 1 to {_MOST} draws, got {draws}")


def _computed(
    what: BasinQuestion,
    study: Study,
    rig: Rig,
    known: IdentifiedParameters,
    releases: BasinReleases,
    files: BasinFiles,
    scheduler: str | None,
) -> dict[str, Any]:
    """Compute the map and the probabilities, write the files, and return the JSON of both."""
    from studies.tile_files import TileFolder

    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="rig-basins-") as passing:
        place = Path(passing) if files.output is None else Path(f"{files.output}.tiles")
        found = _found(what, study, place, scheduler)
        took = time.perf_counter() - started
        chances = None if releases.probabilities is None else _chances(what, known, releases, releases.probabilities)
        if files.output is not None:
            with written_whole(files.output) as part:
                np.savez_compressed(part, **_arrays(found))
        if place.is_dir():
            TileFolder(place, study).remove()
    if files.plot is not None:
        _draw(files.plot, rig, what.speed_rad_s, found, list(what.settings))
    return _result(rig, found, took) | {"probabilities": chances}


def _found(what: BasinQuestion, study: Study, place: Path, scheduler: str | None) -> BasinMap:
    """Return the basin map: in one call if it is one tile of this process, else by tiles."""
    from dynamics.steady.basins.basin_map import basins as basin_map
    from studies.basins import assembled

    if study.tiles > 1 or scheduler is not None:
        return assembled(worked_out(study, place, scheduler, "tiles"))
    total = what.releases[0] * what.releases[1]
    try:
        with share_progress(f"{number_of(total, 'release')} of {what.seconds:g} s", total, "releases") as progress:
            return basin_map(what.physics, what.speed_rad_s, *what.angles_rad, what.seconds, progress=progress)
    except KeyboardInterrupt:
        notify("rig basins: interrupted, no release is kept: the file and the figure are written at the end")
        raise


def _chances(what: BasinQuestion, known: IdentifiedParameters, releases: BasinReleases, draws: int) -> dict[str, Any]:
    """Return the probabilities of the ends of a release from the real locks."""
    from analysis.release_probabilities import ReleaseDraws, end_probabilities

    if not known.values:
        notify("rig basins: no --parameters FILE: only the locks' play is drawn")
    with share_progress(f"{number_of(draws, 'rig')} drawn", draws, "rigs") as progress:
        found = end_probabilities(
            what.physics,
            what.speed_rad_s,
            known,
            ReleaseDraws(draws, releases.seconds, math.radians(releases.play_deg)),
            progress,
        )
    return {
        "draws": found.draws,
        "level": found.level,
        "play_deg": releases.play_deg,
        "at_a_boundary": found.unsure,
        "refused": sorted(set(found.releases.refused.values())),
        "ends": [
            {
                "type": e.name,
                "mirror_image": e.mirror,
                "count": e.count,
                "probability": e.probability,
                "interval": list(e.interval),
            }
            for e in found.ends
        ],
    }


def _grid(text: str) -> tuple[int, int]:
    parts = text.lower().replace("×", "x").split("x")
    try:
        across, up = (int(part) for part in parts)
    except ValueError:  # usual: reported below
        across = up = 0
    if across < 1 or up < 1 or across * up > _MOST:
        raise RigFileError(
            f"rig basins: --grid expected N3xN4, whole numbers above 0 and no more than {_MOST} releases, for example "
            f"60x40; got {text!r}"
        )
    return across, up


def _arrays(found: BasinMap) -> dict[str, Any]:
    """Return the arrays of the file: the grid, the result of each release, and the ends by number."""
    return {
        "theta3_deg": np.degrees(found.theta3_rad),
        "theta4_deg": np.degrees(found.theta4_rad),
        "end": found.end,
        "sure": found.sure,
        "caught_s": found.caught_s,
        "settled_s": found.settled_s,
        "amplitude_mm": 1e3 * found.amplitude_m,
        "apart_rad": found.apart_rad,
        "turns": found.turns,
        "ends": np.array([end.words for end in found.ends]),
        "end_types": np.array([end.name for end in found.ends]),
        "seconds": found.seconds,
        "speed_rad_s": found.speed_rad_s,
        "stated_error_rad": found.stated_error_rad,
    }


def _draw(path: Path, rig: Rig, speed: float, found: BasinMap, settings: list[str] | None) -> None:
    from analysis.figures.basins import draw_basins
    from analysis.figures.style import save

    ratio = speed / rig.physics.natural_frequencies_rad_s[0]
    title = f"{rig.name}, Ω = {ratio:.4g} ({speed * TO_RPM:.1f} rpm){what_if_words(settings, '; ')}"
    save(path, draw_basins(found, title))


def _end_json(end: End, share: float, settled: np.ndarray) -> dict[str, Any]:
    out: dict[str, Any] = {
        "type": end.name,
        "mirror_image": end.mirror,
        "share": share,
        "amplitude_mm": 1e3 * end.amplitude_m,
        "multiplier_max": end.multiplier,
        "settled_s": {"median": float(np.median(settled)), "largest": float(np.max(settled))} if len(settled) else None,
    }
    if end.theta_rad is not None:
        out["theta3_deg"], out["theta4_deg"] = (math.degrees(angle) for angle in end.theta_rad)
    if end.slipping is not None:
        orbit = end.slipping
        out |= {
            "turns_per_revolution": list(orbit.turns_per_revolution),
            "winding": list(orbit.winding),
            "residual": orbit.residual,
            "multipliers": orbit.multipliers.tolist(),
        }
    return out


def _result(rig: Rig, found: BasinMap, took: float) -> dict[str, Any]:
    shares = found.shares.tolist()
    settled = [found.settled_s[(found.end == i) & np.isfinite(found.settled_s)] for i in range(len(found.ends))]
    return {
        "speed_ratio": found.speed_rad_s / rig.physics.natural_frequencies_rad_s[0],
        "speed_rpm": found.speed_rad_s * TO_RPM,
        "releases": found.end.size,
        "followed_s": found.seconds,
        "seconds": took,
        "ends": [_end_json(e, s, t) for e, s, t in zip(found.ends, shares, settled, strict=False)],
        "not_settled_share": shares[-1],
        "at_a_boundary_share": 1.0 - float(np.mean(found.sure)),
        "stated_error_deg": math.degrees(found.stated_error_rad),
    }


def _print(result: dict[str, Any], settings: list[str] | None) -> None:
    print(
        f"{result['speed_rpm']:.6g} rpm, speed ratio {result['speed_ratio']:.6g}: "
        f"{number_of(result['releases'], 'release')}, each "
        f"followed for up to {result['followed_s']:g} s, in {result['seconds']:.3g} s"
    )
    for end in result["ends"]:
        print(f"  {100 * end['share']:5.1f} %  {_end_words(end)}")
    if result["not_settled_share"]:
        print(f"  {100 * result['not_settled_share']:5.1f} %  not settled within {result['followed_s']:g} s")
    print(
        f"at a boundary, where {result['stated_error_deg']:.1g}° may change the end: "
        f"{100 * result['at_a_boundary_share']:.2g} %"
    )
    if result["probabilities"] is not None:
        _print_chances(result["probabilities"])
    if settings:
        print(what_if_words(settings))


def _print_chances(chances: dict[str, Any]) -> None:
    print(
        f"release of the real locks, ± {chances['play_deg']:g}° of play, {number_of(chances['draws'], 'rig')} drawn "
        f"({100 * chances['level']:g} % intervals):"
    )
    for end in chances["ends"]:
        low, high = (100 * each for each in end["interval"])
        image = ", the other mirror image" if end["mirror_image"] else ""
        print(f"  {100 * end['probability']:5.1f} %  [{low:.1f}, {high:.1f}]  {end['type']}{image}")
    if chances["at_a_boundary"]:
        print(f"  {chances['at_a_boundary']} of the draws at a boundary")
    for why in chances["refused"]:
        notify(f"not followed: {why}")


def _end_words(end: dict[str, Any]) -> str:
    if end["type"] == "slipping":
        a, b = (round(rate, 9) + 0.0 for rate in end["turns_per_revolution"])  # no −0
        where = f"slipping, A {a:.5g} and B {b:.5g} turns per revolution"
    else:
        where = f"{end['type']:4} θ3 {end['theta3_deg']:.2f}° θ4 {end['theta4_deg']:.2f}°"
    settled = end["settled_s"]
    after = f", settled after {settled['median']:.1f} s (median), {settled['largest']:.1f} s at most" if settled else ""
    return f"{where}, amplitude {end['amplitude_mm']:.4f} mm, multiplier {end['multiplier_max']:.6f}{after}"
