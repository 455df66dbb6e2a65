"""The estimators' benchmark: records, bounds, peers and bookkeeping, independent of the run time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynamics.bench.records import compared
from dynamics.bench.tables import markdown
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.motions.integrate import simulate
from identification.bench import decays, library_peers, precision, ramps, releases, ring_down_peers, spins, tables
from identification.bench.fisher import bound
from identification.bench.trials import Method, MethodResult, Precision, SyntheticRecord, TrialSet, measure
from rig_configs import load_rig


def test_the_bound_of_a_decay_is_the_closed_form() -> None:
    zeta, record_s = 0.01, 20.0
    trial = decays.one_mode(np.random.default_rng(1), zeta, record_s=record_s)
    damping = zeta * 2 * np.pi * trial.truth["f1_Hz"]
    u = 2 * damping * record_s
    e0 = -np.expm1(-u) / u  # moments of t/T under e^{−2dt}
    e1 = (1 - np.exp(-u) * (1 + u)) / u**2
    e2 = (2 - np.exp(-u) * (2 + 2 * u + u**2)) / u**3
    variance = 2 * decays.NOISE_M**2 / (decays.RATE_HZ * 1e-6 * record_s**3 * (e2 - e1**2 / e0))
    assert trial.bound["f1_Hz"] == pytest.approx(np.sqrt(variance) / (2 * np.pi), rel=0.01)
    assert trial.bound["zeta1"] == pytest.approx(np.sqrt(variance) / (2 * np.pi * trial.truth["f1_Hz"]), rel=0.01)


def test_what_is_known_beforehand_lowers_the_bound() -> None:
    def line(at: np.ndarray) -> np.ndarray:
        return at[0] + at[1] * np.arange(5.0)

    theta, step = np.zeros(2), np.full(2, 0.1)
    assert bound(line, theta, step, 1.0) == pytest.approx([math.sqrt(0.6), math.sqrt(0.1)])
    assert bound(line, theta, step, 1.0, np.array([np.inf, 1e-9]))[0] == pytest.approx(math.sqrt(0.2))


def test_the_passage_obeys_its_differential_equation() -> None:
    samples, frequency, zeta = 6000, 3.0, 0.02
    omega = 2 * np.pi * frequency

    def slope(t: float, state: np.ndarray) -> list[complex]:
        phase, speed, acceleration = ramps._phase(np.array(t), samples / ramps.RATE_HZ)
        force = (speed**2 - 1j * acceleration) * np.exp(1j * phase)
        return [state[1], force - 2 * zeta * omega * state[1] - omega**2 * state[0]]

    end = (samples - 1) / ramps.RATE_HZ
    exact = solve_ivp(slope, (0, end), [0j, 0j], "DOP853", [end], rtol=1e-10, atol=1e-10).y[0, -1]
    assert abs(ramps._response(frequency, zeta, samples)[-1] - exact) < 1e-7 * abs(exact)
    before, at, after = (ramps._phase(np.array(t), 60.0) for t in (20 - 1e-5, 20.0, 20 + 1e-5))
    assert (after[0] - before[0]) / 2e-5 == pytest.approx(at[1], rel=1e-8)
    assert (after[1] - before[1]) / 2e-5 == pytest.approx(at[2], rel=1e-6)


def test_the_release_moves_as_the_dynamics_predict() -> None:
    physics = load_rig("virtual").physics
    found = physics.identified()
    suspension = np.array([found[n] for n in releases.NAMES])
    damping, start, phase = np.array([0.001, 0.002]), np.array([0.05, 3.0]), 0.7
    time = np.arange(1, 1001) / 1000
    own = releases._motion(physics, damping, suspension, start, phase, 0.0, time)
    true = physics.with_values(c3_Nms_per_rad=0.001, c4_Nms_per_rad=0.002)
    from dynamics.motions.locked_motion import locked_state

    scene = Scene(
        SpeedHistory.constant(releases.SPEED_RAD_S, phase),
        start=locked_state(true, releases.SPEED_RAD_S, phase, *start),
    )
    motion = simulate(true, scene, np.r_[0.0, time], 1e-9).state[1:]
    assert np.max(np.abs(own - motion)[:, :4]) < 1e-6


@pytest.mark.parametrize(
    "peer",
    [
        ring_down_peers.log_decrement,
        ring_down_peers.careful_log_decrement,
        ring_down_peers.half_power,
        ring_down_peers.hilbert_envelope,
        ring_down_peers.matrix_pencil,
        ring_down_peers.nonlinear_least_squares,
    ],
)
def test_every_peer_reads_a_quiet_decay(peer: Callable[[decays.DecayTrial], MethodResult]) -> None:
    trial = decays.one_mode(np.random.default_rng(3), 0.02, amplitude_m=1.0, record_s=12.0)
    assert peer(trial.record).values["f1_Hz"] == pytest.approx(trial.truth["f1_Hz"], rel=2e-3)
    assert peer(trial.record).values["zeta1"] == pytest.approx(trial.truth["zeta1"], rel=0.08)


@pytest.mark.parametrize("peer", [ring_down_peers.matrix_pencil, ring_down_peers.nonlinear_least_squares])
def test_the_strong_peers_reach_the_bound(peer: Callable[[decays.DecayTrial], MethodResult]) -> None:
    case = TrialSet(
        "ring-down",
        "c",
        lambda rng: decays.one_mode(rng, 0.02, record_s=8.0),
        {"f": ("f1_Hz",), "ζ": ("zeta1",)},
        {"f": 0.05, "ζ": 1.0},
        [Method("peer", "", peer, peer=True)],
    )
    (row,) = measure(case, 40, 5)
    assert row.gross == 0
    assert all(0.7 < v < 1.4 for v in row.rms.values())
    stated = [c for c in row.coverage.values() if c is not None]
    assert all(c > 0.85 for c in stated)


def test_two_axes_and_spin_down_are_read_by_their_peers() -> None:
    trial = decays.two_axes(np.random.default_rng(2), (3.0, 5.0), 0.01, 5.0, 10.0)
    found = ring_down_peers.nonlinear_least_squares(trial.record).values
    for name, true in trial.truth.items():
        assert abs(found[name] - true) < 5 * trial.bound[name]
    spin = spins.spin_down(np.random.default_rng(2), 1e-3)
    fitted = spins.curve_fitting(spin.record)
    assert abs(fitted.values["c_Nms_per_rad"] - 1e-3) < 5 * spin.bound["c_Nms_per_rad"]
    assert spins.log_speed_line(spin.record).values["c_Nms_per_rad"] == pytest.approx(1e-3, rel=0.02)


@pytest.mark.filterwarnings("ignore")  # its own
@pytest.mark.skipif("PyDMD" in library_peers.missing(), reason="the group peers is not installed")
def test_optimised_dmd_reads_a_decay() -> None:
    trial = decays.one_mode(np.random.default_rng(3), 0.02)
    found = library_peers.dynamic_mode_decomposition(trial.record).values
    assert abs(found["zeta1"] - trial.truth["zeta1"]) < 6 * trial.bound["zeta1"]


@pytest.mark.filterwarnings("ignore")  # its own
@pytest.mark.skipif("pyOMA2" in library_peers.missing(), reason="the group peers is not installed")
def test_subspace_identification_reads_a_decay() -> None:
    trial = decays.one_mode(np.random.default_rng(3), 0.02)
    found = library_peers.subspace_identification(trial.record).values
    assert abs(found["f1_Hz"] - trial.truth["f1_Hz"]) < 20 * trial.bound["f1_Hz"]


def _number(rng: np.random.Generator) -> SyntheticRecord:
    """A record that is one number, 10 plus noise of 1."""
    return SyntheticRecord(10 + rng.normal(), {"a": 10.0}, {"a": 1.0})


def _case(*methods: Method) -> TrialSet:
    return TrialSet("s", "c", _number, {"a": ("a",)}, {"a": 0.5}, methods)


def _read(shift: float = 0.0, half_width: float = 1.96) -> Callable[[float], MethodResult]:
    return lambda y: MethodResult({"a": y + shift}, {"a": (y + shift - half_width, y + shift + half_width)})


def test_rms_bias_and_coverage_are_correct() -> None:
    plain, shifted, proud = measure(
        _case(Method("plain", "", _read()), Method("shifted", "", _read(2.0)), Method("proud", "", _read(0.0, 0.196))),
        2000,
        7,
    )
    assert plain.rms["a"] == pytest.approx(1.0, abs=0.05)
    assert plain.bias["a"] == pytest.approx(0.0, abs=0.08)
    assert plain.coverage["a"] == pytest.approx(0.95, abs=0.02)
    assert shifted.rms["a"] == pytest.approx(math.sqrt(5), abs=0.1)
    assert shifted.bias["a"] == pytest.approx(2.0, abs=0.08)
    assert proud.coverage["a"] == pytest.approx(0.156, abs=0.03)


def test_failures_are_counted_left_out_and_kept_off_the_front() -> None:
    def flaky(value: float) -> MethodResult:
        if value > 10.5:
            raise RuntimeError("too much")
        return MethodResult({"a": value if value > 9.5 else 1e9})

    def silent(value: float) -> MethodResult:
        return MethodResult({"a": math.nan})

    rows = compared(
        measure(
            _case(Method("flaky", "", flaky), Method("silent", "", silent, peer=True), Method("good", "", _read())),
            200,
            1,
        ),
        1.15,
    )
    flaky_row, silent_row, good = rows
    assert 80 < flaky_row.gross < 160
    assert flaky_row.rms["a"] < 0.5
    assert silent_row.gross == silent_row.runs == 200
    assert silent_row.rms == {}
    assert [r.front for r in rows] == [False, False, True]
    assert flaky_row.peer_ratio is None
    assert good.peer_ratio is None  # the only peer never answers
    assert flaky_row.failure in {"RuntimeError: too much", "a = 1e+09 where 10 is true"}


def test_the_same_seed_gives_the_same_records_for_any_number() -> None:
    seen: list[float] = []

    def keep(value: float) -> MethodResult:
        seen.append(value)
        return MethodResult({"a": value})

    measure(_case(Method("m", "", keep)), 3, 11)
    few = seen[:]
    seen.clear()
    measure(_case(Method("m", "", keep)), 5, 11)
    assert seen[: len(few)] == few
    assert len(set(seen)) == 5
    seen.clear()
    measure(_case(Method("slow", "", keep)), 5, 11, most_s=0.0)
    assert len(seen) == 3
    seen.clear()
    measure(_case(Method("slow", "", keep, every_record=True)), 5, 11, most_s=0.0)
    assert len(seen) == 5


def _row(
    setting: str, rms: float, gross: int = 0, peer: bool = False, runs: int = 100, seconds: float = 0.1
) -> Precision:
    return Precision(
        "ring-down",
        "ζ 0.01, 20 s",
        "m",
        setting,
        peer,
        seconds,
        runs,
        gross,
        {"f": rms, "ζ": rms},
        {"f": 0.0, "ζ": -0.05},
        {"f": 0.95, "ζ": 0.94},
        "why" if gross else "",
    )


def test_targets_hold_the_balanced_setting_alone_and_only_when_measured_often() -> None:
    rows = [_row("fast", 9.0), _row("balanced", 1.0), _row("x", 9.0, peer=True)]
    found = {t.name: t for t in precision.targets(rows)}
    assert found["ring-down, rms over bound, all ζ"].got == pytest.approx(1.0)
    assert found["ring-down, coverage off 95 %, %"].got == pytest.approx(0.5)
    assert all(t.met for t in found.values())
    assert precision.targets([_row("balanced", 1.0, runs=15)]) == []
    assert not precision.targets([_row("balanced", 1.3)])[0].met
    failing = {t.name: t for t in precision.targets([_row("balanced", 1.0, gross=1)])}
    assert not failing["ring-down, gross failures, damaged ones too"].met


def test_the_page_contains_figures_failures_and_what_a_bound_is() -> None:
    rows = compared(
        [_row("balanced", 1.234), _row("fast", 41.0, gross=3), _row("p", 1.0, peer=True, seconds=0.2)], 1.15
    )
    machine = {"processor": "p", "cores": 2, "load_before": 0.1, "python": "3", "numba": "0", "numpy": "2"}
    page = markdown(tables.page(rows, [], machine, ["a note"]))
    assert "| **ring-down: ζ 0.01, 20 s (f · ζ; 100 records, time a record)** |" in page
    assert "| m | balanced | 100 ms | 1.23 · 1.23 | 0.00 · -0.05 | 95 · 94 | 0/100 | 0.5 | ◉ |" in page
    assert "| m | fast | 100 ms | 41 · 41 | 0.00 · -0.05 | 95 · 94 | 3/100 |  |  |" in page
    assert "- m failed at ring-down, ζ 0.01, 20 s: fast 3 of 100; for example why" in page
    assert "Cramér–Rao" in page
