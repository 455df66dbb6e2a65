"""open_log: finished, unfinished, cut and damaged files; only complete and correct samples are returned."""

import struct

import mcap.writer
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings, strategies as st

from daq import channels as ch
from daq.errors import ChannelMissing, LogError
from daq.log import open_log
from daq.mcap.chunks import CHUNK_LIMIT_BYTES
from daq.mcap.writer import MAGIC
from tests.daq.mcap.written import T0, add_channel, foreign, written
from tests.effort import cases

BLOCKS, PER_BLOCK = 12, 25


def laser(start, n):
    """Samples that identify themselves, so that a wrong one is detected."""
    k = np.arange(start, start + n)
    ticks = 25 * k.astype(np.uint64)
    return {"displacement_m": k * 1e-6, "code": k, "counter": k % 2**18, "device_ticks": ticks, "flags": 0 * k}


def fill(writer):
    """A small log: laser in blocks, index marks, raw bytes both ways, events; flushed after every block."""
    laser_x = add_channel(writer, ch.LASER_X)
    add_channel(writer)
    raw = writer.register_channel(
        "raw/laser_x", "protobuf", writer.register_schema(ch.RAW_SCHEMA_NAME, "protobuf", ch.raw_descriptor_set())
    )
    notes = writer.register_schema(ch.NOTE_SCHEMA_NAME, "jsonschema", ch.note_schema())
    events = writer.register_channel("events", "json", notes)
    writer.add_metadata("rig", {"name": "bench"})
    writer.add_attachment("rig.toml", "text/plain", b"[rig]\n", T0)
    for block in range(BLOCKS):
        now, k = T0 + block * 10**7, np.arange(block * PER_BLOCK, (block + 1) * PER_BLOCK)
        writer.add_message(raw, now, now, block, ch.pack_raw(block % 2, bytes([block]) * 40))
        writer.add_block(laser_x, now, T0 + k * 250_000, k, ch.LASER_X.pack(laser(k[0], PER_BLOCK)))
        writer.add_message(events, now, now, block, ch.pack_note({"kind": "beat", "number": block}))
        writer.flush()


@pytest.fixture(scope="module")
def whole():
    return written(fill)


@pytest.fixture(scope="module")
def plain():
    return written(fill, compression="none")


def write(tmp_path, data, name="run.mcap"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def check_samples(log):
    """Check that the returned data are complete and correct; return the number of laser samples."""
    if "laser/x" not in log:
        return 0
    x = log["laser/x"]
    k = x.code.astype(np.int64)
    for name, column in laser(0, BLOCKS * PER_BLOCK).items():
        assert np.array_equal(x[name], column[k])
    assert np.array_equal(x.time_ns, T0 + k * 250_000)
    assert np.array_equal(x.sequence, k)
    assert len(np.unique(k)) == len(k)
    assert len(k) % PER_BLOCK == 0
    for chunk in log.raw("laser_x") if "laser_x" in log.devices else []:
        assert chunk.data == bytes([chunk.data[0]]) * 40
        assert chunk.direction == chunk.data[0] % 2
        assert chunk.host_ns == T0 + chunk.data[0] * 10**7
    for event in log.events:
        assert event == {"kind": "beat", "number": event["number"], "time_ns": T0 + event["number"] * 10**7}
    return len(k)


def test_a_finished_log(tmp_path, whole):
    with open_log(write(tmp_path, whole)) as log:
        assert (log.complete, log.missing) == (True, [])
        assert log.topics == ("events", "laser/x", "raw/laser_x", "tacho")
        assert list(log) == ["laser/x", "tacho"]
        assert len(log) == 2
        assert check_samples(log) == BLOCKS * PER_BLOCK == log.count("laser/x")
        assert len(log["tacho"]) == len(log["tacho"].revolutions) == 0
        assert [chunk.direction for _, chunk in log.raw_in_order()] == [0, 1] * (BLOCKS // 2)
        assert [chunk for _, chunk in log.raw_in_order()] == log.raw("laser_x")
        assert (len(log.events), log.health) == (BLOCKS, [])
        assert (log.metadata, log.attachments) == ({"rig": {"name": "bench"}}, {"rig.toml": b"[rig]\n"})
        x = log["laser/x"]
        assert x.time_s[1] - x.time_s[0] == pytest.approx(250e-6, abs=5e-7)
        assert (x.log_time_ns[::PER_BLOCK] == T0 + np.arange(BLOCKS) * 10**7).all()
    assert len(x.displacement_m) == BLOCKS * PER_BLOCK  # samples remain valid after the log is closed
    with pytest.raises(LogError, match="closed"):
        log.raw("laser_x")


KINDS = mcap.writer.CompressionType


@pytest.mark.parametrize(
    "options",
    [
        {"library": "pendulum-balancer-rig", "compression": KINDS.ZSTD, "enable_data_crcs": True},  # the layout before
        {"compression": KINDS.ZSTD},
        {"compression": KINDS.NONE},
        {"use_chunking": False},
    ],
)
def test_a_log_of_the_librarys_own_writer(tmp_path, options):
    def add(writer):
        cid = add_channel(writer, ch.LASER_X)
        writer.add_metadata("run", {"test": "point-A"})
        for k, message in enumerate(ch.LASER_X.pack(laser(0, 50))):
            shortened = message.tobytes() if k else b""  # the first as proto3 would: all zeros
            writer.add_message(cid, T0 + k, shortened, T0 + k * 250_000, k)

    with open_log(write(tmp_path, foreign(add, **options))) as log:
        assert log.missing == []
        assert log.metadata == {"run": {"test": "point-A"}}
        assert check_samples(log) == 50
        log.verify()
        assert log.complete


def test_an_unfinished_log_is_read_and_reported(tmp_path):
    log = open_log(write(tmp_path, written(fill, finish=False), "run.mcap.part"))
    assert check_samples(log) == BLOCKS * PER_BLOCK
    assert not log.complete
    assert "not finished" in " ".join(map(str, log.missing))


@pytest.mark.parametrize("kind", ["whole", "plain"])
def test_cut_anywhere(tmp_path, kind, request):
    data = request.getfixturevalue(kind)
    counts = []
    for size in np.unique(np.linspace(len(MAGIC), len(data) - 1, 60).astype(int)):
        with open_log(write(tmp_path, data[:size])) as log:
            assert not log.complete
            counts.append(check_samples(log))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, BLOCKS * PER_BLOCK)
    assert len(set(counts)) == BLOCKS + 1


@settings(max_examples=cases(40, 150))
@given(st.sampled_from(["whole", "plain"]), st.floats(0, 1, exclude_max=True))
def test_a_flipped_bit_is_noticed_and_costs_one_chunk_at_most(tmp_path_factory, whole, plain, kind, place):
    damaged = bytearray({"whole": whole, "plain": plain}[kind])
    first, last = 8 * len(MAGIC), 8 * len(damaged)
    bit = first + int(place * (last - first))
    damaged[bit // 8] ^= 1 << bit % 8
    with open_log(write(tmp_path_factory.mktemp("flip"), bytes(damaged))) as log:
        assert log.verify()
        assert not log.complete
        # the definitions are in the first chunk and in the summary, so even its loss costs its own samples only
        assert check_samples(log) >= (BLOCKS - 1) * PER_BLOCK


def chunk(unpacked, packed, compression=b"zstd", crc=0):
    body = struct.pack("<QQQII", 0, 0, unpacked, crc, len(compression)) + compression
    body += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize(
    "hostile",
    [
        chunk(2**60, zstandard.compress(b"")),
        chunk(10, zstandard.compress(bytes(10**7))),
        chunk(CHUNK_LIMIT_BYTES + 1, zstandard.compress(bytes(10))),
        chunk(2**20, b"\x28\xb5\x2f\xfd\xe0" + b"\xff" * 7 + b"\x0f" + bytes(8)),
        chunk(5, b"12345", b"lz4"),
        chunk(9, b"\x05" + b"\xff" * 8, b""),
        chunk(12, b"\x05" + struct.pack("<Q", 3) + b"abc", b""),
        struct.pack("<BQ", 6, 2**63) + bytes(100),
        struct.pack("<BQ", 4, 12) + bytes([1, 0, 1, 0]) + struct.pack("<Q", 2**63),
        struct.pack("<BQ", 0x0C, 8) + b"\xff" * 8,
        struct.pack("<BQ", 0, 0) * 10,
    ],
)
def test_hostile_lengths_cost_no_memory(tmp_path, hostile, whole):
    with open_log(write(tmp_path, MAGIC + hostile + whole[8:])) as log:
        assert log.missing
        assert check_samples(log) == BLOCKS * PER_BLOCK


def test_a_bad_attachment_is_left_out(tmp_path, whole):
    log = open_log(write(tmp_path, whole.replace(b"[rig]\n", b"[Rig]\n", 1)))
    assert log.attachments == {}
    assert any("rig.toml" in str(place) for place in log.missing)


@pytest.mark.parametrize("data", [b"", b"\x89MCA", b"time;x\n1;2\n", b"\x00" * 100])
def test_no_log_at_all(tmp_path, data):
    with pytest.raises(LogError, match="expected an MCAP log"):
        open_log(write(tmp_path, data))


def test_no_file(tmp_path):
    with pytest.raises(LogError, match="No such file"):
        open_log(tmp_path / "nowhere.mcap")
    with pytest.raises(LogError, match="directory"):
        open_log(tmp_path)


def test_missing_names_help(tmp_path, whole):
    with open_log(write(tmp_path, whole)) as log:
        with pytest.raises(ChannelMissing, match=r"did you mean 'laser/x'"):
            log["laser_x"]
        with pytest.raises(ChannelMissing, match="expected one of"):
            log.raw("tachometer")
        with pytest.raises(ChannelMissing, match="displacement_m"):
            log["laser/x"]["displacement_mm"]
        with pytest.raises(AttributeError, match="displacement_m"):
            log["laser/x"].displacement_mm  # noqa: B018 (the access itself is tested)
        assert log.get("laser/z") is None
        assert "raw/laser_x" not in log


def test_content_that_is_not_its_schemas(tmp_path):
    def add(writer):
        writer.add_message(add_channel(writer), T0, T0, 0, b"\x0d\x01")
        for topic, content in (("events", b"{no json"), ("health", b"[1]"), ("bare", b"")):
            writer.add_message(writer.register_channel(topic, "json", 0), T0, T0, 0, content)

    log = open_log(write(tmp_path, written(add)))
    assert log.complete
    for read in (lambda: log["tacho"], lambda: log.events, lambda: log.health, lambda: log["bare"]):
        with pytest.raises(LogError, match="expected"):
            read()


@pytest.mark.parametrize("name", [b"\xff______", b"counter", b""], ids=["no UTF-8", "twice", "empty"])
def test_a_schema_with_impossible_names(tmp_path, name):
    descriptor = ch.descriptor_pb2.FileDescriptorSet.FromString(ch.LASER_X.file_descriptor_set())
    descriptor.file[0].message_type[0].field[0].name = "#" * len(name)
    damaged = descriptor.SerializeToString().replace(b"#" * 7, name)

    def add(writer):
        schema = writer.register_schema("rig.LaserSample", "protobuf", damaged)
        channel = writer.register_channel("laser/x", "protobuf", schema)
        writer.add_block(channel, T0, T0, 0, ch.LASER_X.pack(laser(0, 2)))

    with open_log(write(tmp_path, written(add))) as log, pytest.raises(LogError, match="expected 1 … 15"):
        log["laser/x"]
