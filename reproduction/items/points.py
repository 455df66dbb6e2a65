"""Figures 4.10 to 4.14: the points A to E, simulated and recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from analysis.figures.point import point_figure, simulate_release
from analysis.prediction import known_axis_angle
from analysis.results import PointResult
from analysis.rig_model import RigModel
from reproduction.recordings import KnownRig, known_rig, recorded_point
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import VIRTUAL, Workspace, numbers_of
from rig_basics.units import TO_RPM

_SEED = ("virtual.seed=410",)
_EXPECTED: Mapping[str, tuple[str, str]] = {
    "A": ("III", "At A the pendulums stay together: Type III."),
    "B": ("I", "At B the pendulums balance the rotor: Type I."),
    "C": ("I", "At C the pendulums balance the rotor: Type I."),
    "D": ("III", "At D the pendulums stay together: Type III."),
    "E": ("I", "At E the pendulums balance the rotor: Type I."),
}


@lru_cache(maxsize=1)
def _known(folder: Path) -> KnownRig:
    return known_rig(VIRTUAL, _SEED, folder)


def point_a_4_10(work: Workspace) -> Reproduced:
    """Figure 4.10: below the first resonance."""
    return _point(work, "A")


def point_b_4_11(work: Workspace) -> Reproduced:
    """Figure 4.11: in the first stable area, near its lower border."""
    return _point(work, "B")


def point_c_4_12(work: Workspace) -> Reproduced:
    """Figure 4.12: in the first stable area, near its upper border."""
    return _point(work, "C")


def point_d_4_13(work: Workspace) -> Reproduced:
    """Figure 4.13: between both stable areas."""
    return _point(work, "D")


def point_e_4_14(work: Workspace) -> Reproduced:
    """Figure 4.14: in the second stable area."""
    return _point(work, "E")


def _point(work: Workspace, name: str) -> Reproduced:
    known = _known(work.folder.parent / "points" / "recordings")
    work.progress(0.5)
    run, judged = recorded_point(known, name, work.recordings("point"))
    physics = known.parameters.applied_to(known.rig.physics)
    angle = math.radians(known_axis_angle(known.parameters, known.rig)[0])
    measured = judged.measurement
    assert measured is not None, judged.why
    simulated = simulate_release(run, measured, physics, angle)
    figure = point_figure(run, measured, judged.prediction, simulated)
    state, statement = _EXPECTED[name]
    description = (
        f"Point {name}: displacements and both pendulums' angles, recorded on the virtual rig and simulated with the "
        "parameters identified from its logs."
    )
    return Reproduced(
        (Panel("point", description, figure),),
        (_scores(judged),),
        numbers_of(RigModel.of(known.rig, known.parameters).physics) | {"virtual.seed": 410},
        (
            "The recording is one of the virtual rig through drivers, wire bytes and a log: the source's are lost.",
            f"Ω = {known.rig.points[name].speed_ratio:g} of {name}: the source has it only in a figure.",
        ),
        (
            Claim.judged(
                "4.3, 4.4",
                statement,
                judged.state == state,
                f"recorded: {judged.state}, θ3 = {math.degrees(measured.theta_rad[0].value):.2f}°, θ4 = "
                f"{math.degrees(measured.theta_rad[1].value):.2f}°, amplitude "
                f"{1e3 * measured.amplitude_m.value:.4f} mm at "
                f"{measured.speed_rad_s.value * TO_RPM:.1f} rpm",
            ),
            Claim.judged(
                "4.4",
                "Simulation and measurement are nearly the same.",
                judged.verdict == "pass" and simulated is not None,
                f"{judged.verdict}: {judged.why}; largest |z| "
                f"{max(map(abs, judged.z_scores.values()), default=math.nan):.1f}",
            ),
        ),
    )


def _scores(judged: PointResult) -> SourceTable:
    """Return measured and predicted steady values with their standard deviations."""
    values = judged.to_json()
    names = [n for n in values["measured"] if n in values["predicted"] and values["measured"][n] is not None]
    columns = {
        key: np.array([math.nan if values[key][n] is None else values[key][n] for n in names])
        for key in ("measured", "measured_std", "predicted", "predicted_std")
    }
    return SourceTable("steady", "Steady values, measured and predicted", {"quantity": names, **columns}, shown=True)
