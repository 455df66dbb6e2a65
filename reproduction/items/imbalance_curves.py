"""Chapter 3.2: amplitude and pendulum angles over the imbalance, modelled and recorded: parts of its figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import gammaincc

from analysis.figures.branches import A_COLOUR, B_COLOUR, draw_amplitudes, draw_angles, mark_borders
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import label
from dynamics import RotorParameters, SteadyBranches, SteadyState, steady_branches, steady_states
from reproduction.recorded import Recorded, as_stated, recorded_points
from reproduction.results import Claim, SourceTable
from reproduction.workspace import ISOTROPIC, Workspace
from rig_basics.texts import number_of

MOMENT = "first moment of the imbalance S_P, g m"
LEAST_P = 0.01
"""p-value of χ² below which a claim is rejected."""
_MAX_Z = 4.0  # ratio of amplitude to noise above which a rotor is not at rest
_FOOT = "Error bars: ± 2 standard deviations, smaller than the symbol where none is visible. "


@dataclass(frozen=True)
class Series:
    """Settings of a series of recordings.

    Attributes:
        point: of the shipped rig, "below" or "above" resonance.
        speed_ratio: its speed.
        settings: "key=value" over the shipped rig.
        up_to_kg_m: end of the curves.
        recorded_kg_m: S_P of the recordings.
        count: start-ups at each.
    """

    point: str
    speed_ratio: float
    settings: tuple[str, ...]
    up_to_kg_m: float
    recorded_kg_m: tuple[float, ...]
    count: int = 1

    def physics(self, work: Workspace, more: Sequence[str] = ()) -> RotorParameters:
        """Return the rig's parameters."""
        return work.physics(ISOTROPIC, [*self.settings, *more])

    def curves(self, work: Workspace, more: Sequence[str] = ()) -> SteadyBranches:
        """Return the steady states over S_P in kg m, at one speed ratio."""
        p = self.physics(work, more)
        values = np.linspace(0.0, self.up_to_kg_m, 121)
        return steady_branches(lambda s: (p.with_values(SP_kg_m=s), p.speed_rad_s(self.speed_ratio)), values)

    def as_turned(self, rows: Sequence[StartUpComparison]) -> Series:
        """Return the series at the mean speed of the recordings, slightly below the commanded one."""
        ratios = [
            row.recorded.measured.speed_rad_s.value / row.recorded.rig.physics.natural_frequencies_rad_s[0]
            for row in rows
        ]
        return replace(self, speed_ratio=float(np.mean(ratios)))

    def recordings(self, work: Workspace) -> list[tuple[float, Recorded]]:
        """Return (S_P in kg m, start-up); each S_P is a rig with its own random sensors and clocks."""
        found = list[tuple[float, Recorded]]()
        for i, moment in enumerate(self.recorded_kg_m):
            radius = moment / self.physics(work).imbalance_mass_kg
            settings = (
                *self.settings,
                f"imbalance.radius_m={radius!r}",
                f"points.{self.point}.speed_ratio={self.speed_ratio!r}",
                f"virtual.seed={i + 1}",
            )
            place = work.recordings(f"{1e3 * moment:g}-g-m")
            each = recorded_points(place, ISOTROPIC, as_stated(ISOTROPIC, settings), self.count, self.point)
            found += [(moment, one) for one in each]
            work.progress((i + 1) / len(self.recorded_kg_m))
        return found


@dataclass(frozen=True)
class StartUpComparison:
    """A recorded start-up and the model's stable state at the measured speed.

    Attributes:
        moment_kg_m: S_P.
        recorded: what was measured.
        state: the stable state nearest to the measured angles.
    """

    moment_kg_m: float
    recorded: Recorded
    state: SteadyState

    @property
    def angle_z(self) -> tuple[float, float]:
        """Measured minus computed θ3, θ4 over the standard deviation."""
        a, b = (
            math.remainder(one.value - own, 2 * math.pi) / one.std
            for one, own in zip(self.recorded.measured.theta_rad, self.state.theta_rad, strict=True)
        )
        return a, b

    @property
    def amplitude_z(self) -> float:
        """The same of the amplitude. For a rotor at rest it is the measured amplitude over the noise floor."""
        measured = self.recorded.measured
        if self.state.amplitude_m < 1e-9:
            return measured.amplitude_m.value / measured.noise_floor_m
        return (measured.amplitude_m.value - self.state.amplitude_m) / measured.amplitude_m.std

    @property
    def mirrored(self) -> bool:
        """Whether A is between 180° and 360°."""
        return self.recorded.measured.theta_rad[0].value % (2 * math.pi) > math.pi


def compared(found: Sequence[tuple[float, Recorded]]) -> list[StartUpComparison]:
    """Compare each start-up with the model."""
    out = list[StartUpComparison]()
    for moment, one in found:
        near = np.exp(1j * np.array([theta.value for theta in one.measured.theta_rad]))
        states = [s for s in steady_states(one.rig.physics, one.measured.speed_rad_s.value, 1e-9) if s.draws]
        best = min(states, key=lambda s: float(np.max(np.abs(np.exp(1j * np.array(s.theta_rad)) - near))))
        out.append(StartUpComparison(moment, one, best))
    return out


def table_of(rows: Sequence[StartUpComparison]) -> SourceTable:
    """Return the table of the recordings."""
    measured = [row.recorded.measured for row in rows]
    return SourceTable(
        "recorded",
        "Recorded on the virtual rig, and the model at the measured speed",
        {
            "S_P_g_m": [1e3 * row.moment_kg_m for row in rows],
            "type": [row.state.type for row in rows],
            "theta3_deg": [math.degrees(m.theta_rad[0].value) % 360 for m in measured],
            "theta3_std_deg": [math.degrees(m.theta_rad[0].std) for m in measured],
            "theta3_model_deg": [math.degrees(row.state.theta_rad[0]) % 360 for row in rows],
            "theta4_deg": [math.degrees(m.theta_rad[1].value) % 360 for m in measured],
            "theta4_std_deg": [math.degrees(m.theta_rad[1].std) for m in measured],
            "theta4_model_deg": [math.degrees(row.state.theta_rad[1]) % 360 for row in rows],
            "amplitude_mm": [1e3 * m.amplitude_m.value for m in measured],
            "amplitude_std_mm": [1e3 * m.amplitude_m.std for m in measured],
            "amplitude_model_mm": [1e3 * row.state.amplitude_m for row in rows],
            "noise_alone_mm": [1e3 * m.noise_floor_m for m in measured],
            "settled": [str(m.settling.settled) for m in measured],
        },
        shown=True,
    )


def curve_table(found: SteadyBranches, name: str = "curves", title: str = "Stable states by the model") -> SourceTable:
    """Return the stable branches as rows."""
    parts = found.stable_branches()
    stacked = [
        np.column_stack([b.values, np.degrees(b.theta_rad) % 360, b.amplitude_m, b.multiplier_max]) for b in parts
    ]
    rows = np.concatenate(stacked) if stacked else np.zeros((0, 5))
    return SourceTable(
        name,
        title,
        {
            "type": [b.type for b in parts for _ in b.values],
            "branch": [i for i, b in enumerate(parts) for _ in b.values],
            "S_P_g_m": 1e3 * rows[:, 0],
            "theta3_deg": rows[:, 1],
            "theta4_deg": rows[:, 2],
            "amplitude_mm": 1e3 * rows[:, 3],
            "multiplier_max": rows[:, 4],
        },
    )


def amplitude_figure(
    title: str,
    found: SteadyBranches,
    rows: Sequence[StartUpComparison],
    thin: Sequence[tuple[str, SteadyBranches]] = (),
    foot: str = "",
) -> Figure:
    """Draw the amplitude over S_P."""
    with sheet(WIDTH_IN, 3.6, title, [_FOOT + foot]) as figure:
        axes: Axes = figure.subplots()
        for (name, other), style in zip(thin, ((0, (6, 2)), (0, (2, 2)), (0, (6, 2, 1, 2))), strict=False):
            for i, b in enumerate(other.stable_branches()):
                axes.plot(
                    1e3 * b.values,
                    1e3 * b.amplitude_m,
                    color="#8a8a8a",
                    lw=0.9,
                    ls=style,
                    label=name if i == 0 else None,
                )
        draw_amplitudes(axes, found, 1e3, unstable=False)
        points_of_amplitude(axes, rows)
        mark_borders([axes], found, 1e3)
        axes.set_xlim(-0.1, 1e3 * float(found.values[-1]))
        label(axes, MOMENT, "amplitude, mm")
    return figure


def points_of_amplitude(axes: Axes, rows: Sequence[StartUpComparison]) -> None:
    """Draw recorded amplitudes in mm with error bars."""
    measured = [row.recorded.measured.amplitude_m for row in rows]
    axes.errorbar(
        [1e3 * row.moment_kg_m for row in rows],
        [1e3 * m.value for m in measured],
        yerr=[2e3 * m.std for m in measured],
        fmt="D",
        color=A_COLOUR,
        mfc="white",
        ms=5,
        capsize=3,
        zorder=4,
        label="recorded",
    )


def angle_figure(title: str, found: SteadyBranches, rows: Sequence[StartUpComparison], foot: str = "") -> Figure:
    """Draw pendulum angles over S_P: A as circles, B as crosses."""
    with sheet(WIDTH_IN, 3.8, title, [_FOOT + foot]) as figure:
        axes: Axes = figure.subplots()
        draw_angles(axes, found, 1e3)
        points_of_angles(axes, rows)
        mark_borders([axes], found, 1e3)
        axes.set_xlim(0, 1e3 * float(found.values[-1]))
        label(axes, MOMENT, "pendulum angle from the imbalance, °")
    return figure


def points_of_angles(axes: Axes, rows: Sequence[StartUpComparison]) -> None:
    """Draw recorded angles in degrees with error bars."""
    moments = [1e3 * row.moment_kg_m for row in rows]
    for i, (which, sign, colour, size) in enumerate((("A", "o", A_COLOUR, 8), ("B", "x", B_COLOUR, 6))):
        measured = [row.recorded.measured.theta_rad[i] for row in rows]
        axes.errorbar(
            moments,
            [math.degrees(m.value) % 360 for m in measured],
            yerr=[2 * math.degrees(m.std) for m in measured],
            fmt=sign,
            color=colour,
            mfc="none",
            ms=size,
            mew=1.4,
            capsize=3,
            zorder=4,
            label=f"{which}, recorded",
        )


def amplitude_claim(place: str, rows: Sequence[StartUpComparison]) -> Claim:
    """Compare recorded amplitudes with the model: χ² of whirling rotors, noise of those at rest."""
    whirling = [row for row in rows if row.state.amplitude_m >= 1e-9]
    resting = [row for row in rows if row.state.amplitude_m < 1e-9]
    chi2 = sum(row.amplitude_z**2 for row in whirling)
    p = float(gammaincc(0.5 * len(whirling), 0.5 * chi2)) if whirling else 1.0
    largest = max((row.amplitude_z for row in resting), default=0.0)
    text = f"{len(whirling)} whirling: χ² {chi2:.1f} on {len(whirling)}, p = {p:.2f}"
    if resting:
        micro = 1e6 * max(row.recorded.measured.amplitude_m.value for row in resting)
        text += f"; {len(resting)} balanced: {micro:.2f} µm at most, {largest:.1f} times what noise alone shows"
    return Claim.judged(
        place,
        "Measured amplitudes lie on the computed curve.",
        p > LEAST_P and largest < _MAX_Z and _settled(rows),
        text,
    )


def angle_claim(place: str, rows: Sequence[StartUpComparison]) -> Claim:
    """Compare recorded angles with the model: χ² of both pendulums."""
    z = np.array([row.angle_z for row in rows])
    chi2, count = float(np.sum(z**2)), z.size
    p = float(gammaincc(0.5 * count, 0.5 * chi2))
    return Claim.judged(
        place,
        "Measured pendulum positions lie on the computed curves.",
        p > LEAST_P and _settled(rows),
        f"{number_of(len(rows), 'start-up')}, two angles each: χ² {chi2:.1f} on {count}, p = {p:.2f}, largest "
        f"{np.max(np.abs(z)):.1f} standard deviations",
    )


def _settled(rows: Sequence[StartUpComparison]) -> bool:
    """Return whether all recordings reached a steady state; the angles show which one."""
    return all(row.recorded.measured.settling.settled for row in rows)
