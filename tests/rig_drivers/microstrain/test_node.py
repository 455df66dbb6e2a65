"""MicroStrain nodes: packets of the base station, order and time of the sweeps, dialogue, and a session in lockstep."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.drivers.identification import FoundDevice
from daq.errors import DeviceError, LogError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.log import open_log
from daq.replay import check
from daq.signals.run import load_run
from rig_drivers.microstrain import wire
from rig_drivers.microstrain.dialogue import identity_turns
from rig_drivers.microstrain.driver import DRIVER
from rig_drivers.microstrain.far_end import PlayedMicroStrain, SimulatedMicroStrain
from rig_drivers.microstrain.framing import PacketSearch
from rig_drivers.microstrain.rates import BASE_ADDRESS
from rig_drivers.microstrain.settings import MicroStrainNode
from rig_drivers.microstrain.stream import MicroStrainPipeline
from rig_drivers.microstrain.wire import Version
from rig_testing.bench import DriverBench
from rig_testing.subject import together
from tests.daq.kit_cases import kit_cases
from tests.daq.simulated_sessions import recorded_at_rest

NODE, RATE_HZ, UTC_S, S = 307, 256, 1_700_000_000, 1_000_000_000
RATE_CODE = 105


def settings(**more: Any) -> MicroStrainNode:
    return MicroStrainNode.model_validate({"driver": "microstrain", "port": "p", "node_address": NODE, **more})


def pipeline(identity: dict[str, Any] | None = None, **more: Any) -> MicroStrainPipeline:
    return MicroStrainPipeline("node", settings(**more), identity or {})


def packet(kind: int, payload: bytes, address: int = NODE, version: int = 3, base_rssi: int = -61) -> bytes:
    """A packet from the base station, by the layouts of the maker's library."""
    if version == 1:
        body = struct.pack(">BBHB", 7, kind, address, len(payload)) + payload
        return b"\xaa" + body + struct.pack(">bbH", -49, base_rssi, sum(body))
    body = struct.pack(">BBBIH", 0xAC, 8, kind, address, len(payload)) + payload + struct.pack(">bb", -49, base_rssi)
    return body + struct.pack(">I", zlib.crc32(body))


def sweeps(number: int, codes: list[tuple[int, int]], tick: int | None = None, late_s: int = 0, **more: Any) -> bytes:
    """A packet whose first sweep has a number on the beacon's grid."""
    after_ns = round(number * 1e9 / RATE_HZ)
    head = struct.pack(
        ">IHBBH", 0, more.get("mask", 3), more.get("rate", RATE_CODE), 7, (number if tick is None else tick) % 65536
    )
    head += struct.pack(">Q", (UTC_S + late_s) * S + after_ns)
    payload = head + struct.pack(f">{2 * len(codes)}H", *(v for pair in codes for v in pair))
    return packet(0x1A, payload, base_rssi=more.get("base_rssi", -61))


def status(utc_ns: int, is_on: bool = True) -> bytes:
    return packet(0x31, struct.pack(">HBII", 0xBEAD, is_on, utc_ns // S, utc_ns % S), 0x1234)


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


def thetas(items: list[Batch | DeviceEvent]) -> list[float]:
    whole = together(items, "pendulums")
    return [] if whole is None else whole.columns["theta3_rad"].tolist()


# --- packets -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "kind", "address", "payload"),
    [
        ("AA 00 00 00 01 03 0D 00 00 00 00 00 11", 0x00, 1, "0D0000"),
        ("AA 07 04 00 01 08 02 01 70 03 00 00 00 00 00 00 00 8A", 0x04, 1, "0201700300000000"),
        ("AA 07 02 01 6F 02 00 00 00 00 00 7B", 0x02, 367, "0000"),
    ],
)
def test_the_packets_of_the_maker_s_tests_are_found(data: str, kind: int, address: int, payload: str) -> None:
    found = PacketSearch(1).feed(bytes.fromhex(data))
    assert found.packets == [wire.Packet(kind, address, bytes.fromhex(payload), 0, 0)]
    assert found.skipped_bytes == 0
    damaged = bytes.fromhex(data)[:-1] + b"\x02"
    assert PacketSearch(1).feed(damaged).packets == []


def test_requests_are_those_of_the_maker() -> None:
    assert wire.request(1, 123, wire.START_SYNC) == bytes.fromhex("AA 05 00 00 7B 02 00 3B 00 BD")
    assert wire.request(1, 0x1234, wire.PING) == bytes.fromhex("AA 0E 30 12 34 02 00 01 00 87")
    assert wire.request(1, 0x1234, wire.SET_TO_IDLE, wire.node_bytes(1, 123))[6:10] == bytes.fromhex("0091 007B")
    ping = wire.request(3, 0x1234, wire.PING)
    assert ping[:-4] == bytes.fromhex("AC 01 30 00 00 12 34 00 02 00 01 7F 7F")
    assert ping[-4:] == zlib.crc32(ping[:-4]).to_bytes(4, "big")
    start = wire.request(3, 123, wire.START_SYNC)
    assert start[:-4] == bytes.fromhex("AC 04 00 00 00 00 7B 00 02 00 3B 7F 7F")


@pytest.mark.parametrize(
    ("mode_and_type", "data", "values"),
    [
        (0x12, "00000000 3F800000", [0.0, 1.0]),
        (0x18, "7F800001", [math.nan]),
        (0x23, "00FE", [254.0]),
        (0x21, "00FE", [127.0]),
        (0x29, "FDDF5E", [16637790.0]),
        (0x2A, "B7FF", [188412.0]),
        (0x24, "00010000", [65536.0]),
        (0x2B, "FF8CCF 007331", [-29489.0, 29489.0]),
        (0x2C, "FFFF", [-64.0]),
        (0x2E, "0001", [256.0]),
        (0x2F, "FFF6", [-1.0]),
    ],
)
def test_values_of_every_type_are_read(mode_and_type: int, data: str, values: list[float]) -> None:
    """The first ones are vectors of the maker's tests."""
    payload = bytes.fromhex(f"0001 70 {mode_and_type:02X} 0001 6553F100 3B9AC9FF {data}")
    found = wire.parse_sweeps(payload, 1)
    assert found.values[:, 0].tolist() == pytest.approx(values, nan_ok=True)
    assert (found.rate_code, found.tick, found.channels) == (112, 1, (1,))
    assert found.time_ns == 0x6553F100 * S + 999_999_999


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        ("0001 70 32 0001 00000000 00000000 00000000", "sampling mode"),
        ("0001 70 26 0001 00000000 00000000 00000000", "data type"),
        ("0000 70 22 0001 00000000 00000000 00000000", "channels"),
        ("0001 70 22 0001 00000000 3B9ACA00 00000000", "ns of a second"),
        ("0001 70 22 0001 00000000 00000000 0000", "sweeps of 4 bytes"),
        ("0001 70 22 0001 00000000 00000000", "more than 14 bytes"),
    ],
)
def test_impossible_content_is_refused(payload: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        wire.parse_sweeps(bytes.fromhex(payload), 1)
    with pytest.raises(ValueError, match="2116"):
        wire.parse_sweeps(bytes(4) + bytes.fromhex("0001 70 02 0001") + b"\xff" * 8 + bytes(4), 3)


@given(st.binary(max_size=60), st.sampled_from([1, 3]))
def test_any_content_of_an_intact_packet_is_decoded(payload: bytes, version: wire.Version) -> None:
    line = pipeline(aspp=version)
    for kind in (0x1A, 0x31, 0x18, 0x00):
        line.feed(RX, packet(kind, payload, version=version) + packet(kind, payload, 0x1234, version), S)


# --- order, losses, time -----------------------------------------------------------------------------------------


def test_angles_follow_slope_and_offset() -> None:
    line = pipeline(slope_a_rad=-0.001, offset_a_rad=0.5, turns=False, counts_per_revolution=6283)
    (batch,) = line.feed(RX, sweeps(0, [(100, 0), (500, 16384)]), 5 * S)
    assert isinstance(batch, Batch)
    assert batch.columns["theta3_rad"] == pytest.approx([0.4, 0.0])
    assert batch.columns["theta4_rad"] == pytest.approx([0.0, math.pi / 2])
    assert batch.columns["count_a"].tolist() == [400, 0]
    assert batch.columns["node_time_us"].tolist() == [UTC_S * 1_000_000, UTC_S * 1_000_000 + 3906]
    assert batch.time_ns.tolist() == [5 * S - 3906250, 5 * S]
    assert line.losses == {"samples": 0, "damaged_packets": 0, "bytes": 0, "foreign_packets": 0}


@pytest.mark.parametrize("code", [10, 32_000, 33_000, 65_500])
def test_the_first_angle_is_within_half_a_turn_of_the_lock(code: int) -> None:
    (batch,) = pipeline().feed(RX, sweeps(0, [(code, code)]), S)
    assert isinstance(batch, Batch)
    step = 2 * math.pi / 65536
    assert batch.columns["theta3_rad"] == pytest.approx([step * (code if code < 32_768 else code - 65_536)])
    assert batch.columns["theta4_rad"] == pytest.approx([step * code])


def test_a_packet_on_air_again_gives_no_samples_and_is_no_loss() -> None:
    line = pipeline()
    first, second = sweeps(0, [(1, 1)] * 4), sweeps(4, [(2, 2)] * 4)
    assert len(thetas(line.feed(RX, first + first + second + first, S))) == 8
    assert line.feed(RX, second, S) == []
    assert not any(line.losses.values())


def test_missing_sweeps_are_counted_exactly_even_over_a_wrap_of_the_tick() -> None:
    line = pipeline()
    line.feed(RX, sweeps(65530, [(1, 1)] * 4), S)
    assert kinds(line.feed(RX, sweeps(65534, [(1, 1)] * 4), S)) == []
    assert line.feed(RX, sweeps(65540, [(1, 1)], base_rssi=-80), 2 * S) == []  # it waits for those before it
    gap, batch = line.feed(RX, b"", 3 * S)
    assert isinstance(gap, DeviceEvent)
    assert isinstance(batch, Batch)
    assert (gap.kind, gap.facts["samples"], gap.facts["time_ns"]) == ("gap", 2, int(batch.time_ns[0]))
    assert gap.facts["rssi_dBm"] == -80
    assert batch.sequence.tolist() == [10]
    many = 65541 + 3 * 65536 + 17
    gap, _ = line.feed(RX, sweeps(many, [(1, 1)]), 800 * S)
    assert isinstance(gap, DeviceEvent)
    assert gap.facts["samples"] == 3 * 65536 + 17
    assert line.losses["samples"] == 2 + 3 * 65536 + 17


def test_a_late_packet_gives_no_samples() -> None:
    line = pipeline()
    for number in (0, 8):
        line.feed(RX, sweeps(number, [(number, 1)] * 4), S)
    line.feed(RX, status(UTC_S * S), 2 * S)
    assert line.losses["samples"] == 4
    assert line.feed(RX, sweeps(4, [(4, 1)] * 4), 2 * S) == []
    assert len(thetas(line.feed(RX, sweeps(10, [(5, 1)] * 4), 2 * S))) == 2  # of which two have come before
    assert line.losses["samples"] == 4


def test_a_node_or_beacon_that_starts_again_is_reported() -> None:
    line = pipeline()
    line.feed(RX, sweeps(1000, [(1, 1)] * 4), S)
    assert kinds(line.feed(RX, sweeps(2000, [(1, 1)] * 4, tick=0), 5 * S)) == ["restart"]
    assert kinds(line.feed(RX, sweeps(2004, [(1, 1)] * 4, tick=4), 5 * S)) == []
    found = line.feed(RX, sweeps(0, [(1, 1)] * 4, late_s=-100), 6 * S)
    assert kinds(found) == ["restart"]
    assert [int(item.time_ns[-1]) for item in found if isinstance(item, Batch)] == [6 * S]
    found = line.feed(RX, sweeps(0, [(1, 1)] * 4, late_s=100_000), 7 * S)
    assert "beacon's time was set" in "".join(item.text for item in found if isinstance(item, DeviceEvent))
    assert kinds(line.feed(RX, packet(0x18, bytes(8)), 8 * S)) == ["restart"]
    assert line.losses["samples"] == 0


def test_the_beacon_s_answers_give_the_times_without_the_delay_of_the_radio() -> None:
    """Its time at the host is 3 s later, and every packet is 80 ms late."""
    line = pipeline({"beacon_lag_ns": 3 * S})
    for second in range(20):
        line.feed(RX, status((UTC_S + second) * S), (UTC_S + second + 3) * S)
        for part in range(32):
            number = 256 * second + 8 * part
            due_ns = UTC_S * S + round((number + 7) * S / RATE_HZ) + 3 * S
            found = line.feed(RX, sweeps(number, [(1, 1)] * 8), due_ns + 80_000_000)
            (batch,) = [item for item in found if isinstance(item, Batch)]
            assert abs(int(batch.time_ns[-1]) - due_ns) < 20_000
    assert line.status.clock_seed is not None


@pytest.mark.parametrize(("later_ns", "used"), [(0, True), (60 * S, True), (60 * S + 1, False)])
def test_the_answer_of_a_beacon_that_is_on_is_used_for_a_minute(later_ns: int, used: bool) -> None:
    line, at_ns = pipeline(), (UTC_S + 3) * S
    line.feed(RX, status(UTC_S * S), at_ns)
    line.feed(RX, status(0, is_on=False), at_ns)
    *doubt, batch = line.feed(RX, sweeps(0, [(1, 1)]), at_ns + later_ns)
    assert isinstance(batch, Batch)
    assert batch.time_ns.tolist() == [at_ns if used else at_ns + later_ns]
    assert kinds(doubt) == ([] if used else ["doubt"])


def test_an_answer_of_more_than_a_minute_ago_is_not_used() -> None:
    """Without answers a sample has the time of its arrival, here 50 ms after the beacon's time."""
    line, off_ns = pipeline({"beacon_lag_ns": 3 * S}), list[int]()
    for part in range(400):
        due_ns = UTC_S * S + part * S // 4 + 3 * S
        found = line.feed(RX, sweeps(64 * part, [(1, 1)]), due_ns + 50_000_000)
        off_ns += [int(batch.time_ns[-1]) - due_ns for batch in found if isinstance(batch, Batch)]
    assert np.abs(off_ns[:240]).max() < 20_000
    assert off_ns[-1] == pytest.approx(50_000_000, abs=100_000)
    line = pipeline()
    (batch,) = line.feed(RX, sweeps(0, [(1, 1)]), 9 * S)
    assert isinstance(batch, Batch)
    assert batch.time_ns.tolist() == [9 * S]


def test_a_beacon_that_is_off_is_reported_once() -> None:
    line = pipeline()
    assert kinds(line.feed(RX, status(UTC_S * S), UTC_S * S)) == ["reply"]
    assert kinds(line.feed(RX, status(UTC_S * S), UTC_S * S)) == []
    assert kinds(line.feed(RX, status(0, is_on=False), UTC_S * S)) == ["restart"]
    assert "beacon is off" in line.status.set_up_lost
    assert kinds(line.feed(RX, status(0, is_on=False), UTC_S * S)) == []
    line.feed(RX, status(UTC_S * S), UTC_S * S)
    assert line.status.set_up_lost == ""


def test_a_beacon_that_the_host_switches_off_is_no_fault_and_its_next_state_is_a_reply() -> None:
    """The device is opened again during a recording; the queries of the beacon continue meanwhile."""
    line = pipeline()
    line.feed(RX, status(UTC_S * S), UTC_S * S)
    line.feed(RX, packet(0x31, bytes.fromhex("beac ffffffff"), 0x1234), UTC_S * S)
    assert kinds(line.feed(RX, status(0, is_on=False), UTC_S * S)) == ["reply"]
    assert kinds(line.feed(RX, status(0, is_on=False), UTC_S * S)) == []
    line.feed(RX, packet(0x31, bytes.fromhex("beac") + UTC_S.to_bytes(4, "big"), 0x1234), UTC_S * S)
    assert kinds(line.feed(RX, status(UTC_S * S), UTC_S * S)) == ["reply"]
    assert kinds(line.feed(RX, status(0, is_on=False), UTC_S * S)) == ["restart"]


def test_an_answer_of_another_node_is_not_taken() -> None:
    line = pipeline()
    answer = packet(0x31, struct.pack(">HBII", 0xBEAD, 1, UTC_S, 0), 308)
    assert kinds(line.feed(RX, answer, UTC_S * S)) == ["foreign"]
    assert kinds(line.feed(RX, status(UTC_S * S), UTC_S * S)) == ["reply"]


def test_values_that_are_not_numbers_are_flagged() -> None:
    line = pipeline(quantities={"supply_V": 4})
    head = struct.pack(">IHBBHQ", 0, 0b1011, RATE_CODE, 2, 0, UTC_S * S)
    data = struct.pack(">9f", math.nan, 1.0, 3.3, 16384.0, math.inf, 3.4, 1e30, 2.0, 3.5)
    pendulums, node = line.feed(RX, packet(0x1A, head + data), S)
    assert isinstance(pendulums, Batch)
    assert isinstance(node, Batch)
    assert np.isnan(pendulums.columns["theta3_rad"]).tolist() == [True, False, True]
    assert pendulums.columns["theta3_rad"][1] == pytest.approx(math.pi / 2)
    assert pendulums.columns["flags"].tolist() == [1, 2, 1]
    assert node.channel.topic == "node"
    assert node.columns["supply_V"] == pytest.approx([3.3, 3.4, 3.5])


def test_written_bytes_are_not_decoded_and_damage_is_counted() -> None:
    line = pipeline()
    good = sweeps(0, [(1, 1)])
    assert line.feed(TX, good, S) == []
    assert kinds(line.feed(RX, good, S)) == []
    assert kinds(line.feed(RX, good[:10] + sweeps(1, [(1, 1)]), S)) == ["damage"]
    assert line.losses["bytes"] == 10
    assert line.base_rssi_dBm == -61


# --- settings, dialogue, far end ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"rate_Hz": 250}, "the nearest are 256"),
        ({"channel_b": 1}, "each pendulum has its own sensor"),
        ({"slope_a_rad": 0}, "other than 0"),
        ({"aspp": 1, "node_address": 70_000}, "at most 65534"),
        ({"node_address": 0x1234}, "every base station"),
        ({"serial": "12"}, "serial"),
        ({"quantities": {"Bad name": 3}}, "quantities"),
    ],
)
def test_impossible_settings_are_refused(more: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        settings(**more)


def test_a_serial_number_is_kept_in_the_maker_s_form() -> None:
    assert settings(serial="6305-0-7").serial == "6305-0000-00007"


# Words of 16 bits that repeat with each revolution; whole turns are not known after a loss.
_ONE_TURN = replace(
    DRIVER,
    example={"node_address": 307, "rate_Hz": 512, "quantities": {"supply_V": 5}},
    claims=frozenset({"counts exactly", "falls silent"}),
)


# The sum of 16 bits does not detect exchanged bytes.
_OLD = replace(
    DRIVER,
    example={"node_address": 9, "aspp": 1, "slope_a_rad": -0.01745, "slope_b_rad": 0.01745},
    claims=frozenset({"counts exactly", "falls silent"}),
)


@pytest.mark.parametrize("case", kit_cases((_ONE_TURN, _OLD)))
def test_other_settings_pass_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


@pytest.mark.parametrize(
    ("fault", "value", "words"),
    [
        ("deaf", 1, "no base station answers a ping"),
        ("dead", 1, "did not become idle"),
        ("radio", 1, "did not become idle"),
        ("rate", 106, "node 307 is set to 128"),
    ],
)
def test_a_node_that_cannot_be_opened_is_explained(fault: str, value: int, words: str) -> None:
    bench = DriverBench(DRIVER)
    bench.far.fail(fault, value)
    with pytest.raises(DeviceError, match=words):
        bench.begin()


def test_another_node_than_the_rig_file_s_is_refused() -> None:
    bench = DriverBench(DRIVER)
    bench.settings = bench.settings.model_copy(update={"serial": "6305-1000-48211"})
    bench.begin()
    assert bench.identity["serial"] == "6305-1000-48211"
    assert bench.identity["firmware"] == "12.5"
    bench.end()
    bench.far.fail("serial", 9)
    with pytest.raises(DeviceError, match=r"serial number 6305-1000-00009, the rig file states 6305-1000-48211"):
        bench.begin()


def test_a_channel_that_is_not_active_and_a_refusal_are_explained() -> None:
    bench = DriverBench(DRIVER)
    assert isinstance(bench.far, SimulatedMicroStrain)
    bench.far.eeprom[12] = 1
    with pytest.raises(DeviceError, match="channel 2 of node 307 is not active"):
        bench.begin()
    del bench.far.eeprom[72]
    with pytest.raises(DeviceError, match="refuses command 0007h with code 1: no such place"):
        bench.begin()


def test_a_node_that_samples_is_stopped_and_opened_again() -> None:
    """As after a host that was killed."""
    bench = DriverBench(DRIVER)
    for _ in range(2):
        bench.begin()
        bench.clock.wait(1.0)
        assert together(bench.items, "pendulums") is not None
        assert not any(bench.pipeline.losses.values())


def test_a_stop_that_the_node_does_not_confirm_is_reported_and_ends_the_beacon() -> None:
    bench = DriverBench(DRIVER)
    bench.begin()
    bench.clock.wait(0.5)
    bench.far.fail("radio", 1)
    with pytest.raises(DeviceError, match="node 307 does not confirm that it is idle"):
        bench.end()
    assert isinstance(bench.far, SimulatedMicroStrain)
    assert not bench.far.streaming


@pytest.mark.parametrize(
    ("fault", "value", "kind", "count"),
    [
        ("foreign", 10, "foreign_packets", 10),
        ("repeats", 1, "", 0),
        ("open sensor", 1, "", 0),
        ("radio", 1, "samples", None),
    ],
)
def test_faults_of_the_simulated_node_reach_the_host(fault: str, value: int, kind: str, count: int | None) -> None:
    bench = DriverBench(DRIVER)
    bench.begin()
    bench.clock.wait(0.5)
    bench.far.fail(fault, value)
    bench.clock.wait(0.5)
    if fault == "radio":
        bench.far.fail(fault, 0)
    bench.clock.wait(0.5)
    whole = together(bench.items, "pendulums")
    assert whole is not None
    assert bool(np.any(whole.columns["flags"])) == (fault == "open sensor")
    losses = {name: number for name, number in bench.pipeline.losses.items() if number}
    assert set(losses) == ({kind} - {""})
    assert count is None or losses.get(kind, 0) == count
    steps = np.diff(whole.columns["node_time_us"].astype(np.int64))
    missing = int(np.rint(np.sum(steps) * 256e-6)) - len(steps)
    assert losses.get("samples", 0) == missing


def test_a_node_without_supply_starts_again_by_the_beacon_and_a_lost_beacon_is_a_restart() -> None:
    bench = DriverBench(DRIVER)
    bench.begin()
    bench.clock.wait(1.0)
    bench.far.power(False, bench.motion.time_s)
    bench.clock.wait(1.0)
    bench.far.power(True, bench.motion.time_s)
    bench.clock.wait(1.0)
    assert kinds(bench.items).count("restart") == 2  # it reports its start, and its ticks begin again
    bench.far.fail("beacon", 1)
    bench.clock.wait(2.0)
    *_, restart = [i for i in bench.items if isinstance(i, DeviceEvent) and i.kind == "restart"]
    assert "beacon is off" in restart.text


def test_requests_in_any_pieces_and_after_noise_are_answered() -> None:
    far = SimulatedMicroStrain.unmoved(settings(aspp=1), 6305, 1000, 7)
    answer = b""
    for byte in b"\xaa\x00\x00" + bytes(9) + wire.request(1, 0x1234, wire.PING):
        answer += far.receive(bytes([byte]), 0.0)
    assert answer == packet(0x31, b"\x00\x01", 0x1234, 1)
    assert far.receive(wire.request(1, 0x1234, wire.BASE_READ, b"\x00\x63"), 0.0)[2] == 0x32
    assert far.receive(wire.request(1, 308, wire.START_SYNC), 0.0) == b""
    with pytest.raises(ValueError, match="no fault 'x'"):
        far.fail("x")


@pytest.mark.parametrize("serial", ["a", "1-2", "1-2-x", "70000-1-1"])
def test_an_impossible_identity_cannot_be_played(serial: str) -> None:
    with pytest.raises(LogError, match="serial"):
        PlayedMicroStrain(settings(), {"serial": serial})


def test_a_played_node_that_is_only_listened_to_sends() -> None:
    played = PlayedMicroStrain(settings(), {})
    assert not played.sending
    played.begin()
    assert played.sending


# --- a session ---------------------------------------------------------------------------------------------------

NODES = """
[devices.angles]
driver = "microstrain"
port = "p"
node_address = 307
rate_Hz = 512
"""


def test_a_rig_has_its_angles_from_this_node_and_its_marks_from_another_device(tmp_path: Path) -> None:
    """Each signal has the clock of its device; decoding the log's bytes gives the same samples again."""
    file = tmp_path / "rig.toml"
    text = (resources.files("rig_configs") / "by_hand.toml").read_text()
    file.write_text(text.replace("locks = false", "locks = false\nangles = false") + NODES)
    log = tmp_path / "a.mcap"
    roles = recorded_at_rest(file, log, ["virtual.seed=4"]).roles
    assert roles.angles is not None
    assert roles.phase is not None
    assert (roles.angles.device, roles.phase.device) == ("angles", "encoder")
    assert [row.topic for row in check(log) if row.difference] == []
    with open_log(log) as opened:
        found = opened["pendulums"]
    assert len(found.time_ns) + sum(load_run(log).losses.values()) == pytest.approx(4 * 512, abs=20)
    assert np.median(found["theta4_rad"]) == pytest.approx(math.pi, abs=0.01)
    assert load_run(log).clocks["angles"] == "angles"
    assert load_run(log).clocks["phase"] == "encoder"


BASE = 0x1234
STEP = 2 * math.pi / 65536
Items = list[Batch | DeviceEvent]


def only_batch(items: Items, topic: str = "pendulums") -> Batch:
    (batch,) = [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]
    return batch


def only_event(items: Items) -> DeviceEvent:
    (event,) = [item for item in items if isinstance(item, DeviceEvent)]
    return event


def shape(items: Items) -> list[str]:
    """The kinds of the events in their order, and "samples" for a batch."""
    return [item.kind if isinstance(item, DeviceEvent) else "samples" for item in items]


def floats(rows: list[tuple[float, ...]], mask: int = 3, tick: int = 0) -> bytes:
    """A packet of sweeps of floating-point numbers, one value for each channel of the mask."""
    after_ns = round(tick * 1e9 / 256)
    head = struct.pack(">IHBBHQ", 0, mask, RATE_CODE, 2, tick, UTC_S * S + after_ns)
    values = [value for row in rows for value in row]
    return packet(0x1A, head + struct.pack(f">{len(values)}f", *values))


def payload_of(data: bytes) -> bytes:
    return data[9:-6]


def test_further_quantities_are_those_of_their_channels() -> None:
    line = pipeline(quantities={"supply_V": 4, "hub_V": 6, "end_V": 5})
    items = line.feed(RX, floats([(1, 2, 4, 5, 6), (11, 12, 14, 15, 16)], mask=0b111011), S)
    columns = only_batch(items, "node").columns
    assert {name: column.tolist() for name, column in columns.items()} == {
        "supply_V": [4.0, 14.0],
        "hub_V": [6.0, 16.0],
        "end_V": [5.0, 15.0],
    }
    assert only_batch(items).columns["theta3_rad"] == pytest.approx([STEP, 11 * STEP])


def test_a_packet_as_set_up_ends_a_series_of_contradicting_ones() -> None:
    line, bad = pipeline(), sweeps(0, [(1, 1)], rate=106)
    found = [kinds(line.feed(RX, data, S)) for data in (bad, bad, sweeps(0, [(1, 1)]), bad, bad, bad, bad)]
    assert found == [["damage"], ["damage"], [], ["damage"], ["damage"], ["fault"], []]
    assert line.status.complaint
    assert len(thetas(line.feed(RX, sweeps(1, [(1, 1)]), S))) == 1
    assert line.status.complaint == ""
    assert line.losses == {"samples": 0, "damaged_packets": 6, "bytes": 0, "foreign_packets": 0}


def test_samples_before_a_gap_or_a_restart_come_before_its_event() -> None:
    four = [(1, 1)] * 4
    first = sweeps(1000, four)
    assert shape(pipeline().feed(RX, first + sweeps(1004, four), S)) == ["samples"]
    assert shape(pipeline().feed(RX, first + sweeps(2000, four, tick=0), S)) == ["samples", "restart", "samples"]
    assert shape(pipeline().feed(RX, first + sweeps(0, four, late_s=-100), S)) == ["samples", "restart", "samples"]
    line = pipeline()
    items = [*line.feed(RX, first + sweeps(1006, four), S), *line.feed(RX, status(UTC_S * S), 2 * S)]
    assert shape(items) == ["samples", "reply", "gap", "samples"]
    gap, after = items[2:]
    assert isinstance(gap, DeviceEvent)
    assert isinstance(after, Batch)
    assert gap.text == "2 samples lost (7.81 ms)"
    assert gap.facts == {"samples": 2, "span_s": 0.0078125, "time_ns": int(after.time_ns[0]), "rssi_dBm": -61}
    assert after.sequence.tolist() == [6, 7, 8, 9]
    assert shape(line.feed(RX, sweeps(1010, four), 2 * S)) == ["samples"]
    line.feed(RX, sweeps(1020, four, base_rssi=127), 2 * S)
    unknown = only_event(line.feed(RX, b"", 2 * S))
    assert (unknown.facts["samples"], "rssi_dBm" in unknown.facts, line.base_rssi_dBm) == (6, False, None)


def test_only_packets_of_samples_of_this_node_give_samples() -> None:
    line, payload = pipeline(), payload_of(sweeps(0, [(1, 1)]))
    for kind in (0x19, 0x1B):
        assert line.feed(RX, packet(kind, payload), S) == []
    assert not line.status.has_reported
    for address, kind in ((100, 0x1A), (308, 0x1A), (BASE + 1, 0x31), (BASE, 0x1A)):
        event = only_event(line.feed(RX, packet(kind, payload, address), S))
        assert (event.kind, event.facts) == ("foreign", {"node": address})
    answer = only_event(line.feed(RX, packet(0x22, b"\x00\x07", NODE), S))
    assert (answer.kind, answer.text) == ("reply", f"34 {NODE} {S} 0007")
    assert len(thetas(line.feed(RX, packet(0x1A, payload), S))) == 1
    assert line.status.has_reported


def test_the_first_state_of_the_beacon_is_a_reply_even_if_it_is_off() -> None:
    line = pipeline()
    off, on = status(0, is_on=False), status(UTC_S * S)
    event = only_event(line.feed(RX, off, 7 * S))
    assert (event.kind, event.text) == ("reply", f"49 {BASE} {7 * S} {payload_of(off).hex()}")
    assert [kinds(line.feed(RX, data, 8 * S)) for data in (off, on, on, off, off)] == [[], [], [], ["restart"], []]


@pytest.mark.parametrize(
    ("kind", "payload"),
    [(0x31, "0001"), (0x31, "beab ffffffff"), (0x32, "beac ffffffff"), (0x22, "beac ffffffff")],
)
def test_other_answers_are_replies_and_leave_the_beacon_s_state_known(kind: int, payload: str) -> None:
    line = pipeline()
    line.feed(RX, status(UTC_S * S), S)
    assert kinds(line.feed(RX, packet(kind, bytes.fromhex(payload), BASE), S)) == ["reply"]
    assert line.feed(RX, status(UTC_S * S), S) == []
    assert kinds(line.feed(RX, status(0, is_on=False), S)) == ["restart"]


def test_no_sample_is_later_than_its_arrival() -> None:
    line = pipeline({"beacon_lag_ns": 3 * S})
    early_ns = (UTC_S + 2) * S
    assert only_batch(line.feed(RX, sweeps(0, [(1, 1)]), early_ns)).time_ns.tolist() == [early_ns]
    for known in (True, "1", 1.0):
        line = pipeline({"beacon_lag_ns": known})
        assert only_batch(line.feed(RX, sweeps(0, [(1, 1)]), (UTC_S + 9) * S)).time_ns.tolist() == [(UTC_S + 9) * S]


def test_turns_continue_from_the_last_sample_of_a_packet() -> None:
    line = pipeline()
    first = sweeps(0, [(60_000, 16_384), (65_000, 16_384), (500, 16_384)])
    assert thetas(line.feed(RX, first, S)) == pytest.approx([-5536 * STEP, -536 * STEP, 500 * STEP])
    assert thetas(line.feed(RX, sweeps(3, [(600, 16_384)]), S)) == pytest.approx([600 * STEP])
    back = sweeps(4, [(100, 16_384), (65_500, 16_384), (65_400, 16_384), (10, 16_384), (60_000, 16_384)])
    assert thetas(line.feed(RX, back, S)) == pytest.approx([k * STEP for k in (100, -36, -136, 10, -5536)])
    assert thetas(line.feed(RX, sweeps(9, [(59_000, 16_384)]), S)) == pytest.approx([-6536 * STEP])


def test_a_packet_without_a_reading_leaves_the_turns_as_they_are() -> None:
    line = pipeline()
    assert thetas(line.feed(RX, floats([(-65_000.0, 0.0)]), S)) == pytest.approx([536 * STEP])
    batch = only_batch(line.feed(RX, floats([(math.nan, math.inf)] * 2, tick=1), S))
    assert np.isnan(batch.columns["theta3_rad"]).all()
    assert batch.columns["flags"].tolist() == [3, 3]
    assert thetas(line.feed(RX, floats([(-64_000.0, 0.0)], tick=3), S)) == pytest.approx([1536 * STEP])


ONE_SWEEP = "00000000 0003 68 07 0000 17979cfe362a0000 0001 0002"  # at 512 Hz
WORDS = {wire.MODEL: 6307, wire.MODEL_OPTION: 1040, wire.SERIAL_HIGH: 1, wire.SERIAL_LOW: 4464, wire.FIRMWARE: 0x0C05}


def base_answer(request: bytes, version: int, lost: int | None = None) -> bytes:
    """What a base station answers to a request; no answer to a read of one place."""
    if request == wire.request(cast(Version, version), BASE_ADDRESS, wire.PING):
        return packet(wire.BASE_SUCCESS, wire.PING.to_bytes(2, "big"), BASE_ADDRESS, version)
    for place, word in WORDS.items():
        data = place.to_bytes(2, "big")
        if request == wire.request(cast(Version, version), BASE_ADDRESS, wire.BASE_READ, data) and place != lost:
            payload = wire.BASE_READ.to_bytes(2, "big") + data + word.to_bytes(2, "big")
            return packet(wire.BASE_SUCCESS, payload, BASE_ADDRESS, version)
    return b""


def identified(version: int = 3, before: bytes = b"", lost: int | None = None, asked: int = 3) -> FoundDevice | None:
    """Carry out the dialogue with a base station of a version; bytes of its nodes come before each answer."""
    turns = identity_turns(settings(aspp=asked))
    request = next(turns)
    while True:
        answer = base_answer(request.data, version, lost)
        assert not request.is_answered(before)
        assert request.is_answered(before + answer) is bool(answer)
        try:
            request = turns.send(before + answer)
        except StopIteration as end:
            return cast("FoundDevice | None", end.value)


@pytest.mark.parametrize("version", [1, 3])
def test_serial_number_and_firmware_of_a_base_station(version: int) -> None:
    found = identified(version, asked=version)
    assert found is not None
    assert found.identity == {
        "sensor": "base station",
        "base_serial": "6307-1040-70000",
        "base_firmware": "12.5",
    }
    assert found.settings == {"baud": 921_600, "aspp": version}


def test_the_node_whose_samples_come_is_named() -> None:
    mine, other = sweeps(0, [(1, 2)]) + sweeps(1, [(1, 2)]), packet(0x1A, bytes.fromhex(ONE_SWEEP), address=9)
    foreign = packet(wire.BASE_SUCCESS, wire.SET_BEACON.to_bytes(2, "big"), BASE_ADDRESS)  # to another program
    found = identified(before=b"\xac\x00" + other + foreign + mine + mine[:20])
    assert found is not None
    assert found.settings == {"baud": 921_600, "aspp": 3, "node_address": 307, "rate_Hz": 256}


@pytest.mark.parametrize("lost", [wire.SERIAL_LOW, wire.FIRMWARE])
def test_a_word_that_is_not_answered_is_left_out(lost: int) -> None:
    found = identified(lost=lost)
    assert found is not None
    assert ("base_serial" in found.identity, "base_firmware" in found.identity) == (
        lost != wire.SERIAL_LOW,
        lost != wire.FIRMWARE,
    )


def test_another_version_is_not_answered() -> None:
    assert identified(version=1, asked=3) is None
