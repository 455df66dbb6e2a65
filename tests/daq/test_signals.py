"""From a log to signals on one clock: angles, marks, releases however the node told of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.errors import ChannelMissing, LogError
from daq.signals import load_run
from tests.daq.small_log import write_small_log


def test_signals_keep_the_devices_own_spacing(tmp_path: Path) -> None:
    run = load_run(write_small_log(tmp_path / "a.mcap", steps=40))
    assert len(run.x_time_s) == len(run.y_time_s) == 1600
    assert np.allclose(np.diff(run.x_time_s), 250e-6, rtol=1e-4)
    assert np.allclose(np.diff(run.angle_time_s), 1e-3, rtol=1e-4)
    assert np.allclose(run.mark_phase_rad, 2 * np.pi * np.arange(40))
    assert np.allclose(run.mark_time_s - run.angle_time_s[0], 0.01 * np.arange(40) + 0.0095, atol=1e-6)
    assert np.allclose(run.angle_rad[:, 1], np.pi)
    assert run.test == "small"
    assert run.releases == ()
    assert set(run.clock_rate_std) == {"laser_x", "laser_y", "encoder"}


@pytest.mark.parametrize("told", [(0, 1), (0,), (1,)])
def test_a_release_is_dated_by_the_node_even_when_one_message_is_lost(tmp_path: Path, told: tuple[int, ...]) -> None:
    run = load_run(write_small_log(tmp_path / "a.mcap", steps=20, opened_at=8, told=told))
    assert [r.pendulum for r in run.releases] == [0, 1]
    for release in run.releases:
        assert release.time_s - run.angle_time_s[0] == pytest.approx(0.083, abs=1e-5)
        assert release.time_std_s < 1e-3


def test_without_any_message_the_lock_flags_bracket_the_release(tmp_path: Path) -> None:
    run = load_run(write_small_log(tmp_path / "a.mcap", steps=20, opened_at=8, told=()))
    assert [r.pendulum for r in run.releases] == [0, 1]
    for release in run.releases:
        assert abs(release.time_s - run.angle_time_s[0] - 0.083) < 2 * release.time_std_s + 0.01
        assert 1e-3 < release.time_std_s < 0.02


def test_a_log_that_lacks_a_device_says_so(tmp_path: Path) -> None:
    with pytest.raises((LogError, ChannelMissing), match=r"absent\.mcap"):
        load_run(tmp_path / "absent.mcap")
