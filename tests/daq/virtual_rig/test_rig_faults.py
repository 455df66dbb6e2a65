"""Faults of a simulated rig in the bytes of its devices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.drivers.devices import make_pipelines
from daq.drivers.simulated import FarEnd
from daq.items import RX, Batch
from daq.transports.can_frames import CanFrame, encode, open_bus
from daq.virtual_rig.faults import LINE_FAULTS, FaultInjector
from daq.virtual_rig.rig import SimulatedRig
from rig_configs import load_rig
from rig_drivers.riftek import wire as riftek
from rig_drivers.vesc import wire as vesc

LASER_ON = b"OUTADD_RS422 COUNTER TIMESTAMP\nOUTPUT RS422\n"
RIFTEK_ON = riftek.request(1, riftek.START)
STEP_S = 0.01
START_NS = 1_700_000_000_000_000_000


class Fed:
    """A simulated rig whose devices stream, and the pipelines that decode them."""

    def __init__(self, name: str = "virtual", seed: int = 5) -> None:
        self.config = load_rig(name, settings=[f"virtual.seed={seed}", "virtual.radio.burst_start=0"])
        self.rig = SimulatedRig(self.config)
        self.now_s = 0.0
        self.pipelines = make_pipelines(self.config.devices, {})
        self.batches: dict[str, list[Batch]] = {name: [] for name in self.rig.far_ends}
        self.kinds: dict[str, list[str]] = {name: [] for name in self.rig.far_ends}
        self.go(STEP_S, {"laser_x": LASER_ON, "laser_y": LASER_ON, "drive": open_bus(500_000), "east": RIFTEK_ON})

    def go(self, seconds: float, received: dict[str, bytes] | None = None) -> dict[str, bytes]:
        """Let rig time pass; what each device has sent in it."""
        out = dict.fromkeys(self.rig.far_ends, b"")
        for i in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            for name, data in self.rig.step(self.now_s, (received or {}) if i == 0 else {}).items():
                out[name] += data
                for item in self.pipelines[name].feed(RX, data, START_NS + round(self.now_s * 1e9)):
                    if isinstance(item, Batch):
                        self.batches[name].append(item)
                    else:
                        self.kinds[name].append(item.kind)
        return out

    def fail(self, device: str, what: str, **more: Any) -> None:
        self.rig.do({"do": "fail", "device": device, "what": what, **more}, self.now_s)

    def taken(self, device: str, field: str) -> np.ndarray:
        """Values that were decoded since the last time."""
        found = [np.asarray(b.columns[field]) for b in self.batches[device] if field in b.columns]
        self.batches[device].clear()
        return np.concatenate([np.zeros(0), *found])

    def standing(self, device: str) -> dict[str, float]:
        return self.rig.do({"do": "state"}, self.now_s)["devices"][device]["faults"]


@pytest.mark.parametrize("name", ["virtual", "other_devices", "by_hand"])
def test_every_listed_fault_can_be_placed_and_ended_and_the_rig_goes_on(name: str) -> None:
    fed = Fed(name)
    for device, kinds in fed.rig.do({"do": "faults"}, 0.0)["devices"].items():
        assert set(kinds) > set(LINE_FAULTS)
        for what, facts in kinds.items():
            low, high = facts["limits"]
            for value in (facts["value"], low, high):
                fed.fail(device, what, value=value)
                fed.go(0.03)
            fed.fail(device, what)
            assert (what in fed.standing(device)) == facts["lasts"]
            assert len(facts["words"]) > 10
            if facts["lasts"]:
                fed.fail(device, what, end=True)
            assert fed.standing(device) == {}
            for wrong in (low - 1, high + 1, float("nan"), "much"):
                with pytest.raises(ValueError, match=f"'{what}' of {device} takes"):
                    fed.fail(device, what, value=wrong)


@pytest.mark.parametrize(("name", "laser"), [("virtual", "laser_x"), ("other_devices", "east")])
def test_a_laser_is_blocked_for_the_commanded_time(name: str, laser: str) -> None:
    fed = Fed(name)
    fed.go(0.2)
    fed.taken(laser, "displacement_m")
    fed.fail(laser, "blocked", seconds=0.5)
    fed.go(1.0)
    blind = np.isnan(fed.taken(laser, "displacement_m"))
    assert 0.45 < np.mean(blind) < 0.55
    assert not blind[-1]
    assert fed.standing(laser) == {}


def test_lines_are_mute_unheard_and_damaged_each_by_itself_and_by_seed() -> None:
    sound = Fed().go(0.3)
    for what in ("mute", "garbage", "bit errors", "lost bytes"):
        fed, twin, other = Fed(), Fed(), Fed(seed=6)
        for each in (fed, twin, other):
            each.fail("laser_x", what)
        sent = fed.go(0.3)
        assert sent == twin.go(0.3)
        assert {name: data for name, data in sent.items() if name != "laser_x"} == {
            name: data for name, data in sound.items() if name != "laser_x"
        }
        share = len(sent["laser_x"]) / len(sound["laser_x"])
        assert {
            "mute": share == 0,
            "garbage": 1 < share < 1.01,
            "bit errors": share == 1,
            "lost bytes": 0.99 < share < 1,
        }[what]
        assert sent["laser_x"] != sound["laser_x"]
        fed.fail("laser_x", what, end=True)
        fed.go(0.1)
        assert fed.go(0.1)["laser_x"] != b""
    fed = Fed()
    fed.fail("laser_y", "unheard")
    assert b"ILD1420" not in fed.go(0.1, {"laser_y": b"GETINFO\n"})["laser_y"]
    fed.fail("laser_y", "unheard", end=True)
    assert b"ILD1420" in fed.go(0.1, {"laser_y": b"GETINFO\n"})["laser_y"]


def test_a_laser_without_supply_is_silent_and_then_waits_for_its_host() -> None:
    fed = Fed()
    fed.go(0.5)
    fed.fail("laser_x", "power", seconds=0.4)
    assert fed.go(0.3, {"laser_x": b"GETINFO\n"})["laser_x"] == b""
    assert fed.go(0.5)["laser_x"] == b""  # its supply is back, its output is not
    fed.pipelines = make_pipelines(fed.config.devices, {})
    fed.batches["laser_x"].clear()
    fed.go(0.1, {"laser_x": LASER_ON})
    counters = np.concatenate([batch.sequence for batch in fed.batches["laser_x"]])
    assert 1500 < counters[0] < 1700  # it counts from 0 since its supply came back


def test_other_makers_devices_restart_too() -> None:
    fed = Fed("other_devices")
    speed = {"motor": vesc.set_rpm(7 * 300)}
    fed.go(0.5, speed)
    turning = fed.rig.motion.speed_rad_s
    assert turning > 20
    fed.fail("east", "power", seconds=0.1)
    fed.fail("motor", "power", seconds=0.3)
    ask = {"motor": vesc.get_values()}
    sent = fed.go(0.2, ask)
    assert (sent["east"], sent["motor"]) == (b"", b"")
    assert fed.rig.motion.speed_rad_s > turning - 2  # without supply nothing brakes
    assert fed.rig.far_ends["east"].streaming is False
    fed.go(0.2)
    assert fed.go(0.1, ask)["motor"] != b""


def test_a_drive_without_supply_coasts_and_boots_up_behind_an_adapter_that_answers() -> None:
    fed = Fed()
    motion, drive = fed.rig.motion, fed.rig.far_ends["drive"]
    fed.go(0.02, {"drive": encode(CanFrame(0, bytes([1, 5])))})
    assert len(fed.go(0.2)["drive"]) > 100
    fed.fail("drive", "power", seconds=0.5)
    motion._rotor[1] = motion._rotor[2] = 30.0
    before = motion.speed_rad_s
    assert fed.go(0.4, {"drive": open_bus(500_000)})["drive"] == b""
    assert before - 3 < motion.speed_rad_s < before
    sent = fed.go(0.2)["drive"]
    assert sent == encode(CanFrame(0x705, b"\x00"))  # boot-up; it reports nothing until it is started
    assert drive.facts()["watchdog_ms"] == 0


def test_a_node_without_supply_counts_frames_and_time_from_nothing_and_a_mute_radio_loses_them() -> None:
    fed = Fed()
    fed.go(1.0)
    fed.fail("encoder", "radio", seconds=0.5)
    fed.taken("encoder", "theta3_rad")
    fed.go(0.5)
    assert len(fed.taken("encoder", "theta3_rad")) < 40  # what was on air
    fed.go(0.5)
    assert "gap" in fed.kinds["encoder"]
    assert fed.pipelines["encoder"].losses["radio_frames"] > 20
    lost = fed.pipelines["encoder"].losses["radio_frames"]
    fed.fail("encoder", "power", seconds=0.5)
    fed.go(1.0)
    assert "restart" in fed.kinds["encoder"]
    assert fed.pipelines["encoder"].losses["radio_frames"] == lost
    angles = fed.taken("encoder", "theta4_rad")
    assert len(angles) > 400
    assert np.allclose(angles, np.pi, atol=0.02)  # the counters kept their zero


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"device": "laser_z", "what": "mute"}, "no device 'laser_z'; this rig has laser_x, laser_y, encoder, drive"),
        ({"device": "laser_x", "what": "tired"}, "no fault 'tired'; it can have: blocked, code, power, mute"),
        ({"device": "drive", "what": "restart", "seconds": 1.0}, "cannot be ended or timed: it happens once"),
        ({"device": "drive", "what": "restart", "end": True}, "cannot be ended or timed: it happens once"),
        ({"device": "laser_x", "what": "mute", "seconds": 0}, "seconds above 0"),
        ({"device": "laser_x", "what": "mute", "seconds": "long"}, "a finite number for 'seconds'"),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(request_: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Fed().rig.do({"do": "fail", **request_}, 0.0)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"do": "pluck", "x_mm": float("nan")}, "a finite number for 'x_mm'"),
        ({"do": "pluck", "x_mm": 80}, "at most 50 mm"),
        ({"do": "flick", "pendulum": 2, "speed_rad_s": 3}, r"expected pendulum 0 \(A\) or 1 \(B\), got 2"),
        ({"do": "turn", "rpm": 1e9, "ramp_rpm_per_s": 20}, "at most 20000 rpm"),
        ({"do": "turn", "rpm": 60, "ramp_rpm_per_s": 0}, "a ramp above 0"),
        ({"do": "set", "key": "suspension.k3", "value": 1}, "unknown key"),
    ],
)
def test_a_hand_cannot_do_everything(request_: dict[str, Any], words: str) -> None:
    rig = Fed("by_hand").rig
    rig.do({"do": "release"}, 0.0)
    with pytest.raises(ValueError, match=words):
        rig.do(request_, 0.0)


def test_a_far_end_that_lists_nothing_has_the_faults_of_every_line() -> None:
    faults = FaultInjector({"it": FarEnd()}, lambda name: np.random.default_rng(0))
    assert list(faults.kinds("it")) == list(LINE_FAULTS)
    faults.place({"device": "it", "what": "power", "seconds": 2}, 1.0)
    assert (faults.heard("it", b"a"), faults.arrives("it", b"b", 0.1)) == (b"", b"")
    faults.end_in_time(2.9)
    assert faults.heard("it", b"a") == b""
    faults.end_in_time(3.0)
    assert (faults.heard("it", b"a"), faults.arrives("it", b"b", 0.1)) == (b"a", b"b")
