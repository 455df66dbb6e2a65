"""Figures 3.21 and 3.22: a balancer whose pivot is off the rotor's axis, computed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.branches import A_COLOUR, B_COLOUR, wrapped_deg
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GREY, label
from dynamics import RotorParameters, Scene, SpeedHistory, locked_orbit, simulate_batch
from dynamics.motions.integrate import locked_state
from dynamics.steady.pivot_shift import ShiftedPivot, shifted_pivot
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import ISOTROPIC, Workspace, numbers_of
from rig_basics.arrays import Array

SPEED_RATIO = 20.0
MOMENT_KG_M = 0.995 * 2 * 0.075 * 0.054
_STIFFNESS = 287.01  # M_S (2π · 1 Hz)²
SETTINGS = (
    f"suspension.k1_N_per_m={_STIFFNESS}",
    f"suspension.k2_N_per_m={_STIFFNESS}",
    "suspension.zeta1=0.02",
    "suspension.zeta2=0.02",
    f"imbalance.radius_m={MOMENT_KG_M / 0.12!r}",
)
_SHIFTS = np.linspace(0.0, 3.0, 301)
_RHO = "relative shift of the pivot ρ_C = R_C/e"
_BREAK = 0.02
CHOSEN = (
    "S_P = 0.995 (S_A + S_B), ζ = 0.02: the source states slightly below the limit, and small damping.",
    "f_n = 1 Hz instead of 3 Hz: with 3 Hz its 1200 rpm are Ω = 6.7, not almost 20.",
    "The shift's own imbalance is balanced away, as its procedure has it. e = S_P/M_S.",
)


def computed(work: Workspace, ratio: float = SPEED_RATIO) -> tuple[RotorParameters, ShiftedPivot]:
    """The rig, and its stable state over the shift."""
    p = work.physics(ISOTROPIC, SETTINGS)
    return p, shifted_pivot(p, p.speed_rad_s(ratio), _SHIFTS)


def curve_table(found: ShiftedPivot) -> SourceTable:
    """Return the stable state as rows."""
    shift, alpha = found.ratio
    return SourceTable(
        "curve",
        "Stable state over the relative shift",
        {
            "rho_C": shift,
            "alpha": alpha,
            "theta3_deg": np.degrees(found.theta_rad[:, 0]) % 360,
            "theta4_deg": np.degrees(found.theta_rad[:, 1]) % 360,
            "apart_deg": np.degrees(found.apart_rad),
        },
    )


def vibration_3_21(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.21: released over locked amplitude, computed."""
    p, found = computed(work)
    printed_e = p.imbalance_moment_kg_m / (p.rotor_mass_kg + p.imbalance_mass_kg)
    printed = shifted_pivot(p, p.speed_rad_s(SPEED_RATIO), _SHIFTS, printed_e)
    figure = alpha_figure("3.21: vibration with a shifted pivot, computed", found, printed)
    shift, alpha = found.ratio
    below, beyond = (shift > 0) & (shift < found.together), shift > found.together
    slope = float(np.mean(alpha[below] / shift[below]))
    bent = float(np.max(np.abs(alpha[below] / shift[below] / slope - 1)))
    rise = float((alpha[beyond][-1] - alpha[beyond][0]) / (shift[beyond][-1] - shift[beyond][0]))
    return Reproduced(
        (Panel("vibration", "α rises in proportion to the shift up to 2 and stays there.", figure),),
        (curve_table(found),),
        numbers_of(p) | {"speed_ratio": SPEED_RATIO, "e_m": found.eccentricity_m},
        CHOSEN,
        (
            Claim.judged(
                "3.3",
                "The vibration rises in proportion to the shift.",
                bent < 1e-6,
                f"α = {slope:.4f} ρ_C up to the break, within {bent:.0e}: what is left is the shift itself",
            ),
            Claim.judged(
                "3.3",
                "The curve breaks at ρ_C = 2.",
                abs(found.together - 2) < _BREAK,
                f"found at ρ_C = {found.together:.5f}; (S_P + S_A + S_B)/S_P/(1 − 1/Ω²) = "
                f"{(1 + 1 / 0.995) / (1 - SPEED_RATIO**-2):.5f}",
            ),
            Claim.judged(
                "3.3",
                "Beyond the break the vibration almost settles into a plateau.",
                abs(rise) < 0.01 * slope,
                f"α = {alpha[beyond][0]:.4f} at the break, {alpha[-1]:.4f} at ρ_C = 3: {rise:.0e} per unit",
            ),
            Claim.judged(
                "(3-34)",
                "The eccentricity that ρ_C counts in is M_P P_3/(M_D + M_P).",
                abs(printed.together - 2) < _BREAK,
                f"so counted the breaks lie at {printed.most_apart:.4f} and {printed.together:.4f} instead of "
                f"{found.most_apart:.4f} and {found.together:.4f}: "
                f"{100 * (printed.together / found.together - 1):+.1f} %. "
                "The pendulums turn with the rotor; the mass is M_S",
            ),
            _integrated(p, found),
        ),
    )


Draw = Callable[[list[Axes]], None]
"""Draws recorded values onto a figure's plots."""


def alpha_figure(
    title: str, found: ShiftedPivot, printed: ShiftedPivot | None = None, more: Draw | None = None, foot: str = ""
) -> Figure:
    """Draw α over ρ_C."""
    with sheet(WIDTH_IN, 3.6, title, [foot] if foot else []) as figure:
        axes: Axes = figure.subplots()
        axes.plot(*found.ratio, color="black", lw=1.5, label="model, e = S_P/M_S")
        if printed is not None:
            axes.plot(*printed.ratio, color="#8a8a8a", lw=1.0, ls=(0, (5, 2)), label="model, e = S_P/(M_D + M_P)")
        if more is not None:
            more([axes])
        _breaks([axes], found)
        axes.set(xlim=(-0.04, 3.04), ylim=(0, 2.4))
        label(axes, _RHO, "α: amplitude released over locked")
    return figure


def _breaks(rows: list[Axes], found: ShiftedPivot) -> None:
    for axes in rows:
        for value in (found.most_apart, found.together):
            axes.axvline(value, color=GREY, lw=0.8, ls=(0, (4, 3)))


def _integrated(p: RotorParameters, found: ShiftedPivot) -> Claim:
    """Return α at three shifts by integration of the equations of motion."""
    worst = 0.0
    for shift in (0.5, 1.5, 2.5):
        own = replace(p, pivot_shift_m=shift * found.eccentricity_m)
        ends = released(own, np.array([[0.2, 179.9]]), 90.0)
        x, _ = locked_orbit(own, own.speed_rad_s(SPEED_RATIO), 0.0, math.pi)
        alpha = float(np.hypot(ends[0, 0], ends[0, 1]) / abs(x))
        worst = max(worst, abs(alpha / float(np.interp(shift, *found.ratio)) - 1))
    return Claim.judged(
        "3.3",
        "The curve is that of the equations of motion.",
        worst < 1e-4,
        f"released from 0.2° and 179.9° and integrated for 90 s at ρ_C = 0.5, 1.5, 2.5: α within {worst:.0e}",
    )


def released(p: RotorParameters, starts_deg: Array, end_s: float) -> Array:
    """Return the last states of releases from (n, 2) angles, shape (n, 8)."""
    speed = p.speed_rad_s(SPEED_RATIO)
    history = SpeedHistory.constant(speed)
    scenes = [
        Scene(history, (True, True), locked_state(p, speed, 0.0, math.radians(a), math.radians(b)))
        for a, b in starts_deg.tolist()
    ]
    found = simulate_batch([p] * len(scenes), scenes, np.array([0.0, end_s]), 1e-5, last_only=True)
    return np.asarray(found.states, np.float64)[:, 0]


def positions_3_22(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.22: absolute and relative positions, computed."""
    p, found = computed(work)
    figure = position_figure("3.22: pendulum positions with a shifted pivot, computed", found)
    start = np.degrees(found.theta_rad[0]) % 360
    largest = math.degrees(float(np.max(found.apart_rad)))
    beyond = found.ratio[0] > found.together
    return Reproduced(
        (Panel("positions", "Above: both angles; below: the smaller angle between the pendulums.", figure),),
        (curve_table(found),),
        numbers_of(p) | {"speed_ratio": SPEED_RATIO, "e_m": found.eccentricity_m},
        CHOSEN,
        (
            Claim.judged(
                "3.3",
                "Without a shift the pendulums stand near 180° and almost overlap.",
                np.max(np.abs(start - 180)) < 10,
                f"θ3 {start[0]:.2f}°, θ4 {start[1]:.2f}°",
            ),
            Claim.judged(
                "3.3",
                "At ρ_C = 1 the pendulums are 180° apart.",
                abs(found.most_apart - 1) < _BREAK and largest > 179,
                f"farthest apart at ρ_C = {found.most_apart:.5f}, by {largest:.2f}°",
            ),
            Claim.judged(
                "3.3",
                "From ρ_C = 2 on the pendulums overlap.",
                abs(found.together - 2) < _BREAK and np.max(found.apart_rad[beyond]) < 1e-9,
                f"Type III from ρ_C = {found.together:.5f} to {found.ratio[0][-1]:g}, at "
                f"{math.degrees(float(found.theta_rad[-1, 0])) % 360:.2f}°",
            ),
        ),
    )


def position_figure(title: str, found: ShiftedPivot, more: Draw | None = None, foot: str = "") -> Figure:
    """Draw both angles above, the angle between them below."""
    shift = found.ratio[0]
    with sheet(WIDTH_IN, 5.4, title, [foot] if foot else []) as figure:
        panels: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        first, second = one_side(found.theta_rad)
        panels[0].plot(shift, wrapped_deg(first), color=A_COLOUR, lw=1.8, label="A, model")
        panels[0].plot(shift, wrapped_deg(second), color=B_COLOUR, lw=1.3, label="B, model")
        panels[1].plot(shift, np.degrees(found.apart_rad), color="black", lw=1.5, label="apart, model")
        if more is not None:
            more(panels)
        _breaks(panels, found)
        panels[0].set(ylim=(0, 360), yticks=(0, 90, 180, 270, 360), xlim=(-0.04, 3.04))
        panels[1].set(ylim=(0, 190), yticks=(0, 60, 120, 180))
        label(panels[0], None, "pendulum angle, °")
        label(panels[1], _RHO, "apart, °")
    return figure


def one_side(theta_rad: Array) -> tuple[Array, Array]:
    """Return both angles (n,) of (n, 2), mirrored at the imbalance's line if A is behind B."""
    swapped = np.sin(theta_rad[:, 1] - theta_rad[:, 0]) < 0
    sign = np.where(swapped, -1.0, 1.0)
    return sign * theta_rad[:, 0], sign * theta_rad[:, 1]


def apart_deg(theta_rad: Array) -> Array:
    """Return the smaller angle between the pendulums, (n,) of (n, 2), °."""
    return np.degrees(np.abs(np.angle(np.exp(1j * (theta_rad[:, 0] - theta_rad[:, 1])))))
