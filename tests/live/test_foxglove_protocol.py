"""The Foxglove protocol without a connection: messages byte for byte, and parsing of requests."""

import base64
import json
import struct

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.channels import CHANNELS, LASER_X, MOTOR, Channel
from live.errors import InvalidRequest
from live.foxglove.client import Subscriptions
from live.foxglove.protocol import (
    ChannelMessages,
    Subscribe,
    Unsubscribe,
    advertise,
    in_order,
    message_data,
    offered,
    parsed_request,
    server_info,
    status,
    time_data,
)

IDS = st.integers(0, 2**32 - 1)
TIMES = st.integers(0, 2**63 - 1)
OFFERED = offered(CHANNELS.values())


def test_bytes_are_as_the_specification_lays_them_out() -> None:
    assert message_data(0x01020304, 0x1112131415161718, b"ab").hex() == "010403020118171615141312116162"
    assert time_data(0x1112131415161718).hex() == "021817161514131211"


@given(IDS, TIMES, st.binary(max_size=50))
def test_a_message_is_read_back(own: int, time_ns: int, payload: bytes) -> None:
    data = message_data(own, time_ns, payload)
    assert struct.unpack_from("<BIQ", data) == (1, own, time_ns)
    assert data[13:] == payload


def test_only_reading_is_offered() -> None:
    info = json.loads(server_info("rüttler", "s1", {"access": "read-only"}))
    assert (info["op"], info["name"], info["capabilities"]) == ("serverInfo", "rüttler", ["time"])
    assert (info["sessionId"], info["metadata"]) == ("s1", {"access": "read-only"})
    assert "supportedEncodings" not in info
    assert json.loads(status(1, "x", "y")) == {"op": "status", "level": 1, "message": "x", "id": "y"}


def test_channels_are_advertised_with_the_schemas_of_a_log() -> None:
    given_ = {each["topic"]: each for each in json.loads(advertise(OFFERED))["channels"]}
    assert set(given_) == {*CHANNELS, "events", "health"}
    assert len({each["id"] for each in given_.values()}) == len(given_)
    laser = given_["laser/x"]
    assert (laser["encoding"], laser["schemaEncoding"], laser["schemaName"]) == (
        "protobuf",
        "protobuf",
        "rig.LaserSample",
    )
    assert Channel.from_descriptor_set("laser/x", "rig.LaserSample", base64.b64decode(laser["schema"])) == LASER_X
    events = given_["events"]
    assert (events["encoding"], events["schemaEncoding"]) == ("json", "jsonschema")
    assert json.loads(events["schema"])["title"] == "rig.Note"


@given(st.lists(st.tuples(IDS, IDS), max_size=5), st.lists(IDS, max_size=5))
def test_requests_are_parsed(pairs: list[tuple[int, int]], ids: list[int]) -> None:
    wanted = [{"id": own, "channelId": number} for own, number in pairs]
    assert parsed_request(json.dumps({"op": "subscribe", "subscriptions": wanted})) == Subscribe(tuple(pairs))
    assert parsed_request(json.dumps({"op": "unsubscribe", "subscriptionIds": ids})) == Unsubscribe(tuple(ids))


REFUSED = [
    ('{"op": "advertise", "channels": [{"id": 1, "topic": "motor"}]}', "publishing: refused"),
    (b"\x01\x01\x00\x00\x00payload", "publishing: refused"),
    (b"\x02" + bytes(12), "services: refused"),
    ('{"op": "setParameters", "parameters": []}', "parameters: refused"),
    ('{"op": "getParameters"}', "parameters: refused"),
    ('{"op": "fetchAsset", "uri": "file:///etc/passwd", "requestId": 1}', "assets: refused"),
    ('{"op": "subscribeConnectionGraph"}', "connection graph: refused"),
    ('{"op": "stop"}', "expected"),
    ('{"op": ["subscribe"]}', "expected"),
    ("[]", "expected"),
    ("null", "expected"),
    ("", "expected JSON"),
    ("{", "expected JSON"),
    ("[" * 60_000, "expected JSON"),
    ("1" * 5000, "expected JSON"),
    ('{"op": "subscribe"}', "list under subscriptions"),
    ('{"op": "subscribe", "subscriptions": [1]}', "channelId"),
    ('{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}', "whole number"),
    ('{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": -1}]}', "whole number"),
    ('{"op": "subscribe", "subscriptions": [{"id": 4294967296, "channelId": 1}]}', "whole number"),
    ('{"op": "unsubscribe", "subscriptionIds": [1.5]}', "whole number"),
    (b"", "unknown opcode"),
    (b"\xff", "unknown opcode"),
]


@pytest.mark.parametrize(("message", "why"), REFUSED, ids=range(len(REFUSED)))
def test_all_else_is_refused_with_a_reason(message: str | bytes, why: str) -> None:
    with pytest.raises(InvalidRequest, match=why) as refused:
        parsed_request(message)
    assert len(str(refused.value)) < 250
    assert str(refused.value).isprintable()


@given(st.one_of(st.text(), st.binary(), st.recursive(st.none() | IDS | st.text(), st.lists).map(json.dumps)))
def test_nonsense_is_never_anything_but_refused(message: str | bytes) -> None:
    with pytest.raises(InvalidRequest):
        parsed_request(message)


def test_one_subscription_a_channel_and_one_channel_an_id() -> None:
    ours = Subscriptions(OFFERED)
    assert ours.apply(Subscribe(((7, 1), (8, 2)))) == []
    assert ours.by_channel == {1: 7, 2: 8}
    assert ours.apply(Subscribe(((9, 1), (7, 3), (5, 99), (6, 4)))) == [
        "channel 1 is already subscribed to as 7",
        "subscription id 7 is in use",
        "channel 99 does not exist",
    ]
    assert ours.by_channel == {1: 7, 2: 8, 4: 6}
    assert ours.apply(Unsubscribe((7, 77))) == ["subscription 77 does not exist"]
    assert ours.apply(Subscribe(((7, 3),))) == []
    assert ours.by_channel == {2: 8, 4: 6, 3: 7}


@given(st.lists(st.lists(st.integers(0, 100), max_size=8), max_size=4))
def test_messages_of_several_channels_come_in_order_of_time(times: list[list[int]]) -> None:
    blocks = [
        ChannelMessages(number, np.sort(np.array(each, np.int64)), b"".join(bytes([number, t]) for t in sorted(each)))
        for number, each in enumerate(times)
    ]
    found = list(in_order(blocks, {0: 10, 1: 11, 3: 13}))
    expected = [(t, number) for number, each in enumerate(times) if number != 2 for t in each]
    assert [(time_ns, number) for number, _, time_ns, _ in found] == sorted(expected)
    assert all(message == bytes([number, t]) and own == 10 + number for number, own, t, message in found)


def test_a_block_of_a_log_is_cut_where_its_messages_end() -> None:
    packed = MOTOR.pack({"speed_rpm": np.array([1.0, 2.0]), "target_rpm": 3.0, "statusword": 4})
    block = ChannelMessages(5, np.array([10, 20], np.int64), packed.tobytes())
    cut = [MOTOR.unpack(message)["speed_rpm"][0] for _, _, _, message in in_order([block], {5: 1})]
    assert cut == [1.0, 2.0]
