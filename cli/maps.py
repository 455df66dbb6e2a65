"""The stability of the balanced state over two numbers of a rig, and its borders."""

from __future__ import annotations

import math
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from cli.console import print_json, say, share_progress, wait_for_compilation
from cli.model import Accuracy, Plot
from cli.numbers import Positive, PositiveRpm
from cli.options import Json, ParametersPath, Settings, need_place, what_if_words
from rig_configs import IdentifiedParameters, Rig, RigFileError, load_rig

if TYPE_CHECKING:
    from cli.map_axes import MapAxis
    from dynamics.stability.borders import Borders
    from dynamics.stability.stability_map import PlaneMap

Quantity = Literal["multiplier", "decay-rate"]
_BORDER_POINTS = 4000  # at least, of a border as long as a side of the map
_X, _Y = "speed_ratio=0.3:7:400", "stiffness_ratio=1:16:250"


def map(
    rig: str,
    *,
    x: Annotated[str, Parameter(help="KEY=A:B:N or KEY=A:B:N:log, N values from A to B; KEY+KEY change alike")] = _X,
    y: Annotated[str, Parameter(help="the same, of another number")] = _Y,
    quantity: Annotated[
        Quantity, Parameter(help="the largest multiplier, or the decay rate per second that follows from it")
    ] = "multiplier",
    borders: Annotated[
        bool, Parameter(negative="", help="follow the borders of stability, every branch to 1e-10, beside the map")
    ] = False,
    point: Annotated[str | None, Parameter(help="the speed of a point, where neither axis is a speed")] = None,
    speed_ratio: Annotated[Positive | None, Parameter(help="the speed, where neither axis is one")] = None,
    speed_rpm: Annotated[PositiveRpm | None, Parameter(help="the same in rpm")] = None,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"], help="write the arrays as .npz")] = None,
    plot: Plot = None,
    accuracy: Accuracy = 1e-8,
    parameters: ParametersPath = None,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Where the balanced state is stable, over any two numbers of the rig file.

    KEY is speed_ratio, speed_rpm, stiffness_ratio or a number of the rig file, such as imbalance.radius_m or
    suspension.zeta1+suspension.zeta2.
    """
    need_place("rig map:", output, plot)
    if output is not None and output.suffix != ".npz":
        raise RigFileError(f"rig map: -o expected a name ending in .npz, got {output}")
    known = IdentifiedParameters.load(parameters) if parameters else None
    loaded = load_rig(rig, known, settings or [])
    _say_what_is_left_out(loaded, known)
    with wait_for_compilation("stability map"):
        from cli.map_axes import plane_over, read_axis  # noqa: PLC0415
        from dynamics.stability.borders import stability_borders  # noqa: PLC0415
        from dynamics.stability.map_tiles import compile_tiles  # noqa: PLC0415
        from dynamics.stability.stability_map import plane_map  # noqa: PLC0415

        axes = read_axis("--x", x), read_axis("--y", y)
        speed = _speed(loaded, point, speed_ratio, speed_rpm)
        plane = plane_over(rig, known, settings or [], axes, speed)
        plane_map(plane, axes[0].values[:1], axes[1].values[:1], accuracy)
        compile_tiles()
    started = time.perf_counter()
    with share_progress(f"{len(axes[0].values) * len(axes[1].values)} points") as progress:
        found = plane_map(plane, axes[0].values, axes[1].values, accuracy, progress)
    seconds, lines = time.perf_counter() - started, None
    if borders:
        _need_an_area(axes)
        with share_progress("borders") as progress:
            logarithmic = axes[0].logarithmic, axes[1].logarithmic
            spacing = 1 / max(_BORDER_POINTS, *(len(axis.values) for axis in axes))  # no wider than the map's pitch
            lines = stability_borders(
                plane, axes[0].span, axes[1].span, spacing=spacing, logarithmic=logarithmic, progress=progress
            )
    if output is not None:
        np.savez_compressed(output, **_arrays(axes, found, lines))
    if plot is not None:
        _draw(plot, loaded, axes, found, lines, quantity)
    result = _result(axes, found, lines, seconds) | {
        "what_if": list(settings or []),
        "file": None if output is None else str(output),
        "plot": None if plot is None else str(plot),
    }
    if json:
        print_json(result)
        return 0
    _print(result, found, settings)
    for path in (output, plot):
        if path is not None:
            print(f"written to {path}")
    if output is None and plot is None:
        say("nothing kept: give -o FILE.npz for the arrays, --plot FILE for the figure")
    return 0


def _say_what_is_left_out(rig: Rig, known: IdentifiedParameters | None) -> None:
    if known and known.slow_roll and known.slow_roll.bow_m:
        say("the map leaves the bow out: a bent shaft has no state at rest")
    if rig.physics.a.friction_arm_m or rig.physics.b.friction_arm_m:
        say("the map leaves dry friction out")


def _need_an_area(axes: tuple[MapAxis, MapAxis]) -> None:
    if any(len(axis.values) < 2 for axis in axes):
        raise RigFileError("rig map: --borders needs both axes to span a range, A < B and N of at least 2")


def _speed(rig: Rig, point: str | None, speed_ratio: float | None, speed_rpm: float | None) -> float | None:
    """The speed given beside the axes, rad/s."""
    if sum(given is not None for given in (point, speed_ratio, speed_rpm)) > 1:
        raise RigFileError("rig map: give only one of --point, --speed-ratio, --speed-rpm")
    if point is not None:
        if point not in rig.points:
            raise RigFileError(f"rig map: no point {point!r} in {rig.name}; known: {', '.join(rig.points)}")
        return rig.physics.speed_rad_s(rig.points[point].speed_ratio)
    if speed_ratio is not None:
        return rig.physics.speed_rad_s(speed_ratio)
    return None if speed_rpm is None else speed_rpm * math.pi / 30


def _arrays(axes: tuple[MapAxis, MapAxis], found: PlaneMap, lines: Borders | None) -> dict[str, Any]:
    """What is kept: the axes under their keys, the map, and each border's points."""
    arrays: dict[str, Any] = {
        axes[0].keys[0]: found.x,
        axes[1].keys[0]: found.y,
        "multiplier_max": found.multiplier_max,
        "error_estimate": found.error_estimate,
        "decay_rate_per_s": found.decay_rate_per_s,
    }
    for number, branch in enumerate(lines.branches if lines else (), 1):
        arrays[f"border_{number}"] = np.column_stack([branch.x, branch.y])
        arrays[f"border_{number}_multiplier"] = branch.multiplier
    return arrays


def _draw(
    path: Path, rig: Rig, axes: tuple[MapAxis, MapAxis], found: PlaneMap, lines: Borders | None, quantity: Quantity
) -> None:
    from analysis.figures.stability_map import MapPoint, plane_map_figure  # noqa: PLC0415
    from analysis.figures.style import save  # noqa: PLC0415

    own = rig.physics.k2_N_per_m / rig.physics.k1_N_per_m
    usual = (axes[0].keys, axes[1].keys) == (("speed_ratio",), ("stiffness_ratio",))
    points = [MapPoint(name, p.speed_ratio, p.expected) for name, p in rig.points.items()] if usual else []
    names, logarithmic = (axes[0].name, axes[1].name), (axes[0].logarithmic, axes[1].logarithmic)
    as_rate = quantity == "decay-rate"
    save(path, plane_map_figure(found, names, logarithmic, lines, as_rate, points, own if usual else None))


def _result(axes: tuple[MapAxis, MapAxis], found: PlaneMap, lines: Borders | None, seconds: float) -> dict[str, Any]:
    there = np.isfinite(found.multiplier_max)
    stable = found.multiplier_max + found.error_estimate < 1.0
    size = found.multiplier_max.size
    return {
        "x": "+".join(axes[0].keys),
        "y": "+".join(axes[1].keys),
        "points": size,
        "balanced_share": float(np.mean(there)),
        "seconds": seconds,
        "microseconds_per_point": 1e6 * seconds / size,
        "method": found.method,
        "accuracy": found.accuracy,
        "largest_error_estimate": float(np.max(found.error_estimate[there], initial=0.0)),
        "stable_share": float(np.mean(stable)),
        "points_beyond_accuracy": found.missed,
        "borders": None if lines is None else [
            {"points": len(b.x), "closed": b.closed, "kinds": dict(Counter(b.kind)),
             "off_share_of_range": b.off,
             "from": [float(b.x[0]), float(b.y[0])], "to": [float(b.x[-1]), float(b.y[-1])]}
            for b in lines.branches
        ],
        "borders_complete_to": None if lines is None else list(lines.complete_to),
        "stable_share_by_borders": None if lines is None else lines.stable_share,
    }  # fmt: skip


def _print(result: dict[str, Any], found: PlaneMap, settings: list[str] | None) -> None:
    print(
        f"{result['points']} points in {result['seconds']:.3g} s ({result['microseconds_per_point']:.3g} µs a point), "
        f"balanced state stable on {100 * result['stable_share']:.1f} %, largest error estimate "
        f"{result['largest_error_estimate']:.1g}"
    )
    if result["balanced_share"] < 1:
        print(f"no balanced state exists on {100 * (1 - result['balanced_share']):.1f} %")
    print(f"method: {found.method}")
    for border in result["borders"] or []:
        ends = (
            "closed"
            if border["closed"]
            else "from {:.4g}, {:.4g} to {:.4g}, {:.4g}".format(*border["from"], *border["to"])
        )
        print(f"border: {', '.join(border['kinds'])}; {border['points']} points, {ends}")
    if result["borders"] is not None:
        across, up = result["borders_complete_to"]
        print(
            f"stable within the borders: {100 * result['stable_share_by_borders']:.3f} %; islands and bands "
            f"narrower than 1/{1 / across:.0f} of x or 1/{1 / up:.0f} of y may have been missed"
        )
    if settings:
        print(what_if_words(settings))
    if found.missed:
        say(f"{found.missed} points are known less well than asked; error_estimate says how well")
