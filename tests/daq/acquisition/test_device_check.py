"""Checks of an observed rig: one deviation fails its check and its device, and no other."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.acquisition.device_check import (
    ObservedAngles,
    ObservedSpeed,
    RigObservation,
    common_factor,
    device_checks,
    passed,
)
from daq.acquisition.displacement_check import ObservedDisplacement
from daq.acquisition.rate_watch import Rate
from daq.drivers.canopen import cia301
from daq.drivers.checks import Checks
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.status_checks import drive_checks
from daq.drivers.contract import TimeOut
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.status_checks import node_checks
from daq.drivers.rotorlink.stream import NodePipeline
from daq.items import DeviceEvent
from daq.signals.speed_agreement import SpeedAgreement
from rig_configs import load_rig

RIG = load_rig("virtual")
STATUS = rotorlink.NodeStatus(1, 8, 2_000_000, 3712, 315, 8, 0, 1, 4, 4096)
LOCKED = np.tile([0.0, np.pi], (100, 1))


def rate(nominal: float, factor: float = 1.0, clock_ppm: float = 10.0, bound_ppm: float = 1000.0) -> Rate:
    return Rate(nominal * factor, nominal, clock_ppm, bound_ppm, 150.0, 2.0)


def flags(value: int) -> np.ndarray:
    return np.full(2000, value, np.uint32)


@dataclass(frozen=True)
class Node:
    """What a look finds of the encoder node."""

    status: rotorlink.NodeStatus | None = STATUS
    rssi_dBm: int | None = -58
    battery_low: bool = False

    def checks(self) -> Checks:
        pipeline = NodePipeline("encoder", RIG.devices["encoder"], {})
        pipeline.node_status, pipeline.rssi_dBm, pipeline.battery_low = self.status, self.rssi_dBm, self.battery_low
        return node_checks(RIG.devices["encoder"], pipeline, None, [])


@dataclass(frozen=True)
class Drive:
    """State of the drive as an observation contains it, without the speed."""

    state: str = cia402.SWITCH_ON_DISABLED
    code: int | None = None

    def fault_code(self) -> int | None:
        return self.code


@dataclass(frozen=True)
class Seen(RigObservation):
    """A look, with what the drivers looked at still to be judged."""

    node: Node = field(default_factory=Node)
    drive: Drive = field(default_factory=Drive)

    def judged(self) -> dict[str, Checks]:
        drive = drive_checks(self.drive, [e for e in self.events if e.device == "drive"])
        own: dict[str, Checks] = {"encoder": self.node.checks(), "drive": drive}
        return device_checks(RIG, replace(self, own=own))


def displaced(value_m: np.ndarray) -> ObservedDisplacement:
    return ObservedDisplacement(np.arange(len(value_m)) / 4000.0, value_m)


def healthy() -> Seen:
    rest = displaced(1e-4 + 4e-6 * np.random.default_rng(1).standard_normal(8000))
    return Seen(
        seconds=2.0,
        rates={"laser/x": rate(4000), "laser/y": rate(4000), "pendulums": rate(1000)},
        host_rates_Hz={},
        losses={
            "laser_x": {"samples": 0, "invalid": 3},
            "laser_y": {"samples": 0},
            "drive": {"damaged_lines": 0},
            "encoder": {"radio_frames": 1, "samples": 20},
        },
        events=[],
        displacements={"laser/x": rest, "laser/y": rest},
        clock_stds_ns={"laser_x": 2e4, "encoder": 9e4},
        by_radio=frozenset({"encoder"}),
        time_out=TimeOut(0.51, 0.5, 0.03),
        angles=ObservedAngles(LOCKED, flags(96)),
        speed=ObservedSpeed(100.0, 0.0),
    )


def changed(look: Seen, what: str, value: Any) -> Seen:
    room, _, name = what.partition(".")
    if not name:
        return replace(look, **{room: value})
    return replace(look, **{room: replace(getattr(look, room), **{name: value})})


def test_a_healthy_rig_passes_with_what_was_seen_and_expected() -> None:
    devices = healthy().judged()
    assert list(devices) == ["laser_x", "laser_y", "encoder", "drive"]
    assert {name: [w for w, c in checks.items() if c.failed] for name, checks in devices.items()} == {
        "laser_x": [],
        "laser_y": [],
        "encoder": [],
        "drive": [],
    }
    assert devices["laser_x"]["rate_Hz"].facts() == {
        "value": 4000.0,
        "expected": 4000,
        "verdict": "pass",
        "note": "± 1000 ppm in 2.0 s",
    }
    assert devices["encoder"]["battery_mV"].value == 3712
    assert devices["encoder"]["firmware"].value == "1.4"


NOISE = np.random.default_rng(2).standard_normal(32_000)
SHAKEN = np.column_stack([5e-3 * (-1.0) ** np.arange(100), np.zeros(100)])
HUM = 4e-6 * NOISE + 1e-5 * np.sin(2 * np.pi * 50.0 * np.arange(32_000) / 4000.0)
EMERGENCY = DeviceEvent("emergency", "drive", "drive error 0x3220", {"error_code": 0x3220})


@pytest.mark.parametrize(
    ("what", "value", "device", "check"),
    [
        ("rates", {**healthy().rates, "laser/x": rate(4000, 7911 / 4000)}, "laser_x", "rate_Hz"),
        ("rates", {**healthy().rates, "laser/y": rate(4000, 3656 / 4000)}, "laser_y", "rate_Hz"),
        ("rates", {**healthy().rates, "laser/y": rate(4000, 1.0, 86_000.0)}, "laser_y", "clock_ppm"),
        ("rates", {**healthy().rates, "pendulums": None}, "encoder", "rate_Hz"),
        ("losses", {**healthy().losses, "laser_y": {"samples": 7}}, "laser_y", "lost_samples"),
        ("losses", {**healthy().losses, "drive": {"damaged_lines": 1}}, "drive", "lost_damaged_lines"),
        (
            "displacements",
            {**healthy().displacements, "laser/x": displaced(np.full(100, np.nan))},
            "laser_x",
            "invalid_samples",
        ),
        (
            "displacements",
            {**healthy().displacements, "laser/x": displaced(np.full(9, 3e-3))},
            "laser_x",
            "from_mid_range_mm",
        ),
        ("displacements", {**healthy().displacements, "laser/x": displaced(np.empty(0))}, "laser_x", "samples"),
        (
            "displacements",
            {**healthy().displacements, "laser/y": displaced(np.full(8000, 1e-4))},
            "laser_y",
            "equal_samples",
        ),
        ("speeds", SpeedAgreement(544.0, 476.0, 8 / 7, 1e-3), "drive", "marks_over_drive"),
        ("angles.flags", flags(96 | 1), "encoder", "encoder_faults"),
        ("angles.flags", flags(96 | 2), "encoder", "encoder_faults"),
        ("node.battery_low", True, "encoder", "battery_mV"),
        ("node.status", None, "encoder", "status"),
        ("node.status", replace(STATUS, counts_per_revolution=8192), "encoder", "counts_per_revolution"),
        ("node.rssi_dBm", -97, "encoder", "signal_dBm"),
        ("angles.theta_rad", np.zeros((100, 2)), "encoder", "locked_B_deg"),
        ("angles.theta_rad", LOCKED + np.array([0.2, 0.0]), "encoder", "locked_A_deg"),
        ("drive.state", cia402.FAULT, "drive", "state"),
        ("drive.state", cia402.UNKNOWN, "drive", "state"),
        ("displacements", {**healthy().displacements, "laser/y": displaced(3e-5 * NOISE)}, "laser_y", "noise_um"),
        ("displacements", {**healthy().displacements, "laser/y": displaced(HUM)}, "laser_y", "steady_lines_um"),
        ("angles.theta_rad", LOCKED + SHAKEN, "encoder", "noise_A_counts"),
        ("time_out", TimeOut(1.5, 0.5, 0.03), "drive", "time_out_s"),
        ("time_out", TimeOut(0.3, 0.5, 0.03), "drive", "time_out_s"),
        ("time_out", TimeOut(None, 0.5, 0.03), "drive", "time_out_s"),
        ("clock_stds_ns", {"laser_y": 3e6}, "laser_y", "clock_std_us"),
        ("unopened", {"drive": "no answer"}, "drive", "opened"),
        ("complaints", {"laser_x": "another sensor"}, "laser_x", "identity"),
        ("speed.speed_rpm", 12.0, "drive", "speed_rpm"),
        ("speed.reports_Hz", float("nan"), "drive", "speed_reports_Hz"),
        ("events", [EMERGENCY], "drive", "emergencies"),
        ("events", [DeviceEvent("restart", "encoder", "the node started again")], "encoder", "restarts"),
    ],
)
def test_one_thing_wrong_fails_its_check_and_no_other(what: str, value: Any, device: str, check: str) -> None:
    devices = changed(healthy(), what, value).judged()
    failed = {(name, key) for name, checks in devices.items() for key, found in checks.items() if found.failed}
    assert failed == {(device, check)}
    assert [name for name, checks in devices.items() if not passed(checks)] == [device]


@pytest.mark.parametrize(
    ("hertz", "rpm", "passes"),
    [(10.0, 600.0, True), (20.1, 600.0, True), (50.0, 600.0, True), (13.0, 600.0, False), (10.0, math.nan, False)],
)
def test_orders_of_a_rotor_that_turns_are_no_disturbance(hertz: float, rpm: float, passes: bool) -> None:
    line = 4e-6 * NOISE + 1e-3 * np.sin(2 * np.pi * hertz * np.arange(32_000) / 4000.0)
    seen = changed(healthy(), "displacements", {**healthy().displacements, "laser/y": displaced(line)})
    check = changed(seen, "rotor_rpm", rpm).judged()["laser_y"]["steady_lines_um"]
    assert check.passed is passes
    assert ("600 rpm" in check.note) == passes


def test_a_fault_by_the_lost_heartbeat_of_a_host_passes_and_is_reported() -> None:
    beat = Drive(cia402.FAULT, cia301.HEARTBEAT_ERROR)
    state = changed(healthy(), "drive", beat).judged()["drive"]["state"]
    assert state.passed
    assert "0x8130" in state.note
    other = changed(healthy(), "drive", replace(beat, code=0x3220)).judged()["drive"]["state"]
    assert not other.passed
    assert "0x3220" in other.note


def test_an_open_lock_is_no_fault_and_its_position_not_judged() -> None:
    checks = changed(healthy(), "angles.flags", flags(64)).judged()["encoder"]
    assert checks["lock_A"].value == "open"
    assert "locked_A_deg" not in checks
    assert "locked_B_deg" in checks


@pytest.mark.parametrize(("host_Hz", "ok"), [(990.0, True), (970.0, False), (1030.0, False), (math.nan, False)])
def test_a_channel_without_a_device_clock_is_judged_by_the_hosts(host_Hz: float, ok: bool) -> None:
    look = healthy()
    rates = {topic: found for topic, found in look.rates.items() if topic != "pendulums"}
    checks = replace(look, rates=rates, host_rates_Hz={"pendulums": host_Hz}).judged()["encoder"]
    assert checks["rate_Hz"].passed == ok
    assert "clock_ppm" not in checks


def test_a_rig_of_one_sensor_is_judged_by_that_one() -> None:
    one = RIG.model_copy(update={"devices": {"probe": RIG.devices["laser_x"]}})
    look = RigObservation(
        2.0, {"laser/x": rate(4000)}, {}, {"probe": {"samples": 0}}, [], {"laser/x": displaced(np.full(9, 3e-3))}
    )
    devices = device_checks(one, look)
    assert [(name, key) for name, c in devices.items() for key, found in c.items() if found.failed] == [
        ("probe", "from_mid_range_mm")
    ]


def test_clocks_that_are_all_off_alike_are_the_hosts_own_fault() -> None:
    assert common_factor(healthy()) is None
    off = {topic: rate(4000, 0.125, -875_000.0) for topic in ("laser/x", "laser/y", "pendulums")}
    assert common_factor(changed(healthy(), "rates", off)) == pytest.approx(0.125)


def test_messages_of_others_are_no_loss() -> None:
    """A neighbour's module on the same channel is passed over, counted and shown; the device is sound."""
    checks = replace(healthy(), losses={**healthy().losses, "encoder": {"foreign_frames": 12}}).judged()["encoder"]
    assert (checks["foreign_frames"].value, checks["foreign_frames"].passed) == (12, True)


@pytest.mark.parametrize(("by_radio", "lost", "passes"), [(True, 100, True), (True, 101, False), (False, 1, False)])
def test_only_a_radio_may_lose_a_small_share(by_radio: bool, lost: int, passes: bool) -> None:
    """Of 2000 samples in 2 s; the node counts no frames, as MicroStrain nodes."""
    look = replace(healthy(), by_radio=frozenset({"encoder"} if by_radio else ()))
    checks = replace(look, losses={**look.losses, "encoder": {"samples": lost}}).judged()["encoder"]
    assert checks["lost_samples"].passed is passes
    assert checks["lost_samples"].expected == ("at most 5% of the samples" if by_radio else 0)


SHORT = {
    "seconds": 2.0,
    "rates": {**healthy().rates, "laser/x": rate(4000, bound_ppm=1200.0)},
    "clock_stds_ns": {"laser_x": 2e6},
    "displacements": {**healthy().displacements, "laser/x": displaced(4e-6 * NOISE[:150])},
    "speed.reports_Hz": 10.25,
    "time_out": TimeOut(0.5, 0.5, 0.2),
}


@pytest.mark.parametrize(
    ("what", "device", "check", "advice"),
    [
        ("rates", "laser_x", "clock_ppm", "observe for 18 s"),
        ("clock_stds_ns", "laser_x", "clock_std_us", "observe for 5 s"),
        ("displacements", "laser_x", "invalid_samples", "observe for"),
        ("displacements", "laser_x", "noise_um", "256 valid samples are needed"),
        ("seconds", "laser_y", "steady_lines_um", "observe for 6 s"),
        ("speed.reports_Hz", "drive", "speed_reports_Hz", "observe for 4 s"),
        ("time_out", "drive", "time_out_s", "± 0.2 s by the periods of the messages"),
    ],
)
def test_a_limit_that_the_observation_does_not_resolve_is_no_tick(
    what: str, device: str, check: str, advice: str
) -> None:
    """An error of ± 1200 ppm leaves a limit of 150 ppm open."""
    found = changed(healthy(), what, SHORT[what]).judged()[device]
    assert found[check].passed is None
    assert found[check].facts()["verdict"] == "not resolved"
    assert advice in found[check].note
    assert passed(found), "it is no failure either"


def test_a_longer_observation_resolves_the_clock() -> None:
    rates = {topic: rate(4000, bound_ppm=100.0) for topic in healthy().rates}
    assert changed(healthy(), "rates", rates).judged()["laser_x"]["clock_ppm"].passed is True


@pytest.mark.parametrize("bound_ppm", [1.0, 50.0, 1000.0])
@given(off_ppm=st.floats(-3000.0, 3000.0))
def test_a_tick_holds_for_every_value_within_the_bound(off_ppm: float, bound_ppm: float) -> None:
    rates = {**healthy().rates, "laser/x": rate(4000, clock_ppm=off_ppm, bound_ppm=bound_ppm)}
    found = changed(healthy(), "rates", rates).judged()["laser_x"]["clock_ppm"]
    limit = rates["laser/x"].tolerance_ppm
    extremes = [abs(off_ppm) - bound_ppm <= limit, abs(off_ppm) + bound_ppm <= limit]
    assert found.passed is (True if all(extremes) else None if any(extremes) else False)


def test_drive_and_index_marks_of_a_rotor_at_rest_are_not_compared() -> None:
    found = healthy().judged()["drive"]["marks_over_drive"]
    assert (found.passed, found.value) == (None, None)
    assert "Turn it by hand" in found.note


@pytest.mark.parametrize(("step_m", "equal", "verdict"), [(1e-6, False, True), (1.0, True, False)])
def test_only_a_sensor_that_repeats_its_value_hangs(step_m: float, equal: bool, verdict: bool) -> None:
    """Noise of a third of a step moves a coarse reading often enough."""
    coarse = step_m * np.round(0.34 * NOISE[:8000] + 0.2) if not equal else np.full(8000, 1e-3)
    seen = changed(healthy(), "displacements", {**healthy().displacements, "laser/x": displaced(coarse)})
    assert seen.judged()["laser_x"]["equal_samples"].passed is verdict
