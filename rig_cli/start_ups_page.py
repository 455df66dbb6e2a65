"""`rig predict --start-ups`: ends of repeated start-ups from rest by the model, as JSON and as lines."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.guided_tests.hands import HAND_RAMP_RPM_S
from rig_basics.texts import number_of
from rig_basics.units import TO_RPM
from rig_cli.share_progress import share_progress
from rig_configs import Rig, RigFileError

if TYPE_CHECKING:
    from dynamics.equations.parameters import RotorParameters

_SEED = 1
_MOST = 10_000


def start_ups_json(rig: Rig, physics: RotorParameters, speed: float, count: int, plot: Path | None) -> dict[str, Any]:
    """Simulate start-ups from random positions with pendulums or balls free, each with the rig's own ramp.

    Args:
        physics: the rotor, with its friction.
        speed: rad/s.
        count: number of start-ups.
        plot: file of a figure; None: no figure.
    Raises:
        RigFileError: the count is out of range, or the balancer is not a pair of equal pendulums or balls.
    """
    from analysis.figures.start_ups import draw_start_ups
    from analysis.figures.style import save
    from analysis.friction_sweep import balance_of
    from analysis.settled_scatter import settled_scatter
    from dynamics import locked_orbit
    from dynamics.motions.start_ups import random_starts, start_ups_from_rest

    if not 2 <= count <= _MOST:
        raise RigFileError(f"rig predict --start-ups {count}: expected 2 to {_MOST}")
    if not (physics.a.present and physics.b.present):
        raise RigFileError("rig predict --start-ups: expected two pendulums or balls, the rig has fewer")
    ramp = HAND_RAMP_RPM_S if rig.roles.speed is None else rig.roles.speed.ramp_rpm_per_s
    ramp_s = speed * TO_RPM / ramp
    with share_progress("starting up") as progress:
        ends = start_ups_from_rest(
            [physics] * count,
            speed,
            ramp_s,
            random_starts(count, _SEED),
            progress=lambda done, whole: progress(done / whole),
        )
    found = settled_scatter(ends.theta_rad, ends.amplitude_m[:, 0], balance_of(physics))
    locked = abs(locked_orbit(physics, speed)[0])
    if plot is not None:
        title = f"{rig.name}: {number_of(count, 'start-up')} from rest to {speed * TO_RPM:.0f} rpm, by the model"
        save(plot, draw_start_ups(found, title, {"locked at 0° and 180°": locked}))
    left = found.amplitude_m
    moving = int((ends.drift_rad > math.radians(0.1)).sum())
    return {
        "count": count,
        "friction_arm_m": [physics.a.friction_arm_m, physics.b.friction_arm_m],
        "ramp_rpm_per_s": ramp,
        "scatter_deg": math.degrees(found.scatter_rad),
        "off_balance_deg": None if math.isnan(found.off_rad) else math.degrees(found.off_rad),
        "amplitude_x_mm": {"mean": 1e3 * float(left.mean()), "largest": 1e3 * float(left.max())},
        "locked_amplitude_x_mm": 1e3 * locked,
        "not_at_rest": moving,
        "not_followed": int((~ends.followed).sum()),
        "theta_deg": [[math.degrees(angle) for angle in pair] for pair in ends.theta_rad.tolist()],
    }


def start_ups_lines(result: dict[str, Any]) -> list[str]:
    """Return the result as lines of text."""
    off, left = result["off_balance_deg"], result["amplitude_x_mm"]
    lines = [
        f"{number_of(result['count'], 'start-up')} from rest: places scatter by {result['scatter_deg']:.3g}°"
        + ("" if off is None else f", {off:.3g}° (rms) off the balance")
        + f"; amplitude {left['mean']:.3g} mm in the mean, {left['largest']:.3g} mm at most; locked at 0° and 180° "
        f"{result['locked_amplitude_x_mm']:.3g} mm"
    ]
    if result["not_at_rest"]:
        lines.append(f"  {result['not_at_rest']} of them had not come to rest on the rotor 30 s after the ramp")
    if result["not_followed"]:
        lines.append(f"  {result['not_followed']} of them cannot be followed numerically: their ends are examples")
    return lines
