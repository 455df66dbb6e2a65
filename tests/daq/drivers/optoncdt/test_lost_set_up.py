"""Sensors that go on sending after a power cut, but with settings of their own or in the place of another sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.acquisition.rotor_command import RotorCommand
from daq.acquisition.session import Session
from daq.drivers.contract import Talk
from daq.drivers.optoncdt import wire as optoncdt
from daq.drivers.optoncdt.driver import DRIVER
from daq.drivers.optoncdt.far_end import SimulatedLaser
from daq.drivers.optoncdt.sensor_answers import SensorInfo
from daq.drivers.optoncdt.settings import Laser
from daq.errors import DeviceError, LogError
from daq.items import RX, TX
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from daq.signals.run import load_run
from rig_configs import load_rig

TABLE = Laser.model_validate({"driver": "optoncdt", "port": "p", "axis": "x"})
SAME_WORDS = b"OUTADD_RS422 COUNTER TIMESTAMP\nOUTPUT RS422\n"
DISTANCE_ONLY = b"OUTADD_RS422 NONE\nOUTPUT RS422\n"
T0 = 1_700_000_000_000_000_000


# --- what a pipeline notices ------------------------------------------------------------------------------------------


class Stream:
    """A pipeline with what it gets, 10 ms at a time."""

    def __init__(self) -> None:
        self.pipeline = DRIVER.pipeline("x", TABLE, {})
        self.now_ns = T0

    def send(self, first: int, reads: int, words: int = 4) -> str:
        for read in range(reads):
            number = first + 40 * read + np.arange(40)
            ticks = 25 * number
            block = np.column_stack([np.full(40, 32_760), number % 2**18, ticks & 0xFFFF, ticks >> 16])
            self.now_ns += 10_000_000
            self.pipeline.feed(RX, optoncdt.encode_block(block[:, :words]), self.now_ns)
        return self.sign

    def command(self, text: bytes) -> str:
        self.pipeline.feed(TX, text, self.now_ns)
        return self.sign

    @property
    def sign(self) -> str:
        return self.pipeline.status.set_up_lost


def test_a_restart_is_a_sign_until_the_stream_is_started_again() -> None:
    stream = Stream()
    assert stream.send(100_000, 20) == ""
    assert "lost power" in stream.send(0, 2)
    assert "lost power" in stream.command(b"OUTPUT NONE\n")
    assert stream.command(b"OUTPUT RS422\n") == ""
    assert stream.send(5_000, 20) == ""


def test_a_restart_by_the_set_up_itself_is_no_sign() -> None:
    stream = Stream()
    stream.send(100_000, 20)
    stream.command(b"OUTPUT RS422\n")
    assert stream.send(0, 20) == ""
    assert "lost power" in stream.send(0, 2)


def test_bytes_without_samples_are_a_sign_after_two_seconds() -> None:
    stream = Stream()
    stream.send(100_000, 20)
    assert stream.send(0, 195, words=1) == ""
    assert "no samples" in stream.send(0, 20, words=1)
    assert stream.command(b"OUTPUT RS422\n") == ""


def test_silence_and_a_gap_are_no_sign() -> None:
    stream = Stream()
    stream.send(100_000, 20)
    stream.now_ns += 9_000_000_000
    assert stream.send(100_800 + 36_000, 20) == ""


def test_single_answers_of_a_sensor_that_does_not_stream_are_no_sign() -> None:
    stream = Stream()
    for _ in range(10):
        stream.now_ns += 2_000_000_000
        stream.pipeline.feed(RX, b"OUTPUT NONE ok\r\n->", stream.now_ns)
    assert stream.sign == ""


# --- what a session does about it ------------------------------------------------------------------------------------


def opened() -> tuple[LockstepRig, Session]:
    sim = LockstepRig(load_rig("virtual", settings=["virtual.seed=5"]))
    return sim, Session(
        load_rig("virtual", settings=["virtual.seed=5", *sim.port_settings()]), sim.clock, edge=sim.edge
    )


_POWER = SimulatedLaser.power


def streaming_again(laser: SimulatedLaser, on: bool, now_s: float) -> None:
    """Switch a sensor's power; it streams by itself when its power returns."""
    _POWER(laser, on, now_s)
    if on:
        laser._commands.receive(SAME_WORDS)


def power_cycled(
    monkeypatch: pytest.MonkeyPatch, log: Path, stored: bytes, becomes: SensorInfo | None = None
) -> tuple[Session, list[str]]:
    """Record while laser_y loses power for half a second; return the session and the commands sent to it after that.

    Args:
        stored: commands whose effect is stored in the sensor.
        becomes: sensor that is on its cable afterwards.
    """
    cut: list[float] = []

    def restored(laser: SimulatedLaser, on: bool, now_s: float) -> None:
        if becomes is not None:
            laser._info = becomes
        _POWER(laser, on, now_s)
        if on:
            laser._commands.receive(stored)
            cut.append(now_s)

    monkeypatch.setattr(SimulatedLaser, "power", restored)
    sim, session = opened()
    with session:
        session.start_recording(log, {"test": "record"})
        sim.clock.wait(1.0)
        sim.ask("fail", device="laser_y", what="power", value=1, seconds=0.5)
        end = sim.clock.now_s() + 10.0
        while sim.clock.now_s() < end:
            session.check()
            sim.clock.wait(0.05)
        session.stop_recording({})
    assert cut
    with open_log(log) as recorded:
        sent = [chunk.data.decode() for chunk in recorded.raw("laser_y") if chunk.direction == TX]
    return session, sent


@pytest.mark.parametrize("stored", [SAME_WORDS, DISTANCE_ONLY], ids=["same words", "distance only"])
def test_a_sensor_that_streams_again_by_itself_is_set_up_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, stored: bytes
) -> None:
    session, sent = power_cycled(monkeypatch, tmp_path / "a.mcap", stored)
    assert [text.strip() for text in sent].count("OUTPUT RS422") == 1, "set up again, once"
    assert "MASTERMV NONE\n" in sent
    assert sum("It is set up again" in notice for notice in session.notices) == 1
    assert sum("Its clock is not continuous: this log is not analysed" in notice for notice in session.notices) == 1
    assert len(session.notices) == 2
    with pytest.raises(LogError, match="laser_y restarted during this log"):
        load_run(tmp_path / "a.mcap")
    with open_log(tmp_path / "a.mcap") as log:
        kinds = [event["kind"] for event in log.events if event.get("of") == "laser_y" and event["kind"] != "silence"]
        assert kinds == ["altered", "set_up"]
        assert (log.end_ns - log["laser/y"].time_ns[-1]) * 1e-9 < 0.2
    assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []


def test_a_sensor_with_another_range_in_its_place_is_stopped_and_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    other = SensorInfo(name="ILD1420-50", serial="99990001", range_m=0.05, version="001.019")
    session, _ = power_cycled(monkeypatch, tmp_path / "a.mcap", SAME_WORDS, other)
    assert any("the range is 25 mm in the rig file and 50 mm in the sensor" in notice for notice in session.notices)
    with open_log(tmp_path / "a.mcap") as log:
        assert (log.end_ns - log["laser/y"].time_ns[-1]) * 1e-9 > 5.0, "no longer recorded"
        assert [event["kind"] for event in log.events if event["kind"] == "other"] == ["other"]


def test_another_sensor_of_the_same_kind_is_stopped_and_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    other = SensorInfo(name="ILD1420", serial="99990001", range_m=0.025, version="001.019")
    session, _ = power_cycled(monkeypatch, tmp_path / "a.mcap", SAME_WORDS, other)
    assert any("serial 99990001 instead of" in notice for notice in session.notices)
    with open_log(tmp_path / "a.mcap") as log:
        last_s = (log.end_ns - log["laser/y"].time_ns) * 1e-9
        assert np.mean(last_s < 5.0) < 0.02, "stopped, but for the moments in which it is opened and compared"


def test_a_turning_rotor_delays_the_set_up_also_into_the_next_log(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A dialogue with a sensor would delay the monitoring of the rotor."""

    def wait(seconds: float) -> None:
        end = sim.clock.now_s() + seconds
        while sim.clock.now_s() < end:
            session.check()
            sim.clock.wait(0.05)

    def turning(command: RotorCommand) -> bool:
        return True

    monkeypatch.setattr(SimulatedLaser, "power", streaming_again)
    sim, session = opened()
    with session:
        with monkeypatch.context() as turned:
            turned.setattr(RotorCommand, "turning", turning)
            session.start_recording(tmp_path / "a.mcap", {"test": "record"})
            wait(1.0)
            sim.ask("fail", device="laser_y", what="power", value=1, seconds=0.5)
            wait(4.0)
            assert [*session._core.altered] == ["laser_y"]
            session.stop_recording({})
            session.start_recording(tmp_path / "b.mcap", {"test": "record"})
            wait(3.0)
            assert [*session._core.altered] == ["laser_y"]
        wait(3.0)
        assert [*session._core.altered] == []
        session.stop_recording({})
    for name, kinds in (("a", ["altered"]), ("b", ["set_up"])):
        with open_log(tmp_path / f"{name}.mcap") as log:
            assert [event["kind"] for event in log.events if event["kind"] in ("altered", "set_up")] == kinds


@pytest.mark.parametrize("after_s", [0.0, 0.1, 0.12])
def test_a_lost_set_up_is_reported_before_the_device_is_set_up_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, after_s: float
) -> None:
    """Devices are set up again in any wait of the session, and looked at four times a second."""
    monkeypatch.setattr(SimulatedLaser, "power", streaming_again)
    sim, session = opened()
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.clock.wait(3.0)
        sim.clock.wait(after_s)
        sim.ask("fail", device="laser_y", what="power", value=1, seconds=0.1)
        for _ in range(60):
            session.check()
            sim.clock.wait(0.05)
        session.stop_recording({})
    assert [
        notice for notice in session.notices if "may have lost power and its settings. It is set up again" in notice
    ]
    with open_log(tmp_path / "a.mcap") as log:
        assert [e["kind"] for e in log.events if e["kind"] in ("altered", "set_up")] == ["altered", "set_up"]


def test_attempts_that_fail_in_ever_new_words_are_reported_ten_times(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The text of a failure may contain numbers of bytes; a recording of hours makes thousands of attempts."""
    monkeypatch.setattr(SimulatedLaser, "power", streaming_again)
    sim, session = opened()
    attempts: list[str] = []

    def refuses(device: str, settings: Laser, talk: Talk) -> dict[str, Any]:
        attempts.append(f"{device}: refused attempt {max(0, len(attempts) - 4)}")  # the first five are equal
        talk.clock.wait(0.1)
        raise DeviceError(attempts[-1])

    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.clock.wait(3.0)
        monkeypatch.setitem(vars(DRIVER), "open", refuses)
        sim.ask("fail", device="laser_y", what="power", value=1, seconds=0.1)
        for _ in range(820):
            session.check()
            sim.clock.wait(0.05)
        session.stop_recording({})
    assert len(attempts) > 15
    assert [notice for notice in session.notices if "refused attempt" in notice] == attempts[4:14]
