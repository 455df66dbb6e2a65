"""`rig check` on simulated rigs: healthy ones, and each kind of fault. How many verdicts are right?

    uv run python -m benchmarks.check_rigs --healthy 20 --faults 3

The checks see the rigs only through the bytes of their devices, on simulated time. Noise, clocks, gains and the losses
of the radio differ from rig to rig.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from daq.acquisition.device_check import device_checks
from daq.acquisition.life import Policy
from daq.acquisition.observation import observe
from daq.acquisition.session import Session
from daq.acquisition.tap import tap_test
from daq.drivers.checks import Checks
from daq.drivers.optoncdt.far_end import SimulatedLaser
from daq.lockstep.rig import LockstepRig
from rig_configs import load_rig

SECONDS = 10.0  # the default of `rig check`
HEALTHY_RIGS = (
    "virtual",
    "virtual",
    "other_devices",
    "one_laser",
    "by_hand",
    "virtual",
    "other_devices",
    "ethernet_lasers",
    "analogue_lasers",
    "can_lasers",
)


@dataclass(frozen=True)
class Fault:
    """A fault, and the checks by which it is found.

    Attributes:
        name: description.
        found_by: checks of which at least one fails, as "device check".
        true: settings of the simulated rig.
        stated: settings of the rig file that differ from them.
        prepare: called before the devices are opened.
        swapped: whether the ports of the lasers are exchanged.
    """

    name: str
    found_by: frozenset[str]
    true: tuple[str, ...] = ()
    stated: tuple[str, ...] = ()
    prepare: Callable[[LockstepRig], object] = lambda far: None
    swapped: bool = False


def _drift(far: LockstepRig) -> None:
    laser = far.far.far_ends["laser_x"]
    assert isinstance(laser, SimulatedLaser)
    laser.beam.clock.drift += 500e-6


FAULTS = (
    Fault("lasers swapped", frozenset({"laser_x direction_deg"}), swapped=True),
    Fault("wrong range", frozenset({"laser_x opened"}), stated=("devices.laser_x.range_m=0.05",)),
    Fault(
        "wrong rate",
        frozenset({"encoder rate_Hz"}),
        true=("devices.encoder.rate_Hz=500",),
        stated=("devices.encoder.rate_Hz=1000",),
    ),
    Fault("wrong serial number", frozenset({"laser_y opened"}), stated=("devices.laser_y.serial=12345",)),
    Fault(
        "time-out not as stated",
        frozenset({"drive time_out_s"}),
        prepare=lambda far: far.ask("fail", device="drive", what="time-out", value=2.0),
    ),
    Fault(
        "B locked at A's place",
        frozenset({"encoder locked_B_deg"}),
        prepare=lambda far: far.far.motion.lock(1, -math.pi),
    ),
    Fault("clock 500 ppm off", frozenset({"laser_x clock_ppm"}), prepare=_drift),
    Fault("noisy supply", frozenset({"laser_x steady_lines_um"}), true=("virtual.sensors.hum_m=20e-6",)),
    Fault(
        "radio loses 20 %",
        frozenset({"encoder lost_samples"}),
        true=("virtual.radio.burst_start=0.1", "virtual.radio.burst_stop=0.3", "virtual.radio.loss_in_burst=0.8"),
    ),
)


def failed_checks(name: str, seed: int, fault: Fault | None) -> dict[str, str]:
    """Return the failed checks of a simulated rig as "device check", with their notes.

    Args:
        name: name of a shipped rig file.
        seed: seed of the rig.
        fault: its fault; None for a healthy rig.
    """
    rng = np.random.default_rng(seed)
    true = [
        f"virtual.seed={seed}",
        f"virtual.sensors.laser_noise_m={rng.uniform(1e-6, 8e-6):.3g}",
        *(fault.true if fault else ()),
    ]
    far = LockstepRig(load_rig(name, settings=true))
    ports = far.port_settings()
    if fault and fault.swapped:
        x, y = (json.dumps(far.cables[laser].port) for laser in ("laser_y", "laser_x"))
        ports += [f"devices.laser_x.port={x}", f"devices.laser_y.port={y}"]
    rig = load_rig(name, settings=[*true, *ports, *(fault.stated if fault else ())])
    session = Session(rig, far.clock, edge=far.edge, policy=Policy(lenient=True))
    if fault:
        fault.prepare(far)
    with session:
        found: dict[str, Checks] = device_checks(rig, observe(session, SECONDS))
        if (fault is None or fault.swapped) and not session.devices.unopened:
            for device, checks in tap_test(session, lambda text: _tap(far, text[-1], rng)).items():
                found[device] |= checks
    each = [(f"{device} {what}", one) for device, checks in found.items() for what, one in checks.items()]
    return {what: one.note for what, one in each if one.failed}


def _tap(far: LockstepRig, axis: str, rng: np.random.Generator) -> None:
    """Tap the disk a second later, with the error of direction of a hand."""
    angle = math.radians((0.0 if axis == "x" else 90.0) + 6.0 * rng.standard_normal())
    size_mm = rng.uniform(0.3, 1.5)
    x_mm, y_mm = size_mm * math.cos(angle), size_mm * math.sin(angle)
    far.clock.after(1.0, lambda: far.ask("pluck", x_mm=x_mm, y_mm=y_mm, hold_s=0.05), world=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each rig, and the number of right verdicts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--healthy", type=int, default=20, help="number of healthy rigs")
    parser.add_argument("--faults", type=int, default=3, help="number of rigs with each fault")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    right = 0
    for k in range(given.healthy):
        name = HEALTHY_RIGS[k % len(HEALTHY_RIGS)]
        failed = failed_checks(name, given.seed + k, None)
        right += not failed
        print(f"healthy {name:14} seed {given.seed + k}: {failed or 'passes'}", flush=True)
    print(f"healthy rigs that pass: {right} of {given.healthy}", flush=True)
    for fault in FAULTS:
        found = [failed_checks("virtual", given.seed + 1000 + k, fault) for k in range(given.faults)]
        hits = sum(fault.found_by <= failed.keys() for failed in found)
        others = sorted({what.split(" ", 1)[0] for failed in found for what in failed} - {_device(fault)})
        print(
            f"{fault.name:24} found in {hits} of {given.faults}; other devices that fail: {others or 'none'}",
            flush=True,
        )


def _device(fault: Fault) -> str:
    return next(iter(fault.found_by)).split(" ", 1)[0]


if __name__ == "__main__":
    main()
