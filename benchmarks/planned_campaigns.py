"""Promises of planned campaigns against what their recordings give: `python -m benchmarks.planned_campaigns`.

Each campaign has a rig with drawn damping and a drawn requirement on c3 and c4. Its plan is recorded by the
laboratory's equations (benchmarks.worlds.motion) and identified, with the suspension known as well as the plan
assumes. The table contains the achieved over the promised standard deviation, and the errors over the promised one.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.independent_friction import Dry, swings
from benchmarks.independent_rig import Encoders, release_run
from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from identification import FitFailed, NotIdentifiable, fit_release, fit_spin_down_run
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientFit
from identification.plan import Requirement, plan_experiments
from identification.plan.experiment import Experiment
from rig_configs import load_rig
from rig_configs.schema import Rig

_NAMES = ("c3_Nms_per_rad", "c4_Nms_per_rad")
_SUSPENSION = {"k1_N_per_m": 1e-4, "k2_N_per_m": 1e-4, "zeta1": 1e-3, "zeta2": 1e-3, "SP_kg_m": 1e-3}  # as the plan
_ENCODERS = Encoders(2 * np.pi / 4096, 1000.0, 0.3, 0.0)
_LOCKED_S, _HAND_S = 0.5, 0.05


def spin_down_run(physics: RotorParameters, flick_rad_s: float, record_s: float, rng: np.random.Generator) -> Run:
    """Both pendulums flicked in opposite directions on a resting rotor."""
    a, b = physics.a, physics.b
    p = np.r_[
        physics.total_mass_kg, physics.k1_N_per_m, physics.k2_N_per_m, physics.damping_Ns_per_m,
        a.first_moment_kg_m, b.first_moment_kg_m, physics.imbalance_moment_kg_m, a.inertia_kg_m2, b.inertia_kg_m2,
        a.damping_Nms_per_rad, b.damping_Nms_per_rad, 0.0, rng.uniform(0, np.pi),
    ]  # fmt: skip
    kept = [float(np.exp(-own.damping_Nms_per_rad / own.inertia_kg_m2 * _HAND_S)) for own in (a, b)]
    start = np.r_[0.0, 0.0, 0.0, np.pi, 0.0, 0.0, flick_rad_s * kept[0], -flick_rad_s * kept[1]]
    free = swings(start, np.arange(0, record_s, 1e-3), p, Dry())
    state = np.vstack([np.tile(np.r_[start[:6], 0.0, 0.0], (round(_LOCKED_S * 1e3), 1)), free])
    time, none = 1e-3 * np.arange(len(state)), np.empty(0)
    angle = _ENCODERS.read(state[:, 2:4], rng)
    return Run("spin-down", "planned spin-down", 0.0, time, state[:, 0], time, state[:, 1], time, angle, none, none)


def recorded(physics: RotorParameters, step: Experiment, rng: np.random.Generator, known: Knowledge) -> TransientFit:
    """Record one planned experiment and fit it."""
    if step.method == "spin-down":
        run = spin_down_run(physics, step.settings["flick_rad_per_s"], step.record_s, rng)
        return fit_spin_down_run(run, known)
    speed_Hz = step.settings["speed_rpm"] / 60
    run = release_run(physics, speed_Hz, rng, _ENCODERS, np.zeros(2), step.record_s)
    return fit_release(replace(run, test=step.test), known, float(np.radians(0.05)))


def campaign(seed: int, rig: Rig) -> list[tuple[str, float, float]]:
    """Return (method, achieved over promised standard deviation, error over the promised one) of c3 and c4."""
    rng = np.random.default_rng([6, seed])
    damping = dict(zip(_NAMES, (1e-3 * np.exp(rng.uniform(-0.7, 0.7, 2))).tolist(), strict=True))
    physics = rig.physics.with_values(**damping)
    table = rig.pendulums.model_copy(
        update={
            part: getattr(rig.pendulums, part).model_copy(update={"damping_Nms_per_rad": damping[name]})
            for part, name in zip("ab", _NAMES, strict=True)
        }
    )
    share = float(np.exp(rng.uniform(np.log(5e-4), np.log(1e-2))))
    plan = plan_experiments(rig.model_copy(update={"pendulums": table}), [Requirement(n, share, True) for n in _NAMES])
    true = physics.identified()
    std = {name: share * true[name] for name, share in _SUSPENSION.items()}
    known = Knowledge.nominal(physics).with_found({name: true[name] for name in _SUSPENSION}, std)
    rows: list[tuple[str, float, float]] = []
    for step in plan.steps:
        try:
            fit = recorded(physics, step.experiment, rng, known)
        except (FitFailed, NotIdentifiable) as error:
            print(f"campaign {seed}: {error}")
            continue
        for name in step.experiment.expected.names:
            promised = step.experiment.relative_std(name) * true[name]
            method = step.experiment.method
            rows.append((method, fit.std[name] / promised, (fit.values[name] - true[name]) / promised))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaigns", type=int, default=100)
    count, rig = parser.parse_args().campaigns, load_rig("virtual")
    rows = [row for seed in range(count) for row in campaign(seed, rig)]
    print("| test | values | achieved over promised: 5 %, median, 95 % | error over promised: rms, largest |")
    print("|---|---|---|---|")
    for method in sorted({row[0] for row in rows}):
        ratio, z = np.array([row[1:] for row in rows if row[0] == method]).T
        low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        rms, most = float(np.sqrt(np.mean(z**2))), float(np.max(np.abs(z)))
        print(f"| {method} | {len(z)} | {low:.2f}, {middle:.2f}, {high:.2f} | {rms:.2f}, {most:.1f} |")


if __name__ == "__main__":
    main()
