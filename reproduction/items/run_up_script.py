"""The source's run-up program: its results with its own faulty equations and with the right ones."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import MEASURED, MODEL, label
from dynamics.derivation.run_up_faults import SCRIPT_SPEED_RAD_S, PrintedFaults, ReleaseMotion, release, script_rig
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import Workspace, numbers_of

_BEFORE_S, _SHOWN_S = 3.0, 10.0


def run_up_script(work: Workspace) -> Reproduced:
    """Plot as the program does: Θ1, Θ2 in the turning frame and the pendulums, from 3 s before the release."""
    p = script_rig()
    right = release(p, SCRIPT_SPEED_RAD_S, PrintedFaults(), free_s=30.0)
    faulty = release(
        p, SCRIPT_SPEED_RAD_S, PrintedFaults(without_reaction=True, integrates_locked_speed=True), free_s=30.0
    )
    with sheet(WIDTH_IN, 5.4, "The run-up program: faulty equations and right ones, its own numbers") as figure:
        grid: list[Axes] = figure.subplots(3, 1, sharex=True).tolist()
        for run, colour, dashes, name in (
            (faulty, MODEL, "-", "as programmed"),
            (right, MEASURED, (0, (5, 2)), "right equations"),
        ):
            time, (along, across) = _shown(run)
            grid[0].plot(time, 1e3 * along, color=colour, ls=dashes, label=name)
            grid[1].plot(time, 1e3 * across, color=colour, ls=dashes)
            for pendulum, width in ((2, 1.6), (3, 0.9)):
                grid[2].plot(time, np.degrees(_part(run)[1][:, pendulum]), color=colour, ls=dashes, lw=width)
        for axes, name in zip(grid, ("Θ1, mm", "Θ2, mm", "θ3 (thick), θ4 (thin), °"), strict=True):
            axes.axvline(_BEFORE_S, color="#444444", lw=0.8, ls=":")
            label(axes, None, name)
        grid[2].set(xlim=(0, _SHOWN_S))
        label(grid[2], "time, s; release at 3 s")
    columns = {"time_s": _shown(right)[0]}
    for name, run in (("right", right), ("programmed", faulty)):
        time, (along, across) = _shown(run)
        angles = np.degrees(_part(run)[1][:, 2:4])
        columns |= {f"theta1_mm_{name}": 1e3 * along, f"theta2_mm_{name}": 1e3 * across}
        columns |= {f"theta3_deg_{name}": angles[:, 0], f"theta4_deg_{name}": angles[:, 1]}
    return Reproduced(
        (Panel("run", "The disk's centre in the turning frame and both pendulums, as the program plots.", figure),),
        (SourceTable("run", "Both runs from 3 s before the release", columns),),
        numbers_of(p) | {"speed_rad_s": SCRIPT_SPEED_RAD_S},
        (
            "The program's locks: 0° and 180° + 0.001 rad, 12 s of full speed before the release.",
            "What stops the program (misprints.md, programs) is corrected in both runs.",
        ),
        _claims(right, faulty),
    )


def _claims(right: ReleaseMotion, faulty: ReleaseMotion) -> tuple[Claim, ...]:
    speeds = [math.degrees(v) for v in faulty.speed_at_release_rad_s]
    before = [
        1e3 * float(np.sqrt(np.mean(run.radius_m[run.released - 200 : run.released] ** 2))) for run in (right, faulty)
    ]
    ends = [np.degrees(run.final_angles_rad) % 360 for run in (right, faulty)]
    apart = float(np.max(np.abs((ends[0] - ends[1] + 180) % 360 - 180)))
    moved = float(np.degrees(np.max(np.abs((right.state - faulty.state)[right.released :, 2:4]))))
    return (
        Claim.judged(
            "appendix B, run-up program",
            "A locked pendulum is at rest when it is released.",
            max(map(abs, speeds)) < 0.01,
            f"its speed state has increased to {speeds[0]:.1f} and {speeds[1]:.1f} °/s for A and B",
        ),
        Claim.judged(
            "appendix B, run-up program",
            "The program's vibration before the release is that of its rotor.",
            abs(before[1] / before[0] - 1) < 1e-3,
            f"rms radius {before[1]:.4f} mm, by the right equations {before[0]:.4f} mm: "
            f"{100 * (before[1] / before[0] - 1):+.1f} %",
        ),
        Claim.judged(
            "appendix B, run-up program",
            "The program's release moves as the rig would.",
            moved < 1.0,
            f"angles differ by up to {moved:.0f}° on the way",
        ),
        Claim.judged(
            "appendix B, run-up program",
            "The program's release ends where the rig's would.",
            apart < 0.1,
            f"θ3, θ4 {ends[1][0]:.2f}°, {ends[1][1]:.2f}°, by the right equations {ends[0][0]:.2f}°, {ends[0][1]:.2f}°",
        ),
    )


def _part(run: ReleaseMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return the times from 3 s before the release, and the states at these times."""
    time = run.time_s - run.time_s[run.released] + _BEFORE_S
    inside = (time >= 0) & (time <= _SHOWN_S)
    return time[inside], run.state[inside]


def _shown(run: ReleaseMotion) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return times, and the disk's centre in the turning frame along the imbalance and across it, m."""
    time, state = _part(run)
    start = run.time_s[run.released] - _BEFORE_S
    turned = (state[:, 0] + 1j * state[:, 1]) * np.exp(-1j * SCRIPT_SPEED_RAD_S * (time + start))
    return time, (turned.real, turned.imag)
