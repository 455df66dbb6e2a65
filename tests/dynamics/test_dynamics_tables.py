"""Results of the dynamics print as a table and become a data frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from nominal import rig

from dynamics import (
    BasinMap,
    BatchMotion,
    Borders,
    Branch,
    End,
    Motion,
    Reaction,
    ReleaseOutcome,
    SteadyBranches,
    SteadyStates,
    stability_map,
    steady_states,
)
from dynamics.motions.start_ups import StartUpEnds
from dynamics.stability.borders import stability_borders
from dynamics.stability.map_plane import RigPlane
from dynamics.steady.branches import BreakPoint

P = rig()


@pytest.fixture(scope="module")
def states() -> SteadyStates:
    return steady_states(P, P.speed_rad_s(2.0))


def test_steady_states_have_a_row_each(states: SteadyStates) -> None:
    frame = states.to_dataframe()
    assert frame["type"].tolist() == [state.type for state in states]
    assert frame["theta4_rad"].tolist() == [state.theta_rad[1] for state in states]
    assert str(SteadyStates(states, ["II did not converge"])).splitlines()[-1] == "- II did not converge"


def test_branches_have_a_row_for_each_state() -> None:
    ones = np.ones(2)
    three = Branch("III", ones, np.array([[0.1, 0.2], [0.3, 0.4]]), ones, 2 * ones, ones < 0)
    one = Branch("I", np.array([2.0]), np.array([[1.0, 2.0]]), ones[:1], ones[:1], ones[:1] > 0)
    breaks = (BreakPoint(1.5, 1e-6, (), ("I",)),)
    found = SteadyBranches(np.arange(2.0), (three, one), breaks, ones, ((1.7, "II did not converge"),))
    frame = found.to_dataframe()
    assert frame["branch"].tolist() == [0, 0, 1]
    assert frame["theta4_rad"].tolist() == [0.2, 0.4, 2.0]
    assert frame["stable"].tolist() == [False, False, True]
    assert str(found).startswith("SteadyBranches: nothing stable → I at 1.5\n")
    assert str(found).endswith("- at 1.7: II did not converge")


def test_a_map_has_a_row_for_each_point() -> None:
    found = stability_map(P, [1.5, 2.0, 3.0], [1.0, 14.9])
    frame = found.to_dataframe()
    assert frame["speed_ratio"].tolist() == [1.5, 2.0, 3.0] * 2
    assert frame["multiplier_max"].tolist() == found.multiplier_max.ravel().tolist()
    missed = str(replace(found, accuracy=0.0))
    assert str(found).startswith("StabilityMap: 3 × 2 points, 83.3 % stable\n")
    assert missed.endswith("- 6 points miss the accuracy of 0")


def test_basins_have_a_row_for_each_release() -> None:
    end = End("I", 0, (0.5, 1.0), 0.0, 0.9, np.zeros(8), None)
    table = np.arange(6.0).reshape(2, 3)
    index = np.array([[0, 0, -1], [0, 0, 0]])
    found = BasinMap(
        np.arange(3.0),
        np.array([7.0, 8.0]),
        (end,),
        index,
        index >= 0,
        table,
        table,
        table,
        table,
        np.stack([table, table + 10], -1),
        5.0,
        1e-6,
        40.0,
    )
    frame = found.to_dataframe()
    assert frame["theta3_rad"].tolist() == [0, 1, 2] * 2
    assert frame["theta4_rad"].tolist() == [7] * 3 + [8] * 3
    assert frame["name"].tolist() == ["I", "I", "not settled", "I", "I", "I"]
    assert frame["turns4"].tolist() == [10, 11, 12, 13, 14, 15]
    assert str(found).startswith("BasinMap: 83.3 % I: A at 28.6°, B at 57.3°; 16.7 % not settled\n")


def test_motions_have_a_row_for_each_instant() -> None:
    time, state = np.arange(3.0), np.arange(24.0).reshape(3, 8)
    frame = Motion(time, state, 1e-7, 1e-3).to_dataframe()
    assert frame["time_s"].tolist() == [0, 1, 2]
    assert frame["theta4_rad"].tolist() == [3, 11, 19]
    last = BatchMotion(time, np.stack([state, state + 100])[:, -1:], np.ones(2), (None, "too long"))
    frame = last.to_dataframe()
    assert frame["run"].tolist() == [0, 1]
    assert frame["time_s"].tolist() == [2, 2]
    assert frame["x_m"].tolist() == [16, 116]
    assert str(last).splitlines()[0] == "BatchMotion: 2 runs, 1 succeeded"
    assert str(last).splitlines()[-1] == "- run 1: too long"
    pairs = np.arange(4.0).reshape(2, 2)
    frame = StartUpEnds(pairs, pairs + 10, pairs + 20, np.zeros(2), pairs[0] > 0).to_dataframe()
    assert frame["theta4_rad"].tolist() == [11, 13]
    assert frame["followed"].tolist() == [False, True]


def test_a_release_shows_its_end_and_the_doubts() -> None:
    found = ReleaseOutcome("I", (1.0, 5.0), 3.0, 40, (0.25, -0.5), None, seen="it crept", same_end=False)
    assert found.to_dataframe()["slip_turns"].tolist() == [0.25, -0.5]
    assert str(found).splitlines()[0] == "ReleaseOutcome: I after 3 s"
    assert str(found).splitlines()[-2:] == [
        "- it crept",
        "- a more accurate run ended in another state: the end is not determined",
    ]


def test_borders_have_a_row_for_each_point() -> None:
    plane = RigPlane(lambda stiffness, speed: (rig(stiffness), speed))
    found: Borders = stability_borders(plane, (5.0, 20.0), (45.0, 60.0), first=(8, 8), levels=0, spacing=0.1)
    frame = found.to_dataframe()
    assert frame["x"].tolist() == [x for branch in found.branches for x in branch.x]
    assert frame["branch"].nunique() == len(found.branches) > 0
    assert set(frame["kind"]) <= {"divergence", "flutter", "period doubling"}


def test_a_reaction_has_a_row_for_each_revolution(states: SteadyStates) -> None:
    angles = np.array([[1.0, 2.0], [3.0, 4.0]])
    found = Reaction(states[0], None, np.arange(2.0), np.ones(2), angles, 1.0, math.nan, math.nan)
    assert found.to_dataframe()["theta4_rad"].tolist() == [2, 4]
    assert str(found).startswith("Reaction: I → no stable state; amplitude at most 1 m\n")
