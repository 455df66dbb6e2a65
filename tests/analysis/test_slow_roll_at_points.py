"""Run-out and a bent shaft at the points: part of the prediction where a run-up showed them, named where none did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analysis_runs import Drawn, point_run

from analysis import validate
from analysis.prediction import predict_point
from analysis.validation import Validation
from daq.signals.run import Run
from rig_configs import Rig
from rig_configs.slow_roll import SlowRoll

POINTS = {"A": 45.0, "B": 50.0, "E": 25.0}
RUN_OUT, BOW = 60e-6 * np.exp(0.8j), 40e-6 * np.exp(2.0j)
BETA = np.radians(1.0)


@pytest.fixture(scope="module")
def straight(rig: Rig, drawn: Drawn) -> list[Run]:
    return [point_run(rig, name, drawn=drawn, after_s=after) for name, after in POINTS.items()]


@pytest.fixture(scope="module")
def with_run_out(straight: list[Run], drawn: Drawn) -> list[Run]:
    """The same runs of a rotor whose target is not centred: both lasers read it late, each with its gain."""
    found = []
    for run in straight:
        speed = np.polyfit(run.mark_time_s[5:-20], run.mark_phase_rad[5:-20], 1)
        x, y = (
            RUN_OUT * np.exp(1j * np.polyval(speed, time + drawn.laser_delay_s))
            for time in (run.x_time_s, run.y_time_s)
        )
        found.append(replace(run, x_m=run.x_m + drawn.gain[0] * x.real, y_m=run.y_m + drawn.gain[1] * y.imag))
    return found


@pytest.fixture(scope="module")
def bent(rig: Rig, drawn: Drawn) -> list[Run]:
    crooked = replace(rig.true_physics, bow_x_m=BOW.real, bow_y_m=BOW.imag)
    return [point_run(rig, name, drawn=drawn, after_s=after, physics=crooked) for name, after in POINTS.items()]


def judged(rig: Rig, drawn: Drawn, runs: list[Run], roll: SlowRoll | None) -> Validation:
    return validate(runs, rig, replace(drawn.identified, slow_roll=roll), drawn.axis_angle_deg)


def known(rng: np.random.Generator, run_out: complex = 0j, bow: complex = 0j) -> SlowRoll:
    """As a run-up shows it, with an error of its own."""
    std = np.array([2e-7] * 4 if run_out else [0.0] * 4 + [1e-7] * 2)
    std = np.r_[std, np.zeros(6 - len(std))]
    errors = (std * rng.standard_normal(6)).reshape(3, 2) @ [1, 1j]
    return SlowRoll(run_out + errors[0], run_out + errors[1], bow + errors[2], np.diag(std**2), (0.5, 0.5))


def test_run_out_of_a_run_up_leaves_the_points_in_agreement(rig: Rig, drawn: Drawn, with_run_out: list[Run]) -> None:
    roll = known(np.random.default_rng(1), run_out=RUN_OUT)
    found = judged(rig, drawn, with_run_out, roll)
    assert found.passed, [p.why for p in found.points.values()]
    assert found.agreement is not None
    assert found.agreement.together.p > 0.01


def test_run_out_that_no_run_up_showed_is_named(rig: Rig, drawn: Drawn, with_run_out: list[Run]) -> None:
    found = judged(rig, drawn, with_run_out, None)
    assert not found.passed
    assert found.explanations is not None
    best = found.explanations.best
    assert best is not None
    assert [cause.name for cause in best.causes] == ["run-out along", "run-out across"]
    assert complex(*best.sizes) == pytest.approx(RUN_OUT, abs=3e-6)
    assert "run-out along the imbalance" in found.explanations.sentences[0]
    assert "a slow roll" in found.explanations.sentences[0]


def test_a_bow_of_a_run_up_leaves_the_points_in_agreement(rig: Rig, drawn: Drawn, bent: list[Run]) -> None:
    found = judged(rig, drawn, bent, known(np.random.default_rng(2), bow=BOW))
    assert found.passed, [p.why for p in found.points.values()]
    assert found.agreement is not None
    assert found.agreement.together.p > 0.01


def test_a_bow_that_no_run_up_showed_is_named(rig: Rig, drawn: Drawn, bent: list[Run]) -> None:
    found = judged(rig, drawn, bent, None)
    assert not found.passed
    assert found.explanations is not None
    best = found.explanations.best
    assert best is not None
    assert [cause.name for cause in best.causes] == ["bow along", "bow across"]
    assert complex(*best.sizes) == pytest.approx(BOW, abs=3e-6)


def test_a_straight_rotor_s_points_blame_neither(rig: Rig, drawn: Drawn, straight: list[Run]) -> None:
    found = judged(rig, drawn, straight, None)
    assert found.passed
    assert found.agreement is not None
    assert {"run-out along", "run-out across", "bow along", "bow across"} <= set(found.agreement.cause_z)


@pytest.mark.parametrize("name", ["A", "E"])
def test_derivatives_by_a_bow_are_those_of_the_prediction(rig: Rig, drawn: Drawn, name: str) -> None:
    speed = rig.physics.speed_rad_s(rig.points[name].speed_ratio)

    def predicted(bow: complex) -> np.ndarray:
        roll = SlowRoll(RUN_OUT, RUN_OUT, bow, np.zeros((6, 6)))
        one = predict_point(rig, replace(drawn.identified, slow_roll=roll), speed, near_rad=near)
        return np.r_[one.values, [part for z in one.orbit for part in (z.real, z.imag)]]

    roll = SlowRoll(RUN_OUT, RUN_OUT, BOW, np.zeros((6, 6)))
    here = predict_point(rig, replace(drawn.identified, slow_roll=roll), speed)
    near, step = here.values[:2].tolist(), 1e-6
    for column, unit in enumerate((1.0, 1j)):
        slope = (predicted(BOW + unit * step) - predicted(BOW - unit * step)) / (2 * step)
        own = np.r_[here.by_bow[0][:, column], here.by_bow[1][:, column]]
        assert own == pytest.approx(slope, rel=2e-2, abs=2e-2 * np.abs(slope[2:]).max())
