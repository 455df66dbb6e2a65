"""Figures 3.23 and 3.24: a shifted pivot on the virtual rig, and the effect of dry friction near ρ_C = 1."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from scipy.special import gammaincc

from analysis.figures.branches import A_COLOUR, B_COLOUR
from analysis.figures.style import GREY, MEASURED
from analysis.steady_state import locked_radius_m
from dynamics import RotorParameters, SteadyState, locked_orbit, steady_states
from dynamics.steady.pivot_shift import ShiftedPivot
from reproduction.items.shifted_pivots import (
    CHOSEN,
    MOMENT_KG_M,
    SETTINGS,
    SPEED_RATIO,
    alpha_figure,
    apart_deg,
    computed,
    curve_table,
    one_side,
    position_figure,
    released,
)
from reproduction.recorded import Recorded, as_stated, recorded_points
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import ISOTROPIC, Workspace, numbers_of
from rig_basics.arrays import Array
from rig_basics.texts import number_of

RECORDED_RATIO = 19.5
RECORDED = (0.0, 0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.5, 1.75, 2.15, 2.6, 3.0)
_ARM_M = 2e-6
_FRICTION_AT = (0.5, 0.9, 1.0, 1.1, 1.5)
_FRICTION_STARTS, _END_S = 12, 60.0
_ALPHA_FOOT = "Error bars: ± 2 standard deviations. Grey: not settled within 90 s."
_ANGLE_FOOT = (
    "Where the release fell to the mirror image, both angles are mirrored at 180°. Error bars: ± 2 standard "
    "deviations; where a recording did not settle, its range in the last 30 s. Dots: releases from random angles, "
    f"integrated with dry friction of a {1e6 * _ARM_M:g} µm arm."
)


@dataclass(frozen=True)
class _Row:
    """A recording at one shift."""

    shift: float
    recorded: Recorded
    state: SteadyState
    alpha: float
    alpha_std: float
    alpha_model: float
    theta_deg: Array
    error_deg: Array
    apart_deg: float
    apart_std_deg: float
    angle_z: Array

    @property
    def settled(self) -> bool:
        return self.recorded.measured.settling.settled


def _recordings(work: Workspace) -> list[_Row]:
    e = MOMENT_KG_M / work.physics(ISOTROPIC, SETTINGS).total_mass_kg
    found = list[_Row]()
    for i, shift in enumerate(RECORDED):
        own = (
            *SETTINGS,
            f"points.above.speed_ratio={RECORDED_RATIO}",
            f"virtual.seed={i + 1}",
            f"pendulums.pivot_shift_m={shift * e!r}",
        )
        place = work.recordings(f"rho-{shift:g}")
        (one,) = recorded_points(place, ISOTROPIC, as_stated(ISOTROPIC, own))
        found.append(_row(shift, one))
        work.progress((i + 1) / len(RECORDED))
    return found


def _row(shift: float, one: Recorded) -> _Row:
    measured, p = one.measured, one.rig.physics
    near = np.exp(1j * np.array([theta.value for theta in measured.theta_rad]))
    stable = [s for s in steady_states(p, measured.speed_rad_s.value, 1e-9) if s.draws]
    state = min(stable, key=lambda s: float(np.max(np.abs(np.exp(1j * np.array(s.theta_rad)) - near))))
    theta = np.array([[t.value for t in measured.theta_rad]])
    std = np.array([t.std for t in measured.theta_rad])
    locked = locked_radius_m(one.run)
    x, _ = locked_orbit(p, measured.speed_rad_s.value, 0.0, math.pi)
    own = math.sqrt(measured.own[4, 4])
    noise = measured.noise_floor_m * math.sqrt(3.0)  # two seconds instead of six
    alpha = measured.amplitude_m.value / locked
    z = np.array([math.remainder(a - b, 2 * math.pi) for a, b in zip(theta[0], state.theta_rad, strict=True)]) / std
    settled = measured.settling.settled
    error = np.degrees(2 * std) if settled else _range_deg(one)
    a, b = one_side(theta)
    return _Row(
        shift,
        one,
        state,
        alpha,
        math.hypot(own, alpha * noise) / locked,
        state.amplitude_m / abs(x),
        np.degrees([a[0], b[0]]) % 360,
        error,
        float(apart_deg(theta)[0]),
        math.degrees(math.hypot(*std)) if settled else 0.5,
        z,
    )


def _range_deg(one: Recorded) -> Array:
    """Return half the range of both angles in the last 30 s, °."""
    run, end = one.run, one.measured.to_s
    late = (run.angle_time_s > end - 30) & (run.angle_time_s <= end) & np.isfinite(run.angle_rad).all(axis=1)
    return 0.5 * np.degrees(np.ptp(run.angle_rad[late], axis=0))


def _row_table(rows: list[_Row]) -> SourceTable:
    return SourceTable(
        "recorded",
        "Recorded on the virtual rig",
        {
            "rho_C": [row.shift for row in rows],
            "type": [row.state.type for row in rows],
            "alpha": [row.alpha for row in rows],
            "alpha_std": [row.alpha_std for row in rows],
            "alpha_model": [row.alpha_model for row in rows],
            "theta3_deg": [row.theta_deg[0] for row in rows],
            "theta4_deg": [row.theta_deg[1] for row in rows],
            "apart_deg": [row.apart_deg for row in rows],
            "apart_model_deg": [float(apart_deg(np.array([row.state.theta_rad]))[0]) for row in rows],
            "settled": [str(row.settled) for row in rows],
        },
        shown=True,
    )


def vibration_3_23(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.23: released over locked amplitude, recorded."""
    rows = _recordings(work)
    p, found = computed(work, _mean_ratio(rows))
    title = "3.23: vibration with a shifted pivot, recorded"
    figure = alpha_figure(title, found, None, partial(_draw_alpha, rows), _ALPHA_FOOT)
    own = [row for row in rows if row.settled and row.shift > 0]
    off = np.array([row.alpha - row.alpha_model for row in own])
    far = float(np.max(np.abs(off / np.array([row.alpha_model for row in own]))))
    rising = [row for row in own if row.shift < 2]
    slope = float(np.polyfit([row.shift for row in rising], [row.alpha for row in rising], 1)[0])
    flat = [row.alpha for row in own if row.shift > 2]
    return Reproduced(
        (Panel("vibration", "Recorded amplitudes, released over locked, on the computed curve.", figure),),
        (_row_table(rows), curve_table(found)),
        numbers_of(p) | {"speed_ratio": _mean_ratio(rows), "e_m": found.eccentricity_m},
        (*CHOSEN, "Each recording is one release by a rig with its own draw of sensors, clocks and locks."),
        (
            Claim.judged(
                "Figure 3.23",
                "The measured vibration rises in proportion and hardly beyond ρ_C = 2.",
                abs(slope - 1) < 0.02 and max(flat) - min(flat) < 0.02,
                f"slope {slope:.4f} up to 2; {min(flat):.4f} … {max(flat):.4f} beyond",
            ),
            Claim.judged(
                "Figure 3.23",
                "Measured and computed vibration agree.",
                far < 0.005,
                f"{number_of(len(own), 'settled recording')} with a shift: α within {100 * far:.2f} %; without a shift "
                f"α = {rows[0].alpha:.1e}",
            ),
        ),
    )


def _mean_ratio(rows: list[_Row]) -> float:
    each = [(row.recorded.measured.speed_rad_s.value, row.recorded.rig.physics) for row in rows]
    return float(np.mean([speed / p.natural_frequencies_rad_s[0] for speed, p in each]))


def positions_3_24(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.24: absolute and relative positions, recorded."""
    rows = _recordings(work)
    p, found = computed(work, _mean_ratio(rows))
    friction = _with_friction(p, found.eccentricity_m)
    title = "3.24: pendulum positions with a shifted pivot, recorded"
    figure = position_figure(title, found, partial(_draw_positions, rows, friction), _ANGLE_FOOT)
    own = [row for row in rows if row.settled]
    z = np.array([row.angle_z for row in own])
    chi2 = float(np.sum(z**2))
    chance = float(gammaincc(0.5 * z.size, 0.5 * chi2))
    open_ones = ", ".join(f"{row.shift:g}" for row in rows if not row.settled) or "none"
    gaps = [abs(row.apart_deg - float(apart_deg(np.array([row.state.theta_rad]))[0])) for row in rows]
    return Reproduced(
        (
            Panel(
                "positions", "Recorded angles on the computed curves; at ρ_C = 1 the pair's direction is open.", figure
            ),
        ),
        (_row_table(rows), curve_table(found), _friction_table(p, found, friction)),
        numbers_of(p) | {"speed_ratio": _mean_ratio(rows), "e_m": found.eccentricity_m},
        (*CHOSEN, f"Dry friction: an arm of {1e6 * _ARM_M:g} µm on both, integrated; the recordings have none."),
        (
            Claim.judged(
                "Figure 3.24",
                "Measured relative positions are almost those computed.",
                max(gaps) < 1.0,
                f"{number_of(len(rows), 'recording')}, the unsettled among them: within {max(gaps):.2f}°",
            ),
            Claim.judged(
                "Figure 3.24",
                "Measured absolute positions are those computed, but for ρ_C near 1.",
                chance > 0.01 and all(abs(row.shift - 1) < 0.15 for row in rows if not row.settled),
                f"{number_of(len(own), 'settled recording')}: χ² {chi2:.1f} on {z.size}, p = {chance:.2f}; not settled "
                f"within 90 s: ρ_C = {open_ones}",
            ),
            _indifferent(p, found, friction),
        ),
    )


def _with_friction(p: RotorParameters, e: float) -> dict[float, Array]:
    """Return ρ_C → angles (n, 2) at which releases from random angles end with dry friction."""
    found: dict[float, Array] = {}
    for shift in _FRICTION_AT:
        own = replace(
            p, pivot_shift_m=shift * e, a=replace(p.a, friction_arm_m=_ARM_M), b=replace(p.b, friction_arm_m=_ARM_M)
        )
        starts = np.random.default_rng(24).uniform(0, 360, (_FRICTION_STARTS, 2))
        found[shift] = released(own, starts, _END_S)[:, 2:4]
    return found


def _scatter(p: RotorParameters, found: ShiftedPivot, friction: dict[float, Array]) -> list[tuple[float, float, float]]:
    """Return ρ_C → largest distance of the pair's angles from the computed ones, and of the angle between, °."""
    out = list[tuple[float, float, float]]()
    for shift, ends in friction.items():
        own = replace(p, pivot_shift_m=shift * found.eccentricity_m)
        states = [s for s in steady_states(own, own.speed_rad_s(SPEED_RATIO), 1e-9) if s.draws]
        absolute = [
            min(float(np.max(np.abs(np.angle(np.exp(1j * (end - np.array(s.theta_rad))))))) for s in states)
            for end in ends
        ]
        gap = float(apart_deg(np.array([states[0].theta_rad]))[0])
        out.append((shift, math.degrees(max(absolute)), float(np.max(np.abs(apart_deg(ends) - gap)))))
    return out


def _friction_table(p: RotorParameters, found: ShiftedPivot, friction: dict[float, Array]) -> SourceTable:
    rows = _scatter(p, found, friction)
    return SourceTable(
        "friction",
        f"Releases from {_FRICTION_STARTS} random angles with dry friction",
        {
            "rho_C": [r for r, _, _ in rows],
            "largest_off_deg": [a for _, a, _ in rows],
            "largest_offapart_deg": [b for _, _, b in rows],
        },
        shown=True,
    )


def _indifferent(p: RotorParameters, found: ShiftedPivot, friction: dict[float, Array]) -> Claim:
    rows = {shift: (absolute, apart) for shift, absolute, apart in _scatter(p, found, friction)}
    near, others = rows[1.0], [rows[shift] for shift in rows if abs(shift - 1) > 0.3]
    return Claim.judged(
        "3.3.1",
        "Near ρ_C = 1 friction alone decides the absolute position, while the relative one stays 180°.",
        near[0] > 5 * max(a for a, _ in others) and near[1] < 0.2 * near[0],
        "; ".join(
            f"ρ_C = {shift:g}: absolute off by up to {a:.1f}°, relative by {b:.1f}°" for shift, (a, b) in rows.items()
        ),
    )


def _draw_alpha(rows: list[_Row], panels: list[Axes]) -> None:
    for row in rows:
        colour = MEASURED if row.settled else GREY
        panels[0].errorbar(
            row.shift,
            row.alpha,
            yerr=2 * row.alpha_std,
            fmt="D",
            color=colour,
            mfc="white",
            ms=5,
            capsize=3,
            label="recorded" if row.settled else "recorded, not settled",
        )


def _draw_positions(rows: list[_Row], friction: dict[float, Array], panels: list[Axes]) -> None:
    for at, ends in friction.items():
        for angles, colour in zip(one_side(ends), (A_COLOUR, B_COLOUR), strict=True):
            panels[0].plot(np.full(len(angles), at), np.degrees(angles) % 360, ".", color=colour, ms=4, alpha=0.6)
        panels[1].plot(np.full(len(ends), at), apart_deg(ends), ".", color=GREY, ms=4)
    for row in rows:
        _draw_row(panels, row)


def _draw_row(panels: list[Axes], row: _Row) -> None:
    for i, (sign, colour, which) in enumerate((("o", A_COLOUR, "A"), ("x", B_COLOUR, "B"))):
        panels[0].errorbar(
            row.shift,
            row.theta_deg[i],
            yerr=row.error_deg[i],
            fmt=sign,
            color=colour,
            mfc="none",
            ms=7,
            mew=1.3,
            capsize=3,
            label=f"{which}, recorded",
        )
    panels[1].errorbar(
        row.shift,
        row.apart_deg,
        yerr=2 * row.apart_std_deg,
        fmt="D",
        color=MEASURED,
        mfc="white",
        ms=5,
        capsize=3,
        label="apart, recorded",
    )
