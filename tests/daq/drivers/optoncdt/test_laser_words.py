"""Text on a laser's line: for any content and position, the stream decides its words."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from daq.drivers.optoncdt import sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.stream import DEFAULT_WORDS, LaserPipeline
from daq.errors import DeviceError
from daq.items import RX, Batch, DeviceEvent
from rig_configs import load_rig
from tests.effort import cases

DEVICES = load_rig("virtual").devices
START_NS = 1_700_000_000_000_000_000
NAMES = ("DIST", "COUNTER", "TIMESTAMP", "INTENSITY", "SHUTTER", "STATE", "DIST_RAW", "TEMP", "FOO", "LINEAR1")
ORDERS = st.lists(st.sampled_from(NAMES), min_size=1, max_size=6)


def pipeline(identity: dict[str, object] | None = None) -> LaserPipeline:
    return LaserPipeline("laser_x", DEVICES["laser_x"], identity or {})


def answer(*names: str) -> bytes:
    return " ".join(("GETOUTINFO_RS422", *names)).encode() + b"\r\n->"


def stream(names: tuple[str, ...] | list[str], counter: np.ndarray) -> bytes:
    """Blocks of these outputs at 4 kHz, the distance growing with the counter."""
    words = sensor_answers.parse_outinfo(" ".join(("GETOUTINFO_RS422", *names)))
    ticks = 25 * counter
    columns = {
        "DIST": 30_000 + 3 * counter % 1000,
        "COUNTER": counter % 2**18,
        "TIMESTAMP_LO": ticks & 0xFFFF,
        "TIMESTAMP_HI": (ticks >> 16) & 0xFFFF,
    }
    return optoncdt.encode_block(np.column_stack([columns.get(w, np.full(len(counter), 1234)) for w in words]))


def fed(parts: list[bytes], laser: LaserPipeline) -> tuple[list[tuple[int, ...]], list[DeviceEvent]]:
    """Samples as (code, counter, ticks, flags), and events; the host's time goes on by the bytes."""
    rows: list[tuple[int, ...]] = []
    events: list[DeviceEvent] = []
    seen = 0
    for part in (*parts, b""):  # to the end of a log: samples that wait are then decided
        seen += len(part)
        for item in laser.feed(RX, part, START_NS + seen * 20_000):
            if isinstance(item, Batch):
                fields = (item.columns[name] for name in ("code", "counter", "device_ticks", "flags"))
                rows += zip(*(field.tolist() for field in fields), strict=True)
            else:
                events.append(item)
    return rows, events


def split(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [data[a:b] for a, b in itertools.pairwise(edges)]


K = np.arange(70_000, 70_080)
USUAL = ("DIST", "COUNTER", "TIMESTAMP")


@settings(max_examples=cases(20, 60))
@given(ORDERS, st.integers(0, 77), st.lists(st.integers(0, 2000), max_size=6))
@example(["DIST"], 40, [])
@example(["DIST", "TIMESTAMP", "COUNTER"], 40, [])
@example(["NONE"], 40, [])
def test_an_answer_that_is_not_true_costs_nothing(announced: list[str], at: int, cuts: list[int]) -> None:
    # three blocks behind an answer decide; fewer, at a log's very end, wait undecoded
    data = stream(USUAL, K[:at]) + answer(*announced) + stream(USUAL, K[at:])
    laser = pipeline()
    rows, events = fed(split(data, cuts), laser)
    assert [row[1] for row in rows] == (K % 2**18).tolist()
    assert {name: n for name, n in laser.losses.items() if n} == {}
    assert "restart" not in {event.kind for event in events}
    assert sum(event.kind == "reply" for event in events) == 2


def test_an_answer_that_is_not_true_is_reported_with_its_words() -> None:
    data = stream(USUAL, K[:40]) + answer("DIST", "INTENSITY", "COUNTER") + stream(USUAL, K[40:])
    _, events = fed([data], pipeline())
    assert [event.text for event in events if event.kind == "words"] == [
        "an answer announces the words DIST INTENSITY COUNTER, the stream does not consist of them: ignored"
    ]


def test_an_answer_that_repeats_the_present_words_changes_nothing() -> None:
    data = stream(USUAL, K[:40]) + answer("DIST", "INTENSITY") + answer(*USUAL) + stream(USUAL, K[40:])
    rows, events = fed([data], pipeline())
    assert [row[1] for row in rows] == (K % 2**18).tolist()
    assert [event.text for event in events if event.kind == "words"] == []


@pytest.mark.parametrize(
    "announced",
    [
        ("DIST", "TIMESTAMP", "COUNTER"),
        ("DIST", "INTENSITY", "COUNTER", "TIMESTAMP"),
        ("DIST1", "COUNTER", "TIMESTAMP"),
        ("COUNTER", "TIMESTAMP", "DIST"),
        ("TIMESTAMP", "STATE", "DIST", "COUNTER"),
        ("COUNTER", "DIST", "TIMESTAMP"),
    ],
)
@pytest.mark.parametrize("cut", [1, 13, 10_000])
def test_a_true_answer_holds_from_its_own_place_on(announced: tuple[str, ...], cut: int) -> None:
    data = stream(USUAL, K[:40]) + answer(*announced) + stream(announced, K[40:])
    laser = pipeline()
    rows, events = fed([data[i : i + cut] for i in range(0, len(data), cut)], laser)
    assert [row[:3] for row in rows] == [(30_000 + 3 * k % 1000, k % 2**18, 25 * k) for k in K.tolist()]
    assert not any(laser.losses.values())
    changed = sensor_answers.parse_outinfo("GETOUTINFO_RS422 " + " ".join(announced)) != DEFAULT_WORDS
    assert [event.kind for event in events].count("words") == changed


@pytest.mark.parametrize(
    "announced",
    [
        ("DIST",),
        ("DIST", "COUNTER"),
        ("DIST", "TIMESTAMP"),
        ("INTENSITY", "COUNTER"),
        ("DIST", "STATE", "SHUTTER", "TEMP"),
    ],
)
def test_words_without_counter_and_timestamp_are_counted_as_unusable(announced: tuple[str, ...]) -> None:
    laser = pipeline()
    rows, events = fed([stream(USUAL, K[:40]) + answer(*announced) + stream(announced, K[40:])], laser)
    assert len(rows) == 40
    assert {name: n for name, n in laser.losses.items() if n} == {"unusable": 40}
    assert any("no samples without" in event.text for event in events)


@settings(max_examples=cases(20, 40), deadline=None)
@given(ORDERS, ORDERS, st.data())
def test_no_words_and_no_text_invent_losses_or_break_it(
    true: list[str], announced: list[str], data: st.DataObject
) -> None:
    wire = bytearray(stream(USUAL, K[:20]) + answer(*announced) + stream(true, K[20:]) + stream(USUAL, K[:9] + 80))
    for place in data.draw(st.lists(st.integers(0, len(wire) - 1), max_size=3)):
        how = data.draw(st.sampled_from(["flip", "drop", "answer", "half an answer"]))
        if how == "flip":
            wire[place % len(wire)] ^= 1 << data.draw(st.integers(0, 7))
        elif how == "drop":
            del wire[place % len(wire)]
        else:
            wire[place:place] = answer(*announced)[: None if how == "answer" else 25]
    cuts = data.draw(st.lists(st.integers(0, len(wire)), max_size=20))
    whole, by_byte, parts = pipeline(), pipeline(), pipeline()
    rows, _ = fed([bytes(wire)], whole)
    assert fed([bytes(wire[i : i + 1]) for i in range(len(wire))], by_byte)[0] == rows
    assert fed(split(bytes(wire), cuts), parts)[0] == rows
    decided_by_time = {"samples": 0}  # lost ones, or a new start of the sensor
    assert whole.losses | decided_by_time == by_byte.losses | decided_by_time == parts.losses | decided_by_time
    assert 0 <= whole.losses["samples"] <= 4000 * (2 + len(wire) * 20e-6)


def test_an_endless_flow_of_answers_keeps_nothing() -> None:
    laser = pipeline()
    fed([stream(USUAL, K)], laser)
    fed([answer("DIST", name) for name in itertools.islice(itertools.cycle(("STATE", "TEMP")), 400)], laser)
    assert laser._trial is None or len(laser._trial.held) <= 4096
    rows, _ = fed([stream(USUAL, K[-1] + 1 + np.arange(60))], laser)
    assert len(rows) == 60


@pytest.mark.parametrize(
    "identity",
    [
        {"words": []},
        {"words": "DIST"},
        {"words": [1, 2]},
        {"words": None},
        {"words": ["DIST"] * 99},
        {"range_m": "wide"},
        {"range_m": float("nan")},
        {"range_m": -1},
        {"range_m": True},
        {"range_m": None},
    ],
)
def test_an_invalid_identity_is_refused_with_a_message(identity: dict[str, object]) -> None:
    with pytest.raises(DeviceError, match="laser_x: expected"):
        pipeline(identity)


def test_the_distance_is_found_wherever_it_stands() -> None:
    words = sensor_answers.parse_outinfo
    assert words("GETOUTINFO_RS422 LINEAR COUNTER")[0] == "DIST"
    assert words("GETOUTINFO_RS422 COUNTER DIST_RAW DIST1") == ("COUNTER", "DIST_RAW", "DIST")
    assert "DIST" not in words("GETOUTINFO_RS422 SHUTTER INTENSITY")
    with pytest.raises(DeviceError, match="at most"):
        words("GETOUTINFO_RS422" + " DIST" * 40)


@pytest.mark.parametrize("outputs", [["DIST"], ["DIST", "COUNTER"]])
def test_a_stream_of_other_words_from_the_beginning_on_is_counted_and_stated(outputs: list[str]) -> None:
    """A sensor that is only listened to, and sends the distance alone as it does when it is new."""
    data = stream(outputs, np.arange(2000))
    laser = pipeline()
    rows, events = fed([data[at : at + 50] for at in range(0, len(data), 50)], laser)
    assert rows == []
    assert len(data) - 3 * len(outputs) <= laser.losses["bytes"] <= len(data)
    assert sum(event.facts.get("bytes", 0) for event in events if event.kind == "damage") == laser.losses["bytes"]
    (words,) = [event.text for event in events if event.kind == "words"]
    assert "without a block of the words DIST COUNTER TIMESTAMP_LO TIMESTAMP_HI: the sensor sends other words" in words


@pytest.mark.parametrize(("before", "lost"), [(1023, 0), (1026, 1026)])
def test_bytes_before_the_first_block_count_if_they_are_many(before: int, lost: int) -> None:
    begin = stream(["DIST"], np.arange(before // 3))
    laser = pipeline()
    rows, _ = fed([begin, stream(["DIST", "COUNTER", "TIMESTAMP"], np.arange(500))], laser)
    assert len(rows) == 500
    assert laser.losses["bytes"] == lost
