"""From a log to signals on one clock: angles, marks, releases from any combination of the node's messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.errors import ChannelMissing, LogError
from daq.exchange.imported_log import DISPLACEMENT_Y, PENDULUM_ANGLES, ROTOR_MARK, ROTOR_PHASE
from daq.items import Batch, DeviceEvent
from daq.log.file import LogFile
from daq.signals.run import load_run
from rig_configs import load_rig
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
    assert set(run.clock_rate_std) == {"x", "y", "angles", "phase"}


@pytest.mark.parametrize("reported", [(0, 1), (0,), (1,)])
def test_a_release_is_dated_by_the_node_even_when_one_message_is_lost(
    tmp_path: Path, reported: tuple[int, ...]
) -> None:
    run = load_run(write_small_log(tmp_path / "a.mcap", steps=20, opened_at=8, reported=reported))
    assert [r.pendulum for r in run.releases] == [0, 1]
    for release in run.releases:
        assert release.time_s - run.angle_time_s[0] == pytest.approx(0.083, abs=1e-5)
        assert release.time_std_s < 1e-3


def test_without_any_message_the_lock_flags_bracket_the_release(tmp_path: Path) -> None:
    run = load_run(write_small_log(tmp_path / "a.mcap", steps=20, opened_at=8, reported=()))
    assert [r.pendulum for r in run.releases] == [0, 1]
    for release in run.releases:
        assert abs(release.time_s - run.angle_time_s[0] - 0.083) < 2 * release.time_std_s + 0.01
        assert 1e-3 < release.time_std_s < 0.02


def test_a_log_that_is_absent_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises((LogError, ChannelMissing), match=r"absent\.mcap"):
        load_run(tmp_path / "absent.mcap")


START = 1_700_000_000_500_000_000


def imported_log(
    path: Path, *parts: Batch, events: tuple[DeviceEvent, ...] = (), rig: bytes | None = None, **facts: str
) -> Path:
    """A log without device clocks: the samples' own times are on the common clock."""
    snapshot = (
        load_rig("virtual", settings=["devices.encoder.index_angle_deg=30"]).snapshot_json() if rig is None else rig
    )
    attachments = {"rig.json": snapshot} if snapshot else {}
    with LogFile(path, {"test": "point-B", **facts}, attachments, (), START, [part.channel for part in parts]) as log:
        for part in parts:
            log.batch(part, part.time_ns)
        for event in events:
            log.event(event, START)
        return log.finish({"losses": {"laser_y": {"samples": 2, "invalid": 1}}})


def batch(channel: Any, step_s: float, **columns: np.ndarray) -> Batch:
    n = len(next(iter(columns.values())))
    time = START + np.rint(np.arange(n) * step_s * 1e9).astype(np.int64)
    return Batch(channel, time, np.arange(n, dtype=np.uint32), columns)


def test_channels_without_a_device_clock_are_on_the_common_clock(tmp_path: Path) -> None:
    y = batch(DISPLACEMENT_Y, 1e-3, displacement_m=np.array([1e-3, np.nan, 3e-3]))
    angles = batch(
        PENDULUM_ANGLES,
        2e-3,
        theta3_rad=np.array([0.1, np.nan, 0.3, 0.4]),
        theta4_rad=np.array([3.0, 3.1, 3.2, np.nan]),
    )
    marks = batch(ROTOR_MARK, 0.25, revolutions=np.array([0, 1, 3]))
    reported = DeviceEvent(
        "lock", "encoder", "", {"pendulum": 1, "state": "released", "time_ns": START + 4_000_000, "time_std_s": 0.02}
    )
    run = load_run(imported_log(tmp_path / "a.mcap", y, angles, marks, events=(reported,), clock_tolerance_ppm="7"))
    assert run.start_s == 1_700_000_000
    assert len(run.x_time_s) == len(run.x_m) == 0
    assert np.allclose(run.y_time_s, [0.5, 0.501, 0.502], atol=1e-12)
    assert np.array_equal(run.y_m, [1e-3, np.nan, 3e-3], equal_nan=True)
    assert np.allclose(run.angle_time_s, [0.5, 0.504], atol=1e-12)  # only where both have a reading
    assert run.angle_rad.tolist() == [[0.1, 3.0], [0.3, 3.2]]
    assert np.allclose(run.mark_time_s, [0.5, 0.75, 1.0])
    assert np.allclose(run.mark_phase_rad, 2 * np.pi * np.array([0, 1, 3]) + np.radians(30))
    assert [(r.pendulum, r.time_std_s) for r in run.releases] == [(1, 0.02)]
    assert run.releases[0].time_s == pytest.approx(0.504)
    assert run.clock_rate_std == {"x": 7e-6, "y": 7e-6, "angles": 7e-6, "phase": 7e-6}
    assert run.losses == {"laser_y.samples": 2, "laser_y.invalid": 1}
    assert run.metadata["identities"] == {}


def test_a_pendulum_that_was_not_recorded_is_absent_throughout(tmp_path: Path) -> None:
    angles = batch(PENDULUM_ANGLES, 1e-3, theta3_rad=np.array([0.1, np.nan, 0.3]), theta4_rad=np.full(3, np.nan))
    run = load_run(imported_log(tmp_path / "a.mcap", angles))
    assert run.angle_rad[:, 0].tolist() == [0.1, 0.3]
    assert np.isnan(run.angle_rad[:, 1]).all()


def test_a_phase_becomes_the_instants_of_its_whole_turns(tmp_path: Path) -> None:
    turns = np.array([-0.5, 0.5, 0.3, 0.4, np.nan, 1.5, 3.5])  # an encoder may step backwards
    run = load_run(imported_log(tmp_path / "a.mcap", batch(ROTOR_PHASE, 1.0, phase_rad=2 * np.pi * turns)))
    assert np.allclose(run.mark_phase_rad, 2 * np.pi * np.array([0, 1, 2, 3]))
    assert np.allclose(run.mark_time_s - 0.5, [0.5, 1 + 4 * 0.5, 5.25, 5.75])


def test_a_log_without_rig_file_or_samples_is_refused(tmp_path: Path) -> None:
    angles = batch(PENDULUM_ANGLES, 1e-3, theta3_rad=np.zeros(3), theta4_rad=np.zeros(3))
    with pytest.raises(LogError, match=r"rig\.json"):
        load_run(imported_log(tmp_path / "a.mcap", angles, rig=b""))
    with pytest.raises(LogError, match="expected samples in one of laser/x, laser/y, pendulums, tacho, found"):
        load_run(imported_log(tmp_path / "b.mcap"))
    with pytest.raises(LogError, match="expected a number as clock_tolerance_ppm, got 'good'"):
        load_run(imported_log(tmp_path / "c.mcap", angles, clock_tolerance_ppm="good"))
