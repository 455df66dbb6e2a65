"""Hand-made MCAP files with one fault each: where the walk and the summary's reader find it, and what they keep."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest

from daq.errors import LogError
from daq.mcap.checksum import crc32
from daq.mcap.contents import Contents
from daq.mcap.file_bytes import FileBytes
from daq.mcap.reader import walk
from daq.mcap.records import DamageError
from daq.mcap.summary_reader import FileSummary, read_summary
from daq.mcap.writer import LIBRARY, MAGIC
from tests.daq.mcap.made_bytes import (
    FRONT,
    INNER,
    LOOSE,
    channel,
    chunk,
    data_end,
    ending,
    finished,
    header,
    indexes,
    message,
    metadata,
    record,
    statistics,
    text,
)


def walked(folder: Path, data: bytes) -> Contents:
    path = folder / "a.mcap"
    path.write_bytes(data)
    return walk(FileBytes(path))


AT = len(FRONT)
CHUNK_OF_ALL = chunk(INNER, 10, 30)
FACTS = metadata("facts", {"a": "b"})
SHORT = record(5, bytes(21))
EARLY = statistics(0, {})
SUMMARY = channel(1, "a") + statistics(3, {1: 2, 2: 1})


@pytest.mark.parametrize("begin", [b"", record(1, b"\xff" * 9), record(1, text("")[:3])])
def test_a_damaged_header_costs_the_header_alone(tmp_path: Path, begin: bytes) -> None:
    found = walked(tmp_path, MAGIC + begin + metadata("one", {"a": "b"}) + CHUNK_OF_ALL)
    assert found.counts == {1: 2, 2: 1}
    assert found.missing[0].text.startswith("the header is damaged: ")
    assert found.missing[0].byte_start == len(MAGIC)
    assert found.missing[0].byte_end == len(MAGIC) + max(1, len(begin))  # also without a header the place is not empty


@pytest.mark.parametrize(
    "whole",
    [
        finished(LOOSE),
        finished(LOOSE, end=data_end(crc32(FRONT + LOOSE))),
        finished(LOOSE, summary=SUMMARY),
        finished(LOOSE, summary=SUMMARY, crc=None),
        *(finished(record(kind, b"abc"), CHUNK_OF_ALL) for kind in (0x10, 0x80, 0xFF)),  # of other writers
    ],
)
def test_a_sound_file_has_all_its_messages_and_no_fault(tmp_path: Path, whole: bytes) -> None:
    found = walked(tmp_path, whole)
    assert (found.counts, found.missing) == ({1: 2, 2: 1}, [])
    assert found.table.span() == (10, 30)


@pytest.mark.parametrize(
    ("data", "words", "start", "length"),
    [
        (finished(LOOSE, CHUNK_OF_ALL), "messages outside of chunks, left out", AT, len(LOOSE)),
        (finished(LOOSE, SHORT, FACTS), "a message shorter than its own head", AT + len(LOOSE), len(SHORT)),
        (finished(EARLY, CHUNK_OF_ALL), "a record of kind 0x0b, which is not allowed here", AT, len(EARLY)),
        (finished(record(0, b"abc"), CHUNK_OF_ALL), "kind 0", AT, 12),
        (
            finished(LOOSE, end=data_end(crc32(FRONT + LOOSE) ^ 1)),
            "the CRC of the whole data section is wrong, though every chunk in it is right",
            0,
            AT + len(LOOSE),
        ),
        (finished(LOOSE, end=record(15, b"")), "an end of the data of the wrong length", AT + len(LOOSE), None),
        (finished(LOOSE, end=record(15, bytes(3))), "an end of the data of the wrong length", AT + len(LOOSE), None),
        (
            finished(LOOSE, end=b""),
            "a footer of another length than 20 bytes, or before the end of the data",
            AT + len(LOOSE),
            None,
        ),
        (FRONT + LOOSE + data_end() + record(2, bytes(21)) + MAGIC, "a footer of another length", None, None),
        (finished(LOOSE)[:-1], "the file was not finished or is cut.*after the footer", None, None),
        (
            finished(LOOSE) + b"x",
            "bytes after the end of the log, which do not belong to it",
            len(finished(LOOSE)),
            1,
        ),
        (
            finished(LOOSE, summary=channel(1, "a") + statistics(4, {1: 2, 2: 2})),
            "the statistics count 4 messages",
            None,
            None,
        ),
        (
            finished(LOOSE, summary=SUMMARY, crc=1),
            "the summary cannot be used: a summary whose CRC is wrong or missing",
            None,
            None,
        ),
    ],
)
def test_a_fault_is_found_where_it_stands_and_costs_no_message(
    tmp_path: Path, data: bytes, words: str, start: int | None, length: int | None
) -> None:
    found = walked(tmp_path, data)
    assert found.counts == {1: 2, 2: 1}
    place = found.missing[0]
    assert re.search(words, place.text)
    assert start in (None, place.byte_start)
    assert length is None or place.byte_end == place.byte_start + length


def test_messages_outside_of_chunks_are_kept_where_there_is_no_chunk(tmp_path: Path) -> None:
    """Also two like series of them: without a CRC only chunks can show that the same bytes were copied over others."""
    found = walked(tmp_path, finished(LOOSE, FACTS, metadata("two", {"c": "d"}, ours=True), LOOSE))
    assert (found.counts, found.missing) == ({1: 4, 2: 2}, [])
    assert found.metadata == {"facts": {"a": "b"}, "two": {"c": "d"}}
    assert found.table.start.tolist()[0] == AT
    assert found.table.length.tolist() == [len(LOOSE)] * 2
    unchecked = [place.text.partition(" without")[0] for place in found.unchecked]
    assert sorted(unchecked) == ["1 data section", "1 metadata record", "1 summary", "2 series of messages"]


def test_many_messages_outside_of_chunks_are_kept_in_series_of_about_4_MiB(tmp_path: Path) -> None:
    each = message(1, 10, bytes(2**20))
    found = walked(tmp_path, finished(6 * each))
    assert (found.counts, found.missing) == ({1: 6}, [])
    assert found.table.length.tolist() == [4 * len(each), 2 * len(each)]


def test_a_summary_that_the_disk_does_not_read_again_is_damaged(tmp_path: Path) -> None:
    class Failing(FileBytes):
        def crc(self, start: int, end: int, crc: int = 0) -> int:
            raise LogError(f"expected {end - start} bytes at byte {start}, the disk cannot read them")

    path = tmp_path / "a.mcap"
    path.write_bytes(finished(LOOSE, summary=SUMMARY, crc=None))
    assert [place.text.partition(":")[0] for place in walk(Failing(path)).missing] == ["the summary cannot be used"]


@pytest.mark.parametrize(("size", "refused"), [(64 * 2**20, True), (64 * 2**20 - 9, False)])
def test_metadata_of_more_than_64_MiB_are_damage(tmp_path: Path, size: int, refused: bool) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        file.write(FRONT + struct.pack("<BQ", 12, size))
        file.seek(size, 1)  # a hole
        file.write(LOOSE + data_end() + ending(b"", b""))
    faults_there = [(place.text, place.byte_start) for place in walk(FileBytes(path)).missing]
    assert ((f"metadata of {size + 9} bytes", len(FRONT)) in faults_there) is refused


def test_the_limit_of_metadata_does_not_depend_on_their_place(tmp_path: Path) -> None:
    path, size = tmp_path / "a.mcap", 65 * 2**20
    with path.open("wb") as file:
        file.write(FRONT + struct.pack("<BQ", 0x80, size))
        file.seek(size, 1)  # a hole
        file.write(metadata("one", {"a": "b"}) + LOOSE)
    assert walk(FileBytes(path)).metadata == {"one": {"a": "b"}}


def test_messages_outside_of_chunks_that_the_disk_does_not_read_again_are_left_out(tmp_path: Path) -> None:
    class Failing(FileBytes):
        def read(self, start: int, length: int) -> bytes:
            if (start, length) == (len(FRONT), len(LOOSE)):
                raise LogError("the disk cannot read them")
            return super().read(start, length)

    path = tmp_path / "a.mcap"
    path.write_bytes(FRONT + LOOSE)
    found = walk(Failing(path))
    assert found.counts == {}
    (place,) = found.missing
    assert "the disk cannot read them, left out" in place.text


def test_the_search_for_intact_records_never_returns_to_an_earlier_place(tmp_path: Path) -> None:
    """An index of 8 bytes has the head of one, so that the search stops at it; the next search begins behind it."""
    first, last = chunk(INNER, 10, 30), chunk(message(2, 99), 99, 99)
    broken = bytes(2**22) + record(7, struct.pack("<HI", 1, 8) + bytes(8))
    found = walked(tmp_path, finished(first, broken, last))
    assert found.counts == {1: 2, 2: 2}
    assert found.table.start.tolist() == [len(FRONT), len(FRONT + first + broken)]
    (place,) = found.missing
    assert (place.byte_start, place.byte_end) == (len(FRONT + first), len(FRONT + first + broken))


@pytest.mark.parametrize(
    ("listed", "fault", "missing"),
    [
        ({"c1": [(10, 0), (30, 70)], "c2": [(20, 35)]}, None, 0),
        ({}, None, 0),  # other writers need none
        ({"c1": [(10, 0), (30, 70)]}, "message indexes before this place do not list every message of their chunk", 0),
        ({"c1": [(10, 0), (31, 70)], "c2": [(20, 35)]}, "message indexes that do not fit their chunk", 0),
        (
            {"c1": [(10, 0), (30, 70)], "c2": [(20, 35)], "c3": [(30, 70)]},
            "message indexes that do not fit their chunk",
            None,  # they may belong to a chunk that is missing
        ),
        ({"c1": [(10, 0)], "c2": [(20, 35)]}, "message indexes that do not fit their chunk", None),
    ],
)
def test_message_indexes_list_the_messages_of_their_chunk(
    tmp_path: Path, listed: dict[str, list[tuple[int, int]]], fault: str | None, missing: int | None
) -> None:
    found = walked(tmp_path, finished(CHUNK_OF_ALL, indexes(**listed)))
    assert found.counts == {1: 2, 2: 1}
    first = [(place.text, place.messages) for place in found.missing][:1]
    assert first == ([] if fault is None else [(fault, missing)])


@pytest.mark.parametrize(("more", "missing"), [(0, 0), (1, None)])
def test_damage_as_long_as_the_missing_indexes_held_no_message(tmp_path: Path, more: int, missing: int | None) -> None:
    before, index = FRONT + chunk(INNER, 10, 30) + indexes(c1=[(10, 0), (30, 70)]), indexes(c2=[(20, 35)])
    lost = index[:1] + bytes([index[1] - 1]) + index[2:] + bytes(more)
    (place, _) = walked(tmp_path, before + lost + chunk(message(2, 99), 99, 99)).missing
    assert (place.byte_start, place.byte_end) == (len(before), len(before + lost))
    assert place.messages == missing


@pytest.mark.parametrize(
    ("first", "last", "wrong"), [(10, 30, False), (9, 30, True), (11, 30, True), (10, 29, True), (10, 31, True)]
)
def test_a_chunk_of_ours_has_the_times_of_its_messages(tmp_path: Path, first: int, last: int, wrong: bool) -> None:
    data = MAGIC + header(LIBRARY) + channel(1, "a") + channel(2, "b") + chunk(INNER, first, last)
    texts = [place.text for place in walked(tmp_path, data).missing]
    assert ("a chunk whose head has other times than its messages; those of the messages are used" in texts) is wrong


def test_a_chunk_with_a_wrong_crc_is_left_out_and_its_indexes_state_what_it_held(tmp_path: Path) -> None:
    bad = chunk(INNER, 10, 30, crc=5)
    good = chunk(message(2, 99), 99, 99)
    listed = indexes(c1=[(10, 0), (30, 70)], c2=[(20, 35)])
    found = walked(tmp_path, finished(bad, listed, good))
    assert found.counts == {2: 1}
    (place,) = found.missing
    assert place.text == "a chunk whose CRC is wrong, left out"
    assert (place.byte_start, place.byte_end) == (len(FRONT), len(FRONT + bad + listed))
    assert (place.messages, place.topics) == (3, ("a", "b"))


def test_the_walk_reports_its_share(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(finished(LOOSE))
    shares: list[float] = []
    walk(FileBytes(path), shares.append)
    assert shares == sorted(shares)
    assert shares[0] == pytest.approx(len(MAGIC) / path.stat().st_size)
    assert shares[-1] <= 1.0


# --- summary ---------------------------------------------------------------------------------------------------


def index(start: int, length: int, count: int, unpacked: int) -> bytes:
    """Index of a chunk with messages of channel 1 only, whose message index follows it."""
    entries = struct.pack("<HQ", 1, start + length)
    behind = 15 + 16 * count
    body = struct.pack("<QQQQI", 10, 30, start, length, len(entries)) + entries
    return record(8, body + struct.pack("<Q", behind) + text("") + struct.pack("<QQ", unpacked, unpacked))


RECORDS = message(1, 10) + message(1, 30)
CHUNK = chunk(RECORDS, 10, 30)
BODY = FRONT + CHUNK + indexes(c1=[(10, 0), (30, 35)]) + data_end(77)
INDEX = index(len(FRONT), len(CHUNK), 2, len(RECORDS))


def longer(whole: bytes, extra: bytes) -> bytes:
    """The record with bytes after its known fields."""
    return record(whole[0], whole[9:] + extra)


def summarised(folder: Path, summary: bytes, body: bytes = BODY, **end: int | None) -> FileSummary:
    path = folder / "a.mcap"
    path.write_bytes(body + ending(body, summary, end.get("crc")))
    return read_summary(FileBytes(path))


def test_a_summary_has_the_places_and_numbers_of_its_records(tmp_path: Path) -> None:
    for extra in (b"", b"new"):
        found = summarised(tmp_path, channel(1, "a") + longer(INDEX, extra) + statistics(2, {1: 2, 2: 0}, chunks=1))
        assert found.data_end == len(BODY) - 13
        assert (found.table.start.tolist(), found.table.length.tolist()) == ([len(FRONT)], [len(CHUNK)])
        assert found.table.unpacked.tolist() == [len(RECORDS)]
        assert found.table.index_at.tolist() == [len(FRONT) + len(CHUNK)]
        assert (found.table.start_ns.tolist(), found.table.end_ns.tolist()) == ([10], [30])
        assert (found.table.channel.tolist(), found.table.count.tolist()) == ([1], [2])
        assert found.table.first_entry.tolist() == [0, 1]
        assert list(found.definitions.channels) == [1]
        assert (found.attachments, found.metadata) == ([], [])
        assert found.table.crc is None


PLACES = record(13, struct.pack("<QQ", 5, 6) + text("facts"))
KEPT = record(10, struct.pack("<QQQQQ", 5, 6, 0, 0, 0) + text("a.json") + text(""))


def test_a_summary_may_be_longer_than_one_read(tmp_path: Path) -> None:
    many = PLACES * 9000 + KEPT * 4000
    long = record(13, struct.pack("<QQ", 5, 6) + text("f" * 300_000))
    found = summarised(tmp_path, channel(1, "a") + many + long + INDEX + statistics(2, {1: 2}, 1, 9001, 4000))
    assert (len(found.metadata), len(found.attachments)) == (9001, 4000)
    assert (found.metadata[0].offset, found.metadata[0].length, found.metadata[-1].name) == (5, 6, "f" * 300_000)


@pytest.mark.parametrize(
    ("summary", "fault"),
    [
        (INDEX + statistics(2, {1: 2}, 1), "lacks channels"),
        (channel(1, "a") + INDEX + statistics(3, {1: 2}, 1), "index everything"),
        (channel(1, "a") + INDEX + statistics(2, {1: 1}, 1), "index everything"),
        (channel(1, "a") + INDEX + statistics(2, {1: 2, 2: 1}, 1), "index everything"),
        (channel(1, "a") + INDEX + statistics(2, {1: 2}, 2), "index everything"),
        (channel(1, "a") + INDEX + PLACES + statistics(2, {1: 2}, 1), "index everything"),
        (channel(1, "a") + INDEX + KEPT + statistics(2, {1: 2}, 1), "index everything"),
        (channel(1, "a") + INDEX + statistics(2, {1: 2}, 1, facts=1), "index everything"),
        (channel(1, "a") + INDEX + statistics(2, {1: 2}, 1, attachments=1), "index everything"),
        (channel(1, "a"), "without statistics"),
        (channel(1, "a") + INDEX + INDEX + statistics(4, {1: 4}, 2), "contradicts itself"),
        (channel(1, "a") + index(len(BODY) - 13 - 47, 1, 2, 99) + statistics(2, {1: 2}, 1), "points beyond the data"),
        (channel(1, "a") + record(8, bytes(70))[:-1], "ends inside a record"),
        (b"\x04\x05", "ends inside a record"),
    ],
)
def test_a_summary_that_is_inconsistent_is_refused(tmp_path: Path, summary: bytes, fault: str) -> None:
    with pytest.raises(DamageError, match=fault):
        summarised(tmp_path, summary)


def test_a_summary_that_ends_at_the_end_of_the_data_is_accepted(tmp_path: Path) -> None:
    last = index(len(BODY) - 13 - 47 - 1, 1, 2, 99)
    assert summarised(tmp_path, channel(1, "a") + last + statistics(2, {1: 2}, 1)).table.start.tolist() == [
        len(BODY) - 61
    ]


def test_a_summary_has_statistics_and_its_crc(tmp_path: Path) -> None:
    """Only they show that everything is indexed."""
    with pytest.raises(DamageError, match="without statistics"):
        summarised(tmp_path, channel(1, "a") + INDEX)
    for crc in (0, 5):
        with pytest.raises(DamageError, match="CRC is wrong or missing"):
            summarised(tmp_path, channel(1, "a") + INDEX, crc=crc)


def test_a_file_without_a_summary_or_without_an_end_of_the_data_is_refused(tmp_path: Path) -> None:
    summary = channel(1, "a") + INDEX
    with pytest.raises(DamageError, match="no summary"):
        summarised(tmp_path, b"")
    for body in (BODY[:-13] + record(15, bytes(3)), BODY[:-13] + record(14, bytes(4)), BODY[:-13]):
        with pytest.raises(DamageError, match="no end of the data before the summary"):
            summarised(tmp_path, summary, body=body)
    path = tmp_path / "a.mcap"
    whole = BODY + ending(BODY, summary, None)
    footer = len(whole) - len(MAGIC) - 29
    for data in (
        whole[:-1],
        whole[:-1] + b"\0",
        whole + b"\0",
        whole[:footer] + bytes(29) + MAGIC,
        whole[:footer] + b"\x03" + whole[footer + 1 :],
        whole[: footer + 1] + b"\x15" + whole[footer + 2 :],
    ):
        path.write_bytes(data)
        with pytest.raises(DamageError, match="no footer at the end"):
            read_summary(FileBytes(path))
    path.write_bytes(MAGIC)
    with pytest.raises(DamageError):
        read_summary(FileBytes(path))
