"""Pipelines at their limits, with every field of their samples and events."""

from __future__ import annotations

import math
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
from rig_drivers.vesc import packets, wire as vesc
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
    report = drive_line(cia301.cob_tpdo(1, DRIVE.node_id), cia402.VELOCITY.pack(0x0637, -123))

    def target(rpm: int) -> bytes:
        return drive_line(cia301.cob_rpdo(1, DRIVE.node_id), cia402.VELOCITY.pack(0x0F, rpm))

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


def test_a_drive_without_reports_has_described_itself() -> None:
    """The length of a report alone can contradict the rig file."""
    pipeline = DrivePipeline("drive", DRIVE, {})
    assert (pipeline.status.has_reported, pipeline.status.complaint) == (True, "")


# --- VESC ------------------------------------------------------------------------------------------------------

MOTOR = Vesc(driver="vesc", port="-", pole_pairs=7, timeout_s=1.0, brake_A=10.0, min_erpm=700.0, follow_s=0.1)
TURNS = vesc.Values(erpm=2100, turned=1000, charges=(5, 0, 9, 0), status=0)


def answer(reported: vesc.Values) -> bytes:
    return packets.packet(vesc.pack_values(reported))


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
