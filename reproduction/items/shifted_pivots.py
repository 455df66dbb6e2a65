# pyright: strict, reportUnknownMemberType=false
"""Figures 3.21 to 3.24: a balancer whose pivot stands beside the rotor's axis, computed and recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.special import gammaincc  # pyright: ignore[reportMissingTypeStubs]

from analysis.figures.branches import A_COLOUR, B_COLOUR, wrapped_deg
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GREY, MEASURED, label
from analysis.steady_state import locked_radius_m
from dynamics import RotorParameters, Scene, SpeedHistory, SteadyState, locked_orbit, simulate_batch, steady_states
from dynamics.motions.integrate import locked_state
from dynamics.steady.pivot_shift import ShiftedPivot, shifted_pivot
from reproduction.recorded import Recorded, as_stated, recorded_points
from reproduction.results import Claim, Panel, Reproduced, Table
from reproduction.workspace import ISOTROPIC, Workspace, numbers_of

Array = NDArray[np.float64]

SPEED_RATIO = 20.0
RECORDED_RATIO = 19.5
_MOMENT = 0.995 * 2 * 0.075 * 0.054
_STIFFNESS = 287.01  # M_S (2π · 1 Hz)²
SETTINGS = (
    f"suspension.k1_N_per_m={_STIFFNESS}", f"suspension.k2_N_per_m={_STIFFNESS}", "suspension.zeta1=0.02",
    "suspension.zeta2=0.02", f"imbalance.radius_m={_MOMENT / 0.12!r}",
)  # fmt: skip
RECORDED = (0.0, 0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.5, 1.75, 2.15, 2.6, 3.0)
_SHIFTS = np.linspace(0.0, 3.0, 301)
_RHO = "relative shift of the pivot ρ_C = R_C/e"
_BREAK = 0.02
_CHOSEN = (
    "S_P = 0.995 (S_A + S_B), ζ = 0.02: the source says slightly below the limit, and small damping.",
    "f_n = 1 Hz instead of 3 Hz: with 3 Hz its 1200 rpm are Ω = 6.7, not almost 20.",
    "The shift's own imbalance is balanced away, as its procedure has it. e = S_P/M_S.",
)
_ARM_M = 2e-6
_FRICTION_AT = (0.5, 0.9, 1.0, 1.1, 1.5)
_FRICTION_STARTS, _END_S = 12, 60.0
_NOISE_S = 2.0


def _computed(work: Workspace, ratio: float = SPEED_RATIO) -> tuple[RotorParameters, ShiftedPivot]:
    p = work.physics(ISOTROPIC, SETTINGS)
    return p, shifted_pivot(p, p.speed_rad_s(ratio), _SHIFTS)


def _curve_table(found: ShiftedPivot) -> Table:
    shift, alpha = found.ratio
    return Table("curve", "Stable state over the relative shift", {
        "rho_C": shift, "alpha": alpha, "theta3_deg": np.degrees(found.theta_rad[:, 0]) % 360,
        "theta4_deg": np.degrees(found.theta_rad[:, 1]) % 360, "apart_deg": np.degrees(found.apart_rad),
    })  # fmt: skip


def vibration_3_21(work: Workspace) -> Reproduced:
    """Figure 3.21: released over locked amplitude, computed."""
    p, found = _computed(work)
    printed_e = p.imbalance_moment_kg_m / (p.rotor_mass_kg + p.imbalance_mass_kg)
    printed = shifted_pivot(p, p.speed_rad_s(SPEED_RATIO), _SHIFTS, printed_e)
    figure = _alpha_figure("3.21: vibration with a shifted pivot, computed", found, printed, None)
    shift, alpha = found.ratio
    below, beyond = (shift > 0) & (shift < found.together), shift > found.together
    slope = float(np.mean(alpha[below] / shift[below]))
    bent = float(np.max(np.abs(alpha[below] / shift[below] / slope - 1)))
    rise = float((alpha[beyond][-1] - alpha[beyond][0]) / (shift[beyond][-1] - shift[beyond][0]))
    return Reproduced(
        (Panel("vibration", "α rises in proportion to the shift up to 2 and stays there.", figure),),
        (_curve_table(found),),
        numbers_of(p) | {"speed_ratio": SPEED_RATIO, "e_m": found.eccentricity_m},
        _CHOSEN,
        (
            Claim.judged("3.3", "The vibration rises in proportion to the shift.", bent < 1e-6,
                         f"α = {slope:.4f} ρ_C up to the break, within {bent:.0e}: what is left is the shift itself"),
            Claim.judged("3.3", "The curve breaks at ρ_C = 2.", abs(found.together - 2) < _BREAK,
                         f"found at ρ_C = {found.together:.5f}; (S_P + S_A + S_B)/S_P/(1 − 1/Ω²) = "
                         f"{(1 + 1 / 0.995) / (1 - SPEED_RATIO**-2):.5f}"),
            Claim.judged("3.3", "Beyond the break the vibration almost settles into a plateau.",
                         abs(rise) < 0.01 * slope,
                         f"α = {alpha[beyond][0]:.4f} at the break, {alpha[-1]:.4f} at ρ_C = 3: {rise:.0e} per unit"),
            Claim.judged("(3-34)", "The eccentricity that ρ_C counts in is M_P P_3/(M_D + M_P).",
                         abs(printed.together - 2) < _BREAK,
                         f"so counted the breaks lie at {printed.most_apart:.4f} and {printed.together:.4f} instead of "
                         f"{found.most_apart:.4f} and {found.together:.4f}: "
                         f"{100 * (printed.together / found.together - 1):+.1f} %. "
                         "The pendulums turn with the rotor; the mass is M_S"),
            _integrated(p, found),
        ),
    )  # fmt: skip


def _alpha_figure(title: str, found: ShiftedPivot, printed: ShiftedPivot | None, rows: list[_Row] | None) -> Figure:
    foot = [] if rows is None else ["Error bars: ± 2 standard deviations. Open grey symbol: not settled within 90 s."]
    with sheet(WIDTH_IN, 3.6, title, foot) as figure:
        axes: Axes = figure.subplots()
        axes.plot(*found.ratio, color="black", lw=1.5, label="model, e = S_P/M_S")
        if printed is not None:
            axes.plot(*printed.ratio, color="#8a8a8a", lw=1.0, ls=(0, (5, 2)), label="model, e = S_P/(M_D + M_P)")
        for row in rows or []:
            colour = MEASURED if row.settled else GREY
            axes.errorbar(row.shift, row.alpha, yerr=2 * row.alpha_std, fmt="D", color=colour, mfc="white", ms=5,
                          capsize=3, label="recorded" if row.settled else "recorded, not settled")  # fmt: skip
        _breaks([axes], found)
        axes.set(xlim=(-0.04, 3.04), ylim=(0, 2.4))
        label(axes, _RHO, "α: amplitude released over locked")
    return figure


def _breaks(rows: list[Axes], found: ShiftedPivot) -> None:
    for axes in rows:
        for value in (found.most_apart, found.together):
            axes.axvline(value, color=GREY, lw=0.8, ls=(0, (4, 3)))


def _integrated(p: RotorParameters, found: ShiftedPivot) -> Claim:
    """α at three shifts by integration of the equations of motion."""
    worst = 0.0
    for shift in (0.5, 1.5, 2.5):
        own = replace(p, pivot_shift_m=shift * found.eccentricity_m)
        ends = _released(own, np.array([[0.2, 179.9]]), 90.0)
        x, _ = locked_orbit(own, own.speed_rad_s(SPEED_RATIO), 0.0, math.pi)
        alpha = float(np.hypot(ends[0, 0], ends[0, 1]) / abs(x))
        worst = max(worst, abs(alpha / float(np.interp(shift, *found.ratio)) - 1))
    return Claim.judged(
        "3.3", "The curve is that of the equations of motion.", worst < 1e-4,
        f"released from 0.2° and 179.9° and integrated for 90 s at ρ_C = 0.5, 1.5, 2.5: α within {worst:.0e}",
    )  # fmt: skip


def _released(p: RotorParameters, starts_deg: Array, end_s: float) -> Array:
    """Last states of releases from (n, 2) angles, shape (n, 8)."""
    speed = p.speed_rad_s(SPEED_RATIO)
    history = SpeedHistory.constant(speed)
    scenes = [
        Scene(history, (True, True), locked_state(p, speed, 0.0, math.radians(a), math.radians(b)))
        for a, b in starts_deg.tolist()
    ]
    found = simulate_batch([p] * len(scenes), scenes, np.array([0.0, end_s]), 1e-5, last_only=True)
    return np.asarray(found.states, np.float64)[:, 0]


def positions_3_22(work: Workspace) -> Reproduced:
    """Figure 3.22: absolute and relative positions, computed."""
    p, found = _computed(work)
    figure = _position_figure("3.22: pendulum positions with a shifted pivot, computed", found, None)
    start = np.degrees(found.theta_rad[0]) % 360
    largest = math.degrees(float(np.max(found.apart_rad)))
    beyond = found.ratio[0] > found.together
    return Reproduced(
        (Panel("positions", "Above: both angles; below: the smaller angle between the pendulums.", figure),),
        (_curve_table(found),),
        numbers_of(p) | {"speed_ratio": SPEED_RATIO, "e_m": found.eccentricity_m},
        _CHOSEN,
        (
            Claim.judged("3.3", "Without a shift the pendulums stand near 180° and almost overlap.",
                         np.max(np.abs(start - 180)) < 10, f"θ3 {start[0]:.2f}°, θ4 {start[1]:.2f}°"),
            Claim.judged("3.3", "At ρ_C = 1 the pendulums are 180° apart.",
                         abs(found.most_apart - 1) < _BREAK and largest > 179,
                         f"farthest apart at ρ_C = {found.most_apart:.5f}, by {largest:.2f}°"),
            Claim.judged("3.3", "From ρ_C = 2 on the pendulums overlap.",
                         abs(found.together - 2) < _BREAK and np.max(found.apart_rad[beyond]) < 1e-9,
                         f"Type III from ρ_C = {found.together:.5f} to {found.ratio[0][-1]:g}, at "
                         f"{math.degrees(float(found.theta_rad[-1, 0])) % 360:.2f}°"),
        ),
    )  # fmt: skip


def _position_figure(
    title: str, found: ShiftedPivot, rows: list[_Row] | None, friction: dict[float, Array] | None = None
) -> Figure:
    foot = [] if rows is None else [
        "Where the release fell to the mirror image, both angles are mirrored at 180°. Error bars: ± 2 standard "
        "deviations; where a recording did not settle, its range in the last 30 s. Dots: releases from random angles, "
        f"integrated with dry friction of a {1e6 * _ARM_M:g} µm arm."
    ]  # fmt: skip
    shift = found.ratio[0]
    with sheet(WIDTH_IN, 5.4, title, foot) as figure:
        panels: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        first, second = _one_side(found.theta_rad)
        panels[0].plot(shift, wrapped_deg(first), color=A_COLOUR, lw=1.8, label="A, model")
        panels[0].plot(shift, wrapped_deg(second), color=B_COLOUR, lw=1.3, label="B, model")
        panels[1].plot(shift, np.degrees(found.apart_rad), color="black", lw=1.5, label="apart, model")
        for at, ends in (friction or {}).items():
            a, b = _one_side(ends)
            for angles, colour in ((a, A_COLOUR), (b, B_COLOUR)):
                panels[0].plot(np.full(len(angles), at), np.degrees(angles) % 360, ".", color=colour, ms=4, alpha=0.6)
            panels[1].plot(np.full(len(ends), at), _apart_deg(ends), ".", color=GREY, ms=4)
        for row in rows or []:
            _draw_row(panels, row)
        _breaks(panels, found)
        panels[0].set(ylim=(0, 360), yticks=(0, 90, 180, 270, 360), xlim=(-0.04, 3.04))
        panels[1].set(ylim=(0, 190), yticks=(0, 60, 120, 180))
        label(panels[0], None, "pendulum angle, °")
        label(panels[1], _RHO, "apart, °")
    return figure


def _draw_row(panels: list[Axes], row: _Row) -> None:
    for i, (sign, colour, which) in enumerate((("o", A_COLOUR, "A"), ("x", B_COLOUR, "B"))):
        panels[0].errorbar(row.shift, row.theta_deg[i], yerr=row.error_deg[i], fmt=sign, color=colour, mfc="none", ms=7,
                           mew=1.3, capsize=3, label=f"{which}, recorded")  # fmt: skip
    panels[1].errorbar(row.shift, row.apart_deg, yerr=2 * row.apart_std_deg, fmt="D", color=MEASURED, mfc="white", ms=5,
                       capsize=3, label="apart, recorded")  # fmt: skip


def _one_side(theta_rad: Array) -> tuple[Array, Array]:
    """Both angles (n,) of (n, 2), mirrored at the imbalance's line where A stands behind B."""
    swapped = np.sin(theta_rad[:, 1] - theta_rad[:, 0]) < 0
    sign = np.where(swapped, -1.0, 1.0)
    return sign * theta_rad[:, 0], sign * theta_rad[:, 1]


def _apart_deg(theta_rad: Array) -> Array:
    return np.degrees(np.abs(np.angle(np.exp(1j * (theta_rad[:, 0] - theta_rad[:, 1])))))


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
    e = _MOMENT / work.physics(ISOTROPIC, SETTINGS).total_mass_kg
    found = list[_Row]()
    for i, shift in enumerate(RECORDED):
        own = (*SETTINGS, f"points.above.speed_ratio={RECORDED_RATIO}", f"virtual.seed={i + 1}",
               f"pendulums.pivot_shift_m={shift * e!r}")  # fmt: skip
        place = work.recordings(f"rho-{shift:g}")
        (one,) = recorded_points(place, ISOTROPIC, as_stated(ISOTROPIC, own))
        found.append(_row(shift, one))
        work.tell((i + 1) / len(RECORDED))
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
    a, b = _one_side(theta)
    return _Row(
        shift, one, state, alpha, math.hypot(own, alpha * noise) / locked, state.amplitude_m / abs(x),
        np.degrees([a[0], b[0]]) % 360, error, float(_apart_deg(theta)[0]),
        math.degrees(math.hypot(*std)) if settled else 0.5, z,
    )  # fmt: skip


def _range_deg(one: Recorded) -> Array:
    """Half the range of both angles in the last 30 s, °."""
    run, end = one.run, one.measured.to_s
    late = (run.angle_time_s > end - 30) & (run.angle_time_s <= end) & np.isfinite(run.angle_rad).all(axis=1)
    return 0.5 * np.degrees(np.ptp(run.angle_rad[late], axis=0))


def _row_table(rows: list[_Row]) -> Table:
    return Table("recorded", "Recorded on the virtual rig", {
        "rho_C": [row.shift for row in rows], "type": [row.state.type for row in rows],
        "alpha": [row.alpha for row in rows], "alpha_std": [row.alpha_std for row in rows],
        "alpha_model": [row.alpha_model for row in rows],
        "theta3_deg": [row.theta_deg[0] for row in rows], "theta4_deg": [row.theta_deg[1] for row in rows],
        "apart_deg": [row.apart_deg for row in rows],
        "apart_model_deg": [float(_apart_deg(np.array([row.state.theta_rad]))[0]) for row in rows],
        "settled": [str(row.settled) for row in rows],
    }, shown=True)  # fmt: skip


def recorded_vibration_3_23(work: Workspace) -> Reproduced:
    """Figure 3.23: released over locked amplitude, recorded."""
    rows = _recordings(work)
    p, found = _computed(work, _mean_ratio(rows))
    figure = _alpha_figure("3.23: vibration with a shifted pivot, recorded", found, None, rows)
    own = [row for row in rows if row.settled and row.shift > 0]
    off = np.array([row.alpha - row.alpha_model for row in own])
    far = float(np.max(np.abs(off / np.array([row.alpha_model for row in own]))))
    rising = [row for row in own if row.shift < 2]
    slope = float(np.polyfit([row.shift for row in rising], [row.alpha for row in rising], 1)[0])
    flat = [row.alpha for row in own if row.shift > 2]
    return Reproduced(
        (Panel("vibration", "Recorded amplitudes, released over locked, on the computed curve.", figure),),
        (_row_table(rows), _curve_table(found)),
        numbers_of(p) | {"speed_ratio": _mean_ratio(rows), "e_m": found.eccentricity_m},
        (*_CHOSEN, "Each recording is one release by a rig with its own draw of sensors, clocks and locks."),
        (
            Claim.judged("Figure 3.23", "The measured vibration rises in proportion and hardly beyond ρ_C = 2.",
                         abs(slope - 1) < 0.02 and max(flat) - min(flat) < 0.02,
                         f"slope {slope:.4f} up to 2; {min(flat):.4f} … {max(flat):.4f} beyond"),
            Claim.judged("Figure 3.23", "Measured and computed vibration agree.", far < 0.005,
                         f"{len(own)} settled recordings with a shift: α within {100 * far:.2f} %; without a shift "
                         f"α = {rows[0].alpha:.1e}"),
        ),
    )  # fmt: skip


def _mean_ratio(rows: list[_Row]) -> float:
    each = [(row.recorded.measured.speed_rad_s.value, row.recorded.rig.physics) for row in rows]
    return float(np.mean([speed / p.natural_frequencies_rad_s[0] for speed, p in each]))


def recorded_positions_3_24(work: Workspace) -> Reproduced:
    """Figure 3.24: absolute and relative positions, recorded."""
    rows = _recordings(work)
    p, found = _computed(work, _mean_ratio(rows))
    friction = _with_friction(p, found.eccentricity_m)
    figure = _position_figure("3.24: pendulum positions with a shifted pivot, recorded", found, rows, friction)
    own = [row for row in rows if row.settled]
    z = np.array([row.angle_z for row in own])
    chi2 = float(np.sum(z**2))
    chance = float(gammaincc(0.5 * z.size, 0.5 * chi2))
    gaps = [abs(row.apart_deg - float(_apart_deg(np.array([row.state.theta_rad]))[0])) for row in rows]
    return Reproduced(
        (Panel("positions",
               "Recorded angles on the computed curves; at ρ_C = 1 the pair's direction is open.", figure),),
        (_row_table(rows), _curve_table(found), _friction_table(p, found, friction)),
        numbers_of(p) | {"speed_ratio": _mean_ratio(rows), "e_m": found.eccentricity_m},
        (*_CHOSEN, f"Dry friction: an arm of {1e6 * _ARM_M:g} µm on both pendulums, integrated; the recordings have none."),
        (
            Claim.judged("Figure 3.24", "Measured relative positions are almost those computed.", max(gaps) < 1.0,
                         f"{len(rows)} recordings, the unsettled among them: within {max(gaps):.2f}°"),
            Claim.judged("Figure 3.24", "Measured absolute positions are those computed, but for ρ_C near 1.",
                         chance > 0.01 and all(abs(row.shift - 1) < 0.15 for row in rows if not row.settled),
                         f"{len(own)} settled recordings: χ² {chi2:.1f} on {z.size}, p = {chance:.2f}; not settled "
                         f"within 90 s: ρ_C = {', '.join(f'{row.shift:g}' for row in rows if not row.settled) or 'none'}"),
            _indifferent(p, found, friction),
        ),
    )  # fmt: skip


def _with_friction(p: RotorParameters, e: float) -> dict[float, Array]:
    """ρ_C ↦ angles (n, 2) at which releases from random angles end with dry friction."""
    found: dict[float, Array] = {}
    for shift in _FRICTION_AT:
        own = replace(p, pivot_shift_m=shift * e, a=replace(p.a, friction_arm_m=_ARM_M),
                      b=replace(p.b, friction_arm_m=_ARM_M))  # fmt: skip
        starts = np.random.default_rng(24).uniform(0, 360, (_FRICTION_STARTS, 2))
        found[shift] = _released(own, starts, _END_S)[:, 2:4]
    return found


def _scatter(p: RotorParameters, found: ShiftedPivot, friction: dict[float, Array]) -> list[tuple[float, float, float]]:
    """ρ_C, largest distance of the pair's angles from computed, and of the angle between, °."""
    out = list[tuple[float, float, float]]()
    for shift, ends in friction.items():
        own = replace(p, pivot_shift_m=shift * found.eccentricity_m)
        states = [s for s in steady_states(own, own.speed_rad_s(SPEED_RATIO), 1e-9) if s.draws]
        absolute = [min(float(np.max(np.abs(np.angle(np.exp(1j * (end - np.array(s.theta_rad))))))) for s in states)
                    for end in ends]  # fmt: skip
        gap = float(_apart_deg(np.array([states[0].theta_rad]))[0])
        out.append((shift, math.degrees(max(absolute)), float(np.max(np.abs(_apart_deg(ends) - gap)))))
    return out


def _friction_table(p: RotorParameters, found: ShiftedPivot, friction: dict[float, Array]) -> Table:
    rows = _scatter(p, found, friction)
    return Table("friction", f"Releases from {_FRICTION_STARTS} random angles with dry friction", {
        "rho_C": [r for r, _, _ in rows], "largest_off_deg": [a for _, a, _ in rows],
        "largest_off_apart_deg": [b for _, _, b in rows],
    }, shown=True)  # fmt: skip


def _indifferent(p: RotorParameters, found: ShiftedPivot, friction: dict[float, Array]) -> Claim:
    rows = {shift: (absolute, apart) for shift, absolute, apart in _scatter(p, found, friction)}
    near, others = rows[1.0], [rows[shift] for shift in rows if abs(shift - 1) > 0.3]
    return Claim.judged(
        "3.3.1", "Near ρ_C = 1 friction alone decides the absolute position, while the relative one stays 180°.",
        near[0] > 5 * max(a for a, _ in others) and near[1] < 0.2 * near[0],
        "; ".join(f"ρ_C = {shift:g}: absolute off by up to {a:.1f}°, relative by {b:.1f}°"
                  for shift, (a, b) in rows.items()),
    )  # fmt: skip
