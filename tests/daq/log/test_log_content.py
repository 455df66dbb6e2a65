"""Contents of a log: the same in parts as in one piece."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.channels import HEALTH_TOPIC, LASER_X, RX, TX
from daq.items import Batch, DeviceEvent
from daq.log import Log, content as log_content, open_log
from daq.log.content import (
    RawContent,
    channel_content,
    event_content,
    events_of,
    last_health,
    raw_content,
    stretches,
)
from daq.log.file import LogFile

T0 = 1_700_000_000_000_000_000
S = 10**9


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """Forty seconds: laser at 20 Hz from 3 s to 33 s, raw bytes both ways, events, a health report each second."""
    path = tmp_path_factory.mktemp("content") / "run.mcap"
    with LogFile(path, {}, {}, ("laser_x",), T0) as file:
        for second in range(40):
            now = T0 + second * S
            file.raw("laser_x", RX, b"1234", now)
            if second % 10 == 0:
                file.raw("laser_x", TX, b"query", now)
                file.event(
                    DeviceEvent("gap", "laser_x", f"{second} samples lost", {"samples": second, "span_s": 0.25}), now
                )
                file.event(DeviceEvent("reply", "laser_x", "OK"), now)
            if 3 <= second < 33:
                k = np.arange(20)
                columns = {"displacement_m": 1e-3 * k, "code": k, "counter": k, "device_ticks": k, "flags": 0 * k}
                file.batch(Batch(LASER_X, now - 30_000_000 + k * S // 20, k.astype(np.uint32), columns), now)
            file.note(HEALTH_TOPIC, {"kind": "health", "number": second}, now, now)
            file.flush()
        return open_log(file.finish({}))


@pytest.mark.parametrize("messages", [10**6, 100, 37, 1])
def test_stretches_are_the_log_once(log: Log, messages: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_content, "_STRETCH_MESSAGES", messages)
    parts = list(stretches(log))
    assert len(parts) == -(-sum(log.count(topic) for topic in log.topics) // messages)
    assert [share for share, _ in parts][-1] == 1.0
    times = np.concatenate([part["laser/x"].time_ns for _, part in parts])
    assert np.array_equal(times, log["laser/x"].time_ns)
    assert [event for _, part in parts for event in part.events] == log.events == list(events_of(log))


def test_raw_bytes_are_counted_both_ways(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    assert raw_content(log) == raw_content(log, thorough=False) == {"laser_x": RawContent(44, 160, 20)}
    monkeypatch.setattr(log_content, "_READS_COUNTED", 43)
    assert raw_content(log) == {"laser_x": RawContent(44, 160, 20)}
    assert raw_content(log, thorough=False) == {"laser_x": RawContent(44, None, None)}


def test_a_channel_is_known_by_its_ends(log: Log) -> None:
    found = channel_content(log, "laser/x")
    assert found.samples == 600
    assert found.span_s == pytest.approx(29.95)
    assert found.rate_Hz == pytest.approx(20.0)
    assert channel_content(log, "laser/y") == log_content.ChannelContent(0, 0.0, 0.0)


def test_the_last_health_report(log: Log, tmp_path: Path) -> None:
    report = last_health(log)
    assert (report["number"], report["time_ns"]) == (39, T0 + 39 * S)
    with LogFile(tmp_path / "run.mcap", {}, {}, (), T0) as file:
        assert last_health(open_log(file.finish({}))) is None


def test_events_alike_but_for_their_numbers_are_taken_together(log: Log) -> None:
    found = event_content(events_of(log), log.start_ns)
    assert found.kinds == Counter(gap=4, reply=4)
    gap, reply = found.lines
    assert (gap.text, gap.count, gap.first_s, round(gap.last_s, 9)) == ("0 samples lost", 4, 0.0, 30.0)
    assert (reply.kind, reply.device, reply.count) == ("reply", "laser_x", 4)
    assert found.lost == {"laser_x": {"gap": (4, 1.0)}}
    assert found.more == 0


@given(
    st.lists(
        st.dictionaries(st.sampled_from(["kind", "device", "text", "span_s"]), st.none() | st.text() | st.floats())
    )
)
def test_events_with_any_content_are_all_counted(events: list[dict[str, object]]) -> None:
    found = event_content(({**event, "time_ns": T0} for event in events), T0)
    assert sum(found.kinds.values()) == sum(line.count for line in found.lines) + found.more == len(events)


def test_room_for_kinds_of_events_is_bounded() -> None:
    events = ({"kind": "reply", "device": "laser_x", "text": "x" * number, "time_ns": T0} for number in range(1000))
    found = event_content(events, T0)
    assert len(found.lines) + found.more == 1000
    assert len(found.lines) == 200
