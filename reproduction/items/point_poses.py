"""Figure 3.5: the three types of singular points, drawn to scale, and their conditions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import MODEL, label
from dynamics import Scene, SpeedHistory, balanced_angles, simulate
from dynamics.equations.parameters import RotorParameters
from dynamics.steady.point_eigenvalues import point_eigenvalues, stability_of
from dynamics.steady.singular_points import SingularPoint, singular_points
from dynamics.steady.whirl import circular_whirl
from reproduction.items.pendulum_sets import isotropic_rig, with_moments
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import Workspace, numbers_of
from rig_basics.texts import number_of

_ZETA = 0.05
_REVOLUTIONS = 60
_SETS = 400
A_COLOUR, B_COLOUR = "#0072B2", "#56B4E9"


def draw_pose(axes: Axes, p: RotorParameters, point: SingularPoint, title: str, whirl: float = 0.4) -> None:
    """Draw a rotor from above in its own frame: O its rest position, C its centre, imbalance and pendulums about C.

    Args:
        whirl: drawn distance of C from O, in radii of the disk; 0 if it rests at O.
    """
    centre = np.array([0.0, 0.0])
    if abs(point.z_m) > 0:
        centre = whirl * np.array([point.z_m.real, point.z_m.imag]) / abs(point.z_m)
        axes.plot((0, centre[0]), (0, centre[1]), color=MODEL, lw=1.2)
    axes.add_patch(Circle((centre[0], centre[1]), 1.0, fill=False, ec="#999999", lw=1.0))
    axes.plot((centre[0], centre[0] + 0.62), (centre[1], centre[1]), color="black", lw=0.8)
    axes.plot(centre[0] + 0.62, centre[1], "s", color="black", ms=6, label="imbalance")
    most = max(p.a.first_moment_kg_m, p.b.first_moment_kg_m)
    both = ((p.a, A_COLOUR, 0.86, "A"), (p.b, B_COLOUR, 0.74, "B"))
    for theta, (pendulum, colour, reach, name) in zip(point.theta_rad, both, strict=True):
        out = np.array([math.cos(theta), math.sin(theta)])
        tip = centre + reach * out
        axes.plot((centre[0], tip[0]), (centre[1], tip[1]), color=colour, lw=2.0)
        axes.plot(
            *tip,
            "o",
            color=colour,
            ms=4 + 5 * math.sqrt(pendulum.first_moment_kg_m / most),
            mec="white",
            mew=0.6,
            label=f"pendulum {name}",
        )
    axes.plot(*centre, "o", color=MODEL, ms=4, label="C: centre of the disk")
    axes.plot(0, 0, "+", color="black", ms=9, mew=1.4, label="O: where it would rest")
    axes.grid(False)
    axes.set(aspect="equal", xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), xticks=(), yticks=())
    for spine in axes.spines.values():
        spine.set_visible(False)
    label(axes, None, None, title)


def stable_first(p: RotorParameters, ratio: float, kind: str) -> SingularPoint:
    """Return a stable point of a type, or else its last one.

    Raises:
        StopIteration: no point of this type exists.
    """
    points = [point for point in singular_points(p, p.speed_rad_s(ratio)) if point.type == kind]
    stable = stability_of(point_eigenvalues(p, p.speed_rad_s(ratio), points)) if points else np.zeros(0)
    return next(point for _, point in sorted(zip(stable.tolist(), points, strict=True), key=lambda pair: -pair[0]))


def _light_b(p: RotorParameters) -> RotorParameters:
    """Pendulum B of 19 g and an imbalance of 1 g m: improperly oversized."""
    lighter = replace(p, b=replace(p.b, mass_kg=0.019))
    share = lighter.total_mass_kg / p.total_mass_kg
    return replace(lighter.with_values(SP_kg_m=0.001), k1_N_per_m=share * p.k1_N_per_m, k2_N_per_m=share * p.k2_N_per_m)


def types_3_5(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.5: a stable point of each type."""
    p = isotropic_rig(work, _ZETA)
    cases = [("I", p, 2.5), ("II", _light_b(p), 2.5), ("III", p, 0.8)]
    points = [stable_first(rig, ratio, kind) for kind, rig, ratio in cases]
    with sheet(WIDTH_IN, 3.3, "3.5: the three types of singular points, seen on the rotor") as figure:
        row: list[Axes] = figure.subplots(1, 3).tolist()
        for axes, (kind, rig, ratio), point in zip(row, cases, points, strict=True):
            theta = [math.degrees(t) for t in point.theta_rad]
            draw_pose(
                axes,
                rig,
                point,
                f"Type {kind}, Ω = {ratio:g}: |OC| = {1e3 * abs(point.z_m):.3f} mm\n"
                f"θ3 = {theta[0]:.1f}°, θ4 = {theta[1]:.1f}°",
            )
    columns = {
        "type": [kind for kind, _, _ in cases],
        "speed_ratio": [ratio for _, _, ratio in cases],
        "S_A_g_m": [1e3 * rig.a.first_moment_kg_m for _, rig, _ in cases],
        "S_B_g_m": [1e3 * rig.b.first_moment_kg_m for _, rig, _ in cases],
        "S_P_g_m": [1e3 * rig.imbalance_moment_kg_m for _, rig, _ in cases],
        "theta3_deg": [math.degrees(q.theta_rad[0]) for q in points],
        "theta4_deg": [math.degrees(q.theta_rad[1]) for q in points],
        "radius_mm": [1e3 * abs(q.z_m) for q in points],
    }
    return Reproduced(
        (
            Panel(
                "types",
                "Disk, imbalance on the right and pendulums in the rotor's frame: C is at O in Type I; in II and III "
                "it whirls about O, drawn at one length for any radius.",
                figure,
            ),
        ),
        (SourceTable("points", "Singular points drawn", columns, shown=True),),
        numbers_of(p),
        (
            f"One set of numbers for each, ζ = {_ZETA:g}; the source draws them without numbers. II: M_B = 19 g, "
            "S_P = 1 g m.",
        ),
        (_closed_form(p), _equations(cases), *_stay(cases, points)),
    )


def _closed_form(p: RotorParameters) -> Claim:
    """Compare (3-21), (3-22) as printed with the triangle of moments, for random properly oversized sets."""
    rng, worst, s = np.random.default_rng(35), 0.0, p.imbalance_moment_kg_m
    for _ in range(_SETS):
        a = s * rng.uniform(0.1, 2.0)
        b = rng.uniform(abs(a - s), a + s)
        first = (a + b - s) * (a + b + s)
        second = (a - b - s) * (a - b + s)
        root = math.sqrt(max(-first * second, 0.0))
        printed = (
            math.atan2(-root / (2 * s * a), -(a * a - b * b + s * s) / (2 * s * a)),
            math.atan2(root / (s * b), (a * a - b * b - s * s) / (s * b)),
        )
        away = [
            max(abs(np.exp(1j * own) - np.exp(1j * given)) for own, given in zip(pair, printed, strict=True))
            for pair in balanced_angles(with_moments(p, a, b))
        ]
        worst = max(worst, float(min(away)))
    return Claim.judged(
        "(3-21), (3-22)",
        "Type I's angles in closed form.",
        worst < 1e-6,
        f"{_SETS} random sets inside ABCD: one of the two mirror images within {worst:.0e} rad",
    )


def _equations(cases: list[tuple[str, RotorParameters, float]]) -> Claim:
    """Insert all points of all cases into (3-17) to (3-20) as printed."""
    lacking = turning = with_imbalance = 0.0
    count = 0
    for _, p, ratio in cases:
        speed, s = p.speed_rad_s(ratio), p.imbalance_moment_kg_m
        for point in singular_points(p, speed):
            turns = [complex(math.cos(t), math.sin(t)) for t in point.theta_rad]
            moments, z = (p.a.first_moment_kg_m, p.b.first_moment_kg_m), point.z_m
            whole = p.total_mass_kg * z + sum(m * turn for m, turn in zip(moments, turns, strict=True))
            spring = complex(p.k1_N_per_m, speed * p.damping_Ns_per_m[0]) * z
            printed = (spring - speed**2 * whole) / (speed**2 * s)
            torques = [m * (z * turn.conjugate()).imag for m, turn in zip(moments, turns, strict=True)]
            lacking, with_imbalance = max(lacking, abs(printed)), max(with_imbalance, abs(printed - 1))
            turning = max(turning, *(abs(torque) / (s * max(abs(z), 1e-3)) for torque in torques))
            count += 1
    return Claim.judged(
        "(3-17) to (3-20)",
        "Singular points fulfil the four equations as printed.",
        lacking < 1e-9 and turning < 1e-9,
        f"{number_of(count, 'point')} of all types: torques vanish within {turning:.0e} S_P |z|; of the "
        f"forces {lacking:.3f} ω² S_P "
        f"is left (of (3-13), where the term stands, {with_imbalance:.0e})",
    )


def _stay(cases: list[tuple[str, RotorParameters, float]], points: list[SingularPoint]) -> tuple[Claim, ...]:
    """Integrate the whole equations of motion from each point."""
    claims = list[Claim]()
    statements = {
        "I": "Type I: the disk rests and stays there.",
        "II": "Type II: the disk whirls in a circle, pendulums opposed.",
        "III": "Type III: the disk whirls in a circle, pendulums together.",
    }
    for (kind, p, ratio), point in zip(cases, points, strict=True):
        speed = p.speed_rad_s(ratio)
        scene = Scene(SpeedHistory.constant(speed), (True, True), circular_whirl(speed, point)[0])
        times = np.linspace(0.0, _REVOLUTIONS * 2 * math.pi / speed, 40 * _REVOLUTIONS + 1)
        state = simulate(p, scene, times, 1e-9).state
        radius = np.hypot(state[:, 0], state[:, 1])
        moved = float(np.max(np.abs(state[:, 2:4] - np.array(point.theta_rad))))
        wander = float(np.max(np.abs(radius - abs(point.z_m))))
        claims.append(
            Claim.judged(
                "Figure 3.5",
                statements[kind],
                moved < 1e-6 and wander < 1e-8 and (abs(point.z_m) > 0) == (kind != "I"),
                f"radius {1e3 * abs(point.z_m):.4f} mm; integrated for {_REVOLUTIONS} revolutions: angles move by "
                f"{moved:.0e} rad, the radius by {wander:.0e} m",
            )
        )
    return tuple(claims)
