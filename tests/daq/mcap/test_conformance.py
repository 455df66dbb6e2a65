"""The files of the format's conformance suite are read right, are whole, and are recovered record by record."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import lz4.frame
import pytest
import zstandard
from mcap import records
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from daq.log import open_log
from daq.log.recover import recover
from tests.daq.mcap.conformance import CONTENTS, MAGIC, Case, all_cases, encoded, file_of

_OWN = ("recovered", "times")


def found_in(data: bytes) -> tuple[list[records.McapRecord], ...]:
    """Definitions, messages, attachments and metadata that the library reads from a file."""
    found = list(StreamReader(io.BytesIO(data), validate_crcs=True).records)
    definitions = {repr(record): record for record in found if isinstance(record, records.Schema | records.Channel)}
    return (
        list(definitions.values()),
        [record for record in found if isinstance(record, records.Message)],
        [record for record in found if isinstance(record, records.Attachment)],
        [record for record in found if isinstance(record, records.Metadata) and record.name not in _OWN],
    )


def check_recovered(path: Path, data: bytes) -> None:
    """Every record is in the recovered file as it was."""
    out = path.with_name("out.mcap")
    recover(path, out)
    assert found_in(out.read_bytes()) == found_in(data)
    with open_log(out) as log:
        assert log.complete
        assert all("without a CRC" in str(place) for place in log.verify())
    out.unlink()


def check(path: Path, case: Case, data: bytes) -> None:
    path.write_bytes(data)
    messages = case.of(records.Message)
    times = [message.log_time for message in messages] or [0]
    with open_log(path) as log:
        for _ in range(2):
            assert log.complete, f"{case}: {log.missing}"
            assert log.count("example") == len(messages) if messages else log.topics == ()
            assert (log.start_ns, log.end_ns) == (min(times), max(times)), case
            assert log.attachments == {record.name: record.data for record in case.of(records.Attachment)}, case
            assert log.metadata == {record.name: record.metadata for record in case.of(records.Metadata)}, case
            assert not [place for place in log.verify() if "without a CRC" not in str(place)], case
    if CONTENTS[case.content]:
        check_recovered(path, data)


@pytest.mark.parametrize("content", CONTENTS)
def test_every_file_of_the_conformance_suite_is_read_and_recovered(tmp_path: Path, content: str) -> None:
    of_content = [case for case in all_cases() if case.content == content]
    for case in of_content:
        check(tmp_path / "a.mcap", case, file_of(case))


def test_the_suite_has_416_files_that_the_library_reads() -> None:
    cases = list(all_cases())
    assert len(cases) == len({str(case) for case in cases}) == 416
    for case in cases:
        found = found_in(file_of(case))
        assert [record for part in found for record in part] == CONTENTS[case.content]


def lz4_frame(data: bytes, **options: bool) -> bytes:
    return cast("Any", lz4.frame).compress(data, **options)


def in_two_frames(data: bytes, pack: Callable[[bytes], bytes]) -> bytes:
    half = len(data) // 2
    return pack(data[:half]) + pack(data[half:])


PACKED: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "lz4": ("lz4", lz4_frame),
    "lz4 without size": ("lz4", lambda data: lz4_frame(data, store_size=False)),
    "lz4 in two frames": ("lz4", lambda data: in_two_frames(data, lz4_frame)),
    "zstd": ("zstd", zstandard.compress),
    "zstd without size": ("zstd", zstandard.ZstdCompressor(write_content_size=False).compress),
    "zstd in two frames": ("zstd", lambda data: in_two_frames(data, zstandard.compress)),
    "zstd and a skippable frame": ("zstd", lambda data: zstandard.compress(data) + b"\x50\x2a\x4d\x18\x03\0\0\0abc"),
}


@pytest.mark.parametrize("packed", PACKED)
def test_both_well_known_compressions_are_read_and_copied(tmp_path: Path, packed: str) -> None:
    features = frozenset({"UseChunks", "UseMessageIndex", "UseChunkIndex", "UseStatistics", "UseRepeatedChannelInfos"})
    for case in (Case("TenMessages", features), Case("TenMessages", frozenset({"UseChunks"}))):
        data = file_of(case, *PACKED[packed])
        path = tmp_path / "a.mcap"
        path.write_bytes(data)
        with open_log(path) as log:
            assert log.verify() == []
            assert log.count("example") == 10
        out = tmp_path / "out.mcap"
        recover(path, out)
        plain = found_in(file_of(case))
        chunks = StreamReader(io.BytesIO(out.read_bytes()), emit_chunks=True).records
        content = next(chunk.data for chunk in chunks if isinstance(chunk, records.Chunk) and chunk.message_end_time)
        assert content in data
        if "two" not in packed:  # the library reads one frame
            assert found_in(out.read_bytes()) == plain
        out.unlink()


def test_recovery_keeps_facts_under_the_name_of_a_checksum_and_facts_of_one_name(tmp_path: Path) -> None:
    """Another program may use any key, and may write a name twice."""
    facts = [
        records.Metadata("run", {"crc32": "mine", "a": "b"}),
        records.Metadata("run", {}),
        records.Metadata("times", {"a": ""}),
    ]
    attachments = [records.Attachment(1, 2, "a", "text/plain", b"x"), records.Attachment(3, 2**63, "a", "", b"")]
    data = MAGIC + b"".join(map(encoded, [records.Header("profile", "a program"), *facts, *attachments]))
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    new = recover(path).path.read_bytes()
    found = list(StreamReader(io.BytesIO(new), validate_crcs=True).records)
    assert found[0] == records.Header("profile", "a program")
    assert [record for record in found if isinstance(record, records.Metadata)][:3] == facts
    assert [record for record in found if isinstance(record, records.Attachment)] == attachments
    indexes = make_reader(io.BytesIO(new)).get_summary()
    assert [index.create_time for index in indexes.attachment_indexes] == [1, 3]


def test_any_field_may_follow_those_of_a_footer_or_data_end_that_are_known(tmp_path: Path) -> None:
    data = MAGIC + encoded(records.Header("", "")) + encoded(records.Metadata("a", {}))
    end = encoded(records.DataEnd(0))
    longer = end[:1] + b"\x07" + end[2:] + b"abc"
    for ending in (end, longer):
        start = len(data + ending)
        summary = encoded(replace(_EMPTY, metadata_count=1)) + encoded(records.MetadataIndex(len(MAGIC) + 17, 18, "a"))
        footer = encoded(records.Footer(start, 0, 0))
        path = tmp_path / "a.mcap"
        path.write_bytes(data + ending + summary + footer + MAGIC)
        with open_log(path) as log:
            assert log.complete, log.missing
            assert log.metadata == {"a": {}}


_EMPTY = records.Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)
