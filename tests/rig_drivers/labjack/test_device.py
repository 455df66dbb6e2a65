"""LabJack: messages, volts, edges, settings, its opening, what it reports as lost, and sessions."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.acquisition.session import Session
from daq.channels import TACHO
from daq.drivers.driver import Driver
from daq.errors import DeviceError, LogError
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from daq.signals.run import load_run
from rig_configs import load_rig
from rig_configs.roles import DisplacementSensor, OtherQuantity, Roles, RotorPhase
from rig_drivers.labjack import wire
from rig_drivers.labjack.driver import DRIVER
from rig_drivers.labjack.far_end import SimulatedLabJack
from rig_drivers.labjack.marks import EdgeFinder
from rig_drivers.labjack.scans import nominal, read_constants
from rig_testing.bench import DriverBench
from tests.daq.kit_cases import LONG
from tests.effort import thorough
from tests.rig_drivers.labjack.reads import LASERS, START, Reads, batches, events, numbers, settings

# --- messages ---------------------------------------------------------------------------------------------------------


def test_parts_of_a_request_are_those_of_the_facts() -> None:
    reads = wire.read(1, 1) + wire.read(2, 2) + wire.read(3, 4)
    assert reads == bytes.fromhex("00 0001 01 00 0002 02 00 0003 04")
    writes = wire.write(1, bytes.fromhex("1234")) + wire.write(2, bytes.fromhex("56789abc"))
    assert writes == bytes.fromhex("01 0001 01 1234 01 0002 02 56789abc")


def test_a_stream_read_is_a_feedback_request_of_register_4500() -> None:
    assert wire.stream_request(5, 2) == bytes.fromhex("8005 0000 0006 01 4c 00 1194 f0")
    assert wire.stream_request(0x8001, 3)[:2] == bytes.fromhex("8001")
    assert wire.samples_per_read(3) == 234


def test_an_answer_has_its_samples_behind_its_state() -> None:
    data = bytes.fromhex("8005 0000 0010 01 4c 0003 0100 0b7d 0007 0001 8000 fffe")
    (message,) = wire.MessageDecoder().feed(data).messages
    read = wire.parse_stream(message.body)
    assert read is not None
    assert (message.number, read.backlog_bytes, read.status, read.info) == (0x8005, 256, wire.Status.RECOVERED, 7)
    assert read.samples.tolist() == [1, 0x8000, 0xFFFE]


@pytest.mark.parametrize("body", [b"", bytes(7), bytes.fromhex("0002 0000 0000 0000 0001")])
def test_an_answer_shorter_than_its_samples_is_damaged(body: bytes) -> None:
    assert wire.parse_stream(body) is None
    data = struct.pack(">HHHBB", 0x8000, 0, 2 + len(body), 1, 0x4C) + body
    made = Reads()
    (event,) = events(made.feed(data))
    assert event.kind == "damage"
    assert made.pipeline.losses["bytes"] == len(body)


# --- volts ------------------------------------------------------------------------------------------------------------


def test_nominal_volts_are_those_of_the_data_sheet() -> None:
    counts = np.array([0, 33523, 65535], np.uint16)
    assert nominal("T7", 10.0).volts(counts) == pytest.approx([-10.586758, 0.0, 10.109575], abs=1e-5)
    assert nominal("T7", 1.0).volts(counts) == pytest.approx([-1.0586758, 0.0, 1.0109575], abs=1e-6)
    assert nominal("T4", 10.0).volts(np.array([0, 65535], np.uint16)) == pytest.approx(
        [-10.532965, 10.669678], abs=1e-4
    )


def test_constants_of_the_flash_are_those_of_range_or_input() -> None:
    sets = [(3e-4, -3.1e-4, 33000.0, -10.0), (3e-5, -3.1e-5, 33001.0, -1.0)] + 6 * [(1e-6, -1e-6, 33002.0, -0.1)]
    t7 = struct.pack(">32f", *(value for each in sets for value in each)) + bytes(36)
    scale = read_constants("T7", "AIN9", 1.0, t7)
    assert scale is not None
    assert scale.volts(np.array([33001, 33101, 32901], np.uint16)) == pytest.approx([0, 3e-3, -3.1e-3], rel=1e-6)
    t4 = struct.pack(">4f", 3.2e-4, -10.5, 3.3e-4, -10.6) + bytes(60)
    scale = read_constants("T4", "AIN1", 10.0, t4)
    assert scale is not None
    assert scale.volts(np.array([0, 1000], np.uint16)) == pytest.approx([-10.6, -10.27], abs=1e-4)
    assert read_constants("T7", "AIN0", 10.0, b"\xff" * 164) is None
    assert read_constants("T4", "AIN0", 10.0, bytes(76)) is None


# --- index marks ------------------------------------------------------------------------------------------------------


@given(st.integers(2, 60), st.lists(st.integers(1, 30), min_size=1, max_size=30))
def test_edges_do_not_depend_on_the_split_and_are_interpolated(period: int, sizes: list[int]) -> None:
    at = np.arange(300)
    signal = np.sin(2 * np.pi * at / (period + 3.37))
    whole = EdgeFinder(0.2, 0.3).feed(signal)
    finder, found, start = EdgeFinder(0.2, 0.3), list[float](), 0
    for size in [*sizes, 300]:
        found += (start + finder.feed(signal[start : start + size])).tolist()
        start = min(300, start + size)
    assert found == pytest.approx(whole.tolist())
    true = (np.arcsin(0.2) / (2 * np.pi) + np.arange(1, 60)) * (period + 3.37)
    for edge in whole.tolist():
        assert np.min(np.abs(true - edge)) < 0.25


def test_noise_within_the_hysteresis_makes_no_second_edge() -> None:
    signal = np.array([0.0, 1.0, 2.6, 2.4, 2.6, 2.1, 2.7, 1.9, 2.6])
    assert EdgeFinder(2.5, 0.5).feed(signal) == pytest.approx([1 + 1.5 / 1.6, 7 + 0.6 / 0.7])


def test_the_first_edge_needs_a_sample_below() -> None:
    finder = EdgeFinder(2.5, 0.5)
    assert not len(finder.feed(np.array([5.0, 5.0])))
    assert not len(finder.feed(np.array([2.3, 5.0])))
    assert len(finder.feed(np.array([0.0, 5.0]))) == 1
    finder.feed(np.array([0.0]))
    finder.restart()
    assert not len(finder.feed(np.array([5.0])))


@pytest.mark.parametrize(("edge", "place"), [("rising", 14_500), ("falling", 19_500)])
def test_a_digital_line_marks_the_middle_between_two_scans(edge: str, place: int) -> None:
    made = Reads(lasers={}, tacho={"input": "EIO3", "edge": edge}, scan_rate_Hz=1000.0)
    states = ([0xFE00 | 0x01] * 15 + [0xFE00 | 0x09] * 5) * 3
    (batch,) = batches(made.answer(states), "tacho")
    first = batch.columns["node_time_us"].astype(int) - 20_000 * batch.columns["revolutions"].astype(int)
    assert first.tolist() == [place] * len(first)
    assert len(first) >= 2


# --- settings ---------------------------------------------------------------------------------------------------------


def test_roles_are_those_of_the_tables() -> None:
    own = settings(tacho={"input": "AIN2", "index_angle_deg": 12.0}, others={"a": _accelerometer("AIN3")})
    x, y, phase, other = own.roles("lab")
    assert isinstance(x, DisplacementSensor)
    assert isinstance(y, DisplacementSensor)
    assert (x.topic, y.topic, x.rate_Hz) == ("laser/x", "laser/y", 4000.0)
    assert isinstance(phase, RotorPhase)
    assert (phase.topic, phase.index_angle_deg) == ("tacho", 12.0)
    assert isinstance(other, OtherQuantity)
    assert (other.topic, other.fields) == ("analogue/a", ("acceleration_m_per_s2",))
    assert Roles.of(own.roles("lab")).phase == phase
    assert own.scan_list == (0, 2, 6, 4)


def _accelerometer(name: str) -> dict[str, Any]:
    return {"input": name, "quantity": "acceleration_m_per_s2", "per_V": 10.0}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"lasers": {}}, "at least one input"),
        ({"tacho": {"input": "AIN1"}}, "AIN1 has two tables"),
        ({"scan_rate_Hz": 20_000.0}, "samples a second"),
        ({"port": "socket://x:702"}, "502"),
        ({"lasers": {"a": {"axis": "x", "input": "AIN0"}, "b": {"axis": "x", "input": "AIN1"}}}, "same channel"),
        ({"lasers": {"a": {"axis": "x", "input": "AIN0", "far_V": 0.0}}}, "two voltages"),
        ({"lasers": {"a": {"axis": "x", "input": "AIN0", "range_V": 1.0}}}, "range of the input"),
        ({"lasers": {"a": {"axis": "x", "input": "AIN0", "range_V": 5.0}}}, "expected one of 10.0, 1.0"),
        ({"lasers": {"a": {"axis": "x", "input": "AIN14"}}}, "input"),
        ({"tacho": {"input": "CIO0"}}, "input"),
    ],
)
def test_settings_that_are_impossible_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        settings(**wrong)


# --- the device -------------------------------------------------------------------------------------------------------


def bench_of(example: Mapping[str, Any] | None = None) -> tuple[DriverBench, SimulatedLabJack]:
    bench = DriverBench(_driver(dict(example or {"lasers": LASERS, "tacho": {"input": "AIN2"}})))
    assert isinstance(bench.far, SimulatedLabJack)
    return bench, bench.far


def opened(example: Mapping[str, Any] | None = None) -> tuple[DriverBench, SimulatedLabJack]:
    bench, far = bench_of(example)
    bench.begin()
    return bench, far


def _driver(table: dict[str, Any]) -> Driver:
    return replace(DRIVER, example=table)


def _cases(driver: Driver) -> list[Any]:
    """Without those that take long and do not depend on the settings."""
    others = [case for case in rig_testing.cases(driver) if "mutations" not in case.name and "wrap" not in case.name]
    return [pytest.param(case, marks=[thorough] if case.name in LONG else []) for case in others]


@pytest.mark.parametrize(
    "case",
    [
        *_cases(_driver({"lasers": LASERS, "tacho": {"input": "FIO2", "edge": "falling"}})),
        *_cases(
            _driver(
                {
                    "lasers": {"far": {"axis": "y", "input": "AIN5", "near_V": 10.0, "far_V": 2.0, "witness": "far"}},
                    "tacho": {"input": "AIN0", "edge": "falling", "threshold_V": 1.0},
                    "scan_rate_Hz": 1000.0,
                }
            )
        ),
    ],
    ids=str,
)
def test_contract(case: rig_testing.ContractCase) -> None:
    case()


def test_a_stream_that_runs_at_the_opening_is_ended_first() -> None:
    bench, far = opened()
    assert far.facts()["streaming"]
    assert bench.poller is not None
    bench.poller.stop()
    bench.begin()
    bench.clock.wait(0.5)
    assert len(numbers(bench.items)) == pytest.approx(2000, abs=60)
    refused = far.receive(wire.request(9, [wire.write(wire.Register.STREAM_SCAN_RATE_HZ, bytes(4))]))
    detail = far.receive(wire.request(10, [wire.read(wire.Register.LAST_ERROR, 1)]))
    assert refused[7:] == b"\xcc\x04"
    assert int.from_bytes(detail[-2:], "big") == wire.Status.STREAM_IS_ACTIVE


@pytest.mark.parametrize("lacks", [(), (4014, 4024, 48005)], ids=["all registers", "a device without some"])
def test_what_an_earlier_program_left_is_undone(lacks: tuple[int, ...]) -> None:
    """An earlier program had a stream that waits for a trigger, and the line of the tachometer as an output."""

    class Used(SimulatedLabJack):
        written: ClassVar[list[int]] = []

        def _write(self, address: int, data: bytes) -> None:
            self.written.append(address)
            super()._write(1 if address in lacks else address, data)

    bench, far = bench_of({"lasers": LASERS, "tacho": {"input": "EIO3"}})
    trigger, output = wire.write(4024, struct.pack(">I", 2000)), wire.write(2011, b"\0\0")
    far.receive(wire.request(1, [output] if lacks else [output, trigger]))
    assert far.facts()["outputs"] == [11]
    far.__class__ = type("Own", (Used,), {})
    bench.begin()
    bench.clock.wait(2.0)
    assert {4014, 4024, 48005} < {*Used.written}
    assert len(numbers(bench.items)) > 7000
    assert far.facts()["outputs"] == []


def test_the_identity_has_what_the_samples_need() -> None:
    bench, _ = opened()
    identity = bench.identity
    assert (identity["model"], identity["firmware"], identity["scan_rate_Hz"]) == ("T7", 1.0299, 4000.0)
    assert identity["AIN0_zero"] == 33530.0
    assert identity["constants"] == "from its flash"


def test_another_serial_number_is_refused() -> None:
    bench, far = opened({"lasers": LASERS, "serial": 470_012_345})
    assert bench.identity["device_serial"] == 470_012_345
    far.fail("other", 470_099_999)
    with pytest.raises(DeviceError, match=r"470012345.*470099999"):
        bench.begin()


def test_a_blank_flash_gives_nominal_constants_and_a_note() -> None:
    bench, far = bench_of()
    far.fail("blank")
    bench.begin()
    assert bench.identity["AIN0_zero"] == 33523.0
    assert bench.identity["constants"].startswith("nominal for AIN0, AIN1, AIN2: the constants")
    assert "AIN0, AIN1, AIN2 are nominal" in bench.identity["warning"]
    for identity, passed in ((bench.identity, False), ({"constants": "from its flash"}, True)):
        own = settings(tacho={"input": "AIN2"})
        check = DRIVER.checks(own, DRIVER.pipeline("lab", own, identity), None, [])["scales"]
        assert (check.passed, bool(check.note)) == (passed, not passed)


class Fixed(SimulatedLabJack):
    """A device with registers of the test's own."""

    own: ClassVar[dict[int, bytes | None]] = {}

    def _read(self, address: int, count: int) -> bytes:
        if address in self.own:
            value = self.own[address]
            return super()._read(1, count) if value is None else value
        return super()._read(address, count)


@pytest.mark.parametrize(
    ("own", "table", "words"),
    [
        ({60000: struct.pack(">f", 8.0)}, {"lasers": LASERS}, "T4 or T7, got product 8"),
        ({60000: struct.pack(">f", 4.0)}, {"lasers": {"a": {"axis": "x", "input": "AIN4"}}}, "T4"),
        ({60000: b""}, {"lasers": LASERS}, "expected product"),
        ({60028: None}, {"lasers": LASERS}, "refuses"),
        ({60000: struct.pack(">f", 4.0)}, {"lasers": LASERS, "tacho": {"input": "FIO3"}}, "no FIO3"),
        ({60028: None, 55000: struct.pack(">H", 2605)}, {"lasers": LASERS}, "which another program owns"),
        ({60028: None, 55000: struct.pack(">H", 2608)}, {"lasers": LASERS}, "Lower scan_rate_Hz"),
        ({60028: None, 55000: struct.pack(">H", 9999)}, {"lasers": LASERS}, "error 9999, look it up"),
        ({4002: struct.pack(">f", 3000.0)}, {"lasers": LASERS}, "3000"),
    ],
)
def test_a_device_that_does_not_fit_is_refused(own: dict[int, bytes | None], table: dict[str, Any], words: str) -> None:
    bench, far = bench_of(table)
    far.__class__ = type("Own", (Fixed,), {"own": own})
    with pytest.raises(DeviceError, match=words):
        bench.begin()


def test_a_flash_that_cannot_be_read_gives_nominal_constants() -> None:
    bench, far = bench_of()
    far.__class__ = type("Own", (Fixed,), {"own": {61812: None}})
    bench.begin()
    assert "cannot be read" in bench.identity["constants"]


def test_a_device_without_an_answer_is_an_error_at_its_stop() -> None:
    bench, far = opened()
    far.fail("deaf")
    with pytest.raises(DeviceError, match="no answer"):
        bench.end()


def test_an_overflow_is_reported_first_then_counted_exactly() -> None:
    """The device is not read for two seconds: its buffer of 1.4 s overflows."""
    bench, far = opened()
    bench.clock.wait(1.0)
    far.fail("deaf", 1)
    bench.clock.wait(2.0)
    far.fail("deaf", 0)
    bench.clock.wait(3.0)
    found = numbers(bench.items)
    missing = sum(b - a - 1 for a, b in pairwise(found))
    assert missing == bench.pipeline.losses["samples"] > 1000
    assert [event.kind for event in events(bench.items)] == ["backlog", "backlog", "gap"]
    times = np.concatenate([batch.time_ns for batch in batches(bench.items, "laser/x")])
    late_ms = (times - START) * 1e-6 - np.array(found) * 0.25
    assert abs(late_ms[-1] - late_ms[3000]) < 1.0


def test_samples_that_wait_are_read_at_once() -> None:
    """The device is not read for a second: 4000 scans wait, which are 68 answers."""
    bench, far = opened()
    bench.clock.wait(1.0)
    far.fail("deaf", 1)
    bench.clock.wait(1.0)
    assert far.facts()["backlog_bytes"] > 20_000
    far.fail("deaf", 0)
    bench.clock.wait(0.6)
    assert far.facts()["backlog_bytes"] < 1_000
    assert bench.pipeline.losses["samples"] == 0


@pytest.mark.parametrize("scans", [1, 50, 5000])
def test_scans_that_the_device_skips_are_counted_exactly(scans: int) -> None:
    bench, far = opened()
    bench.clock.wait(0.5)
    far.fail("skips", scans)
    bench.clock.wait(0.5)
    found = numbers(bench.items)
    assert sum(b - a - 1 for a, b in pairwise(found)) == bench.pipeline.losses["samples"] >= scans


class OneRefusal(SimulatedLabJack):
    """A device that refuses its first stream read after the opening, but continues its stream."""

    refuses: ClassVar[bool] = True

    def _read(self, address: int, count: int) -> bytes:
        if address == 4500 and type(self).refuses:
            type(self).refuses = False
            return super()._read(1, count)  # no such register
        return struct.pack(">H", 2501) if address == 55000 else super()._read(address, count)


def test_the_host_reads_the_error_of_a_refused_read_and_continues() -> None:
    bench, far = opened()
    far.__class__ = type("Own", (OneRefusal,), {})
    bench.clock.wait(1.0)
    assert [event.kind for event in events(bench.items) if event.kind != "reply"] == ["refused", "refused"]
    assert "error 2501" in events(bench.items, "refused")[1].text
    assert bench.pipeline.losses == {"samples": 0, "bytes": 0, "refused": 1, "invalid": 0}
    assert numbers(bench.items)[-1] > 3800


def test_a_scan_overlap_and_a_power_failure_end_in_a_fault() -> None:
    for fault in ("overlap", "power"):
        bench, far = opened()
        bench.clock.wait(0.3)
        if fault == "overlap":
            far.fail("overlap")
        else:
            far.power(False, bench.clock.now_s())
            far.power(True, bench.clock.now_s())
        bench.clock.wait(0.3)
        assert events(bench.items, "fault"), fault
        assert bench.pipeline.losses["refused"] > 0


def test_blocked_beams_are_no_samples() -> None:
    bench, far = opened()
    far.fail("blocked")
    bench.clock.wait(0.5)
    last = batches(bench.items, "laser/x")[-1]
    assert np.isnan(last.columns["displacement_m"]).all()
    with pytest.raises(ValueError, match="no fault"):
        far.fail("unknown")


@pytest.mark.parametrize(
    "identity",
    [
        {"model": "U3"},
        {"AIN0_zero": "x"},
        {"AIN0_zero": 33500.0, "AIN0_above_V": 5.0},
        {"firmware": "x"},
        {"device_serial": -1},
    ],
)
def test_an_impossible_identity_is_refused(identity: dict[str, Any]) -> None:
    with pytest.raises(LogError):
        DRIVER.played(settings(), identity)
    if "AIN0_zero" in identity:
        with pytest.raises(DeviceError):
            Reads(identity)


def test_marks_have_the_usual_channel() -> None:
    assert DRIVER.occasional(settings()) == ()
    assert DRIVER.occasional(settings(tacho={"input": "AIN2"})) == (TACHO,)


RIG = """
[devices.lab]
driver = "labjack"
port = "p"

[devices.lab.lasers.east]
axis = "x"
input = "AIN0"

[devices.lab.lasers.north]
axis = "y"
input = "AIN1"

[devices.lab.tacho]
input = "AIN2"

"""


OWN = ["virtual.seed=4", "devices.encoder.index_marks=false"]


def rig_file(folder: Path) -> Path:
    """Write the rig file of a rig that is turned by hand, with a LabJack in place of its lasers."""
    file = folder / "rig.toml"
    usual = (resources.files("rig_configs") / "by_hand.toml").read_text()
    before, after = usual.index("[devices.laser_x]"), usual.index("[devices.encoder]")
    file.write_text(usual[:before] + RIG + usual[after:])
    return file


def test_a_session_measures_displacements_and_marks_with_one_device(tmp_path: Path) -> None:
    """The node measures the angles alone. Marks and displacements have one clock, fitted to the displacements."""
    file, own = rig_file(tmp_path), OWN
    sim = LockstepRig(load_rig(file, settings=own))
    session = Session(load_rig(file, settings=[*own, *sim.port_settings()]), sim.clock, edge=sim.edge)
    sim.ask("turn", rpm=200.0, ramp_rpm_per_s=400.0)
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.clock.wait(4.0)
        session.stop_recording({})
        sim.ask("turn", rpm=0.0, ramp_rpm_per_s=400.0)
        sim.clock.wait(8.0)
    log = tmp_path / "a.mcap"
    assert [row.topic for row in check(log) if row.difference] == []
    with open_log(log) as opened:
        assert len(opened["laser/y"].time_ns) == pytest.approx(16_000, abs=200)
    run = load_run(log)
    assert len(run.mark_time_s) == pytest.approx(4.0 * 200.0 / 60.0, abs=2.5)
    virtual = load_rig(file, settings=own).virtual
    assert virtual is not None
    assert np.diff(run.mark_time_s[3:]) == pytest.approx(60.0 / 200.0 / (1 - virtual.drive.slip), abs=2e-5)
    assert run.clock_rate_std["phase"] == run.clock_rate_std["x"] != run.clock_rate_std["angles"]


def test_a_device_that_lost_power_is_started_again_and_its_gap_is_counted(tmp_path: Path) -> None:
    """The dialogue ends the stream while the session would poll it. The log continues, with the scans of the outage."""
    sim = LockstepRig(load_rig(rig_file(tmp_path), settings=OWN))
    session = Session(load_rig(rig_file(tmp_path), settings=[*OWN, *sim.port_settings()]), sim.clock, edge=sim.edge)
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.clock.wait(1.0)
        sim.ask("fail", device="lab", what="deaf", value=1, seconds=3.0)
        end = sim.clock.now_s() + 8.0
        while sim.clock.now_s() < end:
            session.check()
            sim.clock.wait(0.05)
        session.stop_recording({})
    log = tmp_path / "a.mcap"
    assert [row.topic for row in check(log) if row.difference] == []
    with open_log(log) as opened:
        found = opened["laser/x"]
        (gap,) = [event for event in opened.events if (event["kind"], event["device"]) == ("gap", "lab")]
        assert "started again" in gap["text"]
        steps = np.diff(found.time_ns) * 1e-9
        assert gap["samples"] == int(np.max(np.diff(found.sequence.astype(np.int64)))) - 1
        assert gap["samples"] / 4000.0 == pytest.approx(float(np.max(steps)), abs=0.01)
        assert float(np.max(steps)) > 2.0
        assert (opened.end_ns - found.time_ns[-1]) * 1e-9 < 0.2
