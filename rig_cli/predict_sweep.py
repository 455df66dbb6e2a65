"""`rig predict --sweep`: steady states along one number of a rig, and where the stable type changes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig_basics.texts import number_of
from rig_basics.units import RPM, TO_RPM
from rig_cli.console import print_json, wait_for_compilation
from rig_cli.options import what_if_words
from rig_cli.share_progress import share_progress
from rig_cli.speed import SpeedChoice
from rig_configs import IdentifiedParameters, Rig, RigFileError, load_rig

if TYPE_CHECKING:
    from dynamics.steady.branches import Branch, SteadyBranches


def predict_sweep(
    rig: str,
    text: str,
    known: IdentifiedParameters,
    settings: Sequence[str],
    speed: SpeedChoice,
    accuracy: float,
    plot: Path | None,
    *,
    json: bool,
) -> int:
    """Compute the branches over the number and their break points, and draw the figure.

    Args:
        text: KEY=A:B:N[:log].
        speed: constant speed, unless the number is the speed.
    """
    with wait_for_compilation("dynamics"):
        from analysis.maps.lines import line_over
        from rig_cli.map_axes import read_axis
    axis = read_axis("--sweep", text, "rig predict")

    def rig_with(more: list[str]) -> Rig:
        return load_rig(rig, known, [*settings, *more])

    loaded = rig_with([])
    line = line_over(rig_with, axis, *_speed(loaded, speed), effects=known.with_effects)
    with share_progress(f"{number_of(axis.count, 'value')} of {axis.key}") as progress:
        found = line.branches(accuracy, progress)
    if plot is not None:
        from analysis.figures.branches import draw_branches
        from analysis.figures.style import save

        at = "" if axis.is_speed else f", {line.at(axis.low)[1] * TO_RPM:.1f} rpm"
        title = f"{loaded.name}{at}{what_if_words(settings, '; ')}"
        save(plot, draw_branches(found, axis.name, title, logarithmic=axis.logarithmic))
    if json:
        print_json(_json(found, axis.text, plot, settings))
        return 0
    for text_line in lines(found, axis.key):
        print(text_line)
    if settings:
        print(what_if_words(settings))
    return 0


def _speed(rig: Rig, speed: SpeedChoice) -> tuple[float | None, float | None]:
    """Return the speed in rad/s or as a ratio, whichever was given."""
    point, speed_rpm, speed_ratio = speed.point, speed.speed_rpm, speed.speed_ratio
    if speed.count > 1:
        raise RigFileError("rig predict: give one of --point, --speed-rpm, --speed-ratio")
    if point is not None:
        if point not in rig.points:
            raise RigFileError(f"rig predict: no point {point!r} in {rig.name}; known: {', '.join(rig.points)}")
        return None, rig.points[point].speed_ratio
    return None if speed_rpm is None else speed_rpm * RPM, speed_ratio


def lines(found: SteadyBranches, key: str) -> list[str]:
    """Return the result of a sweep as lines of text."""
    text = list[str]()
    for branch in found.stable_branches():
        ends = [_at(branch, i) for i in (0, -1)]
        text.append(
            f"{branch.type:4} stable from {key} = {branch.values[0]:.7g} to {branch.values[-1]:.7g}: "
            f"{ends[0]} … {ends[1]}"
        )
    if not text:
        text.append("no stable steady state at any value")
    for one in found.break_points:
        before, after = (" and ".join(types) or "none" for types in (one.before, one.after))
        text.append(f"break point at {key} = {one.value:.7g} ± {one.error:.1g}: stable before {before}, after {after}")
    if not found.break_points:
        text.append("no break point: the same types are stable at all values")
    if found.unresolved:
        value, why = found.unresolved[0]
        text.append(f"{len(found.unresolved)} not in the list, the first at {key} = {value:.7g}: {why}")
    return text


def _at(branch: Branch, i: int) -> str:
    a, b = (math.degrees(float(angle)) % 360 for angle in branch.theta_rad[i])
    return f"θ3 {a:.2f}° θ4 {b:.2f}° {1e3 * branch.amplitude_m[i]:.4f} mm"


def _json(found: SteadyBranches, axis: str, plot: Path | None, settings: Sequence[str]) -> dict[str, Any]:
    return {
        "sweep": axis,
        "break_points": [
            {"value": one.value, "error": one.error, "before": list(one.before), "after": list(one.after)}
            for one in found.break_points
        ],
        "branches": [
            {
                "type": b.type,
                "values": b.values.tolist(),
                "theta3_deg": [math.degrees(a) % 360 for a in b.theta_rad[:, 0].tolist()],
                "theta4_deg": [math.degrees(a) % 360 for a in b.theta_rad[:, 1].tolist()],
                "amplitude_mm": (1e3 * b.amplitude_m).tolist(),
                "multiplier_max": b.multiplier_max.tolist(),
                "stable": b.stable.tolist(),
            }
            for b in found.branches
        ],
        "values": found.values.tolist(),
        "locked_amplitude_mm": [
            1e3 * value if math.isfinite(value) else None for value in found.locked_amplitude_m.tolist()
        ],
        "unresolved": [{"value": value, "why": why} for value, why in found.unresolved],
        "what_if": list(settings),
        "plot": None if plot is None else str(plot),
    }
