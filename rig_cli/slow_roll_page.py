"""Effects of run-out and of a bow of a parameters file on predicted steady states."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rig_configs import IdentifiedParameters, Rig

if TYPE_CHECKING:
    from dynamics import RotorParameters, SteadyState

Entries = dict[str, Any]


def shown_json(state: SteadyState, known: IdentifiedParameters, rig: Rig) -> Entries:
    """Return what the sensors show of a steady state: order-1 amplitudes with run-out, and the motion's without it, mm.

    Args:
        known: with run-out and axis angle; without an identified angle the sensors' mounting angle is used.
        rig: how the sensors are mounted.
    """
    from analysis.prediction import known_axis_angle  # numba takes seconds to import
    from analysis.run_out import shown_run_out

    beta = math.radians(known_axis_angle(known, rig)[0])
    x, y = state.x_m, -1j * state.y_m
    motion = (x * math.cos(beta) + y * math.sin(beta), -x * math.sin(beta) + y * math.cos(beta))
    shown = tuple(z + r for z, r in zip(motion, shown_run_out(known.slow_roll), strict=True))
    more = 0.5 * sum(abs(s) ** 2 - abs(m) ** 2 for s, m in zip(shown, motion, strict=True))
    whole = math.sqrt(max(state.amplitude_m**2 + more, 0.0))
    return {
        "amplitude_mm": 1e3 * whole,
        "amplitude_x_mm": 1e3 * abs(shown[0]),
        "amplitude_y_mm": 1e3 * abs(shown[1]),
        "of_motion_x_mm": 1e3 * abs(motion[0]),
        "of_motion_y_mm": 1e3 * abs(motion[1]),
    }


def shown_line(shown: Entries) -> str:
    """Return one state's amplitudes as the sensors show them."""
    return (
        f"       with run-out the sensors show x {shown['amplitude_x_mm']:.4f} mm, y {shown['amplitude_y_mm']:.4f} mm "
        f"(the motion alone x {shown['of_motion_x_mm']:.4f} mm, y {shown['of_motion_y_mm']:.4f} mm)"
    )


def forced_region(physics: RotorParameters, speed_rad_s: float) -> str:
    """Return whether the pendulums can balance imbalance and bow together at a speed."""
    from dynamics import balancing_region
    from dynamics.steady.singular_points import bow_moment

    whole = abs(physics.imbalance_moment_kg_m + bow_moment(physics, speed_rad_s))
    return balancing_region(physics.a.first_moment_kg_m, physics.b.first_moment_kg_m, whole)
