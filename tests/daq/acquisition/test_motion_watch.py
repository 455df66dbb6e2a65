"""Sensors that hang while the rotor turns, on simulated columns that are not the virtual rig.

The displacement is that of two oscillators under an unbalance on a ramp, integrated here.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq import open_log
from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.motion_watch import MotionWatch
from daq.errors import DeviceError
from daq.lockstep import Rehearsal
from rig_configs import load_rig
from rig_configs.schema import Rig

RATE_HZ, READ = 1000, 20
NS = 1_000_000_000
RIG = LeastMotion(0.00254, 7.27, (2583.0, 38488.0), (5.5, 21.0))
SENSORS = load_rig("virtual").roles.displacements


@dataclass(frozen=True)
class Column:
    """A column on a ramp: x and y, m, and the speed, rpm, at 1 kHz."""

    x: np.ndarray
    y: np.ndarray
    rpm: np.ndarray

    def first(self, hung: dict[str, np.ndarray] | None = None, least: LeastMotion = RIG) -> tuple[float, str] | None:
        """Return speed and text of the first fault that the watch finds, looked at every 0.1 s; None without one."""
        watch = MotionWatch(SENSORS, least)
        watch.angles(0.0, math.pi)
        shown = {"laser/x": self.x, "laser/y": self.y, **(hung or {})}
        for end in range(READ, len(self.rpm), READ):
            at_ns = end * NS // RATE_HZ
            for topic, values in shown.items():
                watch.feed(topic, at_ns, values[end - READ : end])
            if end % 100 == 0 and (found := watch.tick(at_ns, float(self.rpm[end]))):
                return float(self.rpm[end]), found.text
        return None


def column(
    rig: LeastMotion,
    top_rpm: float = 900.0,
    ramp_rpm_s: float = 22.5,
    share: float = 1.0,
    run_out_m: float = 0.0,
    noise_m: float = 2e-6,
    stiffer: float = 1.0,
) -> Column:
    """Integrate a run-up to a speed that is held for 3 s, and a run-down with the same ramp."""
    time = np.arange(round((2 * top_rpm / ramp_rpm_s + 3.0) * RATE_HZ)) / RATE_HZ
    rpm = np.clip(np.minimum(ramp_rpm_s * time, ramp_rpm_s * (time[-1] - time)), 0.0, top_rpm)
    steps, omega = len(time), rpm * 2 * np.pi / 60
    psi = np.cumsum(omega) / RATE_HZ
    alpha = np.gradient(omega, time)
    moment = share * rig.moment_kg_m
    forces = (
        moment * (omega**2 * np.cos(psi) + alpha * np.sin(psi)),
        moment * (omega**2 * np.sin(psi) - alpha * np.cos(psi)),
    )
    rng = np.random.default_rng(3)
    found = []
    for force, k, c, wave in zip(
        forces, rig.stiffness_N_per_m, rig.damping_Ns_per_m, (np.cos(psi), np.sin(psi)), strict=True
    ):
        value, speed, out = 0.0, 0.0, np.empty(steps)
        h = 1.0 / RATE_HZ
        for i in range(steps):  # symplectic steps, stable far above the column's frequencies
            speed += h * (force[i] - stiffer * k * value - c * speed) / rig.mass_kg
            value += h * speed
            out[i] = value
        found.append(out - run_out_m * wave + noise_m * rng.standard_normal(steps))
    return Column(found[0], found[1], rpm)


@pytest.fixture(scope="module")
def run_up() -> Column:
    return column(RIG)


def test_a_working_rig_is_never_stopped(run_up: Column) -> None:
    assert run_up.first() is None


@pytest.mark.parametrize("noise_m", [0.0, 3e-6], ids=["constant", "noise"])
@pytest.mark.parametrize("both", [True, False])
def test_a_hung_sensor_is_found_before_the_first_resonance(run_up: Column, noise_m: float, both: bool) -> None:
    stands = 1e-3 + noise_m * np.random.default_rng(5).standard_normal(len(run_up.rpm))
    found = run_up.first({"laser/x": stands, "laser/y": stands} if both else {"laser/x": stands})
    assert found is not None
    rpm, text = found
    assert rpm < 0.8 * 60 / (2 * math.pi) * math.sqrt(RIG.stiffness_N_per_m[0] / RIG.mass_kg)
    assert text.startswith("laser/x: moves by ±")


def test_the_other_sensor_is_found_before_its_own_resonance(run_up: Column) -> None:
    found = run_up.first({"laser/y": 3e-6 * np.random.default_rng(5).standard_normal(len(run_up.rpm))})
    assert found[0] < 60 / (2 * math.pi) * math.sqrt(RIG.stiffness_N_per_m[1] / RIG.mass_kg)


@settings(max_examples=8, deadline=None)
@given(
    st.floats(0.75, 1.5),
    st.floats(0.0, 40e-6),
    st.floats(0.85, 1.15),
    st.floats(20.0, 120.0),
    st.sampled_from(["flexible", "stiff", "isotropic"]),
)
def test_a_rig_that_differs_from_its_file_is_not_stopped(
    share: float, run_out_m: float, stiffer: float, ramp: float, kind: str
) -> None:
    """Weights, springs and a run-out within the stated uncertainty, at slow and fast ramps."""
    file = {
        "flexible": RIG,
        "stiff": replace(RIG, moment_kg_m=4e-4, mass_kg=2.0, stiffness_N_per_m=(9e3, 1.2e4)),
        "isotropic": replace(RIG, stiffness_N_per_m=(2583.0, 2583.0), damping_Ns_per_m=(5.5, 5.5)),
    }[kind]
    assert column(file, 600.0, ramp, share, run_out_m, 2e-6, stiffer).first(least=file) is None


def test_a_balanced_rotor_needs_no_motion() -> None:
    file = replace(RIG, moment_kg_m=1e-5)
    still = column(file, 600.0, 60.0, noise_m=0.0)
    flat = np.zeros(len(still.rpm))
    assert replace(still, x=flat, y=flat).first(least=file) is None


def test_free_pendulums_may_balance_the_rotor(run_up: Column) -> None:
    watch = MotionWatch(SENSORS, RIG)
    watch.angles(2.0, 4.3)
    for tick in range(100):
        for topic in ("laser/x", "laser/y"):
            watch.feed(topic, tick * NS // 10, np.zeros(100))
        assert watch.tick(tick * NS // 10, 600.0) is None


@pytest.mark.parametrize(
    ("period_s", "from_s", "found"),
    [(0.02, 0.0, True), (0.1, 0.0, True), (0.02, 1.96, False)],  # the last one: it sends again after a gap
)
def test_a_constant_reading_while_the_other_moves_is_a_fault_once_it_lasts(
    period_s: float, from_s: float, found: bool
) -> None:
    watch = MotionWatch(SENSORS, RIG)
    for number in range(round(2.0 / period_s)):
        at_s = number * period_s
        watch.feed("laser/y", round(at_s * NS), np.array([1e-4 * math.sin(2 * math.pi * at_s)]))
        if at_s >= from_s:
            watch.feed("laser/x", round(at_s * NS), np.full(2, 1e-3))
    stop = watch.tick(2 * NS, math.nan)
    assert (stop is not None and stop.interlock == "stuck sensor") is found


def test_pendulums_without_encoders_imply_only_what_they_cannot_balance() -> None:
    by_hand = load_rig("virtual", settings=["imbalance.mass_kg=1.0"])
    unseen = SimpleNamespace(physics=by_hand.physics, roles=replace(by_hand.roles, angles=None))
    both = sum(each.mass_kg * each.length_m for each in (by_hand.physics.a, by_hand.physics.b))
    assert LeastMotion.of(by_hand).moment_kg_m == pytest.approx(0.02117)
    assert LeastMotion.of(cast(Rig, unseen)).moment_kg_m == pytest.approx(0.02117 - both)


def test_a_run_up_with_hung_lasers_ends_before_the_first_resonance(tmp_path: Path) -> None:
    """The whole way of a session: far ends, drivers, interlocks, the stop of the drive."""
    with contextlib.suppress(DeviceError), Rehearsal("virtual", tmp_path) as rig:
        for laser in ("laser_x", "laser_y"):
            rig._far.ask("fail", device=laser, what="code", value=33_000)
        with pytest.raises(DeviceError, match="laser/x: moves by"):
            rig.record("run-up", top_rpm=400.0, duration_s=16.0)
    (log,) = tmp_path.glob("*.mcap")
    with open_log(log) as opened:
        assert float(opened["motor"].speed_rpm.max()) < 180.0
        assert [event["interlocks"] for event in opened.events if event["kind"] == "trip"] == [["no motion"]]


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 90.0])
def test_the_bound_of_turned_sensors_is_that_of_their_directions(turn_deg: float) -> None:
    speed = 40.0
    turned = replace(RIG, turn_rad=math.radians(turn_deg))
    x, y = (RIG.amplitude_m(axis, speed, speed) for axis in "xy")
    c, s = math.cos(turned.turn_rad), math.sin(turned.turn_rad)
    assert turned.amplitude_m("x", speed, speed) == pytest.approx(math.hypot(c * x, s * y))
