"""The least delay of a device's bytes: its times are earlier by it, live, in replay and in the signals of a log."""

from __future__ import annotations

import numpy as np
import pytest

from daq.drivers.calibrated import CalibratedPipeline, Calibration
from daq.drivers.devices import make_pipelines
from daq.items import RX, TX, Batch
from daq.signals.run_clocks import clock_line
from rig_configs import RigFileError, load_rig
from rig_configs.roles import PendulumAngles
from tests.daq.drivers.optoncdt.test_laser_scaling import blocks

DELAY_S = 0.003
START_NS = 1_700_000_000_000_000_000


def test_the_times_of_a_device_are_earlier_by_its_least_delay() -> None:
    times: list[np.ndarray] = []
    for delay in (0.0, DELAY_S):
        rig = load_rig("virtual", settings=[f"devices.laser_x.least_delay_s={delay}"])
        calibration = Calibration.of(rig.devices["laser_x"])
        pipeline = CalibratedPipeline(make_pipelines(rig.devices, {})["laser_x"], calibration)
        pipeline.feed(TX, b"OUTPUT RS422\n", START_NS - 1)
        found = pipeline.feed(RX, blocks(np.full(50, 32_760)), START_NS)
        times.append(np.concatenate([item.time_ns for item in found if isinstance(item, Batch)]))
    assert len(times[0]) > 40
    assert np.all(times[0] - times[1] == round(DELAY_S * 1e9))


def test_the_roles_of_a_device_contain_it_and_the_signals_of_a_log_use_it() -> None:
    settings = [f"devices.encoder.least_delay_s={DELAY_S}"]
    roles = load_rig("virtual", settings=settings).roles
    assert roles.angles is not None
    assert roles.phase is not None
    assert (roles.angles.least_delay_s, roles.phase.least_delay_s) == (DELAY_S, DELAY_S)
    assert all(sensor.least_delay_s == 0.0 for sensor in roles.displacements)
    device_s = np.arange(0.0, 10.0, 0.01)
    arrived_ns = START_NS + np.round((device_s + 5.0) * 1e9).astype(np.int64)

    def at_s(role: PendulumAngles | None) -> float:
        return float(clock_line(device_s, arrived_ns, START_NS * 1e-9, role).host_s(np.array([0.0]))[0])

    assert at_s(None) - at_s(roles.angles) == pytest.approx(DELAY_S, abs=1e-7)


def test_a_negative_delay_is_refused() -> None:
    with pytest.raises(RigFileError, match="least_delay_s"):
        load_rig("virtual", settings=["devices.encoder.least_delay_s=-0.001"])
