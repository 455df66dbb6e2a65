"""Remaining vibration in either of the two balanced positions, by imperfection."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import MEASURED, MODEL, label
from dynamics import Pendulum, RotorParameters, Scene, SpeedHistory, balanced_angles, simulate_batch, steady_states
from dynamics.errors import DynamicsError
from dynamics.motions.integrate import locked_state
from dynamics.steady.mirrored_positions import Imperfections, mirrored_positions
from reproduction.results import Claim, SourceTable
from rig_basics.arrays import Array
from rig_basics.texts import number_of

_SHIFT_M = 25e-6
_TORQUE_NM = 1e-5
_OBLIQUE = cmath.exp(1j * math.pi / 4)
_HEAVIER = 1.005
_AT_KG_M = 0.003
_RUN_OUT_M = 10e-6 * cmath.exp(1j * math.pi / 3)
_PLANE_M, _COUPLE_KG_M2 = 0.02, 1e-5
_FRICTION_ARM_M = 2e-6
_FRICTION_STARTS = 40
_SAME_M = 1e-11


@dataclass(frozen=True)
class ImperfectionRow:
    """One imperfection: remaining value in either position, in `unit`."""

    name: str
    first: float
    second: float
    unit: str = "µm"
    differs: bool = False


@dataclass(frozen=True)
class RadiusCurve:
    """Remaining radii over S_P."""

    name: str
    moment_kg_m: Array
    first_m: Array
    second_m: Array

    @property
    def table(self) -> SourceTable:
        """Return the table's columns."""
        return SourceTable(
            "left-" + "".join(c if c.isalnum() else "-" for c in self.name),
            f"Left in both positions: {self.name}",
            {"S_P_g_m": 1e3 * self.moment_kg_m, "first_um": 1e6 * self.first_m, "second_um": 1e6 * self.second_m},
        )


_CURVES: tuple[tuple[str, Imperfections], ...] = (
    ("both pivots 25 µm across", Imperfections(1j * _SHIFT_M, 1j * _SHIFT_M)),
    ("pivots ± 25 µm across", Imperfections(1j * _SHIFT_M, -1j * _SHIFT_M)),
    ("pivots ± 25 µm oblique", Imperfections(_SHIFT_M * _OBLIQUE, -_SHIFT_M * _OBLIQUE)),
    ("pivot of A 25 µm oblique", Imperfections(_SHIFT_M * _OBLIQUE, 0j)),
)


def imperfect_curves(p: RotorParameters, speed_ratio: float) -> list[RadiusCurve]:
    """Return the remaining radii in both positions over S_P, for four imperfections."""
    moments = np.linspace(0.0002, 0.00805, 158)
    found = list[RadiusCurve]()
    for name, each in _CURVES:
        radii = np.full((len(moments), 2), np.nan)
        for i, moment in enumerate(moments.tolist()):
            own = p.with_values(SP_kg_m=moment)
            try:
                pair = mirrored_positions(own, own.speed_rad_s(speed_ratio), each)
            except DynamicsError:  # usual: too large an imperfection this near to a border
                if np.isfinite(radii[:i]).any():
                    break
                continue
            radii[i] = [abs(position.z_m) for position in pair]
        found.append(RadiusCurve(name, moments, radii[:, 0], radii[:, 1]))
    return found


def positions_figure(curves: Sequence[RadiusCurve], title: str) -> Figure:
    """Draw both radii over S_P, one plot for each imperfection."""
    foot = "Pivots in the rotor's frame; along: towards the imbalance, oblique: 45° off it. Gaps: no such position."
    with sheet(WIDTH_IN, 4.6, title, [foot]) as figure:
        grid: NDArray[np.object_] = figure.subplots(2, 2, sharex=True, sharey=True)
        panels: list[Axes] = grid.ravel().tolist()
        for axes, curve in zip(panels, curves, strict=True):
            axes.plot(
                1e3 * curve.moment_kg_m, 1e6 * curve.first_m, color=MEASURED, lw=3.0, alpha=0.55, label="A below 180°"
            )
            axes.plot(1e3 * curve.moment_kg_m, 1e6 * curve.second_m, color=MODEL, lw=1.3, label="A above 180°")
            axes.set(ylim=(0, 100), xlim=(0, 8.1))
            label(axes, None, None, curve.name)
        for axes in panels[2:]:
            label(axes, "S_P, g m")
        for axes in panels[::2]:
            label(axes, None, "radius left, µm")
    return figure


def rows_of(p: RotorParameters, speed_ratio: float) -> list[ImperfectionRow]:
    """Return all imperfections, at S_P of 3 g m."""
    own = p.with_values(SP_kg_m=_AT_KG_M)
    speed = own.speed_rad_s(speed_ratio)
    heavy = replace(own, b=replace(own.b, mass_kg=_HEAVIER * own.b.mass_kg))
    shift = Imperfections(1j * _SHIFT_M, 1j * _SHIFT_M)
    found = [
        _solved("B heavier by 0.5 %", heavy, speed, Imperfections()),
        _solved("both pivots 25 µm along", own, speed, Imperfections(_SHIFT_M, _SHIFT_M)),
        *(_solved(name, own, speed, each) for name, each in _CURVES),
        _solved("pivots ± 25 µm along", own, speed, Imperfections(_SHIFT_M, -_SHIFT_M)),
        _solved("both pivots 25 µm across, B heavier by 0.5 %", heavy, speed, shift),
        _solved("torque of 10 µN m on both", own, speed, Imperfections(torque_a_Nm=_TORQUE_NM, torque_b_Nm=_TORQUE_NM)),
        _solved("torque of 10 µN m on A", own, speed, Imperfections(torque_a_Nm=_TORQUE_NM)),
        _steady("bent shaft, 25 µm across", replace(own, bow_y_m=_SHIFT_M), speed),
        _steady("springs of x and y 10 % apart", replace(own, k2_N_per_m=1.1 * own.k1_N_per_m), speed),
        _steady(
            "the same, both pivots 25 µm along",
            replace(own, k2_N_per_m=1.1 * own.k1_N_per_m, pivot_shift_m=_SHIFT_M),
            speed,
        ),
        _steady("axis inclined by 5°", replace(own, gravity_m_per_s2=9.81 * math.sin(math.radians(5))), speed),
        *_seen(own, speed),
    ]
    return [*found, _friction(own, speed)]


def _row(name: str, first_m: float, second_m: float, least_m: float = _SAME_M) -> ImperfectionRow:
    return ImperfectionRow(name, 1e6 * first_m, 1e6 * second_m, "µm", abs(first_m - second_m) > least_m)


def _solved(name: str, p: RotorParameters, speed: float, each: Imperfections) -> ImperfectionRow:
    first, second = mirrored_positions(p, speed, each)
    return _row(name, abs(first.z_m), abs(second.z_m))


def _steady(name: str, p: RotorParameters, speed: float) -> ImperfectionRow:
    """Return the remaining values of the steady states near the two balanced positions."""
    radii = list[float]()
    for pair in balanced_angles(p):
        near = np.exp(1j * np.array(pair))
        states = steady_states(p, speed, 1e-8)
        best = min(states, key=lambda s: float(np.max(np.abs(np.exp(1j * np.array(s.theta_rad)) - near))))
        radii.append(best.amplitude_m)
    return _row(name, radii[0], radii[1], 1e-9)


def _seen(p: RotorParameters, speed: float) -> list[ImperfectionRow]:
    """Return what a sensor or a second plane measures of positions with equal balance."""
    still = mirrored_positions(p, speed, Imperfections())
    torn = mirrored_positions(p, speed, Imperfections(torque_a_Nm=_TORQUE_NM))
    moment = p.a.first_moment_kg_m
    arms = [_PLANE_M * moment * (cmath.exp(1j * s.theta_rad[0]) - cmath.exp(1j * s.theta_rad[1])) for s in still]
    rows = [
        _row("run-out of 10 µm under the sensor", *(abs(s.z_m + _RUN_OUT_M) for s in still)),
        _row("run-out of 10 µm and torque of 10 µN m on A", *(abs(s.z_m + _RUN_OUT_M) for s in torn)),
    ]
    for name, own in (("pendulums in planes ± 20 mm", 0.0), ("the same, a couple of 10 g m mm across", _COUPLE_KG_M2)):
        first, second = (1e9 * abs(arm + 1j * own) for arm in arms)
        rows.append(ImperfectionRow(name, first, second, "g m µm", abs(first - second) > 1e-6 * first))
    return rows


def _friction(p: RotorParameters, speed: float) -> ImperfectionRow:
    """Return the mean radius on either side of releases with dry friction from random angles, and its significance."""

    def rubbing(q: Pendulum) -> Pendulum:
        return replace(q, friction_arm_m=_FRICTION_ARM_M)

    own = replace(p, a=rubbing(p.a), b=rubbing(p.b))
    starts = np.random.default_rng(16).uniform(-math.pi, math.pi, (_FRICTION_STARTS, 2)).tolist()
    history = SpeedHistory.constant(speed)
    scenes = [Scene(history, (True, True), locked_state(own, speed, 0.0, a, b)) for a, b in starts]
    ends = simulate_batch([own] * len(scenes), scenes, np.array([0.0, 60.0]), 1e-5, last_only=True)
    state = np.asarray(ends.states, np.float64)[:, 0]
    radius = np.hypot(state[:, 0], state[:, 1])
    settled = (radius < 4 * _FRICTION_ARM_M) & ends.ok
    high = np.sin(state[:, 2]) < 0
    groups = [radius[settled & (high == side)] for side in (False, True)]
    means, errors = [float(np.mean(g)) for g in groups], [float(np.std(g) / math.sqrt(max(len(g), 1))) for g in groups]
    spread = float(np.std(np.concatenate(groups)))
    name = f"dry friction of a 2 µm arm, {number_of(sum(map(len, groups)), 'start-up')}, scatter {1e6 * spread:.2f} µm"
    return _row(name, means[0], means[1], 3 * math.hypot(*errors))


def positions_table(rows: Sequence[ImperfectionRow]) -> SourceTable:
    """Return all imperfections as a table."""
    return SourceTable(
        "imperfections",
        "What is left with A below and above 180°, S_P = 3 g m",
        {
            "imperfection": [row.name for row in rows],
            "A_below_180": [row.first for row in rows],
            "A_above_180": [row.second for row in rows],
            "unit": [row.unit for row in rows],
            "differ": ["yes" if row.differs else "no" for row in rows],
        },
        shown=True,
    )


def positions_claim(rows: Sequence[ImperfectionRow], recorded_m: Sequence[Sequence[float]]) -> Claim:
    """Return the claim on which imperfections make the two positions differ."""
    mass = rows[0]
    different = [row for row in rows if row.differs]
    alike = [row for row in rows if not row.differs]
    verdict = "holds" if mass.differs else "holds in part" if different else "does not hold"
    largest = max(max(each, default=0.0) for each in recorded_m)
    shown = "; ".join(f"{row.name}: {row.first:.3g} and {row.second:.3g} {row.unit}" for row in different)
    return Claim(
        "3.2.3",
        "Small differences of the pendulums make the two positions leave different vibration.",
        verdict,
        f"not their masses: 0.5 % leaves {mass.first:.1g} and {mass.second:.1g} µm, either position balances (recorded "
        f"equal pendulums: {1e6 * largest:.2f} µm at most). Different: {shown}. The same in both: "
        f"{'; '.join(row.name for row in alike)}. A reflection at the imbalance's line carries one position into the "
        "other; only an imperfection without that line, or a pivot for each, makes them differ",
    )
