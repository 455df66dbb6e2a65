"""Two sensors along one axis: selection of the measuring one, and the ratio of their readings."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.channels import LASER_X, Channel
from daq.items import Batch
from daq.log.file import LogFile
from daq.replay import check
from daq.signals.run import disagreements, load_run
from daq.signals.witnesses import Witness, WitnessAgreement, agreement
from identification import identify
from rig_cli.main import run as main
from rig_configs import load_rig
from rig_configs.roles import DisplacementSensor, role_table
from tests.daq.simulated_sessions import guided, opened
from tests.effort import cases, thorough

Floats = NDArray[np.float64]
NOISE_M = 4e-6


def motion(time_s: Floats, size_m: float) -> Floats:
    """A decay of two modes with a pull before it: 3 and 11.6 Hz."""
    t = np.maximum(time_s - 1.5, 0.0)
    decay = np.exp(-0.38 * t) * np.cos(18.8 * t) + 0.2 * np.exp(-1.4 * t) * np.cos(73.0 * t)
    pull = np.clip((time_s - 1.0) / 0.2, 0.0, 1.0)
    return np.asarray(size_m * (3 * pull**2 - 2 * pull**3) * decay, float)


def compared(
    seed: int,
    gain: float = 1.0,
    size_m: float = 2.5e-3,
    rates: tuple[float, float] = (4000.0, 4000.0),
    delay_s: float = 1.5e-3,
    drift: float = 20e-6,
    noise_m: float = NOISE_M,
    gain_std: float = 1.4e-3,
) -> WitnessAgreement:
    rng = np.random.default_rng(seed)
    ta, tb = (np.arange(rng.uniform(0, 1) / rate, 12.0, 1 / rate) for rate in rates)
    a = motion(ta, size_m) + noise_m * rng.normal(size=len(ta)) + 3e-4
    b = gain * motion(tb, size_m) + noise_m * rng.normal(size=len(tb)) - 1e-4
    a[rng.random(len(a)) < 1e-3] = np.nan
    lost = (tb > 4.0) & (tb < 4.2)
    stamped = tb + delay_s + drift * (tb - 6.0)
    return agreement(Witness("top", "x", "low", stamped[~lost], b[~lost], gain_std), ta, a)


@pytest.mark.parametrize("rates", [(4000.0, 4000.0), (4000.0, 1000.0), (500.0, 4000.0)])
@pytest.mark.parametrize("gain", [1.0, 0.97])
def test_the_ratio_and_its_uncertainty_are_honest(rates: tuple[float, float], gain: float) -> None:
    found = [compared(seed, gain, rates=rates) for seed in range(cases(15, 40))]
    z = np.array([(one.ratio - gain) / one.ratio_std for one in found])
    assert np.mean([one.ratio for one in found]) == pytest.approx(gain, abs=1e-4)  # a tenth of the calibration's
    assert 0.6 < np.std(z) < 1.5
    assert max(one.ratio_std for one in found) < 4e-4
    assert np.mean([one.delay_s for one in found]) == pytest.approx(1.5e-3, abs=5e-5)


def test_what_calibration_allows_agrees_and_what_it_does_not_is_flagged() -> None:
    assert compared(1, 1.002).verdict == "agree"
    off = compared(1, 1.02)
    assert off.verdict == "disagree"
    assert off.ratio == pytest.approx(1.02, abs=2e-4)
    assert off.text.startswith(f"top and low along x: top shows {off.ratio:.5f} ± ")
    assert "the readings of low are used" in off.text
    assert compared(1, 1.02, gain_std=0.02).verdict == "agree"


def test_a_dead_and_an_unmoved_sensor_are_no_agreement() -> None:
    for still in (compared(2, size_m=0.0), compared(2, gain=0.0), compared(2, size_m=2e-8)):
        assert still.verdict in ("too little motion", "disagree")
        assert still.verdict != "agree"
    nothing = Witness("top", "x", "low", np.empty(0), np.empty(0), 1e-3)
    time = np.arange(4000) / 1000.0
    assert agreement(nothing, time, np.sin(time)).verdict == "too little motion"
    constant = Witness("top", "x", "low", time, np.full(4000, 1e-3), 1e-3)
    assert agreement(constant, time, np.sin(20 * time)).verdict == "too little motion"


def test_noise_of_the_neighbouring_sensor_does_not_make_the_ratio_small() -> None:
    ratios = [compared(seed, size_m=3e-4, noise_m=4e-5).ratio for seed in range(30)]
    assert np.mean(ratios) == pytest.approx(1.0, abs=4 * np.std(ratios) / np.sqrt(30))
    assert abs(np.mean(ratios) - 1) < 2e-3


def test_a_log_s_witness_is_compared_with_its_sensor_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = witnessed_log(tmp_path / "a.mcap", gain=1.03)
    run = load_run(path)
    (witness,) = run.witnesses
    assert (witness.device, witness.axis, witness.reference) == ("top", "x", "laser_x")
    assert witness.gain_std == pytest.approx(np.hypot(0.001, 0.002))
    (found,) = run.agreements()
    assert found.verdict == "disagree"
    assert found.ratio == pytest.approx(1.03, abs=3e-4)
    identified = identify([run], load_rig("virtual"))
    assert identified.witnesses == [found]
    assert f"a.mcap: {found.text}" in identified.warnings
    assert main(["log", str(path)]) == 0
    page = capsys.readouterr().out
    assert "laser_x: measures x" in page
    assert "top: measures witness of x, compared with laser_x" in page
    sound = load_run(witnessed_log(tmp_path / "b.mcap", gain=1.0))
    assert [one.verdict for one in sound.agreements()] == ["agree"]
    assert disagreements(sound) == []


WITNESS = """
[devices.top]
driver = "DRIVER"
port = "p"
axis = "x"
witness = "top"
rate_Hz = 2000
lever_ratio = 1.3
"""


@pytest.mark.parametrize("driver", [pytest.param("optoncdt", marks=thorough), "riftek"])
def test_a_built_in_sensor_is_a_witness_of_another_s_axis(driver: str, tmp_path: Path) -> None:
    """Its own channel, its own lever, its own clock: the ratio shows that both measure the same motion."""
    file = tmp_path / "rig.toml"
    file.write_text((resources.files("rig_configs") / "virtual.toml").read_text() + WITNESS.replace("DRIVER", driver))
    settings = ["virtual.seed=4", "virtual.sensors.axis_angle_deg=0"]
    sim, session = opened(file, *settings)
    with session:
        log = guided(session, sim, tmp_path).run("ring-down-x").log
    assert [row.topic for row in check(log) if row.difference] == []
    run = load_run(log)
    (found,) = run.agreements()
    assert (found.device, found.reference, found.verdict) == ("top", "laser_x", "agree")
    assert found.ratio == pytest.approx(1.0, abs=4 * found.allowed_std)


def test_a_turned_pair_of_built_in_sensors_shows_a_motion_along_x_in_both(tmp_path: Path) -> None:
    settings = ["virtual.seed=4", "virtual.sensors.axis_angle_deg=0", "virtual.sensors.draw_calibration=false"]
    settings += ["devices.laser_x.direction_deg=-45", "devices.laser_y.direction_deg=45"]
    sim, session = opened("virtual", *settings)
    with session:
        run = load_run(guided(session, sim, tmp_path).run("ring-down-x").log)
    size_x, size_y = (np.ptp(np.asarray(value)) for value in (run.x_m, run.y_m))
    assert size_x == pytest.approx(size_y, rel=0.1)  # a pull is not exactly along x
    assert size_x > 1e-3


def witnessed_log(path: Path, gain: float) -> Path:
    """A ring-down measured by laser x and by another laboratory's sensor above it, whose driver is not installed."""
    rig = load_rig("virtual")
    snapshot, roles = json.loads(rig.snapshot_json()), json.loads(rig.roles_json())
    snapshot["devices"]["top"] = {"driver": "acme", "port": "p"}
    top = DisplacementSensor(
        "top", "laser/top", "x", 4000.0, 0.025, 30.0, lever_ratio=1.3, gain_std=0.002, witness=True
    )
    roles["top"] = [role_table(top)]
    attachments = {"rig.json": json.dumps(snapshot).encode(), "roles.json": json.dumps(roles).encode()}
    start, rng = 1_700_000_000_000_000_000, np.random.default_rng(3)
    channels = (LASER_X, Channel("laser/top", "rig.LaserSample", LASER_X.fields))
    with LogFile(path, {"test": "ring-down-x"}, attachments, (), start, channels) as log:
        for block in range(300):
            for channel, scale in zip(channels, (1.0, gain), strict=True):
                number = 160 * block + np.arange(160)
                value = scale * motion(number / 4000.0, 2.5e-3) + NOISE_M * rng.normal(size=160)
                columns = {name: np.zeros(160) for name in channel.names} | {
                    "displacement_m": value,
                    "device_ticks": 25 * number,
                }
                time = start + 250_000 * number.astype(np.int64)
                log.batch(Batch(channel, time, number.astype(np.uint32), columns), int(time[-1]) + 100_000)
        return log.finish({"losses": {}})
