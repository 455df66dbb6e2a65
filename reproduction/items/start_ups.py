"""Section 3.3.2: repeated start-ups of a ball balancer and of a pendulum balancer, recorded on virtual rigs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

import dynamics
from analysis import measure
from analysis.figures.start_ups import draw_start_ups
from analysis.friction_sweep import balance_of
from analysis.settled_scatter import SettledScatter, more_consistent, settled_scatter
from analysis.steady_state import SteadyMeasurement, locked_radius_m
from daq.lockstep.rehearsal import Rehearsal
from dynamics import Pendulum, RotorParameters, locked_orbit
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import ISOTROPIC, Workspace, numbers_of
from rig_basics.arrays import Array
from rig_basics.texts import number_of
from rig_basics.units import RPM
from studies.runs import load_runs

COUNT = 12
"""Start-ups of the balls; for the pendulums half as many in each of two series."""
BALLS = "ball_balancer"
SPEED_RPM = 1500.0
SPEED = SPEED_RPM * RPM
PIN_ARM_M = 8e-6
"""Assumed friction arm of a pendulum: a small ball bearing, μ = 0.002 on a pin of 4 mm radius."""
LOCKED_PP_M = 1.75e-3
WITHOUT_PP_M = 0.80475e-3
PENDULUMS = (
    "imbalance.radius_m=0.05226",
    "virtual.truth.imbalance.radius_m=0.05226",
    "limits.speed_rpm=1600",
    f"pendulums.a.friction_arm_m={PIN_ARM_M}",
    f"pendulums.b.friction_arm_m={PIN_ARM_M}",
)
"""Settings of the isotropic rig: an imbalance that whirls by 1.75 mm peak to peak with pendulums locked apart."""


@dataclass(frozen=True)
class _Series:
    """Recorded start-ups of one rig.

    Attributes:
        scatter: of their ends.
        ends: as measured.
        locked_m: order-1 radius with both locked at 0° and 180°, m.
    """

    scatter: SettledScatter
    ends: tuple[SteadyMeasurement, ...]
    locked_m: float

    @property
    def std(self) -> tuple[Array, Array]:
        """Return standard uncertainties of places and amplitudes, rad (n, 2) and m (n,)."""
        return (
            np.array([[angle.std for angle in end.theta_rad] for end in self.ends]),
            np.array([end.amplitude_x_m.std for end in self.ends]),
        )

    @property
    def own_rad(self) -> float:
        """Return the scatter of the measurements alone, without common errors of all start-ups as encoder zeros."""
        return math.sqrt(float(np.mean([np.diag(end.own)[:2] for end in self.ends])))

    @property
    def lower(self) -> list[str]:
        """Return which of the two is at the lower angle: mirror images have different errors of the encoder zeros."""
        turned = [[math.remainder(angle.value - math.pi, 2 * math.pi) for angle in end.theta_rad] for end in self.ends]
        return ["A" if a < b else "B" for a, b in turned]

    def table(self, name: str, title: str) -> SourceTable:
        """Return every start-up."""
        places, (angle_std, amplitude_std) = np.degrees(self.scatter.places_rad), self.std
        return SourceTable(
            name,
            title,
            {
                "start_up": [float(i + 1) for i in range(len(self.ends))],
                "lower_deg": places[:, 0],
                "higher_deg": places[:, 1],
                "lower_is": self.lower,
                "place_std_deg": np.degrees(angle_std.max(axis=1)),
                "amplitude_pp_mm": 2e3 * self.scatter.amplitude_m,
                "amplitude_pp_std_mm": 2e3 * amplitude_std,
            },
            shown=True,
        )


def _recorded(work: Workspace, rig: str, settings: tuple[str, ...], count: int, seed: int) -> _Series:
    """Record start-ups from rest, and one release at speed, whose locked orbit is the level without a balancer."""
    ends, recorded = list[SteadyMeasurement](), 0
    with Rehearsal(rig, work.recordings(f"{rig}-{seed}"), [*settings, f"virtual.seed={seed}"]) as far:
        (locked,) = load_runs([far.record("start-ups", speed_rpm=SPEED_RPM, count=1).runs[0].log])
        for _ in range(count):
            log = far.record("start-ups", speed_rpm=SPEED_RPM, count=1, from_rest=1).runs[0].log
            (run,) = load_runs([log])
            ends.append(measure(run, far.rig))
            if recorded:
                log.unlink()  # twelve megabytes each, all similar: only the first is kept
            recorded += 1
            work.progress(recorded / (count + 1))
        physics = far.rig.physics
    theta = np.array([[angle.value for angle in end.theta_rad] for end in ends])
    found = settled_scatter(theta, np.array([end.amplitude_x_m.value for end in ends]), balance_of(physics))
    return _Series(found, tuple(ends), locked_radius_m(locked))


def without(p: RotorParameters) -> RotorParameters:
    """Return the rig without its balancer."""
    return replace(p, a=Pendulum.absent(), b=Pendulum.absent())


def level(p: RotorParameters, theta: tuple[float, float] = (0.0, math.pi)) -> float:
    """Return the amplitude of x at 1500 rpm with the pendulums held, m."""
    return abs(locked_orbit(p, SPEED, *theta)[0])


def _degrees(rad: float) -> str:
    value = math.degrees(rad)
    return f"{value:.1f}°" if value >= 0.1 else f"{value:.2g}°"


def balls_3_27(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.27: final positions of the balls, start-up by start-up, and remaining vibration."""
    p = work.physics(BALLS)
    series = _recorded(work, BALLS, (), COUNT, 327)
    bare, balance = level(without(p)), balance_of(p)
    assert balance is not None
    best = level(p, (math.pi - balance, math.pi + balance))
    levels = {"without balls (computed)": bare, "balls locked at ±30° (computed)": best}
    figure = draw_start_ups(
        series.scatter,
        f"3.27: {COUNT} start-ups of the ball balancer, from rest to 1500 rpm",
        levels,
        ("Amplitudes are drawn peak to peak: only so do the source's levels fit its masses.",),
        series.std,
    )
    return Reproduced(
        (
            Panel(
                "places",
                "Resting places of both balls across, amplitude of the disk's centre up, a symbol a "
                "start-up, its two balls joined; the levels without balls and with balls locked where they balance.",
                figure,
            ),
        ),
        (series.table("start-ups", "Start-ups of the ball balancer as measured"),),
        numbers_of(p)
        | {
            "rolling_resistance_m": 1e-5,
            "friction_arm_m": p.a.friction_arm_m,
            "speed_rpm": SPEED_RPM,
            "ball_radius_m": p.a.ball_radius_m,
            "rotor_kg_of_the_level": p.rotor_mass_kg,
        },
        (
            "Rolling resistance of 10 µm (a length): the source gives none; item 3.28 sweeps it. Viscous damping of "
            "0.0001 N m s/rad: none is given either.",
            "114 mm is the radius of the circle of the balls' centres: with it the level without balls requires a "
            "rotor near the 7 kg of the pendulum rig; as the radius of the channel's wall it would require less.",
            "The imbalance is that of two balls locked at ±30° from its far side, 2 m R cos 30°. The virtual rig's "
            "locks stand at 0° and 180°; ±30° is computed.",
            "Balls are pushed by hand before each start, so that they begin elsewhere; angles are measured by the "
            "virtual rig's encoders, where the source read a dial.",
        ),
        _ball_claims(p, series, bare, best),
    )


def _ball_claims(p: RotorParameters, series: _Series, bare: float, best: float) -> tuple[Claim, ...]:
    """Return the claims of Figure 3.27.

    Args:
        bare, best: amplitude of x without balls and with balls locked in balance, m.
    """
    left = series.scatter.amplitude_m
    return (
        _mass_of_the_level(p),
        Claim.judged(
            "section 3.3.2",
            "Vibration is largest without balls: every start-up with balls has less.",
            bool(np.all(left < bare)),
            f"without {2e3 * bare:.3f} mm peak to peak (balls locked apart, measured "
            f"{2e3 * series.locked_m:.3f} mm); with balls {2e3 * left.min():.3f} to {2e3 * left.max():.3f} mm, "
            f"in the mean {2e3 * left.mean():.3f} mm",
        ),
        Claim.judged(
            "section 3.3.2",
            "It is smallest with the balls locked at ±30°.",
            bool(np.all(left > best)),
            f"locked there {2e6 * best:.2g} µm by the model, least of the start-ups {2e6 * left.min():.0f} µm",
        ),
        Claim.judged(
            "Figure 3.27",
            "The balls settle at other places each time, widely scattered.",
            series.scatter.scatter_rad > 10 * series.own_rad and series.scatter.scatter_rad > math.radians(5),
            f"standard deviation of a place {_degrees(series.scatter.scatter_rad)} ± "
            f"{_degrees(series.scatter.scatter_std_rad)}, of the amplitude "
            f"{2e3 * series.scatter.amplitude_scatter_m:.3f} mm peak to peak; the measurements alone "
            f"{_degrees(series.own_rad)}",
        ),
    )


def _mass_of_the_level(p: RotorParameters) -> Claim:
    """Compare 0.80475 mm without balls with the mass of the disk."""
    bare = without(p)
    mass = dict[str, float]()
    for name, amplitude in (("half of a whole swing", WITHOUT_PP_M / 2), ("0–peak", WITHOUT_PP_M)):
        rotor = 7.0
        for _ in range(60):  # with constant springs the amplification depends slightly on the mass
            found = replace(bare, rotor_mass_kg=rotor)
            rotor = (rotor + found.imbalance_mass_kg) * level(found) / amplitude - found.imbalance_mass_kg
        mass[name] = rotor
    zero, swing = mass["0–peak"], mass["half of a whole swing"]
    verdict = "holds" if abs(zero - 7) < 0.35 else "holds in part" if abs(swing - 7) < 0.35 else "does not hold"
    return Claim(
        "section 3.3.2",
        "Without balls the amplitude is 0.80475 mm.",
        verdict,
        f"with 2 m R cos 30° = {p.imbalance_moment_kg_m:.4g} kg m it requires a rotor of {zero:.2f} kg as an amplitude "
        f"(0–peak) and of {swing:.2f} kg peak to peak; the pendulum rig's has 7 kg: taken as peak to peak",
    )


def _pendulums(work: Workspace, seed: int) -> tuple[RotorParameters, _Series]:
    settings = [each for each in PENDULUMS if not each.startswith(("virtual", "limits"))]
    return work.physics(ISOTROPIC, settings), _recorded(work, ISOTROPIC, PENDULUMS, max(2, COUNT // 2), seed)


_ASSUMED = (
    "The source names neither the speed nor the imbalance of these start-ups: 1500 rpm as for the balls, and the "
    "imbalance that whirls by 1.75 mm peak to peak with the pendulums locked apart.",
    f"Friction arm of a pendulum {1e6 * PIN_ARM_M:g} µm (μ = 0.002 of a small ball bearing at 4 mm): the source gives "
    "none; item 3.28 sweeps it.",
    "Pendulums are pushed by hand before each start, so that they begin elsewhere.",
)


def pendulums_3_29(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.29: final positions of the pendulums, and the level with both locked."""
    p, series = _pendulums(work, 329)
    locked = level(p)
    figure = draw_start_ups(
        series.scatter,
        f"3.29: {number_of(series.scatter.count, 'start-up')} of the pendulum balancer, from rest to 1500 rpm",
        {"locked at 0° and 180° (computed)": locked, "locked where they balance (computed)": 0.0},
        ("Amplitudes are drawn peak to peak: only so do the source's levels fit its masses.",),
        series.std,
    )
    most = p.a.first_moment_kg_m + p.b.first_moment_kg_m
    wanted = {
        name: amplitude * p.imbalance_moment_kg_m / locked
        for name, amplitude in (("peak", LOCKED_PP_M), ("swing", LOCKED_PP_M / 2))
    }
    left = series.scatter.amplitude_m
    return Reproduced(
        (
            Panel(
                "places",
                "Resting places of both pendulums across, amplitude of the disk's centre up, a symbol a "
                "start-up; the level with the pendulums locked at 0° and 180°.",
                figure,
            ),
        ),
        (series.table("start-ups", "Start-ups of the pendulum balancer as measured"),),
        numbers_of(p) | {"friction_arm_m": PIN_ARM_M, "speed_rpm": SPEED_RPM},
        _ASSUMED,
        (
            Claim(
                "section 3.3.2",
                "With the pendulums locked at 0° and 180° the amplitude is 1.75 mm.",
                "holds" if wanted["peak"] <= most else "holds in part" if wanted["swing"] <= most else "does not hold",
                f"at 1500 rpm 1.75 mm 0–peak needs S_P = {1e3 * wanted['peak']:.2f} g m, more than both pendulums' "
                f"{1e3 * most:.2f}: they could not balance it; peak to peak it needs "
                f"{1e3 * wanted['swing']:.2f} g m and they can. So drawn, measured {2e3 * series.locked_m:.3f} mm",
            ),
            Claim.judged(
                "Figure 3.29",
                "Free pendulums leave a small part of the locked rotor's vibration.",
                bool(np.all(left < 0.05 * locked)),
                f"{2e3 * left.min():.4f} to {2e3 * left.max():.4f} mm peak to peak, "
                f"{100 * left.max() / locked:.2f} % of the locked rotor's at most",
            ),
            Claim.judged(
                "Figure 3.29",
                "The pendulums settle at the same places each time.",
                series.scatter.scatter_rad < math.radians(0.2),
                f"standard deviation of a place {_degrees(series.scatter.scatter_rad)}; the measurements alone "
                f"{_degrees(series.own_rad)}; {_degrees(series.scatter.off_rad)} (rms) off the balance",
            ),
        ),
    )


def zoomed_3_30(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.30: the same enlarged, another series, and a comparison with the balls."""
    p, series = _pendulums(work, 330)
    figure = draw_start_ups(
        series.scatter,
        f"3.30: resting places of the pendulums closer, {number_of(series.scatter.count, 'further start-up')}",
        {},
        ("Error bars hold what all start-ups share: each encoder's zero and the lasers' gain.",),
        series.std,
        zoom=True,
    )
    balls = simulated_balls(work)
    chance = more_consistent(series.scatter, balls)
    ratio = balls.scatter_rad / max(series.scatter.scatter_rad, 1e-12)
    amplitudes = balls.amplitude_scatter_m / max(series.scatter.amplitude_scatter_m, 1e-15)
    return Reproduced(
        (
            Panel(
                "closer",
                "Two plots around the resting places of the two pendulums, amplitude of the disk's centre up, "
                "a symbol a start-up; where they would balance exactly.",
                figure,
            ),
        ),
        (series.table("start-ups", "Further start-ups of the pendulum balancer as measured"),),
        numbers_of(p) | {"friction_arm_m": PIN_ARM_M, "speed_rpm": SPEED_RPM},
        (*_ASSUMED, "The balls' scatter is simulated from 24 random places; item 3.27 has recordings."),
        (
            Claim.judged(
                "section 3.3.2",
                "Pendulums are much more consistent than balls.",
                ratio > 5 and chance < 1e-3,
                f"standard deviation of a place {_degrees(series.scatter.scatter_rad)} against "
                f"{_degrees(balls.scatter_rad)}, {ratio:.3g} times; of the amplitude {amplitudes:.3g} times; "
                f"equal ones would differ so much with a probability of {chance:.1g}. For friction arms of "
                f"{1e6 * PIN_ARM_M:g} and {1e6 * work.physics(BALLS).a.friction_arm_m:.0f} µm; item 3.28 has "
                "the dependence on assumed friction",
            ),
            Claim.judged(
                "Figure 3.30",
                "They come to rest off the exact balance, always at the same places.",
                series.scatter.off_rad > 3 * series.scatter.scatter_rad,
                f"{_degrees(series.scatter.off_rad)} (rms) off, scattered by {_degrees(series.scatter.scatter_rad)}: "
                "consistent is not exact",
            ),
        ),
    )


def simulated_balls(work: Workspace, count: int = 24) -> SettledScatter:
    """Return start-ups of the ball balancer by the model, from random places."""
    p = work.physics(BALLS)
    ends = dynamics.start_ups_from_rest([p] * count, SPEED, SPEED_RPM / 120.0, dynamics.random_starts(count, 330))
    return settled_scatter(ends.theta_rad, ends.amplitude_m[:, 0], balance_of(p))
