"""Whether the TypeScript implementation (@mcap/core, of Foxglove and Lichtblick) reads our logs with equal contents.

    python -m benchmarks.mcap_core.agreement [LOG]

Without LOG a log with every kind of channel is recorded first. Node reads it with all CRCs checked, as a stream and
through its indexes, and writes it again; then the original and the copy, each read by the Python library and by us,
must agree message for message. Needs node and npm; the packages go into a temporary directory.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from benchmarks.laser_samples import laser_samples
from daq import channels
from daq.log import open_log
from daq.mcap.writer import BlockWriter

_HERE = Path(__file__).parent


def record(path: Path, compression: Any) -> Path:
    """A log with samples, raw bytes, events, an attachment, metadata and several chunks with channels interleaved."""
    samples = laser_samples(20_000)
    with path.open("wb") as stream:
        writer = BlockWriter(stream, compression, chunk_bytes=64 * 1024)
        writer.start("rig")
        raw = writer.register_schema(channels.RAW_SCHEMA_NAME, "protobuf", channels.raw_descriptor_set())
        note = writer.register_schema(channels.NOTE_SCHEMA_NAME, "jsonschema", channels.note_schema())
        laser = channels.LASER_X
        schema = writer.register_schema(laser.schema_name, "protobuf", laser.file_descriptor_set())
        raw_id = writer.register_channel(channels.raw_topic("laser_x"), "protobuf", raw)
        laser_id = writer.register_channel(laser.topic, "protobuf", schema, {"unit": "m"})
        events_id = writer.register_channel(channels.EVENTS_TOPIC, "json", note)
        writer.add_metadata("run", {"operator": "Ωmega", "": "empty key"})
        writer.add_attachment("rig.json", "application/json", b'{"k1": 1}', int(samples.log_time_ns[0]))
        for number, block in enumerate(samples.blocks(40)):
            host_ns = int(block.log_time_ns[-1])
            writer.add_message(raw_id, host_ns, host_ns, 0, channels.pack_raw(channels.RX, bytes(number % 200)))
            writer.add_block(laser_id, block.log_time_ns, block.time_ns, block.sequence, block.messages())
            if number % 50 == 0:
                text = channels.pack_note({"kind": "gap", "text": "–"})
                writer.add_message(events_id, host_ns, host_ns - 7, 0, text)
        writer.finish()
    return path


def reencode(log: Path, work: Path) -> tuple[Path, dict[str, Any]]:
    """The log as @mcap/core writes it, and what it found in ours."""
    npm, node = shutil.which("npm"), shutil.which("node")
    if npm is None or node is None:
        raise SystemExit("expected node and npm on the path: install Node.js 20 or later")
    for name in ("package.json", "reencode.mjs"):
        shutil.copy(_HERE / name, work)
    if not (work / "node_modules").exists():
        subprocess.run([npm, "install", "--silent", "--no-audit", "--no-fund"], cwd=work, check=True, timeout=300)
    copy = work / "theirs.mcap"
    run = subprocess.run(
        [node, "reencode.mjs", log.resolve(), copy], cwd=work, check=True, timeout=600, capture_output=True
    )
    return copy, json.loads(run.stdout)


def messages(path: Path) -> Iterator[tuple[Any, ...]]:
    """Everything a message is, schema and channel included but for the ids, in file order."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            definition = (schema.name, schema.encoding, schema.data) if schema else None
            kind = (definition, channel.topic, channel.message_encoding, sorted(channel.metadata.items()))
            yield kind, message.log_time, message.publish_time, message.sequence, message.data


def metadata_and_attachments(path: Path) -> tuple[list[Any], list[Any]]:
    """Metadata and attachments."""
    with path.open("rb") as stream:
        tables = [r for r in StreamReader(stream, validate_crcs=True).records if isinstance(r, Metadata)]
    with path.open("rb") as stream:
        files = list(make_reader(stream, validate_crcs=True).iter_attachments())
    attachments = [(a.name, a.media_type, a.log_time, a.create_time, a.data) for a in files]
    return [(t.name, t.metadata) for t in tables], attachments


def compare(ours: Path, theirs: Path, found: dict[str, Any]) -> dict[str, Any]:
    """Each comparison by name, true when all is equal."""
    count = sum(1 for _ in messages(ours))
    with open_log(ours) as a, open_log(theirs) as b:
        same_samples = list(a) == list(b) and all(
            (a[topic].time_ns == b[topic].time_ns).all()
            and (a[topic].log_time_ns == b[topic].log_time_ns).all()
            and (a[topic].sequence == b[topic].sequence).all()
            and all(a[topic][name].tobytes() == b[topic][name].tobytes() for name in a[topic].columns)
            for topic in a
        )
        same_raw = list(a.raw_in_order()) == list(b.raw_in_order()) and a.events == b.events
    return {
        "messages": count,
        "all found as a stream": found["streamed"]["Message"] == count,
        "all found by the indexes": found["indexed_messages"] == found["announced_messages"] == count,
        "messages equal": all(x == y for x, y in zip(messages(ours), messages(theirs), strict=True)),
        "metadata equal": metadata_and_attachments(ours)[0] == metadata_and_attachments(theirs)[0],
        "attachments equal": metadata_and_attachments(ours)[1] == metadata_and_attachments(theirs)[1],
        "our reader: samples equal": same_samples,
        "our reader: raw bytes and events equal": same_raw,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("log", nargs="?", type=Path)
    given = parser.parse_args().log
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        logs = [given] if given else [record(work / f"{name}.mcap", name) for name in ("zstd", "none")]
        for log in logs:
            theirs, found = reencode(log, work)
            result = compare(log, theirs, found)
            print(f"{log.name}: @mcap/core found {json.dumps(found)}")
            for what, value in result.items():
                print(f"  {what}: {value}")
            failed |= not all(result.values())
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
