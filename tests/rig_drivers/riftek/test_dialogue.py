"""An RF60x sensor opened, read and stopped: the real dialogue and pipeline against the simulated sensor, no threads."""

from __future__ import annotations

import queue
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.clock import SimulatedClock
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.motion import GRID_S, StepTrajectory
from daq.virtual_rig.world import DeviceClock
from rig_drivers.riftek import wire
from rig_drivers.riftek.driver import DRIVER
from rig_drivers.riftek.far_end import SimulatedRiftek
from rig_drivers.riftek.settings import RiftekLaser

STEP_S = 0.02


def laser(**other: Any) -> RiftekLaser:
    return RiftekLaser(**{"driver": "riftek", "port": "loop://", "axis": "y", "rate_Hz": 4000.0} | other)


class Bench:
    """A sensor on its line and its reader; time passes while the dialogue waits.

    Attributes:
        motion: y in m at a time in s.
    """

    def __init__(self, config: RiftekLaser, drift: float = 0.0, offset_m: float = 0.0) -> None:
        self.config = config
        rng = np.random.default_rng(1)
        beam = Beam(np.array([0.0, 1.0]), offset_m, 0.0, DeviceClock(3.0, drift), rng)
        self.sensor = SimulatedRiftek(config, beam, "12345")
        self.pipeline = DRIVER.pipeline("laser_y", config, {})
        self.clock = SimulatedClock()
        self.replies: queue.Queue[str] = self.clock.queue()
        self.bytes_in = 0
        self.sent: list[bytes] = []
        self.batches: list[Batch] = []
        self.events: list[DeviceEvent] = []
        self.damage: set[int] = set()  # places of answer bytes that get a bit flipped
        self._answered = 0
        self.clock.after(STEP_S, self._step, world=True)

    def restart_decoding(self) -> None:
        self.pipeline = DRIVER.pipeline("laser_y", self.config, {})
        self.batches.clear()
        self.events.clear()

    def send(self, data: bytes) -> None:
        self.sent.append(data)
        self.pipeline.feed(TX, data, self.clock.now_ns())
        answer = bytearray(self.sensor.receive(data))
        for i in range(len(answer)):
            answer[i] ^= 0x01 if self._answered + i in self.damage else 0
        self._answered += len(answer)
        self._hear(bytes(answer))

    def motion(self, time_s: np.ndarray) -> np.ndarray:
        return 2e-3 * np.sin(20.0 * time_s)

    def _step(self) -> None:
        times = self.clock.now_s() - STEP_S + GRID_S * np.arange(round(STEP_S / GRID_S) + 1)
        rows = np.zeros((len(times), 10))
        rows[:, 1], rows[:, 5] = self.motion(times), 40e-3 * np.cos(20.0 * times)
        self._hear(self.sensor.sample(StepTrajectory(times, rows)))
        self.clock.after(STEP_S, self._step, world=True)

    def _hear(self, data: bytes) -> None:
        if not data:
            return
        self.bytes_in += len(data)
        for item in self.pipeline.feed(RX, data, self.clock.now_ns()):
            if isinstance(item, Batch):
                self.batches.append(item)
            elif item.kind == "reply":
                self.replies.put(item.text)
            else:
                self.events.append(item)

    def column(self, name: str) -> np.ndarray:
        return np.concatenate([batch.columns[name] for batch in self.batches])


@pytest.fixture
def bench() -> Bench:
    return Bench(laser())


def test_opening_sets_it_up_and_starts_its_stream(bench: Bench) -> None:
    identity = DRIVER.open("laser_y", bench.config, bench)
    assert identity == {
        "type": 63,
        "firmware": 64,
        "serial": "12345",
        "base_m": 0.08,
        "range_m": 0.025,
        "period_us": 250,
        "control": 0x02,
    }
    assert bench.sensor.streaming
    assert bench.sensor.period_us == 250
    bench.clock.wait(1.0)
    assert len(bench.column("code")) == pytest.approx(4000, abs=2)
    assert bench.events == []
    assert not any(bench.pipeline.losses.values())


def test_a_stream_left_running_is_run_dry_first(bench: Bench) -> None:
    bench.sensor.receive(wire.request(0, wire.START))
    bench.clock.wait(0.5)
    assert bench.batches
    assert DRIVER.open("laser_y", bench.config, bench)["range_m"] == 0.025
    bench.clock.wait(0.5)
    assert bench.events == []
    assert bench.column("counter")[-1] == pytest.approx(2000, abs=2)


@pytest.mark.parametrize("rate_Hz", [10_000.0, 4000.0, 1000.0, 250.0, 40.0, 16.0])
@pytest.mark.parametrize("before", [100, 255, 256, 5000, 65_535])
def test_the_period_is_set_from_any_previous_value(rate_Hz: float, before: int) -> None:
    bench = Bench(laser(rate_Hz=rate_Hz))
    bench.sensor.parameters |= {wire.PERIOD: before & 0xFF, wire.PERIOD + 1: before >> 8}
    DRIVER.open("laser_y", bench.config, bench)
    assert bench.sensor.period_us == bench.config.period_us
    integration = bench.sensor.parameters[wire.INTEGRATION] | bench.sensor.parameters[wire.INTEGRATION + 1] << 8
    assert integration == min(3200, bench.config.period_us)


def test_what_another_program_left_set_is_undone(bench: Bench) -> None:
    bench.sensor.parameters |= {wire.POWER: 0, wire.CONTROL: 0xFF, wire.AVERAGES: 64, wire.ZERO: 7, wire.ZERO + 1: 3}
    DRIVER.open("laser_y", bench.config, bench)
    kept = {wire.POWER: 1, wire.CONTROL: wire.CONTROL_KEPT, wire.AVERAGES: 1, wire.ZERO: 0, wire.ZERO + 1: 0}
    assert kept.items() <= bench.sensor.parameters.items()
    assert not any(data[1] & 0x0F == wire.STORE for data in bench.sent)


def test_another_sensor_than_the_rig_files_is_refused(bench: Bench) -> None:
    bench.sensor.fail("range", 50)
    with pytest.raises(
        DeviceError, match=r"25 mm in the rig file and 50 mm in the sensor \(serial 12345\)\. Correct dev"
    ):
        DRIVER.open("laser_y", bench.config, bench)


def test_the_error_for_a_silent_sensor_contains_what_to_check(bench: Bench) -> None:
    bench.sensor.fail("deaf")
    with pytest.raises(DeviceError, match=r"no answer to request 1 of address 1 within .* its parity E, its address"):
        DRIVER.open("laser_y", bench.config, bench)


def test_a_sensor_that_does_not_stop_raises(bench: Bench) -> None:
    bench.sensor.receive(wire.request(0, wire.START))
    bench.sensor.fail("deaf")
    with pytest.raises(DeviceError, match="ordered several times to stop its stream, it goes on sending"):
        DRIVER.open("laser_y", bench.config, bench)


def test_a_parameter_that_does_not_stay_as_written_raises(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.sensor, "_write", lambda parameter, value: None)
    with pytest.raises(DeviceError, match=r"wrote low byte of zero point 0|wrote .* integration time \d+ .*can this"):
        DRIVER.open("laser_y", bench.config, bench)


def test_a_sensor_of_another_address_is_refused_but_stopped() -> None:
    bench = Bench(laser(address=7))
    other = SimulatedRiftek(laser(address=9), Beam.unmoved(), "1")
    bench.sensor = other
    other.receive(wire.request(9, wire.START))
    with pytest.raises(DeviceError, match="of address 7"):
        DRIVER.open("laser_y", bench.config, bench)
    assert not other.streaming


@pytest.mark.parametrize("place", range(0, 40, 3))
def test_a_flipped_bit_in_an_answer_does_not_set_it_up_wrongly(bench: Bench, place: int) -> None:
    bench.damage = {place}
    identity = DRIVER.open("laser_y", bench.config, bench)
    assert (identity["serial"], identity["range_m"], bench.sensor.period_us) == ("12345", 0.025, 250)


def test_answers_that_never_agree_raise(bench: Bench) -> None:
    bench.damage = {18, 35, 52}
    with pytest.raises(DeviceError, match="expected two equal answers"):
        DRIVER.open("laser_y", bench.config, bench)


@pytest.mark.parametrize("lost", [1, 3, 300])
def test_lost_results_are_counted(bench: Bench, lost: int) -> None:
    DRIVER.open("laser_y", bench.config, bench)
    bench.clock.wait(3.0)
    bench.sensor.fail("lost", lost)
    bench.clock.wait(3.0)
    assert bench.pipeline.losses["samples"] == lost
    assert bench.column("counter")[-1] == pytest.approx(24_000, abs=2)


def test_faults_of_the_sensor_show(bench: Bench) -> None:
    DRIVER.open("laser_y", bench.config, bench)
    for what, value in (("code", 0), ("code", 16_384), ("code", -1), ("stale", 1), ("stale", 0)):
        bench.batches.clear()
        bench.sensor.fail(what, value)
        bench.clock.wait(0.2)
        valid = np.isfinite(bench.column("displacement_m"))
        assert valid.all() if (what, value) in (("code", -1), ("stale", 0)) else not valid[1:].any()
    with pytest.raises(ValueError, match="no fault 'dance'"):
        bench.sensor.fail("dance")


def test_out_of_range_is_no_target() -> None:
    bench = Bench(laser(), offset_m=0.0125)
    DRIVER.open("laser_y", bench.config, bench)
    bench.clock.wait(0.5)
    assert 0.3 < np.mean(np.isnan(bench.column("displacement_m"))) < 0.7


@given(st.binary(max_size=200), st.lists(st.integers(1, 20), min_size=1))
def test_any_requests_in_any_pieces_give_the_same_answers(data: bytes, cuts: list[int]) -> None:
    whole, pieces = Bench(laser()).sensor, Bench(laser()).sensor
    expected, got, rest = whole.receive(data), b"", data
    for cut in cuts * 200:
        got, rest = got + pieces.receive(rest[:cut]), rest[cut:]
    assert got + pieces.receive(rest) == expected
    assert all(byte >= 0x80 for byte in expected)
