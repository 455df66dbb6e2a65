"""CANopen encoders: faults at the opening and later, and the checks of open encoders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from daq import channels
from daq.acquisition.device_check import device_checks
from daq.drivers.canopen import cia301
from daq.drivers.checks import Checks
from daq.items import RX, TX, Batch, DeviceEvent
from rig_configs import load_rig
from rig_drivers.cia406 import wire
from rig_drivers.cia406.driver import DRIVER
from rig_drivers.cia406.far_end import PlayedEncoders, SimulatedEncoders
from rig_drivers.cia406.stream import EncoderPipeline
from rig_testing.bench import DriverBench
from tests.daq.acquisition.test_device_check import healthy
from tests.daq.can_text import rx, tx
from tests.rig_drivers.cia406.test_encoders import SYNC, Line, bench_of, identity, report, settings


def opened(**objects: tuple[int, int, int, str]) -> DriverBench:
    """Open encoders; those of B have other objects: index, sub-index, value, form."""
    bench, far = bench_of()
    for index, sub, value, form in objects.values():
        far.encoders[1].objects[index, sub] = (value, form)
    bench.begin()
    bench.clock.wait(0.1)
    return bench


FAULTY = {"b_error_register": 1, "b_error_code": 0x5000, "b_alarms": 0x8001, "b_warnings": 0x10}


def test_faults_at_the_opening_are_in_the_identity() -> None:
    bench = opened(
        register=(0x1001, 0, 1, "<B"),
        newest=(0x1003, 1, 0xABCD_5000, "<I"),
        alarms=(0x6503, 0, 0x8001, "<H"),
        warnings=(0x6505, 0, 0x10, "<H"),
    )
    assert {key: value for key, value in bench.identity.items() if key in FAULTY} == FAULTY
    assert {bench.identity[f"a_{key}"] for key in ("error_register", "error_code", "alarms", "warnings")} == {0}
    assert set(FAULTY) <= DRIVER.measured, "the next opening of the same encoder may find others"


def test_an_old_entry_of_the_error_field_is_no_fault() -> None:
    bench = opened(newest=(0x1003, 1, 0x5000, "<I"))
    assert bench.identity["b_error_code"] == 0


def test_encoders_without_the_objects_of_faults_have_none() -> None:
    bench, far = bench_of()
    for index, sub in ((0x1003, 0), (0x1003, 1), (0x6503, 0), (0x6505, 0)):
        del far.encoders[1].objects[index, sub]
    bench.begin()
    assert {bench.identity[key] for key in FAULTY} == {0}


def decoded(known: Mapping[str, Any], *others: bytes) -> tuple[EncoderPipeline, list[Batch | DeviceEvent]]:
    pipeline = EncoderPipeline("encoders", settings(), {**identity(), **known})
    items = pipeline.feed(TX, SYNC, 0)
    for data in (*others, report(3, 1) + report(4, 1) + report(5, 1)):
        items += pipeline.feed(RX, data, 1_000_000)
    return pipeline, items


def flags(items: list[Batch | DeviceEvent]) -> int:
    (batch,) = [item for item in items if isinstance(item, Batch)]
    return int(batch.columns["flags"][0])


@pytest.mark.parametrize("known", [FAULTY, {"b_error_register": 0x81}, {"b_alarms": 2}])
def test_a_fault_at_the_opening_is_an_emergency_and_a_flag(known: dict[str, int]) -> None:
    pipeline, items = decoded(known)
    assert flags(items) == channels.ENCODER_FAULT_B
    (found,) = [item for item in items if isinstance(item, DeviceEvent) and item.kind == "emergency"]
    assert "encoder b (node 4): since the opening" in found.text
    assert found.facts["error_code"] == known.get("b_error_code", 0x1000)
    assert DRIVER.words(found).startswith("of encoder b: 0x")
    checks = DRIVER.checks(settings(), pipeline, None, [])  # the event came before the check began
    assert not checks["emergencies"].passed
    assert "of encoder b" in checks["emergencies"].value


def test_the_fault_of_the_opening_is_named_and_ends_with_its_emergency() -> None:
    _, items = decoded(FAULTY)
    (found,) = [item for item in items if isinstance(item, DeviceEvent) and item.kind == "emergency"]
    assert found.text.endswith("error register 01h, alarms 8001h (position error, manufacturer-specific)")
    pipeline, items = decoded(FAULTY, rx(b"t0848" + b"00" * 8 + b"\r"))
    assert flags(items) == 0
    assert pipeline.faults == []


def test_warnings_are_reported_and_are_no_fault() -> None:
    pipeline, items = decoded({"a_warnings": 0x11})
    assert flags(items) == 0
    (found,) = [item for item in items if isinstance(item, DeviceEvent)]
    assert (found.kind, found.facts) == ("status", {"encoder": "a", "warnings": 0x11})
    assert "warnings 0011h (speed too high, battery low)" in found.text
    assert DRIVER.checks(settings(), pipeline, None, [])["emergencies"].passed


@pytest.mark.parametrize("known", [{}, {"a_alarms": "1"}, {"a_alarms": None}])
def test_identities_of_earlier_versions_have_no_faults(known: dict[str, Any]) -> None:
    pipeline, items = decoded(known)
    assert flags(items) == 0
    assert pipeline.faults == []


def test_a_fault_remains_until_the_error_register_is_0() -> None:
    line = Line()
    for emergency in (b"0050" + b"21" + b"00" * 5, b"0000" + b"20" + b"00" * 5, b"0000" + b"00" * 6):
        line.at(0, RX, rx(b"t0838" + emergency + b"\r"))
        line.all_answer()
    found = [int(batch.columns["flags"][0]) for batch in line.batches()]
    assert found == [channels.ENCODER_FAULT_A, channels.ENCODER_FAULT_A, 0]
    texts = [event.text.partition(": ")[2] for event in line.events("emergency")]
    assert texts == [
        "error 0x5000",
        "an error has ended, others remain (error register 20h)",
        "an error has ended, none remains",
    ]
    assert DRIVER.words(line.events("emergency")[1]) == ""


def test_the_stand_in_for_a_log_has_its_faults() -> None:
    played = PlayedEncoders(settings(), {**identity(), **FAULTY})
    played.hear(tx(b"O\r"))
    assert played.hear(tx(b"t60484001100000000000\r")) == rx(b"t58484F01100001000000\r")
    assert played.hear(tx(b"t60484003650000000000\r")) == rx(b"t58484B03650001800000\r")


def test_the_simulated_encoder_has_the_fault_that_it_reports() -> None:
    bench, far = bench_of()
    assert isinstance(far, SimulatedEncoders)
    far.fail("emergency", 0x5000)
    bench.begin()
    assert (bench.identity["a_error_register"], bench.identity["a_error_code"]) == (0x21, 0x5000)


def test_bits_of_alarms_and_warnings() -> None:
    assert wire.alarm_words(0x1003) == "1003h (position error, commissioning diagnostics, manufacturer-specific)"
    assert wire.warning_words(0x0060) == "0060h (reference point not reached, reserved)"
    assert cia301.PREDEFINED_ERROR_FIELD == 0x1003


# --- checks ------------------------------------------------------------------------------------------------------


def checked(**losses: int) -> dict[str, Checks]:
    """Check a rig whose device `encoder` has encoders with these losses."""
    pipeline = EncoderPipeline("encoder", settings(), identity())
    for number in range(100):
        pipeline.feed(TX, SYNC, number * 10_000_000)
        pipeline.feed(RX, report(3, 1) + report(4, 1) + report(5, 1), number * 10_000_000 + 1_000_000)
    pipeline.losses |= losses
    own = {"encoder": DRIVER.checks(settings(), pipeline, None, [])}
    seen = replace(healthy(), own=own, losses={"encoder": pipeline.losses, "drive": {"foreign_frames": 3}})
    return device_checks(load_rig("virtual"), seen)


@pytest.mark.parametrize(
    ("kind", "check", "words"),
    [
        ("foreign_syncs", "foreign_syncs", "another node sends SYNC"),
        ("unasked", "lost_unasked", "two encoders with one node number"),
        ("unsampled", "lost_unsampled", "Reduce rate_Hz"),
    ],
)
def test_losses_on_the_bus_fail_the_check_with_a_remedy(kind: str, check: str, words: str) -> None:
    assert checked()["encoder"][check].passed
    devices = checked(**{kind: 5})
    found = devices["encoder"][check]
    assert devices["drive"]["foreign_frames"].passed, "messages that do no harm there"
    assert (found.value, found.passed) == (5, False)
    assert words in found.note


def test_a_host_that_misses_a_few_periods_passes() -> None:
    assert checked(unsampled=2)["encoder"]["lost_unsampled"].passed
