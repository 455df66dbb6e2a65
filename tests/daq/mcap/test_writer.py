"""BlockWriter against the MCAP library's own readers, all CRCs checked."""

import io
import zlib

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, ChunkIndex, DataEnd, MessageIndex, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from daq import channels as ch
from daq.mcap.scan import split_chunk
from daq.mcap.writer import RESTATE_EVERY, BlockWriter
from tests.effort import cases

T0 = 1_700_000_000_000_000_000


def tacho(n, start=0):
    return ch.TACHO.pack({"revolutions": np.arange(start, start + n), "node_time_us": np.arange(n) * 1000})


def add_tacho(writer):
    schema = writer.register_schema(ch.TACHO.schema_name, "protobuf", ch.TACHO.file_descriptor_set())
    return writer.register_channel(ch.TACHO.topic, "protobuf", schema)


def read_back(data, **how):
    """Every message through the seeking, the non-seeking and the plain record reader; they must agree."""
    seeking = make_reader(io.BytesIO(data), validate_crcs=True)
    plain = NonSeekingReader(io.BytesIO(data), validate_crcs=True)
    found = [(c.topic, m) for _, c, m in seeking.iter_messages(**how)]
    assert found == [(c.topic, m) for _, c, m in plain.iter_messages(**how)]
    list(StreamReader(io.BytesIO(data), validate_crcs=True).records)
    return found


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("block"), st.integers(0, 40)),
        st.tuples(st.just("message"), st.binary(max_size=300)),
        st.tuples(st.sampled_from(["flush", "metadata", "attachment", "channel"]), st.just(0)),
    ),
    max_size=25,
)


@settings(max_examples=cases(20, 60))
@given(STEPS, st.sampled_from(["zstd", "none"]), st.sampled_from([1, 200, 2000, 256 * 1024]))
def test_the_library_reads_what_was_written(steps, compression, chunk_bytes):
    stream = io.BytesIO()
    writer = BlockWriter(stream, compression, chunk_bytes)
    writer.start("rig")
    cid = add_tacho(writer)
    wanted, extra = [], [0, 0, 0]
    for number, (kind, value) in enumerate(steps):
        now = T0 + number
        if kind == "block":
            block = tacho(value)
            publish = now - np.arange(value)
            writer.add_block(cid, now, publish, np.arange(value) + 2**32 - 3, block)
            wanted += [("tacho", now, now - k, (k + 2**32 - 3) % 2**32, block[k].tobytes()) for k in range(value)]
        elif kind == "message":
            writer.add_message(cid, now, now, number, value)
            wanted.append(("tacho", now, now, number, value))
        elif kind == "channel":
            extra[0] += 1
            late = writer.register_channel(f"late/{number}", "json", 0, {"unit": "m"})
            writer.add_message(late, now, now, 0, b"{}")
            wanted.append((f"late/{number}", now, now, 0, b"{}"))
        elif kind == "metadata":
            extra[1] += 1
            writer.add_metadata("m", {"key": "value", "θ": "ψ"})
        elif kind == "attachment":
            extra[2] += 1
            writer.add_attachment("a.toml", "text/plain", b"x" * number, now)
        else:
            writer.flush()
    writer.finish()
    data = stream.getvalue()
    found = [
        (topic, m.log_time, m.publish_time, m.sequence, m.data) for topic, m in read_back(data, log_time_order=False)
    ]
    assert found == wanted
    summary = make_reader(io.BytesIO(data), validate_crcs=True).get_summary()
    assert summary is not None
    statistics = summary.statistics
    assert statistics is not None
    assert (statistics.message_count, statistics.channel_count) == (len(wanted), 1 + extra[0])
    assert [index.name for index in summary.metadata_indexes] == ["m"] * extra[1] + ["times"]
    assert len(summary.attachment_indexes) == extra[2]
    assert statistics.chunk_count == len(summary.chunk_indexes)
    if wanted:
        times = [message[1] for message in wanted]
        assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    check_offsets(data, summary)


def check_offsets(data, summary):
    """Every offset in the summary points at the right record, each message index at its messages."""
    for index in summary.chunk_indexes:
        assert data[index.chunk_start_offset] == 0x06
        record = data[index.chunk_start_offset : index.chunk_start_offset + index.chunk_length]
        assert int.from_bytes(record[1:9], "little") == len(record) - 9
        end = index.chunk_start_offset + index.chunk_length
        for offset in index.message_index_offsets.values():
            assert data[offset] == 0x07
            assert end <= offset < end + index.message_index_length
    for index in summary.attachment_indexes:
        assert data[index.offset] == 0x09
        assert int.from_bytes(data[index.offset + 1 : index.offset + 9], "little") == index.length - 9
    for index in summary.metadata_indexes:
        assert data[index.offset] == 0x0C


def records_of(data, emit_chunks=True):
    return list(StreamReader(io.BytesIO(data), emit_chunks=emit_chunks, validate_crcs=True).records)


def test_samples_decode_as_protobuf_in_time_order():
    stream = io.BytesIO()
    writer = BlockWriter(stream)
    writer.start()
    cid = add_tacho(writer)
    times = T0 + np.array([30, 10, 20])
    writer.add_block(cid, times, times, [3, 1, 2], tacho(3))
    writer.finish()
    reader = make_reader(io.BytesIO(stream.getvalue()), validate_crcs=True, decoder_factories=[DecoderFactory()])
    decoded = [message.decoded_message for message in reader.iter_decoded_messages()]
    assert [message.revolutions for message in decoded] == [1, 2, 0]


def test_message_indexes_are_sorted_and_point_at_their_messages():
    stream = io.BytesIO()
    writer = BlockWriter(stream, "none")
    writer.start()
    cid = add_tacho(writer)
    times = T0 + np.array([30, 10, 20])
    writer.add_block(cid, times, times, [3, 1, 2], tacho(3))
    writer.add_message(cid, T0 + 5, T0, 9, b"last")
    writer.finish()
    records = records_of(stream.getvalue())
    (chunk,) = (record for record in records if isinstance(record, Chunk))
    (index,) = (record for record in records if isinstance(record, MessageIndex))
    assert [time - T0 for time, _ in index.records] == [5, 10, 20, 30]
    for time, offset in index.records:
        assert chunk.data[offset] == 0x05
        assert int.from_bytes(chunk.data[offset + 15 : offset + 23], "little") == time
    assert (chunk.message_start_time - T0, chunk.message_end_time - T0) == (5, 30)
    assert chunk.uncompressed_crc == zlib.crc32(chunk.data)


@settings(max_examples=cases(20, 60))
@given(st.lists(st.integers(0, 60), max_size=8), st.sampled_from([1, 200, 2000]), st.booleans())
def test_samples_by_their_fields_are_the_file_of_ready_made_messages(sizes, chunk_bytes, is_repeated):
    files = io.BytesIO(), io.BytesIO()
    writers = [BlockWriter(stream, "none", chunk_bytes) for stream in files]
    wanted: list[bytes] = []
    for writer in writers:
        writer.start()
        cid = add_tacho(writer)
        for number, size in enumerate(sizes):
            ticks = 7 if is_repeated else np.arange(size) * 1000
            columns = {"revolutions": np.arange(size), "node_time_us": ticks}
            heads = T0 + number, T0 + np.arange(size), np.arange(size)
            if writer is writers[0]:
                messages = ch.TACHO.pack(columns)
                wanted += [message.tobytes() for message in messages]
                writer.add_block(cid, *heads, messages)
            else:
                writer.add_samples(cid, *heads, ch.TACHO.item, columns)
        writer.finish()
    assert files[0].getvalue() == files[1].getvalue()
    assert [message.data for _, message in read_back(files[1].getvalue(), log_time_order=False)] == wanted


def test_message_indexes_are_those_of_the_messages_read_back():
    """A walk compares them as bytes and parses only others."""
    stream = io.BytesIO()
    writer = BlockWriter(stream, "none")
    writer.start()
    cid = add_tacho(writer)
    other = writer.register_channel("other", "json", 0)
    for number in range(3):
        times = T0 + np.array([30, 10, 10]) - number
        writer.add_block(cid, times, times, [3, 1, 2], tacho(3))
        writer.add_message(other, T0 + 5, T0, 9, b"last")
    writer.finish()
    (chunk,) = (record for record in records_of(stream.getvalue()) if isinstance(record, Chunk))
    indexes = split_chunk(chunk.data)[0].indexes()
    assert len(indexes) == 2 * 15 + 12 * 16
    assert chunk.data + indexes in stream.getvalue()


def test_data_section_crc_and_summary_offsets():
    stream = io.BytesIO()
    writer = BlockWriter(stream)
    writer.start()
    writer.add_block(add_tacho(writer), T0, T0, 0, tacho(5))
    writer.finish()
    data = stream.getvalue()
    records = records_of(data)
    (end,) = (record for record in records if isinstance(record, DataEnd))
    place = data.index(b"\x0f\x04\0\0\0\0\0\0\0" + end.data_section_crc.to_bytes(4, "little"))
    assert zlib.crc32(data[:place]) == end.data_section_crc != 0
    for offset in (record for record in records if isinstance(record, SummaryOffset)):
        assert data[offset.group_start] == offset.group_opcode
        assert offset.group_length > 0


def test_flush_makes_everything_so_far_readable():
    stream = io.BytesIO()
    writer = BlockWriter(stream)
    writer.start()
    cid = add_tacho(writer)
    writer.add_block(cid, T0, T0, 0, tacho(7))
    writer.flush()
    writer.flush()
    records = StreamReader(io.BytesIO(stream.getvalue()), validate_crcs=True).records
    assert sum(type(next(records)).__name__ == "Message" for _ in range(1 + 2 + 7)) == 7


def test_chunks_keep_near_their_size_and_definitions_are_restated():
    stream = io.BytesIO()
    writer = BlockWriter(stream, "none", chunk_bytes=2000)
    writer.start()
    cid = add_tacho(writer)
    writer.add_block(cid, T0, T0, 0, tacho(RESTATE_EVERY * 50))
    writer.finish()
    data = stream.getvalue()
    chunks = [record for record in records_of(data) if isinstance(record, Chunk)]
    assert 2000 - 45 < max(chunk.uncompressed_size for chunk in chunks) <= 2000
    restated = [number for number, chunk in enumerate(chunks) if b"rig.IndexMark" in chunk.data]
    assert restated == list(range(0, len(chunks), RESTATE_EVERY))
    assert len(read_back(data)) == RESTATE_EVERY * 50
    assert sum(isinstance(record, ChunkIndex) for record in records_of(data)) == len(chunks)


def test_an_empty_log_is_a_log():
    stream = io.BytesIO()
    writer = BlockWriter(stream)
    writer.start()
    writer.finish()
    assert read_back(stream.getvalue()) == []


def test_wrong_use_is_refused_before_anything_is_written():
    writer = BlockWriter(io.BytesIO())
    writer.start()
    cid = add_tacho(writer)
    with pytest.raises(ValueError, match="register it first"):
        writer.add_block(cid + 1, T0, T0, 0, tacho(1))
    with pytest.raises(ValueError, match="register it first"):
        writer.register_channel("x", "json", 9)
    with pytest.raises(ValueError, match="1970"):
        writer.add_block(cid, -1, T0, 0, tacho(1))
    with pytest.raises(ValueError, match="1970"):
        writer.add_message(cid, T0, -1, 0, b"")
    with pytest.raises(ValueError, match="1970"):
        writer.add_message(cid, 2**64, T0, 0, b"")
    with pytest.raises(ValueError, match=r"shape \(n,\)"):
        writer.add_block(cid, T0, T0, 0, tacho(4).reshape(2, 2))
    with pytest.raises(ValueError, match="one integer or 4"):
        writer.add_block(cid, T0, np.arange(3), 0, tacho(4))
    with pytest.raises(ValueError, match="zstd"):
        BlockWriter(io.BytesIO(), "lz4")  # an invalid compression


def test_a_short_write_is_an_error():
    class Full(io.BytesIO):
        def write(self, data, /):
            return super().write(data[:3])

    with pytest.raises(OSError, match="disk full"):
        BlockWriter(Full()).start()


def test_the_index_of_many_chunks_is_whole_and_in_order():
    stream = io.BytesIO()
    writer = BlockWriter(stream)
    writer.start()
    cid = add_tacho(writer)
    for number in range(700):  # more than one piece of the index kept while writing
        writer.add_block(cid, T0 + number, T0 + number, number, tacho(1))
        writer.flush()
    writer.finish()
    summary = make_reader(io.BytesIO(stream.getvalue()), validate_crcs=True).get_summary()
    assert summary is not None
    assert [index.message_start_time for index in summary.chunk_indexes] == [T0 + number for number in range(700)]
    assert len(read_back(stream.getvalue())) == 700
