"""Pipelines at their limits, with every field of their samples and events."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from daq import channels
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.stream import NodePipeline
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, encode
from rig_configs import load_rig
from rig_drivers.riftek import wire as riftek
from rig_drivers.riftek.settings import RiftekLaser
from rig_drivers.riftek.stream import RiftekPipeline
from rig_drivers.vesc import packets, stream as vesc_stream, wire as vesc
from rig_drivers.vesc.settings import Vesc
from rig_drivers.vesc.stream import VescPipeline

DEVICES = load_rig("virtual").devices
DRIVE = DEVICES["drive"]
START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
Items = list[Batch | DeviceEvent]


def batches(items: Items) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch)]


def events(items: Items, kind: str = "") -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and kind in ("", item.kind)]


def values(items: Items, name: str) -> list[Any]:
    return [value for batch in batches(items) for value in batch.columns[name].tolist()]


# --- CiA 402 ---------------------------------------------------------------------------------------------------


def drive_line(identifier: int, data: bytes) -> bytes:
    return encode(CanFrame(identifier, data))


def test_a_report_has_the_target_that_was_sent_or_seen_before_it() -> None:
    pipeline = DrivePipeline("drive", DRIVE, {})
    report = drive_line(cia301.cob_tpdo(1, DRIVE.node_id), cia402.pack_tpdo1(0x0637, -123))

    def target(rpm: int) -> bytes:
        return drive_line(cia301.cob_rpdo(1, DRIVE.node_id), cia402.pack_rpdo1(0x0F, rpm))

    items = pipeline.feed(RX, report, START_NS)
    assert pipeline.feed(TX, target(70), START_NS) == []
    items += pipeline.feed(RX, report + target(80) + report, START_NS + 5)
    short = drive_line(cia301.cob_rpdo(1, DRIVE.node_id), b"\x0f\x00\x09")
    items += pipeline.feed(RX, short + report, START_NS + 6)
    assert values(items, "target_rpm") == [0.0, 70.0, 80.0, 80.0]
    assert values(items, "speed_rpm") == [-123.0] * 4
    assert values(items, "statusword") == [0x0637] * 4
    assert [time for batch in batches(items) for time in batch.time_ns] == [START_NS, *[START_NS + 5] * 2, START_NS + 6]
    assert [batch.sequence.tolist() for batch in batches(items)] == [[0], [0, 0], [0]]
    assert len(pipeline.frames) == 2


def test_a_state_is_reported_when_it_changes() -> None:
    pipeline = DrivePipeline("drive", DRIVE, {})
    words = (0x0637, 0x0237, 0x0637, 0x0633, 0x0608, 0x0608)
    data = b"".join(drive_line(cia301.cob_tpdo(1, DRIVE.node_id), cia402.pack_tpdo1(word, 0)) for word in words)
    found = events(pipeline.feed(RX, data, START_NS))
    assert [(event.kind, event.text) for event in found] == [
        ("drive", "OPERATION ENABLED"),
        ("drive", "SWITCHED ON"),
        ("drive", "FAULT"),
    ]
    assert [event.facts["statusword"] for event in found] == [0x0637, 0x0633, 0x0608]


def test_a_drive_without_reports_has_described_itself() -> None:
    """The length of a report alone can contradict the rig file."""
    pipeline = DrivePipeline("drive", DRIVE, {})
    assert (pipeline.status.has_reported, pipeline.status.complaint) == (True, "")


@pytest.mark.parametrize("count", [7, 8])
def test_an_emergency_has_eight_bytes(count: int) -> None:
    identifier = cia301.cob_emergency(DRIVE.node_id)
    found = DrivePipeline("drive", DRIVE, {}).feed(
        RX, drive_line(identifier, bytes.fromhex("3081010000000000")[:count]), 0
    )
    assert [event.text for event in events(found)] == ["drive error 0x8130"] * (count == 8)


# --- VESC ------------------------------------------------------------------------------------------------------

MOTOR = Vesc(driver="vesc", port="-", pole_pairs=7, timeout_s=1.0, brake_A=10.0, min_erpm=700.0, follow_s=0.1)
TURNS = vesc.Values(erpm=2100, turned=1000, charges=(5, 0, 9, 0), status=0)


def answer(reported: vesc.Values) -> bytes:
    return packets.packet(vesc.pack_values(reported))


def test_fields_of_a_statusword() -> None:
    word = vesc_stream.statusword(replace(TURNS, fault=5, status=0xA3), vesc_stream.FREE)
    assert f"{word:026b}" == "01" + "10100011" + "000000" + "11" + "00000101"
    assert vesc_stream.statusword(replace(TURNS, status=None), vesc_stream.BRAKE) == 0b10_00000000
    assert (vesc_stream.NOTHING, vesc_stream.SPEED, vesc_stream.BRAKE, vesc_stream.FREE) == (0, 1, 2, 3)


@pytest.mark.parametrize(
    ("status", "text"),
    [(1, "TIMED OUT"), (2, "KILL SWITCH OPEN"), (3, "KILL SWITCH OPEN"), (4, "BRAKES"), (0, "BRAKES")],
)
def test_states_by_the_status_byte(status: int, text: str) -> None:
    word = vesc_stream.statusword(replace(TURNS, status=status), vesc_stream.BRAKE)
    assert vesc_stream.state(word) == text
    assert vesc_stream.state(word | 1) == "FAULT"


@pytest.mark.parametrize(("count", "lost"), [(84, 0), (85, 1)])
def test_the_rest_of_an_earlier_answer_has_at_most_84_bytes(count: int, lost: int) -> None:
    pipeline = VescPipeline("drive", MOTOR, {})
    found = pipeline.feed(RX, b"\x55" * count + answer(TURNS), 0)
    assert pipeline.losses["damaged_bytes"] == lost
    assert [event.facts for event in events(found, "damage")] == [{"bytes": 1}] * lost


@pytest.mark.parametrize(
    ("target_rpm", "speed_rpm", "follows"),
    [
        (1000, 770, True),
        (1000, 769, False),
        (1000, 1230, True),
        (1000, 1231, False),
        (-1000, -770, True),
        (0, 31, False),
    ],
)
def test_a_rotor_follows_within_a_fifth_and_30_rpm_for_five_reports(
    target_rpm: int, speed_rpm: int, follows: bool
) -> None:
    """0.1 s at 50 reports a second."""
    pipeline = VescPipeline("drive", MOTOR, {})
    pipeline.feed(TX, vesc.set_rpm(7 * target_rpm), 0)
    report = answer(replace(TURNS, erpm=7 * speed_rpm))
    found = [events(pipeline.feed(RX, report, 0), "fault") for _ in range(10)]
    assert [len(each) for each in found] == ([0] * 10 if follows else [0, 0, 0, 0, 1, 0, 0, 0, 0, 0])
    for (fault,) in filter(None, found):
        assert fault.facts == {"target_rpm": target_rpm, "speed_rpm": speed_rpm}


def test_a_short_time_to_follow_is_three_reports() -> None:
    pipeline = VescPipeline("drive", MOTOR.model_copy(update={"follow_s": 0.001}), {})
    pipeline.feed(TX, vesc.set_rpm(7000), 0)
    assert [len(events(pipeline.feed(RX, answer(TURNS), 0), "fault")) for _ in range(5)] == [0, 0, 1, 0, 0]


def test_a_set_point_counts_only_for_the_command_of_a_speed() -> None:
    pipeline = VescPipeline("drive", MOTOR, {})
    targets: list[float] = []
    for command in (vesc.set_rpm(2800), vesc.set_brake(2.8), vesc.set_rpm(-1400), vesc.release()):
        pipeline.feed(TX, command, 0)
        targets += values(pipeline.feed(RX, answer(TURNS), 0), "target_rpm")
    assert targets == [400.0, 0.0, -200.0, 0.0]


def test_every_change_of_the_state_is_an_event() -> None:
    pipeline = VescPipeline("drive", MOTOR, {})
    texts: list[str] = []
    for command in (vesc.set_rpm(2100), vesc.set_brake(2.8), vesc.set_brake(2.9), vesc.set_rpm(2100)):
        pipeline.feed(TX, command, 0)
        texts += [event.text for event in events(pipeline.feed(RX, answer(TURNS), 0), "drive")]
    assert texts == ["HOLDS SPEED", "BRAKES", "HOLDS SPEED"]


def test_missing_answers_are_counted_before_the_next_one() -> None:
    pipeline = VescPipeline("drive", MOTOR, {})
    for _ in range(4):
        pipeline.feed(TX, vesc.get_values(), 0)
    (gap,) = events(pipeline.feed(RX, answer(TURNS), 0), "gap")
    assert (gap.text, gap.facts, pipeline.losses["unanswered"]) == ("3 polls not answered", {"samples": 3}, 3)
    pipeline.feed(TX, vesc.get_values(), 0)
    assert events(pipeline.feed(RX, answer(TURNS), 0), "gap") == []
    old = bytes([4]) + bytes(vesc.VALUES_BYTES - 2)
    (damage,) = pipeline.feed(RX, packets.packet(old), 0)
    assert isinstance(damage, DeviceEvent)
    assert (damage.kind, damage.facts, pipeline.losses["unreadable_answers"]) == ("damage", {"bytes": len(old)}, 1)


def test_an_identity_has_its_version_with_two_digits() -> None:
    firmware = vesc.Firmware(6, 5, "60", bytes(range(12)).hex())
    (event,) = VescPipeline("drive", MOTOR, {}).feed(RX, packets.packet(vesc.pack_firmware(firmware)), 0)
    assert isinstance(event, DeviceEvent)
    assert event.facts == {"firmware": "6.05", "hardware": "60", "serial": "000102030405060708090a0b"}
    (event,) = VescPipeline("drive", MOTOR, {}).feed(RX, packets.packet(bytes([0, 3])), 0)
    assert isinstance(event, DeviceEvent)
    assert (event.kind, event.text, event.facts) == ("reply", "0003", {})


# --- RotorLink -------------------------------------------------------------------------------------------------


def block(index: int = 0, seq: int = 0, node_us: int | None = None, n: int = 10, flags: int = 0, **other: int) -> bytes:
    counts = np.column_stack([100 + np.arange(n), -np.arange(n)]).astype(np.int32)
    first_us = 1000 * index if node_us is None else node_us
    return rotorlink.wire(
        rotorlink.EncoderBlock(other.get("node", 1), seq, index, first_us % 2**32, 1000, flags, counts).pack()
    )


def node(**identity: Any) -> NodePipeline:
    return NodePipeline("encoder", DEVICES["encoder"], identity)


def fed(pipeline: NodePipeline, *parts: bytes | tuple[bytes, float]) -> Items:
    """Reads 10 ms apart, or with the host's time in ms."""
    items: Items = []
    for i, part in enumerate(parts):
        data, at_ms = part if isinstance(part, tuple) else (part, 10.0 * i)
        items += pipeline.feed(RX, data, START_NS + round(at_ms * MS))
    return items


def test_samples_of_a_block_have_angles_indices_and_times() -> None:
    (batch,) = batches(fed(node(), block(7, flags=96)))
    assert batch.columns["theta3_rad"] == pytest.approx((100 + np.arange(10)) * 2 * math.pi / 4096)
    assert batch.columns["theta4_rad"] == pytest.approx(-np.arange(10) * 2 * math.pi / 4096)
    assert batch.columns["count_a"].tolist() == list(range(100, 110))
    assert batch.columns["count_b"].tolist() == list(range(0, -10, -1))
    assert batch.columns["index"].tolist() == batch.sequence.tolist() == list(range(7, 17))
    assert batch.columns["node_time_us"].tolist() == [7000 + 1000 * k for k in range(10)]
    assert batch.columns["flags"].tolist() == [96] * 10
    assert batch.time_ns.tolist() == [START_NS - (9 - k) * MS for k in range(10)]


@pytest.mark.parametrize("number", [0, 255])
def test_a_node_s_number_is_a_byte(number: int) -> None:
    pipeline = node(node=number)
    assert pipeline.status.learned == {"node": number}
    assert values(fed(pipeline, block(node=number)), "index") == list(range(10))
    for wrong in (-1, 256, True, "1", 1.0):
        with pytest.raises(DeviceError, match="a node's number, 0 to 255"):
            node(node=wrong)


def test_a_status_has_its_values_in_their_units() -> None:
    status = rotorlink.NodeStatus(1, 0, 5000, 3712, -315, 8, 2, 1, 4, 4096)
    pipeline = node()
    assert not pipeline.status.has_reported
    (event,) = events(fed(pipeline, rotorlink.wire(status.pack())))
    assert (event.kind, event.text) == ("status", "battery 3712 mV")
    assert event.facts == {
        "battery_mv": 3712,
        "frames_sent": 8,
        "overruns": 2,
        "counts_per_revolution": 4096,
        "temperature_degC": -31.5,
    }
    assert pipeline.status.has_reported
    assert pipeline.status.complaint == ""


@pytest.mark.parametrize(
    ("pendulum", "state", "text"),
    [(0, 0, "A locked"), (1, 1, "B released"), (0, 2, "A moving"), (1, 3, "B fault"), (0, 9, "A fault")],
)
def test_events_of_the_locks(pendulum: int, state: int, text: str) -> None:
    lock = rotorlink.LockEvent(1, 0, 4000, pendulum, state, 7)
    (event,) = events(fed(node(), rotorlink.wire(lock.pack())))
    assert (event.kind, event.text) == ("lock", f"pendulum {text}")
    facts = {"pendulum": pendulum, "state": text[2:], "node_time_us": 4000, "time_ns": START_NS}
    assert event.facts == facts


@pytest.mark.parametrize(
    ("result", "text"), [(0, "accepted"), (3, "fault"), (4, "refused: not locked"), (77, "refused: not")]
)
def test_answers_to_commands(result: int, text: str) -> None:
    (event,) = events(fed(node(), rotorlink.wire(rotorlink.Acknowledge(1, 0, 42, result).pack())))
    assert event.kind == "acknowledge"
    assert event.text.startswith(f"command 42: {text}")
    assert event.facts == {"command_seq": 42, "result": result}


def test_a_mark_is_a_sample_of_the_tachometer() -> None:
    (batch,) = batches(fed(node(), rotorlink.wire(rotorlink.IndexMark(1, 9, 4_000_000_000, 12).pack())))
    assert batch.channel is channels.TACHO
    assert (batch.columns["revolutions"].tolist(), batch.columns["node_time_us"].tolist()) == ([12], [4_000_000_000])
    assert (batch.time_ns.tolist(), batch.sequence.tolist()) == ([START_NS], [9])


def test_only_the_first_damage_of_a_log_is_the_rest_of_a_frame() -> None:
    pipeline = node()
    items = fed(pipeline, b"\x05\x01\x00", b"\x05\x01\x00", block(0))
    assert [event.kind for event in events(items)] == ["damage"]
    assert pipeline.losses["damaged_frames"] == 1
    later = node()
    assert len(events(fed(later, block(0), b"\x05\x01\x00"), "damage")) == 1


def test_a_seed_of_the_node_s_clock_wraps_after_32_bits_of_microseconds() -> None:
    pipeline = node()
    assert pipeline.status.clock_seed is None
    fed(pipeline, block(0))
    seed = pipeline.status.clock_seed
    assert seed is not None
    assert (seed.wrap_ns, seed.device_ns, seed.host_ns) == (2**32 * 1000, 9 * MS, START_NS)


# --- RIFTEK ----------------------------------------------------------------------------------------------------


def rf60x(rate_Hz: float = 1000.0, **other: Any) -> RiftekPipeline:
    settings = RiftekLaser(driver="riftek", port="-", axis="x", rate_Hz=rate_Hz, **other)
    return RiftekPipeline("laser_x", settings, {})


def test_columns_of_results() -> None:
    pipeline = rf60x(range_m=0.05, lever_ratio=0.5)
    codes, numbers = [0x2000, 0x3000, 0x1000, 0x4001], [2, 3, 0, 1]
    (batch,) = batches(pipeline.feed(RX, riftek.results(codes, numbers), START_NS))
    assert batch.columns["displacement_m"][:3].tolist() == pytest.approx([0.0, 0.025, -0.025])
    assert math.isnan(batch.columns["displacement_m"][3])
    assert batch.columns["code"].tolist() == codes
    assert batch.columns["counter"].tolist() == batch.sequence.tolist() == [0, 1, 2, 3]
    assert batch.columns["device_ticks"].tolist() == [0, 100, 200, 300]
    assert batch.columns["flags"].tolist() == [0, 0, 0, 0]
    assert batch.time_ns.tolist() == [START_NS - (3 - k) * MS for k in range(4)]
    assert pipeline.losses == {"samples": 0, "bytes": 0, "invalid": 1, "suspect": 0}


def test_an_older_result_sent_again_is_flagged_and_not_a_reading() -> None:
    pipeline = rf60x()
    data = riftek.results([100, 100], [0, 1]) + riftek.results([100], [2], updated=False)
    (batch,) = batches(pipeline.feed(RX, data, START_NS))
    assert batch.columns["flags"].tolist() == [0, 0, 2]
    assert np.isnan(batch.columns["displacement_m"]).tolist() == [False, False, True]


def test_lost_results_have_their_number_span_and_place() -> None:
    pipeline = rf60x(500.0)
    found = pipeline.feed(RX, riftek.results([9, 9, 9, 9], [0, 1, 0, 1]), START_NS)
    (gap,) = events(found, "gap")
    assert gap.facts == {
        "samples": 2,
        "span_s": pytest.approx(0.004),
        "time_ns": START_NS - 2 * MS,
        "device_ticks": 4 * 200,
    }
    assert gap.text == "2 samples lost (4.00 ms)"
    assert values(found, "counter") == [0, 1, 4, 5]
    assert pipeline.losses["samples"] == 2
    assert values(rf60x().feed(RX, riftek.results([9, 9, 9], [2, 3, 1]), START_NS), "counter") == [0, 1, 3]
    more = pipeline.feed(RX, riftek.results([9], [3]), START_NS + 7 * MS)
    assert (values(more, "counter"), events(more)[0].facts["device_ticks"]) == ([7], 7 * 200)


@pytest.mark.parametrize(("spikes", "text"), [([300], "a sample marked"), ([300, 340], "2 samples marked")])
def test_false_results_are_counted_and_reported(spikes: list[int], text: str) -> None:
    pipeline = rf60x()
    codes = 8192 + np.rint(3000 * np.sin(0.02 * np.arange(400))).astype(np.int64)
    codes[spikes] ^= 0x1000
    found = pipeline.feed(RX, riftek.results(codes, np.arange(400)), START_NS)
    (event,) = events(found, "suspect")
    assert event.text.startswith(text)
    assert event.facts == {"suspect": len(spikes), "time_ns": START_NS - 99 * MS}
    assert pipeline.losses["suspect"] == len(spikes)


@pytest.mark.parametrize("range_m", [0, -1, True, "1", math.nan, math.inf, None])
def test_a_range_is_a_positive_number(range_m: object) -> None:
    settings = RiftekLaser(driver="riftek", port="-", axis="x", rate_Hz=1000.0)
    with pytest.raises(DeviceError, match="range_m"):
        RiftekPipeline("laser_x", settings, {"range_m": range_m})
    with pytest.raises(DeviceError, match="range_m"):
        LaserPipeline("laser_x", DEVICES["laser_x"], {"range_m": range_m})
    for number in (1, 1e-3):
        RiftekPipeline("laser_x", settings, {"range_m": number})


# --- optoNCDT --------------------------------------------------------------------------------------------------


def laser(**identity: Any) -> LaserPipeline:
    return LaserPipeline("laser_x", DEVICES["laser_x"], identity)


def laser_bytes(counters: np.ndarray, ticks: np.ndarray) -> bytes:
    codes = distance_words.code(0.0125 + 1e-4 * (counters % 7), 0.025)
    return optoncdt.encode_block(np.column_stack([codes, counters % 2**18, ticks & 0xFFFF, ticks >> 16 & 0xFFFF]))


def test_a_laser_s_gap_has_its_number_span_and_place() -> None:
    pipeline = laser()
    counters = np.array([5, 6, 7, 11, 12])
    found = pipeline.feed(RX, laser_bytes(counters, 25 * counters), START_NS)
    (gap,) = events(found)
    assert gap.facts == {
        "samples": 3,
        "span_s": pytest.approx(0.00075),
        "time_ns": START_NS - 250_000,
        "device_ticks": 275,
    }
    assert gap.text == "3 samples lost (0.75 ms)"
    assert pipeline.losses["samples"] == 3
    assert values(found, "device_ticks") == (25 * counters).tolist()
    assert values(found, "displacement_m") == pytest.approx((1e-4 * (counters % 7)).tolist(), abs=5e-7)


def test_a_gap_longer_than_the_counter_s_wrap_is_counted_by_the_timestamp() -> None:
    pipeline = laser()
    first = np.arange(1, 6)
    lost = 2**18 + 10
    later = first + 5 + lost
    found = pipeline.feed(RX, laser_bytes(first, 25 * first), START_NS)
    found += pipeline.feed(RX, laser_bytes(later, 25 * later), START_NS + 250_000 * int(later[-1] - 5))
    assert pipeline.losses["samples"] == lost
    assert events(found, "gap")[0].facts["device_ticks"] == 25 * int(later[0])


@pytest.mark.parametrize(("deviation", "reported"), [(0.0015, False), (0.0025, True)])
def test_a_rate_that_deviates_by_two_thousandths_is_reported(deviation: float, reported: bool) -> None:
    pipeline = laser()
    counters = np.arange(6000)
    ticks = np.rint(25 * counters * (1 + deviation)).astype(np.int64)
    found = [
        item
        for part in range(6)
        for item in pipeline.feed(
            RX, laser_bytes(counters[1000 * part :][:1000], ticks[1000 * part :][:1000]), START_NS + 250 * part * MS
        )
    ]
    rates = events(found, "rate")
    assert bool(rates) is reported
    for event in rates:
        assert event.facts["nominal_Hz"] == pytest.approx(4000.0)
        assert event.facts["rate_Hz"] == pytest.approx(4000.0 / (1 + deviation), rel=2e-4)
    assert values(found, "counter") == counters.tolist()


def test_a_seed_of_the_laser_s_clock_wraps_with_its_timestamp() -> None:
    pipeline = laser()
    assert pipeline.status.clock_seed is None
    counters = np.arange(1, 6)
    pipeline.feed(RX, laser_bytes(counters, 25 * counters), START_NS)
    seed = pipeline.status.clock_seed
    assert seed is not None
    assert (seed.wrap_ns, seed.device_ns, seed.host_ns) == (42_949_672_960_000, 125 * 10_000, START_NS)


@pytest.mark.parametrize(
    "identity",
    [
        {"words": []},
        {"words": "DIST"},
        {"words": ["DIST", "COUNTER", "TIMESTAMP_LO"]},
        {"words": ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI", "DIST"]},
        {"words": ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI", 1]},
        {"words": ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI", *map(str, range(29))]},
        {"scaling": "none"},
        {"scaling": 1},
    ],
)
def test_identities_that_no_laser_has_are_refused(identity: dict[str, object]) -> None:
    with pytest.raises(DeviceError, match="laser_x: expected"):
        laser(**identity)
    laser(words=["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI", *map(str, range(28))])


@pytest.mark.parametrize(
    ("odd", "words"),
    [
        ([900], "a sample whose counter and timestamp do not fit was dropped"),
        ([900, 1900], "2 samples whose counter and timestamp do not fit were dropped"),
    ],
)
def test_samples_that_do_not_fit_are_dropped_and_reported(odd: list[int], words: str) -> None:
    pipeline = laser()
    counters = np.arange(1, 9)
    ticks = 25 * counters
    data = laser_bytes(np.insert(counters, 4, odd), np.insert(ticks, 4, odd))
    found = pipeline.feed(RX, data, START_NS)
    (event,) = events(found)
    assert (event.kind, event.text, event.facts) == ("damage", words, {"damaged": len(odd)})
    assert values(found, "counter") == counters.tolist()
    assert pipeline.losses["damaged"] == len(odd)


def test_bytes_skipped_within_a_stream_are_counted_and_those_before_it_are_not() -> None:
    counters = np.arange(1, 6)
    data = laser_bytes(counters, 25 * counters)
    pipeline = laser()
    assert events(pipeline.feed(RX, b"\xff\xff" + data, START_NS)) == []
    (event,) = events(pipeline.feed(RX, b"\xff" + laser_bytes(counters + 5, 25 * (counters + 5)), START_NS + MS))
    assert (event.kind, event.facts, event.text) == ("damage", {"bytes": 1}, "1 byte skipped that belongs to no block")
    assert pipeline.losses["bytes"] == 1


@pytest.mark.parametrize(
    "make", [laser, node, rf60x, lambda: VescPipeline("d", MOTOR, {}), lambda: DrivePipeline("d", DRIVE, {})]
)
def test_no_pipeline_begins_with_losses(make: Any) -> None:
    assert set(make().losses.values()) == {0}
