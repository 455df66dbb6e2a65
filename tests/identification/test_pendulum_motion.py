"""The free motion's derivatives and the locked start, against the dynamics package's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.equations.kernels import FA, FB
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import locked_state, simulate
from dynamics.motions.sensitivities import packed_derivatives, sensitivities
from identification.pendulums.free_angles import swing
from identification.pendulums.frictional_motion import frictional_motion
from identification.pendulums.locked_start import LockedStart
from identification.pendulums.variational import PARAMETER_COLUMNS, free_motion
from identification.samples import block_averages
from rig_configs.load import load_rig

RIG = replace(load_rig("virtual").physics, bow_x_m=2e-4, bow_y_m=-1e-4)  # the most that there may be
RAMP = SpeedHistory.ramp(40.0, 55.0, 4.0)
START = np.array([1e-3, 5e-4, 0.02, 3.1, 0.03, 0.02, 0.1, 0.2])


def test_derivatives_match_complex_steps() -> None:
    names = ["k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "c3_Nms_per_rad", "c4_Nms_per_rad", "SP_kg_m"]
    time = np.linspace(0.0, 1.0, 51)
    wanted = sensitivities(RIG, Scene(RAMP, start=START), time, [*(f"start_{i}" for i in range(8)), *names], 1e-9)
    states, raw = free_motion(START, 0.0, time, 5e-4, RAMP.knots_s, RAMP.coefficients, RIG.packed())
    by = packed_derivatives(RIG)
    columns = [raw[:, :, i] for i in range(8)] + [raw[:, :, 8:] @ by[n][list(PARAMETER_COLUMNS)] for n in names]
    scale = np.abs(wanted[1]).max(axis=(0, 1))
    assert np.stack(columns, axis=2) / scale == pytest.approx(wanted[1] / scale, abs=2e-5)
    assert states[:, 2:4] == pytest.approx(simulate(RIG, Scene(RAMP, start=START), time, 1e-9).state[:, 2:4], abs=1e-6)


def test_block_means_are_means_of_the_motion() -> None:
    time = np.arange(0.02, 0.5, 1e-3)
    motion = swing(RIG, RAMP, START, 0.0, 0.01, 0.5)
    assert motion is not None
    exact = simulate(RIG, Scene(RAMP, start=START), np.r_[0.0, time], 1e-10).state[1:]
    blocks = block_averages(time, exact[:, 2], 0.004, 1e-3)
    assert motion.angle(0, blocks)[0] == pytest.approx(blocks.value, abs=2e-6)


def test_locked_start_is_the_locked_orbit_at_constant_speed() -> None:
    steady = LockedStart(SpeedHistory.constant(50.0, 0.3), 0.0, 4.0)
    state, _ = steady.at(RIG, 0.01, 3.1, 0.002)
    assert state == pytest.approx(locked_state(RIG, 50.0, 0.3 + 50.0 * 4.002, 0.01, 3.1), rel=1e-4, abs=1e-8)


def test_locked_start_s_derivatives_are_its_own() -> None:
    start = LockedStart(RAMP, 0.0, 5.0)
    true = RIG.identified()
    state, by = start.at(RIG, 0.01, 3.1, 1e-3)
    moves = [
        (start.at(RIG, 0.01 + 1e-6, 3.1, 1e-3)[0], 1e-6),
        (start.at(RIG, 0.01, 3.1 + 1e-6, 1e-3)[0], 1e-6),
        (start.at(RIG, 0.01, 3.1, 1e-3 + 1e-6)[0], 1e-6),
    ]
    for name in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m"):
        moves.append((start.at(RIG.with_values(**{name: true[name] * np.exp(1e-4)}), 0.01, 3.1, 1e-3)[0], 1e-4))
    for column, (moved, step) in enumerate(moves):
        numeric = (moved - state) / step
        assert by[:, column] == pytest.approx(numeric, rel=4e-3, abs=4e-3 * np.abs(numeric).max() + 1e-9)


@pytest.mark.parametrize("dry", [None, np.array([2e-5, 1e-5, 1e-9, 0.0])])
def test_without_derivatives_it_is_the_same_motion(dry: np.ndarray | None) -> None:
    """To the last bit: differences of such motions are derivatives."""
    whole, bare = (swing(RIG, RAMP, START, 0.0, 0.01, 2.0, dry, slopes) for slopes in (True, False))
    assert whole is not None
    assert bare is not None
    assert np.array_equal(whole.states, bare.states)
    assert bare.derivatives.shape == (len(bare.time_s), 8, 0)


@pytest.mark.parametrize(
    ("dry", "slides"),
    [([1.0, 1.0, 0.0, 0.0], [0, 0]), ([2e-5, 1.0, 0.0, 0.0], [1, 0]), ([2e-5, 0.0, 1e-8, 0.0], [1, 1])],
)
def test_a_motion_with_dry_friction_begins_with_its_own_rates(dry: list[float], slides: list[int]) -> None:
    """A pendulum that friction holds has none: a later release changes nothing of it."""
    rest, step = np.r_[START[:6], 0.0, 0.0], 1e-6
    motion = swing(RIG, RAMP, rest, 0.0, 0.01, 0.5, np.array(dry))
    assert motion is not None
    packed = RIG.packed()
    packed[[FA, FB]] = dry[2:]
    given = (RAMP.knots_s, RAMP.coefficients, packed, np.array(dry[:2]), False)
    later = frictional_motion(rest, 0.0, np.array([step]), step, *given)[0][0]
    assert motion.start_rates == pytest.approx((later - rest) / step, rel=1e-3, abs=1e-4)
    assert np.array_equal(motion.start_rates[6:] != 0, np.array(slides, bool))
