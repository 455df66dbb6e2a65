"""Losses of a log, from each of the places where they are stored."""

import json

import pytest

from daq.errors import LogError
from daq.items import DeviceEvent
from daq.log import open_log
from daq.log.content import event_content
from daq.log.file import LogFile
from daq.log.losses import Losses, losses_of

START = 1_700_000_000_000_000_000


def write(path, summary=None, health=(), events=()):
    with LogFile(path, {}, {}, ("laser_x",), START) as log:
        for facts in health:
            log.note("health", {"kind": "health", **facts}, START, START)
        for event in events:
            log.event(event, START)
        if summary is not None:
            return log.finish(summary)
        log.flush()
    return log.part


GAPS = [
    DeviceEvent("gap", "laser_x", "3 samples lost", {"samples": 3}),
    DeviceEvent("damage", "laser_x", "5 bytes skipped", {"bytes": 5}),
    DeviceEvent("gap", "encoder", "2 radio frames lost", {"radio_frames": 2}),
    DeviceEvent("reply", "laser_x", "ok", {"samples": 1000}),
]
COUNTED = {"laser_x": {"samples": 3, "bytes": 5}, "encoder": {"radio_frames": 2}}


def test_losses_of_a_finished_log_are_those_of_its_summary(tmp_path):
    counted = {"laser_x": {"samples": 3, "invalid": 7}}
    with open_log(write(tmp_path / "a.mcap", {"losses": counted}, [{"losses": {"x": {"samples": 9}}}])) as log:
        losses = losses_of(log)
    assert (losses.by_device, losses.source, losses.total) == (counted, "summary", 3)
    assert losses.flat == {"laser_x.samples": 3, "laser_x.invalid": 7}
    assert losses.words() == "laser_x 3 samples, laser_x 7 invalid"


def test_losses_of_a_cut_log_are_those_of_its_last_health_report_or_events(tmp_path):
    reports = [{"losses": {"laser_x": {"samples": 1}}}, {"losses": {"laser_x": {"samples": 2}}}, {"rates": 1}]
    with open_log(write(tmp_path / "a.mcap", None, reports, GAPS)) as log:
        assert losses_of(log).by_device == {"laser_x": {"samples": 2}}
        assert losses_of(log).source == "health"
    with open_log(write(tmp_path / "b.mcap", None, (), GAPS)) as log:
        assert losses_of(log).by_device == COUNTED
        assert (losses_of(log).source, losses_of(log).total) == ("events", 5)  # 5 bytes are those of the 3 samples
    with open_log(write(tmp_path / "c.mcap")) as log:
        assert (losses_of(log).by_device, losses_of(log).words()) == ({}, "unknown: it counts none")
        assert losses_of(log).source == "none"
    with open_log(write(tmp_path / "d.mcap", None, (), GAPS[-1:])) as log:
        assert (losses_of(log).source, losses_of(log).words()) == ("events", "nothing lost")


def test_a_silence_counts_for_the_device_whose_channel_was_silent(tmp_path):
    silence = {"of": "encoder", "channel": "tacho"}
    events = [
        DeviceEvent("silence", "host", "tacho: silent", {**silence, "since_ns": START}),
        DeviceEvent("silence", "host", "tacho: came back", {**silence, "tacho_silent_ms": 1500, "span_s": 1.5}),
        DeviceEvent("silence", "host", "tacho: silent", {**silence, "since_ns": START}),
        DeviceEvent("silence", "host", "tacho: still silent", {**silence, "tacho_silent_ms": 250, "span_s": 0.25}),
    ]
    with open_log(write(tmp_path / "a.mcap", None, (), events)) as log:
        assert losses_of(log).by_device == {"encoder": {"tacho_silent_ms": 1750}}
        assert losses_of(log).words() == "encoder 1750 tacho silent ms"
        assert event_content(log.events, START).lost == {"encoder": {"silence": (2, 1.75)}}


@pytest.mark.parametrize("hostile", [5, [1], {"laser_x": 5}, {"laser_x": {"samples": "many"}}, {"x": {"y": [1]}}])
def test_what_is_no_count_is_refused_in_words(tmp_path, hostile):
    with (
        open_log(write(tmp_path / "a.mcap", {"losses": hostile})) as log,
        pytest.raises(LogError, match="expected loss"),
    ):
        losses_of(log)
    with open_log(write(tmp_path / "b.mcap", {"losses": {}})) as log:
        log.metadata["summary"]["losses"] = "[" * 100_000
        with pytest.raises(LogError, match="expected loss"):
            losses_of(log)
        log.metadata["summary"]["losses"] = json.dumps({"laser_x": {"samples": 1e999}})
        with pytest.raises(LogError, match="expected loss"):
            losses_of(log)


def test_a_lost_frame_and_its_samples_count_once() -> None:
    losses = Losses({"encoder": {"radio_frames": 2, "samples": 40}, "drive": {"damaged_lines": 1}}, "summary")
    assert losses.total == 41
    assert losses.words() == "encoder 40 samples (with 2 radio frames), drive 1 damaged line"
    assert Losses({"laser": {"samples": 1, "damaged": 3}}, "summary").words() == "laser 1 sample (with 3 damaged)"
    assert Losses({"encoder": {"radio_frames": 2, "samples": 0}}, "summary").total == 2  # frames without known samples
