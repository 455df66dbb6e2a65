"""Clock of a recording: never exact unless the operator states it, and one clock for all columns of a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.exchange import import_recording, make_recipe
from daq.log.file import LogFile
from daq.signals.clock_rates import rate_std_between
from daq.signals.run import Run, load_run
from identification.clocks import clock_errors
from identification.identify import Identification, identify
from rig_configs import load_rig
from rig_configs.error_label import ErrorLabel
from rig_configs.schema import Rig
from rig_configs.shared_errors import shared_source
from tests.daq.signals.test_signals import DISPLACEMENT_Y, START, batch

RIG = load_rig("virtual")
UNSTATED = RIG.model_copy(
    update={
        "devices": {
            name: type(device).model_validate(
                {k: v for k, v in device.model_dump().items() if k != "clock_tolerance_ppm"}
            )
            for name, device in RIG.devices.items()
        }
    }
)
MASS = RIG.physics.total_mass_kg
K1, K2, ZETA1, ZETA2 = 2471.0, 41987.0, 0.0171, 0.0113


def plucked(path: Path, rate_error: float, seed: int = 3) -> Path:
    """A pluck in closed form: two decays, axes 1.3° apart, white noise; stamps of a clock with `rate_error`."""
    rng = np.random.default_rng(seed)
    t = np.arange(15_000) / 1000.0

    def decay(stiffness: float, zeta: float, amplitude: float) -> NDArray[np.float64]:
        natural = np.sqrt(stiffness / MASS)
        return amplitude * np.exp(-zeta * natural * t) * np.cos(natural * np.sqrt(1 - zeta**2) * t + 0.3)

    one, two, turn = decay(K1, ZETA1, 2.6), decay(K2, ZETA2, 0.9), np.radians(1.3)
    x = np.cos(turn) * one + np.sin(turn) * two + 2e-3 * rng.normal(size=len(t))
    y = np.cos(turn) * two - np.sin(turn) * one + 2e-3 * rng.normal(size=len(t))
    np.savetxt(path, np.column_stack([t * (1 + rate_error), x, y]), "%.9f", delimiter=",", header="t,x,y", comments="")
    return path


def brought_in(path: Path, rig: Rig = RIG, **options: Any) -> Run:
    out = path.with_suffix(".mcap")
    import_recording(path, out, rig, make_recipe(test="ring-down-x", time="t:s", x="x:mm", y="y:mm", **options))
    return load_run(out)


def stds_off(found: Identification, name: str, truth: float) -> float:
    return (found.parameters.values[name] - truth) / found.parameters.std[name]


def test_stamps_30_ppm_fast_are_within_the_interval(tmp_path: Path) -> None:
    run = brought_in(plucked(tmp_path / "fast.csv", 30e-6))
    found = identify([run], RIG)
    for name, truth in (("k1_N_per_m", K1), ("k2_N_per_m", K2)):
        assert abs(stds_off(found, name, truth)) < 3
        assert found.parameters.std[name] >= 2 * 30e-6 * truth
    one, two = (list(found.parameters.values).index(n) for n in ("k1_N_per_m", "k2_N_per_m"))
    assert found.parameters.correlation[one, two] > 0.9  # one clock stamped both
    exact = identify([brought_in(plucked(tmp_path / "stated.csv", 0.0), clock_tolerance_ppm=0.1)], RIG)
    assert exact.parameters.std["k1_N_per_m"] < 0.2 * found.parameters.std["k1_N_per_m"]
    assert abs(stds_off(exact, "k1_N_per_m", K1)) < 4


def test_files_of_one_recorder_share_its_error_and_those_of_two_do_not(tmp_path: Path) -> None:
    def together(*recorders: str) -> float:
        runs = [
            brought_in(plucked(tmp_path / f"{'-'.join(recorders)}{i}.csv", 0.0, i), UNSTATED, recorder=name)
            for i, name in enumerate(recorders)
        ]
        return identify(runs, UNSTATED).parameters.std["k2_N_per_m"] / (2 * 50e-6 * K2)

    unnamed, one, two = together("", ""), together("a", "a"), together("a", "b")
    assert unnamed == pytest.approx(one, rel=0.02)
    assert one >= 1.0
    assert two == pytest.approx(one / np.sqrt(2), rel=0.1)


def test_a_recorder_without_a_stated_tolerance_counts_50_ppm_with_a_warning(tmp_path: Path) -> None:
    path = plucked(tmp_path / "a.csv", 0.0)
    recipe = make_recipe(test="ring-down-x", time="t:s", x="x:mm", y="y:mm")
    done = import_recording(path, tmp_path / "unstated.mcap", UNSTATED, recipe)
    assert any("50 ppm" in warning for warning in done.warnings)
    run = load_run(done.path)
    assert run.clock_rate_std["x"] == pytest.approx(50e-6)
    assert rate_std_between(run, "x", "phase") == 0.0
    assert list(clock_errors(run, {"x": np.ones(1), "y": np.ones(1)})) == [ErrorLabel("clock", "recorder")]
    stated = import_recording(path, tmp_path / "stated.mcap", RIG, recipe)
    assert not any("ppm" in warning for warning in stated.warnings)


def test_what_one_log_has_read_of_a_rate_is_an_error_of_its_own(tmp_path: Path) -> None:
    path = plucked(tmp_path / "a.csv", 0.0)
    recipe = make_recipe(test="ring-down-x", time="t:s", x="x:mm", y="y:mm")
    run = load_run(import_recording(path, tmp_path / "a.mcap", RIG, recipe).path)
    rates = {"clock_rate_std": {"x": 5e-6, "y": 5e-6}, "clock_shared_std": {"x": 3e-6, "y": 5e-6}}
    both = replace(run, **rates, clocks={"x": "east", "y": "north"})
    slopes = {"x": np.array([1.0, 0.0]), "y": np.array([0.0, 2.0])}
    found = clock_errors(both, slopes, ("a/1.mcap", "b/2.mcap"))
    assert {label: shift.tolist() for label, shift in found.items()} == {
        ErrorLabel("clock", "east"): pytest.approx([3e-6, 0.0]),
        ErrorLabel("clock", "east", "1.mcap + 2.mcap"): pytest.approx([4e-6, 0.0]),
        ErrorLabel("clock", "north"): pytest.approx([0.0, 1e-5]),
    }
    assert [shared_source(label).kind for label in found] == ["B", "A", "B"]


@pytest.mark.parametrize(
    ("facts", "ppm"),
    [
        ({}, 50.0),
        ({"clock_tolerance_ppm": "0.0"}, 0.0),
        ({"clock_tolerance_ppm": "7"}, 7.0),
    ],
)
def test_a_log_without_a_stated_clock_is_not_exact(tmp_path: Path, facts: dict[str, str], ppm: float) -> None:
    y = batch(DISPLACEMENT_Y, 1e-3, displacement_m=np.array([1e-3, 2e-3, 3e-3]))
    attachments = {"rig.json": RIG.snapshot_json()}
    path = tmp_path / "a.mcap"
    with LogFile(path, {"test": "ring-down-y", **facts}, attachments, (), START, [y.channel]) as log:
        log.batch(y, y.time_ns)
        log.finish({"losses": {}})
    assert load_run(path).clock_rate_std["y"] == pytest.approx(1e-6 * ppm)
