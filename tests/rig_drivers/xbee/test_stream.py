"""A node's payloads in API frames: the same samples as over a dongle's line, and the reports of a module."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.stream import NodePipeline
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.clock import SimulatedClock
from rig_drivers.xbee import framing
from rig_drivers.xbee.driver import DRIVER
from rig_drivers.xbee.settings import XBeeNode
from rig_drivers.xbee.stream import XBeePipeline

START_NS = 1_700_000_000_000_000_000

NODE, STRANGER = "0013A20041AEB54E", "0013A20099999999"
MODES = pytest.mark.parametrize("mode", [1, 2], ids=["AP=1", "AP=2"])
TYPES = pytest.mark.parametrize("kind", [0x90, 0x91, 0x80, 0x81], ids=hex)


def settings(mode: int = 2, address: str = NODE) -> XBeeNode:
    return XBeeNode.model_validate({"driver": "xbee", "port": "-", "node_address": address, "api_mode": mode})


def pipeline(mode: int = 2, address: str = NODE, **identity: Any) -> XBeePipeline:
    return XBeePipeline("encoder", settings(mode, address), identity)


def api(payload: bytes, mode: int = 2, kind: int = 0x90, source: str = NODE, rssi_dBm: int = -61) -> bytes:
    """A frame from the module."""
    address = bytes.fromhex(source)
    heads = {
        0x90: address + b"\xff\xfe\xc1",
        0x91: address + b"\xff\xfe\xe8\xe8\x00\x11\xc1\x05\xc1",
        0x80: address + bytes((-rssi_dBm, 0)),
        0x81: address + bytes((-rssi_dBm, 0)),
    }
    return framing.encode(bytes((kind,)) + heads[kind] + payload, escaped=mode == 2)


def module_frame(data: str, mode: int = 2) -> bytes:
    return framing.encode(bytes.fromhex(data), escaped=mode == 2)


def block(i: int, first_seq: int = 0, samples: int = 5) -> bytes:
    numbers = np.arange(samples) + samples * i
    counts = np.column_stack([3 * numbers - 40, 2048 + 17 * numbers]).astype(np.int32)
    return rotorlink.EncoderBlock(
        1, (first_seq + i) & 0xFFFF, int(numbers[0]), 4000 * int(numbers[0]) % 2**32, 4000, 96, counts
    ).pack()


def feed(into: NodePipeline, parts: list[bytes]) -> tuple[list[Batch], list[DeviceEvent]]:
    found = [item for i, part in enumerate([*parts, b""]) for item in into.feed(RX, part, START_NS + 20_000_000 * i)]
    return [x for x in found if isinstance(x, Batch)], [x for x in found if isinstance(x, DeviceEvent)]


def column(batches: list[Batch], name: str) -> np.ndarray:
    return np.concatenate([batch.columns[name] for batch in batches] or [np.empty(0, int)])


def same(first: list[Batch], second: list[Batch], times: bool = True) -> bool:
    return len(first) == len(second) and all(
        a.channel is b.channel
        and (not times or np.array_equal(a.time_ns, b.time_ns))
        and np.array_equal(a.sequence, b.sequence)
        and a.columns.keys() == b.columns.keys()
        and all(np.array_equal(a.columns[name], b.columns[name]) for name in a.columns)
        for a, b in zip(first, second, strict=True)
    )


PAYLOADS = [
    block(0),
    rotorlink.IndexMark(1, 1, 21_000, 33).pack(),
    rotorlink.NodeStatus(1, 2, 22_000, 3712, 315, 8, 0, 1, 4, 4096).pack(),
    rotorlink.LockEvent(1, 3, 23_000, 0, 1, 42).pack(),
    rotorlink.Acknowledge(1, 4, 42, 0).pack(),
    block(1, first_seq=4),
    block(3, first_seq=4),
]


@MODES
@TYPES
def test_the_same_items_as_over_a_dongle(mode: int, kind: int) -> None:
    source = "1234" if kind == 0x81 else NODE
    frames = [api(payload, mode, kind, source) for payload in PAYLOADS]
    of_module, own = pipeline(mode, source), NodePipeline("encoder", settings(), {})
    batches, events = feed(of_module, frames)
    expected_batches, expected_events = feed(own, [rotorlink.wire(payload) for payload in PAYLOADS])
    assert same(batches, expected_batches)
    assert events == expected_events
    assert of_module.status == own.status
    assert of_module.losses == {"radio_frames": 1, "damaged_frames": 0, "samples": 5, "foreign_frames": 0}


@given(st.sets(st.integers(1, 38), max_size=25))
def test_lost_frames_are_counted_across_the_wrap(lost: set[int]) -> None:
    into = pipeline()
    batches, events = feed(into, [api(block(i, 65_520)) for i in range(40) if i not in lost])
    assert into.losses["radio_frames"] == len(lost)
    assert into.losses["samples"] == 5 * len(lost) == sum(e.facts.get("samples", 0) for e in events)
    assert column(batches, "index").tolist() == [k for i in range(40) if i not in lost for k in range(5 * i, 5 * i + 5)]


def test_a_repeated_frame_gives_no_sample_twice_and_a_restart_restarts_the_counts() -> None:
    into = pipeline()
    late = rotorlink.EncoderBlock(1, 900, 10, 2_000_000, 4000, 96, np.zeros((5, 2), np.int32)).pack()
    batches, events = feed(
        into, [api(p) for p in (block(0, 898), block(0, 898), block(1, 898), late, block(0), block(1))]
    )
    assert column(batches, "index").tolist() == [*range(15), *range(10)]
    assert [event.kind for event in events] == ["clock", "restart"], "the time of the block after 10 samples is 2 s"


def test_frames_from_elsewhere_are_counted_and_reported_once() -> None:
    into = pipeline()
    strange = [api(block(i), source=STRANGER) for i in range(10)]
    batches, events = feed(into, [strange[0], api(block(0)), *strange[1:], api(block(1))])
    assert column(batches, "index").tolist() == list(range(10))
    assert into.losses["foreign_frames"] == 10
    assert [(e.kind, e.facts) for e in events] == [("foreign", {"source": STRANGER})]
    assert NODE in events[0].text


def test_many_foreign_frames_fill_neither_log_nor_memory() -> None:
    into = pipeline()
    _, events = feed(into, [api(block(0), source=f"0013A200{i:08X}") for i in range(200)] * 2)
    assert [event.facts["source"] for event in events] == [f"0013A200{i:08X}" for i in range(16)]
    assert into.losses["foreign_frames"] == 400


def test_a_frame_that_names_no_sender_is_not_taken_for_the_nodes() -> None:
    for address, kind, source in (
        (NODE, 0x90, "F" * 16),
        (NODE, 0x81, "1234"),
        ("1234", 0x80, NODE),
        ("1234", 0x90, NODE),
    ):
        into = pipeline(address=address)
        batches, events = feed(into, [api(block(0), kind=kind, source=source)])
        assert batches == []
        assert [event.kind for event in events] == ["foreign"]


def test_signal_strength_of_a_frame_an_answer_or_the_opening() -> None:
    into = pipeline(rssi_dBm=-70)
    assert into.rssi_dBm == -70
    feed(into, [api(block(0), kind=0x80, rssi_dBm=-61)])
    assert into.rssi_dBm == -61
    feed(into, [module_frame("88 07 44 42 00 28")])
    assert into.rssi_dBm == -40
    feed(
        into,
        [
            module_frame("88 07 44 42 00 00"),
            module_frame("88 07 44 42 01"),
            module_frame("88 07 44 42 00"),
            api(block(1)),
        ],
    )
    assert into.rssi_dBm == -40
    feed(into, [module_frame("88 01 44 42 00 01 00")])
    assert into.rssi_dBm == -256
    for known in ("strong", "-50", True):
        assert pipeline(rssi_dBm=known).rssi_dBm is None


@pytest.mark.parametrize(
    ("data", "kind", "text", "facts"),
    [
        ("8A 00", "modem", "hardware reset", {"status": 0, "restart": True}),
        ("8A 01", "modem", "watchdog", {"status": 1, "restart": True}),
        ("8A 06", "modem", "started a network", {"status": 6, "restart": False}),
        ("8A 99", "modem", "0x99", {"status": 0x99, "restart": False}),
        ("8B 05 FF FE 00 21 00", "acknowledge", "out of reach", {"frame_id": 5, "delivery_status": 0x21}),
        ("89 05 01", "acknowledge", "out of reach", {"frame_id": 5, "delivery_status": 1}),
        ("89 05 EE", "acknowledge", "0xEE", {"frame_id": 5, "delivery_status": 0xEE}),
        ("88 01 41 50 00 02", "reply", "1 AP 02 ok", {"frame_id": 1, "command": "AP", "status": 0}),
        ("88 01 4E 50 02", "reply", "1 NP  invalid command", {"frame_id": 1, "command": "NP", "status": 2}),
        ("88 01 41 50 04 02", "reply", "transmission failed", {"frame_id": 1, "command": "AP", "status": 4}),
        ("88 01 4E 50 77", "reply", "status 119", {"frame_id": 1, "command": "NP", "status": 0x77}),
        ("92 01 02", "foreign", "0x92", {"frame_type": 0x92}),
    ],
)
def test_words_of_the_module(data: str, kind: str, text: str, facts: dict[str, Any]) -> None:
    into = pipeline()
    (event,) = into.feed(RX, module_frame(data), START_NS)
    assert isinstance(event, DeviceEvent)
    assert (event.kind, event.facts, event.device) == (kind, facts, "encoder")
    assert text in event.text
    assert not any(into.losses.values())


def test_a_delivered_request_is_no_acknowledgement() -> None:
    assert pipeline().feed(RX, module_frame("8B 05 FF FE 00 00 00") + module_frame("89 05 00"), START_NS) == []


def test_what_went_out_gives_nothing() -> None:
    assert pipeline().feed(TX, api(block(0)), START_NS) == []


def test_damage_is_counted_with_its_reason() -> None:
    crc = bytearray(block(1))
    crc[8] ^= 1
    torn = bytearray(api(block(2)))
    torn[-1] ^= 1
    wrapped = rotorlink.Wrapped(1, 500, 9_000_000, -61, rotorlink.IndexMark(1, 10, 2_050_000, 33)).pack()
    into = pipeline()
    parts = [
        api(block(0)),
        api(bytes(crc)),
        bytes(torn),
        b"\x01\x02",
        api(wrapped),
        module_frame("8B 05"),
        api(b""),
        api(block(5)),
    ]
    batches, events = feed(into, parts)
    reasons = [e.facts["reason"] for e in events if e.kind == "damage"]
    assert reasons == ["payload crc", "checksum", "payload type", "length", "payload length"]
    assert into.losses == {"radio_frames": 4, "damaged_frames": 5, "samples": 20, "foreign_frames": 0}
    assert column(batches, "index").tolist() == [*range(5), *range(25, 30)]


@MODES
def test_the_other_mode_than_the_modules_is_seen_at_once(mode: int) -> None:
    """Every frame from a 64-bit address holds a byte that one mode escapes and the other does not."""
    into = pipeline(mode)
    batches, _ = feed(into, [api(block(i), mode=3 - mode) for i in range(60)])
    assert batches == []
    assert into.losses["damaged_frames"] > 50


@MODES
def test_what_follows_damage_in_the_same_read_is_decoded(mode: int) -> None:
    torn = bytearray(api(block(9), mode))
    torn[-1] ^= 1
    wrong_crc = block(9)[:-1] + b"\x00"
    for damage in (b"\x01\x02", bytes(torn), module_frame("8B 05", mode), api(wrong_crc, mode)):
        into = pipeline(mode)
        batches, events = feed(into, [api(block(0), mode) + damage + api(block(1), mode)])
        assert column(batches, "index").tolist() == list(range(10))
        assert [event.kind for event in events] == ["damage"]
        assert into.losses == {"radio_frames": 0, "damaged_frames": 1, "samples": 0, "foreign_frames": 0}


@pytest.mark.parametrize(
    ("kind", "lost"), [(0x0F, 1), (0x10, 0), (0x1F, 0), (0x20, 1), (0x25, 1), (0x2F, 1), (0x90, 1)], ids=hex
)
def test_a_frame_of_an_unknown_type_has_a_number_of_the_node_only_if_it_is_of_a_node(kind: int, lost: int) -> None:
    into = pipeline()
    unknown = [rotorlink.encode_frame(bytes((kind, 1, seq, 0, 7))) for seq in (1, 1)]
    batches, events = feed(into, [api(p) for p in (block(0), *unknown, block(1, first_seq=1))])
    assert column(batches, "index").tolist() == list(range(10))
    assert [e.facts["reason"] for e in events if e.kind == "damage"] == ["payload type"] * 2
    assert into.losses == {"radio_frames": lost, "damaged_frames": 2, "samples": 0, "foreign_frames": 0}


def test_only_the_answer_to_db_has_the_signal_strength() -> None:
    for command in ("4150", "4441", "4443", "4E49", "5342"):
        into = pipeline(rssi_dBm=-50)
        feed(into, [module_frame(f"88 01 {command} 00 3d")])
        assert into.rssi_dBm == -50


MS = 1_000_000
STATUS = rotorlink.NodeStatus(1, 0, 1000, 3700, 250, 8, 0, 1, 4, 4096).pack()
ANSWER = "88 01 41 50 00 02"


def heard(*frames: bytes, into: XBeePipeline | None = None) -> str:
    made = into or pipeline()
    for i, frame in enumerate(frames):
        made.feed(RX, frame, START_NS + 20 * MS * i)
    return made.status.complaint


def test_the_complaint_names_the_address_from_which_a_node_sends() -> None:
    third = "0013A20088888888"
    text = f"frames from {STRANGER} ignored: the rig file states node_address = {NODE}"
    assert heard(api(block(0), source=STRANGER), api(b"T=21.5", source=third)) == text
    assert heard(api(b"T=21.5", source=third), api(block(0), source=STRANGER)) == text
    assert third in heard(api(b"T=21.5", source=third))


def test_there_is_no_complaint_about_other_senders_once_the_node_is_received() -> None:
    stranger = api(block(0), source=STRANGER)
    assert heard(stranger, api(block(0)), stranger) == ""
    assert heard(stranger, api(STATUS), stranger) == ""


@pytest.mark.parametrize(("payload", "reason"), [(block(0)[:30], "crc"), (rotorlink.wire(block(0)), "crc")])
def test_the_complaint_explains_payloads_that_are_no_frames_of_a_node(payload: bytes, reason: str) -> None:
    text = heard(api(STATUS), api(payload))
    assert text.startswith(f"frames from {NODE} contain no whole payload of a node (payload {reason})")
    assert heard(api(payload), api(block(0)), api(payload)) == ""


def test_a_node_without_angles_needs_no_block() -> None:
    marks = settings().model_copy(update={"angles": False})
    assert heard(api(STATUS), api(b"damaged"), into=XBeePipeline("encoder", marks, {})) == ""


def transparent(seconds: float, start_ns: int) -> Iterator[tuple[bytes, int]]:
    """Payloads of a module in transparent mode."""
    return ((block(i, samples=10), start_ns + 40 * MS * i) for i in range(int(seconds * 25)))


def test_a_module_that_restarts_in_another_mode_is_recognised_until_it_answers() -> None:
    line = pipeline()
    line.feed(RX, api(block(0)), START_NS)
    for data, host_ns in transparent(1.9, START_NS + 40 * MS):
        line.feed(RX, data, host_ns)
        assert not line.status.set_up_lost
    for data, host_ns in transparent(1.0, START_NS + 2000 * MS):
        line.feed(RX, data, host_ns)
    assert "no API frame for 2 s" in line.status.set_up_lost
    line.feed(TX, module_frame("08 01 41 50"), START_NS + 3000 * MS)
    assert line.status.set_up_lost, "a request alone does not show that the module is set up"
    line.feed(RX, module_frame(ANSWER), START_NS + 3010 * MS)
    assert not line.status.set_up_lost


def test_a_silence_within_a_frame_is_no_other_mode() -> None:
    line, frame = pipeline(), api(block(0))
    for i, (data, after_ms) in enumerate([(frame, 0), (frame[:20], 0), (frame[20:40], 5000), (frame[40:], 5001)]):
        line.feed(RX, data, START_NS + (after_ms + i) * MS)
        assert not line.status.set_up_lost
    assert line.losses["damaged_frames"] == 0


def test_a_short_burst_of_noise_is_no_other_mode() -> None:
    line = pipeline()
    line.feed(RX, bytes(5000), START_NS)
    line.feed(RX, bytes(5000), START_NS + 1999 * MS)
    assert not line.status.set_up_lost
    line.feed(RX, bytes(1), START_NS + 2001 * MS)
    assert line.status.set_up_lost


@pytest.mark.parametrize(("legacy", "advised"), [(False, True), (True, False)])
def test_a_request_without_any_status_may_be_of_a_type_that_the_module_does_not_execute(
    legacy: bool, advised: bool
) -> None:
    config = settings().model_copy(update={"legacy_transmit": legacy})
    with pytest.raises(DeviceError, match="after 20 tries") as error:
        DRIVER.locks(config, lambda data: None, SimulatedClock()).command("lock A", lambda: None)
    assert ("legacy_transmit = true" in str(error.value)) is advised
