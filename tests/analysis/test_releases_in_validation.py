"""Verdict on the motion right after a release, in addition to that on the steady state."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest
from analysis_runs import Drawn, point_run

from analysis import validate
from analysis.differences import Rows, differences
from daq.signals.run import Run
from rig_configs import Rig
from rig_configs.drag import Reading

C3 = "c3_Nms_per_rad"


@dataclass(frozen=True)
class Made:
    """A release's rows, made up."""

    point: str
    rows: tuple[str, ...]
    values: np.ndarray
    own: np.ndarray
    by_parameter: np.ndarray
    parameters: tuple[str, ...]
    by_number: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    shared: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    used_for: tuple[str, ...] = ()
    by_slow_roll: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    reading: Reading = ""
    remark: str = ""


@pytest.fixture(scope="module")
def run(rig: Rig, drawn: Drawn) -> Run:
    return point_run(rig, "E", drawn=drawn, after_s=25.0)


def made(drawn: Drawn, off: float = 0.0) -> Made:
    """Four rows that depend on all parameters, measured as with c3 above the identified one by so many deviations."""
    found, rng = drawn.identified, np.random.default_rng(2)
    std = np.array(list(found.std.values()))
    by = -rng.standard_normal((4, len(std))) * 8 / std
    names = tuple(found.values)
    noise, at = 0.3 * rng.standard_normal(4), names.index(C3)
    values = noise - by[:, at] * off * std[at]
    return Made("E", ("release 1", "release 2", "release 3", "release 4"), values, np.eye(4), by, names)


def test_a_release_that_agrees_is_counted_and_passes(rig: Rig, drawn: Drawn, run: Run) -> None:
    alone = validate([run], rig, drawn.identified, drawn.axis_angle_deg)
    found = validate([run], rig, drawn.identified, drawn.axis_angle_deg, [made(drawn)])
    assert alone.agreement is not None
    assert found.agreement is not None
    assert found.passed
    assert list(found.agreement.points) == ["E", "E release"]
    assert found.agreement.points["E release"].dof == 4
    assert found.agreement.together.dof == alone.agreement.together.dof + 4
    assert found.agreement.point_limit == pytest.approx(alone.agreement.point_limit / 2)


def test_a_release_that_does_not_fails_its_point_and_finds_the_cause(rig: Rig, drawn: Drawn, run: Run) -> None:
    found = validate([run], rig, drawn.identified, drawn.axis_angle_deg, [made(drawn, 9.0)])
    assert found.points["E"].verdict == "fail"
    assert "right after the release" in found.points["E"].why
    assert found.agreement is not None
    assert found.agreement.failing_points == ("E release",)
    assert found.explanations is not None
    best = found.explanations.best
    assert best is not None
    assert [cause.name for cause in best.causes] == [C3]
    std = drawn.identified.std[C3]
    assert best.sizes[0] / std == pytest.approx(9.0, abs=3.5)


def test_rows_move_with_what_is_assumed(rig: Rig, drawn: Drawn) -> None:
    release: Rows = made(drawn, 2.0)
    there = differences([], rig, drawn.identified, [release], {C3: 2.0 * drawn.identified.std[C3]})
    here = differences([], rig, drawn.identified, [made(drawn)])
    assert there.values == pytest.approx(here.values)


def test_a_parameter_that_the_release_itself_has_found_adds_no_error(rig: Rig, drawn: Drawn) -> None:
    without = dataclasses.replace(made(drawn), used_for=(C3,))
    found = differences([], rig, drawn.identified, [without])
    full = differences([], rig, drawn.identified, [made(drawn)])
    at = full.parameters.index(C3)
    shift = full.by_parameter[:, at] * drawn.identified.std[C3]
    assert full.covariance - found.covariance == pytest.approx(np.outer(shift, shift))
    assert found.by_parameter == pytest.approx(full.by_parameter)  # of a cause it still is one
