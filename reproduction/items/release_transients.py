"""Figures 3.15 and 3.18: motion after a release, recorded and simulated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis import RigModel, SimulatedRun, simulate_run
from analysis.figures.sheet import MEASURED_LOOK, MODEL_LOOK, WIDTH_IN, sheet
from analysis.figures.style import GREY, MEASURED, MODEL, band, label, outline
from analysis.steady_state import locked_radius_m
from dynamics import RotorParameters
from reproduction.items.imbalance_curves import Series
from reproduction.recorded import Recorded
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import Workspace, numbers_of
from rig_basics.arrays import Array

BEFORE_S, AFTER_S = 3.0, 17.0
_MOMENT = 0.12 * 0.02117
_MAX_ANGLE_DEG, _MAX_SHARE = 2.0, 0.03
_MAX_DELAY_S = 4e-3
_BINS = 130  # of an envelope: each at least as long as a revolution


def _series(mass_b: float) -> Series:
    settings = (f"pendulums.b.mass_kg={mass_b}", "virtual.sensors.axis_angle_deg=0.0")
    return Series("above", 2.5, settings, 0.01, (_MOMENT,))


def release_of_different_3_15(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.15: non-identical pendulums."""
    return _release(work, "3.15", 0.037)


def release_of_equal_3_18(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.18: identical pendulums."""
    return _release(work, "3.18", 0.075)


@dataclass(frozen=True)
class _Pair:
    """Return recorded signals and the simulated ones at their times, from the release on; degrees and mm."""

    time_s: Array
    angle_deg: Array
    angle_model_deg: Array
    shown_time_s: Array
    shown_mm: Array
    shown_model_mm: Array
    delay_s: tuple[float, float]


def _release(work: Workspace, number: str, mass_b: float) -> Reproduced:
    series = _series(mass_b)
    ((_, recorded),) = series.recordings(work)
    simulated = simulate_run(recorded.run, RigModel.of(recorded.rig))
    if simulated is None:
        raise RuntimeError(f"{number}: the model does not follow its recording {recorded.run.source}")
    pair = _paired(recorded, simulated)
    p = recorded.rig.physics
    kind = "equal" if mass_b == p.a.mass_kg else "different"
    title = f"{number}: release of {kind} pendulums, Ω = {series.speed_ratio:g}, M_A = 0.075 kg, M_B = {mass_b:g} kg"
    description = (
        "Displacements of both lasers and both pendulum angles from 3 s before the release, recorded and simulated."
    )
    return Reproduced(
        (Panel("release", description, _figure(title, recorded, simulated)),),
        (
            SourceTable(
                "angles",
                "Pendulum angles, recorded and simulated",
                {
                    "time_s": pair.time_s,
                    "theta3_deg": pair.angle_deg[:, 0],
                    "theta4_deg": pair.angle_deg[:, 1],
                    "theta3_model_deg": pair.angle_model_deg[:, 0],
                    "theta4_model_deg": pair.angle_model_deg[:, 1],
                },
            ),
            SourceTable(
                "displacements",
                "Displacements, recorded and simulated",
                {
                    "time_s": pair.shown_time_s,
                    "x_mm": pair.shown_mm[:, 0],
                    "y_mm": pair.shown_mm[:, 1],
                    "x_model_mm": pair.shown_model_mm[:, 0],
                    "y_model_mm": pair.shown_model_mm[:, 1],
                },
            ),
        ),
        numbers_of(p) | {"speed_ratio": series.speed_ratio},
        (
            "Ω = 2.5, ζ = 0.05, S_P = 2.54 g m: the source's text gives none of them.",
            "The model has the rig's own parameters, the speed by the tachometer and the start angles by the encoders; "
            "fitted is each laser's delay against the encoder's clock, one number, on the locked orbit, no more.",
            "The lasers stand along the model's axes.",
        ),
        (*_before(recorded, p), _alike(pair), _after(recorded)),
    )


def _paired(recorded: Recorded, simulated: SimulatedRun) -> _Pair:
    run, go = recorded.run, recorded.measured.release_s
    ends = (go - BEFORE_S, min(go + AFTER_S, float(simulated.time_s[-1])))
    inside = (run.angle_time_s >= ends[0]) & (run.angle_time_s <= ends[1]) & np.isfinite(run.angle_rad).all(axis=1)
    time, angles = run.angle_time_s[inside][::5], run.angle_rad[inside][::5]
    model = np.stack([_at(time, simulated.time_s, simulated.angle_rad[:, i]) for i in (0, 1)], axis=1)
    whole = 2 * math.pi * np.round(np.median(angles - model, axis=0) / (2 * math.pi))
    at = run.x_time_s[(run.x_time_s >= ends[0]) & (run.x_time_s <= ends[1])][::4]
    shown = np.stack([_at(at, t, v) for t, v in ((run.x_time_s, run.x_m), (run.y_time_s, run.y_m))], axis=1)
    shown = shown - np.mean(shown, axis=0)
    delays = [
        _delay_s(at[at < go], shown[at < go, i], simulated.time_s, v)
        for i, v in enumerate((simulated.x_m, simulated.y_m))
    ]
    of_model = np.stack(
        [_at(at - delay, simulated.time_s, v) for delay, v in zip(delays, (simulated.x_m, simulated.y_m), strict=True)],
        axis=1,
    )
    return _Pair(
        time - go,
        np.degrees(angles - whole),
        np.degrees(model),
        at - go,
        1e3 * shown,
        1e3 * of_model,
        (delays[0], delays[1]),
    )


def _at(time: Array, of_time: Array, values: Array) -> Array:
    return np.asarray(np.interp(time, of_time, values), np.float64)


def _delay_s(time: Array, shown: Array, model_time: Array, model: Array) -> float:
    """Return the delay of a laser's locked orbit against the model's, by least squares over delays."""
    tried = np.linspace(-_MAX_DELAY_S, _MAX_DELAY_S, 401)
    left = [float(np.mean((shown - _at(time - delay, model_time, model)) ** 2)) for delay in tried.tolist()]
    return float(tried[int(np.argmin(left))])


def _figure(title: str, recorded: Recorded, simulated: SimulatedRun) -> Figure:
    pair = _paired(recorded, simulated)
    with sheet(WIDTH_IN, 6.4, title) as figure:
        rows: list[Axes] = figure.subplots(4, 1, sharex=True).tolist()
        for i, name in enumerate("xy"):
            band(rows[i], pair.shown_time_s, pair.shown_mm[:, i], MEASURED, "recorded", bins=_BINS)
            outline(rows[i], pair.shown_time_s, pair.shown_model_mm[:, i], MODEL, "simulated", bins=_BINS)
            label(rows[i], None, f"{name}, mm")
        for i, name in enumerate(("θ3 of A, °", "θ4 of B, °")):
            rows[2 + i].plot(pair.time_s, pair.angle_deg[:, i], **MEASURED_LOOK)
            rows[2 + i].plot(pair.time_s, pair.angle_model_deg[:, i], **MODEL_LOOK)
            label(rows[2 + i], None, name)
        for axes in rows:
            axes.axvline(0.0, color=GREY, lw=0.8, ls=(0, (4, 3)))
        rows[-1].set_xlim(-BEFORE_S, float(pair.time_s[-1]))
        label(rows[-1], "time since the release, s")
    return figure


def _before(recorded: Recorded, p: RotorParameters) -> list[Claim]:
    """Return the effect of the locked pendulums on the imbalance."""
    speed = recorded.measured.speed_rad_s.value
    gain = speed**2 / abs(complex(p.k1_N_per_m - p.total_mass_kg * speed**2, speed * p.damping_Ns_per_m[0]))
    difference = p.a.first_moment_kg_m - p.b.first_moment_kg_m
    moment = p.imbalance_moment_kg_m + difference
    found = locked_radius_m(recorded.run)
    off = found / (gain * moment) - 1
    shown = (
        f"locked amplitude {1e3 * found:.4f} mm, by S_P + S_A − S_B = {1e3 * moment:.3f} g m "
        f"{1e3 * gain * moment:.4f} mm ({100 * off:+.2f} %); by S_P alone {1e3 * gain * p.imbalance_moment_kg_m:.4f} mm"
    )
    if difference > 0:
        statement = "Locked at 0° the heavier pendulum adds to the imbalance and the rotor vibrates more."
        return [Claim.judged("3.2.3", statement, abs(off) < 0.005 and moment > 1.1 * p.imbalance_moment_kg_m, shown)]
    statement = "Equal pendulums locked at 0° and 180° leave the level of imbalance as it is."
    return [Claim.judged("3.2.3", statement, abs(off) < 0.005, shown)]


def _alike(pair: _Pair) -> Claim:
    angle = np.sqrt(np.mean((pair.angle_deg - pair.angle_model_deg) ** 2, axis=0))
    shown = np.sqrt(np.mean((pair.shown_mm - pair.shown_model_mm) ** 2, axis=0))
    size = np.sqrt(np.mean(pair.shown_mm[pair.shown_time_s < 0] ** 2, axis=0))
    return Claim.judged(
        "3.2.3",
        "Simulation and measurement respond alike to the release.",
        bool(np.all(angle < _MAX_ANGLE_DEG) and np.all(shown < _MAX_SHARE * size)),
        f"over {BEFORE_S:g} s before and {pair.time_s[-1]:.0f} s after the release, rms of recorded minus simulated: "
        f"θ3 {angle[0]:.2f}°, θ4 {angle[1]:.2f}°, x {1e3 * shown[0]:.1f} µm, y {1e3 * shown[1]:.1f} µm, compared "
        f"with {1e3 * size[0]:.0f} µm rms of the locked rotor; lasers {1e3 * pair.delay_s[0]:.2f} and "
        f"{1e3 * pair.delay_s[1]:.2f} ms late",
    )


def _after(recorded: Recorded) -> Claim:
    left, locked = recorded.measured.amplitude_m.value, locked_radius_m(recorded.run)
    return Claim.judged(
        "3.2.3",
        "Released, the pendulums balance the rotor.",
        left < 0.01 * locked,
        f"amplitude {1e3 * locked:.3f} mm locked, {1e6 * left:.2f} µm "
        f"{recorded.measured.to_s - recorded.measured.release_s:.0f} s after the release; "
        f"state {recorded.measured.state}",
    )
