"""One true rig with its sensors, drawn around the numbers of a rig file.

`Spread` has what is drawn and how widely, `Effects` the effects of a real rig outside the model. A world has numbers
only: `benchmarks.worlds.recording` makes its campaign's runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace

import numpy as np

from benchmarks.worlds.motion import Mechanics, SwingingMass
from rig_configs import load_rig
from rig_configs.known import MASSES, physical_numbers
from rig_configs.schema import Rig

FLICK_RAD_S = 12.0
"""Usual speed of a flicked pendulum: the largest viscous torque is c times this."""
PLUCK_M = 2.5e-3
"""Usual displacement of a pluck."""
FAST_RATIO = 5.8
"""Speed ratio of the fastest point, at which a contact-shaped friction has its stated share."""


@dataclass(frozen=True)
class Spread:
    """Standard uncertainty of all that a campaign draws; 0 keeps a number at the rig file's.

    Attributes:
        masses, lengths: relative, of rotor, imbalance and both pendulums, each for itself.
        balance: relative, common to all masses: one balance weighed them.
        zero_deg, index_deg, axis_deg: of each encoder's zero, of the index mark, of the sensors against the springs.
        gain: relative, of each laser.
        clock_ppm: of the rate of each device's clock.
        lock_play_deg: half the play of a lock, evenly spread, drawn for each test.
        stiffness, damping, magnets, moment: relative, of what is to be identified.
    """

    masses: float = 0.0
    lengths: float = 0.0
    balance: float = 0.0
    zero_deg: float = 0.05
    index_deg: float = 0.05
    axis_deg: float = 1.0
    gain: float = 1e-3
    clock_ppm: float = 30.0
    lock_play_deg: float = 0.2
    stiffness: float = 0.01
    damping: float = 0.04
    magnets: float = 0.04
    moment: float = 0.004

    @classmethod
    def exact(cls) -> Spread:
        """Every number that is not identified is the rig file's."""
        return cls(zero_deg=0.0, index_deg=0.0, gain=0.0, clock_ppm=0.0)

    @classmethod
    def weighed(cls) -> Spread:
        """Masses and lengths as a laboratory's balance and calliper give them, 0.05 %."""
        return cls(masses=5e-4, lengths=5e-4)


@dataclass(frozen=True)
class Effects:
    """Effects of a rig outside the model; 0 means that the effect is absent. Names are those of `--effect`.

    Attributes:
        cubic: relative gain of stiffness at 2.5 mm, both directions.
        quadratic: relative gain of the suspension's damping at the greatest speed of a 2.5 mm ring-down.
        dry: friction of the pendulums at any speed, as a share of c · 12 rad/s.
        contact: friction with the contact force, with that share at the fastest point's speed.
        drag: torque of the air that turns with the disk, with that share at 12 rad/s.
        bow_m: a bent shaft; runout_m: the same on the sensors alone.
        hum_m: mains on the lasers, 50 Hz, with 0.4 and 0.2 of it at 100 and 150 Hz.
        wander_m: rms of 1/f noise on the lasers.
        creep_rpm: speed of the rotor in the spin-down, where an encoder then reads its phase.
        phase_step_deg: an encoder of so coarse steps, read at 1 kHz, in place of the index mark.
        speed_noise_rpm: at the points a noisy speed, read at 1 kHz and integrated, in place of the index mark.
        turned_deg: how the sensors stand, in place of what is drawn.
        noise_m: white noise of the lasers; counts, encoder_noise_counts: of the encoders; gaps: radio bursts lost.
    """

    cubic: float = 0.0
    quadratic: float = 0.0
    dry: float = 0.0
    contact: float = 0.0
    drag: float = 0.0
    bow_m: float = 0.0
    runout_m: float = 0.0
    hum_m: float = 0.0
    wander_m: float = 0.0
    creep_rpm: float = 0.0
    phase_step_deg: float = 0.0
    speed_noise_rpm: float = 0.0
    turned_deg: float = 0.0
    noise_m: float = 4e-6
    counts: int = 4096
    encoder_noise_counts: float = 0.3
    gaps: float = 1.0


USUAL_STRENGTH: dict[str, float] = {
    "cubic": 0.01,
    "quadratic": 0.05,
    "dry": 0.01,
    "contact": 0.01,
    "drag": 0.02,
    "bow_m": 1e-4,
    "runout_m": 1e-4,
    "hum_m": 2e-5,
    "wander_m": 1e-5,
    "creep_rpm": 0.1,
    "phase_step_deg": 0.1,
    "speed_noise_rpm": 0.2,
    "turned_deg": 3.0,
    "noise_m": 2e-5,
    "gaps": 5.0,
}
"""Strength of an effect that is asked for by its name alone."""


@dataclass(frozen=True)
class World:
    """One true rig and its sensors.

    Attributes:
        seed: of everything drawn.
        mechanics: all that moves.
        zeta: damping ratios, x and y.
        zero_rad: what each encoder shows at 0; index_rad: ψ at the index mark; axis_rad: from the springs' x to
            sensor x; gain: shown over true, lasers x and y; clock: relative rate errors by device.
        lock_play_rad: half the play of a lock.
        rig: the rig file.
        effects: those outside the model.
    """

    seed: int
    mechanics: Mechanics
    zeta: tuple[float, float]
    zero_rad: tuple[float, float]
    index_rad: float
    axis_rad: float
    gain: tuple[float, float]
    clock: dict[str, float]
    lock_play_rad: float
    rig: Rig = field(repr=False)
    effects: Effects = Effects()

    @property
    def truth(self) -> dict[str, float]:
        """Values of all that is identified, names as in parameters.toml."""
        m = self.mechanics
        return {
            "k1_N_per_m": m.stiffness_N_per_m[0],
            "k2_N_per_m": m.stiffness_N_per_m[1],
            "zeta1": self.zeta[0],
            "zeta2": self.zeta[1],
            "c3_Nms_per_rad": m.a.damping_Nms_per_rad,
            "c4_Nms_per_rad": m.b.damping_Nms_per_rad,
            "SP_kg_m": m.moment_kg_m,
        }

    def changed(self, name: str, by: float) -> World:
        """The same world with one number another.

        Args:
            name: of WRONG.
            by: added to it, SI; of a gain relative.
        Raises:
            ValueError: no such name.
        """
        m = self.mechanics
        k, zeta, moment, a, b = m.stiffness_N_per_m, self.zeta, m.moment_kg_m, m.a, m.b
        match name:
            case "k2":
                k = (k[0], k[1] + by)
            case "zeta1":
                zeta = (zeta[0] + by, zeta[1])
            case "SP":
                moment += by
            case "c3":
                a = replace(a, damping_Nms_per_rad=a.damping_Nms_per_rad + by)
            case "mass_b":
                b = replace(b, mass_kg=b.mass_kg + by)
            case "length_b":
                b = replace(b, length_m=b.length_m + by)
            case "zero_a":
                return replace(self, zero_rad=(self.zero_rad[0] + by, self.zero_rad[1]))
            case "gain_x":
                return replace(self, gain=(self.gain[0] + by, self.gain[1]))
            case _:
                raise ValueError(f"expected one of {', '.join(WRONG)}, got {name!r}")
        mass = m.mass_kg + b.mass_kg - m.b.mass_kg
        damping = _damping(k, zeta, mass)
        moved = replace(m, mass_kg=mass, stiffness_N_per_m=k, damping_Ns_per_m=damping, moment_kg_m=moment, a=a, b=b)
        return replace(self, mechanics=moved, zeta=zeta)


WRONG = {
    "k2": "k2_N_per_m",
    "zeta1": "zeta1",
    "c3": "c3_Nms_per_rad",
    "SP": "SP_kg_m",
    "mass_b": "",
    "length_b": "",
    "zero_a": "",
    "gain_x": "",
}
"""What can be wrong, and the identified parameter whose standard deviation measures it; without one it is wrong from
the beginning, by the standard uncertainty that the rig file states or a laboratory would."""


def stated(spread: Spread) -> Rig:
    """The shipped `virtual` rig, whose file states what is drawn of masses, lengths, balance, mounting, index."""
    physics = load_rig("virtual").physics
    numbers = physical_numbers(physics)
    settings = [f"devices.{laser}.direction_std_deg={spread.axis_deg!r}" for laser in ("laser_x", "laser_y")]
    settings.append(f"devices.encoder.index_angle_std_deg={spread.index_deg!r}")
    for name, value in numbers.items():
        share = spread.masses if name.endswith("mass_kg") else spread.lengths
        if share and value:
            settings.append(
                f"{name.replace('mass_kg', 'mass_std_kg').replace('length_m', 'length_std_m')}={share * value!r}"
            )
    if spread.balance:
        settings += [
            f"instruments.balance.measures={list(MASSES)!r}",
            f"instruments.balance.relative_std={spread.balance!r}",
        ]
    return load_rig("virtual", settings=settings)


def draw_world(
    seed: int, spread: Spread | None = None, effects: Effects | None = None, rig: Rig | None = None
) -> World:
    """A true rig and its sensors.

    Args:
        seed: of all draws; the same seed draws the same numbers with any effects.
        rig: around whose numbers; None: the shipped `virtual`, with what is drawn stated in its file.
    """
    spread, effects = spread or Spread(), effects or Effects()
    rig = rig or stated(spread)
    physics, rng = rig.physics, np.random.default_rng([seed, 1])
    near = rng.standard_normal(13)
    masses = 1 + spread.balance * rng.standard_normal() + spread.masses * rng.standard_normal(4)
    lengths = 1 + spread.lengths * rng.standard_normal(2)
    magnets = [
        c * (1 + spread.magnets * near[i])
        for i, c in enumerate((physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad))
    ]
    k1 = physics.k1_N_per_m * (1 + spread.stiffness * near[2])
    k2 = physics.k2_N_per_m * (1 + spread.stiffness * near[3])
    zeta = (physics.zeta1 * (1 + spread.damping * near[4]), physics.zeta2 * (1 + spread.damping * near[5]))
    weights = (
        np.array([physics.rotor_mass_kg, physics.imbalance_mass_kg, physics.a.mass_kg, physics.b.mass_kg]) * masses
    )
    fast = FAST_RATIO * math.sqrt(k1 / weights.sum())
    pendulums = [
        _pendulum(float(weights[2 + i]), own.length_m * float(lengths[i]), magnets[i], effects, fast)
        for i, own in enumerate((physics.a, physics.b))
    ]
    mass, ks = float(weights.sum()), (float(k1), float(k2))
    mechanics = Mechanics(
        mass,
        ks,
        _damping(ks, zeta, mass),
        physics.imbalance_moment_kg_m * (1 + spread.moment * float(near[6])),
        pendulums[0],
        pendulums[1],
        _both(effects.cubic / PLUCK_M**2),
        (_quadratic(effects, ks[0] / mass), _quadratic(effects, ks[1] / mass)),
        effects.bow_m,
        rng.uniform(-math.pi, math.pi),
    )
    devices = rng.standard_normal(3) * spread.clock_ppm * 1e-6
    return World(
        seed,
        mechanics,
        zeta,
        (math.radians(spread.zero_deg * near[7]), math.radians(spread.zero_deg * near[8])),
        math.radians(spread.index_deg * near[9]),
        math.radians(effects.turned_deg or spread.axis_deg * near[10]),
        (1 + spread.gain * float(near[11]), 1 + spread.gain * float(near[12])),
        dict(zip(("laser_x", "laser_y", "encoder"), devices.tolist(), strict=True)),
        math.radians(spread.lock_play_deg),
        rig,
        effects,
    )


def with_effect(text: str, effects: Effects | None = None) -> Effects:
    """Effects with one more, given as NAME or NAME=STRENGTH; a name without its unit will do.

    Raises:
        ValueError: no such effect.
    """
    name, _, strength = text.partition("=")
    names = {f.name for f in fields(Effects)}
    full = name if name in names else next((n for n in names if n.rsplit("_", 1)[0] == name), None)
    if full is None or (not strength and full not in USUAL_STRENGTH):
        raise ValueError(f"expected an effect of {', '.join(USUAL_STRENGTH)}, got {text!r}")
    value = float(strength) if strength else USUAL_STRENGTH[full]
    return replace(effects or Effects(), **{full: int(value) if full == "counts" else value})


def _both(value: float) -> tuple[float, float]:
    return (value, value)


def _quadratic(effects: Effects, stiffness_per_mass: float) -> float:
    return effects.quadratic / (PLUCK_M * math.sqrt(stiffness_per_mass))


def _damping(k: tuple[float, float], zeta: tuple[float, float], mass: float) -> tuple[float, float]:
    return (2 * zeta[0] * math.sqrt(k[0] * mass), 2 * zeta[1] * math.sqrt(k[1] * mass))


def _pendulum(mass: float, length: float, damping: float, effects: Effects, fast_rad_s: float) -> SwingingMass:
    viscous = damping * FLICK_RAD_S
    return SwingingMass(
        mass,
        length,
        damping,
        effects.drag * viscous / FLICK_RAD_S**2,
        effects.dry * viscous,
        effects.contact * viscous / fast_rad_s**2,
    )
