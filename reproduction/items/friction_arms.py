"""Figures 3.28 and 3.31: friction that holds a ball or a pendulum off its balance, and scatter of start-ups."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GOOD, GREY, MEASURED, MODEL, label
from analysis.friction_sweep import FrictionSweep, scatter_over_friction
from dynamics import RotorParameters
from dynamics.equations.parameters import rolling_arm
from dynamics.equations.rolling_contact import (
    YIELDS_AT,
    Contact,
    Material,
    hertz_contact,
    hysteresis_resistance,
    plastic_depth,
)
from dynamics.motions.start_ups import random_starts
from reproduction.items.start_ups import BALLS, PENDULUMS, PIN_ARM_M, SPEED, SPEED_RPM
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import ISOTROPIC, Workspace, numbers_of

COUNT = 16
"""Start-ups at each friction arm."""
ARMS_M = tuple(1e-6 * np.array([2, 4, 8, 15, 30, 60, 100, 150, 250, 400, 700]))
STEEL = Material(208e9, 0.30, 2.0e9)
ALUMINIUM = Material(68.9e9, 0.33, 276e6)
"""6061-T6."""
SOFT_YIELD_PA = 55e6
"""6061 annealed."""
STEEL_KG_PER_M3 = 7810.0
CLAIMED_M = 16e-6
_RAMP_S = SPEED_RPM / 120.0
_DAMPED_NMS = 5e-4
_FLOOR_DEG = 1e-3
_BEARING = (0.0015 * 3e-3, 0.003 * 5e-3)  # friction coefficient times pin radius of small ball bearings, m
_BUSHING = (0.1 * 3e-3, 0.2 * 5e-3)  # of dry plain bushings, m
_G, _SLIP = 9.81, 0.2


def arms_3_28(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.28: contact of the ball, friction arms of both balancers, scatter over assumed friction."""
    p = work.physics(BALLS)
    pendulum = work.physics(ISOTROPIC, [each for each in PENDULUMS if not each.startswith(("virtual", "limits"))])
    damped = replace(
        p, a=replace(p.a, damping_Nms_per_rad=_DAMPED_NMS), b=replace(p.b, damping_Nms_per_rad=_DAMPED_NMS)
    )
    force = p.a.first_moment_kg_m * SPEED**2
    contact = hertz_contact(force, p.a.ball_radius_m, STEEL, ALUMINIUM, p.a.length_m + p.a.ball_radius_m)
    rigs = {"balls": p, "balls, damped five times as much": damped, "pendulums": pendulum}
    sweeps = dict[str, FrictionSweep]()
    for i, (name, rig) in enumerate(rigs.items()):
        sweeps[name] = scatter_over_friction(rig, ARMS_M, SPEED, _RAMP_S, random_starts(COUNT, 328))
        work.progress((i + 1) / len(rigs))
    resistance = {"elastic, 2 % lost": hysteresis_resistance(contact, 0.02), "assumed in 3.27": 1e-5, "soft wall": 5e-5}
    arms = {name: rolling_arm(b, p.a.length_m, p.a.ball_radius_m) for name, b in resistance.items()}
    return Reproduced(
        (
            Panel(
                "force",
                "Radius of the contact and approach of ball and wall over the force between them; the force "
                "at 1500 rpm, where yielding begins, and the 16 µm of the text.",
                _draw_contact(p, force),
            ),
            Panel(
                "arms",
                "Friction arms as bars from the least to the largest usual one: rolling balls, ball bearings "
                "and plain bushings of pendulums.",
                _draw_arms(arms),
            ),
            Panel(
                "scatter",
                "Above: standard deviation of the resting places over the friction arm; below: amplitude "
                "left. Balls, balls with more damping, pendulums; dashed: half width of the band friction holds.",
                _draw_sweeps(sweeps),
            ),
        ),
        (_arm_table(arms), *(_sweep_table(i, name, sweep) for i, (name, sweep) in enumerate(sweeps.items()))),
        numbers_of(p)
        | {
            "ball_radius_m": p.a.ball_radius_m,
            "speed_rpm": SPEED_RPM,
            "force_N": force,
            "steel_GPa": 208.0,
            "aluminium_GPa": 68.9,
            "yield_MPa": 276.0,
        },
        (
            "The wall is a cylinder (not a groove across the path) of 6061-T6; a groove that fits the ball gives less.",
            "Friction arms are those of usual bearings: balls 0.6 to 50 µm of rolling resistance, ball bearings "
            "μ = 0.0015 to 0.003 on pins of 3 to 5 mm radius, dry bushings μ = 0.1 to 0.2. The source names none.",
            f"Scatter: {COUNT} start-ups from random places at each arm, the model's numbers of 3.27 and 3.29.",
        ),
        (
            *_contact_claims(p, force, contact),
            _stops_before(sweeps["balls"]),
            _levers(arms),
            *_susceptible(sweeps),
        ),
    )


def _contact_claims(p: RotorParameters, force: float, contact: Contact) -> tuple[Claim, ...]:
    mass = STEEL_KG_PER_M3 * 4 / 3 * math.pi * p.a.ball_radius_m**3
    weight = p.a.mass_kg * _G
    floor = _SLIP * _G / SPEED**2
    rolls = p.a.friction_arm_m
    plastic = [plastic_depth(force, p.a.ball_radius_m, each) for each in (ALUMINIUM.yield_Pa, SOFT_YIELD_PA)]
    return (
        Claim.judged(
            "section 3.3.2",
            "A chrome-steel ball of 15 mm weighs 13.8 g.",
            abs(mass / 13.8e-3 - 1) < 0.01,
            f"{1e3 * mass:.2f} g with {STEEL_KG_PER_M3:g} kg/m³",
        ),
        Claim.judged(
            "section 3.3.2",
            "Ball and channel come together by 16 µm at 1500 rpm.",
            abs(contact.approach_m / CLAIMED_M - 1) < 0.25,
            f"{force:.1f} N give {1e6 * contact.approach_m:.2f} µm by Hertz (half axes "
            f"{1e6 * contact.half_axes_m[0]:.0f} and {1e6 * contact.half_axes_m[1]:.0f} µm, "
            f"{1e-6 * contact.peak_pressure_Pa:.0f} MPa: {contact.peak_pressure_Pa / ALUMINIUM.yield_Pa:.1f} yield "
            f"stresses, so it yields). Where all around yields the dent is {1e6 * plastic[0]:.1f} µm, "
            f"{1e6 * plastic[1]:.1f} µm in annealed metal: 16 µm need "
            f"{(CLAIMED_M / contact.approach_m) ** 1.5:.0f} times the force",
        ),
        Claim.judged(
            "section 3.3.2",
            "The centrifugal force is much larger than the weight.",
            force > 30 * weight,
            f"{force:.1f} N against {weight:.3f} N: {force / weight:.0f} times",
        ),
        Claim.judged(
            "Figure 3.28",
            "The ball rolls on the wall and slips on the floor, whose friction holds it too.",
            force > weight,
            f"the wall can pull {force / weight:.0f} times as much as the floor, so it slips there; friction "
            f"arm of the floor μ g/ω² = {1e6 * floor:.0f} µm with μ = {_SLIP:g}, of rolling {1e6 * rolls:.0f} µm with "
            f"b = 10 µm; the floor's is larger for b below {1e6 * floor * p.a.ball_radius_m / p.a.length_m:.1f} µm",
        ),
    )


def _stops_before(balls: FrictionSweep) -> Claim:
    still = balls.still == 1.0
    growing = np.polyfit(np.log(balls.arm_m[still]), np.log(balls.amplitude_m[still]), 1)[0]
    return Claim.judged(
        "section 3.3.2",
        "Rolling resistance stops the balls before they balance, and that leaves a vibration.",
        bool(np.all(balls.held[still] < 1.001)) and growing > 0.5,
        f"all {int(still.sum()) * COUNT} ends need at most {balls.held[still].max():.3f} of the friction to be held; "
        f"the amplitude left is {1e6 * balls.amplitude_m[0]:.1f} µm at an arm of {1e6 * balls.arm_m[0]:.0f} µm, "
        f"{1e6 * balls.amplitude_m[-3]:.0f} µm at {1e6 * balls.arm_m[-3]:.0f} µm: about the arm itself",
    )


def _levers(arms: dict[str, float]) -> Claim:
    """Compare rolling resistance on a lever R/r with friction at a pin."""
    least, most = min(arms.values()), max(arms.values())
    better, worse = least / _BEARING[1] > 1, most / _BEARING[0] > 1
    bushing = arms["assumed in 3.27"] > _BUSHING[1]
    verdict = "holds" if better and bushing else "holds in part" if worse else "does not hold"
    return Claim(
        "Figure 3.31",
        "Friction holds a ball on a longer lever than it holds a pendulum.",
        verdict,
        f"a ball's arm is b R/r, 15.2 b: {1e6 * least:.0f} to {1e6 * most:.0f} µm, "
        f"{1e6 * arms['assumed in 3.27']:.0f} µm as assumed; a pendulum's is μ times the pin's radius: ball bearings "
        f"{1e6 * _BEARING[0]:.0f} to "
        f"{1e6 * _BEARING[1]:.0f} µm, dry bushings {1e6 * _BUSHING[0]:.0f} to {1e6 * _BUSHING[1]:.0f} µm. As assumed "
        f"{arms['assumed in 3.27'] / PIN_ARM_M:.0f} times, but less than a dry bushing's",
    )


def _susceptible(sweeps: dict[str, FrictionSweep]) -> tuple[Claim, ...]:
    balls, damped, pendulums = (sweeps[name] for name in ("balls", "balls, damped five times as much", "pendulums"))
    ratio = balls.scatter_rad / np.maximum(pendulums.scatter_rad, math.radians(_FLOOR_DEG))
    much = ratio > 5
    turns = float(pendulums.arm_m[~much][0]) if np.any(~much) else math.inf
    like = [(arm, pendulums.arm_at(float(np.interp(arm, balls.arm_m, balls.scatter_rad)))) for arm in (15.2e-6, 152e-6)]
    calmed = float(balls.scatter_rad[4] / damped.scatter_rad[4])
    words = "; ".join(
        f"balls of b = {1e6 * arm / 15.2:.0f} µm ({1e6 * arm:.0f} µm of arm) scatter less than pendulums from a pin's "
        + (f"arm of {1e6 * same:.0f} µm on" if math.isfinite(same) else f"arm beyond {1e6 * ARMS_M[-1]:.0f} µm on")
        for arm, same in like
    )
    return (
        Claim(
            "section 3.3.2",
            "Pendulum balancers are less susceptible to friction than ball balancers.",
            "holds" if np.all(much) else "holds in part" if np.any(much) else "does not hold",
            f"at equal friction arms the balls scatter more than five times as much below {1e6 * turns:.0f} µm and "
            f"{ratio.min():.1f} to {ratio[~much].max(initial=0.0):.1f} times from there on. {words}",
        ),
        Claim(
            "Figure 3.31",
            "The distribution of the forces is what makes pendulums consistent.",
            "holds" if calmed < 2 else "holds in part",
            f"at equal arms, with five times the viscous damping balls scatter "
            f"{np.degrees(damped.scatter_rad[4]):.2g}° at an arm of "
            f"{1e6 * damped.arm_m[4]:.0f} µm, with their own {np.degrees(balls.scatter_rad[4]):.2g}°, pendulums "
            f"{np.degrees(pendulums.scatter_rad[4]):.2g}°: motions that are damped more come to rest from the same "
            f"side each time; the damping alone makes {calmed:.0f} times less scatter",
        ),
    )


def _draw_contact(p: RotorParameters, force: float) -> Figure:
    forces = np.geomspace(0.5, 600.0, 60)
    found = [
        hertz_contact(float(f), p.a.ball_radius_m, STEEL, ALUMINIUM, p.a.length_m + p.a.ball_radius_m) for f in forces
    ]
    approach = 1e6 * np.array([each.approach_m for each in found])
    pressure = np.array([each.peak_pressure_Pa for each in found])
    yields = float(np.interp(YIELDS_AT * ALUMINIUM.yield_Pa, pressure, forces))
    with sheet(WIDTH_IN, 3.2, "3.28: approach of a 15 mm steel ball and a wall of 6061-T6, r = 121.5 mm") as figure:
        axes = figure.subplots()
        axes.loglog(forces, approach, color=MODEL, label="elastic (Hertz)")
        axes.loglog(
            forces,
            1e6 * np.array([plastic_depth(float(f), p.a.ball_radius_m, ALUMINIUM.yield_Pa) for f in forces]),
            color=MODEL,
            ls=(0, (5, 2)),
            label="dent where all around yields",
        )
        axes.axvline(force, color=MEASURED, lw=1.2, label=f"centrifugal force at 1500 rpm, {force:.1f} N")
        axes.axvline(yields, color=GREY, ls=(0, (1, 1.5)), lw=1.2, label=f"yielding begins, {yields:.1f} N")
        axes.axhline(1e6 * CLAIMED_M, color=GOOD, ls=(0, (6, 1.5, 1, 1.5)), lw=1.2, label="16 µm, as the source has it")
        label(axes, "force, N", "approach, µm")
    return figure


def _draw_arms(arms: dict[str, float]) -> Figure:
    rows = {
        "ball, b = 0.6 to 50 µm": (min(arms.values()), max(arms.values())),
        "ball on the floor, μ = 0.1 to 0.3": (0.1 * _G / SPEED**2, 0.3 * _G / SPEED**2),
        "pendulum in ball bearings": _BEARING,
        "pendulum in dry bushings": _BUSHING,
    }
    with sheet(WIDTH_IN, 2.2, "3.31: friction arms: torque that holds over the contact force") as figure:
        axes = figure.subplots()
        for i, (low, high) in enumerate(rows.values()):
            colour = MEASURED if i < 2 else MODEL
            axes.plot([1e6 * low, 1e6 * high], [i, i], color=colour, lw=9, solid_capstyle="butt", alpha=0.75)
        axes.plot(1e6 * arms["assumed in 3.27"], 0, "o", mfc="white", mec="black", ms=6, label="assumed in 3.27, 3.29")
        axes.plot(1e6 * PIN_ARM_M, 2, "o", mfc="white", mec="black", ms=6)
        axes.set(xscale="log", yticks=range(len(rows)), yticklabels=list(rows), ylim=(len(rows) - 0.4, -0.6))
        label(axes, "friction arm, µm")
    return figure


_LOOKS = {"balls": (MEASURED, "o"), "balls, damped five times as much": (GOOD, "s"), "pendulums": (MODEL, "^")}


def _draw_sweeps(sweeps: dict[str, FrictionSweep]) -> Figure:
    with sheet(
        WIDTH_IN,
        5.4,
        f"3.31: {COUNT} start-ups from rest to 1500 rpm at each friction arm, by the model",
        (f"Below {_FLOOR_DEG:g}° a scatter is drawn there. Dashed: how far from the balance friction holds one.",),
    ) as figure:
        rows: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        for name, sweep in sweeps.items():
            colour, marker = _LOOKS[name]
            arm = 1e6 * sweep.arm_m
            rows[0].loglog(
                arm,
                np.maximum(np.degrees(sweep.scatter_rad), _FLOOR_DEG),
                color=colour,
                marker=marker,
                ms=4.5,
                label=name,
            )
            rows[1].loglog(arm, 2e3 * sweep.amplitude_m, color=colour, marker=marker, ms=4.5)
            if name != "balls, damped five times as much":
                rows[0].loglog(arm, np.degrees(sweep.half_width_rad), color=colour, ls=(0, (5, 2)), lw=1.0)
        for axes in rows:
            axes.axvline(1e6 * PIN_ARM_M, color=MODEL, lw=0.9, ls=(0, (1, 1.5)), label="pendulums as in 3.29")
            axes.axvline(152, color=MEASURED, lw=0.9, ls=(0, (1, 1.5)), label="balls as in 3.27")
        label(rows[0], None, "scatter of a place, °")
        label(rows[1], "friction arm, µm", "mean amplitude left, mm\n(peak to peak)")
    return figure


def _arm_table(arms: dict[str, float]) -> SourceTable:
    pins = [f"pendulum, {kind}, {end}" for kind in ("ball bearing", "dry bushing") for end in ("least", "largest")]
    names = [*(f"ball, {name}" for name in arms), *pins]
    values = np.array([*arms.values(), *_BEARING, *_BUSHING])
    return SourceTable("arms", "Friction arms", {"what": names, "friction_arm_um": 1e6 * values}, shown=True)


def _sweep_table(number: int, name: str, sweep: FrictionSweep) -> SourceTable:
    return SourceTable(
        f"scatter-{number + 1}",
        f"Start-ups over the friction arm: {name}",
        {
            "friction_arm_um": 1e6 * sweep.arm_m,
            "scatter_deg": np.degrees(sweep.scatter_rad),
            "band_half_width_deg": np.degrees(sweep.half_width_rad),
            "off_balance_deg": np.array([math.degrees(each.off_rad) for each in sweep.scatter]),
            "amplitude_pp_mm": 2e3 * sweep.amplitude_m,
            "amplitude_scatter_pp_mm": np.array([2e3 * each.amplitude_scatter_m for each in sweep.scatter]),
            "share_at_rest": sweep.still,
            "share_followed": sweep.followed,
        },
        shown=True,
    )
