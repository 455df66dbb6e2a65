"""Records in hand-made bytes: their places and fields, cut or too long by a byte; header, metadata and attachments."""

from __future__ import annotations

import itertools
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from daq.errors import LogError
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
from daq.mcap.scan import record_places, split_chunk
from daq.mcap.writer import LIBRARY, MAGIC, metadata_crc
from tests.daq.mcap.made_bytes import attachment, message, record, table, text
from tests.effort import cases

BIG = 0x8877665544332211


RECORDS = st.one_of(
    st.tuples(st.integers(1, 255), st.binary(max_size=40)).map(lambda pair: record(*pair)),
    st.tuples(st.integers(0, 3), st.integers(0, 2**64 - 1), st.binary(max_size=3)).map(
        lambda row: message(row[0], row[1], row[2])
    ),
)


@settings(max_examples=cases(60, 600))
@given(st.lists(st.tuples(RECORDS, st.sampled_from([1, 1, 2, 70, 400])), max_size=12), st.integers(0, 60))
def test_records_are_found_one_after_the_other(runs: list[tuple[bytes, int]], cut: int) -> None:
    """Any repetition of equal records, and a last one that is cut."""
    each = [part for part, count in runs for _ in range(count)]
    data = b"".join(each)
    whole = data[: max(0, len(data) - cut)]
    offsets, sizes, end = record_places(whole)
    found = [whole[at : at + size] for at, size in zip(offsets.tolist(), sizes.tolist(), strict=True)]
    assert found == each[: len(found)]
    assert end == sum(map(len, found))
    assert len(found) == len(each) or len(whole) < end + len(each[len(found)])


def test_messages_of_a_chunk_have_their_fields() -> None:
    data = (
        record(3, b"schema")
        + message(0x1234, 50, b"ab", 61, 2**32 - 1)
        + record(4, b"channel")
        + message(7, 40, b"", 90)
        + message(0x1234, BIG, b"c", 60)
        + record(0x80, b"unknown")
    )
    found, definitions = split_chunk(data)
    assert definitions == [(3, b"schema"), (4, b"channel")]
    assert found.channel_ids.tolist() == [0x1234, 7, 0x1234]
    assert found.log_ns.tolist() == [50, 40, BIG]
    assert found.publish_ns.tolist() == [61, 90, 60]
    assert found.sequences.tolist() == [2**32 - 1, 0, 0]
    assert [found.payload(row) for row in range(3)] == [b"ab", b"", b"c"]
    assert (found.counts, found.span()) == ({7: 1, 0x1234: 2}, (40, BIG))
    part = found.part(found.channel_ids == 7)
    assert (len(part), part.payload(0), part.span()) == (1, b"", (40, 40))
    assert split_chunk(b"")[0].span() == (0, 0)


@pytest.mark.parametrize(
    "data",
    [
        message(1, 0)[:-1],
        message(1, 0) + b"\x05",
        message(1, 0) + record(0, b"x"),
        record(5, bytes(21)),
        message(1, 0)[:1] + b"\xff" * 8 + message(1, 0)[9:],
        message(1, 0) + message(1, 0)[:1] + struct.pack("<Q", 2**63) + message(1, 0)[9:],
    ],
)
def test_records_that_are_not_whole_are_damage(data: bytes) -> None:
    with pytest.raises(DamageError, match="whole records"):
        split_chunk(data)


def test_a_difference_in_a_long_run_of_equal_heads_ends_it() -> None:
    rows = [message(1, k) for k in range(3000)]
    for place in (1, 64, 65, 1000, 2999):
        for changed in (message(2, 5), message(1, 5, b"123"), record(4, rows[0][9:])):
            data = b"".join([*rows[:place], changed, *rows[place + 1 :]])
            offsets, sizes, end = record_places(data)
            assert (len(offsets), int(sizes.sum()), end) == (3000, len(data), len(data))
            assert data[offsets[place] : offsets[place] + sizes[place]] == changed


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


def facts(**texts: str) -> bytes:
    return text("facts") + table(texts)


def test_metadata_of_other_writers_may_use_the_key_of_our_checksum() -> None:
    crc = metadata_crc("facts", {"a": "b"})
    for ours in (True, False):
        assert check_metadata(facts(a="b", crc32=crc), ours) == ("facts", {"a": "b"}, True)
    for other in (
        facts(a="b"),
        facts(a="b", crc32="1234"),
        facts(a="c", crc32=crc),
        facts(crc32="ABCDEF01"),
    ):
        name, texts, has_crc = check_metadata(other, False)
        assert (name, has_crc) == ("facts", False)
        assert len(texts) == other.count(b"crc32") + other.count(b"a\x01")
        with pytest.raises(DamageError, match="CRC is wrong"):
            check_metadata(other, True)


def test_a_record_of_facts_may_have_64_MiB(tmp_path: Path) -> None:
    limit = 64 * 2**20
    frame = len(facts(a=""))
    for size, accepted in ((limit - 1024, True), (limit + 1024, False)):
        file = on_disk(tmp_path, MAGIC + record(12, facts(a="b" * (size - frame))))
        if accepted:
            assert len(read_metadata(file, len(MAGIC), ours=False)[1]["a"]) == size - frame
        else:
            with pytest.raises(DamageError):
                read_metadata(file, len(MAGIC), ours=False)


def test_an_attachment_is_checked_and_read(tmp_path: Path) -> None:
    whole = attachment()
    file = on_disk(tmp_path, b"##" + whole)
    for ours in (True, False):
        place, has_crc = check_attachment(file, 2, ours)
        assert has_crc
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
    place, has_crc = check_attachment(file, 0, False)
    assert not has_crc
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
    """Shorter data is followed by bytes of an unknown field, but not by its CRC."""
    with pytest.raises(DamageError, match="CRC" if (key, by) == ("content", -1) else "lengths"):
        check_attachment(on_disk(tmp_path, attachment(**{key: by}) + after), 0, False)


def test_an_attachment_has_its_kind_and_its_least_length(tmp_path: Path) -> None:
    least = record(9, bytes(36))
    assert check_attachment(on_disk(tmp_path, least), 0, False) == (AttachmentPlace(0, 45, ""), False)
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
