"""Time per unit and error of the services that use every core: maps, batches of releases, steady states."""

from __future__ import annotations

import dataclasses
import os
import time

import numpy as np

from dynamics.arrays import Array
from dynamics.bench import heyoka_runs
from dynamics.bench.heyoka_runs import Rig
from dynamics.bench.motion_precision import release
from dynamics.bench.records import Measurement
from dynamics.bench.timing import median_seconds
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.batch import simulate_batch
from dynamics.stability.stability_map import StabilityMap, stability_map
from dynamics.steady.steady_motions import steady_states
from rig_basics.texts import number_of

SPEED_RATIOS, STIFFNESS_RATIOS = (0.3, 7.0), (1.0, 16.0)
_SPREAD = 0.1  # relative half-width of the batch's parameters
_VARIED = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "c3_Nms_per_rad", "c4_Nms_per_rad", "SP_kg_m")
_JUDGED_RUNS = 50  # number of releases compared with the reference
_SEED = 20261121


def map_rows(
    parameters: RotorParameters,
    shape: tuple[int, int],
    sample: int,
    accuracy: float,
    peer_tolerance: float,
    repeats: int,
) -> list[Measurement]:
    """Rows of the stability map on all cores, with its true error on a random sample, and of heyoka on that sample.

    Args:
        shape: numbers of stiffness ratios and speed ratios.
        sample: number of points compared with the reference.
        peer_tolerance: heyoka's tolerance per step.
    """
    speeds, stiffness = np.linspace(*SPEED_RATIOS, shape[1]), np.linspace(*STIFFNESS_RATIOS, shape[0])
    points = shape[0] * shape[1]
    cores = os.cpu_count() or 1
    spans = [f"{low:g}…{high:g}" for low, high in (SPEED_RATIOS, STIFFNESS_RATIOS)]
    case = f"{number_of(points, 'point')}, Ω {spans[0]} × K {spans[1]}"
    found = stability_map(parameters, speeds, stiffness, accuracy)
    seconds = median_seconds(lambda: stability_map(parameters, speeds, stiffness, accuracy), repeats) / points
    places = np.random.default_rng(_SEED).choice(points, min(sample, points), replace=False)
    rigs = [_rig_at(parameters, found, int(i)) for i in places]
    error, rows = None, list[Measurement]()
    if heyoka_runs.available():
        true, _ = _heyoka_multipliers(rigs, heyoka_runs.EXTENDED_TOLERANCE)
        values = found.multiplier_max.ravel()[places]
        error = max(heyoka_runs.relative(float(v), t) for v, t in zip(values, true, strict=True))
        peers, taken = _heyoka_multipliers(rigs, peer_tolerance)
        peer_error = max(heyoka_runs.relative(v, t) for v, t in zip(peers, true, strict=True))
        setting = f"tolerance {peer_tolerance:.0e}, {cores} cores, {len(rigs)} of the points"
        rows.append(Measurement("map", case, "heyoka (variational)", setting, taken, "point", peer_error, peer=True))
    estimate = float(np.max(found.error_estimate / np.maximum(1.0, found.multiplier_max)))
    setting = f"accuracy {accuracy:.0e}, {cores} cores"
    own = Measurement(
        "map",
        case,
        f"automatic: {found.method}",
        setting,
        seconds,
        "point",
        error,
        estimate,
        automatic=True,
        accuracy=accuracy,
        count=points,
        chosen=(found.method,),
    )
    return [own, *rows]


def _rig_at(parameters: RotorParameters, found: StabilityMap, place: int) -> Rig:
    row, column = divmod(place, len(found.x))
    k2 = float(found.y[row]) * parameters.k1_N_per_m
    return dataclasses.replace(parameters, k2_N_per_m=k2), parameters.speed_rad_s(float(found.x[column]))


def _heyoka_multipliers(rigs: list[Rig], tolerance: float) -> tuple[list[float], float]:
    """Largest multipliers by heyoka on all cores, and the time per point without compilation, s."""
    integrator = heyoka_runs.compiled(True, tolerance)
    start = time.perf_counter()
    found = heyoka_runs.on_all_cores(
        lambda own, i: heyoka_runs.largest_multiplier(rigs[i], tolerance, own), integrator, len(rigs)
    )
    return found, (time.perf_counter() - start) / len(rigs)


def batch_rows(parameters: RotorParameters, speed_ratio: float, runs: int, duration_s: float) -> list[Measurement]:
    """Rows of releases with different parameters on all cores, and of heyoka for the same releases."""
    rng = np.random.default_rng(_SEED)
    base = parameters.identified()
    rigs: list[Rig] = []
    for _ in range(runs):
        drawn = {name: base[name] * rng.uniform(1 - _SPREAD, 1 + _SPREAD) for name in _VARIED}
        one = parameters.with_values(**drawn)
        rigs.append((one, one.speed_rad_s(speed_ratio)))
    scenes = [release(rig) for rig in rigs]
    times, accuracy = np.array([0.0, duration_s]), 1e-6
    sets = [rig[0] for rig in rigs]
    case = f"{number_of(runs, 'release')} of {duration_s:g} s at Ω = {speed_ratio:g}, parameters ± {100 * _SPREAD:g} %"
    found = simulate_batch(sets, scenes, times, accuracy, last_only=True)
    if not np.all(found.ok):
        case += f", {int(np.sum(~found.ok))} refused"
    seconds = median_seconds(lambda: simulate_batch(sets, scenes, times, accuracy, last_only=True), 3)
    ends, rows, error = found.states[:, -1], list[Measurement](), None
    if heyoka_runs.available():
        judged = [i for i in range(min(runs, _JUDGED_RUNS)) if found.ok[i]]
        true = {i: _end(rigs[i], scenes[i].start, duration_s, heyoka_runs.EXTENDED_TOLERANCE) for i in judged}
        error = max(heyoka_runs.angle_error(ends[i], true[i]) for i in judged)
        integrator = heyoka_runs.compiled(False, 1e-9)
        start = time.perf_counter()
        peers = heyoka_runs.on_all_cores(
            lambda own, i: _end(rigs[i], scenes[i].start, duration_s, 1e-9, own), integrator, runs
        )
        taken = time.perf_counter() - start
        peer_error = max(heyoka_runs.angle_error(peers[i], true[i]) for i in judged)
        rows.append(Measurement("batch", case, "heyoka", "tolerance 1e-09", taken / runs, "run", peer_error, peer=True))
    estimate = float(np.max(found.error_estimates[found.ok]))
    own = Measurement(
        "batch",
        case,
        "automatic",
        f"accuracy {accuracy:.0e}",
        seconds / runs,
        "run",
        error,
        estimate,
        automatic=True,
        accuracy=accuracy,
        count=runs,
        chosen=("automatic",),
    )
    return [own, *rows]


def _end(rig: Rig, start: Array | None, duration_s: float, tolerance: float, own: object = None) -> Array:
    return heyoka_runs.end_state(rig, np.array(start), duration_s, tolerance, own)


def steady_state_rows(points: dict[str, Rig], accuracy: float, repeats: int) -> list[Measurement]:
    """Rows of all steady states at each point. The error is that of the balanced state's largest multiplier."""
    rows: list[Measurement] = []
    for name, (parameters, speed) in points.items():
        found = steady_states(parameters, speed, accuracy)
        balanced = [s for s in found if s.type == "I"]
        error = None
        if balanced and heyoka_runs.available():
            true = heyoka_runs.largest_multiplier((parameters, speed), heyoka_runs.EXTENDED_TOLERANCE)
            error = heyoka_runs.relative(balanced[0].multiplier_max, true)
        estimate = max(s.error_estimate / max(1.0, s.multiplier_max) for s in found)
        seconds = median_seconds(lambda p=parameters, w=speed: steady_states(p, w, accuracy), repeats)
        rows.append(
            Measurement(
                "steady states",
                name,
                number_of(len(found), "state"),
                f"accuracy {accuracy:.0e}",
                seconds,
                "call",
                error,
                estimate,
                automatic=True,
                accuracy=accuracy,
                chosen=(number_of(len(found), "state"),),
            )
        )
    return rows
