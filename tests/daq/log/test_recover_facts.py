"""Recovery of hand-made files: the facts that the new log states about the old one, and the definitions it needs."""

from __future__ import annotations

import logging
import struct
from pathlib import Path

import pytest

from daq.errors import LogError
from daq.log import open_log
from daq.log.recover import recover
from daq.mcap.file_bytes import FileBytes
from daq.mcap.reader import walk
from daq.mcap.records import AttachmentPlace, DamageError
from daq.mcap.writer import LIBRARY, MAGIC
from tests.daq.mcap.made_bytes import (
    FRONT,
    INNER,
    LOOSE,
    attachment,
    chunk,
    finished,
    header,
    indexes,
    message,
    metadata,
    record,
    text,
)

BAD = chunk(INNER, 10, 30, crc=5) + indexes(c1=[(10, 0), (30, 70)], c2=[(20, 35)])
GOOD = chunk(message(2, 2_000_000_000) + message(3, 4_500_000_000), 2_000_000_000, 4_500_000_000)


def made(folder: Path, *parts: bytes) -> Path:
    path = folder / "old.mcap"
    path.write_bytes(finished(*parts))
    return path


def test_the_new_log_states_what_was_kept_and_what_is_missing(tmp_path: Path) -> None:
    old = made(tmp_path, BAD, GOOD)
    found = recover(old)
    assert (found.path, found.messages, found.chunks) == (tmp_path / "old.recovered.mcap", 2, 1)
    assert found.seconds == pytest.approx(2.5)
    assert [place.messages for place in found.missing] == [3, 1]  # the chunk, and the name of channel 3
    with open_log(found.path) as new:
        facts = new.metadata["recovered"]
        assert [(topic, new.count(topic)) for topic in new.topics] == [("a", 0), ("b", 1), ("unknown/3", 1)]
        assert new.verify() == []
        assert "summary" not in new.metadata
    expected = {
        "origin": "old.mcap",
        "origin_bytes": str(old.stat().st_size),
        "kept_chunk_bytes": str(len(GOOD)),
        "kept_messages": "2",
        "kept_chunks": "1",
        "missing_messages": "4",
        "missing_places": "2",
        "origin_library": "another program",
    }
    assert {key: facts[key] for key in expected} == expected


def test_a_channel_without_definition_has_no_schema(tmp_path: Path) -> None:
    schema = record(3, struct.pack("<H", 1) + text("one") + text("") + struct.pack("<I", 0))
    new = walk(FileBytes(recover(made(tmp_path, schema, GOOD)).path)).definitions
    assert list(new.schemas) == [1]
    assert (new.channels[3].topic, new.channels[3].schema_id) == ("unknown/3", 0)


def test_every_number_of_a_channel_is_recovered(tmp_path: Path) -> None:
    found = recover(made(tmp_path, chunk(message(0, 5) + message(65535, 6) + message(65535, 7), 5, 7)))
    assert found.messages == 3
    assert walk(FileBytes(found.path)).counts == {0: 1, 65535: 2}


def test_an_unknown_number_of_missing_messages_is_unknown(tmp_path: Path) -> None:
    old = made(tmp_path, chunk(INNER, 10, 30, crc=5), GOOD)
    found = recover(old, tmp_path / "deep" / "new.mcap")
    with open_log(found.path) as new:
        assert new.metadata["recovered"]["missing_messages"] == "unknown"
        assert new.metadata["recovered"]["missing_places"] == str(len(found.missing)) == "2"


def test_damage_without_a_missing_message_counts_as_none(tmp_path: Path) -> None:
    """The chunk is intact; the indexes after it do not list all of its messages."""
    found = recover(made(tmp_path, chunk(INNER, 10, 30), indexes(c1=[(10, 0), (30, 70)])))
    assert [place.messages for place in found.missing] == [0]
    with open_log(found.path) as new:
        assert new.metadata["recovered"]["missing_messages"] == "0"


def test_facts_of_the_old_log_keep_their_texts(tmp_path: Path) -> None:
    facts = (
        metadata("run", {"crc32": "mine", "a": "b"})
        + metadata("recovered", {"c": "d"})
        + metadata("summary", {"e": "f"})
    )
    found = recover(made(tmp_path, facts, GOOD))
    contents = walk(FileBytes(found.path))
    assert contents.metadata["run"] == {"crc32": "mine", "a": "b"}
    assert contents.metadata["recovered earlier"] == {"c": "d"}
    assert contents.metadata["summary"] == {"e": "f"}
    assert contents.metadata["recovered"]["origin"] == "old.mcap"
    assert contents.missing == []


def test_facts_keep_their_checksum_if_the_header_is_lost(tmp_path: Path) -> None:
    part = tmp_path / "a.mcap"
    part.write_bytes(MAGIC + metadata("run", {"a": "b"}, ours=True) + metadata("note", {"c": "d"}))
    with open_log(recover(part).path) as new:
        assert new.metadata["run"] == {"a": "b"}
        assert ["1 metadata record without a CRC" in str(place) for place in new.verify()] == [True]


def test_an_attachment_that_is_not_read_as_before_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def other(file: FileBytes, place: AttachmentPlace, ours: bool) -> None:
        raise DamageError("attachment 'a.json' whose CRC is wrong")

    whole = attachment()
    part = made(tmp_path, whole, GOOD)
    monkeypatch.setattr("daq.log.recover.read_attachment", other)
    found = recover(part)
    place = found.missing[-1]
    assert (place.text, place.messages) == ("attachment 'a.json' whose CRC is wrong", 0)
    assert (place.byte_start, place.byte_end) == (len(FRONT), len(FRONT + whole))
    assert walk(FileBytes(found.path)).attachments == []


def test_unreadable_notes_of_losses_do_not_prevent_a_recovery(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Unreadable:
        def __init__(self, *given: object) -> None:
            raise LogError("expected JSON in daq/health")

    part = tmp_path / "ours.mcap"
    part.write_bytes(MAGIC + header(LIBRARY) + GOOD)
    monkeypatch.setattr("daq.log.recover.Log", Unreadable)
    with caplog.at_level(logging.WARNING, "daq"):
        found = recover(part)
    assert (found.messages, found.seconds) == (2, 2.5)
    assert "its counts of losses are not in the recovered log: expected JSON in daq/health" in caplog.text


def test_messages_outside_of_chunks_are_recovered_as_a_chunk(tmp_path: Path) -> None:
    found = recover(made(tmp_path, LOOSE))
    assert (found.messages, found.chunks, found.missing) == (3, 1, ())
    contents = walk(FileBytes(found.path))
    assert (contents.counts, contents.table.span()) == ({1: 2, 2: 1}, (10, 30))


def test_a_file_with_facts_alone_is_recovered_and_one_without_anything_is_not(tmp_path: Path) -> None:
    found = recover(made(tmp_path, metadata("run", {"a": "b"})))
    assert (found.messages, found.chunks, found.seconds) == (0, 0, 0.0)
    found.path.unlink()
    with pytest.raises(LogError, match="expected a message, a fact or an attachment, found none"):
        recover(made(tmp_path))


def test_the_names_of_new_files(tmp_path: Path) -> None:
    data = FRONT + GOOD
    for name, new in (("a.mcap.part", "a.mcap"), ("b.mcap", "b.recovered.mcap"), ("c.part", "c.recovered.mcap")):
        (tmp_path / name).write_bytes(data)
        assert recover(tmp_path / name).path == tmp_path / new
    assert not list(tmp_path.glob("*.recovering"))
