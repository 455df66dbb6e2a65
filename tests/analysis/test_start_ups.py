"""Repeated start-ups: where they end, how far apart, what vibration is left."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from analysis_runs import Drawn, draw, point_run

from analysis import Validation, measure, validate
from analysis.start_ups import START_UPS, StartUps
from daq.lockstep.rehearsal import Rehearsal
from daq.signals.run import Run
from rig_configs import Rig
from studies.runs import load_runs

COUNT = 5


@pytest.fixture(scope="module")
def drawn(rig: Rig) -> Drawn:
    return draw(rig, 3)


@pytest.fixture(scope="module")
def runs(rig: Rig, drawn: Drawn) -> list[Run]:
    speed = rig.physics.speed_rad_s(rig.points["E"].speed_ratio) * 30 / np.pi
    made = [point_run(rig, "E", seed, drawn=drawn, after_s=25.0, accuracy=1e-5) for seed in range(COUNT)]
    return [
        dataclasses.replace(
            run, test=START_UPS, start_s=1e9 + 100 * i, metadata={**run.metadata, "speed_rpm": f"{speed}"}
        )
        for i, run in enumerate(made)
    ]


def series_of(found: Validation) -> StartUps:
    (series,) = found.start_ups
    return series


def test_a_rig_that_ends_in_the_predicted_state_passes(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    found = validate(runs, rig, drawn.identified, drawn.axis_angle_deg)
    assert found.passed
    assert found.points == {}
    series = series_of(found)
    assert series.counts == {"pass": COUNT}
    assert sum(ending.count for ending in series.endings) == COUNT
    for ending in series.endings:
        assert ending.state == "I"
        assert ending.scattering == ()
        assert set(ending.scatter) == ({"theta3", "theta4"} if ending.count > 1 else set())
        assert all(one.found < 3 * one.explained for one in ending.scatter.values())
        assert 0 < ending.left < 0.05  # the balanced rotor shakes by less than a twentieth of the locked one
    assert json.loads(json.dumps(found.to_json(), allow_nan=False))["start_ups"][0]["counts"] == {"pass": COUNT}
    assert f"{COUNT} start-ups at" in series.sentences[0]
    assert any("vibration left" in sentence for sentence in series.sentences)


def test_positions_that_scatter_are_called_what_they_are(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    rng = np.random.default_rng(8)
    stuck = []
    for run in runs:
        after = run.angle_time_s > run.releases[0].time_s + 0.5
        off = np.radians(0.1) * rng.standard_normal(2)
        stuck.append(dataclasses.replace(run, angle_rad=run.angle_rad + after[:, None] * off))
    series = series_of(validate(stuck, rig, drawn.identified, drawn.axis_angle_deg))
    assert not series.passed
    largest = max(series.endings, key=lambda ending: ending.count)
    assert largest.scattering
    assert any("friction, play or a speed that wanders" in sentence for sentence in series.sentences)
    seen = np.degrees([one.found for one in largest.scatter.values()])
    assert 0.02 < seen.max() < 0.3


def test_one_that_was_broken_off_is_counted_and_named(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    short = dataclasses.replace(runs[0], releases=(), source="broken.mcap")
    found = validate([short, *runs[1:3]], rig, drawn.identified, drawn.axis_angle_deg)
    assert not found.passed
    series = series_of(found)
    assert series.counts == {"pass": 2, "not enough data": 1}
    assert any("broken.mcap" in sentence and "release" in sentence for sentence in series.sentences)
    assert sum(ending.count for ending in series.endings) == 2


def test_speeds_are_series_of_their_own(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    other = dataclasses.replace(runs[0], metadata={**runs[0].metadata, "speed_rpm": "100.0"})
    found = validate([other, runs[1]], rig, drawn.identified, drawn.axis_angle_deg)
    assert [len(series.results) for series in found.start_ups] == [1, 1]
    assert found.start_ups[0].speed_rpm == 100.0
    assert "one start-up has no scatter" in " ".join(found.start_ups[0].sentences)


@pytest.mark.parametrize("stated", ["nan", "fast", None])
def test_a_cut_log_that_states_no_speed_is_counted_and_ends_nothing(
    rig: Rig, drawn: Drawn, runs: list[Run], stated: str | None
) -> None:
    facts = {"speed_rpm": stated} if stated else {}
    none = np.empty(0)
    cut = dataclasses.replace(runs[0], metadata=facts, mark_time_s=none, mark_phase_rad=none)
    whole = dataclasses.replace(runs[1], metadata=facts)
    found = validate([cut, whole], rig, drawn.identified, drawn.axis_angle_deg)
    series = series_of(found)
    assert series.counts == {"not enough data": 1, "pass": 1}
    assert "a speed that no log states" in series.sentences[0]
    assert json.dumps(found.to_json(), allow_nan=False)


def test_a_start_up_from_rest_is_measured_from_where_its_speed_is_reached(tmp_path: Path) -> None:
    settings = ["virtual.seed=5", "limits.speed_rpm=700"]
    with Rehearsal("isotropic", tmp_path, settings) as far:
        done = far.record("start-ups", speed_rpm=600.0, count=1, from_rest=1)
        (one,) = load_runs([run.log for run in done.runs])
        found = measure(one, far.rig)
    assert done.summary["classes"]["balanced"] == 1
    assert (found.state, found.locked) == ("I", True)
    assert max(r.time_s for r in one.releases) + 4.5 < found.release_s < found.from_s < found.to_s
    assert found.speed_rad_s.value == pytest.approx(600 * math.pi / 30, rel=5e-3)
    ramp = one.mark_time_s < found.release_s - 0.5
    rpm = np.diff(one.mark_phase_rad) / np.diff(one.mark_time_s)
    assert rpm[ramp[:-1]].max() < 0.999 * found.speed_rad_s.value, "before it the rotor speeds up"


def test_marks_lost_before_a_release_at_speed_do_not_make_a_start_from_rest(rig: Rig, runs: list[Run]) -> None:
    whole = runs[0]
    release = max(r.time_s for r in whole.releases)
    kept = (whole.mark_time_s < release - 2.0) | (whole.mark_time_s > release)
    assert not np.all(kept)
    lossy = dataclasses.replace(whole, mark_time_s=whole.mark_time_s[kept], mark_phase_rad=whole.mark_phase_rad[kept])
    assert measure(lossy, rig).release_s == measure(whole, rig).release_s == release
