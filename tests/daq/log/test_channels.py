"""Messages of a log: constant layout, valid protobuf, JSON notes."""

import json
from contextlib import suppress

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from daq import channels as ch

KINDS = {
    "double": "<f8",
    "fixed32": "<u4",
    "fixed64": "<u8",
    "sfixed32": "<i4",
    "sfixed64": "<i8",
}


def columns_of(channel, n, seed=0):
    rng = np.random.default_rng(seed)
    size = {name: np.dtype(KINDS[kind]).itemsize for name, kind in channel.fields}
    return {name: np.frombuffer(rng.bytes(n * size[name]), KINDS[kind]) for name, kind in channel.fields}


def protobuf_class(schema_name, descriptor_set):
    files = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set)
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema_name))


@pytest.mark.parametrize("channel", ch.CHANNELS.values(), ids=lambda channel: channel.topic)
def test_google_protobuf_agrees_in_both_directions(channel):
    message_class = protobuf_class(channel.schema_name, channel.file_descriptor_set())
    columns = columns_of(channel, 20)
    for name, kind in channel.fields:
        if kind == "double":
            columns[name] = np.where(np.isfinite(columns[name]), columns[name], np.nan)
    packed = channel.pack(columns)
    for row, record in enumerate(packed):
        message = message_class.FromString(record.tobytes())
        assert message.SerializeToString() == record.tobytes()
        for name in channel.names:
            assert np.array_equal(
                getattr(message, name), columns[name][row], equal_nan=name.endswith(("_m", "_rad", "_rpm"))
            )


@pytest.mark.parametrize("channel", ch.CHANNELS.values(), ids=lambda channel: channel.topic)
def test_round_trip_and_schema(channel):
    columns = columns_of(channel, 50)
    packed = channel.pack(columns)
    for back in (channel.unpack(packed), channel.unpack(packed.tobytes()), channel.unpack_any(map(bytes, packed))):
        for name in channel.names:
            assert back[name].tobytes() == columns[name].tobytes()
    again = ch.Channel.from_descriptor_set(channel.topic, channel.schema_name, channel.file_descriptor_set())
    assert again == channel


def test_the_channels_are_those_of_the_log():
    assert list(ch.CHANNELS) == ["laser/x", "laser/y", "pendulums", "tacho", "motor"]
    assert ch.LASER_X.dtype.itemsize == 9 + 5 + 5 + 9 + 5


def test_messages_of_other_writers_omit_zeros_and_change_order():
    channel = ch.TACHO
    whole = channel.pack({"revolutions": [7, 7], "node_time_us": [9, 0]})
    first, second = (record.tobytes() for record in whole)
    swapped = first[5:] + first[:5] + b"\x50\x96\x01" + b"\x5a\x02hi"  # unknown fields behind
    back = channel.unpack_any([swapped, second[:5]])
    assert back["revolutions"].tolist() == [7, 7]
    assert back["node_time_us"].tolist() == [9, 0]


@given(st.binary(max_size=60))
def test_hostile_messages_are_values_or_value_errors(data):
    for read in (lambda: ch.TACHO.unpack_any([data]), lambda: ch.TACHO.unpack(data), lambda: ch.unpack_raw(data)):
        with suppress(ValueError):
            read()


def test_pack_wants_every_field_once():
    with pytest.raises(ValueError, match="expected the fields"):
        ch.TACHO.pack({"revolutions": [1]})
    with pytest.raises(ValueError, match="tag"):
        ch.TACHO.unpack(bytes(14))
    assert len(ch.TACHO.pack({"revolutions": np.arange(3), "node_time_us": 5})) == 3


def test_a_foreign_schema_is_refused():
    for schema in (b"\xff\xff", ch.raw_descriptor_set(), b""):
        with pytest.raises(ValueError, match="expected"):
            ch.Channel.from_descriptor_set("x", ch.RAW_SCHEMA_NAME, schema)


@given(st.sampled_from([ch.RX, ch.TX]), arrays(np.uint8, st.integers(0, 70000)).map(lambda data: data.tobytes()))
def test_raw_round_trip(direction, data):
    assert ch.unpack_raw(ch.pack_raw(direction, data)) == (direction, data)


@pytest.mark.parametrize("size", [0, 1, 127, 128, 16383, 16384])
def test_raw_is_protobuf(size):
    message_class = protobuf_class(ch.RAW_SCHEMA_NAME, ch.raw_descriptor_set())
    message = message_class.FromString(ch.pack_raw(ch.TX, bytes(size)))
    assert (message.direction, message.data) == (ch.TX, bytes(size))
    assert ch.unpack_raw(message.SerializeToString()) == (ch.TX, bytes(size))
    assert ch.unpack_raw(message_class().SerializeToString()) == (ch.RX, b"")


def test_notes():
    note = {
        "kind": "sync",
        "device": "laser x",
        "text": "θ",
        "drift_ppm": np.float64(3.5),
        "n": np.int32(2),
        "bad": np.nan,
    }
    assert json.loads(ch.pack_note(note)) == note | {"bad": None}
    assert json.loads(ch.note_schema())["required"] == ["kind"]
    with pytest.raises(ValueError, match="kind"):
        ch.pack_note({"text": "no kind"})
    with pytest.raises(TypeError, match="JSON"):
        ch.pack_note({"kind": "x", "value": object()})
