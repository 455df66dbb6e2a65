"""Calibrations on the virtual rig, through the bytes of its devices, on simulated time."""

from __future__ import annotations

import numpy as np
import pytest

from daq.acquisition.session import Session
from daq.calibration.encoder import EncoderCalibration, check_senses, close_repeatedly, judge
from daq.calibration.lengths import positions_of
from daq.calibration.sensor import SensorCalibration, SensorSetup, calibrate, read_positions, there_and_back
from daq.errors import ProcedureError
from daq.guided_tests.hands import CommandedLocks
from daq.lockstep.rig import LockstepRig
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_configs import load_rig
from tests.daq.simulated_sessions import opened

RIG = "one_laser"
TRUE_GAIN = ["devices.probe.gain_factor=1.003", "virtual.sensors.draw_calibration=false", "virtual.seed=4"]
POSITIONS = there_and_back(positions_of("-4, -2, 0, 2, 4 mm ± 1 µm"))


class ErringOperator(SimulatedOperator):
    """Uses blocks with errors of 1 µm."""

    def place(self, device: str, mm: float | None) -> None:
        """Place the target off by the error of the block."""
        off = 0.0 if mm is None else 1e-3 * float(np.random.default_rng(round(1e3 * mm) + 10_000).standard_normal())
        super().place(device, None if mm is None else mm + off)


class WrongOperator(SimulatedOperator):
    """Makes a mistake at one position."""

    def place(self, device: str, mm: float | None) -> None:
        """Take another block in place of that of 2 mm."""
        super().place(device, 1.0 if mm == 2.0 else mm)


class MovingOperator(SimulatedOperator):
    """Does not hold the target."""

    def place(self, device: str, mm: float | None) -> None:
        """Displace the column and release it."""
        self.pluck("x", 2.0)


def calibrated(operator: type[SimulatedOperator], *settings: str, setup: SensorSetup) -> SensorCalibration:
    changes = [*TRUE_GAIN, *settings]
    far = LockstepRig(load_rig(RIG, settings=changes))
    plain = ["devices.probe.gain_factor=1.0", *far.port_settings()]
    rig = load_rig(RIG, settings=[*changes, *plain])
    with Session(rig, far.clock, edge=far.edge) as session:
        readings = read_positions(session, "probe", POSITIONS, operator(far), setup, lambda text: None)
    sensor = rig.devices["probe"]
    return calibrate(readings, sensor, 0.001, setup)


SETUP = SensorSetup(seconds=0.5, zero_m=0.0)


def test_a_gain_that_is_off_by_3_per_mille_is_found_within_its_uncertainty() -> None:
    found = calibrated(ErringOperator, setup=SETUP)
    assert found.refusals == ()
    assert abs(found.line.gain - 1.003) < 3 * found.line.gain_std
    assert found.line.gain_std < 3e-4
    assert found.settings(at_disk=True) | {"lever_ratio_std": 0.0} == found.settings(at_disk=True)


def test_a_curved_sensor_with_play_is_reported() -> None:
    found = calibrated(
        ErringOperator,
        "virtual.sensors.laser_nonlinearity_m=0.002",
        "virtual.sensors.laser_hysteresis_m=4e-6",
        setup=SETUP,
    )
    assert found.line.hysteresis_m == pytest.approx(-4e-6, rel=0.2)
    assert found.line.curved
    assert found.line.nonlinearity_m == pytest.approx(2e-3 * (4 / 12.5) ** 3 * 0.3, rel=0.3)


def test_a_wrong_block_is_refused_by_its_number() -> None:
    (text,) = calibrated(WrongOperator, setup=SETUP).refusals
    assert text.startswith("reading 4 and 7 (position 2 mm)")


def test_a_swapped_sign_is_refused() -> None:
    (text,) = calibrated(SimulatedOperator, setup=SensorSetup(toward=True, seconds=0.5)).refusals
    assert "the reading falls where it should rise" in text


def test_a_target_that_moves_is_not_a_reading() -> None:
    with pytest.raises(ProcedureError, match="the target moves"):
        calibrated(MovingOperator, setup=SETUP)


# --- encoders ----------------------------------------------------------------------------------------------------


class ClockwiseOperator(SimulatedOperator):
    """Turns pendulums the other way, which is what a reversed encoder shows."""

    def turn_pendulum(self, pendulum: int) -> None:
        """Turn clockwise."""
        self._line.ask("flick", pendulum=pendulum, speed_rad_s=-4.0)


class OtherHand(SimulatedOperator):
    """Turns the other pendulum, which is what exchanged encoders show."""

    def turn_pendulum(self, pendulum: int) -> None:
        """Turn the other one."""
        super().turn_pendulum(1 - pendulum)


def encoders(operator: type[SimulatedOperator], zeroed_elsewhere: bool = False) -> EncoderCalibration:
    far, session = opened("virtual", "virtual.seed=4")
    with session:
        hand, locks = operator(far), CommandedLocks(session, session.wait_for)
        senses = check_senses(session, hand, locks, lambda text: None)
        if zeroed_elsewhere:
            session.rotor.command_locks("zero")
        closings = close_repeatedly(session, hand, locks, 4, lambda text: None)
    return judge(closings, senses, 0.05)


def test_repeated_closings_yield_zero_spread_and_sense() -> None:
    found = encoders(SimulatedOperator)
    assert (found.refusals, found.senses) == ((), (1, 1))
    assert all(0.02 < spread < 0.25 for spread in found.spread_deg)  # play of ± 0.2°, evenly distributed
    assert max(map(abs, found.zero_deg)) < 0.4
    assert 0.05 < found.zero_std_deg < 0.4


def test_a_reversed_sense_and_an_exchange_are_refused() -> None:
    assert encoders(ClockwiseOperator).senses == (-1, -1)
    found = encoders(OtherHand)
    assert found.senses == (0, 0)
    assert "exchange the plugs" in found.refusals[0]


def test_a_zero_elsewhere_is_refused() -> None:
    (text,) = encoders(SimulatedOperator, zeroed_elsewhere=True).refusals
    assert "its own closed lock" in text


def test_too_few_closings_are_refused() -> None:
    with pytest.raises(ProcedureError, match="at least 3 closings"):
        judge([], [1, 1], 0.05)
