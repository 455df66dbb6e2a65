"""A world's campaign, recorded: two ring-downs, a spin-down, a run-up and a release at each point, as `Run` objects.

Times are what a recording of real devices has after its clocks were mapped: each device's own rate error is left in
them. Angles and phase come from one node, each laser has its own clock.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np

from benchmarks.worlds.motion import STEP_S, Array, Turning, moved
from benchmarks.worlds.world import FLICK_RAD_S, World
from daq.signals.run import Release, Run

BEFORE_POINTS = ("ring-down-x", "ring-down-y", "spin-down", "run-up")
SETTLE_S = {"A": 45.0, "B": 45.0, "C": 60.0, "D": 45.0, "E": 55.0}
"""Seconds recorded after the release; C comes to rest slowest."""
LONGEST_S = 90.0
"""Seconds after which a guided test ends, settled or not."""
_RING_S, _SPIN_S, _RAMP_S, _TOP_RPM, _WAIT_S, _LOCKED_S = 13.0, 8.0, 40.0, 900.0, 8.0, 4.0
_NODE = 4  # grid steps between the node's samples: 1 kHz
_BLOCK = 8  # samples of one radio message
_MARK_JITTER_S, _RELEASE_S = 1e-6, 1e-4
_FINE_PHASE_RAD = 2 * math.pi / 2**16  # of an encoder that reads a rotor that should rest
_WANDER_FROM_Hz = 0.02
_MAINS_Hz, _HARMONICS = 50.0, (1.0, 0.4, 0.2)


@dataclass(frozen=True)
class _Recorded:
    """The motion on the grid, from which the sensors read."""

    test: str
    time_s: Array
    state: Array
    turning: Turning
    release_s: float | None = None


def campaign_tests(world: World) -> list[str]:
    """The whole campaign in its order."""
    return [*BEFORE_POINTS, *(f"point-{name}" for name in world.rig.points)]


def record(world: World, seed: int, test: str, settle_s: float | None = None) -> Run:
    """One test of a campaign.

    Args:
        seed: of noise, lock play, phases and what the operator does; not of the world.
        test: "ring-down-x", "ring-down-y", "spin-down", "run-up" or "point-NAME" with a point of the rig file.
        settle_s: how long a point is recorded after the release; None: SETTLE_S.
    Raises:
        ValueError: no such test.
    """
    rng = _stream(seed, test)
    if test in ("ring-down-x", "ring-down-y"):
        return _read(world, seed, _ring_down(world, test, rng))
    if test == "spin-down":
        return _read(world, seed, _spin_down(world, rng))
    if test == "run-up":
        return _read(world, seed, _run_up(world, rng))
    if test.removeprefix("point-") in world.rig.points and test.startswith("point-"):
        return _read(world, seed, _point(world, test, rng, settle_s))
    raise ValueError(f"expected one of {', '.join(campaign_tests(world))}, got {test!r}")


def _stream(seed: int, name: str) -> np.random.Generator:
    """Random numbers of their own for each purpose: an effect more moves nothing else."""
    return np.random.default_rng([seed, 2, zlib.crc32(name.encode())])


def _locks(world: World, rng: np.random.Generator) -> Array:
    return np.array([0.0, math.pi]) + world.lock_play_rad * rng.uniform(-1, 1, 2)


def _rest(world: World, turning: Turning) -> Array:
    """Where the springs of a bent shaft rest at the start, m."""
    bow = world.mechanics.bow_m * np.exp(1j * (world.mechanics.bow_rad + turning.rows[0, 1]))
    return np.array([bow.real, bow.imag])


def _grid(seconds: float) -> Array:
    return STEP_S * np.arange(float(round(seconds / STEP_S)))


def _phase(rng: np.random.Generator) -> float:
    return float(rng.uniform(-math.pi, math.pi))


def _ring_down(world: World, test: str, rng: np.random.Generator) -> _Recorded:
    """Pulled within 0.1 s, held for 0.4 s, released."""
    time, pull, go = _grid(0.7 + 0.5 + _RING_S), 0.7, round(1.2 / STEP_S)
    held = np.array([2.6e-3, 0.25e-3] if test.endswith("x") else [-0.2e-3, 2.4e-3]) * (
        1 + 0.05 * rng.standard_normal(2)
    )
    turning, lock = Turning.steady(_phase(rng), 0.0), _locks(world, rng)
    state = np.zeros((len(time), 8))
    state[:, 2:4] = lock
    rest = _rest(world, turning)
    state[:go, :2] = rest + np.clip((time[:go, None] - pull) / 0.1, 0, 1) * held
    state[go:] = moved(world.mechanics, turning, time[go:], np.r_[rest + held, lock, np.zeros(4)], False)
    return _Recorded(test, time, state, turning)


def _spin_down(world: World, rng: np.random.Generator) -> _Recorded:
    """Rotor at rest, or creeping; both pendulums flicked, one each way."""
    time, flick = _grid(0.7 + _SPIN_S), round(0.7 / STEP_S)
    turning = Turning.steady(_phase(rng), world.effects.creep_rpm * math.pi / 30)
    lock, rest = _locks(world, rng), _rest(world, turning)
    speed = FLICK_RAD_S * np.array([0.96, -0.9]) * (1 + 0.05 * rng.standard_normal(2)) * rng.choice([-1, 1])
    state = np.tile(np.r_[rest, lock, np.zeros(4)], (len(time), 1))
    state[flick:] = moved(world.mechanics, turning, time[flick:], np.r_[rest, lock, 0.0, 0.0, speed], True)
    return _Recorded("spin-down", time, state, turning)


def _run_up(world: World, rng: np.random.Generator) -> _Recorded:
    time = _grid(0.5 + _RAMP_S + 1.0)
    turning = Turning.ramp(_phase(rng), 0.5, _TOP_RPM * math.pi / 30, _RAMP_S)
    start = np.r_[_rest(world, turning), _locks(world, rng), np.zeros(4)]
    return _Recorded("run-up", time, moved(world.mechanics, turning, time, start, False), turning)


def _point(world: World, test: str, rng: np.random.Generator, settle_s: float | None) -> _Recorded:
    """Four seconds of the locked orbit, then both pendulums released."""
    name = test.removeprefix("point-")
    ratio, physics = world.rig.points[name].speed_ratio, world.rig.physics
    speed = ratio * math.sqrt(physics.k1_N_per_m / physics.total_mass_kg) * (1 + 0.002 * float(rng.standard_normal()))
    turning, lock, locked = Turning.steady(_phase(rng), speed), _locks(world, rng), _WAIT_S + _LOCKED_S
    time = _grid(locked + (settle_s or SETTLE_S.get(name, 60.0)))
    go = round((locked + 0.1 * float(rng.random())) / STEP_S)
    x, y = (a * np.exp(1j * turning.rows[0, 1]) for a in world.mechanics.locked_orbit(speed, lock))
    start = np.r_[x.real, y.real, lock, (1j * speed * x).real, (1j * speed * y).real, 0.0, 0.0]
    before = moved(world.mechanics, turning, time[: go + 1], start, False)
    after = moved(world.mechanics, turning, time[go:], before[-1], True)
    since = round(_WAIT_S / STEP_S)  # of a locked orbit that a hardening spring makes another than the linear one
    state = np.concatenate([before[since:-1], after])
    return _Recorded(test, time[since:], state, turning, float(time[go]))


def _read(world: World, seed: int, recorded: _Recorded) -> Run:
    """What the devices make of a motion."""
    rng = _stream(seed, f"{recorded.test} node")
    lasers = _lasers(world, seed, recorded)
    rates = {device: 1 + rate for device, rate in world.clock.items()}
    time, node = recorded.time_s, recorded.time_s[::_NODE]
    step, wrong = 2 * math.pi / world.effects.counts, np.array(world.zero_rad)
    counts = (recorded.state[::_NODE, 2:4] + wrong) / step
    angle = np.round(counts + world.effects.encoder_noise_counts * rng.standard_normal(counts.shape)) * step
    keep = _arrived(len(node), world.effects.gaps, _stream(seed, f"{recorded.test} radio"))
    marks, phases, fine = _marks(world, recorded, _stream(seed, f"{recorded.test} marks"))
    releases: tuple[Release, ...] = ()
    if recorded.release_s is not None:
        release_s = (recorded.release_s + _RELEASE_S * float(rng.standard_normal())) * rates["encoder"]
        releases = (Release(0, release_s), Release(1, release_s))
    roles = world.rig.roles
    ppm = {d.axis: d.clock_tolerance_ppm for d in roles.displacements}
    angles = roles.angles.clock_tolerance_ppm if roles.angles else 0.0
    stds = {"x": ppm["x"], "y": ppm["y"], "angles": angles, "phase": angles}
    return Run(
        recorded.test,
        f"world-{world.seed}/{recorded.test}.mcap",
        0.0,
        time * rates["laser_x"],
        lasers[0],
        time * rates["laser_y"],
        lasers[1],
        node[keep] * rates["encoder"],
        angle[keep],
        marks * rates["encoder"],
        phases,
        releases,
        step,
        {name: 1e-6 * std for name, std in stds.items()},
        {"x": "laser_x", "y": "laser_y", "angles": "encoder", "phase": "encoder"},
        phase_time_s=fine[0] * rates["encoder"],
        phase_rad=fine[1],
        phase_absolute=not _integrated(world, recorded.test),
    )


def _lasers(world: World, seed: int, recorded: _Recorded) -> tuple[Array, Array]:
    """Both displacements as shown, with an offset, m."""
    rng, more = (_stream(seed, f"{recorded.test} {name}") for name in ("lasers", "disturbances"))
    effects, state, time = world.effects, recorded.state, recorded.time_s
    cos, sin = math.cos(world.axis_rad), math.sin(world.axis_rad)
    x, y = state[:, 0], state[:, 1]
    shown: list[Array] = []
    if effects.runout_m:
        angle = recorded.turning.phase(time)[0] + _phase(np.random.default_rng([world.seed, 3]))
        x, y = x + effects.runout_m * np.cos(angle), y + effects.runout_m * np.sin(angle)
    for axis, value in enumerate((x * cos + y * sin, y * cos - x * sin)):
        reading = value * world.gain[axis] + 1e-4 * rng.standard_normal()
        reading = reading + effects.noise_m * rng.standard_normal(len(time))
        if effects.hum_m:
            for k, share in enumerate(_HARMONICS, 1):
                wave = 2 * math.pi * _MAINS_Hz * k * time + _phase(more)
                reading = reading + effects.hum_m * share * np.sin(wave)
        if effects.wander_m:
            reading = reading + effects.wander_m * wander(len(time), STEP_S, more)
        shown.append(reading)
    return shown[0], shown[1]


def wander(samples: int, step_s: float, rng: np.random.Generator) -> Array:
    """1/f noise above 0.02 Hz with an rms of 1, shape (samples,)."""
    frequency = np.fft.rfftfreq(samples, step_s)
    shape = np.zeros(len(frequency))
    high = frequency >= min(_WANDER_FROM_Hz, frequency[1])
    high[0] = False
    shape[high] = frequency[high] ** -0.5
    drawn = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    noise = np.fft.irfft(shape * drawn, samples)
    return noise / (np.std(noise) or 1.0)


def _arrived(samples: int, gaps: float, rng: np.random.Generator) -> np.ndarray:
    """Which samples came through: bursts, in which four of five messages are lost; gaps: times as many as usual."""
    blocks = math.ceil(samples / _BLOCK)
    lost, burst = np.zeros(blocks, bool), False
    draws = rng.random((blocks, 2))
    for i in range(blocks):
        burst = bool(draws[i, 0] > 0.4) if burst else bool(draws[i, 0] < 0.002 * gaps)
        lost[i] = burst and draws[i, 1] < 0.8
    return ~np.repeat(lost, _BLOCK)[:samples]


def _integrated(world: World, test: str) -> bool:
    return bool(world.effects.speed_noise_rpm) and test.startswith("point-")


def _marks(world: World, recorded: _Recorded, rng: np.random.Generator) -> tuple[Array, Array, tuple[Array, Array]]:
    """Index marks, their phases, and times and values of a phase that is read all the time, where one is."""
    none, time, effects = np.empty(0), recorded.time_s, world.effects
    node = time[::_NODE]
    phase, speed = recorded.turning.phase(node)
    if speed.max() <= 0.2:  # at rest, or creeping by less than a turn
        if not speed.any():
            return none, none, (none, none)
        return none, none, (node, np.round(phase / _FINE_PHASE_RAD) * _FINE_PHASE_RAD)
    if _integrated(world, recorded.test):
        read = speed + effects.speed_noise_rpm * math.pi / 30 * rng.standard_normal(len(node))
        shown = np.r_[0.0, np.cumsum(0.5 * (read[1:] + read[:-1]) * np.diff(node))]
    elif effects.phase_step_deg:
        step = math.radians(effects.phase_step_deg)
        shown = np.round((phase - world.index_rad) / step) * step
    else:
        turns = _whole_turns(float(phase[0]) + 2 * math.pi, float(phase[-1]) - 2 * math.pi)
        fired = recorded.turning.crossings(turns + world.index_rad, time)
        return fired + _MARK_JITTER_S * rng.standard_normal(len(turns)), turns, (none, none)
    highest = np.maximum.accumulate(shown)
    rising = np.flatnonzero(np.diff(highest, prepend=-np.inf) > 0)
    turns = _whole_turns(float(shown[0]), float(highest[-1]))
    return np.interp(turns, shown[rising], node[rising]), turns, (node, shown)


def _whole_turns(first_rad: float, last_rad: float) -> Array:
    """All multiples of 2π in a span, rad."""
    return 2 * math.pi * np.arange(math.ceil(first_rad / (2 * math.pi)), math.floor(last_rad / (2 * math.pi)) + 1.0)
