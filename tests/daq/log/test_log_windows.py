"""Parts of a log by time, the reads they need, and files that change or fail while they are open."""

import os

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq import channels as ch
from daq.errors import ChannelMissing, LogError
from daq.log import open_log
from daq.mcap.file_bytes import FileBytes
from daq.mcap.writer import LIBRARY
from tests.daq.mcap.written import T0, add_channel, marks, written
from tests.effort import cases

MS = 10**6


def record(blocks, finish=True, compression="zstd"):
    """A log of (log time, sample times) blocks in ms, a chunk each; raw bytes and an event with each block."""
    return written(lambda writer: add_blocks(writer, blocks), finish=finish, compression=compression)


def add_blocks(writer, blocks):
    tacho = add_channel(writer)
    raw = writer.register_channel(
        "raw/encoder", "protobuf", writer.register_schema(ch.RAW_SCHEMA_NAME, "protobuf", ch.raw_descriptor_set())
    )
    events = writer.register_channel("events", "json", 0)
    for number, (log_ms, sample_ms) in enumerate(blocks):
        now, times = T0 + log_ms * MS, T0 + np.array(sample_ms, np.int64) * MS
        writer.add_block(tacho, now, times, np.arange(len(times)), marks(np.full(len(times), number)))
        writer.add_message(raw, now, now, 0, ch.pack_raw(0, bytes([number % 256])))
        if sample_ms:
            writer.add_message(events, now, int(times[0]), 0, ch.pack_note({"kind": "beat", "number": number}))
        writer.flush()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.mcap"


TIMES = st.integers(0, 60)


@settings(max_examples=cases(20, 60), deadline=None)
@given(
    st.lists(st.tuples(TIMES, st.lists(TIMES, max_size=5)), min_size=1, max_size=12),
    TIMES,
    TIMES,
    st.booleans(),
    st.sampled_from(["zstd", "none"]),
)
def test_a_window_holds_exactly_what_lies_in_it(tmp_path_factory, blocks, low, high, finish, compression):
    """For any delay of the samples: those of the whole log within the window, in its order."""
    path = tmp_path_factory.mktemp("window") / "run.mcap"
    path.write_bytes(record(blocks, finish, compression))
    start, end = T0 + low * MS, T0 + high * MS
    with open_log(path) as log:
        part = log.between(start, end)
        whole, some = log["tacho"], part["tacho"]
        rows = (whole.time_ns >= start) & (whole.time_ns < end)
        for name in ("revolutions", "node_time_us"):
            assert np.array_equal(some[name], whole[name][rows])
        assert np.array_equal(some.time_ns, whole.time_ns[rows])
        assert np.array_equal(some.log_time_ns, whole.log_time_ns[rows])
        assert np.array_equal(some.sequence, whole.sequence[rows])
        parts = list(part.parts("tacho", rows=3))
        assert np.array_equal(np.concatenate([each.sequence for each in parts]), some.sequence)
        assert np.array_equal(np.concatenate([each["revolutions"] for each in parts]), some["revolutions"])
        assert max(len(each) for each in log.parts("tacho", rows=3)) < 3 + 5
        assert part.raw("encoder") == [chunk for chunk in log.raw("encoder") if start <= chunk.host_ns < end]
        assert part.events == [event for event in log.events if start <= event["time_ns"] < end]
        assert (part.count("tacho"), part.count("raw/encoder")) == (len(some), len(part.raw("encoder")))
        assert part.topics == log.topics
        narrower = part.between(start + 5 * MS, end + 100 * MS)
        assert narrower.window_ns == (start + 5 * MS, end)


def test_only_the_chunks_that_are_needed_are_read(path, monkeypatch):
    path.write_bytes(record([(k, [k]) for k in range(200)]))
    read = []
    plain = FileBytes.read
    monkeypatch.setattr(
        FileBytes, "read", lambda self, start, length: read.append(length) or plain(self, start, length)
    )
    with open_log(path) as log:
        opened = sum(read)
        assert len(log.between(T0 + 100 * MS, T0 + 103 * MS)["tacho"]) == 3
        assert len(log.between(T0 + 100 * MS, T0 + 103 * MS).events) == 3
    assert sum(read) - opened < 20 * log.size_bytes / 200


def test_attributes_of_a_log_and_of_a_window(path):
    data = record([(5, [1, 2]), (9, [8])])
    path.write_bytes(data)
    with open_log(path) as log:
        assert (log.start_ns, log.end_ns) == (T0 + 5 * MS, T0 + 9 * MS)
        part = log.between(T0 + 2 * MS, T0 + 100 * MS)
        assert (part.start_ns, part.end_ns) == (T0 + 5 * MS, T0 + 9 * MS)
        assert (part.between(0, 1).start_ns, part.between(0, 1).end_ns) == (0, 0)
        assert (log.size_bytes, log.chunk_count) == (len(data), 2)
        assert log.library == LIBRARY
        assert log.channel("tacho").fields == ch.TACHO.fields
        with pytest.raises(ChannelMissing, match="raw/encoder"):
            log.channel("raw/encoder")
        assert log.verify() == []
        with part:
            pass
        assert len(log["tacho"]) == 3  # closing a part leaves the log open
    for read in (lambda: log.events, lambda: part["tacho"], lambda: log.raw("encoder"), log.verify):
        with pytest.raises(LogError, match="closed"):
            read()


def test_an_empty_log(path):
    path.write_bytes(record([]))
    with open_log(path) as log:
        assert (log.start_ns, log.end_ns, log.verify(), log.events) == (0, 0, [], [])
        assert len(log.between(0, 10)["tacho"]) == 0


def big(n=60_000):
    """A log of several MB, so that several threads read it, with samples that identify themselves."""
    times, numbers = T0 + np.arange(n) * MS, np.arange(n)
    return written(
        lambda writer: writer.add_block(add_channel(writer), times, times, numbers, marks(numbers)),
        compression="none",
        chunk_bytes=50_000,
    )


def test_a_long_log_is_read_by_several_threads(path):
    data = bytearray(big())
    path.write_bytes(data)
    with open_log(path) as log:
        assert np.array_equal(log["tacho"].revolutions, np.arange(60_000))
    data[len(data) // 3] ^= 1
    path.write_bytes(data)
    with open_log(path) as log:
        found = log["tacho"].revolutions
        (place,) = log.missing
        assert len(found) == 60_000 - (place.messages or 0)
        gone = np.setdiff1d(np.arange(60_000), found)
        assert (place.start_ns, place.end_ns) == (T0 + gone[0] * MS, T0 + gone[-1] * MS)
        assert len(gone) == place.messages == gone[-1] - gone[0] + 1


def test_a_file_that_is_cut_while_it_is_open(path):
    path.write_bytes(big())
    with open_log(path) as log:
        os.truncate(path, log.size_bytes // 2)
        found = log["tacho"].revolutions
        assert np.array_equal(found, np.arange(len(found)))
        assert 20_000 < len(found) < 40_000
        assert sum(place.messages or 0 for place in log.missing) == 60_000 - len(found)
        assert "cut meanwhile" in str(log.missing[0])
        assert log.count("tacho") == len(found)


def test_a_disk_that_refuses_a_sector(path, monkeypatch):
    data = big()
    path.write_bytes(data)
    bad = len(data) // 2
    plain = FileBytes._at

    def refusing(self, start, length):
        if start <= bad < start + length:
            raise OSError(5, "Input/output error")
        return plain(self, start, length)

    monkeypatch.setattr(FileBytes, "_at", refusing)
    with open_log(path) as log:
        found = log["tacho"].revolutions
        (place,) = log.missing
        assert place.byte_start <= bad < place.byte_end
        assert "Input/output error" in str(place)
        assert len(found) == 60_000 - place.messages
        log.verify()
        assert np.array_equal(log["tacho"].revolutions, found)


def test_a_file_that_is_written_over_while_it_is_open(path):
    """A part that was intact when it was read and is damaged now is excluded from then on."""
    path.write_bytes(record([(k, [k]) for k in range(30)], finish=False))
    with open_log(path) as log:
        with path.open("r+b") as stream:
            stream.seek(300)
            stream.write(bytes(log.size_bytes - 600))
        for _ in range(2):
            assert len(log["tacho"]) + len(log.events) < 60
        assert not log.complete


def test_a_topic_with_two_schemas_is_refused(path):
    def fill(writer):
        for layout in (ch.TACHO, ch.MOTOR):
            writer.add_block(add_channel(writer, layout, "tacho"), T0, T0, 0, marks(1))

    path.write_bytes(written(fill))
    with open_log(path) as log, pytest.raises(LogError, match="one schema for the whole file"):
        log["tacho"]
