"""Identification of a base station on an unknown port: what it answers, and which node it receives."""

from __future__ import annotations

from typing import cast

import pytest

from daq.drivers.identification import FoundDevice
from rig_drivers.microstrain import wire
from rig_drivers.microstrain.dialogue import identity_turns
from rig_drivers.microstrain.rates import BASE_ADDRESS
from rig_drivers.microstrain.wire import Version
from tests.rig_drivers.test_microstrain import packet, settings, sweeps

ONE_SWEEP = "00000000 0003 68 07 0000 17979cfe362a0000 0001 0002"  # at 512 Hz
WORDS = {wire.MODEL: 6307, wire.MODEL_OPTION: 1040, wire.SERIAL_HIGH: 1, wire.SERIAL_LOW: 4464, wire.FIRMWARE: 0x0C05}


def base_answer(request: bytes, version: int, lost: int | None = None) -> bytes:
    """What a base station answers to a request; no answer to a read of one place."""
    if request == wire.request(cast(Version, version), BASE_ADDRESS, wire.PING):
        return packet(wire.BASE_SUCCESS, wire.PING.to_bytes(2, "big"), BASE_ADDRESS, version)
    for place, word in WORDS.items():
        data = place.to_bytes(2, "big")
        if request == wire.request(cast(Version, version), BASE_ADDRESS, wire.BASE_READ, data) and place != lost:
            payload = wire.BASE_READ.to_bytes(2, "big") + data + word.to_bytes(2, "big")
            return packet(wire.BASE_SUCCESS, payload, BASE_ADDRESS, version)
    return b""


def identified(version: int = 3, before: bytes = b"", lost: int | None = None, asked: int = 3) -> FoundDevice | None:
    """Carry out the dialogue with a base station of a version; bytes of its nodes come before each answer."""
    turns = identity_turns(settings(aspp=asked))
    request = next(turns)
    while True:
        answer = base_answer(request.data, version, lost)
        assert not request.is_answered(before)
        assert request.is_answered(before + answer) is bool(answer)
        try:
            request = turns.send(before + answer)
        except StopIteration as end:
            return cast("FoundDevice | None", end.value)


@pytest.mark.parametrize("version", [1, 3])
def test_serial_number_and_firmware_of_a_base_station(version: int) -> None:
    found = identified(version, asked=version)
    assert found is not None
    assert found.identity == {
        "sensor": "base station",
        "base_serial": "6307-1040-70000",
        "base_firmware": "12.5",
    }
    assert found.settings == {"baud": 921_600, "aspp": version}


def test_the_node_whose_samples_come_is_named() -> None:
    mine, other = sweeps(0, [(1, 2)]) + sweeps(1, [(1, 2)]), packet(0x1A, bytes.fromhex(ONE_SWEEP), address=9)
    foreign = packet(wire.BASE_SUCCESS, wire.SET_BEACON.to_bytes(2, "big"), BASE_ADDRESS)  # to another program
    found = identified(before=b"\xac\x00" + other + foreign + mine + mine[:20])
    assert found is not None
    assert found.settings == {"baud": 921_600, "aspp": 3, "node_address": 307, "rate_Hz": 256}


@pytest.mark.parametrize("lost", [wire.SERIAL_LOW, wire.FIRMWARE])
def test_a_word_that_is_not_answered_is_left_out(lost: int) -> None:
    found = identified(lost=lost)
    assert found is not None
    assert ("base_serial" in found.identity, "base_firmware" in found.identity) == (
        lost != wire.SERIAL_LOW,
        lost != wire.FIRMWARE,
    )


def test_another_version_is_not_answered() -> None:
    assert identified(version=1, asked=3) is None
