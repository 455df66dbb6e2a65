"""Pipelines: what is lost is counted, what is not is decoded, and the same bytes give the same samples."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.line import FrameDecoder
from daq.drivers.rotorlink.stream import NodePipeline
from daq.items import RX, Batch, DeviceEvent
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, decode, encode
from rig_configs import load_rig
from tests.effort import cases

DEVICES = load_rig("virtual").devices
START_NS = 1_700_000_000_000_000_000


def blocks(counters: np.ndarray, metres: np.ndarray) -> np.ndarray:
    ticks = counters * 25
    return np.column_stack(
        [distance_words.code(metres + 0.0125, 0.025), counters % 2**18, ticks & 0xFFFF, (ticks >> 16) & 0xFFFF]
    ).astype(np.uint32)


def feed(pipeline: LaserPipeline | NodePipeline, parts: list[bytes]) -> tuple[list[Batch], list[DeviceEvent]]:
    """A whole log, to its end."""
    return feed_on(pipeline, [*parts, b""])


def feed_on(pipeline: LaserPipeline | NodePipeline, parts: list[bytes]) -> tuple[list[Batch], list[DeviceEvent]]:
    items = [x for i, p in enumerate(parts) for x in pipeline.feed(RX, p, START_NS + i * 10_000_000)]
    return [x for x in items if isinstance(x, Batch)], [x for x in items if isinstance(x, DeviceEvent)]


def laser() -> LaserPipeline:
    return LaserPipeline("laser_x", DEVICES["laser_x"], {})


@given(st.lists(st.integers(2, 80), min_size=1, max_size=8), st.lists(st.integers(0, 50), min_size=8, max_size=8))
def test_laser_gaps_are_counted_exactly(lengths: list[int], gaps: list[int]) -> None:
    counters, at = [], 262_100  # across the wrap of the 18-bit counter
    for length, gap in zip(lengths, gaps, strict=False):
        counters.append(np.arange(at, at + length))
        at += length + gap
    pipeline = laser()
    items = [
        item
        for c in counters
        for item in pipeline.feed(RX, optoncdt.encode_block(blocks(c, np.full(len(c), 1e-3))), 250_000 * int(c[-1]))
    ]
    batches = [item for item in items if isinstance(item, Batch)]
    events = [item for item in items if isinstance(item, DeviceEvent)]
    used = gaps[: len(lengths) - 1]
    assert pipeline.losses["samples"] == sum(used)
    assert sum(len(b.time_ns) for b in batches) == sum(lengths)
    reported = [e.facts for e in events if e.kind == "gap"]
    assert [facts["samples"] for facts in reported] == [g for g in used if g]
    assert [facts["span_s"] for facts in reported] == pytest.approx([g * 250e-6 for g in used if g])
    first_after = [int(batch.time_ns[0]) for batch, gap in zip(batches[1:], used, strict=True) if gap]
    assert [facts["time_ns"] for facts in reported] == first_after
    values = np.concatenate([b.columns["displacement_m"] for b in batches])
    assert np.allclose(values, 1e-3, atol=2e-7)
    times = np.concatenate([b.time_ns for b in batches])
    assert np.all(np.diff(times) > 0)


def test_invalid_codes_are_nan_and_counted() -> None:
    pipeline = laser()
    words = blocks(np.arange(100, 110), np.zeros(10))
    words[3:5, 0] = 262_078
    batches, _ = feed(pipeline, [optoncdt.encode_block(words)])
    displacement = batches[0].columns["displacement_m"]
    assert np.flatnonzero(np.isnan(displacement)).tolist() == [3, 4]
    assert pipeline.losses["invalid"] == 2
    assert batches[0].columns["code"][3] == 262_078


def test_a_restarted_sensor_is_an_event_not_a_huge_gap() -> None:
    pipeline = laser()
    parts = [
        optoncdt.encode_block(blocks(np.arange(90_000, 90_100), np.zeros(100))),
        optoncdt.encode_block(blocks(np.arange(5, 105), np.zeros(100))),
    ]
    batches, events = feed(pipeline, parts)
    assert [e.kind for e in events] == ["restart"]
    assert pipeline.losses["samples"] == 0
    assert sum(len(b.time_ns) for b in batches) == 200


def node_frames(count: int, first_seq: int = 65_530) -> list[bytes]:
    return [
        rotorlink.wire(
            rotorlink.EncoderBlock(
                1,
                (first_seq + i) & 0xFFFF,
                20 * i,
                (20_000 * i) % 2**32,
                1000,
                96,
                np.column_stack([np.arange(20) + 20 * i, np.full(20, 2048)]).astype(np.int32),
            ).pack()
        )
        for i in range(count)
    ]


@given(st.sets(st.integers(1, 38), max_size=25))
def test_lost_radio_frames_are_counted_and_the_rest_is_kept(lost: set[int]) -> None:
    pipeline = NodePipeline("encoder", DEVICES["encoder"], {})
    batches, _ = feed(pipeline, [f for i, f in enumerate(node_frames(40)) if i not in lost])
    assert pipeline.losses["radio_frames"] == len(lost)
    assert pipeline.losses["samples"] == 20 * len(lost)
    index = np.concatenate([b.columns["index"] for b in batches])
    assert np.array_equal(index, [k for i in range(40) if i not in lost for k in range(20 * i, 20 * i + 20)])


def test_repeated_and_damaged_frames_give_no_samples_twice() -> None:
    frames = node_frames(6)
    damaged = bytearray(frames[3])
    damaged[10] ^= 0x40
    pipeline = NodePipeline("encoder", DEVICES["encoder"], {})
    batches, events = feed(pipeline, [frames[0], frames[1], frames[1], frames[2], bytes(damaged), frames[4], frames[5]])
    index = np.concatenate([b.columns["index"] for b in batches])
    assert np.array_equal(index, [*range(60), *range(80, 120)])
    assert pipeline.losses == {"radio_frames": 1, "cable_frames": 0, "damaged_frames": 1, "samples": 20}
    assert "damage" in [e.kind for e in events]


@given(st.integers(1, 38), st.integers(0, 3), st.integers(1, 0x3FFFF))
def test_one_damaged_row_is_dropped_and_nothing_else(row: int, column: int, flip: int) -> None:
    words = blocks(np.arange(5000, 5040), np.zeros(40))
    damaged = words.copy()
    damaged[row, column] ^= flip & (0x3FFFF if column < 2 else 0xFFFF)
    pipeline = laser()
    batches, events = feed(
        pipeline, [optoncdt.encode_block(damaged), optoncdt.encode_block(blocks(np.arange(5040, 5080), np.zeros(40)))]
    )
    kept = np.concatenate([b.columns["device_ticks"] for b in batches])
    assert np.all(np.diff(kept.astype(np.int64)) > 0)
    assert "restart" not in [e.kind for e in events]
    if column == 0 or np.array_equal(damaged[:, 1:], words[:, 1:]):
        assert len(kept) == 80
    else:
        assert len(kept) >= 79
        assert pipeline.losses["samples"] == pipeline.losses["damaged"] == 80 - len(kept)


def test_a_gap_longer_than_the_counter_is_counted_by_the_timestamp() -> None:
    pipeline = laser()
    far = 100 + 2**18 + 5
    pipeline.feed(RX, optoncdt.encode_block(blocks(np.arange(0, 100), np.zeros(100))), START_NS)
    later_ns = START_NS + far * 250_000
    pipeline.feed(RX, optoncdt.encode_block(blocks(np.arange(far, far + 50), np.zeros(50))), later_ns)
    assert pipeline.losses["samples"] == 2**18 + 5


def encoder_wire(seq: int, index: int, node_us: int, n: int = 20, flags: int = 0) -> bytes:
    counts = np.column_stack([index + np.arange(n), np.full(n, 2048)]).astype(np.int32)
    return rotorlink.wire(rotorlink.EncoderBlock(1, seq, index, node_us, 1000, flags, counts).pack())


def decoded(sent: list[tuple[float, bytes]]) -> tuple[NodePipeline, list[int], list[DeviceEvent]]:
    """A node's frames, each with the host's time of its arrival in s; what came out, to the log's end."""
    pipeline = NodePipeline("encoder", DEVICES["encoder"], {})
    items = [x for s, frame in [*sent, (sent[-1][0], b"")] for x in pipeline.feed(RX, frame, START_NS + round(s * 1e9))]
    index = [int(k) for x in items if isinstance(x, Batch) for k in x.columns["index"]]
    return pipeline, index, [x for x in items if isinstance(x, DeviceEvent)]


def blocks_from(
    start_s: float,
    count: int,
    seq: int = 0,
    index: int = 0,
    node_s: float | None = None,
    period_us: int = 1000,
    n: int = 20,
    **other: int,
) -> list[tuple[float, bytes]]:
    """Encoder blocks of a node as they come: each when its last sample is made."""
    node_us = round(1e6 * (start_s if node_s is None else node_s))
    return [
        (
            start_s + 1e-6 * (i + 1) * n * period_us,
            rotorlink.wire(
                rotorlink.EncoderBlock(
                    other.get("node", 1),
                    (seq + i) % 2**16,
                    (index + n * i) % 2**32,
                    (node_us + i * n * period_us) % 2**32,
                    period_us,
                    other.get("flags", 0),
                    np.zeros((n, 2), np.int32),
                ).pack()
            ),
        )
        for i in range(count)
    ]


@pytest.mark.parametrize("minutes", [0.1, 10, 36, 40, 60, 71, 75])
def test_a_node_that_starts_again_is_seen_however_long_it_ran(minutes: float) -> None:
    ran_s = 60.0 * minutes
    seq, index = round(50 * ran_s), round(1000 * ran_s)
    sent = [*blocks_from(0.0, 50, seq % 2**16, index, node_s=ran_s), *blocks_from(2.0, 100, node_s=0.0)]
    pipeline, found, events = decoded(sent)
    assert found == [*range(index, index + 1000), *range(2000)]
    assert [event.kind for event in events] == ["restart"]
    assert not any(pipeline.losses.values())


@pytest.mark.parametrize("minutes", [1, 30, 40, 71.6, 75])
def test_a_node_that_is_out_of_reach_for_long_has_lost_so_many_samples(minutes: float) -> None:
    away = round(3000 * minutes)  # blocks
    sent = [*blocks_from(0.0, 50), *blocks_from(0.02 * (50 + away), 50, (50 + away) % 2**16, 20 * (50 + away))]
    pipeline, found, events = decoded(sent)
    assert len(found) == 2000
    assert "restart" not in [event.kind for event in events]
    assert pipeline.losses["samples"] == 20 * away


def test_times_go_on_behind_an_outage_longer_than_the_nodes_clock() -> None:
    away = 75 * 3000
    sent = [*blocks_from(0.0, 50), *blocks_from(0.02 * (50 + away), 50, (50 + away) % 2**16, 20 * (50 + away))]
    pipeline = NodePipeline("encoder", DEVICES["encoder"], {})
    items = [x for s, frame in sent for x in pipeline.feed(RX, frame, START_NS + round(s * 1e9))]
    times = np.concatenate([x.time_ns for x in items if isinstance(x, Batch)])
    assert times[-1] - START_NS == pytest.approx(1e9 * sent[-1][0], abs=2e7)


@pytest.mark.parametrize("later", [1, 3, 60, 100])
def test_a_block_sent_again_is_no_restart_however_late(later: int) -> None:
    sent = blocks_from(0.0, 300)
    again = rotorlink.EncoderBlock(1, 30, 600, 600_000, 1000, rotorlink.FLAG_REPEATS, np.zeros((20, 2), np.int32))
    for came in (True, False):
        frames = [each for k, each in enumerate(sent) if came or k != 30]
        place = 30 + later + came
        frames.insert(place, (frames[place - 1][0], rotorlink.wire(again.pack())))
        pipeline, found, events = decoded(frames)
        there = came or later <= 3
        assert found == [k for k in range(6000) if there or not 600 <= k < 620]
        assert pipeline.losses["samples"] == (0 if there else 20)
        assert "restart" not in [event.kind for event in events]


@pytest.mark.parametrize(("period_us", "n"), [(1000, 29), (2000, 20), (5000, 29), (4000, 10)])
def test_repeats_are_waited_for_as_long_as_blocks_last(period_us: int, n: int) -> None:
    sent: list[tuple[float, bytes]] = []
    for i in range(100):
        for k, flags in ((i, 0), (i - 2, rotorlink.FLAG_REPEATS)):
            if k >= 0 and (k, flags) != (50, 0):
                ((_, frame),) = blocks_from(
                    0.0, 1, len(sent), n * k, 1e-6 * period_us * n * k, period_us, n, flags=flags
                )
                sent.append((1e-6 * period_us * n * (i + 1), frame))
    pipeline, found, _ = decoded(sent)
    assert found == list(range(100 * n))
    assert pipeline.losses["samples"] == 0


@pytest.mark.parametrize("period_us", [20_000, 40_000, 65_535])
def test_a_status_within_a_long_block_is_no_restart(period_us: int) -> None:
    length_s = 29e-6 * period_us
    frames = [(s, 1, frame) for s, frame in blocks_from(0.0, 30, period_us=period_us, n=29)]
    status = [
        (0.9 * k, 0, rotorlink.NodeStatus(1, 0, round(9e5 * k), 3700, 250, 0, 0, 1, 1, 4096))
        for k in range(int(33 * length_s))
    ]
    reported = sorted([*frames, *status], key=lambda each: each[:2])
    sent = [(s, _numbered(frame, k)) for k, (s, _, frame) in enumerate(reported) if s <= 30 * length_s]
    pipeline, found, events = decoded(sent)
    assert found == list(range(870))
    assert {event.kind for event in events} == {"status"}
    assert not any(pipeline.losses.values())


def _numbered(frame: bytes | rotorlink.NodeStatus, seq: int) -> bytes:
    """A frame with its place in the sender's sequence."""
    found = FrameDecoder().feed(frame).frames[0] if isinstance(frame, bytes) else frame
    assert isinstance(found, rotorlink.EncoderBlock | rotorlink.NodeStatus)
    return rotorlink.wire(replace(found, seq=seq).pack())


@pytest.mark.parametrize("dongle_seq", [20, 33_049, 50_049, 65_049])
def test_a_dongle_that_starts_again_has_lost_nothing(dongle_seq: int) -> None:
    sent = []
    for k, (s, frame) in enumerate(blocks_from(0.0, 100)):
        inner = FrameDecoder().feed(frame).frames[0]
        seq, dongle_s = (dongle_seq + k, 3600 + s) if k < 50 else (k - 50, s - 1.0)
        sent.append((s, rotorlink.wire(rotorlink.Wrapped(1, seq % 2**16, round(dongle_s * 1e6), -60, inner).pack())))
    pipeline, found, events = decoded(sent)
    assert found == list(range(2000))
    assert not any(pipeline.losses.values())
    assert [event.kind for event in events] == ["dongle"]


@pytest.mark.parametrize("wrapped", [False, True])
def test_an_intact_frame_of_an_unknown_type_is_not_lost(wrapped: bool) -> None:
    sent = []
    for k, (s, frame) in enumerate(blocks_from(0.0, 100)):
        sent.append((s, frame))
        if k % 10 == 5:
            strange = rotorlink.encode_frame(bytes((0x17, 1)) + k.to_bytes(2, "little") + b"something")
            sent[-1] = (s, rotorlink.wire(strange))
        if wrapped:
            (inner,) = FrameDecoder().feed(sent[-1][1]).frames
            damaged = strange if isinstance(inner, rotorlink.Skipped) else b""
            outer = rotorlink.Wrapped(1, k, round(s * 1e6), -60, None if damaged else inner, damaged)
            sent[-1] = (s, rotorlink.wire(outer.pack()))
    pipeline, _, _ = decoded(sent)
    assert pipeline.losses["damaged_frames"] == 10
    assert pipeline.losses["radio_frames"] == pipeline.losses["cable_frames"] == 0


def test_only_one_node_is_listened_to() -> None:
    of_seven, of_two = (blocks_from(0.0, 50, node=number, seq=9 * number, index=100 * number) for number in (7, 2))
    mixed = [each for pair in zip(of_seven, of_two, strict=True) for each in pair]
    pipeline, found, events = decoded(mixed)
    assert found == list(range(700, 1700))
    assert not any(pipeline.losses.values())
    assert [event.text for event in events] == [
        "the node's number is 7",
        "frames of node 2 ignored: this rig's is node 7",
        pipeline.status.complaint,
    ]
    config = DEVICES["encoder"].model_copy(update={"node": 2})
    chosen = NodePipeline("encoder", config, {})
    batches, _ = feed(chosen, [frame for _, frame in mixed])
    assert batches[0].columns["index"][0] == 200


def test_the_node_of_one_log_is_that_of_the_next_independent_of_the_first_frame() -> None:
    first, *_ = decoded(blocks_from(0.0, 10, node=7))
    again = NodePipeline("encoder", DEVICES["encoder"], json.loads(json.dumps(first.status.learned)))
    neighbour, ours = blocks_from(1.0, 1, node=2), blocks_from(1.0, 10, 10, 200, node=7)
    batches, events = feed(again, [frame for _, frame in neighbour + ours])
    assert sum(len(batch.time_ns) for batch in batches) == 200
    ignored = "frames of node 2 ignored: this rig's is node 7"
    assert [event.text for event in events] == [ignored, again.status.complaint]
    chosen = NodePipeline("encoder", DEVICES["encoder"].model_copy(update={"node": 2}), first.status.learned or {})
    assert chosen.status.learned == {"node": 2}  # the rig file decides


@settings(max_examples=cases(40, 200))
@given(st.sets(st.integers(4, 89), max_size=60), st.booleans(), st.integers(1, 2))
def test_samples_sent_again_fill_the_holes_of_lost_blocks(lost: set[int], own_seq: bool, behind: int) -> None:
    """Each block is sent twice, the second time behind one newer block or two; a loss is what never came."""
    sent = []  # number of the block, sequence, flags
    for i in range(50):
        sent.append((i, len(sent), 0))
        if i >= behind:
            seq = next(s for n, s, f in sent if n == i - behind and not f) if own_seq else len(sent)
            sent.append((i - behind, seq, rotorlink.FLAG_REPEATS))
    came = [each for place, each in enumerate(sent) if place not in lost]
    pipeline = NodePipeline("encoder", DEVICES["encoder"], {})
    batches, events = feed(pipeline, [encoder_wire(s, 20 * n, 20_000 * n, flags=f) for n, s, f in came])
    there = sorted({n for n, _, _ in came})
    index = np.concatenate([b.columns["index"] for b in batches])
    assert np.array_equal(index, [20 * n + k for n in there for k in range(20)])
    assert pipeline.losses["samples"] == 20 * (50 - len(there))
    assert sum(e.facts.get("samples", 0) for e in events if e.kind == "gap") == pipeline.losses["samples"]
    assert np.all(np.diff(np.concatenate([b.time_ns for b in batches])) > 0)


def test_lost_radio_frames_are_reported_with_count_and_span() -> None:
    pipeline = NodePipeline("encoder", DEVICES["encoder"], {})
    start_us = 2**32 - 50_000  # across the wrap of the node's clock
    parts = [encoder_wire(i, 20 * i, (start_us + 20_000 * i) % 2**32) for i in (0, 1, 5, 6)]
    batches, events = feed(pipeline, parts)
    frames, samples = (e.facts for e in events if e.kind == "gap")
    assert (frames["radio_frames"], frames["span_s"]) == (3, pytest.approx(0.08))
    assert (samples["samples"], samples["span_s"]) == (60, pytest.approx(0.06))
    assert samples["time_ns"] == batches[2].time_ns[0]
    assert pipeline.losses == {"radio_frames": 3, "cable_frames": 0, "damaged_frames": 0, "samples": 60}


def test_losses_of_air_and_cable_are_counted_separately() -> None:
    """Four frames of the node are missing; by the dongle's numbers it had passed on two frames, or one more."""
    pipeline = NodePipeline("encoder", DEVICES["encoder"], {})
    sent = [(7, 0), (10, 5), (11, 7)]
    wire = [
        rotorlink.wire(rotorlink.Wrapped(1, seq, 50_000 * i, -60, rotorlink.IndexMark(1, i, 50_000 * i, i)).pack())
        for seq, i in sent
    ]
    feed(pipeline, wire)
    assert (pipeline.losses["cable_frames"], pipeline.losses["radio_frames"]) == (2, 3)


def heard(*frames: tuple[int, bytes]) -> list[DeviceEvent]:
    """Events of a drive that sends these frames, each in a read of its own."""
    pipeline = DrivePipeline("drive", DEVICES["drive"], {})
    found: list[Batch | DeviceEvent] = []
    for number, (identifier, data) in enumerate(frames):
        found += pipeline.feed(RX, encode(CanFrame(identifier, data)), START_NS + number)
    return [item for item in found if isinstance(item, DeviceEvent)]


def test_a_drive_that_starts_again_or_leaves_operation_is_an_event() -> None:
    beat = cia301.cob_heartbeat(DEVICES["drive"].node_id)
    states = [0x05, 0x05, 0x85, 0x00, 0x7F, 0x7F, 0x05, 0x04, 0x33]
    events = heard(*((beat, bytes([state])) for state in states))
    reported = [(e.kind, e.facts.get("network_state"), e.facts.get("operational")) for e in events]
    assert reported == [
        ("restart", None, None),
        ("network", 0x7F, False),
        ("network", 0x05, True),
        ("network", 4, False),
    ]
    assert heard((beat + 1, b"\x00"), (beat, b""), (beat, b"\x05")) == []
    assert [e.facts["network_state"] for e in heard((beat, b"\x04"))] == [4]  # found in this state, not started


def test_what_else_is_on_the_bus_is_not_the_drives() -> None:
    """29-bit frames and remote requests whose numbers look like those of the drive."""
    node = DEVICES["drive"].node_id
    report = cia402.VELOCITY.pack(0x0627, 600)
    pipeline = DrivePipeline("drive", DEVICES["drive"], {})
    others = [
        CanFrame(cia301.cob_tpdo(1, node), cia402.VELOCITY.pack(0x0608, -5), extended=True),
        CanFrame(cia301.cob_tpdo(1, node), bytes(4), remote=True),
        CanFrame(cia301.cob_emergency(node), bytes((0x10, 0x23, 1, 0, 0, 0, 0, 0)), extended=True),
        CanFrame(cia301.cob_heartbeat(node), b"\x00", extended=True),
        CanFrame(cia301.cob_rpdo(1, node), cia402.VELOCITY.pack(0x0F, 999), extended=True),
    ]
    own = CanFrame(cia301.cob_tpdo(1, node), report)
    control = DriveControl(DEVICES["drive"], lambda data: None, HostClock())
    items = []
    for k, frame in enumerate([own, *[f for other in others for f in (other, own)]]):
        items += pipeline.feed(RX, encode(frame), START_NS + k)
        control.take_frames(decode(encode(frame)).frames)
        assert (control.state, control.actual_rpm, control.emergencies) == (cia402.state(0x0627), 600.0, [])
    batches = [x for x in items if isinstance(x, Batch)]
    assert [float(b.columns["speed_rpm"][0]) for b in batches] == [600.0] * 6
    assert all(b.columns["target_rpm"][0] == 0 for b in batches)
    assert [x.kind for x in items if isinstance(x, DeviceEvent)] == ["drive"]


def test_a_report_may_be_longer_and_one_that_is_too_short_is_an_event() -> None:
    identifier = cia301.cob_tpdo(1, DEVICES["drive"].node_id)
    pipeline = DrivePipeline("drive", DEVICES["drive"], {})
    items = []
    for data in (cia402.VELOCITY.pack(0x0627, -600) + b"\x02", b"\x27\x06", b"\x27\x06"):
        items += pipeline.feed(RX, encode(CanFrame(identifier, data)), START_NS)
    assert [b.columns["speed_rpm"].tolist() for b in items if isinstance(b, Batch)] == [[-600.0]]
    assert [x.kind for x in items if isinstance(x, DeviceEvent)] == ["drive", "mapping"]
    assert "have 2 bytes" in pipeline.status.complaint


def test_an_emergency_keeps_its_makers_bytes() -> None:
    identifier = cia301.cob_emergency(DEVICES["drive"].node_id)
    with_bytes, without = heard((identifier, bytes.fromhex("1042 11 0102030405")), (identifier, bytes(8)))
    assert with_bytes.facts == {"error_code": 0x4210, "register": 0x11, "maker_bytes": "01 02 03 04 05"}
    assert without.facts == {"error_code": 0, "register": 0}
