"""`rig check` on simulated rigs, through their bytes: every fault is found, and healthy rigs pass."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from daq.acquisition.device_check import device_checks
from daq.acquisition.life import Policy
from daq.acquisition.observation import observe
from daq.acquisition.session import Session
from daq.acquisition.tap import tap_test
from daq.drivers.checks import Checks
from daq.lockstep.rig import LockstepRig
from rig_configs import load_rig
from tests.daq.simulated_sessions import opened
from tests.effort import thorough

SECONDS = 2.0
LONG_S = 10.0  # the default of `rig check`
Prepare = Callable[[LockstepRig], None]


def checked(
    true: Sequence[str] = (),
    stated: Sequence[str] = (),
    prepare: Prepare = lambda far: None,
    tap: bool = False,
    swapped: bool = False,
    name: str = "virtual",
    seconds: float = SECONDS,
) -> dict[str, Checks]:
    """Return the checks of a simulated rig.

    Args:
        true: settings of the simulated rig.
        stated: settings of the rig file that differ from them.
        prepare: called before the devices are opened.
        tap: whether the operator is asked to tap the disk.
        name: name of the rig.
        seconds: length of the observation.
        swapped: whether the ports of the lasers are exchanged in the rig file.
    """
    far = LockstepRig(load_rig(name, settings=list(true)))
    ports = far.port_settings()
    if swapped:
        x, y = (json.dumps(far.cables[laser].port) for laser in ("laser_y", "laser_x"))
        ports += [f"devices.laser_x.port={x}", f"devices.laser_y.port={y}"]
    rig = load_rig(name, settings=[*true, *ports, *stated])
    session = Session(rig, far.clock, edge=far.edge, policy=Policy(lenient=True))
    prepare(far)
    with session:
        found = device_checks(rig, observe(session, seconds))
        if tap:
            taps = tap_test(session, lambda text: _tap(far, text[-1]))
            found = {device: checks | taps.get(device, {}) for device, checks in found.items()}
    return found


def _tap(far: LockstepRig, axis: str) -> None:
    x, y = (0.8, 0.1) if axis == "x" else (-0.1, 0.8)
    far.clock.after(1.0, lambda: far.ask("pluck", x_mm=x, y_mm=y, hold_s=0.05), world=True)


def failed(found: dict[str, Checks]) -> dict[str, str]:
    """Return the notes of all failed checks by "device check"."""
    notes = [(f"{name} {what}", one) for name, checks in found.items() for what, one in checks.items()]
    return {what: one.note for what, one in notes if one.failed}


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=thorough)])
def test_a_healthy_rig_passes(seed: int) -> None:
    assert failed(checked([f"virtual.seed={seed}"], tap=True, seconds=LONG_S)) == {}


def _fault(far: LockstepRig, device: str, what: str, **more: float) -> None:
    far.ask("fail", device=device, what=what, **more)


def _drift(far: LockstepRig, device: str, drift: float) -> None:
    laser = far.far.far_ends[device]
    laser.beam.clock.drift = drift


@pytest.mark.parametrize(
    ("how", "expected", "words"),
    [
        (
            {"swapped": True, "tap": True},
            "laser_x direction_deg, laser_y direction_deg",
            "exchange the ports of laser_x and laser_y",
        ),
        (
            {
                "true": ["devices.laser_x.direction_deg=180", "devices.laser_y.direction_deg=270"],
                "stated": ["devices.laser_x.direction_deg=0", "devices.laser_y.direction_deg=90"],
                "tap": True,
            },
            "laser_x direction_deg, laser_y direction_deg",
            "direction_deg = 180",
        ),
        (
            {"prepare": lambda far: _fault(far, "laser_x", "code", value=33_000)},
            "laser_x equal_samples",
            "the sensor hangs",
        ),
        ({"stated": ["devices.laser_y.serial=12345"]}, "laser_y opened", "serial number 12345 is expected"),
        ({"prepare": lambda far: far.far.motion.lock(1, -math.pi)}, "encoder locked_B_deg", ""),
        (
            {"prepare": lambda far: _drift(far, "laser_x", 500e-6), "seconds": LONG_S},
            "laser_x clock_ppm, laser_x rate_Hz",
            "",
        ),
        (
            {
                "true": ["devices.encoder.rate_Hz=500"],
                "stated": ["devices.encoder.rate_Hz=1000"],
                "seconds": LONG_S,  # with half of the packets, two seconds do not resolve the clock
            },
            "encoder rate_Hz",
            "",
        ),
        (
            {"true": ["virtual.sensors.hum_m=20e-6"], "seconds": LONG_S},
            "laser_x steady_lines_um, laser_y steady_lines_um",
            "mains hum",
        ),
        ({"true": ["virtual.sensors.laser_noise_m=30e-6"]}, "laser_x noise_um, laser_y noise_um", ""),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_one_fault_is_found_and_no_other(how: dict[str, Any], expected: str, words: str) -> None:
    found = failed(checked(**how))
    assert ", ".join(sorted(found)) == expected
    assert words in min(found.items())[1]


def test_a_wrong_range_is_found_and_the_other_devices_are_still_checked() -> None:
    found = checked(stated=["devices.laser_x.range_m=0.05"])
    assert set(failed(found)) == {"laser_x opened"}
    assert "25 mm in the sensor" in failed(found)["laser_x opened"]
    assert not found["laser_y"]["rate_Hz"].failed


def test_a_missing_device_is_found_and_the_others_are_still_checked() -> None:
    found = checked(prepare=lambda far: far.cables["encoder"].cut())
    assert set(failed(found)) == {"encoder opened"}
    assert not found["laser_x"]["rate_Hz"].failed


@pytest.mark.parametrize("device", ["laser_x", pytest.param("encoder", marks=thorough), "drive"])
def test_a_silent_device_is_found_and_the_others_are_still_checked(device: str) -> None:
    found = failed(checked(prepare=lambda far: _fault(far, device, "mute")))
    assert set(found) == {f"{device} opened"}


def test_a_time_out_that_is_not_what_the_drive_states_is_found() -> None:
    found = checked(prepare=lambda far: _fault(far, "drive", "time-out", value=3.0))
    assert set(failed(found)) == {"drive time_out_s"}
    assert found["drive"]["time_out_s"].value == pytest.approx(1.5, abs=0.1)  # an adapter delivers up to 32 ms late
    never = checked(prepare=lambda far: _fault(far, "drive", "time-out", value=100.0))
    assert "would not stop by itself" in failed(never)["drive time_out_s"]


def test_the_heartbeat_is_sent_again_after_the_measurement() -> None:
    _, session = opened("virtual")
    with session:
        assert observe(session, 1.0).time_out.measured_s == pytest.approx(0.5, abs=0.05)
        session.drive.enable()
        session.clock.wait(2.0)
        assert session.drive.enabled


def test_a_radio_that_loses_a_fifth_is_found() -> None:
    lossy = ["virtual.radio.burst_start=0.1", "virtual.radio.burst_stop=0.3", "virtual.radio.loss_in_burst=0.8"]
    found = set(failed(checked(lossy)))
    assert {"encoder lost_samples"} <= found <= {"encoder lost_samples", "encoder lost_radio_frames"}


def test_a_drive_that_is_set_up_and_sends_no_reports_is_stopped_at_the_end() -> None:
    """It was commanded, so the end of the check removes its torque and its watch, and ends the heartbeat."""
    far, session = opened("virtual", policy=Policy(lenient=True))
    _fault(far, "drive", "silent reports")
    with session:
        observe(session, 1.0)
        assert set(session.devices.unopened) == {"drive"}
        assert far.far.far_ends["drive"].facts()["watchdog_ms"] > 0
    assert far.far.far_ends["drive"].facts()["watchdog_ms"] == 0


def test_a_device_without_a_port_does_not_stop_the_commands_of_the_others() -> None:
    far, session = opened("virtual", policy=Policy(lenient=True))
    far.cables["laser_x"].cut()
    with session:
        session.clock.wait(5.0)  # longer than a silent line
        session.rotor.command_locks("lock both")
        assert set(session.devices.unopened) == {"laser_x"}


def test_a_drive_that_refuses_its_set_up_is_judged_where_nothing_else_measures_the_rotor() -> None:
    whole = load_rig("analogue_lasers")
    alone = whole.model_copy(update={"devices": {"inverter": whole.devices["inverter"]}})
    far = LockstepRig(alone)
    port = far.cables["inverter"].port
    rig = alone.model_copy(
        update={"devices": {"inverter": alone.devices["inverter"].model_copy(update={"port": port})}}
    )
    session = Session(rig, far.clock, edge=far.edge, policy=Policy(lenient=True))
    _fault(far, "inverter", "refuses", value=4)
    with session:
        found = device_checks(rig, observe(session, 1.0))
    assert "it refuses writing 10 to register" in failed(found)["inverter opened"]
    assert "keep away from it" in session.rotor_warning
