"""A few hundred damaged logs of the campaign in benchmarks/damaged_logs.py, and its earlier findings one by one."""

import struct
import zlib

import mcap.writer as library
import numpy as np
import pytest

from benchmarks import damaged_logs as campaign
from daq import channels as ch
from daq.log import open_log
from daq.log.recover import recover
from daq.mcap.file_bytes import FileBytes
from daq.mcap.records import DamageError
from daq.mcap.summary_reader import read_summary
from daq.mcap.writer import LIBRARY, MAGIC, BlockWriter
from tests.effort import cases

SHAPES = campaign.shapes()
FINISHED = {shape.name: shape for shape in SHAPES if shape.finished}
SMALL = FINISHED["finished none, 25 samples a chunk"]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.mcap"


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.name)
def test_undamaged_logs_pass_every_check(path, shape):
    path.write_bytes(shape.data)
    assert campaign.check_file(path, shape, None, np.random.default_rng(0)) == "recovered, all samples"


@pytest.mark.parametrize("kind", campaign.DAMAGES, ids=lambda kind: kind.__name__)
def test_nothing_wrong_and_nothing_lost_in_silence(path, kind):
    for number in range(cases(6, 20)):
        rng = np.random.default_rng([7, number])
        shape = SHAPES[rng.integers(len(SHAPES))]
        path.write_bytes(campaign.damaged(shape, kind, rng))
        campaign.check_file(path, shape, kind, rng)


def chunk_places(data):
    return campaign.chunk_spans(data)


def test_a_damaged_chunk_is_described_by_the_index(path):
    data = bytearray(SMALL.data)
    start, end = chunk_places(data)[3]
    data[end - 5] ^= 1
    path.write_bytes(data)
    with open_log(path) as log:
        assert log.complete  # nothing has been read yet
        assert len(log["laser/x"]) == SMALL.laser - 25
        (place,) = log.missing
        assert (place.byte_start, place.byte_end) == (start, end)
        assert place.start_ns == place.end_ns == campaign.T0 + 4 * 10**7
        assert (place.topics, place.messages) == (("laser/x", "raw/laser_x", "tacho"), 27)
        assert log.count("laser/x") == SMALL.laser - 25
        (again,) = log.verify()
        assert (again.byte_start, again.topics, again.messages) == (start, place.topics, 27)
        assert "27 messages of laser/x, raw/laser_x, tacho" in str(again)


@pytest.mark.parametrize("shape", [s for s in SHAPES if " 25 samples a chunk" in s.name], ids=lambda shape: shape.name)
def test_damage_across_the_end_of_a_chunk_is_one_place(path, shape):
    """A bad sector destroys a chunk's end and the beginning of its message indexes: one place, counted once."""
    data = bytearray(shape.data)
    (start, end), (following, _) = chunk_places(data)[3:5]
    data[end - 8 : end + 9] = bytes(17)
    path.write_bytes(data)
    with open_log(path) as log:
        log.verify()
        ours = [
            place for place in log.missing if place.byte_start is not None and start <= place.byte_start < following
        ]
    assert len(ours) == 1
    assert ours[0].byte_start == start


def test_a_damaged_chunk_of_an_unfinished_log_is_described_by_its_message_indexes(path):
    shape = next(shape for shape in SHAPES if shape.name == "unfinished zstd, 25 samples a chunk")
    data = bytearray(shape.data)
    start, end = chunk_places(data)[3]
    data[end - 5] ^= 1
    path.write_bytes(data)
    with open_log(path) as log:
        place, cut = log.missing
        assert place.byte_start == start
        assert (place.topics, place.messages) == (("laser/x", "raw/laser_x", "tacho"), 27)
        assert place.start_ns == campaign.T0 + 4 * 10**7
        assert (cut.byte_start, cut.start_ns, cut.messages) == (len(data), campaign.T0 + 12 * 10**7, None)


def test_a_chunk_without_a_trace_is_located_by_its_neighbours(path):
    shape = next(shape for shape in SHAPES if shape.name == "unfinished none, 25 samples a chunk")
    data = bytearray(shape.data)
    (start, _), (following, _) = chunk_places(data)[3:5]
    data[start:following] = b"\xff" * (following - start)
    path.write_bytes(data)
    with open_log(path) as log:
        place = log.missing[0]
        assert (place.byte_start, place.byte_end) == (start, following)
        assert (place.start_ns, place.end_ns) == (campaign.T0 + 3 * 10**7, campaign.T0 + 5 * 10**7)
        assert place.messages is None


def test_swapped_chunks_are_found_where_they_stand(path):
    """Their heads differ from the index, so the file is walked, and nothing is lost."""
    data = bytearray(SMALL.data)
    (a, a_end), (b, b_end) = chunk_places(data)[2:4]
    assert a_end - a == b_end - b
    data[a:a_end], data[b:b_end] = data[b:b_end], data[a:a_end]
    path.write_bytes(data)
    with open_log(path) as log:
        assert len(log["laser/x"]) == SMALL.laser
        assert log.missing
        assert all(place.messages == 0 for place in log.missing)


def test_a_chunk_copied_over_another_counts_once(path):
    data = bytearray(SMALL.data)
    (a, a_end), (b, b_end) = chunk_places(data)[2:4]
    data[b:b_end] = data[a:a_end]
    path.write_bytes(data)
    with open_log(path) as log:
        assert len(np.unique(log["laser/x"].code)) == len(log["laser/x"]) == SMALL.laser - 25
        assert any("used once" in str(place) and place.messages == 27 for place in log.missing)


def alike_chunks(finished):
    """A log whose chunks 1 and 2 differ in their samples only: same log time and size; and their positions."""
    shape = campaign.make_shape("none", finished, 1, 170, 1, 3250)
    (a, a_end), (b, b_end) = chunk_places(shape.data)[1:3]
    assert a_end - a == b_end - b
    assert shape.data[a : a + 33] == shape.data[b : b + 33]
    return shape, (a, a_end), (b, b_end)


def check_every_way(path, samples, lost):
    """Check by the index, in a window, after a walk and in the recovered log; `lost` is the expected number."""
    with open_log(path) as log:
        for _ in range(2):
            found = log["laser/x"].code
            assert len(np.unique(found)) == len(found) == samples
            assert log.count("laser/x") == samples
            window = campaign.T0 + 250_000 * 40, campaign.T0 + 250_000 * 120
            part = log.between(*window)["laser/x"].code
            assert part.tolist() == [k for k in found.tolist() if 40 <= k < 120]
            assert lost is None or sum(place.messages for place in log.missing) == lost
            assert any("used once" in str(place) and place.messages != 0 for place in log.missing)
            log.verify()
    recover(path, path.with_name("out.mcap"))
    with open_log(path.with_name("out.mcap")) as log:
        assert log["laser/x"].code.tolist() == found.tolist()


@pytest.mark.parametrize("finished", [True, False])
def test_a_chunk_copied_over_one_that_is_alike_counts_once(path, finished):
    """Times, size and counts match the index at both places; only the CRC shows that it is the same chunk."""
    shape, (a, a_end), (b, b_end) = alike_chunks(finished)
    data = bytearray(shape.data)
    data[b:b_end] = data[a:a_end]
    path.write_bytes(data)
    check_every_way(path, 120, 50 if finished else None)


def test_a_chunk_copied_behind_the_head_of_another_counts_once(path):
    """The times in the head still match the index; those of the messages do not."""
    data = bytearray(SMALL.data)
    (a, a_end), (b, b_end) = chunk_places(data)[2:4]
    assert a_end - a == b_end - b
    data[b + 33 : b_end] = data[a + 33 : a_end]
    path.write_bytes(data)
    with open_log(path) as log:
        part = log.between(campaign.T0 + 75 * 250_000, campaign.T0 + 100 * 250_000)  # its contents before the damage
        assert part.count("laser/x") == 0
        assert any(place.messages == 27 for place in part.missing)
    check_every_way(path, SMALL.laser - 25, 27)


def test_a_chunk_copied_over_the_summary_counts_once(path):
    """The CRC of the data is right, but it does not cover the bytes after the data, including the CRC itself."""
    data = bytearray(SMALL.data)
    a, a_end = chunk_places(data)[2]
    start, end = next((start, end) for opcode, start, end in campaign.record_spans(SMALL.data) if opcode == 0x0F)
    copied = data[a:a_end] + data[start:end]
    data[end : end + len(copied)] = copied
    path.write_bytes(data)
    check_every_way(path, SMALL.laser, None)


@pytest.mark.parametrize("finished", [True, False])
def test_a_lost_chunk_is_not_taken_for_one_that_is_alike(path, finished):
    shape, _, (b, _) = alike_chunks(finished)
    data = bytearray(shape.data)
    data[b + 100] ^= 1
    path.write_bytes(data)
    with open_log(path) as log:
        log.verify()
        assert log.missing[0].byte_start == b
        assert log.missing[0].messages == (50 if finished else None)


def test_a_chunk_that_stands_at_the_place_of_another_is_not_lost_but_the_other_is(path):
    data = bytearray(SMALL.data)
    (a, a_end), (b, b_end) = chunk_places(data)[2:4]
    data[b:b_end] = data[a:a_end]
    data[a + 100] ^= 1
    path.write_bytes(data)
    with open_log(path) as log:
        log.verify()
        assert len(log["laser/x"]) == SMALL.laser - 25
        (lost,) = [place for place in log.missing if place.messages]
        assert (lost.messages, lost.start_ns) == (27, campaign.T0 + 4 * 10**7)


@pytest.mark.parametrize("writer", ["ours", "library", "library with a CRC of the data"])
def test_the_same_chunk_written_twice_is_there_twice(path, writer):
    """Nothing is damaged: messages that are repeated with their times in another chunk are read twice."""
    message, times = ch.pack_raw(0, b"again"), (5, 5, 6)
    with path.open("wb") as stream:
        if writer == "ours":
            ours = BlockWriter(stream, "none")
            ours.start("rig")
            schema = ours.register_schema(ch.RAW_SCHEMA_NAME, "protobuf", ch.raw_descriptor_set())
            channel = ours.register_channel("raw/laser_x", "protobuf", schema)
            for time_ns in (1, *times):
                ours.add_message(channel, time_ns, time_ns, 0, message)
                ours.flush()
            ours.finish()
        else:
            other = library.Writer(stream, chunk_size=1, enable_data_crcs="CRC" in writer)
            other.start()
            schema = other.register_schema(ch.RAW_SCHEMA_NAME, "protobuf", ch.raw_descriptor_set())
            channel = other.register_channel("raw/laser_x", "protobuf", schema)
            for time_ns in (1, *times):
                other.add_message(channel, time_ns, message, time_ns)
            other.finish()
    with open_log(path) as log:
        for _ in range(2):
            assert [(chunk.host_ns, chunk.data) for chunk in log.raw("laser_x")] == [(t, b"again") for t in (1, *times)]
            assert len(log.between(5, 6).raw("laser_x")) == 2
            assert log.complete
            log.verify()
    assert recover(path, path.with_name("out.mcap")).messages == 4


def test_a_missing_crc_is_damage_in_our_own_files(path):
    data = bytearray(SMALL.data)
    start, _ = chunk_places(data)[3]
    data[start + 33 : start + 37] = bytes(4)
    path.write_bytes(data)
    with open_log(path) as log:
        assert len(log["laser/x"]) == SMALL.laser - 25
    header = SMALL.data.index(LIBRARY.encode())
    data[header : header + 2] = b"xx"  # a damaged header disables no check
    path.write_bytes(data)
    with open_log(path) as log:
        assert len(log["laser/x"]) == SMALL.laser - 25


@pytest.mark.parametrize("finished", ["finished", "unfinished"])
def test_a_whole_chunk_behind_a_wrong_length_is_found(path, finished):
    """A chunk's head copied over a shorter one covers the next chunk; the search continues inside."""
    shape = next(shape for shape in SHAPES if shape.name == f"{finished} zstd, 1000 samples a chunk")
    data = bytearray(shape.data)
    spans = chunk_places(data)
    shorter = min(range(len(spans) - 1), key=lambda k: spans[k][1] - spans[k][0])
    start, _ = spans[shorter]
    long = spans[shorter + 1][1] - start + 50
    head = struct.pack("<BQ", 6, long - 9) + data[start + 9 : start + 45] + struct.pack("<Q", long - 53)
    data[start : start + 53] = head[:53]
    path.write_bytes(data)
    with open_log(path) as log:
        log.verify()
        assert len(log["laser/x"]) == shape.laser - 1000


def test_nested_heads_are_no_reason_to_search_for_ever(path):
    """Thousands of nested heads, each of a chunk as long as the rest of the file."""
    size = 1_500_000
    body = bytearray(size)
    for at in range(0, size - 100, 60):
        length = size - at
        struct.pack_into("<BQQQQIIQ", body, at, 6, length - 9, 0, 0, length - 49, 1, 0, length - 49)
    path.write_bytes(SMALL.data[: chunk_places(SMALL.data)[2][0]] + body)
    with open_log(path) as log:
        assert len(log["laser/x"]) == 50
        assert any("the rest was not searched" in str(place) for place in log.missing)


def test_swapped_chunks_of_an_unfinished_log_are_not_reported_as_missing(path):
    shape = next(shape for shape in SHAPES if shape.name == "unfinished none, 25 samples a chunk")
    data = bytearray(shape.data)
    (a, a_end), (b, b_end) = chunk_places(data)[2:4]
    data[a:a_end], data[b:b_end] = data[b:b_end], data[a:a_end]
    path.write_bytes(data)
    with open_log(path) as log:
        assert len(log["laser/x"]) == shape.laser
        assert len(log.missing) > 1
        assert not any(place.messages for place in log.missing)


def test_an_index_of_a_swapped_chunk_claims_nothing(path):
    """A damaged chunk, followed by the message indexes of another chunk, which is present."""
    shape = next(shape for shape in SHAPES if shape.name == "unfinished none, 25 samples a chunk")
    data = bytearray(shape.data)
    spans = chunk_places(data)
    (a_start, a_end), (following, _), (_, b_end), (after, _) = spans[2], spans[3], spans[5], spans[6]
    assert after - b_end == following - a_end
    data[a_start + 60] ^= 1
    data[a_end:following] = data[b_end:after]
    path.write_bytes(data)
    with open_log(path) as log:
        place = log.missing[0]
        assert place.byte_start == a_start
        assert not place.messages


def test_metadata_under_a_damaged_name_is_left_out(path):
    data = SMALL.data.replace(b"\x03\0\0\0run", b"\x03\0\0\0ruN", 1)
    path.write_bytes(data)
    with open_log(path) as log:
        for _ in range(2):
            assert set(log.metadata) == {"summary"}
            assert any("'run' was left out" in str(place) for place in log.missing)
            log.verify()


def test_a_summary_without_its_channels_is_not_used(path):
    """Its CRC is right, but the channel of the samples has another id in it."""
    data = bytearray(SMALL.data)
    footer = len(data) - len(MAGIC) - 29
    start = struct.unpack_from("<Q", data, footer + 9)[0]
    channel = next(at for opcode, at, _ in campaign.record_spans(bytes(data)) if opcode == 4 and at > start)
    data[channel + 9] = 99
    data[footer + 25 : footer + 29] = zlib.crc32(data[start : footer + 25]).to_bytes(4, "little")
    path.write_bytes(data)
    with open_log(path) as log:
        assert len(log["laser/x"]) == SMALL.laser
        assert "lacks channels" in str(log.missing[0])


def test_a_summary_that_defines_no_schema_hinders_no_recovery(path):
    """Id 0 means that a channel has no schema; the CRC of the definition is right."""
    data = bytearray(SMALL.data)
    footer = len(data) - len(MAGIC) - 29
    start = struct.unpack_from("<Q", data, footer + 9)[0]
    schemas = [at for opcode, at, _ in campaign.record_spans(bytes(data)) if opcode == 3 and at > start]
    data[schemas[-1] + 9] = 0
    data[footer + 25 : footer + 29] = zlib.crc32(data[start : footer + 25]).to_bytes(4, "little")
    path.write_bytes(data)
    recover(path, path.with_name("out.mcap"))
    with open_log(path.with_name("out.mcap")) as log:
        assert len(log["laser/x"]) == SMALL.laser
        assert log.verify() == []


def test_messages_read_from_a_foreign_file_without_crcs_are_reported(path):
    with path.open("wb") as stream:
        writer = library.Writer(stream, enable_crcs=False)
        writer.start()
        channel = writer.register_channel("note", "json", 0)
        writer.add_message(channel, 5, b"{}", 5)
        writer.finish()
    with open_log(path) as log:
        assert log.complete
        sentences = [str(place) for place in log.verify()]
        assert log.complete
        assert any("1 chunk without a CRC" in text for text in sentences)
        assert log.count("note") == 1


def test_a_summary_crc_is_not_enough(path):
    """Statistics that differ from the index are not used, even if their CRC is right."""
    data = bytearray(SMALL.data)
    footer = len(data) - len(MAGIC) - 29
    start = struct.unpack_from("<Q", data, footer + 9)[0]
    statistics = next(at for opcode, at, _ in campaign.record_spans(bytes(data)) if opcode == 0x0B)
    data[statistics + 9] ^= 1
    data[footer + 25 : footer + 29] = zlib.crc32(data[start : footer + 25]).to_bytes(4, "little")
    path.write_bytes(data)
    with open_log(path) as log:
        assert len(log["laser/x"]) == SMALL.laser
        assert not log.complete


@pytest.mark.parametrize("has_data_end", [True, False])
def test_a_summary_as_long_as_memory_is_damage(path, has_data_end):
    """The footer of a huge file points near its start; the target is checked before memory is allocated for it."""
    path.write_bytes(SMALL.data)
    footer = struct.pack("<BQ", 2, 20)

    class Huge(FileBytes):
        def read(self, start: int, length: int) -> bytes:
            if start + length == self.size:
                return footer + struct.pack("<QQI", 100, 0, 1) + MAGIC
            if start + length == 100 and has_data_end:
                return struct.pack("<BQI", 0x0F, 4, 0)
            return bytes(length)

    file = Huge(path)
    file.size = 2**60
    with pytest.raises(DamageError, match="larger than the available memory" if has_data_end else "no end of the data"):
        read_summary(file)
    file.close()
