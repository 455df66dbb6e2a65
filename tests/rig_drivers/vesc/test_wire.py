"""Packets of a VESC, byte by byte."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, strategies as st

from daq.drivers.ramp import SetpointRamp
from rig_drivers.vesc import packets, wire
from rig_drivers.vesc.settings import Vesc

# an answer of a real controller at rest, firmware with a status byte; published with the MIT-licensed crate vesc 0.3
REAL = bytes(
    [
        2,
        74,
        4,
        1,
        20,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        1,
        119,
        0,
        0,
        0,
        9,
        0,
        0,
        0,
        0,
        0,
        0,
        1,
        116,
        0,
        0,
        0,
        0,
        255,
        255,
        131,
        64,
        0,
        2,
        168,
        254,
        0,
        18,
        6,
        65,
        224,
        20,
        1,
        21,
        252,
        216,
        252,
        202,
        0,
        0,
        0,
        8,
        0,
        0,
        0,
        12,
        0,
        218,
        113,
        3,
    ]
)

I32 = st.integers(-(2**31), 2**31 - 1)
GROWING = st.integers(0, 2**31 - 1)
VALUES = st.builds(
    wire.Values,
    erpm=I32,
    motor_A=st.integers(-10_000, 10_000).map(lambda n: n / 100),
    input_V=st.integers(0, 1000).map(lambda n: n / 10),
    duty=st.integers(-1000, 1000).map(lambda n: n / 1000),
    charges=st.tuples(GROWING, GROWING, GROWING, GROWING),
    turned=st.integers(0, 2**32 - 1),
    fault=st.integers(0, 255),
    status=st.none() | st.integers(0, 255),
)


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (wire.get_values(), "02 01 04 40 84 03"),
        (wire.set_rpm(3000), "02 05 08 00 00 0B B8 F8 04 03"),
        (wire.firmware_version(), "02 01 00 00 00 03"),
    ],
)
def test_golden_commands(made: bytes, expected: str) -> None:
    assert made == bytes.fromhex(expected)


def test_the_checksum_is_xmodem() -> None:
    assert packets.packet(b"123456789")[-3:] == bytes.fromhex("31C3 03")


def test_an_answer_of_a_real_controller() -> None:
    found = packets.PacketDecoder().feed(REAL)
    assert found.skipped == 0
    values = wire.parse_values(found.payloads[0])
    assert values == wire.Values(
        erpm=0, input_V=37.5, charges=(9, 0, 372, 0), turned=174334, fault=0, status=0, motor_A=0.0, duty=0.0
    )
    assert wire.parse_values(found.payloads[0][:-1]) == wire.Values(
        input_V=37.5, charges=(9, 0, 372, 0), turned=174334, status=None
    )  # older firmware


def test_a_controller_at_rest_round_trips() -> None:
    at_rest = wire.parse_values(wire.pack_values(wire.Values()))
    assert at_rest == wire.Values() == wire.Values(0, 0.0, 0.0, 0.0, (0, 0, 0, 0), 0, 0, None)


@given(VALUES)
def test_answers_round_trip(values: wire.Values) -> None:
    # the current drawn from the supply does not come back: nothing here uses it
    assert wire.parse_values(wire.pack_values(values)) == values


@given(I32, st.floats(0, 200))
def test_commands_round_trip(erpm: int, amperes: float) -> None:
    sent = wire.set_rpm(erpm) + wire.set_brake(amperes) + wire.release() + wire.alive() + wire.get_values()
    payloads = packets.PacketDecoder().feed(sent).payloads
    assert [wire.parse_command(payload) for payload in payloads] == [
        wire.MotorCommand(wire.SET_RPM, erpm),
        wire.MotorCommand(wire.SET_BRAKE, round(amperes * 1000)),
        wire.MotorCommand(wire.SET_CURRENT, 0),
        None,
        None,
    ]


@pytest.mark.parametrize(
    "made",
    [
        lambda: wire.set_rpm(2**31),
        lambda: wire.set_brake(-1.0),
        lambda: wire.set_brake(float("nan")),
        lambda: packets.packet(b""),
        lambda: packets.packet(bytes(513)),
    ],
)
def test_what_no_packet_can_carry_is_refused(made) -> None:
    with pytest.raises(ValueError, match="expected"):
        made()


@pytest.mark.parametrize("length", [1, 255, 256, 512])
def test_short_and_long_packets(length: int) -> None:
    packet = packets.packet(bytes(length))
    assert packet[0] == (packets.SHORT if length < 256 else packets.LONG)
    assert packets.PacketDecoder().feed(packet).payloads == [bytes(length)]


def test_firmware_round_trip() -> None:
    firmware = wire.Firmware(6, 5, "60_MK5", "2a0041000a51353338363731")
    assert wire.parse_firmware(wire.pack_firmware(firmware)) == firmware
    assert wire.parse_firmware(bytes([0, 2, 18])) is None
    assert wire.parse_firmware(b"\0\x06\x05\xff\n\0").hardware == "??"
    assert wire.parse_values(bytes([wire.GET_VALUES, 1])) is None


@given(st.lists(st.binary(min_size=0, max_size=30).map(lambda b: b.translate(None, b"\x02\x03")), max_size=6))
def test_garbage_between_packets_costs_no_packet_and_is_counted(garbage: list[bytes]) -> None:
    found = packets.PacketDecoder().feed(b"".join(g + REAL for g in garbage))
    assert found.payloads == [REAL[2:-3]] * len(garbage)
    assert found.skipped == sum(map(len, garbage))


@pytest.mark.parametrize("start", [b"\x03\x02\x00", b"\x02\xff", REAL[:40], REAL[30:-1], b"\x02", b"\x03"])
def test_a_false_start_delays_no_packet(start: bytes) -> None:
    decoder = packets.PacketDecoder()
    found = decoder.feed(start + REAL)
    assert (found.payloads, found.skipped) == ([REAL[2:-3]], len(start))


def test_line_noise_alone_is_counted_while_it_comes() -> None:
    decoder = packets.PacketDecoder()
    assert decoder.feed(bytes(10_000)).skipped == 10_000
    assert sum(decoder.feed(random.Random(1).randbytes(100)).skipped for _ in range(50)) > 4000


@pytest.mark.parametrize("at", [-1, -2, -3, 1, 10])
def test_a_packet_with_one_wrong_byte_is_dropped(at: int) -> None:
    data = bytearray(REAL)
    data[at] ^= 1
    assert packets.PacketDecoder().feed(bytes(data)).payloads == []


def test_a_byte_of_a_sound_packet_begins_no_other() -> None:
    assert packets.PacketDecoder().feed(REAL + b"\x00\x05").skipped == 2


def test_bytes_that_began_before_are_forgiven_once() -> None:
    decoder = packets.PacketDecoder(84)
    assert decoder.feed(REAL[30:] + REAL + b"\xff" * 3).skipped == 3
    assert decoder.feed(REAL[30:] + REAL).skipped == 49
    assert packets.PacketDecoder(84).feed(b"\xff" * 100).skipped == 16


@pytest.mark.parametrize(
    ("before", "after", "started"),
    [
        (wire.Values(turned=10), wire.Values(turned=10), False),
        (wire.Values(turned=10), wire.Values(turned=11), False),
        (wire.Values(turned=10), wire.Values(turned=0), True),
        (wire.Values(turned=2**32 - 3), wire.Values(turned=2), False),  # wraps
        (wire.Values(turned=2**31 - 1), wire.Values(turned=2**31 + 1), False),
        (wire.Values(charges=(5, 0, 9, 0)), wire.Values(charges=(5, 0, 10, 0)), False),
        (wire.Values(turned=3, charges=(5, 0, 9, 0)), wire.Values(turned=8, charges=(0, 0, 0, 0)), True),
    ],
)
def test_a_restart_shows_in_what_only_grows(before: wire.Values, after: wire.Values, started: bool) -> None:
    assert wire.restarted(before, after) is started


@given(st.integers(0, 255))
def test_every_fault_has_words(code: int) -> None:
    assert wire.fault_words(code).startswith(f"{code}, ")
    assert len(wire.fault_words(code)) > len(f"{code}, ")


# --- settings and ramp -----------------------------------------------------------------------------------------

TABLE = {"driver": "vesc", "port": "/dev/x", "pole_pairs": 7, "timeout_s": 1.0, "brake_A": 10.0}


def test_settings_know_the_least_speed() -> None:
    assert Vesc(**TABLE, min_erpm=700.0).min_rpm == 100


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"timeout_s": 0.19}, "timeout_s must be at least 4"),
        ({"report_Hz": 120.0}, "bit/s"),
        ({"pole_pairs": 0}, "pole_pairs"),
        ({"brake_A": 0.0}, "brake_A"),
        ({"pole_pair": 7}, "pole_pair"),
    ],
)
def test_settings_that_cannot_be_are_refused(change: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Vesc(**TABLE | change)


@pytest.mark.parametrize("name", ["pole_pairs", "timeout_s", "brake_A"])
def test_values_that_only_the_operator_has_have_no_default(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Vesc(**{key: value for key, value in TABLE.items() if key != name})


@given(
    st.lists(st.tuples(st.floats(-1000, 1000), st.floats(0.001, 2.0)), min_size=1, max_size=30),
    st.floats(1, 500),
    st.floats(0, 200),
)
def test_the_ramp_is_never_steeper_and_never_where_nothing_holds(
    orders: list[tuple[float, float]], rate: float, least: float
) -> None:
    ramp, now, before = SetpointRamp(rate, least, 0.25), 0.0, 0.0
    ramp.begin(0.0, now)
    for target, passed in orders:
        ramp.target_rpm, now = target, now + passed
        rpm = ramp.at(now)
        assert rpm == 0 or abs(rpm) >= least
        step = rate * min(passed, 0.25) + 1e-9
        crossed = abs(before) <= least + step and abs(rpm) <= least + step  # through what nothing holds it leaps
        assert abs(rpm - before) <= step or (crossed and abs(rpm) <= least + 1e-9)
        before = rpm


def test_the_ramp_arrives() -> None:
    ramp = SetpointRamp(100.0, 50.0, 0.25)
    ramp.begin(0.0, 0.0)
    ramp.target_rpm = 200.0
    assert [ramp.at(t / 4) for t in range(8)] == [50, 75, 100, 125, 150, 175, 200, 200]
    ramp.target_rpm = 0.0
    assert [ramp.at(2 + t / 4) for t in range(8)] == [175, 150, 125, 100, 75, 50, 0, 0]
    ramp.begin(120.0, 5.0)
    assert (ramp.rpm, ramp.target_rpm, ramp.at(5.25)) == (120, 0, 95)
    ramp.begin(49.0, 6.0)
    assert ramp.rpm == 0
