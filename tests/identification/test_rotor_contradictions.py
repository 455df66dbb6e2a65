"""Run-ups whose marks, clock or locks contradict themselves: the fit is right after correction, or names the cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.signals.rotor_doubts import RotorDoubt, encoder_jumps, moved_pendulums, phase_jumps, sound_marks
from daq.signals.run import Run
from identification import identify
from identification.errors import FitFailed, UnexplainedPassage
from identification.run_up.contradictions import explained, phase_of
from identification.run_up.fit import fit_run_up_run
from rig_configs import load_rig
from tests.identification.pendulum_world import World
from tests.identification.test_run_up_passages import Passage, assert_covers, ramp

TURN = 2 * np.pi
PASSAGE = Passage(ramp(0.5, 7.0, 20.0), 20.0)


def with_marks(run: Run, time_s: np.ndarray) -> Run:
    """A run whose sensor counts each of these marks as a turn."""
    return replace(run, mark_time_s=time_s, mark_phase_rad=TURN * (1 + np.arange(len(time_s))))


def stated(run: Run) -> str:
    """What the fit states about a run: its error, or its warnings."""
    try:
        return "; ".join(fit_run_up_run(run).warnings)
    except FitFailed as error:
        return str(error)


def test_marks_that_come_twice_are_counted_once() -> None:
    run = PASSAGE.run()
    late = run.mark_time_s[20:]  # faster than 2.5 turns per second
    bounced = with_marks(run, np.sort(np.r_[run.mark_time_s, late + 3e-3]))
    fit = fit_run_up_run(bounced)
    assert_covers(PASSAGE, fit)
    assert any(f"{len(late)} index marks came twice within 3.0 ms (corrected)" in warning for warning in fit.warnings)


def test_a_turn_that_was_not_counted_is_counted() -> None:
    run = PASSAGE.run()
    fit = fit_run_up_run(with_marks(run, np.delete(run.mark_time_s, 40)))
    assert_covers(PASSAGE, fit)
    assert any("1 turn was not counted (corrected)" in warning for warning in fit.warnings)


@pytest.mark.parametrize("step_s", [0.05, -0.05])
def test_a_step_of_the_clock_of_the_marks_is_named(step_s: float) -> None:
    run = PASSAGE.run()
    after = run.mark_time_s > 14.0
    found = stated(with_marks(run, run.mark_time_s + step_s * after))
    assert f"the clock of the index marks stepped by {step_s * 1e3:+.0f}" in found
    assert "at 13.9" in found or "at 14." in found


def test_a_pendulum_that_moves_in_its_lock_is_named() -> None:
    heavy = replace(PASSAGE, eccentricity_m=400e-6)
    late = PASSAGE.time > 10.0
    x, y = np.where(late[:, None], heavy.signal, PASSAGE.signal).T
    angles = np.radians(np.column_stack([np.where(late, 8.0, 0.0), np.full(len(late), 180.0)]))
    run = replace(PASSAGE.run(), x_m=x, y_m=y, angle_time_s=PASSAGE.time, angle_rad=angles)
    with pytest.raises(FitFailed, match=r"pendulum A moved by \+8\.0° in its lock, first at 10\.00 s"):
        fit_run_up_run(run)


def test_a_turn_that_a_sampled_phase_lost_is_named() -> None:
    phase = PASSAGE.phase - TURN * (PASSAGE.time > 12.0)
    assert phase_jumps(PASSAGE.time, PASSAGE.phase) == []
    (jump,) = phase_jumps(PASSAGE.time, phase)
    assert (jump.kind, jump.size) == ("phase jump", pytest.approx(-TURN, abs=0.01))
    tested = replace(PASSAGE.run(), phase_time_s=PASSAGE.time, phase_rad=PASSAGE.phase)
    assert phase_of(replace(tested, phase_rad=phase))[1] == [jump]
    assert phase_of(tested)[1] == []
    error = explained(UnexplainedPassage("no convergence"), [], phase_of(tested)[0], [jump])
    assert str(error) == "no convergence. the phase jumps by -360.0° at 12.00 s"


@pytest.mark.parametrize("pendulum", [0, 1])
def test_an_encoder_that_slips_is_named(pendulum: int) -> None:
    run = World().spin_down(1, (8.0, -8.0))
    time, angle = run.angle_time_s, run.angle_rad.copy()
    assert encoder_jumps(time, angle) == []
    angle[time > time[0] + 0.8, pendulum] += np.radians(5.0)
    (jump,) = encoder_jumps(time, angle)
    assert (jump.kind, jump.pendulum) == ("encoder jump", "AB"[pendulum])
    assert jump.size == pytest.approx(np.radians(5.0), abs=0.01)
    assert jump.at_s == pytest.approx(time[0] + 0.8, abs=2e-3)
    found = identify([replace(run, angle_rad=angle)], load_rig("virtual"))  # from the motion after the slip
    assert any(f"spin-down.mcap: {jump.words}" == warning for warning in found.warnings)
    for name, value in zip(found.estimates[0].names, found.estimates[0].values, strict=True):
        assert abs(value - World().physics.identified()[name]) < 3 * found.estimates[0].std[name]


def test_a_flick_or_a_gap_is_no_slip() -> None:
    time = np.arange(0.0, 3.0, 1e-3)
    speed = np.interp(time, [1.0, 1.02, 1.5], [0.0, 20.0, 5.0])
    angle = np.column_stack([np.cumsum(speed) * 1e-3, -np.cumsum(speed) * 1e-3])
    assert encoder_jumps(time, angle) == []
    kept = np.abs(time - 1.02) > 0.02
    assert encoder_jumps(time[kept], angle[kept]) == []


def test_a_short_push_at_a_low_rate_is_no_slip() -> None:
    time = np.arange(0.0, 3.0, 1e-2)
    speed = 12.0 * np.exp(-(((time - 1.0) / 0.012) ** 2))
    angle = np.column_stack([np.cumsum(speed) * 1e-2, np.zeros(len(time))])
    assert encoder_jumps(time, angle) == []


def test_a_log_of_sound_marks_is_left_alone() -> None:
    for passage in (PASSAGE, Passage(ramp(0.5, 7.0, 20.0), 20.0, rate_Hz=200.0)):
        run = passage.run()
        rng = np.random.default_rng(3)
        times = run.mark_time_s + 1e-3 * rng.standard_normal(len(run.mark_time_s))
        assert sound_marks(times, run.mark_phase_rad)[2] == ()
        quarters = np.arange(1, 200) * 0.25 * TURN
        assert np.array_equal(sound_marks(np.arange(1.0, 200.0), quarters)[1], quarters)
    still = np.zeros((500, 2)) + np.radians(0.4) * np.sin(np.arange(500))[:, None]
    assert moved_pendulums(np.arange(500) * 0.01, still) == []


def test_every_doubt_has_its_size_and_time() -> None:
    doubt = RotorDoubt("time step", 0.05, 3.25, mended=True)
    assert doubt.words == "the clock of the index marks stepped by +50.0 ms (corrected) at 3.25 s"
    assert RotorDoubt("other order", 0.91, float("nan")).words.startswith("the displacement turns at 0.910 times")
