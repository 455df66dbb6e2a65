"""Compiled passes over hand-made MCAP records: every field, and records that are cut or too long by a byte."""

from __future__ import annotations

import itertools
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.errors import LogError
from daq.mcap import scan
from daq.mcap.checksum import crc32
from daq.mcap.file_bytes import FileBytes
from daq.mcap.records import (
    AttachmentPlace,
    DamageError,
    Definitions,
    Header,
    check_attachment,
    check_metadata,
    read_attachment,
    read_header,
    read_metadata,
    read_record,
)
from daq.mcap.writer import LIBRARY, MAGIC, metadata_crc

BIG = 0x8877665544332211
LATE = 2**63 - 1


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def message(channel: int, log: int = 0, publish: int = 0, data: bytes = b"", sequence: int = 0) -> bytes:
    return record(5, struct.pack("<HIQQ", channel, sequence, log, publish) + data)


def array(data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.uint8)


def tallied(data: bytes) -> tuple[int, int, dict[int, int], list[int], list[int]]:
    counts, touched, times = np.zeros(65536, np.int64), np.zeros(65536, np.int64), np.zeros(4, np.uint64)
    found, others = scan.tally(array(data), counts, touched, times)
    ids = touched[: max(found, 0)].tolist()
    return found, others, {i: int(counts[i]) for i in ids}, ids, times.tolist()


DATA = (
    record(3, b"schema")
    + message(0x1234, 50, 61, b"ab")
    + record(4, b"")
    + message(7, 40, 90)
    + message(0x1234, BIG, 60, b"c")
)


def test_messages_are_counted_with_the_span_of_their_times() -> None:
    assert tallied(DATA) == (2, 2, {0x1234: 2, 7: 1}, [0x1234, 7], [40, BIG, 60, 90])
    assert tallied(message(65535, 3, 4)) == (1, 0, {65535: 1}, [65535], [3, 3, 4, 4])
    assert tallied(b"")[:2] == (0, 0)
    assert tallied(record(3, b""))[:2] == (0, 1)


BROKEN = {
    "cut": DATA[:-1],
    "one more byte": DATA + b"\x05",
    "half a head": DATA + record(5, b"")[:8],
    "kind 0": record(0, b"") + DATA,
    "a message shorter than its head": record(5, bytes(21)) + DATA,
    "a length beyond the end": struct.pack("<BQ", 3, 1),
    "a length beyond any": struct.pack("<BQ", 3, 2**64 - 1),
}


@pytest.mark.parametrize("data", BROKEN.values(), ids=BROKEN)
def test_records_that_are_not_whole_are_broken_for_every_pass(data: bytes) -> None:
    assert tallied(data)[0] == -1
    assert not scan.spans(array(data), np.int64(40), np.int64(50))
    assert scan.definitions(array(data), np.zeros((9, 2), np.int64)) == scan.BROKEN
    assert located(data, [], 99)[0] == scan.BROKEN
    assert collected(data, [99], 0)[0] == scan.BROKEN


def test_a_head_alone_and_a_message_of_22_bytes_are_whole() -> None:
    assert tallied(record(9, b""))[:2] == (0, 1)
    assert tallied(record(5, bytes(22)))[:2] == (1, 0)


def test_the_span_of_a_chunk_is_that_of_its_log_times() -> None:
    data = array(message(1, 50, 1) + record(3, b"") + message(1, 20, 99) + message(1, LATE, 2))
    for first, last, right in ((20, LATE, True), (21, LATE, False), (20, LATE - 1, False), (19, LATE, False)):
        assert bool(scan.spans(data, np.int64(first), np.int64(last))) is right
    assert scan.spans(array(record(3, b"x")), np.int64(5), np.int64(6))
    one = array(message(1, 7, 1))
    assert scan.spans(one, np.int64(7), np.int64(7))
    assert not scan.spans(one, np.int64(7), np.int64(8))
    assert scan.spans(array(message(1, 0, 1)), np.int64(0), np.int64(0))


def test_messages_outside_of_chunks_end_at_another_or_an_incomplete_record() -> None:
    first, second = message(1, data=b"a"), message(2)
    assert scan.loose_messages(array(first + second)) == len(first + second)
    assert scan.loose_messages(array(first + second[:-1])) == len(first)
    assert scan.loose_messages(array(first + record(7, b"") + second)) == len(first)
    assert scan.loose_messages(array(record(5, bytes(21)))) == scan.loose_messages(array(b"")) == 0


def test_definitions_are_counted_beyond_the_room_for_their_places() -> None:
    parts = [record(3, b"one"), message(1), record(4, b"fo"), record(2, b""), record(3, b"")]
    ends = np.cumsum([0, *map(len, parts)]).tolist()
    expected = [[0, ends[1]], [ends[2], ends[3]], [ends[4], ends[5]]]
    for room in (2, 3):
        places = np.zeros((room, 2), np.int64)
        assert scan.definitions(array(b"".join(parts)), places) == 3
        assert places.tolist() == expected[:room]


def located(data: bytes, wanted: list[int], n: int) -> tuple[int, list[list[int]], list[int], list[int]]:
    places, log, publish = np.zeros((n, 3), np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    found = scan.locate(array(data), np.array(wanted, np.int64), places, log, publish)
    return int(found), places.tolist(), log.tolist(), publish.tolist()


def test_messages_are_located_by_channel() -> None:
    data = record(3, b"x") + message(0x1234, 1, 2, b"a") + message(5, 3, 4) + message(0x1234, 5, LATE)
    at = [10, 10 + 32, 10 + 32 + 31]
    everything = [[at[0], at[1], 0x1234], [at[1], at[2], 5], [at[2], at[2] + 31, 0x1234]]
    assert located(data, [], 3) == (3, everything, [1, 3, 5], [2, 4, LATE])
    assert located(data, [9, 0x1234], 2) == (2, [everything[0], everything[2]], [1, 5], [2, LATE])
    assert located(data, [5, 5], 1) == (1, [everything[1]], [3], [4])
    assert located(data, [5], 2)[0] == located(data, [0x1234], 1)[0] == located(data, [9], 1)[0] == scan.OTHER_COUNT
    assert located(data, [9], 0)[0] == 0


FIELDS = np.array([[1, 0x11, 0], [10, 0x1D, -1], [15, 0x21, 1], [24, 0x25, -2]], np.int64)


def fixed(a: int, b: int, c: int, d: int) -> bytes:
    return struct.pack("<BQBIBQBI", 0x11, a, 0x1D, b, 0x21, c, 0x25, d)


def collected(
    data: bytes, wanted: list[int], room: int, row: int = 0, size: int = 28
) -> tuple[int, list[list[int]], list[int], list[list[int]], list[list[int]]]:
    n = 6
    heads, sequence = np.zeros((2, n), np.int64), np.zeros(n, np.uint32)
    wide, narrow = np.zeros((2, n), np.uint64), np.zeros((2, n), np.uint32)
    found = scan.collect(
        array(data), np.array(wanted, np.int64), size, FIELDS, heads, sequence, wide, narrow, row, room
    )
    part = slice(row, row + room)
    return (
        int(found),
        heads[:, part].tolist(),
        sequence[part].tolist(),
        wide[:, part].tolist(),
        narrow[:, part].tolist(),
    )


def test_results_in_place_of_a_number_are_not_a_number_of_messages() -> None:
    codes = (scan.BROKEN, scan.OTHER_LAYOUT, scan.OTHER_COUNT)
    assert len(set(codes)) == 3
    assert max(codes) < 0


def test_messages_of_a_constant_layout_become_columns() -> None:
    data = (
        message(1, 10, 20, fixed(BIG, 2, 3, 0x87654321), 0xFEDCBA98)
        + message(2, 99, 99, b"another")
        + message(0x0301, 11, LATE, fixed(5, 6, BIG, 8), 1)
    )
    columns = ([[10, 11], [20, LATE]], [0xFEDCBA98, 1], [[BIG, 5], [3, BIG]], [[2, 6], [0x87654321, 8]])
    for row in (0, 3):
        assert collected(data, [1, 0x0301], 2, row) == (2, *columns)
    assert collected(data, [1, 0x0301], 1)[0] == collected(data, [1, 0x0301], 3)[0] == scan.OTHER_COUNT
    assert collected(data, [1], 1)[0] == 1
    assert collected(data, [2], 1)[0] == collected(data, [1], 1, size=27)[0] == scan.OTHER_LAYOUT
    assert collected(data, [9], 0)[0] == collected(data, [], 0)[0] == 0
    for kind in (4, 6):  # another record with the same bytes
        assert collected(bytes([kind]) + message(1, 1, 1, fixed(1, 2, 3, 4))[1:], [1], 0)[0] == 0
    for at in (0, 9, 14, 23):  # a wrong tag
        wrong = bytearray(fixed(1, 2, 3, 4))
        wrong[at] ^= 1
        assert collected(message(1, 1, 1, bytes(wrong)), [1], 1)[0] == scan.OTHER_LAYOUT


def index(channel: int, entries: list[tuple[int, int]], size: int | None = None) -> bytes:
    listed = b"".join(struct.pack("<QQ", *entry) for entry in entries)
    return record(7, struct.pack("<HI", channel, len(listed) if size is None else size) + listed)


def indexed(block: bytes, data: bytes = b"", room: int = 9) -> tuple[int, list[list[int]], list[int], int]:
    entries, times = np.zeros((room, 2), np.int64), np.array([2**64 - 1, 0], np.uint64)
    end, found, wrong = scan.message_indexes(array(block), array(data), entries, times)
    return int(end), entries[:found].tolist(), times.tolist(), int(wrong)


def test_message_indexes_are_read_up_to_another_record() -> None:
    first, second = index(0x1234, [(50, 1), (BIG, 2)]), index(7, [(40, 3)])
    both = first + second
    assert indexed(both + record(6, b"")) == (len(both), [[0x1234, 2], [7, 1]], [40, BIG], -1)
    assert indexed(both[:-1])[:2] == (len(first), [[0x1234, 2]])
    assert indexed(both, room=1)[:2] == (len(first), [[0x1234, 2]])
    assert indexed(index(7, [])) == (15, [[7, 0]], [2**64 - 1, 0], -1)
    assert indexed(index(7, [(40, 1)]))[2] == [40, 40]
    assert indexed(index(7, [])[:14])[:2] == (0, [])
    for size in (15, 17, 0):
        assert indexed(index(7, [(40, 3)], size))[:2] == (0, [])
    assert indexed(record(7, struct.pack("<HI", 7, 8) + bytes(8)))[:2] == (0, [])
    for kind in (6, 8):  # another record with the same bytes
        assert indexed(first + bytes([kind]) + second[1:])[:2] == (len(first), [[0x1234, 2]])


def test_message_indexes_are_compared_with_their_chunk() -> None:
    data = message(7, 40) + message(0x1234, 50)
    right = index(7, [(40, 0)]) + index(0x1234, [(50, 31)])
    assert indexed(right, data)[3] == -1
    good = index(7, [(40, 0)])
    for wrong in (
        index(8, [(40, 0)]),
        index(7, [(41, 0)]),
        index(7, [(40, 1)]),
        index(7, [(40, 31)]),
        index(7, [(40, 32)]),
        index(7, [(40, 2**63)]),
        index(7, [(40, 0), (40, 9)]),
    ):
        assert indexed(wrong, data)[3] == 0
        assert indexed(good + wrong + wrong, data)[3] == len(good)
    assert indexed(index(5, [(0, 0)]), b"\x05" + bytes(20))[3] == 0  # shorter than a message


def chunk_index(
    start: int = 100,
    size: int = 50,
    offsets: list[tuple[int, int]] | None = None,
    behind: int = 31 + 47,
    name: bytes = b"zstd",
    packed: int = 30,
    unpacked: int = 31 * 3,
    first: int = 5,
    last: int = 9,
    **other: Any,
) -> bytes:
    """A chunk of 50 bytes at byte 100; one message of channel 3 and two of channel 0x1234 in the indexes behind it."""
    entries = [(3, 150), (0x1234, 181)] if offsets is None else offsets
    table = b"".join(struct.pack("<HQ", *entry) for entry in entries) + other.get("more", b"")
    body = struct.pack("<QQQQI", first, last, start, size, len(table)) + table
    body += struct.pack("<QI", behind, other.get("name_bytes", len(name))) + name + struct.pack("<QQ", packed, unpacked)
    return record(8, body + other.get("rest", b""))


def chunks(block: bytes, n: int = 4, entries: int = 8) -> tuple[int, dict[str, Any]]:
    numbers, kinds = np.zeros((6, n), np.int64), np.zeros(n, np.uint8)
    first_entry, channels = np.zeros(n + 1, np.int64), np.zeros(entries, np.uint16)
    counts, totals, state = np.zeros(entries, np.uint32), np.zeros(65536, np.int64), np.zeros(3, np.int64)
    used = scan.chunk_indexes(array(block), numbers, kinds, first_entry, channels, counts, totals, state)
    k, e = int(state[0]), int(state[1])
    return int(used), {
        "numbers": numbers[:, :k].T.tolist(),
        "kinds": kinds[:k].tolist(),
        "first_entry": first_entry[: k + 1].tolist(),
        "entries": list(zip(channels[:e].tolist(), counts[:e].tolist(), strict=True)),
        "totals": {int(i): int(totals[i]) for i in np.flatnonzero(totals)},
        "end": int(state[2]),
    }


def test_chunk_indexes_become_arrays() -> None:
    first = chunk_index()
    second = chunk_index(228, 20, [(3, 248)], behind=15 + 32, name=b"", packed=7, unpacked=62, first=0, last=LATE)
    third = chunk_index(300, 10, [], behind=0, name=b"lz4", unpacked=0)
    fourth = chunk_index(310, 10, [], behind=0, name=b"zst1")
    block = first + second + third + fourth
    used, found = chunks(block + record(3, b""))
    assert used == len(block)
    assert found["numbers"] == [
        [100, 50, 30, 93, 5, 9],
        [228, 20, 7, 62, 0, LATE],
        [300, 10, 30, 0, 5, 9],
        [310, 10, 30, 93, 5, 9],
    ]
    assert (found["kinds"], found["first_entry"]) == ([1, 0, 2, 2], [0, 2, 3, 3, 3])
    assert found["entries"] == [(3, 1), (0x1234, 2), (3, 2)]
    assert (found["totals"], found["end"]) == ({3: 3, 0x1234: 2}, 320)


def test_a_message_index_may_list_no_message() -> None:
    block = chunk_index(offsets=[(3, 150), (7, 181), (0x1234, 196)], behind=31 + 15 + 47)
    used, found = chunks(block)
    assert (used, found["entries"][:3]) == (len(block), [(3, 1), (7, 0), (0x1234, 2)])


def test_an_incomplete_chunk_index_is_the_rest() -> None:
    first = chunk_index()
    assert chunks(first + first[:-1])[0] == len(first)
    assert chunks(first[:8])[0] == chunks(b"")[0] == chunks(record(3, bytes(99)))[0] == 0


@pytest.mark.parametrize(
    "change",
    [
        {"rest": b"\0"},
        {"more": b"\0"},
        {"name_bytes": 3},
        {"name_bytes": 5},
        {"name_bytes": 2**32 - 1},
        {"size": 51},  # the indexes begin within the chunk
        {"behind": 31 + 47 + 1},
        {"behind": 31 + 47 - 16},  # not enough messages before the next one: the total is another
        {"behind": 2**63},
        {"unpacked": 31 * 3 - 1},  # room for two messages
        {"unpacked": 2**63},
        {"packed": 2**63},
        {"first": 2**63},
        {"last": 2**63},
        {"start": 2**63},
        {"size": 2**63},
        {"start": 2**60, "offsets": [], "behind": 0},
        {"size": 2**60, "offsets": [], "behind": 0},
        {"packed": 2**60},
        {"unpacked": 2**60},
        {"behind": 2**60},
        {"offsets": [(3, 150), (0x1234, 180)]},
        {"offsets": [(3, 149), (0x1234, 181)]},
        {"offsets": [(3, 181), (0x1234, 150)]},
    ],
)
def test_a_chunk_index_that_contradicts_itself_is_broken(change: dict[str, Any]) -> None:
    used, found = chunks(chunk_index(**change))
    if change == {"behind": 31 + 47 - 16}:
        assert found["totals"] == {3: 1, 0x1234: 1}
    else:
        assert used == scan.BROKEN


def test_the_largest_numbers_of_a_chunk_index_are_accepted() -> None:
    most = 2**60 - 1
    for change in ({"packed": most}, {"unpacked": most}, {"first": LATE, "last": LATE}, {"unpacked": 31 * 3 + 30}):
        block = chunk_index(**change)
        assert chunks(block)[0] == len(block)
    far = chunk_index(most, 1, [], behind=0)
    assert chunks(far)[1]["end"] == 2**60


def test_chunks_are_in_order_and_do_not_overlap() -> None:
    first = chunk_index()
    for start, accepted in ((228, True), (227, False)):
        second = chunk_index(start, 20, [], behind=0)
        assert chunks(first + second)[0] == (len(first + second) if accepted else scan.BROKEN)


def test_there_is_no_more_than_room() -> None:
    block = chunk_index()
    assert chunks(block, 1, 2)[0] == len(block)
    assert chunks(block, 0, 2)[0] == chunks(block, 1, 1)[0] == scan.BROKEN
    assert chunks(record(8, bytes(63)))[0] == scan.BROKEN
    assert chunks(record(8, bytes(64)))[0] == 73


# --- records ---------------------------------------------------------------------------------------------------


def on_disk(folder: Path, data: bytes) -> FileBytes:
    path = folder / "a.mcap"
    path.write_bytes(data)
    return FileBytes(path)


@pytest.mark.parametrize(("wrong", "ours"), [(0, True), (3, True), (11, True), (12, False), (38, False)])
def test_a_header_with_a_few_wrong_letters_keeps_the_checks(tmp_path: Path, wrong: int, ours: bool) -> None:
    """At least seven tenths of the 38 letters."""
    name = ("#" * wrong + LIBRARY[wrong:]).encode()
    body = struct.pack("<I", 0) + struct.pack("<I", len(name)) + name
    found = read_header(on_disk(tmp_path, MAGIC + record(1, body)))
    assert (found.library, found.ours) == (name.decode(), ours)


def test_a_header_that_cannot_be_read_has_no_library(tmp_path: Path) -> None:
    for rest in (b"", record(2, bytes(8)), record(1, b"\xff" * 8), record(1, bytes(8))[:-1]):
        assert read_header(on_disk(tmp_path, MAGIC + rest)) == Header("", False)
    with pytest.raises(LogError, match="begins with"):
        read_header(on_disk(tmp_path, b"\x88" + MAGIC[1:]))


def test_a_record_has_a_largest_length(tmp_path: Path) -> None:
    file = on_disk(tmp_path, b"\x09" + record(12, b"12345"))
    assert read_record(file, 1, 5) == (12, b"12345")
    for position, limit in ((1, 4), (2, 99), (9, 99)):
        with pytest.raises(DamageError):
            read_record(file, position, limit)


def text(data: str) -> bytes:
    return struct.pack("<I", len(data)) + data.encode()


def metadata(**texts: str) -> bytes:
    table = b"".join(text(key) + text(value) for key, value in texts.items())
    return text("facts") + struct.pack("<I", len(table)) + table


def test_metadata_of_other_writers_may_use_the_key_of_our_checksum() -> None:
    crc = metadata_crc("facts", {"a": "b"})
    for ours in (True, False):
        assert check_metadata(metadata(a="b", crc32=crc), ours) == ("facts", {"a": "b"})
    for other in (
        metadata(a="b"),
        metadata(a="b", crc32="1234"),
        metadata(a="c", crc32=crc),
        metadata(crc32="ABCDEF01"),
    ):
        name, texts = check_metadata(other, False)
        assert name == "facts"
        assert len(texts) == other.count(b"crc32") + other.count(b"a\x01")
        with pytest.raises(DamageError, match="CRC is wrong"):
            check_metadata(other, True)


def test_a_record_of_facts_may_have_64_MiB(tmp_path: Path) -> None:
    limit = 64 * 2**20
    frame = len(metadata(a=""))
    for size, accepted in ((limit - 1024, True), (limit + 1024, False)):
        file = on_disk(tmp_path, MAGIC + record(12, metadata(a="b" * (size - frame))))
        if accepted:
            assert len(read_metadata(file, len(MAGIC), ours=False)[1]["a"]) == size - frame
        else:
            with pytest.raises(DamageError):
                read_metadata(file, len(MAGIC), ours=False)


def attachment(data: bytes = b"12345", crc: int | None = None, name: bytes = b"a.json", **wrong: int) -> bytes:
    body = struct.pack("<QQ", 3, 4)
    for key, value in (("label", name), ("media", b"text/x")):
        body += struct.pack("<I", len(value) + wrong.get(key, 0)) + value
    body += struct.pack("<Q", len(data) + wrong.get("content", 0)) + data
    return record(9, body + struct.pack("<I", crc32(body) if crc is None else crc))


def test_an_attachment_is_checked_and_read(tmp_path: Path) -> None:
    whole = attachment()
    file = on_disk(tmp_path, b"##" + whole)
    for ours in (True, False):
        place = check_attachment(file, 2, ours)
        assert place == AttachmentPlace(2, len(whole), "a.json")
        found = read_attachment(file, place, ours)
        assert (found.name, found.media_type, found.data, found.log_time, found.create_time) == (
            "a.json",
            "text/x",
            b"12345",
            3,
            4,
        )
        for other in (replace(place, name="b.json"), replace(place, length=len(whole) + 1), replace(place, start=1)):
            with pytest.raises(DamageError):
                read_attachment(file, other, ours)


def test_an_attachment_without_a_crc_is_one_of_other_writers(tmp_path: Path) -> None:
    file = on_disk(tmp_path, attachment(crc=0))
    place = check_attachment(file, 0, False)
    assert read_attachment(file, place, False).data == b"12345"
    for check in (lambda: check_attachment(file, 0, True), lambda: read_attachment(file, place, True)):
        with pytest.raises(DamageError, match=r"'a\.json' whose CRC is wrong"):
            check()
    for ours, crc in itertools.product((True, False), (5, 2**32 - 1)):
        with pytest.raises(DamageError, match="CRC is wrong"):
            check_attachment(on_disk(tmp_path, attachment(crc=crc)), 0, ours)


def test_a_message_has_the_beginning_of_a_long_name(tmp_path: Path) -> None:
    file = on_disk(tmp_path, attachment(crc=5, name=b"a" * 79 + b"bc"))
    with pytest.raises(DamageError, match=f"^attachment '{'a' * 79}b' whose CRC is wrong"):
        check_attachment(file, 0, False)


@pytest.mark.parametrize("key", ["label", "media", "content"])
@pytest.mark.parametrize("by", [-1, 1, 20, 2**20])
@pytest.mark.parametrize("after", [b"", bytes(99)])
def test_an_attachment_whose_lengths_contradict_each_other_is_damaged(
    tmp_path: Path, key: str, by: int, after: bytes
) -> None:
    with pytest.raises(DamageError, match="lengths"):
        check_attachment(on_disk(tmp_path, attachment(**{key: by}) + after), 0, False)


def test_an_attachment_has_its_kind_and_its_least_length(tmp_path: Path) -> None:
    least = record(9, bytes(36))
    assert check_attachment(on_disk(tmp_path, least), 0, False) == AttachmentPlace(0, 45, "")
    for other in (record(9, bytes(35)), record(8, bytes(36)), least[:-1]):
        with pytest.raises(DamageError, match="lengths"):
            check_attachment(on_disk(tmp_path, other), 0, False)


def test_the_first_definition_of_an_id_holds() -> None:
    def schema(number: int, name: str) -> bytes:
        return struct.pack("<H", number) + text(name) + text("") + struct.pack("<I", 0)

    def channel(number: int, topic: str) -> bytes:
        return struct.pack("<HH", number, 1) + text(topic) + text("") + struct.pack("<I", 0)

    found, others = Definitions(), Definitions()
    for _ in range(2):
        found.take(3, schema(1, "one"))
        found.take(4, channel(1, "a"))
    for kind, body in ((3, schema(1, "two")), (4, channel(1, "b")), (3, b"\x01"), (4, b"\x01")):
        with pytest.raises(DamageError):
            found.take(kind, body)
    others.take(3, schema(1, "two"))
    others.take(4, channel(2, "b"))
    found.fill_up(others)
    assert [schema.name for schema in found.schemas.values()] == ["one"]
    assert {number: channel.topic for number, channel in found.channels.items()} == {1: "a", 2: "b"}
