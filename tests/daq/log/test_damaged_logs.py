"""A few hundred damaged logs of the campaign in benchmarks/damaged_logs.py, and its earlier findings one by one."""

import struct
import zlib

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
from tests.daq.mcap.written import foreign, written
from tests.effort import cases

SHAPES = campaign.shapes()
NAMED = {shape.name: shape for shape in SHAPES}
SMALL, CUT = (NAMED[f"{state} none, 25 samples a chunk"] for state in ("finished", "unfinished"))
T0, STEP_NS = campaign.T0, 10**7  # a chunk


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


def places_of(shape):
    return campaign.chunk_spans(shape.data)


def put(path, shape, *changes):
    """Write the log with other bytes at some places."""
    data = bytearray(shape.data)
    for at, new in changes:
        data[at : at + len(new)] = new
    path.write_bytes(data)


def flipped(shape, at):
    return at, bytes([shape.data[at] ^ 1])


def copied(shape, source, to):
    return to, shape.data[slice(*source)]


@pytest.mark.parametrize("name", ["finished none", "unfinished zstd"])
def test_a_damaged_chunk_is_described_by_the_index_or_its_message_indexes(path, name):
    shape = NAMED[f"{name}, 25 samples a chunk"]
    start, end = places_of(shape)[3]
    put(path, shape, flipped(shape, end - 5))
    with open_log(path) as log:
        assert log.complete is shape.finished  # nothing has been read yet
        assert len(log["laser/x"]) == log.count("laser/x") == shape.laser - 25
        place, *cut = log.missing
        assert place.byte_start == start
        assert place.start_ns == T0 + 4 * STEP_NS
        assert (place.topics, place.messages) == (("laser/x", "raw/laser_x", "tacho"), 27)
        assert "27 messages of laser/x, raw/laser_x, tacho" in str(place)
        if shape.finished:
            assert (place.byte_end, place.end_ns) == (end, place.start_ns)
        log.verify()
        assert (log.missing[0].byte_start, log.missing[0].messages) == (start, 27)
        rest = [] if shape.finished else [(len(shape.data), T0 + 12 * STEP_NS, None)]
        assert [(each.byte_start, each.start_ns, each.messages) for each in cut] == rest


@pytest.mark.parametrize("shape", [s for s in SHAPES if " 25 samples a chunk" in s.name], ids=lambda shape: shape.name)
def test_damage_across_the_end_of_a_chunk_is_one_place(path, shape):
    """A bad sector destroys a chunk's end and the beginning of its message indexes: one place, counted once."""
    (start, end), (following, _) = places_of(shape)[3:5]
    put(path, shape, (end - 8, bytes(17)))
    with open_log(path) as log:
        log.verify()
        starts = [place.byte_start for place in log.missing if place.byte_start is not None]
    assert [at for at in starts if start <= at < following] == [start]


def test_a_chunk_without_a_trace_is_located_by_its_neighbours(path):
    (start, _), (following, _) = places_of(CUT)[3:5]
    put(path, CUT, (start, b"\xff" * (following - start)))
    with open_log(path) as log:
        place = log.missing[0]
        assert (place.byte_start, place.byte_end, place.messages) == (start, following, None)
        assert (place.start_ns, place.end_ns) == (T0 + 3 * STEP_NS, T0 + 5 * STEP_NS)


@pytest.mark.parametrize("shape", [SMALL, CUT], ids=lambda shape: shape.name)
def test_swapped_chunks_are_found_where_they_stand(path, shape):
    """Their heads differ from the index, so the file is walked, and nothing is lost."""
    a, b = places_of(shape)[2:4]
    put(path, shape, copied(shape, a, b[0]), copied(shape, b, a[0]))
    with open_log(path) as log:
        assert len(log["laser/x"]) == shape.laser
        assert log.missing
        assert not any(place.messages for place in log.missing)


# --- copies of chunks ------------------------------------------------------------------------------------------------


def alike(finished):
    """A log whose chunks 1 and 2 differ in their samples only: same log time and size; and their positions."""
    shape = campaign.make_shape("none", finished, 1, 170, 1, 3250)
    a, b = places_of(shape)[1:3]
    assert shape.data[a[0] : a[0] + 33] == shape.data[b[0] : b[0] + 33]
    return shape, a, b


def copies():
    """Shapes with a chunk copied over something, and the expected numbers of samples and of missing messages."""
    for finished in (True, False):  # only the CRC shows that it is the same chunk
        shape, a, b = alike(finished)
        yield shape, copied(shape, a, b[0]), 120, 50 if finished else None
    a, b = places_of(SMALL)[2:4]
    yield SMALL, copied(SMALL, a, b[0]), SMALL.laser - 25, 27
    behind_head = copied(SMALL, (a[0] + 33, a[1]), b[0] + 33)  # the times in the head still match the index
    yield SMALL, behind_head, SMALL.laser - 25, 27
    start, end = next((start, end) for opcode, start, end in campaign.record_spans(SMALL.data) if opcode == 0x0F)
    yield SMALL, (end, SMALL.data[slice(*a)] + SMALL.data[start:end]), SMALL.laser, None  # not covered by a CRC


@pytest.mark.parametrize(("shape", "change", "samples", "lost"), list(copies()))
def test_a_chunk_copied_over_something_counts_once(path, shape, change, samples, lost):
    """By the index, in a window, after a walk and in the recovered log."""
    put(path, shape, change)
    with open_log(path) as log:
        for _ in range(2):
            found = log["laser/x"].code
            assert len(np.unique(found)) == len(found) == log.count("laser/x") == samples
            part = log.between(T0 + 250_000 * 40, T0 + 250_000 * 120)["laser/x"].code
            assert part.tolist() == [k for k in found.tolist() if 40 <= k < 120]
            assert lost is None or sum(place.messages for place in log.missing) == lost
            assert any("used once" in str(place) and place.messages != 0 for place in log.missing)
            log.verify()
    recover(path, path.with_name("out.mcap"))
    with open_log(path.with_name("out.mcap")) as log:
        assert log["laser/x"].code.tolist() == found.tolist()


def test_a_window_of_a_chunk_that_was_copied_over_is_missing(path):
    """The times in the head of the copy still match the index; those of the messages do not."""
    a, b = places_of(SMALL)[2:4]
    put(path, SMALL, copied(SMALL, (a[0] + 33, a[1]), b[0] + 33))
    with open_log(path) as log:
        part = log.between(T0 + 75 * 250_000, T0 + 100 * 250_000)  # its contents before the damage
        assert part.count("laser/x") == 0
        assert any(place.messages == 27 for place in part.missing)


@pytest.mark.parametrize("finished", [True, False])
def test_a_lost_chunk_is_not_taken_for_one_that_is_alike(path, finished):
    shape, _, (b, _) = alike(finished)
    put(path, shape, flipped(shape, b + 100))
    with open_log(path) as log:
        log.verify()
        assert (log.missing[0].byte_start, log.missing[0].messages) == (b, 50 if finished else None)


def test_a_chunk_that_stands_at_the_place_of_another_is_not_lost_but_the_other_is(path):
    a, b = places_of(SMALL)[2:4]
    put(path, SMALL, copied(SMALL, a, b[0]), flipped(SMALL, a[0] + 100))
    with open_log(path) as log:
        log.verify()
        assert len(log["laser/x"]) == SMALL.laser - 25
        (lost,) = [place for place in log.missing if place.messages]
        assert (lost.messages, lost.start_ns) == (27, T0 + 4 * STEP_NS)


def again(writer):
    """Four messages in a chunk each, of which two are the same."""
    schema = writer.register_schema(ch.RAW_SCHEMA_NAME, "protobuf", ch.raw_descriptor_set())
    channel = writer.register_channel("raw/laser_x", "protobuf", schema)
    ours, message = isinstance(writer, BlockWriter), ch.pack_raw(0, b"again")
    for time_ns in (1, 5, 5, 6):
        writer.add_message(channel, time_ns, *((time_ns, 0, message) if ours else (message, time_ns)))
        if ours:
            writer.flush()


@pytest.mark.parametrize(
    "make",
    [
        lambda: written(again, compression="none"),
        lambda: foreign(again, chunk_size=1),
        lambda: foreign(again, chunk_size=1, enable_data_crcs=True),
    ],
)
def test_the_same_chunk_written_twice_is_there_twice(path, make):
    """Nothing is damaged: messages that are repeated with their times in another chunk are read twice."""
    path.write_bytes(make())
    with open_log(path) as log:
        for _ in range(2):
            assert [(chunk.host_ns, chunk.data) for chunk in log.raw("laser_x")] == [
                (t, b"again") for t in (1, 5, 5, 6)
            ]
            assert len(log.between(5, 6).raw("laser_x")) == 2
            assert log.complete
            log.verify()
    assert recover(path, path.with_name("out.mcap")).messages == 4


@pytest.mark.parametrize("header", [b"", b"xx"])
def test_a_missing_crc_is_damage_in_our_own_files(path, header):
    """A damaged header disables no check."""
    start, _ = places_of(SMALL)[3]
    put(path, SMALL, (start + 33, bytes(4)), (SMALL.data.index(LIBRARY.encode()), header))
    with open_log(path) as log:
        assert len(log["laser/x"]) == SMALL.laser - 25


@pytest.mark.parametrize("finished", ["finished", "unfinished"])
def test_a_whole_chunk_behind_a_wrong_length_is_found(path, finished):
    """A chunk's head copied over a shorter one covers the next chunk; the search continues inside."""
    shape = NAMED[f"{finished} zstd, 1000 samples a chunk"]
    spans = places_of(shape)
    shorter = min(range(len(spans) - 1), key=lambda k: spans[k][1] - spans[k][0])
    start, _ = spans[shorter]
    long = spans[shorter + 1][1] - start + 50
    head = struct.pack("<BQ", 6, long - 9) + shape.data[start + 9 : start + 45] + struct.pack("<Q", long - 53)
    put(path, shape, (start, head[:53]))
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
    path.write_bytes(SMALL.data[: places_of(SMALL)[2][0]] + body)
    with open_log(path) as log:
        assert len(log["laser/x"]) == 50
        assert any("the rest was not searched" in str(place) for place in log.missing)


def test_an_index_of_a_swapped_chunk_claims_nothing(path):
    """A damaged chunk, followed by the message indexes of another chunk, which is present."""
    spans = places_of(CUT)
    (a_start, a_end), (following, _), (_, b_end), (after, _) = spans[2], spans[3], spans[5], spans[6]
    assert after - b_end == following - a_end
    put(path, CUT, flipped(CUT, a_start + 60), copied(CUT, (b_end, after), a_end))
    with open_log(path) as log:
        assert (log.missing[0].byte_start, log.missing[0].messages or 0) == (a_start, 0)


def test_metadata_under_a_damaged_name_is_left_out(path):
    data = SMALL.data.replace(b"\x03\0\0\0run", b"\x03\0\0\0ruN", 1)
    path.write_bytes(data)
    with open_log(path) as log:
        for _ in range(2):
            assert set(log.metadata) == {"summary"}
            assert any("'run' was left out" in str(place) for place in log.missing)
            log.verify()


def with_summary(path, opcode, new, which=0):
    """Write another first field into a record of the summary, whose CRC is right."""
    data = bytearray(SMALL.data)
    footer = len(data) - len(MAGIC) - 29
    start = struct.unpack_from("<Q", data, footer + 9)[0]
    found = [at for kind, at, _ in campaign.record_spans(SMALL.data) if kind == opcode and at > start]
    data[found[which] + 9] = new
    data[footer + 25 : footer + 29] = zlib.crc32(data[start : footer + 25]).to_bytes(4, "little")
    path.write_bytes(data)


@pytest.mark.parametrize(("opcode", "words"), [(0x04, "lacks channels"), (0x0B, "index everything")])
def test_a_summary_with_a_right_crc_that_contradicts_itself_is_not_used(path, opcode, words):
    """The channel of the samples has another number in it; its statistics count other messages than its index."""
    with_summary(path, opcode, 99)
    with open_log(path) as log:
        assert len(log["laser/x"]) == SMALL.laser
        assert words in str(log.missing[0])
        assert not log.complete


def test_a_summary_that_defines_no_schema_hinders_no_recovery(path):
    """Id 0 means that a channel has no schema."""
    with_summary(path, 0x03, 0, which=-1)
    recover(path, path.with_name("out.mcap"))
    with open_log(path.with_name("out.mcap")) as log:
        assert len(log["laser/x"]) == SMALL.laser
        assert log.verify() == []


def test_messages_read_from_a_foreign_file_without_crcs_are_reported(path):
    def fill(writer):
        writer.add_message(writer.register_channel("note", "json", 0), 5, b"{}", 5)

    path.write_bytes(foreign(fill, enable_crcs=False))
    with open_log(path) as log:
        assert log.complete
        assert any("1 chunk without a CRC" in str(place) for place in log.verify())
        assert log.complete
        assert log.count("note") == 1


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
