"""BlockWriter against the MCAP library's own readers, all CRCs checked."""

import io
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, ChunkIndex, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from daq import channels as ch
from daq.mcap.scan import split_chunk
from daq.mcap.writer import RESTATE_EVERY, BlockWriter
from tests.daq.mcap.written import T0, add_channel, fresh, marks, written
from tests.effort import cases


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
    wanted, kinds = [], Counter(kind for kind, _ in steps)

    def add(writer, cid, number, kind, value):
        now = T0 + number
        if kind == "block":
            block = marks(value)
            writer.add_block(cid, now, now - np.arange(value), np.arange(value) + 2**32 - 3, block)
            wanted.extend(("tacho", now, now - k, (k + 2**32 - 3) % 2**32, block[k].tobytes()) for k in range(value))
        elif kind == "message":
            writer.add_message(cid, now, now, number, value)
            wanted.append(("tacho", now, now, number, value))
        elif kind == "channel":
            late = writer.register_channel(f"late/{number}", "json", 0, {"unit": "m"})
            writer.add_message(late, now, now, 0, b"{}")
            wanted.append((f"late/{number}", now, now, 0, b"{}"))
        elif kind == "metadata":
            writer.add_metadata("m", {"key": "value", "θ": "ψ"})
        elif kind == "attachment":
            writer.add_attachment("a.toml", "text/plain", b"x" * number, now)
        else:
            writer.flush()

    def fill(writer):
        cid = add_channel(writer)
        for number, (kind, value) in enumerate(steps):
            add(writer, cid, number, kind, value)

    data = written(fill, compression=compression, chunk_bytes=chunk_bytes)
    found = [
        (topic, m.log_time, m.publish_time, m.sequence, m.data) for topic, m in read_back(data, log_time_order=False)
    ]
    assert found == wanted
    summary = make_reader(io.BytesIO(data), validate_crcs=True).get_summary()
    statistics = summary.statistics
    assert (statistics.message_count, statistics.channel_count) == (len(wanted), 1 + kinds["channel"])
    assert [index.name for index in summary.metadata_indexes] == ["m"] * kinds["metadata"] + ["times"]
    assert len(summary.attachment_indexes) == kinds["attachment"]
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
    for offset in (record for record in records_of(data) if isinstance(record, SummaryOffset)):
        assert data[offset.group_start] == offset.group_opcode
        assert offset.group_length > 0


def records_of(data, emit_chunks=True):
    return list(StreamReader(io.BytesIO(data), emit_chunks=emit_chunks, validate_crcs=True).records)


def three_marks(writer):
    cid, times = add_channel(writer), T0 + np.array([30, 10, 20])
    writer.add_block(cid, times, times, [3, 1, 2], marks(3))
    return cid


def test_samples_decode_as_protobuf_in_time_order():
    reader = make_reader(io.BytesIO(written(three_marks)), validate_crcs=True, decoder_factories=[DecoderFactory()])
    decoded = [message.decoded_message for message in reader.iter_decoded_messages()]
    assert [message.revolutions for message in decoded] == [1, 2, 0]


@settings(max_examples=cases(20, 60))
@given(st.lists(st.integers(0, 60), max_size=8), st.sampled_from([1, 200, 2000]), st.booleans())
def test_samples_by_their_fields_are_the_file_of_ready_made_messages(sizes, chunk_bytes, is_repeated):
    def fill(writer, packed):
        cid = add_channel(writer)
        for number, size in enumerate(sizes):
            ticks = 7 if is_repeated else np.arange(size) * 1000
            columns = {"revolutions": np.arange(size), "node_time_us": ticks}
            heads = T0 + number, T0 + np.arange(size), np.arange(size)
            if packed:
                writer.add_block(cid, *heads, ch.TACHO.pack(columns))
            else:
                writer.add_samples(cid, *heads, ch.TACHO.item, columns)

    packed, by_fields = (
        written(lambda writer, packed=packed: fill(writer, packed), compression="none", chunk_bytes=chunk_bytes)
        for packed in (True, False)
    )
    assert packed == by_fields
    assert len(read_back(by_fields, log_time_order=False)) == sum(sizes)


def test_message_indexes_are_those_of_the_messages_read_back():
    """A walk compares them as bytes and parses only others."""

    def fill(writer):
        cid = add_channel(writer)
        other = writer.register_channel("other", "json", 0)
        for number in range(3):
            times = T0 + np.array([30, 10, 10]) - number
            writer.add_block(cid, times, times, [3, 1, 2], marks(3))
            writer.add_message(other, T0 + 5, T0, 9, b"last")

    data = written(fill, compression="none")
    (chunk,) = (record for record in records_of(data) if isinstance(record, Chunk))
    indexes = split_chunk(chunk.data)[0].indexes()
    assert len(indexes) == 2 * 15 + 12 * 16
    assert chunk.data + indexes in data


def test_flush_makes_everything_so_far_readable():
    data = written(lambda writer: writer.add_block(add_channel(writer), T0, T0, 0, marks(7)), finish=False)
    records = StreamReader(io.BytesIO(data), validate_crcs=True).records
    assert sum(type(next(records)).__name__ == "Message" for _ in range(1 + 2 + 7)) == 7


def test_chunks_keep_near_their_size_and_definitions_are_restated():
    samples = marks(RESTATE_EVERY * 50)
    data = written(
        lambda writer: writer.add_block(add_channel(writer), T0, T0, 0, samples), compression="none", chunk_bytes=2000
    )
    chunks = [record for record in records_of(data) if isinstance(record, Chunk)]
    assert 2000 - 45 < max(chunk.uncompressed_size for chunk in chunks) <= 2000
    restated = [number for number, chunk in enumerate(chunks) if b"rig.IndexMark" in chunk.data]
    assert restated == list(range(0, len(chunks), RESTATE_EVERY))
    assert len(read_back(data)) == len(samples)
    assert sum(isinstance(record, ChunkIndex) for record in records_of(data)) == len(chunks)


def test_an_empty_log_is_a_log():
    assert read_back(written(lambda writer: None)) == []


@pytest.mark.parametrize(
    ("use", "words"),
    [
        (lambda writer, cid: writer.add_block(cid + 1, T0, T0, 0, marks(1)), "register it first"),
        (lambda writer, cid: writer.register_channel("x", "json", 9), "register it first"),
        (lambda writer, cid: writer.add_block(cid, -1, T0, 0, marks(1)), "1970"),
        (lambda writer, cid: writer.add_message(cid, T0, -1, 0, b""), "1970"),
        (lambda writer, cid: writer.add_message(cid, 2**64, T0, 0, b""), "1970"),
        (lambda writer, cid: writer.add_block(cid, T0, T0, 0, marks(4).reshape(2, 2)), r"shape \(n,\)"),
        (lambda writer, cid: writer.add_block(cid, T0, np.arange(3), 0, marks(4)), "one integer or 4"),
        (
            lambda writer, cid: writer.add_block(cid, np.array([1.0, 2.0]), 1, 0, np.zeros(2, "V3")),
            "log times as one integer or 2, got float64",
        ),
        (lambda writer, cid: writer.add_metadata("run", {"crc32": "0"}), "own checksum"),
        (lambda writer, cid: writer.adopt([], []), "right after start"),
        (lambda writer, cid: BlockWriter(io.BytesIO(), "lz4"), "zstd"),
    ],
)
def test_wrong_use_is_refused_before_anything_is_written(use, words):
    writer = fresh()
    cid = add_channel(writer)
    with pytest.raises(ValueError, match=words):
        use(writer, cid)


def test_a_short_write_is_an_error():
    class Full(io.BytesIO):
        def write(self, data, /):
            return super().write(data[:3])

    with pytest.raises(OSError, match="disk full"):
        BlockWriter(Full()).start()


def test_the_index_of_many_chunks_is_whole_and_in_order():
    """More than one piece of the index is kept while the file is written."""

    def fill(writer):
        cid = add_channel(writer)
        for number in range(700):
            writer.add_block(cid, T0 + number, T0 + number, number, marks(1))
            writer.flush()

    data = written(fill)
    summary = make_reader(io.BytesIO(data), validate_crcs=True).get_summary()
    assert [index.message_start_time for index in summary.chunk_indexes] == [T0 + number for number in range(700)]
    assert len(read_back(data)) == 700
