"""BlockWriter: chunks copied from other files, facts about itself, and failures."""

import io
import tracemalloc
import zlib

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings, strategies as st
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, Message, MessageIndex, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType

from daq.log import open_log
from daq.mcap.writer import BlockWriter, CopiedChunk, metadata_crc
from tests.daq.mcap.written import T0, add_channel, foreign, fresh, marks, written
from tests.daq.small_log import write_small_log
from tests.effort import cases


def finished(fill, **options):
    """Bytes of a file with two channels, filled by `fill(writer, tacho, plain)`."""
    return written(
        lambda writer: fill(writer, add_channel(writer), writer.register_channel("plain", "json", 0)), **options
    )


def records_of(data):
    return list(StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records)


def messages_of(data):
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [
        (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
        for _, c, m in reader.iter_messages(log_time_order=False)
    ]


def metadata_of(data, name):
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [record.metadata for record in reader.iter_metadata() if record.name == name]


def unpacked(chunk):
    return zstandard.decompress(chunk.data) if chunk.compression == "zstd" else chunk.data


def check_message_indexes(data):
    """Exactly one index per channel after each chunk, ascending, and every entry points at its message."""
    chunk, seen = None, {}
    for record in records_of(data):
        if isinstance(record, Chunk):
            chunk, seen = record, {}
        if isinstance(record, MessageIndex):
            assert chunk is not None
            assert record.channel_id not in seen
            content = unpacked(chunk)
            assert record.records == sorted(record.records, key=lambda entry: entry[0])
            for time, offset in record.records:
                head = content[offset : offset + 31]
                assert (head[0], int.from_bytes(head[9:11], "little")) == (5, record.channel_id)
                assert int.from_bytes(head[15:23], "little") == time
            seen[record.channel_id] = len({offset for _, offset in record.records})
            there = [message for message in breakup_chunk(chunk, True) if isinstance(message, Message)]
            assert seen[record.channel_id] == sum(message.channel_id == record.channel_id for message in there)


DATA_END = b"\x0f\x04" + bytes(7)
TIMES = st.integers(0, 2**63 - 1)
BLOCKS = st.lists(
    st.tuples(st.booleans(), st.lists(st.tuples(TIMES, TIMES, st.integers(0, 2**32 - 1)), max_size=12)), max_size=12
)


@settings(max_examples=cases(20, 60))
@given(BLOCKS, st.sampled_from(["zstd", "none"]), st.sampled_from([1, 300, 256 * 1024]))
def test_any_times_in_any_order(blocks, compression, chunk_bytes):
    wanted = []

    def fill(writer, tacho, plain):
        for is_block, rows in blocks:
            log, publish, sequence = (np.array([row[k] for row in rows], np.int64) for k in range(3))
            messages = marks(len(rows))
            if is_block:
                writer.add_block(tacho, log, publish, sequence, messages)
            for row, message in zip(rows, messages, strict=True):
                wanted.append(("tacho" if is_block else "plain", *row, message.tobytes()))
                if not is_block:
                    writer.add_message(plain, *row, message.tobytes())

    data = finished(fill, compression=compression, chunk_bytes=chunk_bytes)
    assert messages_of(data) == wanted
    check_message_indexes(data)
    end = next(record for record in records_of(data) if isinstance(record, DataEnd))
    assert end.data_section_crc == zlib.crc32(data[: data.rindex(DATA_END)])
    late = max([0, *(log - publish for _, log, publish, _, _ in wanted)])
    early = max([0, *(publish - log for _, log, publish, _, _ in wanted)])
    (times,) = metadata_of(data, "times")
    assert (int(times["most_late_ns"]), int(times["most_early_ns"])) == (late, early)


def copy_of(data, **options):
    """The same file made by adopting its definitions and copying its chunks."""
    stream = io.BytesIO()
    writer = BlockWriter(stream, **options)
    writer.start()
    summary = make_reader(io.BytesIO(data)).get_summary()
    writer.adopt(summary.schemas.values(), summary.channels.values())
    for chunk in (record for record in records_of(data) if isinstance(record, Chunk)):
        places = message_places(chunk)
        ids, log, publish, offsets = zip(*places, strict=True) if places else ([], [], [], [])
        size, crc = chunk.uncompressed_size, chunk.uncompressed_crc
        writer.copy_chunk(CopiedChunk(chunk.data, chunk.compression, size, crc, ids, log, publish, offsets))
    return stream, writer


def message_places(chunk):
    """Channel, log time, publish time and offset of each message of a chunk."""
    found, position = [], 0
    for record in breakup_chunk(chunk, True):
        if isinstance(record, Message):
            found.append((record.channel_id, record.log_time, record.publish_time, position))
        content = lz4_content(chunk) if chunk.compression == "lz4" else unpacked(chunk)
        position += 9 + int.from_bytes(content[position + 1 : position + 9], "little")
    return found


def lz4_content(chunk):
    import lz4.frame

    return lz4.frame.decompress(chunk.data)


def two_channels(writer, tacho, plain):
    for k in range(6):
        times = T0 + 1000 * k + np.array([5, 3, 9])
        writer.add_block(tacho, times, times - 100 + 40 * k, 3 * k, marks(3))
        writer.add_message(plain, T0 + 1000 * k, T0, k, b"{}" * k)


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_chunks_are_copied_byte_for_byte(compression):
    source = finished(two_channels, compression=compression, chunk_bytes=200)
    stream, writer = copy_of(source)
    late = writer.register_channel("late", "json", 0)
    writer.add_message(late, T0 + 10_000, T0 + 10_000, 0, b"[]")
    writer.finish()
    copy = stream.getvalue()
    assert messages_of(copy) == [*messages_of(source), ("late", T0 + 10_000, T0 + 10_000, 0, b"[]")]
    chunks = [[r for r in records_of(data) if isinstance(r, Chunk)] for data in (source, copy)]
    assert chunks[1][1:-1] == chunks[0]  # before them the definitions, after them the late channel
    assert metadata_of(copy, "times") == metadata_of(source, "times")
    check_message_indexes(copy)
    summaries = [make_reader(io.BytesIO(data), validate_crcs=True).get_summary() for data in (source, copy)]
    assert summaries[0].schemas == summaries[1].schemas
    assert {**summaries[0].channels, late: summaries[1].channels[late]} == summaries[1].channels
    assert summaries[1].statistics.message_count == summaries[0].statistics.message_count + 1
    assert summaries[1].statistics.message_start_time == summaries[0].statistics.message_start_time


def test_a_foreign_chunk_keeps_its_compression():
    def fill(library):
        topics = [library.register_channel(name, "json", 0) for name in ("a", "b")]
        for k in range(40):
            library.add_message(topics[k % 2], T0 - 7 * k, b"{}", T0 + 10**9 + k, k)

    source = foreign(fill, chunk_size=300, compression=CompressionType.LZ4)
    copy, writer = copy_of(source)
    writer.finish()
    assert messages_of(copy.getvalue()) == messages_of(source)
    assert {r.compression for r in records_of(copy.getvalue()) if isinstance(r, Chunk)} == {"zstd", "lz4"}
    assert metadata_of(copy.getvalue(), "times")[0]["most_early_ns"] == str(10**9 + 39 + 7 * 39)


def test_adopted_ids_stay_and_new_ones_are_free():
    writer = fresh()
    writer.adopt(
        [Schema(7, b"", "jsonschema", "x"), Schema(1, b"", "jsonschema", "y")],
        [Channel(65535, "a", "json", {}, 7), Channel(0, "b", "json", {}, 0)],
    )
    assert writer.register_schema("new", "jsonschema", b"") == 2
    assert writer.register_channel("new", "json", 2) == 1
    writer.add_message(65535, T0, T0, 0, b"{}")
    writer.add_message(0, T0, T0, 0, b"{}")
    writer.finish()


@pytest.mark.parametrize(
    ("schemas", "channels"),
    [
        ([], [Channel(1, "a", "json", {}, 3)]),
        ([], [Channel(1, "a", "json", {}, 0), Channel(1, "b", "json", {}, 0)]),
        ([Schema(0, b"", "", "x")], []),
        ([], [Channel(65536, "a", "json", {}, 0)]),
    ],
)
def test_definitions_that_contradict_are_refused(schemas, channels):
    with pytest.raises(ValueError, match="expected a"):
        fresh().adopt(schemas, channels)


@pytest.mark.parametrize(
    ("ids", "log", "offsets", "match"),
    [
        ([2], [T0], [0], "register it first"),
        ([1], [T0, T0], [0], r"four arrays \(n,\)"),
        ([1], [T0], [70], "within 100 bytes"),
    ],
)
def test_a_chunk_that_contradicts_itself_is_not_copied(ids, log, offsets, match):
    writer = fresh()
    writer.adopt([], [Channel(1, "a", "json", {}, 0)])
    with pytest.raises(ValueError, match=match):
        writer.copy_chunk(CopiedChunk(b"x" * 100, "", 100, 0, ids, log, log, offsets))


@given(st.dictionaries(st.text(st.characters(codec="utf-8")), st.text(st.characters(codec="utf-8"))))
def test_metadata_carries_its_checksum(table):
    table.pop("crc32", None)
    data = finished(lambda writer, tacho, plain: writer.add_metadata("run", table))
    (found,) = metadata_of(data, "run")
    text = "run\0" + "".join(f"{key}\0{value}\0" for key, value in sorted(table.items()))
    assert found == {**table, "crc32": f"{zlib.crc32(text.encode()):08x}"}
    assert metadata_crc("run", found) == metadata_crc("run", table) == found["crc32"]


def test_what_is_written_does_not_depend_on_how_arrays_lie_in_memory():
    base = np.arange(20, dtype=np.int64) + T0
    messages = marks(20)
    frozen = np.frombuffer(messages.tobytes(), messages.dtype)
    unaligned = np.frombuffer(b"x" + base.tobytes(), np.int64, offset=1)
    strided = np.repeat(base, 2)[::2]

    def fill(times, block):
        return finished(lambda writer, tacho, plain: writer.add_block(tacho, times, times, times - T0, block))

    wanted = fill(base, messages)
    assert fill(unaligned, frozen) == fill(strided, np.repeat(messages, 3)[::3]) == wanted
    assert fill(base.astype(np.uint64), messages) == wanted


def test_one_time_or_sequence_stands_for_all():
    def fill(n, *columns):
        return finished(lambda writer, tacho, plain: writer.add_block(tacho, *columns, marks(n)))

    whole = fill(50, np.full(50, T0 + 1), np.full(50, T0), np.full(50, 2**32 + 3))
    assert fill(50, T0 + 1, T0, 2**32 + 3) == fill(50, [T0 + 1], [T0], [3]) == whole


@pytest.mark.parametrize("size", [0, 1, 3_000_000])
def test_messages_of_any_size(size):
    def fill(writer, tacho, plain):
        for k in range(3):
            writer.add_message(plain, T0 + k, T0 + k, k, b"a" * size)
            writer.add_block(plain, T0 + k, T0 + k, k, np.zeros(1, f"V{size}" if size else []))
            writer.add_block(plain, T0 + k, T0 + k, k, np.zeros(2, "V5"))

    assert [len(message[4]) for message in messages_of(finished(fill))] == 3 * [size, size, 5, 5]


def test_memory_does_not_grow_with_the_file(tmp_path):
    with (tmp_path / "long.mcap").open("wb") as stream:
        writer = BlockWriter(stream)
        writer.start()
        channel = writer.register_channel("a", "json", 0)
        writer.add_message(channel, T0, T0, 0, b"{}")
        writer.flush()
        chunks = 1000
        tracemalloc.start()
        try:
            writer.add_message(channel, T0, T0, 0, bytes(20_000_000))
            for k in range(chunks):
                writer.add_block(channel, T0 + k, T0 + k, k, np.zeros(100, "V28"))
                writer.flush()
            grown, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert grown < 300_000 + 250 * chunks  # a chunk, and the index of each


class FullDisk(io.BytesIO):
    """Accepts `room` bytes, then part of a write, then everything again."""

    room = 2000

    def write(self, data, /):
        taken = bytes(data[: max(0, self.room - self.tell())])
        super().write(taken)
        if len(taken) < len(data):
            self.room = 10**9
            raise OSError(28, "No space left on device")
        return len(taken)


def test_behind_half_a_record_nothing_more_is_written():
    stream = FullDisk()
    writer = BlockWriter(stream, "none")
    writer.start()
    channel = writer.register_channel("a", "json", 0)
    for k in range(5):
        writer.add_message(channel, T0 + k, T0 + k, k, b"x" * 50)
        writer.flush()
    writer.add_message(channel, T0, T0, 0, b"x" * 2000)
    with pytest.raises(OSError, match="No space left"):
        writer.flush()
    size = stream.tell()
    for call in (
        writer.flush,
        writer.finish,
        lambda: writer.add_message(channel, T0, T0, 0, b""),
        lambda: writer.add_block(channel, T0, T0, 0, np.zeros(1, "V1")),
        lambda: writer.add_metadata("run", {}),
        lambda: writer.add_attachment("a", "", b"", 0),
    ):
        with pytest.raises(OSError, match="failed before"):
            call()
    assert stream.tell() == size


def test_a_finished_file_takes_no_more():
    writer = fresh()
    channel = writer.register_channel("a", "json", 0)
    writer.finish()
    with pytest.raises(OSError, match="finished"):
        writer.add_message(channel, T0, T0, 0, b"")
    with pytest.raises(OSError, match="finished"):
        writer.finish()


def re_encoded(data):
    """A file made by the library's own writer from the contents that its reader finds in ours."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)

    def fill(writer):
        summary = reader.get_summary()
        schemas = {s.id: writer.register_schema(s.name, s.encoding, s.data) for s in summary.schemas.values()}
        ids = {
            c.id: writer.register_channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0), c.metadata)
            for c in summary.channels.values()
        }
        for _, channel, message in reader.iter_messages(log_time_order=False):
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, attachment.log_time, attachment.name, attachment.media_type, attachment.data)
        for metadata in (record for record in records_of(data) if isinstance(record, Metadata)):
            writer.add_metadata(metadata.name, metadata.metadata)

    return foreign(fill, chunk_size=5000)


def test_a_log_encoded_again_by_the_library_reads_the_same(tmp_path):
    ours = write_small_log(tmp_path / "ours.mcap", steps=30, opened_at=10, reported=(0, 1))
    theirs = tmp_path / "theirs.mcap"
    theirs.write_bytes(re_encoded(ours.read_bytes()))
    assert messages_of(theirs.read_bytes()) == messages_of(ours.read_bytes())
    with open_log(ours) as a, open_log(theirs) as b:
        assert list(a) == list(b)
        assert sum(len(a[topic]) for topic in a) > 1000
        for topic in a:
            assert a[topic].columns.keys() == b[topic].columns.keys()
            for name in a[topic].columns:
                assert a[topic][name].tobytes() == b[topic][name].tobytes()
            for name in ("time_ns", "log_time_ns", "sequence"):
                assert (getattr(a[topic], name) == getattr(b[topic], name)).all()
        assert list(a.raw_in_order()) == list(b.raw_in_order())
        assert (a.events, a.health, a.attachments) == (b.events, b.health, b.attachments)
